"""Results move to their folder whole: a full disk leaves what was there."""

import errno
import shutil
from pathlib import Path

import pytest

from phytac_design.training.result_folder import reserve_folder, write_folder
from tests.refusals import refused


@pytest.mark.parametrize("fails_at", [1, 2, 3])
def test_a_full_disk_leaves_the_old_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails_at: int
) -> None:
    names = ("bundle.json", "bundle.safetensors", "training.json")
    for name in names:
        (tmp_path / name).write_text("old")
    copy, done = shutil.copyfile, []

    def full(source: Path, target: Path) -> Path:
        done.append(source)
        if len(done) == fails_at:
            raise OSError(errno.ENOSPC, "No space left on device")
        return Path(copy(source, target))

    monkeypatch.setattr(shutil, "copyfile", full)

    def train() -> None:
        with write_folder(tmp_path, "training.json") as scratch:
            for name in names:
                (scratch / name).write_text("new")

    with refused("output-not-writable"):
        train()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(
        names, "old"
    )


def test_two_runs_into_one_folder_are_refused(tmp_path: Path) -> None:
    """Or both would report success, and one result would be lost."""
    out = tmp_path / "result"
    with reserve_folder(out, "training.json", "mine", force=False):
        with (
            refused("output-locked") as caught,
            reserve_folder(out, "training.json", "mine", force=True),
        ):
            pass
        caught.match("another run is writing to")
        (out / "training.json").write_text('{"design": "mine"}')
    with reserve_folder(out, "training.json", "mine", force=False):
        pass
    assert [path.name for path in out.iterdir()] == ["training.json"]
