"""A design from a face of the user's own CAD: round trip through STEP, and one clear error."""

import re
from pathlib import Path

import cadquery as cq
import numpy as np
import pytest

from phytac_design.design.design_file import load_design, write_new_design
from phytac_design.rules.design_review import checkup
from phytac_design.workflows.design_from_step import patch_changes
from phytac_shapes.errors import InputError
from tests.refusals import refused
from tests.test_cli import phytac


def dome_z(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Top of a gentle dome, mm."""
    return 100.0 - 0.004 * (x - 50.0) ** 2 - 0.003 * (y + 20.0) ** 2


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An 80 x 60 mm face far from the origin."""
    points = [
        [cq.Vector(x, y, float(dome_z(x, y))) for y in np.linspace(-50.0, 10.0, 9)]
        for x in np.linspace(10.0, 90.0, 9)
    ]
    path = tmp_path_factory.mktemp("cad") / "face.step"
    face = cq.Face.makeSplineApprox(points, tol=1e-6)
    cq.exporters.export(cq.Workplane(face), str(path))
    return path


def test_the_face_comes_back_on_the_cameras_axis(step: Path, tmp_path: Path) -> None:
    changes, said = patch_changes(step, rows=7, columns=8)
    path = write_new_design("mine", "patch", tmp_path / "mine.toml", changes=changes)
    design = load_design(str(path))
    surface = design.surface()
    grid = np.array(changes["shape"]["points_mm"])
    assert grid.shape == (7, 8, 3)
    np.testing.assert_allclose(grid[..., :2].min(axis=(0, 1)) + grid[..., :2].max(axis=(0, 1)), 0.0)
    assert grid[..., 2].min() == 0.0
    moved = np.array([float(x) for x in re.findall(r"moved by \((.*?)\)", said)[0].split(",")])
    (u1, v1) = surface.domain[:, 1]
    uv = np.random.default_rng(0).uniform(size=(50, 2)) * [u1, v1]
    x, y, z = (surface.point(uv) - moved).T
    off = float(re.findall(r"up to ([\d.]+) mm off", said)[0])
    assert 0.5 * off < np.abs(z - dome_z(x, y)).max() < 1.1 * off
    u, v = np.meshgrid(np.arange(7.0), np.arange(8.0))
    x, y, z = (surface.point(np.column_stack([u.ravel(), v.ravel()])) - moved).T
    np.testing.assert_allclose(z, dome_z(x, y), atol=2e-3)  # moved is printed to four digits
    _, closer = patch_changes(step, rows=21, columns=21)
    assert float(re.findall(r"up to ([\d.]+) mm off", closer)[0]) < 0.3 * off
    assert np.all(surface.normal(uv)[:, 2] > 0.8)
    assert checkup(design)["clear"]


def test_the_command_writes_a_design(step: Path, tmp_path: Path) -> None:
    words = ("new", "mine", "--from-step", str(step), "--rows", "5", "--columns", "6")
    out = phytac(*words, cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    assert "a face of 60.3" in out.stdout
    assert "through 5 x 6 points" in out.stdout
    design = load_design(str(tmp_path / "mine.toml"))
    assert design.name == "mine"
    assert (design.layout.rows, design.layout.columns) == (13, 10)
    assert "all else is that of patch: a camera of " in out.stdout
    assert "forces of 0.5 to 25 N (table training)" in out.stdout
    # Without a name, that of the file.
    assert phytac("new", "--from-step", str(step), cwd=tmp_path).returncode == 0
    assert load_design(str(tmp_path / "face.toml")).name == "face"


def test_a_face_that_is_inside_out_is_turned(step: Path, tmp_path: Path) -> None:
    other = tmp_path / "reversed.step"
    face = cq.importers.importStep(str(step)).faces().val()
    cq.exporters.export(cq.Workplane(cq.Face(face.wrapped.Reversed())), str(other))
    there, back = (patch_changes(path)[0]["shape"]["points_mm"] for path in (step, other))
    places = [
        {tuple(np.round(point, 4)) for row in grid for point in row} for grid in (there, back)
    ]
    assert places[0] == places[1]


def test_bad_files_get_one_error(step: Path, tmp_path: Path) -> None:
    with refused("file-unreadable"):
        patch_changes(tmp_path / "nowhere.step")
    other = tmp_path / "x.step"
    other.write_text("solid not a step")
    with refused("file-not-step"):
        patch_changes(other)
    other.write_text(step.read_text()[:600])
    with refused("step-unreadable") as caught:
        patch_changes(other)
    caught.match(r"x\.step")
    with refused("step-face-number"):
        patch_changes(step, face=3)
    upright = cq.Workplane("XZ").rect(80.0, 60.0).extrude(1.0).faces("<Y")
    cq.exporters.export(upright, str(other))
    with refused("step-face-aside") as caught:
        patch_changes(other)
    caught.match(r"faces aside \(its mean normal is -?0.00, -?1.00, -?0.00\)")
    holed = cq.Workplane().box(80.0, 60.0, 5.0).faces(">Z").workplane().hole(10.0)
    cq.exporters.export(holed, str(other))
    with refused("step-face-trimmed"):
        patch_changes(other)
    huge = cq.Workplane(cq.Face.makePlane(3000.0, 2000.0))
    cq.exporters.export(huge, str(other))
    with refused("step-face-too-large"):
        patch_changes(other)
    out = phytac("new", "mine", "--from-step", str(tmp_path / "nowhere.step"), cwd=tmp_path)
    assert out.returncode == InputError.exit_code
    assert out.stderr.startswith("error[file-unreadable]: no STEP file at")
    assert len(out.stderr.splitlines()) == 1
    assert not (tmp_path / "mine.toml").exists()
