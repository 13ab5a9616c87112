"""The studio's server, on this machine only, until Ctrl-C or SIGTERM. uvicorn only here."""

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
from phytac_design.studio.access_control import TIMEOUT_S, Guard
from phytac_design.studio.files import ProjectFolder
from phytac_design.studio.web_app import Studio
from phytac_shapes.errors import OutputError

LOOPBACK = "127.0.0.1"


class TimeoutProtocol(H11Protocol):
    """A connection that ends if no complete request comes, or no response is received, in time."""

    timeout_s = TIMEOUT_S
    waiting_since_s: float | None = None
    progress_at_s = 0.0
    waiting_bytes = 0

    def connection_made(self, transport: Any) -> None:
        """Start the timeout."""
        super().connection_made(transport)
        self.waiting_since_s = self.progress_at_s = self.loop.time()
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Note when a request began, until it is complete."""
        if self.waiting_since_s is None and self._idle:
            self.waiting_since_s = self.loop.time()
        super().data_received(data)
        if not self._idle:
            self.waiting_since_s = None

    def resume_writing(self) -> None:
        """Note that the client has received something."""
        self.progress_at_s = self.loop.time()
        super().resume_writing()

    @property
    def _idle(self) -> bool:
        """Whether no response is under way."""
        return self.cycle is None or self.cycle.response_complete

    def _watch(self) -> None:
        waiting, before = self.transport.get_write_buffer_size(), self.waiting_bytes
        self.waiting_bytes = waiting
        if not waiting or waiting < before:
            self.progress_at_s = self.loop.time()
        elif self.loop.time() - self.progress_at_s >= self.timeout_s:
            # Closing would wait for the rest to be received.
            self.transport.abort()
            return
        if self.transport.is_closing() and not waiting:
            return
        if (
            self.waiting_since_s is not None
            and self.loop.time() - self.waiting_since_s >= self.timeout_s
        ):
            self.waiting_since_s = None
            self.transport.close()
        self.loop.call_later(self.timeout_s / 4.0, self._watch)


class StudioServer:
    """A studio with its socket.

    Parameters
    ----------
    root : Path
        The project folder.
    design : str
        A shipped design, or the path of a design file.
    port : int
        0 for a free one.
    timeout_s : float
        A client that is slower than this is disconnected.

    Raises
    ------
    DesignError
        If the design cannot be read.
    OutputError
        If the port is taken.
    """

    def __init__(
        self, root: Path, design: str, *, port: int = 0, timeout_s: float = TIMEOUT_S
    ) -> None:
        load_design(design)
        given = None if design in shipped_designs() else Path(design).resolve()
        project = ProjectFolder(root, given)
        name = design
        if given is not None:
            inside = given.is_relative_to(project.root)
            name = given.relative_to(project.root).as_posix() if inside else str(given)
        self.listener = _listen(port)
        self.port = int(self.listener.getsockname()[1])
        self.token = secrets.token_urlsafe(16)
        self.studio = Studio(project, name)
        guard = Guard(self.studio.app(), token=self.token, port=self.port, timeout_s=timeout_s)
        protocol = type("Own", (TimeoutProtocol,), {"timeout_s": timeout_s})
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
            limit_concurrency=200,
            h11_max_incomplete_event_size=32_768,
            timeout_keep_alive=max(1, int(timeout_s)),
            timeout_graceful_shutdown=3,
        )
        self.server = uvicorn.Server(config)

    @property
    def url(self) -> str:
        """Address, with this run's token."""
        return f"http://{LOOPBACK}:{self.port}/{self.token}/"

    def run(self, *, ready: Callable[[str], None] = lambda _: None) -> None:
        """Serve until Ctrl-C or SIGTERM; ``ready`` receives the address, which listens already."""
        ready(self.url)
        asyncio.run(self.server.serve(sockets=[self.listener]))

    def stop(self) -> None:
        """Stop it from another thread."""
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
    """Open a browser; False if there is none."""
    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
