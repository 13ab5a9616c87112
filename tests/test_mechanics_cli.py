"""``phytac press`` and ``phytac mesh`` as a person uses them; the files run in CalculiX."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from phytac_design.design.design_file import to_toml
from phytac_design.engine.stage import graphics_libraries
from phytac_design.layout import make_markers
from tests.designs import small
from tests.test_cli import phytac
from verification.calculix import run_ccx

SHELL_TOL = 0.03
"""Our element against S4 of CalculiX on the same coarse mesh."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two design files: a small sensor, and a tiny one with three receptors."""
    out = tmp_path_factory.mktemp("press")
    (out / "small.toml").write_text(to_toml(small()), encoding="utf-8")
    tiny = small(
        name="tiny",
        shape={"diameter_outer_mm": 12.0, "length_mm": 7.0},
        layout={"rows": 1, "columns": 3, "height_near_mm": 1.0, "height_far_mm": 3.0},
    )
    (out / "tiny.toml").write_text(to_toml(tiny), encoding="utf-8")
    return out


def needs_ccx() -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")


def test_press_reports_the_motion(folder: Path) -> None:
    words = ("press", "small.toml", "--force", "12", "--at", "45", "--refine", "6")
    out = phytac(*words, "--json", "--vtu", "moved.vtu", cwd=folder)
    assert out.returncode == 0, out.stderr
    result = json.loads(out.stdout)
    assert (result["theory"], result["receptors"], result["warnings"]) == ("large", True, [])
    assert len(result["markers"]) == 9
    assert result["markers"][0]["marker"] == 45
    assert result["markers"][0]["wall_inward_mm"] == pytest.approx(result["centre_inward_mm"])
    assert (folder / "moved.vtu").stat().st_size > 1000
    text = phytac(*words, "--theory", "linear", "--no-receptors", cwd=folder)
    assert text.returncode == 0, text.stderr
    assert "plain wall" in text.stdout
    assert "warning: linear theory is about" in text.stderr


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("press", "small.toml", "--force", "0"), 2, "positive number of newtons"),
        (("press", "small.toml", "--force", "5", "--at", "70,1"), 2, "off the surface"),
        (("press", "small.toml", "--force", "5", "--vtu", "small.toml"), 4, "end its name in .vtu"),
        (("mesh", "small.toml", "--out", "m", "--formats", "stl"), 2, "formats are inp, msh, vtu"),
        (("mesh", "small.toml", "--out", "m", "--solid", "--radius", "0"), 2, "--radius above 0"),
        (("mesh", "cylinder60", "--out", "m", "--solid", "--size", "0.8"), 2, "raise --size"),
        (("mesh", "small.toml", "--out", "small.toml"), 3, "cannot write"),
    ],
)
def test_errors_are_one_line(folder: Path, words: tuple[str, ...], code: int, message: str) -> None:
    out = phytac(*words, cwd=folder)
    assert (out.returncode, len(out.stderr.strip().splitlines())) == (code, 1), out.stderr
    assert out.stderr.startswith("error[")
    assert message in out.stderr
    assert not (folder / "m").exists()


def test_shell_files_run_as_they_are(folder: Path) -> None:
    out = phytac("mesh", "small.toml", "--out", "shell", "--at", "45", "--json", cwd=folder)
    assert out.returncode == 0, out.stderr
    facts = json.loads(out.stdout)
    assert {path.suffix for path in (folder / "shell").iterdir()} == {".inp", ".msh", ".vtu"}
    needs_ccx()
    nodes, motion = run_ccx(folder / "shell" / "shell.inp")[0]["displacements", "MARKERS"]
    design = small()
    markers = make_markers(design, design.surface())
    inward = float(np.max(-motion @ markers.normal[45]))
    assert len(nodes) == markers.count
    assert inward == pytest.approx(facts["shell"]["inward_mm_at_load"], rel=SHELL_TOL)


@pytest.mark.skipif(
    not all(graphics_libraries().values()), reason="CadQuery's graphics libraries are missing"
)
def test_solid_files_run_as_they_are(folder: Path) -> None:
    pytest.importorskip("gmsh", reason="gmsh is not installed")
    words = ("mesh", "tiny.toml", "--out", "solid", "--solid", "--size", "2", "--formats", "inp")
    at = ("--at", "1", "--radius", "2", "--force", "3", "--json")
    out = phytac(*words, *at, cwd=folder)
    assert out.returncode == 0, out.stderr
    facts = json.loads(out.stdout)["solid"]
    assert "about" in out.stderr
    made = {path.name for path in (folder / "solid").iterdir()}
    assert made == {"shell.inp", "solid.inp"}
    needs_ccx()
    nodes, motion = run_ccx(folder / "solid" / "solid.inp")[0]["displacements", "TIPS"]
    design = small(
        shape={"diameter_outer_mm": 12.0, "length_mm": 7.0},
        layout={"rows": 1, "columns": 3, "height_near_mm": 1.0, "height_far_mm": 3.0},
    )
    normal = make_markers(design, design.surface()).normal[1]
    assert nodes.max() < facts["nodes"]
    solid = float(np.max(-motion @ normal))
    pressed = phytac("press", "tiny.toml", "--theory", "linear", *at, cwd=folder)
    shell = json.loads(pressed.stdout)["markers"][0]["tip_mm"]
    # Tubes of 3 mm on a diameter of 12 mm, and a coarse solid: finer ones give 0.0030, not 0.0028.
    assert solid == pytest.approx(-np.dot(shell, normal), rel=0.3)
