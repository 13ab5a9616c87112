"""Print rules on planted faults, on bodies with known answers, on shipped designs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.print_rules_table import PROCESSES, PrintSection
from phytac_design.fabrication.printing.overhang import overhangs, stand, suggest
from phytac_design.fabrication.printing.print_checks import check_body, check_shell
from phytac_design.fabrication.printing.print_drawing import draw_report
from phytac_design.fabrication.printing.receptors import check_receptors
from phytac_design.fabrication.printing.violations import Violation
from phytac_design.fabrication.printing.voids import cups
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import TriangleMesh, prisms
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import read_stl, write_stl
from phytac_design.solids.solid_mesh import shell_manifold, to_manifold, to_triangles
from phytac_design.stages.build import copy_of
from tests.fabrication.cases import built, design, shipped
from tests.refusals import refused

RULES = PrintSection()
UP = np.array([0.0, 0.0, 1.0])
BOX = [(0, 3, 2), (0, 2, 1), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4)]
BOX += [(1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]


def block(low: tuple[float, ...], high: tuple[float, ...]) -> Any:
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    vertices = np.array([(*c, low[2]) for c in corners] + [(*c, high[2]) for c in corners])
    return to_manifold(TriangleMesh(vertices_mm=vertices, triangles=np.array(BOX)))


def rod(start: tuple[float, ...], end: tuple[float, ...], diameter: float, sides: int = 16) -> Any:
    return to_manifold(prisms(np.array([start]), np.array([end]), diameter / 2.0, sides))


def found(solid: Any, rules: PrintSection = RULES, up: np.ndarray | None = UP) -> list[Violation]:
    return list(check_body(to_triangles(solid), rules, up=up).violations)


def base() -> Any:
    return block((0, 0, 0), (20, 20, 3))


@pytest.mark.parametrize("where", [(5.0, 6.0), (11.3, 9.7)])
def test_a_sound_block_has_no_violations_and_each_planted_fault_is_found(where: Any) -> None:
    x, y = where
    assert found(base()) == []
    faults = {
        "wall": (base() + block((x, y, 2), (x + 5, y + 0.2, 8)), (x + 2.5, y + 0.1, 5.5), 0.2),
        "post": (base() + rod((x, y, 2), (x, y, 23), 0.3), (x, y, 13.0), 0.3),
        "hole": (base() - rod((x, y, -1), (x, y, 4), 0.2), (x, y, 1.5), 0.2),
        "sealed": (base() - rod((x, y, 1), (x, y, 2), 1.0), (x, y, 1.5), 0.0),
        "gap": (
            base()
            + block((x, y, 2), (x + 5, y + 2, 8))
            + block((x, y + 2.1, 2), (x + 5, y + 4, 8)),
            (x + 2.5, y + 2.05, 5.5),
            0.1,
        ),
    }
    for rule, (solid, place, size) in faults.items():
        violations = found(solid)
        assert [item.rule for item in violations] == [rule]
        assert np.linalg.norm(np.array(violations[0].point_mm) - place) <= 0.5
        assert violations[0].measured == pytest.approx(size, rel=0.05, abs=1e-9)


def test_the_numbers_decide() -> None:
    fin = base() + block((5, 5, 2), (12, 5.35, 9))
    hole = base() - rod((5, 5, -1), (5, 5, 4), 0.6)
    post = base() + rod((5, 5, 2), (5, 5, 23), 1.05)
    assert [v.rule for v in found(fin)] == ["wall"]
    assert found(fin, PrintSection(wall_min_mm=0.3, wall_free_min_mm=0.3)) == []
    assert found(hole) == []
    assert [v.rule for v in found(hole, PrintSection(hole_min_mm=0.8))] == ["hole"]
    assert found(post) == []
    stout = PrintSection(post_short_mm=(0.8, 7.0), post_tall_mm=(1.5, 20.0))
    assert [v.rule for v in found(post, stout)] == ["post"]


def test_a_wall_held_at_one_edge_is_free_and_one_between_blocks_is_not() -> None:
    fin = block((0, 0, 0), (20, 20, 2)) + block((0, 10, 1), (20, 10.5, 11))
    assert [(v.rule, v.asked) for v in found(fin)] == [("free wall", 0.6)]
    held = fin + block((0, 0, 0), (2, 20, 11)) + block((18, 0, 0), (20, 20, 11))
    assert found(held) == []
    tube = rod((0, 0, 0), (0, 0, 20), 10.0, 48) - rod((0, 0, -1), (0, 0, 21), 9.0, 48)
    assert found(tube) == []


def test_raised_letters_are_no_walls_and_knife_edges_no_gaps() -> None:
    letters = base() + block((5, 5, 2), (9, 5.3, 3.3)) + block((5, 6, 2), (9, 6.3, 3.3))
    assert found(letters) == []
    beside = block((0, 0, 0), (20, 20, 10)) + rod((10, 22, 0), (10, 22, 10), 4.004, 64)
    assert found(beside) == []


def test_hollows_drain_through_openings_that_are_together_large_enough() -> None:
    hollow = block((-10, -10, -10), (10, 10, 10)) - block((-8, -8, -8), (8, 8, 8))
    assert [v.rule for v in found(hollow, up=-UP)] == ["sealed", "cup"]
    small = hollow - rod((3, 3, 0), (3, 3, 11), 2.0)
    rules = [v.rule for v in found(small, up=-UP)]
    assert rules == ["drain", "cup"]
    assert found(hollow - rod((3, 3, 0), (3, 3, 11), 4.2), up=-UP) == []
    two = small - rod((-3, 3, 0), (-3, 3, 11), 2.0) - rod((3, -3, 0), (3, -3, 11), 2.0)
    four = two - rod((-3, -3, 0), (-3, -3, 11), 2.2)
    assert "drain" not in [v.rule for v in found(four, up=-UP)]
    assert found(small, PrintSection(process="fdm", supports="allowed"), up=-UP) == []


def test_a_cup_depends_on_the_direction_and_the_search_avoids_it() -> None:
    cup = block((-10, -10, -10), (10, 10, 10)) - block((-8, -8, -8), (8, 8, 12))
    assert [v.rule for v in found(cup)] == ["cup"]
    assert found(cup, up=-UP) == []
    assert found(cup, up=None) == []
    assert found(cup, PrintSection(process="polyjet")) == []


@pytest.mark.parametrize(
    ("lean_deg", "pocket", "due_mm3"),
    [
        (0.0, (8.0, 8.0), 16.0 * 16.0 * 18.0),
        (45.0, (8.0, 8.0), 16.0 * (16.0 * 18.0 - 16.0 * 16.0 / 2.0)),
        (0.0, (8.0, 2.0), 16.0 * 4.0 * 18.0 + 4.0 * 2.0 * 18.0),
    ],
)
def test_a_cup_holds_resin_up_to_its_brim_and_in_its_slots(
    lean_deg: float, pocket: tuple[float, float], due_mm3: float
) -> None:
    x, y = pocket
    cup = block((-10, -10, -10), (10, 10, 10)) - block((-x, -y, -8), (x, y, 12))
    if y < x:  # a slot that the drain's ball does not enter
        cup -= block((-1, y - 1, -8), (1, y + 4, 12))
    lean = np.radians(lean_deg)
    (only,) = cups(to_triangles(cup), np.array([np.sin(lean), 0.0, np.cos(lean)]), RULES)
    held = float(only.fix.removeprefix("about ").split(" mm³")[0])
    assert held == pytest.approx(due_mm3, rel=0.06)


def test_overhangs_of_a_table_top() -> None:
    table = block((0, 0, 0), (4, 4, 10)) + block((-6, 0, 10), (4, 4, 12))
    mesh = to_triangles(table)
    standing = stand(mesh, RayTree(mesh), UP, RULES)
    assert standing.overhang_area_mm2 == pytest.approx(24.0)
    assert standing.support_volume_mm3 == pytest.approx(240.0)
    assert standing.height_mm == pytest.approx(12.0)
    parts = overhangs(mesh, RayTree(mesh), UP, RULES)
    assert [p.area_mm2 for p in parts] == [pytest.approx(24.0)]
    assert parts[0].point_mm == pytest.approx((-3.0, 2.0, 10.0), abs=0.5)
    best, tried = suggest(mesh, RayTree(mesh), RULES)
    assert best.overhang_area_mm2 == 0.0
    assert tried > 100
    violations = found(table, PrintSection(supports="none"))
    assert [v.rule for v in violations] == ["overhang"]
    assert found(table, PrintSection(process="polyjet", supports="none")) == []


def test_slope_decides_about_supports() -> None:
    for angle, hangs in ((15.0, True), (25.0, False)):
        rise = 8.0 * np.tan(np.radians(angle))
        wedge = block((0, 0, 0), (8, 8, 8)).warp(
            lambda p, rise=rise: (p[0], p[1], p[2] + p[0] / 8.0 * rise)
        )
        mesh = to_triangles(wedge + block((-2, 0, -2), (0.01, 8, 8)))
        area = stand(mesh, RayTree(mesh), UP, RULES).overhang_area_mm2
        assert (area > 50.0) == hangs


def test_rays_against_a_sphere_and_brute_force() -> None:
    rng = np.random.default_rng(1)
    mesh = to_triangles(rod((0, 0, -5), (0, 0, 5), 10.0, 12))
    tree = RayTree(mesh)
    start = rng.uniform(-3, 3, (300, 3))
    way = rng.normal(size=(300, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    hits = tree.cast(start, way)
    a, b, c = np.moveaxis(tree.corners, 1, 0)
    normal = np.cross(b - a, c - a)
    for k in range(300):
        # Inside a convex body the way out is the nearest face plane ahead.
        speed = normal @ way[k]
        ahead = np.einsum("ni,ni->n", normal, a - start[k])[speed > 0] / speed[speed > 0]
        assert hits.distance_mm[k] == pytest.approx(ahead.min(), rel=1e-9)
    near = tree.cast(start, way, 0.5 * hits.distance_mm)
    assert (near.triangle == -1).all()


def test_receptors_are_judged_from_the_design() -> None:
    case, _, markers = built(
        design(
            receptor={"diameter_outer_mm": 1.2, "diameter_hole_mm": 0.6},
            layout={"rows": 2, "columns": 3, "height_near_mm": 5.0, "height_far_mm": 26.0},
            switch={"tip_diameter_mm": 0.2},
        )
    )
    rules = {v.rule for v in check_receptors(case, markers)}
    assert rules == {"post", "wall"}
    posts = [v for v in check_receptors(case, markers) if v.rule == "post"]
    tall = [k for k in range(markers.count) if markers.height_mm[k] > 24.25]
    assert [v.marker for v in posts] == tall
    assert len(tall) > 0
    near = design(layout={"rows": 1, "columns": 58}, receptor={"diameter_outer_mm": 3.0})
    case, _, markers = built(near)
    gaps = check_receptors(case, markers)
    assert {v.rule for v in gaps} == {"gap"}
    assert all(v.marker is not None and v.measured < 0.3 for v in gaps)


@pytest.mark.parametrize(
    "name", [pytest.param("cylinder40", marks=pytest.mark.long), "hemisphere", "patch"]
)
def test_shipped_shells_break_no_rule(name: str, tmp_path: Path) -> None:
    case = built(shipped(name))
    write_stl(
        to_triangles(shell_manifold(Sensor.of(*case), tolerance_mm=0.05)), tmp_path / "shell.stl"
    )
    mesh = read_stl(tmp_path / "shell.stl")
    report = check_shell(Sensor.of(*case), mesh, tolerance_mm=0.05)
    assert report.violations == ()
    assert report.standing.fits
    assert 0.3 < report.wall_mm < 0.81
    svg = draw_report(RayTree(mesh), report, case[0].print_rules, name)
    assert "no violations" in svg
    assert svg.count("<image") == 2


def test_a_fault_on_a_receptor_names_its_marker() -> None:
    case = built(copy_of(shipped("cylinder40"), layout={"rows": 4}))
    markers = case[2]
    tip, along = markers.tip_mm[-16], markers.direction[-16]
    side = np.cross(along, [0.0, 0.0, 1.0]) * 0.95
    start = tuple(tip + side - 0.2 * along)
    solid = shell_manifold(Sensor.of(*case), tolerance_mm=0.05)
    solid = solid + rod(start, tuple(tip + side + 9.0 * along), 0.25)
    report = check_shell(Sensor.of(*case), to_triangles(solid), tolerance_mm=0.02)
    assert [v.rule for v in report.violations] == ["post"]
    svg = draw_report(RayTree(to_triangles(solid)), report, case[0].print_rules, "x")
    assert svg.count(">1</text>") == 2
    assert "post 0.24" in svg


def test_a_body_larger_than_the_bed_says_so() -> None:
    violations = found(block((0, 0, 0), (150, 150, 150)), up=None)
    assert [v.rule for v in violations] == ["bed"]
    assert violations[0].measured > 145.0
    slanted = block((0, 0, 0), (190, 4, 4))
    assert found(slanted, up=None) == []


def test_presets_give_all_numbers_and_may_be_overridden() -> None:
    assert PrintSection() == PrintSection(process="sla")
    fdm = PrintSection(process="fdm", hole_min_mm=1.5)
    assert (fdm.hole_min_mm, fdm.wall_min_mm) == (1.5, PROCESSES["fdm"]["wall_min_mm"])
    assert PrintSection(process="polyjet").post_short_mm[0] == 1.0
    assert RULES.post_diameter_mm(5.0) == 0.3
    assert RULES.post_diameter_mm(20.0) == pytest.approx(0.3 + 1.2 * 13.0 / 23.0)
    assert RULES.post_diameter_mm(90.0) == 1.5
    for bad in (
        {"process": "sls"},
        {"bed_mm": (0.0, 1.0, 1.0)},
        {"build_direction": (0.0, 0.0, 0.0)},
        {"post_tall_mm": (1.0, 2.0)},
    ):
        with pytest.raises(ValueError, match=r"Input should be|must"):
            PrintSection.model_validate(bad)


def test_a_torn_stl_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.stl"
    write_stl(to_triangles(base()), path)
    path.write_bytes(path.read_bytes()[:-10])
    with refused("stl-file-invalid"):
        read_stl(path)
