"""Access control of the studio: only this machine's own pages that know the token, no slow clients.

Plain ASGI around the application. A page of another site can neither read (it lacks the token, and
a host name that resolves to this machine is rejected) nor post (its Origin is rejected).
"""

import asyncio
import hmac

from starlette.types import ASGIApp, Message, Receive, Scope, Send

BODY_MAX = 8_000_000
"""Bytes of a request, at most: a design of fifty thousand explicit positions has fewer."""
TIMEOUT_S = 10.0
"""A client that sends or receives nothing for this long is disconnected."""
POLICY = (
    b"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    b"img-src 'self' data: blob:; connect-src 'self'; frame-src 'self'; "
    b"frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)
"""The studio's own pages load nothing from elsewhere and run no inline script; inline styles colour
the legends."""
HEADERS = (
    (b"cache-control", b"no-store"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"content-security-policy", POLICY),
)


class RejectedError(Exception):
    """A rejected request: status and reason."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


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
    timeout_s : float
        See ``TIMEOUT_S``.
    """

    def __init__(
        self, app: ASGIApp, *, token: str, port: int, timeout_s: float = TIMEOUT_S
    ) -> None:
        self.app, self.token, self.port, self.timeout_s = app, token, port, timeout_s
        self.hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
        self.origins = {f"http://{host}" for host in self.hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject a request or pass it on."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        try:
            inner = self._admit(scope)
        except RejectedError as refused:
            await _plain(_with_headers(send), refused.status, str(refused))
            return
        await self.app(inner, self._bounded(receive), _with_headers(send))

    def _admit(self, scope: Scope) -> Scope:
        """Request without its token.

        Raises
        ------
        RejectedError
            If it is not of this machine, or not of the studio's page.
        """
        heads = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        if heads.get(b"host", "") not in self.hosts:
            raise RejectedError(403, "the studio is for this machine alone")
        if scope["method"] not in {"GET", "HEAD"}:
            if heads.get(b"origin", "") not in self.origins | {""}:
                raise RejectedError(403, "another site's page may not send requests to the studio")
            kind = heads.get(b"content-type", "").split(";")[0].strip()
            if kind != "application/json":
                raise RejectedError(415, f"send application/json (got {kind[:80] or 'nothing'})")
        if heads.get(b"sec-fetch-site", "none") == "cross-site":
            raise RejectedError(403, "another site's page may not send requests to the studio")
        length = heads.get(b"content-length", "0")
        if not length.isdigit() or int(length[:20]) > BODY_MAX:
            raise RejectedError(413, f"a request may hold {BODY_MAX} bytes (got {length[:20]})")
        first, _, rest = scope["path"].removeprefix("/").partition("/")
        if not hmac.compare_digest(first.encode(), self.token.encode()):
            raise RejectedError(
                403, "open the address that `phytac studio` printed: it holds this run's token"
            )
        return {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode(), "root_path": ""}

    def _bounded(self, receive: Receive) -> Receive:
        """``receive`` that rejects bodies that are too large or too slow."""
        taken = 0
        whole = False

        async def bounded() -> Message:
            nonlocal taken, whole
            if whole:
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), self.timeout_s)
            except TimeoutError:
                raise RejectedError(408, "the request timed out") from None
            if message["type"] == "http.request":
                taken += len(message.get("body", b""))
                whole = not message.get("more_body", False)
                if taken > BODY_MAX:
                    raise RejectedError(413, f"a request may hold {BODY_MAX} bytes (got more)")
            return message

        return bounded


def _with_headers(send: Send) -> Send:
    """``send`` with the security headers."""

    async def extended(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = list(message.get("headers", []))
            have = {name.lower() for name, _ in own}
            own += [item for item in HEADERS if item[0] not in have]
            message = {**message, "headers": own}
        await send(message)

    return extended


async def _plain(send: Send, status: int, text: str) -> None:
    body = text.encode()
    heads = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": "http.response.start", "status": status, "headers": heads})
    await send({"type": "http.response.body", "body": body})
