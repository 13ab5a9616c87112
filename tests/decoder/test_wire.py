"""Messages of a stream: what they say, exact on the wire, and no number that is none."""

import io
import json
import os
import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phytac_decoder.estimation.force_regions import Region
from phytac_decoder.io.imu import Imu
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.csv_recording import COLUMNS, Recorder, RegionRecorder
from phytac_decoder.serving.wire_protocol import (
    FRAMINGS,
    MESSAGE_MAX_BYTES,
    MessageBuilder,
    MessageSplitter,
    encode,
    json_bytes,
    with_dropped,
)
from tests.decoder.toy_sensor import toy_bundle
from tests.made_up import at, found_of
from tests.refusals import refused

COUNT = 30


def messages() -> MessageBuilder:
    return MessageBuilder(bundle=toy_bundle(), estimator="koi_inverse")


def reading(forces_N: dict[int, float], *warnings: str) -> Reading:
    out = np.zeros(COUNT)
    out[list(forces_N)] = list(forces_N.values())
    return Reading(koi=np.array(sorted(forces_N), dtype=np.int64), forces_N=out, warnings=warnings)


def test_hello_describes_the_numbers() -> None:
    hello = messages().hello()
    assert (hello["type"], hello["format"], hello["version"]) == ("hello", "phytac-stream", "1.7")
    assert hello["design"] == "toy"
    assert hello["markers"] == len(hello["positions_mm"]) == COUNT
    assert hello["positions_mm"][7] == [10.0, 10.0, 0.0]
    assert hello["units"]["force"] == "N"
    assert "positions_mm" not in messages().hello(positions=False)


def test_contacts_are_connected_key_nodes_with_their_force_weighted_place() -> None:
    # 7 and 14 touch at a corner; 29 is alone.
    message = messages().frame(reading({7: 3.0, 14: 1.0, 29: 0.5}), sequence=5, timestamp_s=0.25)
    first, second = message["contacts"]
    assert (first["markers"], first["force_N"]) == ([7, 14], 4.0)
    assert first["position_mm"] == [12.5, 12.5, 0.0]
    # Second moment 3/4·12.5 + 1/4·112.5 of the places and 100/6 of the cells, mm².
    assert first["size_mm"] == round(2.0 * np.sqrt(2.0 * (37.5 + 100.0 / 6.0)), 2)
    assert (second["markers"], second["position_mm"]) == ([29], [50.0, 40.0, 0.0])
    assert [(each["id"], each["since_s"]) for each in (first, second)] == [(0, 0.25), (1, 0.25)]
    assert "region" not in first
    assert "regions" not in message
    assert (message["sequence"], message["timestamp_s"], message["valid"]) == (5, 0.25, True)
    assert (message["koi"], message["forces_N"]) == ([7, 14, 29], [3.0, 1.0, 0.5])
    assert message["total_N"] == 4.5
    assert message["net_force_N"] == [0.0, 0.0, -4.5]


def test_ids_survive_frames_that_cannot_be_read() -> None:
    make = messages()
    frames = [reading({7: 3.0}), Reading.none("it is black"), reading({8: 2.0}), reading({29: 1.0})]
    sent = [make.frame(each, sequence=k, timestamp_s=0.1 * k) for k, each in enumerate(frames)]
    assert [[c["id"] for c in message["contacts"]] for message in sent] == [[0], [], [0], [1]]
    assert sent[2]["contacts"][0]["since_s"] == 0.0


def test_regions_have_their_forces_and_contacts_their_region() -> None:
    regions = (
        Region(name="thumb", markers=(7, 8)),
        Region(name="palm", markers=(14, 15, 20)),
        Region(name="hand", markers=(7, 8, 14, 15, 20)),
    )
    make = MessageBuilder(bundle=toy_bundle(), estimator="fem", regions=regions)
    assert make.hello()["regions"][0] == {"name": "thumb", "markers": [7, 8]}
    message = make.frame(reading({7: 1.0, 14: 2.5, 29: 0.5}), sequence=0, timestamp_s=0.0)
    assert [(each["name"], each["force_N"]) for each in message["regions"]] == [
        ("thumb", 1.0),
        ("palm", 2.5),
        ("hand", 3.5),
    ]
    assert [contact["region"] for contact in message["contacts"]] == ["hand", ""]
    idle = make.frame(reading({}), sequence=1, timestamp_s=0.1)
    assert [each["force_N"] for each in idle["regions"]] == [0.0, 0.0, 0.0]


def test_force_along_the_surface_is_part_of_contact_net_force_and_recording(
    tmp_path: Path,
) -> None:
    one = replace(
        at(np.array([10.0, 10.0, 0.0]), [7], 3.0),
        shear_N=np.array([0.5, -1.0, 0.0]),
        shear_covariance_N2=np.diag([0.01, 0.04, 0.0]),
        shear_share=0.2,
    )
    hidden = replace(one, point_mm=np.array([40.0, 40.0, 0.0]), shear_share=0.9)
    found = found_of(one, hidden, shift_px=np.zeros(2 * COUNT))
    message = messages().frame(replace(reading({7: 3.0}), found=found), sequence=0, timestamp_s=0.0)
    seen, unseen = message["contacts"]
    assert seen["shear_N"] == [0.5, -1.0, 0.0]
    assert seen["shear_sd_N"] == [0.1, 0.2, 0.0]
    assert "shear_N" not in unseen
    assert message["net_force_N"][:2] == [0.5, -1.0]
    with Recorder(tmp_path / "out.csv") as recorder:
        recorder.add(message)
    _, first, second = (tmp_path / "out.csv").read_text().splitlines()
    assert ",0.5,-1.0,0.0,0.1,0.2,0.0,0.0,0.0,1.0," in first
    assert ",,,,,,,0.0,0.0,1.0," in second


def test_a_pull_does_not_push_a_contacts_place_off_it() -> None:
    both = messages().frame(reading({7: 2.0, 8: -1.5}), sequence=0, timestamp_s=0.0)
    assert both["contacts"][0]["position_mm"] == [10.0, 10.0, 0.0]
    assert both["contacts"][0]["force_N"] == 0.5
    none = messages().frame(reading({7: 0.0, 8: 0.0}), sequence=0, timestamp_s=0.0)
    assert none["contacts"][0]["position_mm"] == [15.0, 10.0, 0.0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_forces_that_are_not_finite_are_left_out(bad: float) -> None:
    message = messages().frame(
        reading({2: 1.0, 7: bad, 8: 2.0}, "it is dark"), sequence=0, timestamp_s=0.0
    )
    text = json_bytes(message)
    assert b"NaN" not in text
    assert b"nfinity" not in text
    assert message["koi"] == [2, 8]
    assert message["total_N"] == 3.0
    assert message["net_force_N"] == [0.0, 0.0, -3.0]
    assert message["valid"] is False
    assert message["warnings"][0] == "it is dark"
    assert "the forces on 1 markers (7) are not finite" in message["warnings"][1]
    with refused("message-not-finite"):
        json_bytes({"type": "frame", "x": bad if abs(bad) == np.inf else np.nan})


def test_an_unreadable_frame_has_a_reason() -> None:
    message = messages().frame(Reading.none("it is black"), sequence=3, timestamp_s=0.1)
    assert message["valid"] is False
    assert message["warnings"] == ["it is black"]
    assert message["koi"] == message["contacts"] == message["forces_N"] == []


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), framing=st.sampled_from(FRAMINGS))
def test_messages_round_trip_in_pieces_of_any_size(seed: int, framing: str) -> None:
    rng = np.random.default_rng(seed)
    builder = messages()  # one for a stream, as in use: it finds the normals once
    sent = [builder.hello()]
    for number in range(8):
        koi = np.flatnonzero(rng.uniform(size=COUNT) < 0.3)
        sizes = rng.normal(0, 10.0 ** rng.integers(-5, 5), len(koi))
        forces = dict(zip(koi.tolist(), sizes, strict=True))
        sent.append(
            builder.frame(
                reading(forces, "60 % — größer\n\u2028"), sequence=number, timestamp_s=rng.normal()
            )
        )
    data = b"".join(encode(message, framing) for message in sent)
    if framing == "lines":
        assert data.count(b"\n") == len(sent)
    splitter, got = MessageSplitter(framing), []
    at = 0
    while at < len(data):
        step = int(rng.integers(1, 900))
        got += splitter.feed(data[at : at + step])
        at += step
    assert got == sent


def test_the_framing_is_four_bytes_big_endian() -> None:
    message = {"type": "end", "reason": "é"}
    data = encode(message, "length")
    assert struct.unpack(">I", data[:4]) == (len(data) - 4,)
    assert json.loads(data[4:].decode("utf-8")) == message
    assert json.loads(with_dropped(json_bytes(message), 12)) == message | {"dropped": 12}
    with refused("stream-format-unknown"):
        encode(message, "xml")


@pytest.mark.parametrize(
    ("framing", "data", "code"),
    [
        ("lines", b"GET / HTTP/1.1\r\n", "message-invalid"),
        ("lines", b"\xff\xfe\x00\n", "message-invalid"),
        ("lines", b'{"type":"frame","total_N":NaN}\n', "message-invalid"),
        ("lines", b"[1,2]\n", "message-invalid"),
        ("lines", b'{"kind":"frame"}\n', "message-invalid"),
        ("lines", b"[" * 200000 + b"\n", "message-invalid"),
        ("lines", b"x" * (MESSAGE_MAX_BYTES + 1), "message-invalid"),
        ("length", b"GET / HTTP/1.1\r\n", "message-invalid"),
        ("length", b"\x00\x00\x00\x03abc", "message-invalid"),
        ("length", b"\x00\x00\x00\x00", "message-invalid"),
    ],
)
def test_invalid_streams_are_rejected(framing: str, data: bytes, code: str) -> None:
    with refused(code):
        MessageSplitter(framing).feed(data)


def test_motion_samples_go_with_the_frame_they_are_not_newer_than(tmp_path: Path) -> None:
    path = tmp_path / "imu.jsonl"
    lines = [
        '{"t": 0.1, "gyro": [1, 2, 3], "accel": [0, 0, 9.81]}',
        "garbage",
        '{"t": NaN, "gyro": [1, 2, 3]}',
        '{"t": 0.15, "gyro": [1, 2, Infinity]}',
        '{"t": 0.16, "gyro": [1, 2]}',
        '{"t": 1e999, "gyro": [1, 2, 3]}',
        '{"t": 0.2, "gyro": [4, 5, 6]}',
        '{"t": 0.05, "gyro": [9, 9, 9]}',
        '{"t": 0.4, "accel": [7, 8, 9]}',
    ]
    path.write_text("\n".join(lines))
    reported: list[str] = []
    imu = Imu(path, clock=lambda: 0.0, report=reported.append)
    assert imu.latest(0.05) is None
    assert imu.latest(0.1) == {"t": 0.1, "gyro": [1, 2, 3], "accel": [0, 0, 9.81]}
    assert imu.latest(0.3) == {"t": 0.2, "gyro": [4, 5, 6]}
    assert imu.latest(9.0) == {"t": 0.4, "accel": [7, 8, 9]}
    assert imu.bad_lines == 6
    assert len(reported) == 1
    assert "b'garbage" in reported[0]
    imu.close()
    assert imu.latest(10.0) == {"t": 0.4, "accel": [7, 8, 9]}
    with refused("file-unreadable"):
        Imu(tmp_path / "none", clock=lambda: 0.0, report=reported.append)


def test_a_file_of_motion_samples_may_still_be_written(tmp_path: Path) -> None:
    path = tmp_path / "imu.jsonl"
    reported: list[str] = []
    with path.open("w") as file:
        file.write('{"t": 0.1, "gyro": [1, 1, 1]}\n')
        file.flush()
        imu = Imu(path, clock=lambda: 0.0, report=reported.append)
        assert imu.latest(1.0) == {"t": 0.1, "gyro": [1, 1, 1]}
        file.write('{"t": 1.1, "gyro": [2, ')
        file.flush()
        assert imu.latest(1.2) == {"t": 0.1, "gyro": [1, 1, 1]}
        file.write('2, 2]}\n{"t": 1.9, "gyro": [3, 3, 3]}\n')
        file.flush()
        assert imu.latest(1.5) == {"t": 1.1, "gyro": [2, 2, 2]}
        assert imu.latest(2.0) == {"t": 1.9, "gyro": [3, 3, 3]}
    imu.close()
    assert reported == []


def test_a_sample_far_ahead_costs_none_of_the_others(tmp_path: Path) -> None:
    path = tmp_path / "imu.jsonl"
    times = [0.1 * k for k in range(100)]
    ahead = {30: 1e6, 31: 1e6 + 0.1, 60: 200.0}
    for k, wrong in ahead.items():
        times[k] = wrong
    path.write_text("".join(json.dumps({"t": t, "gyro": [1, 1, 1]}) + "\n" for t in times))
    reported: list[str] = []
    imu = Imu(path, clock=lambda: 0.0, report=reported.append)
    for k in range(100):
        sample = imu.latest(0.1 * k + 0.05)
        assert sample is not None
        good = max(j for j in range(k + 1) if j not in ahead)
        assert sample["t"] == pytest.approx(0.1 * good)
    imu.close()
    assert imu.bad_lines == 3
    (line,) = reported
    assert "is no motion sample, or out of order" in line


def test_samples_that_all_begin_late_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "imu.jsonl"
    lines = [json.dumps({"t": 100.0 + k, "gyro": [1, 1, 1]}) + "\n" for k in range(30)]
    path.write_text("".join(lines))
    imu = Imu(path, clock=lambda: 0.0, report=pytest.fail)
    for k in range(135):
        sample = imu.latest(float(k))
        assert (sample and sample["t"]) == (None if k < 100 else min(k, 129))
    imu.close()


def come(imu: Imu, time_s: float, wanted: dict[str, Any]) -> None:
    """Wait for a sample to come off a port."""
    end = time.monotonic() + 10.0
    while imu.latest(time_s) != wanted:
        assert time.monotonic() < end, imu.latest(time_s)
        time.sleep(0.002)


def test_a_port_of_motion_samples_is_never_waited_for(tmp_path: Path) -> None:
    path, now = tmp_path / "port", [5.0]
    os.mkfifo(path)
    imu = Imu(path, clock=lambda: now[0], report=lambda _: None)
    assert imu.latest(9.0) is None
    writer = os.open(path, os.O_WRONLY)
    os.write(writer, b'{"t": 1.0, "gyro": [1, 1, 1]}\n{"gyro": [2, ')
    come(imu, 9.0, {"t": 1.0, "gyro": [1, 1, 1]})
    os.write(writer, b'2, 2]}\n{"t": 5.5, "gyro": [3, 3, 3]}\n')
    come(imu, 5.6, {"t": 5.5, "gyro": [3, 3, 3]})
    # Its time is that of its coming, not of the frame that reads it.
    now[0] = 6.0
    os.write(writer, b'{"gyro": [4, 4, 4]}\n')
    while not imu._waiting:
        time.sleep(0.002)
    now[0] = 7.0
    assert imu.latest(5.9) == {"t": 5.5, "gyro": [3, 3, 3]}
    assert imu.latest(6.0) == {"t": 6.0, "gyro": [4, 4, 4]}
    os.close(writer)
    assert imu.latest(8.0) == {"t": 6.0, "gyro": [4, 4, 4]}
    imu.close()
    assert imu.latest(8.0) == {"t": 6.0, "gyro": [4, 4, 4]}


def test_a_recording_has_a_row_for_each_contact_and_loses_none(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    recorder = Recorder(path)
    recorder.add(messages().frame(reading({7: 3.0, 14: 1.0, 28: 0.5}), sequence=4, timestamp_s=0.5))
    recorder.add(messages().frame(reading({}), sequence=6, timestamp_s=0.75))
    # Not closed: what a killed program leaves.
    head, *rows = [line.split(",") for line in path.read_text().splitlines()]
    assert tuple(head) == COLUMNS
    first, second = ["4", "0.5", "1", "2", "0"], ["4", "0.5", "1", "2", "1"]
    up, no_force, none = ["0.0", "0.0", "1.0"], ["0.0"] * 3, [""] * 3
    # 3 N at (10, 10), 1 N at (20, 20) and 0.5 N at (40, 40) mm, towards -z.
    net = ["0.0", "0.0", "-4.5", *none, "-70.0", "70.0", "0.0", *none, *no_force, ""]
    assert rows == [
        [*first, "4.0", "12.5", "12.5", "0.0", "7 14", "0", "20.82", "0.5", *[""] * 8, *up, *net],
        [*second, "0.5", "40.0", "40.0", "0.0", "28", "1", "11.55", "0.5", *[""] * 8, *up, *net],
        ["6", "0.75", "1", "0", *[""] * 20, *no_force, *none, *no_force, *none, *no_force, ""],
    ]
    with refused("output-exists") as caught:
        Recorder(path)
    caught.match("choose another name")
    recorder.__exit__(None, None, None)


def test_a_recording_of_regions_has_a_row_for_each_frame(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    regions = (Region(name="thumb", markers=(7, 8)), Region(name="index tip", markers=(29,)))
    make = MessageBuilder(bundle=toy_bundle(), estimator="fem", regions=regions)
    with RegionRecorder(path, [region.name for region in regions]) as recorder:
        recorder.add(make.frame(reading({7: 3.0, 29: 0.5}), sequence=4, timestamp_s=0.5))
        recorder.add(make.frame(Reading.none("it is black"), sequence=5, timestamp_s=0.6))
    assert [line.split(",") for line in path.read_text().splitlines()] == [
        [*COLUMNS[:3], "total_N", "region_thumb_N", "region_index tip_N", "warnings"],
        ["4", "0.5", "1", "3.5", "3.0", "0.5", ""],
        ["5", "0.6", "0", "0.0", "0.0", "0.0", "it is black"],
    ]
    assert recorder.rows == 2
    with refused("output-exists") as caught:
        RegionRecorder(path, [])
    caught.match("choose another name")


class Full(io.FileIO):
    """A file on a disk that takes few bytes more."""

    room = 570

    def write(self, data: Any) -> int:
        if self.room <= 0:
            raise OSError(28, "No space left on device")
        part = bytes(data)[: self.room]
        self.room -= len(part)
        return super().write(part)


def test_a_full_disk_leaves_whole_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.csv"
    monkeypatch.setattr(Path, "open", lambda self, mode, **_: Full(self, mode.strip("b")))
    with Recorder(path) as recorder:
        recorder.add(messages().frame(reading({}), sequence=0, timestamp_s=0.0))
        whole = path.read_bytes()
        with refused("output-not-writable"):
            recorder.add(messages().frame(reading({7: 3.0, 28: 1.0}), sequence=1, timestamp_s=0.1))
    assert path.read_bytes() == whole
    assert whole.endswith(b",0.0,0.0,0.0,\n")
    monkeypatch.setattr(Full, "room", 20)
    with refused("output-not-writable"):
        Recorder(tmp_path / "none.csv")
    assert not (tmp_path / "none.csv").exists()
