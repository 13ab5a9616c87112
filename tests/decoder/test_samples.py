"""Data sets on disk: what is written comes back, and how they are shared out."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phytac_design.datasets import samples_file
from phytac_design.datasets.samples import split_sequences
from phytac_design.datasets.samples_file import (
    ARRAYS,
    COUNTS,
    file_hash,
    read_samples,
    write_samples,
)
from tests.decoder.drawn_samples import META, assert_same, drawn
from tests.refusals import refused

SHIFT_STEP_PX = 2.0**-9

PAGE = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def fast_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without waiting for the disk."""
    monkeypatch.setattr(samples_file.os, "fsync", lambda _: None)


@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 12),
    markers=st.integers(1, 20),
    keep=st.sampled_from(["all", "points", "inputs"]),
)
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
def test_what_is_written_comes_back(
    tmp_path: Path, seed: int, count: int, markers: int, keep: str
) -> None:
    made = drawn(seed, count, markers, keep=keep)
    write_samples(tmp_path, made, META)
    got, meta = read_samples(tmp_path, expect_design_hash=META.design_hash)
    assert_same(got, made)
    assert meta == META
    before = [(tmp_path / name).read_bytes() for name in ("samples.npz", "dataset.json")]
    write_samples(tmp_path, made, META)
    again = [(tmp_path / name).read_bytes() for name in ("samples.npz", "dataset.json")]
    assert before == again
    # Rounded numbers are not rounded further.
    write_samples(tmp_path, got, META)
    assert (tmp_path / "samples.npz").read_bytes() == before[0]
    assert_same(read_samples(tmp_path)[0], got, exact=True)


def test_ranges_that_16_bits_do_not_hold() -> None:
    """Large numbers are stored as float32, in the same steps."""
    made = drawn(1)
    assert made.shift_px is not None
    assert made.key_nodes is not None
    shift = made.shift_px.copy()
    shift[2, 3] = (-900.03, 70.01)
    force = made.key_nodes.force_N.copy()
    force[0] = 130.7
    made = replace(made, shift_px=shift, key_nodes=replace(made.key_nodes, force_N=force))
    arrays, scales = samples_file._stored(made, "test")
    assert arrays["shift_px"].dtype == np.float32
    assert arrays["key_force_N"].dtype == np.float32
    assert arrays["key_u_mm"].dtype == np.int16
    assert scales["shift_px"] == {"scale": 1.0, "step": SHIFT_STEP_PX}
    np.testing.assert_allclose(arrays["shift_px"], shift, rtol=0, atol=SHIFT_STEP_PX / 2)
    edge = np.array([[[32767.0, -32767.0]]]) * SHIFT_STEP_PX
    assert samples_file._rounded(edge, SHIFT_STEP_PX, "shift_px")[0].dtype == np.int16
    over = np.array([[[-32768.0, 0.0]]]) * SHIFT_STEP_PX
    assert samples_file._rounded(over, SHIFT_STEP_PX, "shift_px")[0].dtype == np.float32


def test_large_data_come_back(tmp_path: Path) -> None:
    made = drawn(5, 20, keep="points")
    assert made.shift_px is not None
    far = replace(made, shift_px=made.shift_px * 40.0)
    write_samples(tmp_path, far, META)
    assert_same(read_samples(tmp_path)[0], far)


def test_the_table_of_arrays_is_true() -> None:
    """Every array of docs/datasets.md with part, shape, types and unit, in the file's order."""
    row = r"^\| `(\w+)` \| (\w+) \| \((.*?)\) \| (.*?) \| (.*?) \|"
    rows = re.findall(row, PAGE, re.MULTILINE)
    letters = dict(zip(COUNTS, "snctkr", strict=True))
    expected = [
        (
            name,
            stored.part,
            ", ".join(letters.get(str(size), str(size)) for size in stored.shape),
            " or ".join(np.dtype(kind).name for kind in stored.kinds),
            stored.unit,
        )
        for name, stored in ARRAYS.items()
    ]
    assert rows == expected


def test_files_can_be_read_with_numpy_alone(tmp_path: Path) -> None:
    """The five lines of docs/datasets.md."""
    made = drawn(8)
    write_samples(tmp_path / "data", made, META)
    code = PAGE.split("```python\n")[1].split("```")[0]
    out = subprocess.run(
        [sys.executable, "-c", code + "\nprint(shift_px[2, 3, 0], len(z['truth_force_N']))"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert made.shift_px is not None
    assert made.truth is not None
    first, rows = out.stdout.split()
    assert float(first) == pytest.approx(made.shift_px[2, 3, 0], abs=SHIFT_STEP_PX / 2)
    assert int(rows) == len(made.truth.force_N)


def test_samples_that_do_not_fit_are_not_written(tmp_path: Path) -> None:
    made = drawn(2)
    with refused("samples-status-inconsistent"):
        write_samples(tmp_path, replace(made, status=made.status * 0 + 2), META)
    with refused("samples-array-shape"):
        write_samples(tmp_path, replace(made, light=made.light[:3]), META)
    with refused("samples-points-incomplete"):
        write_samples(tmp_path, replace(made, bits=None), META)
    with refused("samples-not-whole-numbers"):
        write_samples(tmp_path, replace(made, status=made.status - 5), META)
    with refused("samples-notes-invalid"):
        write_samples(tmp_path, made, replace(META, notes={"x": float("nan")}))
    assert list(tmp_path.iterdir()) == []


def test_a_crash_leaves_the_old_data_or_a_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, new = drawn(3), drawn(4)
    write_samples(tmp_path, old, META)
    was = read_samples(tmp_path)[0]
    real, calls = Path.replace, [0]
    for stop in (0, 1):
        write_samples(tmp_path, old, META)
        calls[0] = 0

        def replace_once(self: Path, target: Path, stop: int = stop) -> Path:
            if calls[0] == stop:
                raise KeyboardInterrupt
            calls[0] += 1
            return real(self, target)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", replace_once)
            with pytest.raises(KeyboardInterrupt):
                write_samples(tmp_path, new, META)
        if stop == 0:
            assert_same(read_samples(tmp_path)[0], was, exact=True)
        else:
            with refused("data-set-altered"):
                read_samples(tmp_path)
    write_samples(tmp_path, new, META)
    assert_same(read_samples(tmp_path)[0], new)


def test_a_crash_of_the_first_writing_leaves_no_data_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``dataset.json`` comes last: where it stands, a data set was finished."""
    real = Path.replace

    def stop_at_table(self: Path, target: Path) -> Path:
        if target.name == "dataset.json":
            raise KeyboardInterrupt
        return real(self, target)

    monkeypatch.setattr(Path, "replace", stop_at_table)
    with pytest.raises(KeyboardInterrupt):
        write_samples(tmp_path, drawn(4), META)
    assert (tmp_path / "samples.npz").exists()
    assert not (tmp_path / "dataset.json").exists()


def test_frames_are_listed_and_checked(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    names = ["000000.png", "000000_far.png", "000006.jpg"]
    for name in names:
        (tmp_path / "frames" / name).write_bytes(name.encode())
    meta = write_samples(tmp_path, drawn(6), META, frames=names)
    assert list(meta.frames) == names
    assert meta.frames["000006.jpg"] == file_hash(tmp_path / "frames" / "000006.jpg")
    assert read_samples(tmp_path, check_frames=True)[1] == meta
    with refused("samples-picture-name") as caught:
        write_samples(tmp_path, drawn(6), META, frames=["000007.png"])
    caught.match(r"000007\.png")
    (tmp_path / "frames" / "000000_far.png").write_bytes(b"other")
    read_samples(tmp_path)
    with refused("data-set-picture-altered") as caught:
        read_samples(tmp_path, check_frames=True)
    caught.match(r"000000_far\.png")
    (tmp_path / "frames" / "000000_far.png").unlink()
    with refused("file-unreadable") as caught:
        read_samples(tmp_path, check_frames=True)
    caught.match(r"000000_far\.png")


# Sharing out.


@given(seed=st.integers(0, 1000), count=st.integers(30, 200), press=st.integers(1, 8))
@settings(max_examples=40, deadline=None)
def test_a_sequence_stays_on_one_side(seed: int, count: int, press: int) -> None:
    made = drawn(seed, count, 1, keep="inputs")
    made = replace(made, sequence=np.arange(count) // press)
    shares = (0.7, 0.1, 0.2)
    parts = split_sequences(made, shares, seed=seed)
    usable = np.flatnonzero(made.status != 2)
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), usable)
    owners = [set(made.sequence[part].tolist()) for part in parts]
    assert sum(map(len, owners)) == len(set().union(*owners))
    for part, share in zip(parts, shares, strict=True):
        assert len(part) > 0
        assert abs(len(part) - share * len(usable)) <= press
    again = split_sequences(made, shares, seed=seed)
    assert all(np.array_equal(a, b) for a, b in zip(parts, again, strict=True))


def test_another_seed_is_another_split() -> None:
    made = replace(drawn(1, 100, keep="inputs"), sequence=np.arange(100))
    first, second = (split_sequences(made, (0.5, 0.5), seed=seed)[0] for seed in (0, 1))
    assert not np.array_equal(first, second)


def test_shares_that_cannot_be() -> None:
    made = drawn(1, 30)
    with refused("split-shares-invalid"):
        split_sequences(made, (0.5, 0.4), seed=0)
    with refused("split-shares-invalid"):
        split_sequences(made, (1.5, -0.5), seed=0)
    one = replace(made, sequence=np.zeros(30, dtype=np.int64))
    with refused("split-sequences-too-few"):
        split_sequences(one, (0.5, 0.5), seed=0)
