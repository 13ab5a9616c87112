"""``phytac serve`` as a person runs it: streams, records, stops, and errors of one line."""

import csv
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from phytac_decoder.serving.wire_protocol import MessageSplitter
from tests.decoder.toy_sensor import toy_recording
from tests.test_cli import PHYTAC, phytac

ROOT = Path(__file__).parents[1]
PRESSES = [{}, {14: 3.0}, {14: 3.0, 15: 1.5, 29: 2.0}, {7: 2.0}]
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    decoder, frames = toy_recording(tmp_path_factory.mktemp("toy"), PRESSES)
    return str(decoder), str(frames)


@contextmanager
def serving(*words: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The running command, and the port it took."""
    done = subprocess.Popen(
        # What runs in the background of a script has Ctrl-C ignored, and hands that down.
        ["env", "--default-signal=INT", *PHYTAC, "serve", *words, "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    with done:
        try:
            assert done.stderr is not None
            port = 0
            while not port:
                assert select.select([done.stderr], [], [], PATIENCE_S)[0]
                line = done.stderr.readline()
                assert line, "it ended before it listened"
                found = re.search(r"to 127\.0\.0\.1 port (\d+)", line)
                port = int(found[1]) if found else 0
            yield done, port
        finally:
            done.kill()


def test_a_recording_goes_to_clients_and_to_csv(toy: tuple[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    about = ("--moment-about", "0", "0", "-9")
    more = ("--fps", "100", "--every", "--wait", "--record", str(out), *about)
    with serving(*toy, *more) as (done, port):
        client = [sys.executable, str(ROOT / "examples" / "stream" / "client.py")]
        printed = subprocess.run(
            [*client, "127.0.0.1", str(port)],
            capture_output=True,
            text=True,
            check=True,
            timeout=PATIENCE_S,
        ).stdout.splitlines()
        reported, errors = done.communicate(timeout=PATIENCE_S)
    assert done.returncode == 0, errors
    assert reported.startswith("4 frames in ")
    assert ", 0 unread, 0 skipped, 0 missed, 0 messages dropped, 5 rows in " in reported
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["markers"] for row in rows] == ["", "14", "14 15", "29", "7"]
    assert [row["timestamp_s"] for row in rows] == ["0.0", "0.01", "0.02", "0.02", "0.03"]
    assert float(rows[1]["force_N"]) == pytest.approx(3.0, abs=0.15)
    assert printed[0] == "toy 30 markers, protocol 1.7"
    assert printed[-1] == "end: the source has ended"
    assert printed[1] == f"1 {rows[1]['force_N']} N at [20.0, 20.0, 0.0]"
    x, y, z = (float(rows[1][f"net_moment_{axis}_Nmm"]) for axis in "xyz")
    assert printed[2].endswith(f"moment [{x}, {y}, {z}] N mm about [0.0, 0.0, -9.0] mm")


def test_the_example_passes_over_messages_of_later_versions() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = [sys.executable, str(ROOT / "examples" / "stream" / "client.py"), "127.0.0.1"]
        listener.settimeout(PATIENCE_S)
        port = str(listener.getsockname()[1])
        with subprocess.Popen([*client, port], stdout=subprocess.PIPE, text=True) as done:
            link, _ = listener.accept()
            with link:
                link.sendall(b'{"type":"later","dropped":0}\n{"type":"end","reason":"enough"}\n')
            printed, _ = done.communicate(timeout=PATIENCE_S)
    assert (done.returncode, printed) == (0, "end: enough\n")


def test_motion_samples_and_lengths(toy: tuple[str, str], tmp_path: Path) -> None:
    (tmp_path / "imu").write_text('{"t": 0.0, "gyro": [1, 2, 3]}\n{"t": 0.02, "accel": [0, 0, 1]}')
    more = ("--fps", "100", "--every", "--wait", "--imu", str(tmp_path / "imu"))
    with (
        serving(*toy, *more, "--format", "length") as (_, port),
        socket.create_connection(("127.0.0.1", port)) as link,
        link.makefile("rb") as data,
    ):
        hello, *frames, end = MessageSplitter("length").feed(data.read())
    assert (hello["type"], end["type"]) == ("hello", "end")
    assert [frame["imu"]["t"] for frame in frames] == [0.0, 0.0, 0.02, 0.02]
    wrong = phytac("serve", *toy, "--loop", "--port", "0", "--imu", str(tmp_path / "imu"))
    assert wrong.returncode == 4
    assert "a file of motion samples does not begin again" in wrong.stderr


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_it_stops_cleanly_on_a_signal(toy: tuple[str, str], tmp_path: Path, sign: int) -> None:
    out = tmp_path / "out.csv"
    with serving(*toy, "--fps", "50", "--every", "--loop", "--record", str(out)) as (done, port):
        where = ("127.0.0.1", port)
        with socket.create_connection(where, PATIENCE_S) as link, link.makefile("rb") as lines:
            for _ in range(10):
                message = json.loads(next(lines))
            done.send_signal(sign)
            last = [json.loads(line) for line in lines][-1]
        reported, errors = done.communicate(timeout=PATIENCE_S)
    assert message["type"] == "frame"
    assert last["type"] == "end"
    assert last["reason"] == "stopped"
    assert done.returncode == 130
    assert "Traceback" not in errors
    assert " frames in " in reported
    numbers = {int(row["sequence"]) for row in csv.DictReader(out.read_text().splitlines())}
    assert set(range(message["sequence"])) <= numbers


def test_errors_are_one_line(toy: tuple[str, str], tmp_path: Path) -> None:
    decoder, frames = toy
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        out = phytac("serve", decoder, frames, "--port", port, "--record", "x.csv", cwd=tmp_path)
    assert (out.returncode, len(out.stderr.splitlines())) == (3, 1)
    assert out.stderr.startswith(
        f"error[port-unavailable]: cannot listen at 127.0.0.1, port {port} (Address"
    )
    for words, message in (
        ((decoder, frames, frames), "the sensor 'toy' has one camera: one source (got 2)"),
        ((decoder, str(tmp_path / "none")), "no frames at"),
        ((decoder, frames, "--estimator", "best"), "no estimator 'best'; known: fem"),
    ):
        out = phytac("serve", *words, "--port", "0", "--record", "x.csv", cwd=tmp_path)
        assert (out.returncode, len(out.stderr.splitlines())) == (4, 1), out.stderr
        assert message in out.stderr
    assert list(tmp_path.iterdir()) == []


def test_following_needs_a_beginning_and_streams(toy: tuple[str, str], tmp_path: Path) -> None:
    refused = phytac("serve", *toy, "--follow", "--port", "0")
    assert refused.returncode == 4
    assert "give it with --rest" in refused.stderr
    out = tmp_path / "out.csv"
    rest = str(Path(toy[1]) / "frame_0.png")
    more = ("--fps", "50", "--every", "--rest", rest, "--follow", "--record", str(out))
    done = phytac("serve", *toy, *more, "--port", "0")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("4 frames in ")
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert rows[0]["markers"] == ""


REGIONS = '[[regions]]\nname = "thumb"\nmarkers = [14, 15]\n'


def test_regions_go_to_clients_and_to_csv(toy: tuple[str, str], tmp_path: Path) -> None:
    (tmp_path / "regions.toml").write_text(REGIONS)
    out, sums = tmp_path / "out.csv", tmp_path / "sums.csv"
    more = ("--fps", "100", "--every", "--wait", "--regions", str(tmp_path / "regions.toml"))
    files = ("--record", str(out), "--record-regions", str(sums))
    with (
        serving(*toy, *more, *files) as (done, port),
        socket.create_connection(("127.0.0.1", port)) as link,
        link.makefile("rb") as data,
    ):
        hello, *frames, end = [json.loads(line) for line in data]
        reported, errors = done.communicate(timeout=PATIENCE_S)
    assert done.returncode == 0, errors
    assert end["type"] == "end"
    assert hello["regions"] == [{"name": "thumb", "markers": [14, 15]}]
    sent = [frame["regions"][0]["force_N"] for frame in frames]
    assert sent == pytest.approx([0.0, 3.0, 4.5, 0.0], abs=0.3)
    rows = list(csv.DictReader(sums.read_text().splitlines()))
    assert [float(row["region_thumb_N"]) for row in rows] == sent
    assert [row["region"] for row in csv.DictReader(out.read_text().splitlines())] == [
        "",
        "thumb",
        "thumb",
        "",
        "",
    ]
    assert f"5 rows in {out}, 4 rows in {sums}" in reported


def test_regions_that_cannot_be_are_rejected(toy: tuple[str, str], tmp_path: Path) -> None:
    (tmp_path / "regions.toml").write_text(REGIONS.replace("markers = [14, 15]", "rows = [0, 1]"))
    for words, message in (
        (("--regions", "regions.toml"), "are known from the design alone; give the design"),
        (("--regions", "none.toml"), "no regions at none.toml"),
        (("--record-regions", "x.csv", "--record", "y.csv"), "name them with --regions"),
        (("--regions", "regions.toml", "--design", "cylinder40"), "cylinder40 is another design"),
    ):
        out = phytac("serve", *toy, "--port", "0", *words, cwd=tmp_path)
        assert (out.returncode, len(out.stderr.splitlines())) == (4, 1), out.stderr
        assert message in out.stderr
    (tmp_path / "regions.toml").write_text(REGIONS)
    files = ("--regions", "regions.toml", "--record", "x.csv", "--record-regions", "./x.csv")
    out = phytac("serve", *toy, "--port", "0", *files, cwd=tmp_path)
    assert out.returncode == 3, out.stderr
    assert "are one file (x.csv); give each a name of its own" in out.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["regions.toml"]
