"""Which regions are pressed, by symmetry, and the faces that fit them."""

import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.fabrication.calibration_rig.regions import (
    FIT_mm,
    RADIUS_MIN_mm,
    clear_mm,
    disc_places,
    frames_at,
    heights_mm,
    make_regions,
    radii_mm,
)
from phytac_design.fabrication.calibration_rig.symmetry import find_symmetry
from phytac_design.layout.sensor import Sensor
from phytac_design.stages.build import copy_of
from tests.fabrication.cases import FAMILIES, built, family_design, shipped

SHAPES = ("cylinder60", "cone", "cuboid", "grip", "hemisphere", "plane", "patch")


def symmetry(design: Design) -> tuple[int, int, int]:
    _, surface, markers = built(design)
    found = find_symmetry(surface, markers)
    return found.turns, found.mirrors, len(found.needed)


def test_a_spiral_of_two_colours_needs_two_columns() -> None:
    """As the paper says; with one colour one column will do, and four need four."""
    design = shipped("cylinder60")
    assert symmetry(design) == (8, 0, 46)
    _, surface, markers = built(design)
    needed = find_symmetry(surface, markers).needed
    assert set(markers.column[needed].tolist()) == {0, 1}
    assert symmetry(copy_of(design, layout={"colours": ["blue"]})) == (16, 0, 23)
    four = ["blue", "green", "yellow", "magenta"]
    assert symmetry(copy_of(design, layout={"colours": four})) == (4, 0, 92)
    three = ["blue", "green", "yellow"]
    assert symmetry(copy_of(design, layout={"colours": three})) == (1, 0, 368)


def test_mirrors_count_too() -> None:
    straight = copy_of(shipped("cylinder60"), layout={"kind": "straight"})
    turns, mirrors, needed = symmetry(straight)
    assert (turns, mirrors) == (8, 8)
    assert needed == 46
    assert symmetry(shipped("plane")) == (1, 1, 70)
    assert symmetry(shipped("hemisphere")) == (1, 0, 84)


@pytest.mark.parametrize("name", SHAPES)
def test_every_region_is_like_one_that_is_pressed(name: str) -> None:
    """Every symmetry keeps distances, paint and height; together they reach every marker."""
    _, surface, markers = built(shipped(name))
    found = find_symmetry(surface, markers)
    points = surface.point(markers.uv)
    some = np.random.default_rng(0).integers(0, markers.count, (300, 2))
    apart = np.linalg.norm(points[some[:, 0]] - points[some[:, 1]], axis=1)
    for onto in found.maps:
        there = points[onto]
        moved = np.linalg.norm(there[some[:, 0]] - there[some[:, 1]], axis=1)
        assert moved == pytest.approx(apart, abs=1e-6)
        assert np.array_equal(markers.colour[onto], markers.colour)
        assert markers.height_mm[onto] == pytest.approx(markers.height_mm)
    reached = np.unique(found.maps[:, found.needed])
    assert np.array_equal(reached, np.arange(markers.count))
    assert np.isin(found.alike, found.needed).all()
    assert len(found.needed) * len(found.maps) >= markers.count


def explicit(positions: list[list[float]], shape: str | None = None, **layout: object) -> Design:
    data = family_design("cylinder").model_dump(mode="json")
    data["shape"] = FAMILIES[shape or "cylinder"]
    data["layout"] |= {"kind": "explicit", "positions": positions, "colours": ["blue"], **layout}
    return Design.model_validate(data)


def test_one_marker_out_of_place_ends_the_symmetry() -> None:
    even = [[25.0, k * np.pi / 2.0] for k in range(4)]
    assert symmetry(explicit(even))[0] == 4
    moved = [[25.0, 0.001], *even[1:]]
    assert symmetry(explicit(moved))[0] == 1
    taller = explicit(even, position_heights_mm=[2.0, 2.0, 2.0, 2.5])
    assert symmetry(taller)[0] == 1


def test_markers_that_are_alike_on_a_surface_that_is_not() -> None:
    """Two markers mirror each other through a plane that the box does not mirror in."""
    x, y = 23.0, 18.0
    side = 6.0
    other = float(np.sqrt(x * x + side * side - y * y))
    positions = [[x, side, 25.0], [other, y, 25.0]]
    assert symmetry(explicit(positions, "cuboid")) == (1, 0, 2)


def test_heights_of_cylinder_and_ball_by_closed_form() -> None:
    xy = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0], [2.0, -3.0]])
    cylinder = shipped("cylinder60").surface()
    found = heights_mm(cylinder, np.array([[40.0, 1.0], [80.0, 4.0]]), xy)
    due = np.sqrt(30.0**2 - xy[:, 1] ** 2) - 30.0
    assert found == pytest.approx(np.tile(due, (2, 1)), abs=1e-8)
    dome = shipped("hemisphere").surface()
    # One near the pole: the disc lies over it.
    found = heights_mm(dome, np.array([[30.0, 0.3], [10.0, 2.0]]), xy)
    due = np.sqrt(20.0**2 - np.sum(xy**2, axis=1)) - 20.0
    assert found == pytest.approx(np.tile(due, (2, 1)), abs=1e-7)


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_heights_lie_on_the_surface(name: str) -> None:
    design, surface, markers = built(family_design(name))
    uv = markers.uv[[5]]
    places = disc_places(3.0, rings=1, sectors=3)
    frame = frames_at(surface, uv)[0]
    points = surface.point(uv) + places @ frame[:, :2].T
    points += heights_mm(surface, uv, places)[0][:, None] * frame[:, 2]
    assert points == pytest.approx(surface.point(surface.chart(points)), abs=2e-6)
    assert frame.T @ frame == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    del design


@pytest.mark.parametrize("name", SHAPES)
def test_faces_fit_every_region_they_serve(name: str) -> None:
    """On a finer disc than the one they were chosen on."""
    design, surface, markers = built(shipped(name))
    regions = make_regions(Sensor.of(design, surface, markers))
    assert len(regions.too_near) == 0
    assert sorted(regions.marker.tolist()) == regions.symmetry.needed.tolist()
    for k, face in enumerate(regions.faces):
        assert face.radius_mm >= RADIUS_MIN_mm
        own = regions.marker[regions.face == k]
        assert face.marker in own
        places = disc_places(face.radius_mm, rings=5, sectors=36)
        found = heights_mm(surface, markers.uv[np.append(own, face.marker)], places)
        apart = found[:-1] - found[-1]
        assert np.ptp(apart, axis=1).max() / 2.0 <= FIT_mm + 0.005
        clear = clear_mm(design, surface, markers.uv[own])
        assert np.all(face.radius_mm + design.kit.clearance_mm <= clear)


def test_rims_leave_room_only_for_narrow_indenters() -> None:
    design, surface, markers = built(shipped("cylinder60"))
    uv = np.array([[60.0, 0.0], [4.0, 0.0], [3.0, 0.0], [1.0, 0.0], [118.0, 0.0]])
    assert clear_mm(design, surface, uv) == pytest.approx([60.0, 4.0, 3.0, 1.0, 2.0], abs=1e-4)
    assert radii_mm(design, surface, uv) == pytest.approx([4.0, 3.0, 2.25, 0.0, 1.6875])
    bare = copy_of(design, wall={"rim_flange_mm": 0.0})
    assert radii_mm(bare, surface, uv) == pytest.approx([4.0] * 5)
    near = explicit([[0.9, 0.3], [25.0, 2.0]])
    regions = make_regions(Sensor.of(*built(near)))
    assert regions.too_near.tolist() == [0]
    assert regions.marker.tolist() == [1]
    del markers
