"""Regressions on marker displacements, judged on an elastic half-space."""

import inspect
import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from phytac_design.training.marker_regression import MarkerData, fit, judge
from phytac_design.workflows.marker_data import read_marker_data
from tests.refusals import refused
from tests.test_cli import phytac

MODULUS_MPa, POISSON, DEPTH_mm = 0.3, 0.48, 2.0
NOISE_mm = 0.002


def half_space(rng: np.random.Generator, episodes: int, frames: int = 8) -> dict[str, np.ndarray]:
    """Markers 2 mm below an elastic half-space, by Boussinesq (normal) and Cerruti (tangential).

    Each episode is a press at a place of its own, with growing force, by five equal points.
    """
    grid = np.linspace(-9.0, 9.0, 7)
    marks = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    shear, nu, z = MODULUS_MPa / (2.0 * (1.0 + POISSON)), POISSON, DEPTH_mm
    seen, felt = [], []
    for _ in range(episodes):
        place, most = rng.uniform(-5.0, 5.0, 2), rng.uniform(0.5, 3.0)
        slope = rng.uniform(-0.4, 0.4, 2)
        for share in (np.arange(frames) + 1.0) / frames:
            force = share * most * np.array([slope[0], slope[1], 1.0])
            moved = np.zeros_like(marks)
            for offset in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
                x, y = (marks - place - 1.5 * np.array(offset)).T
                r, big = np.hypot(x, y), np.sqrt(x**2 + y**2 + z**2)
                radial = r * z / big**3 - (1.0 - 2.0 * nu) * r / (big * (big + z))
                moved += 0.2 * force[2] * (radial / np.maximum(r, 1e-9) * [x, y]).T
                own = (1.0 - 2.0 * nu) / (big + z)
                cross = x * y / big**3 - own * x * y / (big * (big + z))
                along = [1 / big + c**2 / big**3 + own * (1 - c**2 / (big * (big + z)))
                         for c in (x, y)]  # fmt: skip
                moved += 0.2 * np.stack(
                    [force[0] * along[0] + force[1] * cross,
                     force[0] * cross + force[1] * along[1]], axis=1)  # fmt: skip
            moved /= 4.0 * np.pi * shear
            seen.append(moved + rng.normal(scale=NOISE_mm, size=moved.shape))
            felt.append(force)
    ends = frames * (1 + np.arange(episodes))
    return {"markers": np.array(seen), "force": np.array(felt), "episode_ends": ends}


def as_data(made: dict[str, np.ndarray]) -> MarkerData:
    frames = len(made["force"])
    return MarkerData(
        displacement=made["markers"].reshape(frames, -1),
        wrench=made["force"],
        episode=np.searchsorted(made["episode_ends"], np.arange(frames), side="right"),
    )


def test_the_figure_is_the_error_on_other_presses() -> None:
    data = as_data(half_space(np.random.default_rng(1), 180, frames=3))
    found = judge(data)
    other = as_data(half_space(np.random.default_rng(2), 200, frames=3))
    for name in ("ridge", "kernel"):
        predict, half_width = fit(name, data)
        error = np.abs(predict(other.displacement) - other.wrench)
        ratio = found[name].mean_error / error.mean(axis=0)
        # Four fifths of the presses are learnt from where a figure is made.
        assert np.all((ratio > 0.75) & (ratio < 1.5)), (name, ratio)
        assert np.all((found[name].covered > 0.8) & (found[name].covered < 0.97))
        assert np.all((error <= half_width).mean(axis=0) > 0.8)
    assert np.all(found["ridge"].rms_error < 0.5 * found["mean"].rms_error)


def test_episodes_are_held_out_whole() -> None:
    # Markers tell the episode, and the force is one of the episode: nothing can be learnt.
    rng = np.random.default_rng(3)
    episode = np.repeat(np.arange(40), 10)
    print_, force = rng.normal(size=(40, 30)), rng.normal(size=(40, 3))
    noise = rng.normal(scale=1e-3, size=(400, 30))
    data = MarkerData(displacement=print_[episode] + noise, wrench=force[episode], episode=episode)
    found = judge(data)
    for name in ("ridge", "kernel"):
        assert np.all(found[name].rms_error > 0.9 * force.std(axis=0))


@pytest.mark.parametrize("layout", ["npz", "zarr", "zip"])
def test_the_command(layout: str, tmp_path: Path) -> None:
    made = half_space(np.random.default_rng(4), 12)
    if layout == "npz":
        names = ("markers", "force")
        np.savez(tmp_path / "data.npz", **made)
        source = tmp_path / "data.npz"
    else:
        # As FTP-1 and Tacinf have it: positions of two pads, version 2 of the format.
        zarr = pytest.importorskip("zarr", reason="zarr is not installed (extra zarr)")
        source, names = (
            tmp_path / "task.zarr",
            tuple(f"right_tactile_data_{key}" for key in ("marker", "force")),
        )
        root = zarr.open_group(source, mode="w", zarr_format=2)
        data, meta = root.create_group("data"), root.create_group("meta")
        for name, key in zip(names, ("markers", "force"), strict=True):
            two = np.stack([np.zeros_like(made[key]), made[key]], axis=1)
            data.create_array(name, data=two)
        meta.create_array("episode_ends", data=made["episode_ends"])
        if layout == "zip":
            shutil.make_archive(str(source), "zip", root_dir=tmp_path, base_dir=source.name)
            source = tmp_path / "task.zarr.zip"
    words = ("import-markers", str(source), "--markers", names[0], "--wrench", names[1])
    words += ("--pad", "1", "--out", str(tmp_path / "again.npz"))
    done = phytac(*words, "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert (facts["frames"], facts["episodes"], facts["notes"]) == (96, 12, [])
    expected = judge(as_data(made))
    for name, one in facts["held_out"].items():
        assert one["mean_error"] == pytest.approx(expected[name].mean_error.tolist())
    again = phytac("import-markers", str(tmp_path / "again.npz"), "--markers", "displacement",
                   "--wrench", "wrench")  # fmt: skip
    assert again.stdout.startswith("96 frames of 12 episodes")
    (row,) = re.findall(r"^kernel +2 +(\S+)", again.stdout, re.MULTILINE)
    assert float(row) == pytest.approx(expected["kernel"].mean_error[2], rel=1e-3)


def test_what_cannot_be_judged_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = half_space(np.random.default_rng(5), 4), tmp_path / "data.npz"
    np.savez(path, **made)
    data, notes = read_marker_data(path, "markers", "force")
    assert notes == []
    with refused("marker-episodes-few"):
        judge(data)
    for name in ("none", "force"):
        np.savez(path, **made | {"force": np.ones((32, 3))})
        with refused("marker-data-array"):
            read_marker_data(path, "markers", name)
    for ends in ([5, 99], []):
        np.savez(path, **made | {"episode_ends": np.array(ends)})
        with refused("marker-data-array"):
            read_marker_data(path, "markers", "force")
    made["markers"][3, 0, 0] = np.nan
    del made["episode_ends"]
    np.savez(path, **made)
    data, notes = read_marker_data(path, "markers", "force", rest_first=True)
    assert len(data.wrench) == 31
    assert [note.partition(":")[0] for note in notes] == [
        "no episodes",
        "1 of 1 first frames are not at rest",
        "1 of 32 frames left out",
    ]
    monkeypatch.setitem(sys.modules, "zarr", None)
    with refused("missing-library"):
        read_marker_data(tmp_path / "task.zarr", "markers", "force")
    path.write_bytes(b"no file of this kind")
    with refused("file-unreadable"):
        read_marker_data(path, "markers", "force")


def damaged(made: dict[str, np.ndarray], what: str) -> dict[str, np.ndarray]:
    """Arrays as a user may have them by mistake."""
    force, ends, markers = made["force"], made["episode_ends"], made["markers"]
    gaps, column = markers.copy(), force.copy()
    gaps[:, 3], column[:, 2] = np.nan, np.nan
    changed: dict[str, object] = {
        "a marker that is never seen": {"markers": gaps},
        "a component that is never there": {"force": column},
        "markers that do not move": {"markers": np.ones_like(markers)},
        "markers of another type": {"markers": markers * 1e200},
        "forces of another type": {"force": force * 1e200},
        "no frames": {"markers": markers[:0], "force": force[:0]},
        "ends in a column": {"episode_ends": ends[:, None]},
        "no ends": {"episode_ends": ends[:0]},
        "one end, a number": {"episode_ends": np.array(len(force))},
        "ends as text": {"episode_ends": ends.astype(str)},
        "ends with a gap": {"episode_ends": np.append(ends[:-1].astype(float), np.nan)},
        "ends between frames": {"episode_ends": ends - 0.5},
        "begins in place of ends": {"episode_ends": np.append(0, ends[:-1])},
        "ends below 0": {"episode_ends": np.append(-8, ends[1:])},
    }
    return made | changed[what]


DAMAGES = re.findall(r'^ {8}"([^"]+)": \{', inspect.getsource(damaged), re.MULTILINE)


@pytest.mark.parametrize("what", DAMAGES)
def test_damaged_arrays_are_refused(what: str, tmp_path: Path) -> None:
    path = tmp_path / "data.npz"
    np.savez(path, **damaged(half_space(np.random.default_rng(6), 10), what))
    with refused("marker-data-array"):
        read_marker_data(path, "markers", "force")


@pytest.mark.parametrize("content", [b"", b"PK", "bare", "cut"])
def test_files_that_are_no_npz_are_refused(content: bytes | str, tmp_path: Path) -> None:
    path = tmp_path / "data.npz"
    with path.open("wb") as file:
        np.save(file, np.ones(3)) if content == "bare" else np.savez(file, markers=np.ones(999))
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "cut":
        path.write_bytes(path.read_bytes()[:4000])
    with refused("file-unreadable"):
        read_marker_data(path, "markers", "markers2")


def test_forces_are_not_read_from_themselves(tmp_path: Path) -> None:
    np.savez(tmp_path / "data.npz", **half_space(np.random.default_rng(7), 10))
    with refused("marker-data-array"):
        read_marker_data(tmp_path / "data.npz", "force", "force")


def test_first_frames_that_are_pressed_are_named(tmp_path: Path) -> None:
    made, path = half_space(np.random.default_rng(8), 10), tmp_path / "data.npz"
    np.savez(path, **made)
    _, notes = read_marker_data(path, "markers", "force", rest_first=True)
    (note,) = notes
    assert re.match(r"[1-9]\d* of 10 first frames are not at rest", note)
    made["force"][::8] = 0.0  # as after a tare
    np.savez(path, **made)
    assert read_marker_data(path, "markers", "force", rest_first=True)[1] == []


def test_a_constant_component_changes_no_other_figure() -> None:
    made = half_space(np.random.default_rng(9), 12)
    two = as_data(made | {"force": made["force"][:, :2]})
    made["force"][:, 2] = 0.3
    three = judge(as_data(made))
    for name, one in judge(two).items():
        np.testing.assert_allclose(three[name].rms_error[:2], one.rms_error, rtol=1e-9)


def test_data_that_say_nothing_are_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    made, path = half_space(rng, 12), tmp_path / "data.npz"
    np.savez(path, **made)
    words = ("import-markers", str(path), "--markers", "markers", "--wrench", "force", "--json")
    assert json.loads(phytac(*words).stdout)["notes"] == []
    made["force"] = rng.permutation(made["force"])
    np.savez(path, **made)
    (note,) = json.loads(phytac(*words).stdout)["notes"]
    assert note.startswith("no estimator is much better than the mean of force")


def test_missing_and_damaged_chunks(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="zarr is not installed (extra zarr)")
    made, source = half_space(np.random.default_rng(11), 12), tmp_path / "task.zarr"
    root = zarr.open_group(source, mode="w", zarr_format=2)
    data = root.create_group("data")
    for name in ("markers", "force"):
        data.create_array(name, data=made[name], chunks=(8, *made[name].shape[1:]))
    root.create_group("meta").create_array("episode_ends", data=made["episode_ends"])
    with refused("marker-data-array") as caught:
        read_marker_data(source, "markers", "wrench")
    assert "(it has: force, markers)" in str(caught.value)
    assert read_marker_data(source, "markers", "force")[1] == []
    (source / "data/markers/3.0.0").unlink()
    (note,) = read_marker_data(source, "markers", "force")[1]
    assert note.startswith("1 of 12 chunks of data/markers are not there and read as 0.0")
    (source / "data/markers/3.0.0").write_bytes(b"xx")
    with refused("file-unreadable"):
        read_marker_data(source, "markers", "force")
