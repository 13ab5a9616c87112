import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phytac_design.design.spec import WallSection
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.cad import CadFacts, cad_facts, shell_cad, write_step
from phytac_design.solids.cad_spline import cells_for, spline_edge
from phytac_design.solids.cad_wall import wall_cad
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.solids.step_surface import surface_from_step
from phytac_design.solids.wall_mesh import wall_mesh
from tests.fabrication.cad_files import read_step
from tests.fabrication.cases import FAMILIES, Barrel, built, design, family_design
from tests.fabrication.walls import rims_mm3, steiner_mm3
from tests.long_cases import TUBES, with_long
from tests.refusals import refused

AGREE = 1e-4
"""Mesh against CAD: equal-area sections; the design asks for 1e-3."""
EXACT = 2e-5
"""CAD against closed form: splines are within a micrometre, everything else exact."""


def test_wall_with_rims_is_exact() -> None:
    case = design()
    facts = cad_facts(wall_cad(case.surface(), case.wall))
    closed = np.pi * ((30.0**2 - 29.2**2) * 120.0 + 2.0 * (31.6**2 - 29.2**2) * 4.0)
    assert facts.volume_mm3 == pytest.approx(closed, rel=1e-9)
    assert facts.valid


families = pytest.mark.parametrize("name", sorted(FAMILIES))


@families
@pytest.mark.parametrize(
    "sizes", [{"rim_length_mm": 0.0}, {"rim_flange_mm": 0.0}, {"rim_length_mm": 3.0}]
)
def test_walls_of_all_families_are_valid_and_exact(name: str, sizes: dict[str, float]) -> None:
    surface, wall = family_design(name).surface(), WallSection(**sizes)
    facts = cad_facts(wall_cad(surface, wall))
    assert (facts.valid, facts.solids) == (True, 1)
    closed = steiner_mm3(surface, wall.thickness_mm)
    closed += rims_mm3(surface, wall) if wall.rim_length_mm > 0.0 else 0.0
    assert facts.volume_mm3 == pytest.approx(closed, rel=EXACT)


@pytest.mark.parametrize("name", with_long(sorted(FAMILIES), TUBES))
def test_shells_of_all_families_go_through_step(name: str, tmp_path: Path) -> None:
    case = built(family_design(name, rows=2, columns=3))
    solid = shell_cad(Sensor.of(*case))
    facts = cad_facts(solid)
    assert (facts.valid, facts.solids) == (True, 1)
    assert shell_manifold(Sensor.of(*case)).volume() == pytest.approx(facts.volume_mm3, rel=AGREE)
    write_step(solid, tmp_path / "shell.step")
    again = cad_facts(read_step(tmp_path / "shell.step"))
    assert (again.valid, again.solids) == (True, 1)
    assert again.volume_mm3 == pytest.approx(facts.volume_mm3, rel=AGREE)


def test_a_skew_patch_has_true_mitres() -> None:
    rows = [
        [[x + 0.5 * y, y, 40.0 - 0.004 * x * x] for x in (-30.0, 0.0, 30.0)] for y in (0.0, 30.0)
    ]
    surface = design(shape={"kind": "patch", "points_mm": rows}).surface()
    wall = WallSection()
    facts = cad_facts(wall_cad(surface, wall))
    closed = steiner_mm3(surface, 0.8) + rims_mm3(surface, wall)
    assert facts.valid
    assert facts.volume_mm3 == pytest.approx(closed, rel=EXACT)
    mesh = wall_mesh(surface, wall, tolerance_mm=0.01)
    # The rims are ruled faces that twist: their triangles follow within the tolerance.
    assert mesh.volume_mm3 == pytest.approx(closed, rel=3e-4)


def test_a_face_of_a_step_file_becomes_a_patch(tmp_path: Path) -> None:
    path = tmp_path / "wall.step"
    surface = family_design("patch").surface()
    write_step(wall_cad(surface, WallSection(rim_length_mm=0.0)), path)
    # Face 0 is the outer one; its parameters are the chart, so that the points come back.
    points = surface_from_step(path, rows=4, columns=5, face=0)
    np.testing.assert_allclose(points, np.array(FAMILIES["patch"]["points_mm"]), atol=1e-6)
    again = design(shape={"kind": "patch", "points_mm": points.tolist()}).surface()
    assert again.area_mm2() == pytest.approx(surface.area_mm2(), rel=1e-8)
    largest = surface_from_step(path, rows=7, columns=3)
    assert largest.shape == (7, 3, 3)
    gap = surface.chart(largest.reshape(-1, 3))
    assert np.linalg.norm(surface.point(gap) - largest.reshape(-1, 3), axis=1).max() < 2e-3


def test_an_inward_face_is_turned_outward(tmp_path: Path) -> None:
    path = tmp_path / "wall.step"
    write_step(wall_cad(family_design("plane").surface(), WallSection(rim_length_mm=0.0)), path)
    # The plane leans: the two ends along its slope face aside, the other sides do not quite.
    for face in (0, 1):
        with refused("step-face-aside"):
            surface_from_step(path, rows=3, columns=3, face=face)
    for face in range(2, 6):
        points = surface_from_step(path, rows=3, columns=3, face=face)
        around, along = points[1, 2] - points[1, 0], points[2, 1] - points[0, 1]
        assert np.cross(around, along)[2] > 0.0


def test_faces_that_are_no_patch_are_refused(tmp_path: Path) -> None:
    import cadquery as cq

    def saved(shape: object) -> Path:
        path = tmp_path / "face.step"
        write_step(shape, path)
        return path

    plate = cq.Workplane().box(20.0, 20.0, 2.0).faces(">Z").workplane().hole(6.0).val()
    with refused("step-face-trimmed"):
        surface_from_step(saved(plate))
    with refused("step-face-closed"):
        surface_from_step(saved(cq.Workplane().sphere(10.0).val()))
    with refused("step-face-number"):
        surface_from_step(saved(cq.Workplane().box(1.0, 1.0, 1.0).val()), face=9)
    with refused("step-points-too-few"):
        surface_from_step(tmp_path / "face.step", rows=1)
    (tmp_path / "text.step").write_text("no step at all")
    with refused("step-unreadable"):
        surface_from_step(tmp_path / "text.step")


@pytest.mark.parametrize(
    "layout",
    [
        {"rows": 3, "columns": 4},
        {"rows": 1, "columns": 1},
        {"rows": 3, "columns": 2, "kind": "straight", "height_near_mm": 9.0},
    ],
)
def test_cad_and_mesh_agree(layout: dict[str, object]) -> None:
    case = built(design(layout=layout))
    facts = cad_facts(shell_cad(Sensor.of(*case)))
    assert facts.valid
    assert facts.solids == 1
    assert shell_manifold(Sensor.of(*case)).volume() == pytest.approx(facts.volume_mm3, rel=AGREE)


def test_step_opens_again_and_repeats_byte_for_byte(tmp_path: Path) -> None:
    solid = shell_cad(Sensor.of(*built(design(layout={"rows": 2, "columns": 3}))))
    first, second = tmp_path / "a.step", tmp_path / "b.step"
    write_step(solid, first, name="case")
    write_step(solid, second, name="case")
    assert first.read_bytes() == second.read_bytes()
    text = first.read_text()
    assert "2000-01-01T00:00:00" in text
    assert re.search(r"PRODUCT\('case','case'", text)
    assert "PCURVE" not in text
    again, facts = cad_facts(read_step(first)), cad_facts(solid)
    assert (again.valid, again.solids) == (True, 1)
    assert again.volume_mm3 == pytest.approx(facts.volume_mm3, rel=1e-4)
    assert isinstance(again, CadFacts)


def test_another_process_writes_the_same_step(tmp_path: Path) -> None:
    code = (
        "import sys;from pathlib import Path;from tests.fabrication.cases import *;"
        "from phytac_design.solids.cad import *;from phytac_design.layout.sensor import Sensor;"
        "one=Sensor.of(*built(design(layout={'rows':1,'columns':3})));"
        "write_step(shell_cad(one),Path(sys.argv[1]))"
    )
    root = Path(__file__).parents[2]
    target = tmp_path / "other.step"
    subprocess.run([sys.executable, "-c", code, str(target)], cwd=root, check=True)
    write_step(
        shell_cad(Sensor.of(*built(design(layout={"rows": 1, "columns": 3})))),
        tmp_path / "own.step",
    )
    assert target.read_bytes() == (tmp_path / "own.step").read_bytes()


def test_surface_without_a_builder_is_refused() -> None:
    case, surface = design(layout={"height_far_mm": 4.0}), Barrel()
    with refused("cad-wall-unsupported"):
        shell_cad(Sensor.of(case, surface, make_markers(case, surface)))


def test_a_folder_that_is_missing_is_reported(tmp_path: Path) -> None:
    solid = wall_cad(design().surface(), design().wall)
    with refused("output-not-writable"):
        write_step(solid, tmp_path / "none" / "a.step")


def test_splines_are_refined_until_they_keep_to_the_curve() -> None:
    import cadquery as cq

    def circle(t: np.ndarray) -> np.ndarray:
        angle = 6.0 * t
        return 50.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * t])

    cells = cells_for(circle, 1)
    edge = cq.Edge(spline_edge(circle(np.linspace(0.0, 1.0, cells + 1))))
    places = edge.positions(np.linspace(0.0, 1.0, 1000).tolist())
    radius = np.array([place.Length for place in places])
    assert np.abs(radius - 50.0).max() <= 1.1e-3
    with refused("spline-too-many-cells"):
        cells_for(lambda t: circle(np.sign(t - 0.3)), 1)
