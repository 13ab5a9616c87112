"""The studio and the stream's server under clients that are malformed, hostile or slow."""

import http.client
import json
import random
import re
import signal
import socket
import statistics
import struct
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

from benchmarks.harness import Table
from benchmarks.page_faults_desk import Look, Run
from benchmarks.page_fuzz_change import changed, changed_table, json_text
from phytac_design.design.design_file import load_design

HERE = "127.0.0.1"
WAIT_S = 30.0
"""Three times the patience of either server."""
ANSWER_S = 2.0
"""A sound request is answered within, whatever others do; one core, shared with their threads."""
DEAF = 40
"""Answers of half a megabyte that are asked for on one line and not taken."""
SILENCE = 599
NO_HTTP = (
    b"\0" * 1000,
    b"GET / HTTP/9.9\r\n\r\n",
    b"A" * 100_000,
    b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: -1\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 20_000,
    b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\nZZZ\r\n",
)
ASKED: dict[str, dict[str, Any]] = {
    "open": {"name": "cone"},
    "text": {"source": "cylinder60"},
    "save": {"source": "cylinder60", "name": "a.toml"},
    "draft": {"source": "", "tab": "a", "side_px": 400},
    "study": {"folder": "studies/a"},
    "trial": {"folder": "studies/a", "trial": 3},
    "build/stop": {},
}
"""Sound bodies, which are spoilt; those with a source hold a design too."""
SPOILT, SPOILT_QUICK = 400, 60


class Studio:
    """A running `phytac studio` and one who asks it."""

    def __init__(self, folder: Path) -> None:
        words = ("studio", "cylinder60", "--no-browser")
        self._run = Run(*words, folder=folder, store=folder / "cache")
        assert self._run.until("http://")
        found = re.search(r"http://[^:/]+:(\d+)/([^/\s]+)/", self._run.said)
        assert found is not None
        self.port, self.token = int(found[1]), found[2]
        # Compiled loops are loaded with the first draft.
        self.warm = self.ask("api/draft", _draft(), wait_s=10.0 * WAIT_S)

    def ask(
        self, path: str, body: bytes | None = None, *, wait_s: float = WAIT_S, **heads: str
    ) -> int:
        """Status of a request; 599 if there is none within so many seconds."""
        link = http.client.HTTPConnection(HERE, self.port, timeout=wait_s)
        own = {} if body is None else {"content-type": "application/json"}
        own |= {name.replace("_", "-"): value for name, value in heads.items()}
        try:
            link.request("GET" if body is None else "POST", f"/{self.token}/{path}", body, own)
            answer = link.getresponse()
            answer.read()
        except TimeoutError:
            return SILENCE
        else:
            return answer.status
        finally:
            link.close()

    def line(self, text: bytes) -> socket.socket:
        """A connection on which something was sent."""
        out = socket.create_connection((HERE, self.port), timeout=WAIT_S)
        with suppress(ConnectionError):
            out.sendall(text)
        return out

    def sockets(self) -> int:
        """Sockets that its process has open."""
        names = [link.readlink() for link in Path(f"/proc/{self._run.process.pid}/fd").iterdir()]
        return sum(name.name.startswith("socket:") for name in names)

    def end(self) -> tuple[int, str]:
        """SIGTERM; exit code and what it said."""
        return self._run.end(signal.SIGTERM), self._run.said

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End it, if that was not done."""
        if self._run.running():
            self._run.process.kill()


def _draft() -> bytes:
    data = load_design("cylinder60").model_dump(mode="json")
    return json.dumps({"data": data, "source": "", "tab": "a"}).encode()


class Asker(threading.Thread):
    """Asks for something small again and again while the block lasts; notes the times."""

    def __init__(self, studio: Studio) -> None:
        super().__init__(daemon=True)
        self._studio, self._done = studio, threading.Event()
        self.times: list[float] = []
        self.wrong = 0

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self.join(WAIT_S)

    def run(self) -> None:
        """Ask."""
        while not self._done.wait(0.02):
            start = time.perf_counter()
            try:
                self.wrong += self._studio.ask("api/build") != http.client.OK
            except OSError:
                self.wrong += 1
            self.times.append(time.perf_counter() - start)

    def tell(self, look: Look) -> None:
        """How it fared."""
        text = (
            f"meanwhile {len(self.times)} sound requests, {self.wrong} without their answer, "
            f"median {statistics.median(self.times) * 1e3:.1f} ms, longest {max(self.times):.2f} s"
        )
        look.true(text, self.wrong == 0 and max(self.times) <= ANSWER_S)


def studio(table: Table, *, quick: bool) -> None:
    """Rows: the studio under malformed clients, and under slow ones."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        malformed, slow = Look(folder), Look(folder)
        with Studio(folder) as server:
            malformed.true(f"a sound draft: {server.warm}", server.warm == http.client.OK)
            with Asker(server) as asker:
                _malformed(server, malformed, SPOILT_QUICK if quick else SPOILT)
            asker.tell(malformed)
            if not quick:
                with Asker(server) as asker:
                    _slow(server, slow)
                asker.tell(slow)
            code, said = server.end()
        sound = code == -signal.SIGTERM and "Traceback" not in said and "studio: " not in said
        malformed.true(f"at the end SIGTERM: exit code {code}, no traceback", sound)
        malformed.row(table, "faults: studio under malformed clients")
        if not quick:
            slow.row(table, "faults: studio under slow clients")


def _malformed(server: Studio, look: Look, count: int) -> None:
    answers = Counter[str]()
    for text in NO_HTTP:
        with server.line(text) as line:
            try:
                answer = line.recv(100)
            except ConnectionError:
                answer = b""
        answers["closed" if not answer else answer.split()[1].decode()] += 1
    sound = all(answer == "closed" or answer.startswith("4") for answer in answers)
    look.true(f"{len(NO_HTTP)} that are no HTTP: {_told(answers)}", sound)
    codes = {
        "wrong host": server.ask("api/build", Host="evil.example"),
        "foreign page": server.ask("api/open", b"{}", Origin="https://evil.example"),
        "a form": server.ask("api/open", b"{}", content_type="text/plain"),
        "a giant": server.ask("api/open", None, content_length=str(10**12)),
        "NaN": server.ask("api/open", b'{"name": NaN}'),
        "100 000 levels": server.ask("api/open", b"[" * 100_000),
        "a path outside": server.ask("api/open", b'{"name": "../../etc/passwd"}'),
        "a file outside": server.ask("files/%2e%2e/%2e%2e/etc/passwd"),
    }
    refused = all(400 <= code < 500 for code in codes.values())
    look.true(", ".join(f"{name} {code}" for name, code in codes.items()), refused)
    rng = random.Random(0)  # noqa: S311 - nothing secret
    data = load_design("cylinder60").model_dump(mode="json")
    found = Counter[int]()
    for number in range(count):
        path = list(ASKED)[number % len(ASKED)]
        body = ASKED[path] | ({"data": data} if "source" in ASKED[path] else {})
        if rng.random() < 0.5:
            raw = json_text(changed_table(rng, body))
        else:
            raw = changed(rng, json_text(body), [json_text(body)])
        found[server.ask(f"api/{path}", raw)] += 1
    look.true(f"{count} spoilt requests: {_told(found)}", all(code < 500 for code in found))


def _told(found: Counter[Any]) -> str:
    return ", ".join(f"{number}x {code}" for code, number in found.most_common())


def _slow(server: Studio, look: Look) -> None:
    head = f"POST /{server.token}/api/open HTTP/1.1\r\nHost: {HERE}:{server.port}\r\n".encode()
    whole = head + b"Content-Type: application/json\r\nContent-Length: 50\r\n\r\n{"
    page = f"GET /{server.token}/viewer/{{}} HTTP/1.1\r\nHost: {HERE}:{server.port}\r\n\r\n"
    ask = page.format("three.bundle.min.js").encode() * DEAF
    before, start = server.sockets(), time.monotonic()
    kinds = {
        "silent": [server.line(b"") for _ in range(60)],
        "half a head": [server.line(head) for _ in range(10)],
        "a letter now and then": [server.line(b"") for _ in range(10)],
        "half a body": [server.line(whole) for _ in range(10)],
    }
    deaf = [_deaf(server, ask) for _ in range(10)]
    dripping = list(kinds["a letter now and then"])
    while dripping and time.monotonic() - start < WAIT_S:
        for line in list(dripping):
            try:
                line.send(b"G")
            except OSError:
                dripping.remove(line)
        time.sleep(0.5)
    for name, lines in kinds.items():
        ended = sum(_ends(line) for line in lines)
        look.true(f"{ended} of {len(lines)} with {name} let go", ended == len(lines))
    # Those who ask meanwhile have one or two of their own.
    while (left := server.sockets() - before) > 2 and time.monotonic() - start < WAIT_S:
        time.sleep(0.1)
    look.true(
        f"{len(deaf)} who ask and take nothing let go, {max(left, 0)} sockets more", left <= 2
    )
    took = time.monotonic() - start
    look.true(f"all within {took:.0f} s", took <= WAIT_S)
    for line in (*deaf, *(line for lines in kinds.values() for line in lines)):
        line.close()


def _deaf(server: Studio, text: bytes) -> socket.socket:
    out = socket.socket()
    out.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    out.settimeout(WAIT_S)
    out.connect((HERE, server.port))
    out.sendall(text)
    return out


def _ends(line: socket.socket) -> bool:
    try:
        while line.recv(4096):
            pass
    except TimeoutError:
        return False
    except OSError:
        return True
    return True


class Listener(threading.Thread):
    """Reads lines of a stream until it ends, with the time of each."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.link = socket.create_connection((HERE, port), timeout=WAIT_S)
        self.got: list[tuple[float, dict[str, Any]]] = []
        self.start()

    def run(self) -> None:
        """Read."""
        with suppress(OSError, ValueError), self.link.makefile("rb") as lines:
            for line in lines:
                self.got.append((time.monotonic(), json.loads(line)))


def _first_line(line: socket.socket) -> bytes:
    with line.makefile("rb") as lines:
        return lines.readline()


def stream(table: Table, *, quick: bool) -> None:
    """Row: the stream's server under clients that shout, stall, reset, or are too many."""
    toy_recording = import_module("tests.decoder.toy_sensor").toy_recording
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        look = Look(folder)
        decoder, frames = toy_recording(folder, [{}, {14: 3.0}, {14: 3.0, 15: 1.5, 29: 2.0}])
        words = ("serve", str(decoder), str(frames), "--fps", "100", "--loop", "--port", "0")
        run = Run(*words, folder=folder, store=folder / "cache")
        assert run.until(" port ")
        found = re.search(r"port (\d+)", run.said)
        assert found is not None
        try:
            _hostile(look, int(found[1]), run, quick=quick)
        finally:
            if run.running():
                run.process.kill()
        look.row(table, "faults: stream server under malformed and slow clients")


def _hostile(look: Look, port: int, run: Run, *, quick: bool) -> None:
    good = Listener(port)
    shouting = Listener(port)
    with suppress(OSError):
        shouting.link.sendall(b'{"type":"frame","x":NaN}\n\xff\0')
        for _ in range(5000):
            shouting.link.sendall(b"A" * 4096)
            time.sleep(0.001)
    shouting.join(WAIT_S)
    look.true("one that shouts is closed", not shouting.is_alive())
    for _ in range(30):
        rude = socket.create_connection((HERE, port), timeout=WAIT_S)
        rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        rude.close()
    half = Listener(port)
    half.link.shutdown(socket.SHUT_WR)
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stalled.connect((HERE, port))
    crowd = [socket.create_connection((HERE, port), timeout=WAIT_S) for _ in range(70)]
    told = sum(b"listen already" in _first_line(line) for line in crowd)
    for line in crowd:
        line.close()
    # Of 64 places three are taken by those above.
    look.true(f"of 70 at once {told} are told that there are too many", told == 70 - (64 - 3))
    closed = quick or run.until("took nothing for 10 s")
    look.true("one that stalls is told of and closed after 10 s", closed)
    time.sleep(0.5)
    run.process.send_signal(signal.SIGTERM)
    code = run.end()
    good.join(WAIT_S)
    half.join(WAIT_S)
    look.true(f"SIGTERM: exit code {code}", code == 130 and "Traceback" not in run.said)
    for name, one in (("the sound client", good), ("one whose own half is closed", half)):
        numbers = [message["sequence"] for _, message in one.got if message["type"] == "frame"]
        last = one.got[-1][1]
        sound = numbers == sorted(set(numbers)) and (last["type"], last["dropped"]) == ("end", 0)
        gap = max(b - a for (a, _), (b, _) in pairwise(one.got))
        look.true(
            f"{name}: {len(numbers)} frames in order, 0 dropped, longest gap {gap:.2f} s", sound
        )
    stalled.close()
