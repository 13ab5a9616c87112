"""The server: everyone gets everything, whoever stalls, floods, leaves or connects."""

import os
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from phytac_decoder.io.serial_port import SerialPort
from phytac_decoder.serving.force_server import ClientLimits, StreamServer
from phytac_decoder.serving.wire_protocol import Message, MessageSplitter
from phytac_shapes.errors import InputError
from tests.refusals import refused

HELLO = {"type": "hello", "name": "x" * 3000}
BULK = "x" * 20000
PATIENCE_S = 30.0
"""Far beyond what anything here takes; tests fail by it instead of hanging."""


def wait_until(done: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < until, "it never happened"
        time.sleep(0.002)


class Client:
    """Reads in a thread of its own until the server closes, or its first message alone."""

    def __init__(self, server: StreamServer, framing: str = "lines", *, read: bool = True) -> None:
        self.socket = socket.socket()
        self.socket.settimeout(PATIENCE_S)
        if not read:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.socket.connect((server.host, server.port))
        self._splitter = MessageSplitter(framing)
        self.got: list[Message] = []
        while not self.got:
            self._take()
        self._thread = threading.Thread(target=self._read, daemon=True)
        if read:
            self._thread.start()

    def _take(self) -> bool:
        data = self.socket.recv(65536 if self.got else 4)
        self.got += self._splitter.feed(data)
        return bool(data)

    def _read(self) -> None:
        try:
            while self._take():
                pass
        except OSError:
            pass

    def all(self) -> list[Message]:
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        self.socket.close()
        return self.got


def numbered(count: int, bulk: str = "") -> list[Message]:
    return [{"type": "frame", "sequence": number, "bulk": bulk} for number in range(count)]


def sequences(messages: list[Message]) -> list[int]:
    return [message["sequence"] for message in messages if message["type"] == "frame"]


@pytest.mark.parametrize("framing", ["lines", "length"])
def test_all_get_all_in_order_between_hello_and_end(framing: str) -> None:
    with StreamServer(HELLO, port=0, framing=framing) as server:
        assert server.host == "127.0.0.1"
        clients = [Client(server, framing) for _ in range(3)]
        assert server.clients == 3
        for message in numbered(200):
            server.publish(message)
            time.sleep(0.0002)
    for client in clients:
        hello, *frames, end = client.all()
        assert hello == HELLO | {"dropped": 0}
        assert frames == [message | {"dropped": 0} for message in numbered(200)]
        assert end["type"] == "end"
        assert end["reason"] == "the source has ended"
    assert server.dropped == 0


def test_one_of_ten_that_stalls_costs_the_others_nothing_and_is_closed() -> None:
    reported: list[str] = []
    # A reader may lag by 40 messages of 8 ms, but not by as long as the stalled one is waited for.
    limits = ClientLimits(queue=40, patience_s=1.2)
    with StreamServer(HELLO, port=0, limits=limits, report=reported.append) as server:
        clients = [Client(server) for _ in range(9)]
        stalled = Client(server, read=False)
        longest = 0.0
        sent = 0
        until = time.monotonic() + PATIENCE_S
        while server.clients == 10:
            assert time.monotonic() < until
            begun = time.thread_time()
            server.publish({"type": "frame", "sequence": sent, "bulk": BULK})
            longest = max(longest, time.thread_time() - begun)
            sent += 1
            time.sleep(0.008)
        server.publish({"type": "frame", "sequence": sent, "bulk": BULK})
    for client in clients:
        got = client.all()
        assert sequences(got) == list(range(sent + 1))
        assert got[-1]["dropped"] == 0
    assert longest < 0.05
    assert server.dropped > 40
    stalled.socket.close()
    (line,) = [text for text in reported if "took nothing for 1.2 s" in text]
    assert line.endswith(f", {server.dropped} messages dropped; closed")


def test_a_slow_client_gets_the_newest_messages_and_the_number_dropped() -> None:
    with StreamServer(
        HELLO, port=0, limits=ClientLimits(queue=10, patience_s=PATIENCE_S)
    ) as server:
        slow, quick = Client(server, read=False), Client(server)
        # More than the system's buffers hold.
        for message in numbered(400, BULK):
            server.publish(message)
            if message["sequence"] % 8 == 7:
                number = message["sequence"]
                wait_until(lambda n=number: n in sequences(quick.got[-1:]))
        slow._thread.start()
    got = slow.all()
    numbers = sequences(got)
    assert numbers == sorted(set(numbers))
    assert numbers[-9:] == list(range(391, 400))
    lost = 400 - len(numbers)
    assert lost > 100
    assert got[-1]["dropped"] == server.dropped
    # The end took a place in the queue as well.
    assert got[-1]["dropped"] == lost
    # Each says how many had gone when it went out: those are the gaps so far.
    frames = [message for message in got if message["type"] == "frame"]
    for message, place in zip(frames, range(len(frames)), strict=True):
        assert message["dropped"] >= message["sequence"] - place
    assert sequences(quick.all()) == list(range(400))


def test_clients_come_and_go() -> None:
    with StreamServer(HELLO, port=0) as server:
        first = Client(server)
        server.publish(numbered(1)[0])
        wait_until(lambda: sequences(first.got) == [0])
        first.socket.shutdown(socket.SHUT_RDWR)
        first.socket.close()
        second = Client(server)
        number = 1
        while server.clients > 1:
            server.publish({"type": "frame", "sequence": number})
            number += 1
            time.sleep(0.01)
            assert number < 500
    assert sequences(second.all()) == list(range(1, number))


def flood(into: socket.socket) -> None:
    for _ in range(5000):
        into.sendall(b"A" * 4096)
        time.sleep(0.001)


def test_hostile_clients_do_no_harm() -> None:
    reported: list[str] = []
    limits = ClientLimits(clients=6, received_bytes=10000)
    with StreamServer(HELLO, port=0, limits=limits, report=reported.append) as server:
        address = (server.host, server.port)
        good = Client(server)
        # Numbers that are none, and an endless line.
        flooding = Client(server)
        flooding.socket.sendall(b'{"type":"frame","x":NaN,"y":1e999}\n\xff\x00')
        with pytest.raises(OSError, match=r"pipe|reset"):
            flood(flooding.socket)
        flooding.socket.close()
        # Reset at once; the last has heard that it and those before have been let in.
        for number in range(31):
            rude = (
                socket.create_connection(address)
                if number < 30
                else Client(server, read=False).socket
            )
            rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            rude.close()
        wait_until(lambda: server.clients == 1)
        # Its own half closed: it continues to listen.
        half = Client(server)
        half.socket.shutdown(socket.SHUT_WR)
        many = [Client(server) for _ in range(4)]
        refused = socket.create_connection(address, timeout=PATIENCE_S)
        with refused.makefile("rb") as lines:
            (line,) = lines.readlines()
        assert b"6 clients listen already" in line
        refused.close()
        for message in numbered(50):
            server.publish(message)
            time.sleep(0.0005)
    for client in (good, half, *many):
        assert sequences(client.all()) == list(range(50))
    assert any("has nothing to say here" in text for text in reported)
    # A flood of clients is no flood of reports.
    assert len(reported) < 40


def test_a_port_in_use_is_one_clear_error() -> None:
    with StreamServer(HELLO, port=0) as server:
        client = Client(server)
        words = rf"cannot listen at 127.0.0.1, port {server.port} \(Address already in use\); give"
        with refused("port-unavailable") as caught:
            StreamServer(HELLO, port=server.port)
        caught.match(words)
    client.all()
    # And free again at once, though its last connections are not forgotten yet.
    StreamServer(HELLO, port=server.port).close()
    with refused("port-unavailable"):
        StreamServer(HELLO, host="no.such.host.invalid", port=0)


def test_it_stops_cleanly_though_someone_stalls() -> None:
    threads = threading.active_count()
    server = StreamServer(HELLO, port=0, limits=ClientLimits(queue=5))
    stalled = Client(server, read=False)
    for message in numbered(100, BULK):
        server.publish(message)
        time.sleep(0.001)
    begun = time.monotonic()
    server.close()
    server.close()
    assert time.monotonic() - begun < 3.5
    assert threading.active_count() == threads
    stalled.socket.close()


def test_what_is_published_last_is_not_lost() -> None:
    for _ in range(50):
        server = StreamServer(HELLO, port=0)
        client = Client(server)
        server.publish(numbered(1)[0])
        server.close("late")
        assert sequences(client.all()) == [0]
        assert client.got[-1]["reason"] == "late"


@pytest.mark.parametrize(
    ("error", "end"),
    [
        (
            InputError("camera-silent", "camera 3 has given no frame"),
            {"reason": "camera 3 has given no frame", "code": "camera-silent"},
        ),
        (KeyboardInterrupt(), {"reason": "stopped"}),
    ],
)
def test_clients_get_the_reason_of_the_end(error: BaseException, end: dict[str, str]) -> None:
    server = StreamServer(HELLO, port=0)
    client = Client(server)
    with pytest.raises(type(error)), server:
        raise error
    assert client.all()[-1] == {"type": "end", **end, "dropped": 0}


def test_numbers_that_are_not_finite_are_rejected() -> None:
    with StreamServer(HELLO, port=0) as server, refused("message-not-finite"):
        server.publish({"type": "frame", "total_N": float("nan")})


def test_a_serial_port_gets_fresh_json_lines() -> None:
    master, slave = os.openpty()
    port = SerialPort(Path(os.ttyname(slave)), baud=115200)
    os.set_blocking(master, False)
    hello = {"type": "hello", "name": "short"}
    with StreamServer(HELLO, port=0, serial=port, serial_hello=hello) as server:
        splitter, got = MessageSplitter("lines"), []

        def read() -> None:
            try:
                got.extend(splitter.feed(os.read(master, 4096)))
            except BlockingIOError:
                time.sleep(0.001)

        wait_until(lambda: bool(read() or got))
        assert got == [hello | {"dropped": 0}]
        # Nobody reads: the port's buffer fills, and what waits is the newest.
        for message in numbered(300, "x" * 1000):
            server.publish(message)
            time.sleep(0.0005)
        os.write(master, b"anything at all\n")
        assert server.clients == 0
        wait_until(lambda: bool(read() or sequences(got)[-1:] == [299]))
        numbers = sequences(got)
        assert numbers == sorted(set(numbers))
        assert len(numbers) < 100
        assert got[-1]["dropped"] == 300 - len(numbers)
    os.close(slave)
    os.close(master)


def test_invalid_serial_ports_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with refused("serial-not-a-port"):
        SerialPort(tmp_path / "file")
    with refused("serial-not-opened"):
        SerialPort(tmp_path / "none")
    with refused("serial-baud-rate"):
        SerialPort(tmp_path / "file", baud=115201)
