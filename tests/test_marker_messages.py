"""Markers and wrenches of MCAP files with ROS 2 messages, which the format's own library writes."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.pipeline.frame_reading import Reading
from phytac_design.core.mcap_recording import McapRecorder
from phytac_design.training.marker_regression import judge
from phytac_design.workflows.marker_data import read_marker_data
from tests.refusals import refused
from tests.test_cli import phytac
from tests.test_marker_data import as_data, half_space
from tests.test_mcap import messages

mcap_writer = pytest.importorskip("mcap_ros2.writer", reason="no mcap-ros2-support (recordings)")
typesys = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
FIELD = "my_msgs/msg/Tracked"
STORE.register(
    typesys.get_types_from_msg("std_msgs/Header header\nfloat64[] moved_mm\nstring by", FIELD)
)
STAMPED = "geometry_msgs/msg/WrenchStamped"
FRAMES, START_NS = 8, 1_700_000_000 * 10**9
PERIOD_NS, APART_NS = 33_000_000, 2_000_000_000
"""Of frames, and of episodes."""


def thing(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**fields)


def xyz(values: Any) -> SimpleNamespace:
    return thing(**dict(zip("xyz", (*map(float, values), 0.0), strict=False)))


def header(at_ns: int) -> SimpleNamespace:
    sec, nanosec = divmod(at_ns, 10**9)
    return thing(stamp=thing(sec=sec, nanosec=nanosec), frame_id="pad")


def as_array(_: int, moved: np.ndarray) -> Any:
    return thing(layout=thing(dim=[], data_offset=0), data=moved.ravel().tolist())


def as_field(at_ns: int, moved: np.ndarray) -> Any:
    return thing(header=header(at_ns), moved_mm=moved.ravel().tolist(), by="a tracker")


def as_markers(at_ns: int, moved: np.ndarray) -> Any:
    """Spheres in an order of their own, after the action that deletes those of before."""
    order = np.random.default_rng(at_ns % 2**32).permutation(len(moved)).tolist()
    shown = [(number, 0, moved[number]) for number in order]
    nothing = xyz((0, 0, 0))
    return thing(
        markers=[
            thing(
                header=header(at_ns), ns="", id=number, type=2, action=action,
                pose=thing(position=xyz(place), orientation=thing(x=0.0, y=0.0, z=0.0, w=1.0)),
                scale=nothing, color=thing(r=0.0, g=0.0, b=0.0, a=1.0),
                lifetime=thing(sec=0, nanosec=0), frame_locked=False, points=[], colors=[],
                texture_resource="", texture=thing(header=header(0), format="", data=b""),
                uv_coordinates=[], text="", mesh_resource="",
                mesh_file=thing(filename="", data=b""), mesh_use_embedded_materials=False,
            )
            for number, action, place in [(0, 3, (9.0, 9.0)), *shown]
        ]
    )  # fmt: skip


def as_cloud(at_ns: int, moved: np.ndarray) -> Any:
    """Intensity and places, with a word of nothing after each point."""
    points = np.zeros(len(moved), dtype=[("i", "f4"), ("x", "f4"), ("y", "f4"), ("z", "f4"),
                                         ("none", "f4")])  # fmt: skip
    points["x"], points["y"], points["i"] = *moved.T, 77.0
    fields = [
        thing(name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate(("intensity", "x", "y", "z"))
    ]
    return thing(
        header=header(at_ns), height=1, width=len(moved), fields=fields, is_bigendian=False,
        point_step=20, row_step=20 * len(moved), data=points.tobytes(), is_dense=True,
    )  # fmt: skip


def as_wrench(_: int, force: np.ndarray) -> Any:
    return thing(force=xyz(force), torque=xyz((0, 0, 0)))


def as_stamped(at_ns: int, force: np.ndarray) -> Any:
    return thing(header=header(at_ns), wrench=as_wrench(at_ns, force))


KINDS = {
    "std_msgs/msg/Float64MultiArray": as_array,
    FIELD: as_field,
    "visualization_msgs/msg/MarkerArray": as_markers,
    "sensor_msgs/msg/PointCloud2": as_cloud,
    "geometry_msgs/msg/Wrench": as_wrench,
    STAMPED: as_stamped,
}


class File:
    """MCAP file, one message after the other."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self.writer, self._schemas = mcap_writer.Writer(self._file), dict[str, Any]()

    def add(self, topic: str, kind: str, message: Any, recorded_ns: int) -> None:
        if kind not in self._schemas:
            text, _ = STORE.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self.writer.register_msgdef(kind, text)
        self.writer.write_message(topic, self._schemas[kind], message, log_time=recorded_ns)

    def close(self) -> None:
        self.writer.finish()
        self._file.close()


@contextmanager
def written(path: Path) -> Iterator[File]:
    file = File(path)
    yield file
    file.close()


def record(
    path: Path,
    made: dict[str, np.ndarray],
    rows: range,
    kinds: tuple[str, str],
    *,
    late: bool = False,
    start_ns: int = START_NS,
) -> None:
    """Rows of a data set: markers at 30 Hz, and five wrenches a frame of which one is the row's.

    With ``late``, messages reach the recorder up to 20 ms late, each at its own time.
    """
    rng = np.random.default_rng(len(rows))
    with written(path) as file:
        for row in rows:
            episode, frame = divmod(row, FRAMES)
            at_ns = start_ns + episode * APART_NS + frame * PERIOD_NS
            each = [(at_ns, "/markers", kinds[0], made["markers"][row])]
            for k, force in enumerate((*[np.full(3, 1e3)] * 2, made["force"][row],
                                       *[np.full(3, -1e3)] * 2)):  # fmt: skip
                each.append((at_ns + 1_000_000 + (k - 2) * 6_000_000, "/wrench", kinds[1], force))
            for when_ns, topic, kind, value in each:
                delay_ns = int(rng.integers(20_000_000)) if late else 0
                file.add(topic, kind, KINDS[kind](when_ns, value), when_ns + delay_ns)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("std_msgs/msg/Float64MultiArray", "/markers"),
        (FIELD, "/markers.moved_mm"),
        ("visualization_msgs/msg/MarkerArray", "/markers"),
        ("sensor_msgs/msg/PointCloud2", "/markers"),
    ],
)
def test_the_command(kind: str, name: str, tmp_path: Path) -> None:
    made = half_space(np.random.default_rng(4), 12)
    stamped = "Float" not in kind
    wrench = STAMPED if stamped else "geometry_msgs/msg/Wrench"
    record(tmp_path / "a.mcap", made, range(96), (kind, wrench), late=stamped)
    done = phytac("import-markers", str(tmp_path / "a.mcap"), "--markers", name,
                  "--wrench", "/wrench", "--out", str(tmp_path / "b.npz"), "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "b.npz") as kept:
        places = kept["displacement"].reshape(96, 49, -1)
        assert places[..., :2] == pytest.approx(made["markers"], rel=1e-6, abs=1e-6)
    facts = json.loads(done.stdout)
    assert (facts["frames"], facts["episodes"]) == (96, 12)
    torque = "component 3, 4, 5 of /wrench does not change: its figures mean nothing"
    *clock, last = facts["notes"]
    assert last == torque
    assert ["paired by the time of recording" in note for note in clock] == [True] * (not stamped)
    assert facts["spread"][:3] == pytest.approx(made["force"].std(axis=0).tolist())
    expected = judge(as_data(made))
    for estimator, one in facts["held_out"].items():
        # Moments are zero, and single precision moves the figures a little.
        assert one["mean_error"][3:] == pytest.approx([0.0] * 3, abs=1e-9)
        assert one["mean_error"][:3] == pytest.approx(
            expected[estimator].mean_error.tolist(), rel=1e-2 if "Cloud" in kind else 1e-6
        )


def test_folders_and_bags(tmp_path: Path) -> None:
    made = half_space(np.random.default_rng(6), 12)
    kinds = ("std_msgs/msg/Float64MultiArray", STAMPED)
    for name, rows in (("a", range(44)), ("b", range(44, 96))):
        record(tmp_path / f"{name}.mcap", made, rows, kinds)
    # Two files are two recordings, though the second begins where the first ends.
    data, _ = read_marker_data(tmp_path, "/markers", "/wrench")
    assert np.bincount(data.episode).tolist() == [8] * 5 + [4, 4] + [8] * 6
    assert data.displacement == pytest.approx(made["markers"].reshape(96, -1))
    assert data.wrench[:, :3] == pytest.approx(made["force"])
    # Two parts of a bag are one.
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    data, _ = read_marker_data(tmp_path, "/markers", "/wrench")
    assert np.bincount(data.episode).tolist() == [8] * 12
    # Clocks may restart.
    (tmp_path / "metadata.yaml").unlink()
    record(tmp_path / "b.mcap", made, range(44, 96), kinds, start_ns=START_NS - 11 * APART_NS)
    data, notes = read_marker_data(tmp_path, "/markers", "/wrench", rest_first=True)
    assert len(np.unique(data.episode)) == 13
    assert not data.displacement[[0, 8, 40, 44, 48]].any()
    moved = (made["markers"][47] - made["markers"][44]).ravel()
    assert data.displacement[47] == pytest.approx(moved)
    assert sum("paired by the time of recording" in note for note in notes) == 2
    # Three episodes are too few: blocks are held out, yet each is measured from its own rest.
    record(tmp_path / "a.mcap", made, range(24), kinds)
    (tmp_path / "b.mcap").unlink()
    data, (_, note, *_) = read_marker_data(tmp_path, "/markers", "/wrench", rest_first=True)
    assert note.startswith("3 episodes alone: 20 blocks")
    assert len(np.unique(data.episode)) == 20
    assert not data.displacement[[0, 8, 16]].any()


def test_times_of_different_clocks(tmp_path: Path) -> None:
    made = half_space(np.random.default_rng(7), 10)
    with written(tmp_path / "a.mcap") as file:
        for row in range(80):
            at_ns = START_NS + row * PERIOD_NS
            # The force sensor counts from when it was switched on, and loses each tenth message.
            if row % 10:
                message = as_stamped(at_ns - START_NS + 10**9, made["force"][row])
                file.add("/wrench", STAMPED, message, at_ns + 2_000_000)
            file.add("/markers", FIELD, as_field(at_ns, made["markers"][row]), at_ns)
        # It stops after the camera.
        file.add("/wrench", STAMPED, as_stamped(10**10, np.full(3, 1e3)), START_NS + 10**10)
    data, notes = read_marker_data(tmp_path / "a.mcap", "/markers.moved_mm", "/wrench.wrench.force")
    kept = np.flatnonzero(np.arange(80) % 10)
    assert data.wrench == pytest.approx(made["force"][kept])
    assert data.displacement == pytest.approx(made["markers"].reshape(80, -1)[kept])
    clock, pairs, blocks = (note.removeprefix(f"{tmp_path / 'a.mcap'}: ") for note in notes)
    assert clock.startswith("messages are paired by the time of recording")
    assert pairs.startswith("72 pairs of 80 and 73 messages")
    assert blocks.startswith("no episodes")


def test_recordings_of_our_own(tmp_path: Path) -> None:
    make, path = messages(), tmp_path / "own.mcap"
    forces = 1.0 + np.arange(60) % 5
    with McapRecorder(path, make.bundle, 1.7e9) as recorder:
        for k, force_N in enumerate(forces):
            at, on = np.zeros(30), [7, 14, 28][: 1 + k % 3]
            at[on] = force_N
            reading = Reading(koi=np.array(on), forces_N=at, warnings=[])
            recorder.add(make.frame(reading, sequence=k, timestamp_s=k / 30, decoded_s=k / 30))
    names = ("/phytac/switches", "/phytac/wrench.wrench.force")
    data, notes = read_marker_data(path, *names)
    assert data.displacement.sum(axis=1).tolist() == [1 + k % 3 for k in range(60)]
    assert data.wrench[:, 2] == pytest.approx(-forces * (1 + np.arange(60) % 3))
    assert any(note.startswith(f"{names[1]} is what a decoder reported") for note in notes)
    # A program that was killed leaves messages without an index.
    path.write_bytes(path.read_bytes()[:-3000])
    cut, _ = read_marker_data(path, *names)
    assert 0 < len(cut.wrench) <= 60
    with refused("marker-data-array"):  # one arrow for each contact
        read_marker_data(path, "/phytac/markers", names[1])


def test_what_does_not_fit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = half_space(np.random.default_rng(5), 2), tmp_path / "a.mcap"
    record(path, made, range(16), (FIELD, STAMPED))
    done = phytac("import-markers", str(path), "--markers", "/none", "--wrench", "/wrench")
    assert done.returncode == 4
    assert done.stderr.count("\n") == 1
    assert f"/markers ({FIELD}), /wrench ({STAMPED})" in done.stderr
    for field in ("", ".by", ".none", ".header"):
        with refused("marker-data-array") as found:
            read_marker_data(path, f"/markers{field}", "/wrench")
        assert "header, moved_mm, by" in str(found.value)
    with written(path) as file:
        for k, size in enumerate((4, 4, 6)):
            at_ns = START_NS + k * PERIOD_NS
            file.add("/markers", FIELD, as_field(at_ns, np.zeros(size)), at_ns)
            file.add(
                "/wrench", "geometry_msgs/msg/Wrench", as_wrench(0, np.ones(3)), at_ns + 10**12
            )
            file.add("/picture", "std_msgs/msg/Float64MultiArray", as_array(0, np.zeros(30_001)),
                     at_ns)  # fmt: skip
        file.add("/one", FIELD, as_field(START_NS, np.zeros(4)), START_NS)
    for name, word in (
        ("/markers.moved_mm", "4 to 6 numbers"),
        ("/picture", "not pictures"),
        ("/one.moved_mm", "half a period"),
    ):
        with refused("marker-data-array") as found:
            read_marker_data(path, name, "/wrench")
        assert word in str(found.value)
    from mcap.writer import Writer

    with path.open("wb") as stream:
        other = Writer(stream)
        other.start()
        channel = other.register_channel("/markers", "json", 0)
        other.add_message(channel, log_time=0, publish_time=0, data=b"[1.0]")
        other.finish()
    with refused("file-unreadable") as found:
        read_marker_data(path, "/markers", "/markers.data")
    assert "definitions of ROS 2" in str(found.value)
    whole = path.read_bytes()
    for damaged in (b"", b"no MCAP", whole[:30], whole[:40] + bytes(40) + whole[80:]):
        path.write_bytes(damaged)
        with refused("file-unreadable" if len(damaged) != 30 else "marker-data-array"):
            read_marker_data(path, "/markers", "/markers.data")
    with refused("file-unreadable"):
        read_marker_data(tmp_path / "none.mcap", "/markers", "/wrench")
    monkeypatch.setitem(sys.modules, "mcap_ros2.decoder", None)
    with refused("missing-library") as found:
        read_marker_data(path, "/markers", "/wrench")
    assert "phytac-design[recordings]" in str(found.value)
