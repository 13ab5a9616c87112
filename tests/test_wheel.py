"""The wheel: all that the packages need is in it, and nothing else."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"phytac_shapes": "shapes", "phytac_decoder": "decoder", "phytac_design": "."}
"""Packages, and the folder that holds each."""
LEFT_BEHIND = {".md", ".pyc", ".nbi", ".nbc", ".map"}
"""Files beside the modules that a program does not read: notes, compiled kernels."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel of the working tree, built from a copy: nothing is left in the tree."""
    made = tmp_path_factory.mktemp("wheel")
    source, out = made / "source", made / "out"
    ignore = shutil.ignore_patterns("__pycache__", "node_modules")
    for folder in ("shapes", "decoder", "phytac_design", "tests", "benchmarks", "tools"):
        shutil.copytree(ROOT / folder, source / folder, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, source / name)
    code = f"from setuptools import build_meta; build_meta.build_wheel({str(out)!r})"
    out.mkdir()
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=source,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (path,) = out.glob("*.whl")
    return zipfile.ZipFile(path)


def test_every_file_of_the_packages_is_in_it(wheel: zipfile.ZipFile) -> None:
    packed = {name for name in wheel.namelist() if ".dist-info/" not in name}
    wanted = {
        path.relative_to(ROOT / folder).as_posix()
        for package, folder in PACKAGES.items()
        for path in (ROOT / folder / package).rglob("*")
        if path.is_file() and path.suffix not in LEFT_BEHIND and "node_modules" not in path.parts
    }
    assert wanted - packed == set(), "name it in package-data of pyproject.toml"
    assert packed - wanted == set()


def test_its_command_and_its_parts_are_named(wheel: zipfile.ZipFile) -> None:
    def text(name: str) -> str:
        (path,) = [item for item in wheel.namelist() if item.endswith(f".dist-info/{name}")]
        return wheel.read(path).decode()

    assert "phytac = phytac_design.cli.app:main" in text("entry_points.txt")
    facts = text("METADATA")
    assert "Requires-Dist: numpy>=" in facts
    assert "License-Expression: MIT" in facts
    for extra in ("design", "solid", "study", "studio", "train", "all", "dev"):
        assert f"Provides-Extra: {extra}" in facts


def test_it_runs_where_there_is_no_checkout(wheel: zipfile.ZipFile, tmp_path: Path) -> None:
    """Unpacked elsewhere, the packages are those that run, and find their files."""
    wheel.extractall(tmp_path / "site")
    code = """
import sys
sys.path.insert(0, sys.argv[1])
import phytac_design, phytac_shapes, phytac_decoder
packages = (phytac_design, phytac_shapes, phytac_decoder)
assert all(package.__file__.startswith(sys.argv[1]) for package in packages)
from phytac_design.rules.design_review import checkup
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.rules.check import check_design
from phytac_design.design.scene import load_scene
from phytac_design.study.search.study_file import load_study
from phytac_design.simulation.scenario.scenario_file import load_scenario
print(len(shipped_designs()), check_design(load_design("cylinder60")).markers.count)
print(load_scene("fingertip").name, load_study("dense-cone")[0].name, load_scenario("smoke").name)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "site")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["9", "368", "fingertip", "dense-cone", "smoke"]
