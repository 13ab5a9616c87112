"""A server of forces over TCP and a serial port, whose receivers cannot slow the sensor."""

import asyncio
import contextlib
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from phytac_decoder.io.serial_port import SerialPort
from phytac_decoder.serving.wire_protocol import (
    Message,
    MessageSplitter,
    check_framing,
    end_message,
    framed,
    json_bytes,
    with_dropped,
)
from phytac_shapes.errors import InputError, OutputError, PhytacError


@dataclass(frozen=True, kw_only=True)
class ClientLimits:
    """Limits on clients.

    Attributes
    ----------
    clients : int
        At once.
    queue, serial_queue : int
        Messages that may wait for a client, and for a serial port, which is slow: what waits for
        it must be fresh. Beyond that the oldest are dropped.
    patience_s : float
        A client that takes nothing for this long is closed.
    received_bytes : int
        Clients send commands alone; one that sends more than this in all is closed.
    send_buffer_bytes : int
        Of the system, for each client: half a second at 480 fps.
    hello_again_s : float
        A serial port repeats its hello: nobody knows when someone begins to listen.
    drain_s : float
        At the end, clients that read have this long to take what waits.
    reports_per_s : int
        A flood of clients is no flood of reports.
    """

    clients: int = 64
    queue: int = 256
    serial_queue: int = 2
    patience_s: float = 10.0
    received_bytes: int = 65536
    send_buffer_bytes: int = 1 << 17
    hello_again_s: float = 5.0
    drain_s: float = 2.0
    reports_per_s: int = 20


class Receiver(asyncio.Protocol):
    """A client or serial port behind a bounded queue, from which the oldest message is dropped.

    A message of which a part is sent is always finished, so the stream stays readable.

    Parameters
    ----------
    server : StreamServer
        To which it belongs.
    serial : SerialPort or None
        The port; None for a client.
    """

    def __init__(self, server: "StreamServer", serial: SerialPort | None = None) -> None:
        self.serial, self.dropped = serial, 0
        self._server, self._limits = server, server.limits
        self._framing = "lines" if serial else server.framing
        self._queue = self._limits.serial_queue if serial else self._limits.queue
        self._received_bytes, self._full = 0, False
        self.reported_ignored = False
        self._commands: MessageSplitter | None = MessageSplitter(self._framing)
        self._waiting: deque[bytes] = deque()
        self._urgent: bytes | None = None
        self._rest_bytes, self._moved_s = 0, time.monotonic()

    def connection_made(self, transport: Any) -> None:
        """Send the hello; turn a client away if there are too many."""
        self.transport = transport
        # Whatever the system does not take at once is too much.
        transport.set_write_buffer_limits(high=0)
        if self.serial:
            self.name = f"serial port {self.serial.name}"
        else:
            host, port, *_ = transport.get_extra_info("peername") or ("that has gone", 0)
            self.name = f"client {host}:{port}"
            with contextlib.suppress(OSError):
                link = transport.get_extra_info("socket")
                link.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._limits.send_buffer_bytes)
        self._server.join(self)

    def pause_writing(self) -> None:
        """Wait: the system takes no more."""
        self._full = True

    def resume_writing(self) -> None:
        """Send what waits."""
        self._full = False
        self.flush()

    def data_received(self, data: bytes) -> None:
        """Take a client's commands; what is no message is counted alone."""
        self._received_bytes += len(data)
        if self._received_bytes > self._limits.received_bytes:
            self._server.remove(self, "sends data, and has nothing to say here")
            return
        # A line that is no message does not spoil the next ones.
        parts = data.splitlines(keepends=True) if self._framing == "lines" else [data]
        for part in parts:
            if self._commands is None:
                return
            try:
                for message in self._commands.feed(part):
                    self._server.command(self, message["type"])
            except InputError as error:
                self._server.ignore(self, str(error))
                if self._framing != "lines":
                    self._commands = None

    def eof_received(self) -> bool:
        """Stay: a client may close its own half and continue to listen."""
        return True

    def connection_lost(self, exc: Exception | None) -> None:
        """Leave the server."""
        self._server.remove(self, f"is gone ({getattr(exc, 'strerror', None) or exc})")

    @property
    def idle(self) -> bool:
        """Whether everything is sent."""
        return not (self._full or self._waiting or self._urgent)

    def stalled(self, now_s: float) -> bool:
        """Whether it has taken nothing for too long."""
        rest_bytes = self.transport.get_write_buffer_size()
        if rest_bytes != self._rest_bytes or not rest_bytes:
            self._rest_bytes, self._moved_s = rest_bytes, now_s
        return not self.serial and now_s - self._moved_s > self._limits.patience_s

    def put(self, text: bytes, *, urgent: bool = False) -> None:
        """Send a message's JSON, or queue it; an urgent one goes first and drops none."""
        if urgent:
            self._urgent = text
        else:
            if len(self._waiting) >= self._queue:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(text)
        self.flush()

    def flush(self) -> None:
        """Send what the system takes."""
        while not self._full and (self._waiting or self._urgent):
            text, self._urgent = self._urgent or self._waiting.popleft(), None
            self.transport.write(framed(with_dropped(text, self.dropped), self._framing))


class StreamServer:
    """Sends the same messages to all receivers, from a thread of its own.

    :meth:`publish` costs the sensor one JSON text and a short lock, whatever clients do.

    Parameters
    ----------
    hello : dict
        First message to every client.
    host, port : str, int
        Where it listens; port 0 takes a free one.
    framing : str
        One of :data:`phytac_decoder.serving.wire_protocol.FRAMINGS`.
    serial : SerialPort, optional
        Also sent there, as JSON lines.
    serial_hello : dict, optional
        Hello of the serial port, if another.
    limits : ClientLimits
        See there.
    tare : callable
        Called, from the server's thread, when a client asks for a new rest frame.
    report : callable
        Called with who connects and leaves, from the server's thread.

    Raises
    ------
    OutputError
        If the port is taken.
    """

    def __init__(
        self,
        hello: Message,
        *,
        host: str = "127.0.0.1",
        port: int = 5757,
        framing: str = "lines",
        serial: SerialPort | None = None,
        serial_hello: Message | None = None,
        limits: ClientLimits | None = None,
        tare: Callable[[], None] = lambda: None,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        check_framing(framing)
        self.framing, self.limits = framing, limits or ClientLimits()
        self._hello, self._serial_hello = json_bytes(hello), json_bytes(serial_hello or hello)
        self._serial, self._report, self._tare = serial, report, tare
        self._reported: deque[float] = deque(maxlen=self.limits.reports_per_s)
        self._receivers: list[Receiver] = []
        self._inbox: list[bytes] = []
        self._lock = threading.Lock()
        self._arrival = threading.Event()
        self._failed: BaseException | None = None
        self._lost, self._gone_dropped = 0, 0
        self._listener = _listen(host, port)
        self.host, self.port = self._listener.getsockname()[:2]
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(self._on_exception)
        self._stopping = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: object
    ) -> None:
        if isinstance(error, PhytacError):
            self.close(str(error), error.code)
        else:
            self.close("the source has ended" if error is None else "stopped")

    @property
    def clients(self) -> int:
        """Number of clients now, without the serial port."""
        return sum(receiver.serial is None for receiver in list(self._receivers))

    @property
    def dropped(self) -> int:
        """Messages so far that were not sent to a receiver because it read too slowly."""
        return self._gone_dropped + sum(each.dropped for each in list(self._receivers))

    def publish(self, message: Message) -> None:
        """Send a message to all; returns at once.

        Raises
        ------
        InputError
            If it holds a number that is not finite.
        OutputError
            If the server has failed.
        """
        if self._failed is not None:
            raise OutputError(
                "server-stopped", f"the server has stopped: {self._failed}"
            ) from self._failed
        text = json_bytes(message)
        with self._lock:
            if len(self._inbox) >= self.limits.queue:
                del self._inbox[0]
                self._lost += 1
            self._inbox.append(text)
            first = len(self._inbox) == 1
        if first:
            self._call(self._hand_out)

    def wait_for_client(self, timeout_s: float | None = None) -> bool:
        """Wait until a client has connected; whether one has."""
        return self._arrival.wait(timeout_s)

    def close(self, reason: str = "stopped", code: str = "") -> None:
        """Send clients the end, its reason and an error's code; close all. May be called twice."""
        if self._thread.is_alive() and not self._stopping.is_set():
            with contextlib.suppress(OutputError):
                self.publish(end_message(reason, code))
            self._call(self._stopping.set)
        self._thread.join(timeout=2.0 * self.limits.drain_s)

    def join(self, receiver: Receiver) -> None:
        """Begin to send to a receiver, in the server's thread."""
        most = self.limits.clients
        if not receiver.serial and self.clients >= most:
            receiver.put(json_bytes(end_message(f"{most} clients listen already")))
            receiver.transport.close()
            self._log(f"{receiver.name} turned away: {most} listen already")
            return
        self._receivers.append(receiver)
        receiver.put(self._serial_hello if receiver.serial else self._hello, urgent=True)
        if not receiver.serial:
            self._log(f"{receiver.name} listens")
            self._arrival.set()

    def remove(self, receiver: Receiver, reason: str) -> None:
        """Close a receiver, in the server's thread."""
        if receiver in self._receivers:
            self._receivers.remove(receiver)
            self._gone_dropped += receiver.dropped
            receiver.transport.abort()
            if not self._stopping.is_set():
                self._log(f"{receiver.name} {reason}; closed")

    def ignore(self, receiver: Receiver, reason: str) -> None:
        """Report, once for each receiver, that what it sends is no message."""
        if not receiver.reported_ignored:
            receiver.reported_ignored = True
            self._log(f"{receiver.name} sends what is ignored: {reason}")

    def command(self, receiver: Receiver, name: str) -> None:
        """Do what a receiver asks for, in the server's thread; unknown commands are ignored."""
        if name == "tare":
            self._log(f"{receiver.name} asks for a new rest frame")
            self._tare()

    def _call(self, function: Callable[[], None]) -> None:
        """Call in the server's thread; after its end nothing has to be done."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(function)

    def _log(self, text: str) -> None:
        """Report, but limit a flood."""
        now = time.monotonic()
        if len(self._reported) == self.limits.reports_per_s and now - self._reported[0] < 1.0:
            return
        self._reported.append(now)
        # Whoever reads reports may have gone.
        with contextlib.suppress(OSError, ValueError):
            self._report(text)

    def _on_exception(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if isinstance(error, OSError):  # no file handle is left for a client, for instance
            self._log(f"{context['message']} ({error.strerror})")
        else:  # raised by the next publish
            self._failed = error or RuntimeError(context["message"])
            self._stopping.set()

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        except Exception as error:  # noqa: BLE001 - raised by the next publish
            self._failed = error
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        loop, limits = self._loop, self.limits
        server = await loop.create_server(lambda: Receiver(self), sock=self._listener)
        if self._serial:
            await loop.connect_write_pipe(lambda: Receiver(self, self._serial), self._serial)
        hello_s = time.monotonic()
        while not self._stopping.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), min(0.25, limits.hello_again_s))
            now = time.monotonic()
            for receiver in [each for each in self._receivers if each.stalled(now)]:
                lost = f"{receiver.dropped} messages dropped"
                self.remove(receiver, f"took nothing for {limits.patience_s:g} s, {lost}")
            if now - hello_s >= limits.hello_again_s:
                hello_s = now
                for receiver in [each for each in self._receivers if each.serial]:
                    receiver.put(self._serial_hello, urgent=True)
        server.close()
        end_s = time.monotonic() + limits.drain_s
        for receiver in list(self._receivers):
            while not receiver.idle and time.monotonic() < end_s:  # noqa: ASYNC110 - rare
                await asyncio.sleep(0.005)
        for receiver in self._receivers:
            if receiver.idle:
                receiver.transport.close()
            else:
                receiver.transport.abort()
        # The loop closes them in its next rounds.
        await asyncio.sleep(0.01)

    def _hand_out(self) -> None:
        """Send all that has been published to all receivers."""
        with self._lock:
            texts, self._inbox = self._inbox, []
            lost, self._lost = self._lost, 0
        for receiver in list(self._receivers):
            receiver.dropped += lost
            for text in texts:
                receiver.put(text)


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket.

    Raises
    ------
    OutputError
        If the address is not this machine's, or the port is taken.
    """
    try:
        family, kind, number, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, number)
    except (OSError, OverflowError, UnicodeError) as error:
        raise OutputError(
            "port-unavailable", f"cannot listen at {host!r}, port {port} ({error})"
        ) from None
    try:
        # Only lets a port be taken again at once after its last owner has gone.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(64)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            "port-unavailable",
            f"cannot listen at {host}, port {port} ({reason}); give another --port, or stop the "
            "program that uses it",
        ) from None
    return listener
