"""Printed pieces of the kit: sound solids that fit the sensor, its rims and each other."""

import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from phytac_design.design.documents_table import KitSection
from phytac_design.design.spec import Design
from phytac_design.fabrication.calibration_rig.grippers import jaw, palm_radius_mm
from phytac_design.fabrication.calibration_rig.guide import guide_text
from phytac_design.fabrication.calibration_rig.program import gcode, make_program
from phytac_design.fabrication.calibration_rig.regions import (
    RADIUS_MIN_mm,
    Regions,
    follows,
    frames_at,
    make_regions,
)
from phytac_design.fabrication.calibration_rig.tool_bodies import (
    CalibrationKit,
    kit_bodies,
    kit_parts,
)
from phytac_design.fabrication.calibration_rig.tool_solids import bolt_places, tool_height_mm
from phytac_design.fabrication.printing.print_checks import check_body
from phytac_design.geometry.triangles import TriangleMesh, prisms
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import write_stl
from phytac_design.solids.mesh_facts import manifold_facts, trimesh_facts
from phytac_design.solids.solid_mesh import shell_manifold, stl_triangles, to_manifold, to_triangles
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_design.stages.build import copy_of
from phytac_shapes.arrays import FloatArray
from tests.fabrication.cases import built, family_design, shipped

TOL_mm = 0.03
BOWL_mm = 1.8
UP = np.array([0.0, 0.0, 1.0])
NAMES = ("cylinder60", "cone", "cuboid", "plane", "hemisphere", "patch")
TOUCH_mm3 = 1e-3
"""Common volume of solids that touch, by rounding."""


@cache
def kit_of(name: str) -> tuple[Regions, CalibrationKit]:
    design, surface, markers = built(shipped(name))
    regions = make_regions(Sensor.of(design, surface, markers))
    kit = kit_bodies(
        Sensor.of(design, surface, markers), regions, bowl_mm=BOWL_mm, tolerance_mm=TOL_mm
    )
    return regions, kit


def body_of(name: str, piece: str) -> Any:
    return next(item.body for item in kit_of(name)[1].pieces if item.name == piece)


def placed(body: Any, frame: FloatArray, point: FloatArray) -> Any:
    mesh = to_triangles(body)
    return to_manifold(
        TriangleMesh(vertices_mm=mesh.vertices_mm @ frame.T + point, triangles=mesh.triangles)
    )


@pytest.mark.parametrize("name", NAMES)
def test_every_piece_is_one_sound_solid(name: str) -> None:
    regions, kit = kit_of(name)
    bolts = shipped(name).kit.cell_bolts
    genus = {"cell_seat": bolts + 4, "gripper_three": 3 * bolts + 4, "collar": 1}
    for piece in kit.pieces:
        facts, other = manifold_facts(piece.body), trimesh_facts(to_triangles(piece.body))
        holes = len(piece.markers) if piece.name.startswith("plate_") else bolts
        due = (True, 1, genus.get(piece.name, holes))
        assert (facts.watertight, facts.bodies, facts.genus) == due, piece.name
        assert (other.watertight, other.bodies, other.genus) == due, piece.name
    fitted = [p.markers for p in kit.pieces if p.name.removeprefix("indenter_").isdecimal()]
    assert sorted(np.concatenate(fitted).tolist()) == sorted(regions.marker.tolist())
    listed = kit_parts(shipped(name), kit)
    assert len(listed) == len(kit.pieces) + 2
    screws = listed[-1]["count"]
    assert screws == 2 * bolts * kit.cells


@pytest.mark.skipif(shutil.which("admesh") is None, reason="admesh is not on PATH")
@pytest.mark.parametrize("name", ["cuboid", "patch"])
def test_admesh_finds_nothing_to_repair(name: str, tmp_path: Path) -> None:
    for piece in kit_of(name)[1].pieces:
        path = tmp_path / f"{piece.name}.stl"
        write_stl(stl_triangles(to_triangles(piece.body)), path)
        out = subprocess.run(
            ["admesh", str(path)], capture_output=True, text=True, errors="replace", check=True
        )
        fields = dict(k.split(":", 1) for k in out.stdout.splitlines() if ":" in k)
        for row in ("Degenerate facets", "Edges fixed", "Facets removed", "Normals fixed"):
            found = [v for k, v in fields.items() if k.strip() == row]
            assert int(found[0].split()[0]) == 0, (piece.name, row)


def test_cleaning_keeps_the_solid_and_leaves_no_needle() -> None:
    body = body_of("patch", "plate_1")
    rough = to_triangles(body)
    smooth = stl_triangles(rough)

    def least(mesh: TriangleMesh) -> float:
        a, b, c = np.moveaxis(mesh.corners_mm.astype(np.float32).astype(np.float64), 1, 0)
        long = np.max([np.linalg.norm(k, axis=1) for k in (a - b, b - c, c - a)], axis=0)
        return float(
            (np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(long, 1e-9)).min()
        )

    assert least(rough) < 1e-5 <= least(smooth)
    facts = trimesh_facts(smooth)
    assert (facts.watertight, facts.bodies) == (True, 1)
    assert facts.volume_mm3 == pytest.approx(rough.volume_mm3, rel=1e-6)
    assert facts.genus == trimesh_facts(rough).genus


@pytest.mark.parametrize("name", NAMES)
def test_fitted_faces_lie_on_the_sensor(name: str) -> None:
    """Distance of the printed face's corners from the outer face, at every region served."""
    design, surface, markers = built(shipped(name))
    regions, kit = kit_of(name)
    for k, face in enumerate(regions.faces):
        points = to_triangles(kit.pieces[k].body).vertices_mm
        inside = np.hypot(points[:, 0], points[:, 1]) <= face.radius_mm + 1e-9
        low = points[inside & (points[:, 2] < 0.4 * design.kit.shaft_mm)]
        assert len(low) > 500
        own = regions.marker[regions.face == k]
        frames, foot = frames_at(surface, markers.uv[own]), surface.point(markers.uv[own])
        for frame, at in zip(frames[::7], foot[::7], strict=True):
            there = low @ frame.T + at
            near = surface.chart(there)
            gap = np.sum((there - surface.point(near)) * surface.normal(near), axis=1)
            assert np.ptp(gap) / 2.0 <= 0.05


@pytest.mark.parametrize("name", NAMES)
def test_jigs_fit_around_the_sensor(name: str) -> None:
    design, surface, _ = built(shipped(name))
    shell = to_manifold(wall_mesh(surface, design.wall, tolerance_mm=TOL_mm))
    jigs = [p for p in kit_of(name)[1].pieces if p.name == "collar" or p.name.startswith("plate_")]
    assert jigs
    for piece in jigs:
        assert (piece.body ^ shell).volume() <= TOUCH_mm3
    wall = design.wall.model_copy(update={"rim_flange_mm": design.wall.rim_flange_mm + 0.8})
    wider = to_manifold(wall_mesh(surface, wall, tolerance_mm=TOL_mm))
    assert (jigs[0].body ^ wider).volume() > 1.0


def test_collar_has_a_notch_for_each_column() -> None:
    _, surface, markers = built(shipped("cylinder60"))
    body = body_of("cylinder60", "collar")
    radius = 30.0 + 1.6 + 0.3 + 8.0 - 0.4
    first = surface.point(markers.uv[markers.row == 0])
    angle = np.arctan2(first[:, 1], first[:, 0])

    def filled(turn: FloatArray) -> FloatArray:
        at = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(16, -3.0)])
        probe = [to_manifold(prisms(k[None], k[None] + [0, 0, 0.2], 0.05, 12)) for k in at]
        return np.array([(p ^ body).volume() / p.volume() for p in probe])

    assert filled(angle) == pytest.approx(np.zeros(16), abs=1e-6)
    assert filled(angle + np.pi / 16.0) == pytest.approx(np.ones(16), rel=1e-6)


@pytest.mark.parametrize("name", ["plane", "hemisphere", "patch"])
def test_indenters_pass_their_hole_plates(name: str) -> None:
    """Every region has one hole, along its normal, wide enough; bowls below it are not touched."""
    design, surface, markers = built(shipped(name))
    regions, kit = kit_of(name)
    plates = [p for p in kit.pieces if p.name.startswith("plate_")]
    assert sorted(k for p in plates for k in p.markers) == sorted(regions.marker.tolist())
    radius = dict(
        zip(
            regions.marker.tolist(),
            np.array([f.radius_mm for f in regions.faces])[regions.face],
            strict=True,
        )
    )
    for piece in plates:
        own = np.array(piece.markers)
        foot, normal = surface.point(markers.uv[own]), markers.normal[own]
        for k, at, up in zip(own.tolist(), foot, normal, strict=True):
            rod = prisms(at[None], (at + 12.0 * up)[None], radius[k], 24)
            assert (to_manifold(rod) ^ piece.body).volume() == pytest.approx(0.0, abs=1e-9)
        lid = surface.point(markers.uv, BOWL_mm + 0.2)
        bowls = prisms(surface.point(markers.uv, 0.1), lid, 0.5, 12)
        assert (to_manifold(bowls) ^ piece.body).volume() == pytest.approx(0.0, abs=1e-9)
    del design


def test_three_load_cells_stand_between_jaw_and_indenters() -> None:
    design, surface, markers = built(shipped("cylinder60"))
    regions, kit = kit_of("cylinder60")
    found = jaw(Sensor.of(design, surface, markers), regions, TOL_mm)
    assert found is not None
    jaw_body, pressed = found
    ids = list(pressed)
    frames, foot = frames_at(surface, markers.uv[ids]), surface.point(markers.uv[ids])
    body = placed(jaw_body, frames[0], foot[0])
    cells = [(frame, at, k) for k, (frame, at) in enumerate(zip(frames, foot, strict=True))]
    height = tool_height_mm(design.kit)
    others = []
    for frame, at, _ in cells:
        up = frame[:, 2]
        indenter = placed(kit.pieces[0].body, frame, at)
        rod = prisms(
            (at + (height + 0.01) * up)[None],
            (at + (height + design.kit.cell_height_mm - 0.01) * up)[None],
            design.kit.cell_diameter_mm / 2.0,
            48,
        )
        others += [indenter, to_manifold(rod)]
        # Just past the load cell stands the seat.
        seat = at + (height + design.kit.cell_height_mm + 0.5) * up
        place = seat + frame[:, 0] * (design.kit.cell_diameter_mm / 2.0 - 1.0)
        probe = to_manifold(prisms(place[None], (place + 0.2 * up)[None], 0.2, 12))
        assert (probe ^ body).volume() == pytest.approx(probe.volume(), rel=1e-6)
        holes = seat + np.column_stack([bolt_places(design.kit), [0.0] * 3]) @ frame.T
        through = prisms(holes, holes + 0.5 * up, 0.5, 12)
        assert (to_manifold(through) ^ body).volume() == pytest.approx(0.0, abs=1e-9)
    for k, one in enumerate(others):
        assert (one ^ body).volume() == pytest.approx(0.0, abs=1e-6)
        for other in others[k + 1 :]:
            assert (one ^ other).volume() == pytest.approx(0.0, abs=1e-6)
    shell = shell_manifold(Sensor.of(design, surface, markers), tolerance_mm=0.01)
    assert (body ^ shell).volume() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["grip", "patch"])
def test_posts_of_the_jaw_can_be_printed(name: str) -> None:
    """Apart on a waist, run into each other on a hollow face, but with no slit between them."""
    design, surface, markers = built(shipped(name))
    sensor = Sensor.of(design, surface, markers)
    found = jaw(sensor, make_regions(sensor), TOL_mm)
    assert found is not None
    report = check_body(to_triangles(found[0]), design.print_rules, spacing_mm=1.0, up=UP)
    assert [item.rule for item in report.violations] == []


def test_what_cannot_be_made_is_left_out_with_a_reason() -> None:
    _, kit = kit_of("hemisphere")
    assert set(kit.left_out) == {"gripper_three"}
    assert kit.cells == 1
    case = copy_of(family_design("cylinder"), wall={"rim_length_mm": 0.0})
    design, surface, markers = built(case)
    regions = make_regions(Sensor.of(design, surface, markers))
    made = kit_bodies(
        Sensor.of(design, surface, markers), regions, bowl_mm=BOWL_mm, tolerance_mm=0.05
    )
    assert "no rims" in made.left_out["collar"]


@pytest.mark.parametrize("name", ["cylinder", "plane"])
def test_a_kit_for_markers_that_nothing_reaches(name: str) -> None:
    """All stand at the rim: no indenter, no program, and no crash."""
    data = family_design(name).model_dump(mode="json")
    low = 0.7 if name == "cylinder" else 0.7 - data["shape"]["height_mm"] / 2.0
    positions = [[low, 0.3], [low, 2.3]]
    data["layout"] |= {"kind": "explicit", "positions": positions, "colours": ["blue"]}
    case = built(Design.model_validate(data))
    regions = make_regions(Sensor.of(*case))
    assert (len(regions.marker), len(regions.faces)) == (0, 0)
    assert len(regions.too_near) >= 1
    made = kit_bodies(Sensor.of(*case), regions, bowl_mm=BOWL_mm, tolerance_mm=0.05)
    assert {"gripper_palm", "gripper_three"} <= set(made.left_out)
    program = make_program(Sensor.of(*case), regions)
    assert "M100" not in gcode(program, "decoder", name="x")
    assert "too near a rim" in guide_text(case[0], case[2], regions, program, made)


def test_the_palm_is_as_wide_as_curvature_and_rims_let_it_be() -> None:
    design, surface, markers = built(shipped("cylinder60"))
    middle = int(np.abs(markers.uv[:, 0] - 60.0).argmin())
    assert palm_radius_mm(Sensor.of(design, surface, markers), middle) == pytest.approx(14.0)
    assert palm_radius_mm(Sensor.of(design, surface, markers), 0) == pytest.approx(
        2.6087 - 0.3, abs=1e-3
    )
    narrow = copy_of(design, shape={"diameter_outer_mm": 40.0}, layout={"height_far_mm": 4.0})
    assert palm_radius_mm(Sensor.of(*built(narrow)), middle) == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("depth_mm", "edge_mm", "radius_mm"), [(24.0, 4.0, 12.0), (26.0, 2.0, 14.0)]
)
def test_tools_stay_on_a_narrow_face(depth_mm: float, edge_mm: float, radius_mm: float) -> None:
    """A palm as wide as the face would hang over its edges, and so would an indenter on one."""
    shape = {"width_mm": 60.0, "depth_mm": depth_mm, "length_mm": 60.0, "edge_radius_mm": edge_mm}
    case = family_design("cuboid")
    narrow = copy_of(case, shape=shape, wall={"thickness_mm": 0.8})
    sensor = Sensor.of(*built(narrow))
    surface, uv = sensor.surface, sensor.markers.uv
    middle = int(np.argmin(np.linalg.norm(surface.point(uv) - [30.0, 0.0, 30.0], axis=1)))
    radius = palm_radius_mm(sensor, middle)
    assert RADIUS_MIN_mm < radius < radius_mm
    assert follows(surface, uv[[middle]], radius)[0]
    assert not follows(surface, uv[[middle]], radius_mm)[0]
    made = kit_bodies(sensor, make_regions(sensor), bowl_mm=BOWL_mm, tolerance_mm=0.05)
    assert "gripper_palm" not in made.left_out
    for piece in made.pieces:
        if piece.name == "collar":
            continue
        facts = manifold_facts(piece.body)
        assert 100.0 < facts.volume_mm3 < 1e5, piece.name
        assert np.ptp(facts.bounds_mm, axis=0).max() < 80.0, piece.name


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"cell_bolts": 12, "cell_bolt_circle_mm": 12.0}, "raise cell_bolt_circle_mm"),
        ({"cell_bolt_circle_mm": 18.0}, "outside a load cell"),
        ({"rig_bolt_square_mm": 14.0}, "raise rig_bolt_square_mm"),
        ({"hover_mm": 0.0}, "greater than 0.5"),
        ({"force_steps": 0}, "greater than or equal to 1"),
    ],
)
def test_kits_that_do_not_go_together_are_refused(change: dict[str, Any], match: str) -> None:
    with pytest.raises(ValidationError, match=match):
        KitSection(**change)


def test_an_s_beam_needs_one_stud() -> None:
    sections = {"cell_bolts": 1, "cell_bolt_circle_mm": 0.0, "cell_bolt_hole_mm": 6.2}
    case = copy_of(family_design("cylinder"), kit=sections)
    design, surface, markers = built(case)
    regions = make_regions(Sensor.of(design, surface, markers))
    made = kit_bodies(
        Sensor.of(design, surface, markers), regions, bowl_mm=BOWL_mm, tolerance_mm=0.05
    )
    genus = {p.name: manifold_facts(p.body).genus for p in made.pieces}
    assert genus["indenter_1"] == 0  # a blind hole for the stud
    assert genus["cell_seat"] == 5
