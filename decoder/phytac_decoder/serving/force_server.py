"""A server of forces over TCP and a serial port, whose receivers cannot slow the sensor."""

import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from phytac_decoder.io.serial_port import SerialPort
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
TIMEOUT_S = 0.25
"""The server looks at least this often for stalled clients."""
DRAIN_S = 2.0
"""At the end, clients that read have this long to take what waits."""
HELLO_AGAIN_S = 5.0
"""A serial port repeats its hello: nobody knows when someone begins to listen."""
SERIAL_QUEUE = 2
"""A serial port is slow: what waits for it must be fresh."""
REPORTS_MAX = 20
"""Reports per second."""
SEND_BUFFER_BYTES = 1 << 17
"""Of the system, for each client: half a second at 480 fps."""


@dataclass(frozen=True, kw_only=True)
class ClientLimits:
    """Limits on clients.

    Attributes
    ----------
    clients : int
        At once.
    queue : int
        Messages that may wait for a client; beyond that the oldest are dropped.
    patience_s : float
        A client that takes nothing for this long is closed.
    received_bytes : int
        Clients have nothing to send; one that sends more than this is closed.
    """

    clients: int = 64
    queue: int = 256
    patience_s: float = 10.0
    received_bytes: int = 65536


class Receiver:
    """A client or serial port behind a bounded queue, from which the oldest message is dropped.

    A message of which a part is sent is always finished, so the stream stays readable.

    Parameters
    ----------
    handle : socket or SerialPort
        Where bytes go without ever blocking.
    name : str
        Of the receiver, for people.
    framing : str
        One of :data:`phytac_decoder.serving.wire_protocol.FRAMINGS`.
    hello : bytes
        JSON of the first message.
    queue : int
        Messages that may wait.
    patience_s : float or None
        Stalled if it takes nothing for this long while something waits; never if None.
    """

    def __init__(
        self,
        handle: socket.socket | SerialPort,
        name: str,
        *,
        framing: str,
        hello: bytes,
        queue: int,
        patience_s: float | None,
    ) -> None:
        self.handle, self.name = handle, name
        self.received_bytes, self.dropped, self.ended = 0, 0, False
        self._framing, self._queue, self._patience_s = framing, queue, patience_s
        self._waiting: deque[bytes] = deque()
        self._urgent: bytes | None = hello
        self._going = memoryview(b"")
        self._moved_s = time.monotonic()

    @property
    def idle(self) -> bool:
        """Whether everything is sent."""
        return not self._going and not self._waiting and self._urgent is None

    @property
    def stalled(self) -> bool:
        """Whether it has taken nothing for too long."""
        if self._patience_s is None or self.idle:
            return False
        return time.monotonic() - self._moved_s > self._patience_s

    def put(self, text: bytes, *, urgent: bool = False) -> None:
        """Queue a message's JSON; an urgent one goes before all others and drops none."""
        if self.idle:
            self._moved_s = time.monotonic()
        if urgent:
            self._urgent = text
            return
        if len(self._waiting) >= self._queue:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(text)

    def flush(self) -> None:
        """Send what can be sent without waiting; raises OSError if the receiver is gone."""
        while not self.idle:
            if not self._going:
                text = self._urgent or self._waiting.popleft()
                self._urgent = None
                self._going = memoryview(framed(with_dropped(text, self.dropped), self._framing))
            try:
                sent = self.handle.send(self._going)
            except (BlockingIOError, InterruptedError):
                return
            self._going = self._going[sent:]
            self._moved_s = time.monotonic()


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
    limits : Limits
        See there.
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
        self._reported: deque[float] = deque(maxlen=REPORTS_MAX)
        self._limits = limits or ClientLimits()
        self._receivers: list[Receiver] = []
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
        self._serial: Receiver | None = None
        self._serial_hello = json_bytes(serial_hello or hello)
        if serial is not None:
            self._serial = Receiver(
                serial,
                f"serial port {serial.name}",
                framing="lines",
                hello=self._serial_hello,
                queue=SERIAL_QUEUE,
                patience_s=None,
            )
            self._receivers.append(self._serial)
            self._watch(self._serial)
        self._thread = threading.Thread(target=self._run, name="server", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: object
    ) -> None:
        reason = "the source has ended" if error is None else "stopped"
        self.close(str(error) if isinstance(error, PhytacError) else reason)

    @property
    def clients(self) -> int:
        """Number of clients now, without the serial port."""
        return sum(receiver is not self._serial for receiver in list(self._receivers))

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
            raise OutputError(f"the server has stopped: {self._failed}") from self._failed
        text = json_bytes(message)
        with self._lock:
            if len(self._inbox) >= self._limits.queue:
                self._inbox.popleft()
                self._lost += 1
            self._inbox.append(text)
        self._wake()

    def wait_for_client(self, timeout_s: float | None = None) -> bool:
        """Wait until a client has connected; whether one has."""
        return self._arrival.wait(timeout_s)

    def close(self, reason: str = "stopped") -> None:
        """Send clients the end and its reason, and close all. May be called twice."""
        if not self._stopping.is_set():
            with contextlib.suppress(OutputError):
                self.publish(end_message(reason))
            self._stopping.set()
            self._wake()
        self._thread.join(timeout=2.0 * DRAIN_S)

    def _log(self, text: str) -> None:
        """Report, but limit a flood."""
        now = time.monotonic()
        if len(self._reported) == REPORTS_MAX and now - self._reported[0] < 1.0:
            return
        self._reported.append(now)
        # Whoever reads reports may have gone.
        with contextlib.suppress(OSError, ValueError):
            self._report(text)

    def _wake(self) -> None:
        # A full pipe wakes it as well; after the end nobody has to be woken.
        with contextlib.suppress(OSError):
            self._wake_out.send(b"\0")

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:  # noqa: BLE001 - raised by the next publish
            self._failed = error
        finally:
            for receiver in list(self._receivers):
                self._remove(receiver)
            for handle in (self._listener, self._wake_in, self._wake_out, self._selector):
                handle.close()

    def _serve(self) -> None:
        hello_s = time.monotonic()
        deadline = None
        while True:
            for key, mask in self._selector.select(TIMEOUT_S):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj is self._wake_in:
                    self._wake_in.recv(65536)
                elif key.data in self._receivers:
                    self._attend(key.data, readable=bool(mask & selectors.EVENT_READ))
            now = time.monotonic()
            if self._serial and now - hello_s > HELLO_AGAIN_S:
                self._serial.put(self._serial_hello, urgent=True)
                hello_s = now
            # Read before: what is published before the end is handed out before it.
            stopping = self._stopping.is_set()
            self._hand_out()
            for receiver in [each for each in self._receivers if each.stalled]:
                patience = f"took nothing for {self._limits.patience_s:g} s"
                self._remove(receiver, f"{patience}, {receiver.dropped} messages dropped")
            if stopping:
                deadline = deadline or now + DRAIN_S
                if now > deadline or all(receiver.idle for receiver in self._receivers):
                    return

    def _hand_out(self) -> None:
        """Send all that has been published to all receivers."""
        with self._lock:
            texts = list(self._inbox)
            self._inbox.clear()
            lost, self._lost = self._lost, 0
        for receiver in list(self._receivers):
            receiver.dropped += lost
            for text in texts:
                receiver.put(text)
            self._attend(receiver, readable=False)

    def _attend(self, receiver: Receiver, *, readable: bool) -> None:
        """Take what a receiver sent, and send it what it can take."""
        try:
            if readable:
                with contextlib.suppress(BlockingIOError, InterruptedError):
                    data = receiver.handle.recv(4096)
                    receiver.received_bytes += len(data)
                    # A client may close its own half and continue to listen.
                    receiver.ended = not data
            if receiver.received_bytes > self._limits.received_bytes and (
                receiver is not self._serial
            ):
                self._remove(receiver, "sends data, and has nothing to say here")
                return
            receiver.flush()
        except OSError as error:
            self._remove(receiver, f"is gone ({error.strerror})")
        else:
            self._watch(receiver)

    def _watch(self, receiver: Receiver) -> None:
        """Wait for what can happen to a receiver."""
        wanted = 0 if receiver.ended else selectors.EVENT_READ
        if not receiver.idle:
            wanted |= selectors.EVENT_WRITE
        key = self._selector.get_map().get(receiver.handle.fileno())
        if key and key.events != wanted:
            self._selector.unregister(receiver.handle)
        if wanted and not (key and key.events == wanted):
            self._selector.register(receiver.handle, wanted, receiver)

    def _accept(self) -> None:
        try:
            client, address = self._listener.accept()
        except OSError as error:
            # It has left again already, or no file handle is left for it.
            if not isinstance(error, BlockingIOError | ConnectionError):
                self._log(f"a client could not be let in ({error.strerror})")
                time.sleep(0.01)
            return
        name = f"client {address[0]}:{address[1]}"
        client.setblocking(False)
        with contextlib.suppress(OSError):
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        most = self._limits.clients
        if self.clients >= most:
            refusal = json_bytes(end_message(f"{most} clients listen already"))
            with contextlib.suppress(OSError):
                client.send(framed(with_dropped(refusal, 0), self._framing))
            client.close()
            self._log(f"{name} turned away: {most} listen already")
            return
        receiver = Receiver(
            client,
            name,
            framing=self._framing,
            hello=self._hello,
            queue=self._limits.queue,
            patience_s=self._limits.patience_s,
        )
        self._receivers.append(receiver)
        self._log(f"{name} listens")
        self._attend(receiver, readable=False)
        self._arrival.set()

    def _remove(self, receiver: Receiver, reason: str = "") -> None:
        self._receivers.remove(receiver)
        self._gone_dropped += receiver.dropped
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(receiver.handle)
        with contextlib.suppress(OSError):
            receiver.handle.close()
        if reason:
            self._log(f"{receiver.name} {reason}; closed")


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
