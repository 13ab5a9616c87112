"""Designs at the ends of their ranges: right, or refused with what, got and fix."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.bundle import load_bundle
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.optics.raster import rasterise
from phytac_design.optics.scene import build_scene, paint_owner
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from phytac_design.stages.build import build
from phytac_design.stages.decoder import limit_facts
from phytac_shapes import Cone
from phytac_shapes.errors import DesignError, NumericalError
from tests.designs import of_shape
from tests.fabrication.cases import scaled

SMALL = {"width_px": 648, "height_px": 486, "focal_px": 242.5}
SHAPES: dict[str, dict[str, Any]] = {
    "cylinder": {"diameter_outer_mm": 40.0, "length_mm": 30.0},
    "cone": {"diameter_near_mm": 40.0, "diameter_far_mm": 30.0, "length_mm": 30.0},
    "plane": {"width_mm": 50.0, "height_mm": 40.0},
    "cuboid": {"width_mm": 36.0, "depth_mm": 36.0, "length_mm": 32.0, "edge_radius_mm": 6.0},
    "hemisphere": {"diameter_outer_mm": 40.0, "skirt_mm": 6.0},
    "grip": {"diameters_mm": [40.0, 44.0, 40.0], "length_mm": 36.0},
    "patch": {
        "points_mm": [
            [[x, y, -0.004 * (x * x + y * y)] for x in (-25.0, 0.0, 25.0)]
            for y in (-20.0, 0.0, 20.0)
        ]
    },
}
every_family = pytest.mark.parametrize("kind", sorted(SHAPES))


def grid(rows: int, columns: int, **more: Any) -> dict[str, Any]:
    table = {"kind": "straight", "rows": rows, "columns": columns}
    return table | {"heights": "constant", "height_near_mm": 2.0} | more


def seen(design: Design) -> dict[str, Any]:
    """Report of ``phytac check``: every figure a number, and nothing JSON cannot hold but inf."""
    report = checkup(design)
    assert "NaN" not in json.dumps(report)
    return report


def cylinder(**tables: Any) -> Design:
    layout = grid(4, 12, kind="spiral", heights="power", height_exponent=2.0, height_far_mm=4.0)
    return of_shape("cylinder", SHAPES["cylinder"], layout, camera=SMALL, **tables)


@pytest.mark.parametrize("factor", [0.05, 50.0])
def test_radius_of_one_millimetre_and_of_one_metre(factor: float) -> None:
    """A scaled sensor before the same camera gives the same picture."""
    small, base = seen(scaled(cylinder(), factor)), seen(cylinder())
    assert small["clear"]
    assert small["stand_off_mm"] == pytest.approx(factor * base["stand_off_mm"], rel=1e-9)
    # Pixel centres on an edge may fall to either side of it.
    for key, value in base["visibility"].items():
        assert small["visibility"][key] == pytest.approx(value, rel=0.01, abs=2.0), key
    density = base["markers"]["density_per_cm2"] / factor**2
    assert small["markers"]["density_per_cm2"] == pytest.approx(density, rel=1e-9)


@pytest.mark.parametrize("half_angle_deg", [0.5, 30.0, 60.0, 89.0])
def test_cones_from_nearly_a_cylinder_to_nearly_a_disc(half_angle_deg: float) -> None:
    slope = math.tan(math.radians(half_angle_deg))
    length = min(36.0, 20.0 / slope)
    near = 56.0
    narrow = {
        "diameter_near_mm": near,
        "diameter_far_mm": near - 2.0 * length * slope,
        "length_mm": length,
    }
    rows = max(int(length / math.cos(math.radians(half_angle_deg)) / 7.0), 1)
    layout = grid(rows, 6, height_far_mm=4.0, heights="power", height_near_mm=1.0)
    design = of_shape("cone", narrow, layout, camera=SMALL)
    surface, markers = check_design(design)
    assert isinstance(surface, Cone)
    assert surface.facts()["half_angle_deg"] == pytest.approx(half_angle_deg, abs=1e-9)
    ring = surface.point(markers.uv)
    radius = np.hypot(ring[:, 0], ring[:, 1])
    assert np.allclose(radius, near / 2.0 - ring[:, 2] * slope)
    assert seen(design)["clear"]


def test_a_wall_that_faces_away_is_not_seen() -> None:
    """A cone that widens faster than the view does hides its own inner face."""
    wide = {"diameter_near_mm": 12.0, "diameter_far_mm": 56.0, "length_mm": 4.0}
    report = seen(of_shape("cone", wide, grid(3, 6), camera=SMALL))
    assert report["visibility"]["occluded"] == report["markers"]["count"]
    assert "hidden" in report["advice"]


def dome(*, ring: bool) -> Design:
    """A marker on the pole of a ø40 mm dome, with 16 around it or alone."""
    pole = 10.0 * math.pi
    around = [[pole - 8.0, 2.0 * math.pi * k / 6.0] for k in range(6)]
    around += [[pole - 16.0, 2.0 * math.pi * (k + 0.5) / 10.0] for k in range(10)]
    layout = grid(1, 1, kind="explicit", height_near_mm=1.2)
    layout["positions"] = [[pole, 0.0], *(around if ring else [])]
    shape = {"diameter_outer_mm": 40.0, "skirt_mm": 0.0}
    return of_shape("hemisphere", shape, layout, camera=SMALL)


def test_a_marker_on_the_pole_is_read_by_its_neighbours(tmp_path: Path) -> None:
    """The camera looks along its normal: K·u cannot be used, its switch cannot be read."""
    design = dome(ring=True)
    built = build(design, tmp_path / "x", accuracy="draft", only=["decoder"], progress=quiet)
    bundle = load_bundle(built.out / "decoder")
    markers = make_markers(design, design.surface())
    pole = int(np.argmax(markers.mid_mm[:, 2]))
    assert np.hypot(*markers.mid_mm[pole, :2]) < 1e-9
    assert not bundle.stiffness_usable[pole]
    assert not bundle.tips.readable[pole]
    limits = limit_facts(bundle)
    assert pole in limits["switches_unreadable"]
    assert pole in limits["fem_unusable"]
    force = np.zeros(markers.count)
    force[pole] = 6.0
    shift = (bundle.model.compliance_px @ force).reshape(-1, 2)
    found = bundle.model.forces("koi_inverse", shift, np.array([pole]))
    assert found[pole] == pytest.approx(6.0, rel=1e-6)
    # But faintly: its neighbours move little, and the bundle knows.
    noise = bundle.model.inverse_noise_N_px
    assert noise[pole] == noise.max()


def test_a_lone_marker_on_the_pole_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NumericalError, match=r"moves no marker's image.*place more markers beside"):
        build(dome(ring=False), tmp_path / "x", accuracy="draft", only=["response"], progress=quiet)


def quiet(_: str) -> None:
    """No progress."""


def sharp(positions: list[list[float]], edge_mm: float = 0.81) -> Design:
    shape = SHAPES["cuboid"] | {"edge_radius_mm": edge_mm}
    layout = {"kind": "explicit", "positions": positions, "heights": "constant"}
    return of_shape("cuboid", shape, layout | {"height_near_mm": 2.0}, camera=SMALL)


def test_forces_beyond_the_wall_are_refused(tmp_path: Path) -> None:
    """A grip's 25 N on a sensor of 1 mm radius, whose wall is 0.04 mm thick."""
    tiny = scaled(cylinder(), 0.05)
    with pytest.raises(DesignError, match=r"too strong for this wall.*the sensor is 1 mm from"):
        build(tiny, tmp_path / "x", accuracy="draft", only=["twin"], progress=quiet)


def test_a_box_with_sharp_edges() -> None:
    """Edges as sharp as the wall is thick: markers on the faces are fine, on an edge not."""
    faces = [[z, s * 35.6 + c] for z in (8.0, 16.0, 24.0) for s in (1, 2, 3) for c in (-6.0, 6.0)]
    assert seen(sharp(faces))["clear"]
    edge = 18.0 - 0.81 + 0.81 * math.pi / 4.0
    with pytest.raises(DesignError, match=r"normals meet \(height 2.0 mm ≥ depth there 0.0 mm\)"):
        seen(sharp([[16.0, edge]]))
    with pytest.raises(DesignError, match=r"thickness 0.8 mm ≥ edge_radius_mm 0.5 mm.*below 0.5"):
        seen(sharp(faces, edge_mm=0.5))


@every_family
def test_one_marker(kind: str) -> None:
    report = seen(of_shape(kind, SHAPES[kind], grid(1, 1), camera=SMALL))
    assert report["markers"]["count"] == 1
    assert report["clear"]
    assert report["visibility"]["min_gap_px"] == math.inf


def test_ten_thousand_markers() -> None:
    """Layout, rules and exact map: every marker shows where it projects to."""
    layout = grid(100, 100, colour_pattern="checkerboard", height_near_mm=1.0)
    camera = {"width_px": 2000, "height_px": 2000, "focal_px": 1500.0}
    shape = {"width_mm": 700.0, "height_mm": 700.0}
    design = of_shape("plane", shape, layout, camera=camera)
    surface, markers = check_design(design)
    assert markers.count == 10_000
    view = camera_of(design, surface)
    scene = build_scene(design, surface, markers, tolerance_mm=tolerance_mm(view, markers))
    owner = paint_owner(rasterise(scene, view).part)
    y, x = np.nonzero(owner >= 0)
    number = np.bincount(owner[y, x], minlength=10_000)
    assert number.min() >= 3
    mean = np.column_stack([np.bincount(owner[y, x], weights=c) / number for c in (x, y)])
    # The next marker is 14 px away.
    assert np.linalg.norm(mean - view.project(markers.tip_mm), axis=1).max() < 2.0


@every_family
@pytest.mark.parametrize("stand_off_mm", [0.0, 1e-9, 1.0])
def test_a_camera_that_touches_the_shell(kind: str, stand_off_mm: float) -> None:
    near = {**SMALL, "stand_off_mm": stand_off_mm}
    with pytest.raises(DesignError, match=r"(stands inside|cannot see).*set camera.stand_off_mm"):
        seen(of_shape(kind, SHAPES[kind], grid(2, 4), camera=near))


def test_coincident_markers() -> None:
    layout = grid(1, 1, kind="explicit", positions=[[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(DesignError, match=r"number 0 and number 1 meet: they overlap by 2.40 mm"):
        seen(of_shape("plane", SHAPES["plane"], layout))


LEFT, RIGHT = [0.0, 0.0, 0.0], [30.0, 0.0, 0.0]
NO_AREA = {
    "a point": [[LEFT, LEFT], [LEFT, LEFT]],
    "a line": [[LEFT, RIGHT], [LEFT, RIGHT]],
    "a line given twice": [[LEFT, [10.0, 0.0, 0.0]], [[20.0, 0.0, 0.0], RIGHT]],
}


@pytest.mark.parametrize("name", sorted(NO_AREA))
def test_a_patch_without_area(name: str) -> None:
    with pytest.raises(DesignError, match=r"no area at some place \(got 0 mm².*space points_mm"):
        seen(of_shape("patch", {"points_mm": NO_AREA[name]}, grid(2, 2)))


def test_a_patch_that_is_nearly_a_line() -> None:
    thin = [[LEFT, RIGHT], [[0.0, 1e-7, 0.0], [30.0, 1e-7, 0.0]]]
    with pytest.raises(DesignError, match=r"lies 0.00 mm from the end of the surface"):
        seen(of_shape("patch", {"points_mm": thin}, grid(2, 2)))
