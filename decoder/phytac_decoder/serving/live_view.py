"""A live view of the forces in browsers of this machine, which cannot slow the sensor.

Each browser is served by a thread from the newest frames; one that reads slowly sees fewer of them.
"""

import contextlib
import itertools
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, Self

import numpy as np

from phytac_decoder.serving.wire_protocol import Message, end_message, json_bytes
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import OutputError

LOOPBACK = "127.0.0.1"


def unrolled(position_mm: FloatArray) -> FloatArray:
    """Markers (n, 3) laid out flat, (n, 2) mm: right and up.

    Markers with an angular gap of 90 degrees about the axis are a sheet, laid on its two long
    directions. Others are unrolled, angle times mean radius to the right and the axis up; if one is
    near the axis, it is a pole, and they are seen along the axis with true distances from it.
    """
    x, y, z = position_mm.T
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    ring = np.sort(angle)
    gap = float(np.diff(ring, append=ring[0] + 2.0 * np.pi).max())
    if gap > np.pi / 2.0 or np.ptp(z) < 0.1 * max(float(np.ptp(x)), float(np.ptp(y))):
        centred = position_mm - position_mm.mean(axis=0)
        _, vectors = np.linalg.eigh(centred.T @ centred)
        return np.asarray(centred @ vectors[:, :0:-1])
    if radius.min() > 0.35 * radius.max():
        return np.column_stack([angle * radius.mean(), z])
    top = z[radius.argmin()]
    reach = np.hypot(radius, z - top)
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])


class LiveView:
    """Shows messages to browsers on this machine.

    Parameters
    ----------
    hello : dict
        The stream's first message, with positions.
    port : int
        0 takes a free one.
    tare : callable
        Called, from a thread of the view's own, when its button asks for a new rest frame.

    Raises
    ------
    OutputError
        If the port is taken.
    """

    viewers_max = 8
    push_s = 1.0 / 30.0
    """Least time between two messages to a browser."""
    kept = 4096
    """Frames whose forces wait to be drawn as curves: over 8 s at 480 fps."""
    curve_max = 64
    """Points of the curves in one message; of more, evenly chosen ones."""

    def __init__(
        self, hello: Message, *, port: int = 8057, tare: Callable[[], None] = lambda: None
    ) -> None:
        place = np.asarray(hello["positions_mm"], dtype=np.float64)
        self.hello = json_bytes(hello | {"unrolled_mm": np.round(unrolled(place), 2).tolist()})
        self.tare = tare
        self._news = threading.Condition()
        self._last: Message | None = None
        self._tared: Message = {}
        self._curve: deque[tuple[int, list[float]]] = deque(maxlen=self.kept)
        self._count = itertools.count(1)
        self.number = 0
        self.viewers = 0
        self.ended = ""

        class Handler(_Handler):
            view = self

        try:
            self._http = _Http((LOOPBACK, port), Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(
                "port-unavailable",
                f"cannot listen at {LOOPBACK}, port {port} ({reason}); give another --port",
            ) from None
        self.port = int(self._http.server_address[1])
        self._thread = threading.Thread(
            target=self._http.serve_forever, args=(0.1,), name="live view", daemon=True
        )
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: object
    ) -> None:
        self.close("the source has ended" if error is None else "stopped")

    @property
    def url(self) -> str:
        """Address for the browser."""
        return f"http://{LOOPBACK}:{self.port}/"

    def publish(self, message: Message) -> None:
        """Keep a frame's message for the browsers; returns at once."""
        forces = [region["force_N"] for region in message.get("regions", [])]
        point = [message["timestamp_s"], message["total_N"], *forces]
        with self._news:
            self.number = next(self._count)
            # Browsers skip frames: the result of a tare is in all that follow.
            self._tared = {"tare": message["tare"]} if "tare" in message else self._tared
            self._last = {**message, **self._tared}
            self._curve.append((self.number, point))
            self._news.notify_all()

    def close(self, reason: str = "stopped") -> None:
        """Send browsers the end and its reason, and close all. May be called twice."""
        with self._news:
            self.ended = self.ended or reason
            self._news.notify_all()
        until = time.monotonic() + 1.0
        while self.viewers and time.monotonic() < until:
            time.sleep(0.01)
        self._http.shutdown()
        self._http.server_close()
        self._thread.join(timeout=2.0)

    def wait_for_news(self, seen: int) -> tuple[int, bytes] | None:
        """Number and JSON of the newest frame after ``seen``; None if none came for a second.

        At the end of the stream it is an end message, with number -1.
        """
        with self._news:
            self._news.wait_for(lambda: self.number > seen or self.ended, timeout=1.0)
            if self.number <= seen:
                return (-1, json_bytes(end_message(self.ended))) if self.ended else None
            number, message = self.number, self._last
            points = [point for at, point in self._curve if at > seen]
        if len(points) > self.curve_max:
            chosen = np.linspace(0, len(points) - 1, self.curve_max).round().astype(int)
            points = [points[k] for k in chosen]
        return number, json_bytes({**(message or {}), "curve": points})

    def count_viewer(self, step: int) -> bool:
        """Count a browser in or out; False if there are too many."""
        with self._news:
            if step > 0 and self.viewers >= self.viewers_max:
                return False
            self.viewers += step
            return True


class _Http(ThreadingHTTPServer):
    """A server whose connections are bounded in number, and in the time to send a request."""

    daemon_threads = True
    block_on_close = False
    connections_max = 32
    """Open connections: each has a thread. Viewers are at most a quarter."""

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self.slots = threading.BoundedSemaphore(self.connections_max)
        self.deadlines: dict[socket.socket, float] = {}
        """When each connection whose request is not complete is closed."""
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread, or close it if there are too many."""
        if not self.slots.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread could be started
            self.slots.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection, in its thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.slots.release()

    def service_actions(self) -> None:
        """Close connections whose requests take too long in all; called every 0.1 s."""
        now = time.monotonic()
        for connection, deadline in list(self.deadlines.items()):
            if now > deadline:
                with contextlib.suppress(OSError):  # it has closed
                    connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore it: a browser may close."""


class _Handler(BaseHTTPRequestHandler):
    """The page, and its events."""

    server: _Http
    view: LiveView
    timeout = 5.0
    """To send a request, and to take each answer or event."""
    protocol_version = "HTTP/1.0"

    def setup(self) -> None:
        """Begin the time for the request: ``timeout`` alone begins again with every byte."""
        super().setup()
        self.server.deadlines[self.connection] = time.monotonic() + self.timeout

    def finish(self) -> None:
        """Forget the connection."""
        self.server.deadlines.pop(self.connection, None)
        super().finish()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base's name
        """Log nothing."""

    def do_GET(self) -> None:
        """Answer a request."""
        self.server.deadlines.pop(self.connection, None)
        host = self.headers.get("Host", "")
        self._answer(host, {"/": self._page, "/events": self._events})

    def do_POST(self) -> None:
        """Take a command of the page."""
        self.server.deadlines.pop(self.connection, None)
        self._answer(self.headers.get("Host", ""), {"/tare": self._tare})

    def _answer(self, host: str, routes: dict[str, Callable[[], None]]) -> None:
        """Do what a path stands for, if the request is this machine's own."""
        # A page of another site may not read forces, nor take the places of viewers.
        if host.rsplit(":", 1)[0] not in {LOOPBACK, "localhost", "[::1]"} or not self._own(host):
            self.send_error(HTTPStatus.FORBIDDEN, "This view is for this machine alone")
        elif self.path in routes:
            # A browser that closes is no error.
            with contextlib.suppress(OSError):
                routes[self.path]()
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _own(self, host: str) -> bool:
        """Whether a request comes from this view's page, its user, or a program."""
        if self.headers.get("Origin", f"http://{host}") != f"http://{host}":
            return False
        # A link to the page is allowed. Browsers send no Origin with <img src>.
        linked = self.path == "/" and self.headers.get("Sec-Fetch-Dest") == "document"
        site = self.headers.get("Sec-Fetch-Site", "none")
        return linked or site in {"none", "same-origin"}

    def _page(self) -> None:
        body = files(__package__).joinpath("live_view.html").read_bytes()
        self._head("text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _tare(self) -> None:
        self.view.tare()
        self._head("text/plain")
        self.end_headers()

    def _events(self) -> None:
        view = self.view
        if not view.count_viewer(1):
            self.send_error(
                HTTPStatus.SERVICE_UNAVAILABLE, f"{view.viewers_max} browsers are connected already"
            )
            return
        try:
            self._head("text/event-stream")
            self.end_headers()
            self._send(view.hello)
            seen = 0
            while seen >= 0:
                news = view.wait_for_news(seen)
                if news is None:
                    # Fails if the browser has closed.
                    self.wfile.write(b": still here\n\n")
                    continue
                seen, text = news
                self._send(text)
                time.sleep(view.push_s)
        finally:
            view.count_viewer(-1)

    def _head(self, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", "default-src 'self' 'unsafe-inline'")

    def _send(self, text: bytes) -> None:
        self.wfile.write(b"data: " + text + b"\n\n")
