"""Access control of the studio: only this machine's own pages that know the token.

Plain ASGI around the application. A page of another site can neither read (it lacks the token, and
a host name that resolves to this machine is rejected) nor post (its Origin is rejected).
"""

import hmac

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

BODY_MAX = 8_000_000
"""Bytes of a request, at most: a design of fifty thousand explicit positions has fewer."""
HEADERS = {
    "cache-control": "no-store",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; connect-src 'self'; frame-src 'self'; "
        "frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
    ),
}
"""Of every answer that does not set its own. The studio's pages load nothing from elsewhere and run
no inline script; inline styles colour the legends."""


class Guard:
    """Passes requests of the studio's own page to ``app``.

    Parameters
    ----------
    app : ASGI application
        Sees paths without the token.
    token : str
        Secret of this run; the first part of every path.
    port : int
        Port of the server.
    """

    def __init__(self, app: ASGIApp, *, token: str, port: int) -> None:
        self.app, self.token = app, token
        self.hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject a request or pass it on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def send_closed(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        try:
            path = self._admit(scope["method"], scope["path"], Headers(scope=scope))
        except HTTPException as rejected:
            answer = PlainTextResponse(
                rejected.detail, rejected.status_code, {"connection": "close"}
            )
            await answer(scope, receive, send_closed)
            return
        inner = {**scope, "path": path, "raw_path": path.encode(), "root_path": ""}
        await self.app(inner, receive, send_closed)

    def _admit(self, method: str, path: str, headers: Headers) -> str:
        """Path of a request without its token.

        Raises
        ------
        HTTPException
            If it is not of this machine, or not of the studio's page, or too large.
        """
        if headers.get("host") not in self.hosts:
            raise HTTPException(403, "the studio is for this machine alone")
        if method not in {"GET", "HEAD"}:
            origin = headers.get("origin", "")
            if origin and origin.removeprefix("http://") not in self.hosts:
                raise HTTPException(403, "another site's page may not send requests to the studio")
            kind = headers.get("content-type", "").split(";")[0].strip()
            if kind != "application/json":
                raise HTTPException(415, f"send application/json (got {kind[:80] or 'nothing'})")
            length = headers.get("content-length", "")[:20]
            if not length.isdigit() or "transfer-encoding" in headers:
                raise HTTPException(411, "a request must state its length")
            if int(length) > BODY_MAX:
                raise HTTPException(413, f"a request may hold {BODY_MAX} bytes (got {length})")
        # The file that opens the studio in a browser is another site, too.
        opens = method == "GET" and headers.get("sec-fetch-dest") == "document"
        if headers.get("sec-fetch-site") == "cross-site" and not opens:
            raise HTTPException(403, "another site's page may not send requests to the studio")
        first, _, rest = path.removeprefix("/").partition("/")
        if not hmac.compare_digest(first.encode(), self.token.encode()):
            raise HTTPException(
                403, "open the address that `phytac studio` printed: it holds this run's token"
            )
        return f"/{rest}"
