"""A server of forces over TCP (and a serial port) that no receiver can slow."""

import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from phytac_decoder.io.serial_port import SerialPort
from phytac_decoder.serving.client_queue import Outlet
from phytac_decoder.serving.wire_protocol import (
    Message,
    check_framing,
    end_message,
    framed,
    json_bytes,
    with_dropped,
)
from phytac_shapes.errors import OutputError, PhytacError

PORT = 5757
LOOPBACK = "127.0.0.1"
TURN_S = 0.25
"""The server looks at least this often for stalled clients."""
DRAIN_S = 2.0
"""At the end, clients that read have this long to take what waits."""
HELLO_AGAIN_S = 5.0
"""A serial port says hello again: nobody knows when someone begins to listen."""
SERIAL_QUEUE = 2
"""A serial port is slow: what waits for it must be fresh."""
TOLD_MAX = 20
"""Reports a second."""
SEND_BUFFER_BYTES = 1 << 17
"""Of the system, for each client: half a second at 480 fps."""


@dataclass(frozen=True, kw_only=True)
class ClientLimits:
    """What the server puts up with.

    Attributes
    ----------
    clients : int
        At once.
    queue : int
        Messages that may wait for a client; then the oldest go.
    patience_s : float
        A client that takes nothing for this long is closed.
    received_bytes : int
        Clients have nothing to say; one that sends more than this is closed.
    """

    clients: int = 64
    queue: int = 256
    patience_s: float = 10.0
    received_bytes: int = 65536


class StreamServer:
    """Sends the same messages to all who listen, from a thread of its own.

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
    limits : Limits
        See there.
    report : callable
        Told who comes and goes; called from the server's thread.

    Raises
    ------
    OutputError
        If the port is taken.
    """

    def __init__(
        self,
        hello: Message,
        *,
        host: str = LOOPBACK,
        port: int = PORT,
        framing: str = "lines",
        serial: SerialPort | None = None,
        serial_hello: Message | None = None,
        limits: ClientLimits | None = None,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        check_framing(framing)
        self._hello = json_bytes(hello)
        self._framing, self._report = framing, report
        self._told: deque[float] = deque(maxlen=TOLD_MAX)
        self._limits = limits or ClientLimits()
        self._outlets: list[Outlet] = []
        self._inbox: deque[bytes] = deque()
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._arrival = threading.Event()
        self._failed: BaseException | None = None
        self._lost = 0
        self._gone_dropped = 0
        self._listener = _listen(host, port)
        self.host, self.port = self._listener.getsockname()[:2]
        self._wake_in, self._wake_out = socket.socketpair()
        for handle in (self._listener, self._wake_in, self._wake_out):
            handle.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._wake_in, selectors.EVENT_READ)
        self._serial: Outlet | None = None
        self._serial_hello = json_bytes(serial_hello or hello)
        if serial is not None:
            self._serial = Outlet(
                serial,
                f"serial port {serial.name}",
                framing="lines",
                first=self._serial_hello,
                queue=SERIAL_QUEUE,
                patience_s=None,
            )
            self._add(self._serial)
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        reason = "the source has ended" if error is None else "stopped"
        self.close(str(error) if isinstance(error, PhytacError) else reason)

    @property
    def clients(self) -> int:
        """How many listen now, without the serial port."""
        return sum(outlet is not self._serial for outlet in list(self._outlets))

    @property
    def dropped(self) -> int:
        """Messages so far that some receiver was not sent because it read too slowly."""
        return self._gone_dropped + sum(outlet.dropped for outlet in list(self._outlets))

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
            raise OutputError(f"the server has stopped: {self._failed}") from self._failed
        text = json_bytes(message)
        with self._lock:
            if len(self._inbox) >= self._limits.queue:
                self._inbox.popleft()
                self._lost += 1
            self._inbox.append(text)
        self._wake()

    def wait_for_client(self, timeout_s: float | None = None) -> bool:
        """Wait until someone has come; whether one has."""
        return self._arrival.wait(timeout_s)

    def close(self, reason: str = "stopped") -> None:
        """Tell clients that this is the end, and why; close all. May be called twice."""
        if not self._stopping.is_set():
            with contextlib.suppress(OutputError):
                self.publish(end_message(reason))
            self._stopping.set()
            self._wake()
        self._thread.join(timeout=2.0 * DRAIN_S)

    def _tell(self, text: str) -> None:
        """Report, but not all of a flood."""
        now = time.monotonic()
        if len(self._told) == TOLD_MAX and now - self._told[0] < 1.0:
            return
        self._told.append(now)
        # Whoever reads reports may have gone.
        with contextlib.suppress(OSError, ValueError):
            self._report(text)

    def _wake(self) -> None:
        # A full pipe wakes it as well; a closed one has nobody to wake.
        with contextlib.suppress(OSError):
            self._wake_out.send(b"\0")

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:  # noqa: BLE001 - told by the next publish
            self._failed = error
        finally:
            for outlet in list(self._outlets):
                self._remove(outlet)
            for handle in (self._listener, self._wake_in, self._wake_out, self._selector):
                handle.close()

    def _serve(self) -> None:
        hello_s = time.monotonic()
        deadline = None
        while True:
            for key, mask in self._selector.select(TURN_S):
                if key.data is not None:
                    self._attend(key.data, mask)
                elif key.fileobj is self._listener:
                    self._accept()
                else:
                    self._wake_in.recv(65536)
            now = time.monotonic()
            if self._serial and now - hello_s > HELLO_AGAIN_S:
                self._serial.next(self._serial_hello)
                hello_s = now
            # Asked before: what is published before the end is handed out before it.
            stopping = self._stopping.is_set()
            self._hand_out()
            for outlet in [each for each in self._outlets if each.stalled]:
                self._remove(
                    outlet,
                    f"took nothing for {self._limits.patience_s:g} s, {outlet.dropped} messages "
                    "dropped",
                )
            if stopping:
                deadline = deadline or now + DRAIN_S
                if now > deadline or all(outlet.idle for outlet in self._outlets):
                    return

    def _hand_out(self) -> None:
        """What has been published, to all."""
        with self._lock:
            texts = list(self._inbox)
            self._inbox.clear()
            lost, self._lost = self._lost, 0
        for outlet in list(self._outlets):
            outlet.dropped += lost
            for text in texts:
                outlet.offer(text)
            self._flush(outlet)

    def _flush(self, outlet: Outlet) -> None:
        try:
            outlet.flush()
        except OSError as error:
            self._remove(outlet, f"is gone ({error.strerror})")
            return
        self._watch(outlet)

    def _watch(self, outlet: Outlet) -> None:
        wanted = 0 if outlet.ended else selectors.EVENT_READ
        if not outlet.idle:
            wanted |= selectors.EVENT_WRITE
        key = self._selector.get_map().get(outlet.handle.fileno())
        now = key.events if key else 0
        if wanted == now:
            return
        if not now:
            self._selector.register(outlet.handle, wanted, outlet)
        elif not wanted:
            self._selector.unregister(outlet.handle)
        else:
            self._selector.modify(outlet.handle, wanted, outlet)

    def _attend(self, outlet: Outlet, mask: int) -> None:
        if outlet not in self._outlets:
            return
        if mask & selectors.EVENT_READ:
            try:
                data = outlet.handle.recv(4096)
            except (BlockingIOError, InterruptedError):
                data = None
            except OSError as error:
                self._remove(outlet, f"is gone ({error.strerror})")
                return
            # A client may close its own half and go on listening.
            outlet.ended = data == b""
            outlet.received_bytes += len(data or b"")
            talks = outlet.received_bytes > self._limits.received_bytes
            if talks and outlet is not self._serial:
                self._remove(outlet, "sends data, and has nothing to say here")
                return
        self._flush(outlet)

    def _accept(self) -> None:
        try:
            client, address = self._listener.accept()
        except OSError as error:
            # Gone again already, or no file is left for it: the others go on.
            if not isinstance(error, BlockingIOError | ConnectionError):
                self._tell(f"a client could not be let in ({error.strerror})")
                time.sleep(0.01)
            return
        name = f"client {address[0]}:{address[1]}"
        client.setblocking(False)
        with contextlib.suppress(OSError):
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        if self.clients >= self._limits.clients:
            refusal = json_bytes(end_message(f"{self._limits.clients} clients listen already"))
            with contextlib.suppress(OSError):
                client.send(framed(with_dropped(refusal, 0), self._framing))
            client.close()
            self._tell(f"{name} turned away: {self._limits.clients} listen already")
            return
        outlet = Outlet(
            client,
            name,
            framing=self._framing,
            first=self._hello,
            queue=self._limits.queue,
            patience_s=self._limits.patience_s,
        )
        self._add(outlet)
        self._tell(f"{name} listens")
        self._flush(outlet)
        self._arrival.set()

    def _add(self, outlet: Outlet) -> None:
        self._outlets.append(outlet)
        self._watch(outlet)

    def _remove(self, outlet: Outlet, reason: str = "") -> None:
        if outlet not in self._outlets:
            return
        self._outlets.remove(outlet)
        self._gone_dropped += outlet.dropped
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(outlet.handle)
        with contextlib.suppress(OSError):
            outlet.handle.close()
        if reason:
            self._tell(f"{outlet.name} {reason}; closed")


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
        raise OutputError(f"cannot listen at {host!r}, port {port} ({error})") from None
    try:
        # Only lets a port be taken again at once after its last owner has gone.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(64)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"cannot listen at {host}, port {port} ({reason}); give another --port, or stop the "
            "program that uses it"
        ) from None
    return listener
