"""The studio's server: on this machine alone, until Ctrl-C or SIGTERM. uvicorn only here."""

import asyncio
import secrets
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.studio.access_control import PATIENCE_S, App, Guard
from phytac_design.studio.app import Studio
from phytac_design.studio.files import ProjectFolder
from phytac_shapes.errors import OutputError

LOOPBACK = "127.0.0.1"
CLIENTS_MAX = 200
"""Connections at a time; a browser has a handful."""
HEAD_MAX = 32_768
GRACE_S = 3
"""Requests that are under way when the studio ends have so long."""


class Patient(H11Protocol):
    """A connection that ends if for a while no whole request comes, or no answer is taken."""

    patience_s = PATIENCE_S
    since_s: float | None = None
    moved_s = 0.0
    waiting_bytes = 0

    def connection_made(self, transport: Any) -> None:
        """Begin to wait."""
        super().connection_made(transport)
        self.since_s = self.moved_s = self.loop.time()
        self._look()

    def data_received(self, data: bytes) -> None:
        """Note when a request began to come, until it has."""
        if self.since_s is None and self._between:
            self.since_s = self.loop.time()
        super().data_received(data)
        if not self._between:
            self.since_s = None

    def resume_writing(self) -> None:
        """Note that the client has taken something."""
        self.moved_s = self.loop.time()
        super().resume_writing()

    @property
    def _between(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def _look(self) -> None:
        waiting, before = self.transport.get_write_buffer_size(), self.waiting_bytes
        self.waiting_bytes = waiting
        if not waiting or waiting < before:
            self.moved_s = self.loop.time()
        elif self.loop.time() - self.moved_s >= self.patience_s:
            # Closing would wait for ever until the rest is taken.
            self.transport.abort()
            return
        if self.transport.is_closing() and not waiting:
            return
        if self.since_s is not None and self.loop.time() - self.since_s >= self.patience_s:
            self.since_s = None
            self.transport.close()
        self.loop.call_later(self.patience_s / 4.0, self._look)


class Told(uvicorn.Server):
    """A server that says when it answers."""

    ready: Callable[[], None] = staticmethod(lambda: None)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer."""
        await super().startup(sockets)
        self.ready()


class StudioServer:
    """A studio that is ready to run.

    Parameters
    ----------
    root : Path
        Folder that it reads and writes.
    design : str
        A shipped design, or the path of a design file.
    port : int
        0 takes a free one.
    patience_s : float
        A client that is slower than this is let go.

    Raises
    ------
    DesignError
        If the design cannot be read.
    OutputError
        If the port is taken.
    """

    def __init__(
        self, root: Path, design: str, *, port: int = 0, patience_s: float = PATIENCE_S
    ) -> None:
        load_design(design)
        given = None if design in shipped_designs() else Path(design).resolve()
        place = ProjectFolder(root, given)
        name = design
        if given is not None:
            inside = given.is_relative_to(place.root)
            name = given.relative_to(place.root).as_posix() if inside else str(given)
        self._socket = _listen(port)
        self.port = int(self._socket.getsockname()[1])
        self.token = secrets.token_urlsafe(16)
        self.studio = Studio(place, name)
        app: Any = self.studio.app()
        inner: App = app
        guard = Guard(inner, token=self.token, port=self.port, patience_s=patience_s)
        protocol = type("Own", (Patient,), {"patience_s": patience_s})
        config = uvicorn.Config(
            guard,
            http=protocol,
            loop="asyncio",
            ws="none",
            lifespan="on",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            limit_concurrency=CLIENTS_MAX,
            h11_max_incomplete_event_size=HEAD_MAX,
            timeout_keep_alive=max(1, int(patience_s)),
            timeout_graceful_shutdown=GRACE_S,
        )
        self.server = Told(config)

    @property
    def url(self) -> str:
        """Where to look; it holds this run's token."""
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    def run(self, *, ready: Callable[[str], None] = lambda _: None) -> None:
        """Serve until Ctrl-C or SIGTERM; ``ready`` is told the address once it answers."""
        self.server.ready = lambda: ready(self.url)
        asyncio.run(self.server.serve(sockets=[self._socket]))

    def stop(self) -> None:
        """End it from another thread."""
        self.server.should_exit = True


def _listen(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen(128)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"cannot listen at {LOOPBACK}, port {port} ({reason}); give another --port"
        ) from None
    return listener


def open_browser(url: str) -> bool:
    """Open a browser; whether there is one."""
    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
