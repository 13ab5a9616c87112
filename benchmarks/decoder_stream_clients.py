"""Clients of a force stream in a process of their own; messages and latencies."""

import multiprocessing
import selectors
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from phytac_decoder.serving.force_server import StreamServer
from phytac_decoder.serving.wire_protocol import MessageSplitter
from phytac_shapes.arrays import FloatArray

READERS = 9


@dataclass(frozen=True, kw_only=True)
class ClientRecord:
    """Messages that the clients of a run received.

    Attributes
    ----------
    sequences : list of list of int
        Frames that each reader received, in order.
    latency_ms : (m,) float
        From the end of decoding to reception, all messages of all readers.
    """

    sequences: list[list[int]]
    latency_ms: FloatArray

    def missing(self, count: int) -> int:
        """Messages of ``count`` that some reader did not get, or not in order."""
        return sum(count if got != sorted(set(got)) else count - len(got) for got in self.sequences)


def listen(port: int, readers: int, stalled: int, started_s: float, report: Connection) -> None:
    """Clients in one process: ``readers`` that read until the end, ``stalled`` that never do."""
    sleepers = [_connected(port, small=True) for _ in range(stalled)]
    selector = selectors.DefaultSelector()
    splitters = [MessageSplitter("lines") for _ in range(readers)]
    sequences: list[list[int]] = [[] for _ in range(readers)]
    late: list[float] = []
    for number in range(readers):
        selector.register(_connected(port), selectors.EVENT_READ, number)
    report.send("ready")
    while selector.get_map():
        for key, _ in selector.select():
            link: Any = key.fileobj
            data = link.recv(1 << 16)
            now = time.monotonic() - started_s
            if not data:
                selector.unregister(link)
                link.close()
            for message in splitters[key.data].feed(data):
                if message["type"] == "frame":
                    sequences[key.data].append(message["sequence"])
                    late.append(now - message["decoded_s"])
    for sleeper in sleepers:
        sleeper.close()
    report.send((sequences, late))


def _connected(port: int, *, small: bool = False) -> socket.socket:
    link = socket.socket()
    if small:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    link.connect(("127.0.0.1", port))
    return link


@contextmanager
def clients(
    server: StreamServer, started_s: float, stalled: int
) -> Iterator[Callable[[], ClientRecord]]:
    """Run readers, and some that stall, in another process; yields how to get their record."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    child = context.Process(
        target=listen, args=(server.port, READERS, stalled, started_s, there), daemon=True
    )
    child.start()
    here.recv()
    while server.clients < READERS + stalled:
        time.sleep(0.01)

    def heard() -> ClientRecord:
        sequences, late = here.recv()
        return ClientRecord(sequences=sequences, latency_ms=1000.0 * np.array(late))

    try:
        yield heard
    finally:
        child.join(timeout=10.0)
        child.terminate()
