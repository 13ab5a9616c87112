"""The guide to a shape of one's own, followed to the letter: its file, its design, its commands."""

import json
import os
import shutil
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

import phytac_shapes
from tests.docs.pages import ROOT, commands, listing
from tests.refusals import refused

GUIDE = ROOT / "docs" / "guides" / "own-shape.md"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of ``shapes/`` with the one file more, found before the installed one."""
    folder = tmp_path_factory.mktemp("checkout")
    shutil.copytree(ROOT / "shapes", folder / "shapes", ignore=shutil.ignore_patterns("__py*"))
    (folder / "shapes" / "phytac_shapes" / "barrel.py").write_text(
        listing(GUIDE, "shapes/phytac_shapes/barrel.py")
    )
    (folder / "keg.toml").write_text(listing(GUIDE, "keg.toml"))
    return folder


COMMANDS = """
import json, os, sys
from typer.testing import CliRunner
from phytac_design.cli.app import app
from tests.coarse_switches import coarse_bowls

os.environ["PHYTAC_CACHE"] = "cache"  # no other test takes these switches for the exact ones
with coarse_bowls():
    for words in json.loads(sys.argv[1]):
        done = CliRunner().invoke(app, words)
        print(json.dumps([done.exit_code, done.output + repr(done.exception)]))
"""
"""A program that runs commands one after the other, with switches on the coarse mesh."""


def python(folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{folder / 'shapes'}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
    )


def barrel(checkout: Path, **sizes: float) -> phytac_shapes.Surface:
    """A barrel of the guide's class."""
    spec = spec_from_file_location(
        "barrel_of_the_guide", checkout / "shapes" / "phytac_shapes" / "barrel.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
        made = module.FAMILY(**sizes)
        assert isinstance(made, phytac_shapes.Surface)
        return made
    finally:
        del sys.modules[spec.name]


def test_the_shape_keeps_the_contract(checkout: Path) -> None:
    surface = barrel(checkout, diameter_ends_mm=44.0, diameter_middle_mm=50.0, length_mm=60.0)
    (u0, u1), (v0, v1) = surface.domain
    rng = np.random.default_rng(0)
    uv = np.array([u0, v0]) + rng.uniform(0.0, 0.999, (60, 2)) * [u1 - u0, v1 - v0]
    # On the torus: (√(x² + y²) − c)² + (z − L/2)² = R², with R and c of ends, middle and length.
    radius = (900.0 + 9.0) / 6.0
    point = surface.point(uv)
    ring = np.hypot(point[:, 0], point[:, 1]) - (25.0 - radius)
    assert np.allclose(np.hypot(ring, point[:, 2] - 30.0), radius, rtol=1e-12)
    assert np.allclose(surface.chart(surface.point(uv, -0.8)), uv, atol=1e-9)
    # Area of the band by Pappus: 2π(c·s + R·L), s the arc's length.
    arc = 2.0 * radius * np.arcsin(30.0 / radius)
    area = 2.0 * np.pi * ((25.0 - radius) * arc + radius * 60.0)
    assert surface.area_mm2() == pytest.approx(area, rel=1e-12)
    assert (np.sum(surface.normal(uv)[:, :2] * point[:, :2], axis=1) > 0.0).all()


@pytest.mark.parametrize("middle", [44.0, 40.0, 110.0])
def test_a_barrel_that_is_none_is_refused(checkout: Path, middle: float) -> None:
    with refused("barrel-middle"):
        barrel(checkout, diameter_ends_mm=44.0, diameter_middle_mm=middle, length_mm=60.0)


def test_the_commands_know_it(checkout: Path) -> None:
    """All of the guide's quick commands, and the stages that see the shape, at draft."""
    own = [c.words[1:] for c in commands([GUIDE]) if "keg.toml" in c.words or "barrel" in c.words]
    assert [words[0] for words in own] == ["shapes", "check", "press", "build"]
    own[3] = (*own[3], "--only", "shell,mesh")
    ran = python(checkout, COMMANDS, json.dumps([own[0], own[1], own[3]]))
    assert ran.returncode == 0, ran.stderr
    done = [json.loads(line) for line in ran.stdout.splitlines()]
    assert [code for code, _ in done] == [0, 0, 0], done
    page, seen, _ = (text for _, text in done)
    assert "one arc joins them" in page
    assert "diameter_middle_mm = …  # required" in page
    assert "keg: 96 markers" in seen
    assert "every marker is visible and can be distinguished" in seen
    made = checkout / "exports" / "keg"
    assert (made / "shell" / "shell.stl").stat().st_size > 100_000
    assert "*NODE" in (made / "mesh" / "shell.inp").read_text().upper()


def test_the_guide_counts_right() -> None:
    assert len(phytac_shapes.Surface.__abstractmethods__) == 10
    assert "its ten abstract methods" in GUIDE.read_text()


def test_two_shapes_of_one_name_are_refused(checkout: Path, tmp_path: Path) -> None:
    shutil.copytree(checkout / "shapes", tmp_path / "shapes")
    text = (tmp_path / "shapes" / "phytac_shapes" / "barrel.py").read_text()
    (tmp_path / "shapes" / "phytac_shapes" / "barrel.py").write_text(
        text.replace('"barrel"', '"cone"')
    )
    done = python(tmp_path, "from phytac_design.cli.app import main; main()", "shapes")
    assert done.returncode != 0
    assert "registers the shape 'cone', which there is already (phytac_shapes.cone)" in done.stderr
