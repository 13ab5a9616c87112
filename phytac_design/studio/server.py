"""The studio's server, on this machine only, until Ctrl-C or SIGTERM. uvicorn only here."""

import asyncio
import secrets
import socket
from collections.abc import Callable
from pathlib import Path

import uvicorn

from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.studio.access_control import Guard
from phytac_design.studio.files import ProjectFolder
from phytac_design.studio.web_app import Studio
from phytac_shapes.errors import OutputError


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

    Raises
    ------
    DesignError
        If the design cannot be read.
    OutputError
        If the port is taken.
    """

    def __init__(self, root: Path, design: str, *, port: int = 0) -> None:
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
        config = uvicorn.Config(
            Guard(self.studio.app(), token=self.token, port=self.port),
            http="h11",
            loop="asyncio",
            ws="none",
            lifespan="on",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            limit_concurrency=200,
            h11_max_incomplete_event_size=32_768,
            timeout_keep_alive=10,
            timeout_graceful_shutdown=3,
        )
        self.server = uvicorn.Server(config)

    @property
    def url(self) -> str:
        """Address, with this run's token."""
        return f"http://127.0.0.1:{self.port}/{self.token}/"

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
        listener.bind(("127.0.0.1", port))
        listener.listen(128)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            "port-unavailable",
            f"cannot listen at 127.0.0.1, port {port} ({reason}); give another --port",
        ) from None
    return listener
