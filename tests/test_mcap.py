"""Recordings as MCAP with ROS 2 messages, read by the libraries of others."""

import sys
from collections import defaultdict
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.camera.lens import KannalaBrandt
from phytac_decoder.estimation.force_regions import Region
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.wire_protocol import MessageBuilder
from phytac_design.core import mcap_recording
from phytac_design.core.mcap_recording import McapRecorder
from phytac_design.core.ros2_messages import DEFINITIONS, camera_messages, cdr_bytes, schema_text
from tests.decoder.toy_sensor import toy_bundle, toy_recording
from tests.refusals import refused
from tests.test_cli import phytac

pytest.importorskip("mcap", reason="mcap is not installed (extra recordings)")
decoder = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
START_s = 1.7e9
ABOUT_mm = (10.0, 20.0, -5.0)


def messages() -> MessageBuilder:
    regions = (Region(name="thumb", markers=(7, 8)), Region(name="left palm", markers=(28,)))
    return MessageBuilder(
        bundle=toy_bundle(),
        estimator="fem",
        regions=regions,
        started_unix_s=START_s,
        moment_about_mm=ABOUT_mm,
    )


def frames(make: MessageBuilder, count: int, rate_Hz: float = 4.0) -> list[dict[str, Any]]:
    """Two contacts in every frame but the second, which is black."""
    forces = np.zeros(30)
    forces[[7, 14, 28]] = (3.0, 1.0, 0.5)
    pressed = Reading(koi=np.array([7, 14, 28]), forces_N=forces, warnings=["it is dim"])
    each = [pressed] * count
    each[1] = Reading.none("it is black", "image-dark")
    return [
        make.frame(reading, sequence=k, timestamp_s=k / rate_Hz, decoded_s=k / rate_Hz + 0.01)
        for k, reading in enumerate(each)
    ]


def read(data: bytes) -> dict[str, list[Any]]:
    """Messages of each topic; what comes after a cut is left out."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader

    out: dict[str, list[Any]] = defaultdict(list)
    reader = NonSeekingReader(BytesIO(data), decoder_factories=[decoder.DecoderFactory()])
    try:
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            out[channel.topic].append((message, decoded))
    except EndOfFile:
        pass
    return dict(out)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    make, path = messages(), tmp_path / "out.mcap"
    with McapRecorder(path, make.bundle, START_s) as recorder:
        for message in frames(make, 3):
            recorder.add(message)
    assert recorder.rows == 3
    return path


def test_messages_say_what_the_stream_says(recorded: Path) -> None:
    found = read(recorded.read_bytes())
    assert sorted(found) == [
        "/phytac/camera/camera_info",
        "/phytac/contacts",
        "/phytac/diagnostics",
        "/phytac/markers",
        "/phytac/regions/left_palm/wrench",
        "/phytac/regions/thumb/wrench",
        "/phytac/switches",
        "/phytac/wrench",
    ]
    head, wrench = found["/phytac/wrench"][1]
    assert (head.log_time, head.publish_time) == (1_700_000_000_500_000_000, head.log_time + 10**7)
    assert (wrench.header.stamp.sec, wrench.header.stamp.nanosec) == (1_700_000_000, 500_000_000)
    assert wrench.header.frame_id == "sensor"
    # Markers 7, 14 and 28 are at (10, 10), (20, 20) and (40, 40) mm; pressed along -z.
    assert vector(wrench.wrench.force) == [0.0, 0.0, -4.5]
    assert vector(wrench.wrench.torque) == pytest.approx([-0.07, 0.07, 0.0])
    thumb = found["/phytac/regions/thumb/wrench"][0][1].wrench
    assert vector(thumb.force) == pytest.approx([0.0, 0.0, -4.0])
    assert vector(thumb.torque) == pytest.approx([-0.05, 0.05, 0.0])
    strong, weak = (one for _, one in found["/phytac/contacts"][:2])
    assert (strong.name, weak.name) == ("0", "1")
    assert vector(strong.position) == pytest.approx([0.0125, 0.0125, 0.0])
    assert (vector(strong.normal), vector(weak.wrench.force)) == ([0, 0, 1], [0, 0, -0.5])
    arrows = found["/phytac/markers"][0][1].markers
    assert [(one.action, one.type, len(one.points)) for one in arrows] == [
        (3, 0, 0),
        (0, 0, 2),
        (0, 0, 2),
    ]
    assert vector(arrows[1].points[1]) == pytest.approx([0.0125, 0.0125, 0.0])
    assert arrows[1].points[0].z == pytest.approx(0.02)
    switches = found["/phytac/switches"][0][1]
    assert np.flatnonzero(list(switches.data)).tolist() == [7, 14, 28]
    assert (switches.layout.dim[0].label, switches.layout.dim[0].size) == ("receptor", 30)
    dim, black, _ = (one.status[0] for _, one in found["/phytac/diagnostics"])
    assert (dim.level, dim.message) == (1, "it is dim")
    assert (black.level, black.values[0].value) == (2, "image-dark")
    # Of the black frame there is nothing else.
    assert len(found["/phytac/wrench"]) == len(found["/phytac/markers"]) == 2


def vector(xyz: Any) -> list[float]:
    return [xyz.x, xyz.y, xyz.z]


def test_the_file_is_whole_and_indexed(recorded: Path) -> None:
    from mcap.reader import make_reader

    with recorded.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 18
    assert len(summary.chunk_indexes) == 1
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}


def test_definitions_are_the_published_ones() -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name in DEFINITIONS:
        full = name.replace("/", "/msg/")
        if name.startswith("tactile_msgs"):  # not of ROS itself
            store.register(typesys.get_types_from_msg(DEFINITIONS[name], full))
        published, _ = store.generate_msgdef(full, ros_version=2)
        blocks = sorted(published.strip("\n").split("=" * 80))
        ours = sorted(schema_text(name).split("=" * 80))
        assert [each.strip() for each in ours] == [each.strip() for each in blocks], name


def test_bytes_are_those_of_another_encoder() -> None:
    typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    own = DEFINITIONS["tactile_msgs/TactileContact"]
    store.register(typesys.get_types_from_msg(own, "tactile_msgs/msg/TactileContact"))
    from phytac_design.core.ros2_messages import frame_messages

    make = messages()
    each = [*frame_messages(frames(make, 1 + 1)[0], 10**18 + 7, 30)]
    each += camera_messages(make.bundle.cameras, 10**18)
    assert len({type_name for _, type_name, _ in each}) == 6
    for _, type_name, fields in each:
        name = type_name.replace("/", "/msg/")
        data = cdr_bytes(type_name, fields)
        again = store.serialize_cdr(store.deserialize_cdr(data, name), name)
        # Encoders may end with bytes that fill the last word.
        assert bytes(again)[: len(data)] == data, type_name


def test_a_bag_reader_opens_it(recorded: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed")
    with highlevel.AnyReader([recorded]) as reader:
        count = {one.topic: one.msgcount for one in reader.connections}
        assert count["/phytac/wrench"] == 2
        (connection,) = (one for one in reader.connections if one.topic == "/phytac/contacts")
        _, _, raw = next(reader.messages([connection]))
        contact = reader.deserialize(raw, connection.msgtype)
    assert contact.position.x == pytest.approx(0.0125)


def test_a_kill_loses_less_than_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, path, make = [100.0], tmp_path / "out.mcap", messages()
    monkeypatch.setattr(mcap_recording.time, "monotonic", lambda: clock[0])
    with McapRecorder(path, make.bundle, START_s) as recorder:
        for message in frames(make, 90, rate_Hz=30.0):
            recorder.add(message)
            clock[0] += 1.0 / 30.0
            # What the system has is what a killed program leaves.
            if message["sequence"] in {20, 50, 89}:
                kept = read(path.read_bytes()).get("/phytac/wrench", [])
                last_s = 1e-9 * kept[-1][0].log_time - START_s
                assert message["timestamp_s"] - last_s < 1.0
    infos = read(path.read_bytes())["/phytac/camera/camera_info"]
    assert len(infos) == 3  # one a second


def test_lenses_by_the_names_of_ros() -> None:
    bundle = toy_bundle()
    lens = KannalaBrandt(
        width_px=160, height_px=120, fx_px=80.0, fy_px=81.0, cx_px=79.5, cy_px=59.5,
        distortion=(0.01, 0.0, 0.0, 0.0),
    )  # fmt: skip
    wide = replace(bundle.cameras[0], lens=lens)
    plain, fisheye = camera_messages([bundle.cameras[0], wide], 0)
    assert (plain.topic, fisheye.topic) == ("camera/camera_info", "camera_far/camera_info")
    assert (plain.fields["distortion_model"], plain.fields["d"]) == ("plumb_bob", [0.0] * 5)
    assert (fisheye.fields["distortion_model"], len(fisheye.fields["d"])) == ("equidistant", 4)
    assert fisheye.fields["k"] == [80.0, 0.0, 79.5, 0.0, 81.0, 59.5, 0.0, 0.0, 1.0]
    assert fisheye.fields["p"][5:7] == [81.0, 59.5]


def test_what_cannot_be_recorded_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there.mcap").write_bytes(b"")
    with refused("output-exists"):
        McapRecorder(tmp_path / "there.mcap", toy_bundle(), START_s)
    with refused("output-not-writable"):
        McapRecorder(tmp_path / "none" / "out.mcap", toy_bundle(), START_s)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with refused("missing-library") as found:
        McapRecorder(tmp_path / "out.mcap", toy_bundle(), START_s)
    assert "phytac-design[recordings]" in str(found.value)
    assert not (tmp_path / "out.mcap").exists()


def test_the_commands(tmp_path: Path) -> None:
    toy_recording(tmp_path, [{}, {7: 3.0}])
    done = phytac("decode", "decoder", "frames", "--rest-first", "1", "--mcap", "out.mcap",
                  "--csv", "out.csv", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(read((tmp_path / "out.mcap").read_bytes())["/phytac/wrench"]) > 0
