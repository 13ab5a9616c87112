"""Reports on standard error, and the stream beside them, when nobody reads them any more."""

import contextlib
import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from unittest import mock

import pytest

from phytac_design.cli.console_reporter import ConsoleReporter
from tests.decoder.toy_sensor import toy_recording
from tests.test_cli import PHYTAC

PATIENCE_S = 60.0


@contextmanager
def piped() -> Iterator[int]:
    """Standard error is a pipe; its reading end, that never makes a test wait."""
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    with (
        io.TextIOWrapper(io.FileIO(writing, "w"), encoding="utf-8") as stream,
        mock.patch.object(sys, "stderr", stream),
    ):
        yield reading
    os.close(reading)


def fill(writing: int) -> None:
    """A pipe to its brim, through an own handle: the other's must keep waiting."""
    own = os.open(f"/proc/self/fd/{writing}", os.O_WRONLY | os.O_NONBLOCK)
    try:
        while True:
            os.write(own, b"x")
    except BlockingIOError:
        pass
    finally:
        os.close(own)


def test_reports_keep_their_order_and_end_whole() -> None:
    with piped() as pipe:
        with ConsoleReporter() as report:
            for number in range(100):
                report(f"line {number} µm")
        lines = os.read(pipe, 65536).decode().splitlines()
    assert lines == [f"line {number} µm" for number in range(100)]


def test_nobody_waits_for_a_reader_that_does_not_read() -> None:
    with piped() as pipe:
        fill(sys.stderr.fileno())
        begun = time.monotonic()
        with ConsoleReporter(flush_s=0.3) as report:
            for number in range(3 * report.waiting):
                report(f"line {number}")
            assert time.monotonic() - begun < 1.0
        assert time.monotonic() - begun < 2.0
        # As soon as somebody reads, those that waited come, the oldest of them first.
        data = b""
        until = time.monotonic() + PATIENCE_S
        while data.count(b"\n") < report.waiting:
            assert time.monotonic() < until
            with contextlib.suppress(BlockingIOError):
                data += os.read(pipe, 65536)
    numbers = [int(word) for word in re.findall(rb"line (\d+)", data)]
    assert numbers == list(range(len(numbers)))


def test_a_reader_that_is_gone_is_no_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with (
        io.TextIOWrapper(io.FileIO(writing, "w"), encoding="utf-8") as stream,
        mock.patch.object(sys, "stderr", stream),
    ):
        with ConsoleReporter() as report:
            report("one")
            report("two")
        assert not report._thread.is_alive()


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    decoder, frames = toy_recording(tmp_path_factory.mktemp("toy"), [{}, {14: 3.0}])
    return str(decoder), str(frames)


@contextmanager
def serving(*words: str) -> Iterator[tuple[subprocess.Popen[bytes], socket.socket, int, int]]:
    """The command, a client of it, and both ends of its standard error."""
    reading, writing = os.pipe()
    done = subprocess.Popen(
        ["env", "--default-signal=INT", *PHYTAC, "serve", *words, "--port", "0"],
        stdout=subprocess.DEVNULL,
        stderr=writing,
    )
    with done:
        try:
            reported = b""
            while not (found := re.search(rb"port (\d+);", reported)):
                more = os.read(reading, 4096)
                assert more
                reported += more
            with socket.create_connection(("127.0.0.1", int(found[1]))) as link:
                link.settimeout(PATIENCE_S)
                yield done, link, reading, writing
        finally:
            done.kill()


@pytest.mark.parametrize("kind", ["full", "closed"])
def test_the_stream_continues_when_standard_error_is_not_read(
    toy: tuple[str, str], kind: str
) -> None:
    with serving(*toy, "--fps", "50", "--every", "--loop") as (done, link, reading, writing):
        if kind == "full":
            fill(writing)
        else:
            os.close(writing)
            os.close(reading)
        link.settimeout(2.0)
        begun, frames = time.monotonic(), 0
        with link.makefile("rb") as lines:
            for line in lines:
                message = json.loads(line)
                assert message["type"] != "end", message
                frames += 1
                # Twice as long as it takes to report how it goes.
                if time.monotonic() - begun > 2.2:
                    break
        assert frames > 50
        done.send_signal(signal.SIGINT)
        assert done.wait(PATIENCE_S) == 130
    if kind == "full":
        os.close(writing)
        os.close(reading)


def test_a_closed_standard_error_keeps_the_exit_code() -> None:
    """An error is reported there, and nobody reads it."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*PHYTAC, "check", "no-such-design"], stderr=writing, check=False)
    os.close(writing)
    assert done.returncode == 2
