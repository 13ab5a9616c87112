"""Recordings as Zarr in the layout of FTP-1, and what a kill leaves of all formats."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phytac_design.core import zarr_recording
from phytac_design.core.zarr_recording import ZarrRecorder
from tests.decoder.toy_sensor import toy_recording
from tests.refusals import refused
from tests.test_cli import phytac
from tests.test_mcap import frames, messages

zarr = pytest.importorskip("zarr", reason="zarr is not installed (extra zarr)")


def test_rows_are_what_the_stream_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Written in parts, as a long stream is.
    monkeypatch.setattr(zarr_recording, "CHUNK_s", 0.0)
    path = tmp_path / "cup.zarr"
    with ZarrRecorder(path, 30, task="hold the cup", side="left", area=1) as recorder:
        for message in frames(messages(), 3):
            recorder.add(message)
        recorder.end_episode()
        for message in frames(messages(), 2):
            recorder.add(message)
    assert recorder.rows == 5
    store = zarr.open_group(path, mode="r")
    assert store.metadata.zarr_format == 2
    assert store["meta/episode_ends"][:].tolist() == [3, 5]
    data = dict(store["data"].arrays())
    assert {array.shape[0] for array in data.values()} == {5}
    # FTP-1: four aligned arrays for each tactile group.
    groups = {found[1] for name in data if (found := re.fullmatch(r"left_tactile_data_(.*)", name))}
    assert groups == {"wrench", "contacts", "switches"}
    for group in groups:
        assert data[f"left_tactile_area_{group}"][:].tolist() == [[1]] * 5
        assert set(data[f"left_tactile_sensor_{group}"][:]) == {"PhyTac"}
        assert data[f"left_tactile_data_{group}"].ndim >= 3
    assert set(data["left_tactile_type_wrench"][:]) == {"state"}
    assert set(data["left_tactile_type_switches"][:]) == {"binary"}
    assert set(data["sub_task_instruction"][:]) == {"hold the cup"}
    assert data["timestamps"][:].tolist() == [0.0, 0.25, 0.5, 0.0, 0.25]
    # The second frame of each is black.
    assert data["phytac_valid"][:].tolist() == [True, False, True, True, False]
    assert data["left_tactile_data_wrench"][:, 0, 2].tolist() == [-4.5, 0.0, -4.5, -4.5, 0.0]
    # About the frame's origin, whatever point the stream's are about.
    origin = frames(replace(messages(), moment_about_mm=(0.0, 0.0, 0.0)), 2)[0]["net_moment_Nmm"]
    assert origin != frames(messages(), 2)[0]["net_moment_Nmm"]
    about = data["left_tactile_data_wrench"][0, 0, 3:6]
    assert about.tolist() == pytest.approx(origin, rel=1e-4)
    assert np.flatnonzero(data["left_tactile_data_switches"][0, 0]).tolist() == [7, 14, 28]
    strongest = data["left_tactile_data_contacts"][0, 0, 0].tolist()
    assert strongest == pytest.approx([4.0, 0.0, 12.5, 12.5, 0.0])


def test_a_recording_is_resumed_without_rows_of_no_episode(tmp_path: Path) -> None:
    path = tmp_path / "out.zarr"
    with ZarrRecorder(path, 30) as recorder:
        for _ in range(300):  # more than a chunk
            recorder.add(frames(messages(), 2)[0])
    # As if it was killed between an array and the episode's end.
    array = zarr.open_group(path, mode="r+")["data/timestamps"]
    array.resize((304,))
    array[300:] = 9.0
    with ZarrRecorder(path, 30, resume=True) as recorder:
        for message in frames(messages(), 2):
            recorder.add(message)
    store = zarr.open_group(path, mode="r")
    assert store["meta/episode_ends"][:].tolist() == [300, 302]
    assert store["data/timestamps"][:].tolist() == [0.0] * 301 + [0.25]
    assert (store["data/right_tactile_data_wrench"][:-1, 0, 2] == -4.5).all()
    with refused("output-exists"):
        ZarrRecorder(path, 30)
    with refused("zarr-recording-invalid"):
        ZarrRecorder(path, 31, resume=True)


def test_a_full_disk_leaves_whole_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, made = tmp_path / "out.zarr", [frames(messages(), 2)[0]] * 3
    write, calls = zarr_recording._write, list[Path]()

    def until_full(where: Path, data: bytes) -> None:
        calls.append(where)
        if len(calls) == 9:  # between arrays
            raise OSError(28, "No space left on device")
        write(where, data)

    with ZarrRecorder(path, 30) as recorder:
        recorder.add(made[0])
        recorder.flush()
        monkeypatch.setattr(zarr_recording, "_write", until_full)
        recorder.add(made[1])
        with refused("output-not-writable"):
            recorder.flush()
        recorder.add(made[2])
    # Nothing was written after the failure.
    assert len(calls) == 9
    monkeypatch.undo()
    with ZarrRecorder(path, 30, resume=True) as recorder:
        recorder.add(made[2])
    store = zarr.open_group(path, mode="r")
    assert store["meta/episode_ends"][:].tolist() == [1, 2]
    assert {array.shape[0] for _, array in store["data"].arrays()} == {2}


def test_the_command(tmp_path: Path) -> None:
    toy_recording(tmp_path, [{}, {7: 3.0}])
    words = ("serve", "decoder", "frames", "--rest-first", "1", "--port", "0", "--every")
    done = phytac(*words, "--record", "out.zarr", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("2 rows in out.zarr\n")
    store = zarr.open_group(tmp_path / "out.zarr", mode="r")
    assert store["data/right_tactile_data_switches"][1, 0].argmax() == 7


def test_a_kill_loses_less_than_a_second_of_each_format(tmp_path: Path) -> None:
    for name in ("mcap", "rerun.chunk", "pyarrow"):
        pytest.importorskip(name)
    from benchmarks.connect_kills import lost_frames

    make = messages()
    pressed = frames(make, 3, rate_Hz=30.0)[2]
    stream = [{**pressed, "sequence": k, "timestamp_s": k / 30.0} for k in range(300)]
    lost = lost_frames(make.bundle, stream, tmp_path, seconds=2.0)
    assert len(lost) == 6
    assert all(count < 30 for count in lost.values()), lost
    assert max(lost["CSV"], lost["Parquet (phytac convert)"], lost["LeRobot (resumed)"]) <= 1
