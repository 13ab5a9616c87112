"""A flipped byte in a cached file is found, reported and repaired; exports stay correct."""

import json
import shutil
from pathlib import Path

import pytest

from phytac_design.engine.cache import damaged_file
from phytac_design.stages.build import BuildResult, build
from tests.coarse_switches import coarse_bowls
from tests.designs import small

REBUILT = {".stl", ".3mf", ".gcode", ".npz", ".json", ".safetensors", ".png"}
"""Kinds of file whose stage is run again: what is written by libraries of many kinds."""


def flip(path: Path) -> None:
    """Change one bit in the middle of a file."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def hashes(out: Path) -> dict[str, str]:
    """SHA-256 of each file that a manifest lists."""
    files = json.loads((out / "manifest.json").read_text())["files"]
    return {item["path"]: item["sha256"] for item in files}


@pytest.mark.long
def test_one_flipped_byte_in_each_kind_of_file(
    built: BuildResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "cache"
    for stage, folder in built.folders.items():
        shutil.copytree(folder, own / stage / folder.name)
    monkeypatch.setenv("PHYTAC_CACHE", str(own))
    # Of each kind the file whose stage takes least to compute again; not of stages that are left
    # out of a draft, unless they are named.
    made = [name for name, folder in built.folders.items() if (folder / "export").is_dir()]
    kinds: dict[str, Path] = {}
    for stage in sorted(made, key=built.timing_s.__getitem__):
        for path in sorted((own / stage).rglob("*")):
            if path.is_file() and path.stat().st_size:
                kinds.setdefault(path.suffix, path)
    assert set(kinds) >= REBUILT
    for path in kinds.values():
        folder = own.joinpath(*path.relative_to(own).parts[:2])
        assert damaged_file(folder) == ""
        flip(path)
        assert damaged_file(folder) in {path.relative_to(folder).as_posix(), "stage.json"}
        flip(path)
    overwritten = [kinds[kind] for kind in sorted(REBUILT)]
    for path in overwritten:
        flip(path)
    damaged = {path.relative_to(own).parts[0] for path in overwritten}
    reports: list[str] = []
    with coarse_bowls():
        again = build(
            small(), tmp_path / "out", accuracy="draft", only=[*damaged], progress=reports.append
        )
    warned = {line.split(" is damaged")[0].split()[-1] for line in reports if "damaged" in line}
    # Stages whose inputs were computed again may have another key, and then nothing to report.
    assert {"kit", "shell", "decoder"} <= warned <= damaged
    assert damaged <= set(again.ran)
    first, second = hashes(built.out), hashes(again.out)
    assert second
    assert second == {name: first[name] for name in second}
