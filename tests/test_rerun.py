"""Recordings for Rerun, read by its own library."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.serving.wire_protocol import MessageBuilder
from phytac_design.cli.serve_command import open_recorders, rows_text
from phytac_design.core import rerun_recording
from phytac_design.core.rerun_recording import RerunRecorder
from tests.decoder.toy_sensor import toy_bundle, toy_recording
from tests.refusals import refused
from tests.test_cli import phytac
from tests.test_mcap import START_s, frames, messages

rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra rerun)")
chunks = pytest.importorskip("rerun.chunk", reason="this rerun-sdk has no reader")

UNFOOTED = pytest.mark.filterwarnings("ignore:RRD file has no footer")


def columns(path: Path) -> dict[str, list[Any]]:
    """Values of each entity's components, over all chunks, in order."""
    out: dict[str, list[Any]] = {}
    for chunk in chunks.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        entity = chunk.entity_path.strip("/")
        for name in batch.schema.names:
            values = batch.column(name)
            if "timestamp" in str(values.type):  # nanoseconds, which datetime does not have
                values = values.cast("int64")
            out.setdefault(f"{entity}:{name}", []).extend(values.to_pylist())
    return out


def recorded(path: Path, make: MessageBuilder, count: int) -> RerunRecorder:
    recorder = RerunRecorder(path, make.bundle, START_s)
    for message in frames(make, count):
        recorder.add(message)
    return recorder


def test_frames_are_what_the_stream_says(tmp_path: Path) -> None:
    path = tmp_path / "out.rrd"
    with recorded(path, messages(), 3) as recorder:
        assert recorder.rows == 3
    found = columns(path)
    total, net = (found[f"force/{name}:Scalars:scalars"] for name in ("total_N", "net_N"))
    # The second of three frames is black.
    assert total == [[4.5], [4.5]]
    assert net == [[0.0, 0.0, -4.5]] * 2
    assert found["force/regions/thumb:Scalars:scalars"] == [[3.0], [3.0]]
    assert found["sensor/contacts:Arrows3D:labels"][0] == ["4.0 N", "0.5 N"]
    tip = np.array(found["sensor/contacts:Arrows3D:vectors"][0])
    assert tip == pytest.approx(np.array([[0.0, 0.0, -20.0], [0.0, 0.0, -2.5]]))
    switches = np.array(found["sensor/switches:Points3D:positions"][0])
    assert switches == pytest.approx(messages().bundle.position_mm[[7, 14, 28]])
    assert len(found["sensor/markers:Points3D:positions"][0]) == 30
    assert found["warnings:TextLog:text"] == [["it is dim"], ["it is black"], ["it is dim"]]
    assert found["force/total_N:frame"] == [0, 2]
    seconds = 1e-9 * np.array(found["force/total_N:time"])
    assert seconds == pytest.approx([START_s, START_s + 0.5], abs=1e-3)
    assert found["force/regions/left\\ palm:Scalars:scalars"] == [[0.5], [0.5]]


@UNFOOTED
def test_a_kill_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "out.rrd"
    recorder = recorded(path, messages(), 3)
    time.sleep(0.9)
    # What the system has is what a killed program leaves.
    (tmp_path / "killed.rrd").write_bytes(path.read_bytes())
    assert columns(tmp_path / "killed.rrd")["force/total_N:frame"] == [0, 2]
    recorder.__exit__()


def test_what_cannot_be_recorded_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there.rrd").write_bytes(b"")
    with refused("output-exists"):
        RerunRecorder(tmp_path / "there.rrd", toy_bundle(), START_s)
    with refused("output-not-writable"):
        RerunRecorder(tmp_path / "none" / "out.rrd", toy_bundle(), START_s)
    monkeypatch.setitem(sys.modules, "rerun", None)
    with refused("missing-library") as found:
        RerunRecorder(tmp_path / "out.rrd", toy_bundle(), START_s)
    assert "phytac-design[rerun]" in str(found.value)
    assert not (tmp_path / "out.rrd").exists()


@contextlib.contextmanager
def listener_of(words: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Rerun's program, which starts one of its own; both end with the block, whatever happens."""
    command = [sys.executable, "-m", "rerun", *words]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def wait_for_rows(path: Path, name: str, count: int, within_s: float = 60.0) -> None:
    """Wait until a file that is being written holds so many rows of a component."""
    end_s = time.monotonic() + within_s
    while time.monotonic() < end_s:
        with contextlib.suppress(RuntimeError, OSError):  # not there yet, or half a message
            if len(columns(path).get(name, [])) >= count:
                return
        time.sleep(0.05)
    raise TimeoutError(f"{path.name} has no {count} rows of {name} after {within_s:g} s")


@UNFOOTED
def test_a_viewer_gets_what_a_file_gets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    monkeypatch.setattr(rerun_recording, "VIEWER_PORT", port)
    words = ("--bind", "127.0.0.1", "--port", str(port), "--save", str(tmp_path / "shown.rrd"))
    name = "force/net_N:Scalars:scalars"
    # Rerun's own program in the viewer's place: it needs no display.
    with listener_of(words) as listener:
        while not rerun_recording._listens():
            assert listener.poll() is None
            time.sleep(0.05)
        with contextlib.ExitStack() as stack:
            kept = open_recorders(stack, tmp_path / "out.rrd", None, messages(), rerun=True)
            for message in frames(messages(), 3):
                for recorder in kept.values():
                    recorder.add(message)
            assert rows_text(kept).endswith(", 3 rows in Rerun's viewer")
        wait_for_rows(tmp_path / "shown.rrd", name, 2)  # it writes what it has received later
        os.killpg(listener.pid, signal.SIGINT)
        listener.wait(60.0)
    shown, kept_file = columns(tmp_path / "shown.rrd"), columns(tmp_path / "out.rrd")
    assert shown[name] == kept_file[name] == [[0.0, 0.0, -4.5]] * 2


def test_without_a_display_the_error_names_a_way(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    monkeypatch.setattr(rerun_recording, "VIEWER_PORT", port)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with refused("viewer-not-opened") as found:
        RerunRecorder(None, toy_bundle(), START_s)
    assert "--record FILE.rrd" in str(found.value)


def test_the_command(tmp_path: Path) -> None:
    toy_recording(tmp_path, [{}, {7: 3.0}])
    words = ("live", "decoder", "frames", "--rest-first", "1", "--every", "--port", "0")
    done = phytac(*words, "--record", "out.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "2 rows in out.rrd" in done.stdout
    assert columns(tmp_path / "out.rrd")["force/total_N:Scalars:scalars"][-1][0] > 2.0
