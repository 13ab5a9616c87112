"""Who may talk to the studio: this machine's own pages that know the token, and nobody slowly.

Plain ASGI around the application. A page of another site can neither read (it lacks the token, and
a name that it makes point here is no host of ours) nor post (its Origin is not ours).
"""

import asyncio
import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from typing import Any

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

BODY_MAX = 8_000_000
"""Bytes of a request, at most: a design of fifty thousand explicit positions has fewer."""
PATIENCE_S = 10.0
"""A client that sends or takes nothing for this long is let go."""
NAMES = ("127.0.0.1", "localhost", "[::1]")
HEADERS = (
    (b"cache-control", b"no-store"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)
POLICY = (
    b"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    b"img-src 'self' data: blob:; connect-src 'self'; frame-src 'self'; "
    b"frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)
"""The studio's own pages load nothing from elsewhere and run no script in them (legends have
colours of their own, as inline styles)."""


class RefusedError(Exception):
    """A request that cannot be answered: its status, and why."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class Guard:
    """Lets requests through to ``app`` that are ours.

    Parameters
    ----------
    app : ASGI application
        Sees paths without the token.
    token : str
        Of this run; the first part of every path.
    port : int
        Port that the server listens at.
    patience_s : float
        See ``PATIENCE_S``.
    """

    def __init__(self, app: App, *, token: str, port: int, patience_s: float = PATIENCE_S) -> None:
        self.app, self.token, self.port, self.patience_s = app, token, port, patience_s
        self.hosts = {f"{name}:{port}" for name in NAMES}
        self.origins = {f"http://{host}" for host in self.hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on, a request."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        try:
            inner = self._admit(scope)
        except RefusedError as refused:
            await _plain(self._patient(send), refused.status, str(refused))
            return
        # Whoever takes nothing is gone by now: there is nobody to tell.
        with suppress(TimeoutError):
            await self.app(inner, self._bounded(receive), self._patient(send))

    def _admit(self, scope: Scope) -> Scope:
        """Request without its token.

        Raises
        ------
        RefusedError
            If it is not of this machine, or not of our page.
        """
        heads = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        if heads.get(b"host", "") not in self.hosts:
            raise RefusedError(403, "the studio is for this machine alone")
        if scope["method"] not in {"GET", "HEAD"}:
            if heads.get(b"origin", "") not in self.origins | {""}:
                raise RefusedError(403, "another site's page may not ask the studio for anything")
            kind = heads.get(b"content-type", "").split(";")[0].strip()
            if kind != "application/json":
                raise RefusedError(415, f"send application/json (got {kind[:80] or 'nothing'})")
        if heads.get(b"sec-fetch-site", "none") == "cross-site":
            raise RefusedError(403, "another site's page may not ask the studio for anything")
        length = heads.get(b"content-length", "0")
        if not length.isdigit() or int(length[:20]) > BODY_MAX:
            raise RefusedError(413, f"a request may hold {BODY_MAX} bytes (got {length[:20]})")
        first, _, rest = scope["path"].removeprefix("/").partition("/")
        if not hmac.compare_digest(first.encode(), self.token.encode()):
            raise RefusedError(
                403, "open the address that `phytac studio` printed: it holds this run's token"
            )
        return {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode(), "root_path": ""}

    def _bounded(self, receive: Receive) -> Receive:
        """``receive`` that refuses bodies which are too large or come too slowly."""
        taken = 0
        whole = False

        async def bounded() -> Message:
            nonlocal taken, whole
            if whole:
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), self.patience_s)
            except TimeoutError:
                raise RefusedError(408, "the request came too slowly") from None
            if message["type"] == "http.request":
                taken += len(message.get("body", b""))
                whole = not message.get("more_body", False)
                if taken > BODY_MAX:
                    raise RefusedError(413, f"a request may hold {BODY_MAX} bytes (got more)")
            return message

        return bounded

    def _patient(self, send: Send) -> Send:
        """``send`` that adds our headers and gives up on a client that takes nothing."""

        async def patient(message: Message) -> None:
            if message["type"] == "http.response.start":
                own = list(message.get("headers", []))
                have = {name.lower() for name, _ in own}
                more = [*HEADERS, (b"content-security-policy", POLICY)]
                own += [(name, value) for name, value in more if name not in have]
                message = {**message, "headers": own}
            # The connection itself ends sooner; this is for servers that do not look.
            await asyncio.wait_for(send(message), 2.0 * self.patience_s)

        return patient


async def _plain(send: Send, status: int, text: str) -> None:
    body = text.encode()
    heads = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": "http.response.start", "status": status, "headers": heads})
    await send({"type": "http.response.body", "body": body})
