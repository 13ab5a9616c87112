"""Bodies before the camera: exact overlaps, and what is refused because it runs into what."""

import re
from typing import Any

import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.geometry.overlaps import distance_mm, tube_overlaps_mm, within
from phytac_design.geometry.triangles import TriangleMesh, cylinder_mesh
from phytac_design.layout import make_markers
from phytac_design.optics.render_scene import fixture_mesh
from phytac_design.rules.body_rules import wall_overlap_mm
from phytac_design.rules.check import check_design
from phytac_shapes.arrays import FloatArray
from tests.designs import of_shape
from tests.optics.cases import make_design
from tests.refusals import refused

FEW = {"rows": 3, "columns": 4, "height_near_mm": 3.0, "height_far_mm": 6.0}
SMALL = {"width_px": 648, "height_px": 486, "focal_px": 242.5}
ROD = {"name": "cable", "kind": "cylinder", "radius_mm": 1.0}
BOX = {"name": "plug", "kind": "box"}
FISHEYE = {"model": "kannala_brandt", "focal_px": 130.0, "width_px": 648, "height_px": 486}


def with_fixtures(*fixtures: dict[str, Any], **tables: Any) -> Design:
    design = make_design(layout=FEW, camera=SMALL, **tables)
    return Design.model_validate(design.model_dump(mode="json") | {"fixtures": fixtures})


def meshed(fixture: dict[str, Any]) -> TriangleMesh:
    return fixture_mesh(with_fixtures(fixture).fixtures[0], tolerance_mm=1e-5)


def block(centre: FloatArray, size: float, turn_deg: float = 0.0) -> dict[str, Any]:
    return BOX | {"centre_mm": centre.tolist(), "size_mm": [size] * 3, "turn_deg": turn_deg}


def rod(start: FloatArray, end: FloatArray, radius: float) -> dict[str, Any]:
    return ROD | {"from_mm": start.tolist(), "to_mm": end.tolist(), "radius_mm": radius}


def sampled(triangle: FloatArray, count: int = 60) -> FloatArray:
    """Points all over a triangle (3, 3), its edges too."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    s, t = i[i + j <= count] / count, j[i + j <= count] / count
    a, b, c = triangle
    return np.asarray(a + s[:, None] * (b - a) + t[:, None] * (c - a))


def test_triangles_meet_tubes_just_where_their_points_do() -> None:
    rng = np.random.default_rng(3)
    start, end = rng.normal(size=(2, 40, 3))
    axis = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    length = np.linalg.norm(end - start, axis=1)
    met = 0
    for _ in range(40):
        triangle = rng.normal(size=(3, 3)) * rng.choice([0.3, 1.0, 4.0])
        mesh = TriangleMesh(vertices_mm=triangle, triangles=np.array([[0, 1, 2]]))
        depth = tube_overlaps_mm(start, end, 0.4, mesh)
        arm = sampled(triangle)[None] - start[:, None]
        along = np.einsum("npi,ni->np", arm, axis)
        aside = np.linalg.norm(arm - along[..., None] * axis[:, None], axis=2)
        # Samples are up to a sixtieth of a side apart.
        coarse = np.ptp(triangle, axis=0).max() / 30.0
        for slack in (0.0, coarse):
            inside = (along >= -slack) & (along <= length[:, None] + slack)
            inside &= aside < 0.4 + slack
            hit = inside.any(axis=1)
            side = 0.4 - np.where(inside, aside, np.inf).min(axis=1)
            out = length - np.where(inside, along, np.inf).min(axis=1)
            wanted = np.minimum(side, out)
            if slack:
                assert hit[depth > 0.0].all()
                assert (depth[hit] <= np.maximum(wanted[hit], 0.0) + 2.0 * coarse).all()
            else:
                assert (depth[hit] >= wanted[hit] - 1e-9).all()
                assert (depth[hit] > 0.0).all()
        met += int((depth > 0.0).sum())
    assert 100 < met < 1500


def test_a_rod_beside_a_tube_overlaps_by_what_the_axes_lack() -> None:
    start, end = np.zeros((1, 3)), np.array([[0.0, 0.0, 10.0]])
    for away, depth in ((1.2, 1.3), (2.4, 0.1), (2.4999, 0.0001), (2.5001, 0.0)):
        mesh = cylinder_mesh(
            np.array([-20.0, away, 5.0]), np.array([20.0, away, 4.0]), 1.0, tolerance_mm=1e-6
        )
        assert tube_overlaps_mm(start, end, 1.5, mesh)[0] == pytest.approx(depth, abs=3e-5)
    # A wide block over the flat end: the ends' overlap counts, not a round end's.
    for gap in (-0.2, 0.3):
        lid = meshed(BOX | {"centre_mm": [0.7, 0, 15.0 + gap], "size_mm": [8.0, 8.0, 10.0]})
        assert tube_overlaps_mm(start, end, 1.5, lid)[0] == pytest.approx(max(-gap, 0.0))


def test_points_inside_bodies() -> None:
    points = np.random.default_rng(0).uniform(-6.0, 6.0, (1000, 3))
    tube = meshed(rod(np.array([0.0, 0.0, -4.0]), np.array([0.0, 0.0, 4.0]), 3.0))
    radius = np.hypot(points[:, 0], points[:, 1])
    sure = np.abs(radius - 3.0) > 1e-4
    truly = (radius < 3.0) & (np.abs(points[:, 2]) < 4.0)
    np.testing.assert_array_equal(within(points[sure], tube), truly[sure])
    cube = meshed(block(np.array([1.0, 0.0, 0.0]), 4.0))
    truly = np.asarray((np.abs(points - [1.0, 0.0, 0.0]) < 2.0).all(axis=1))
    np.testing.assert_array_equal(within(points, cube), truly)
    off = np.abs(points - [1.0, 0.0, 0.0]) - 2.0
    gap = np.where(truly, -off.max(axis=1), np.linalg.norm(np.maximum(off, 0.0), axis=1))
    for point, wanted in zip(points[:200], gap[:200], strict=True):
        assert distance_mm(point, cube) == pytest.approx(wanted, abs=1e-12)
    # A screen has no inside.
    screen = TriangleMesh(vertices_mm=cube.vertices_mm, triangles=cube.triangles[:5])
    assert not within(points, screen).any()


def tube_point(design: Design, marker: int, share: float, aside: float) -> FloatArray:
    """Point beside a receptor's axis, a share of the way from its foot to its tip."""
    markers = make_markers(design, design.surface())
    across = np.cross(markers.direction[marker], [0.0, 0.0, 1.0])
    on = markers.base_mm[marker] + share * (markers.tip_mm - markers.base_mm)[marker]
    return np.asarray(on + aside * across)


@pytest.mark.parametrize(("aside", "overlap"), [(2.3, "0.2 mm"), (2.45, "0.05 mm"), (2.51, "")])
def test_a_cable_beside_a_receptor(aside: float, overlap: str) -> None:
    plain = with_fixtures()
    centre = tube_point(plain, 9, 0.5, aside)
    along = np.array([0.0, 0.0, 2.0])
    design = with_fixtures(rod(centre - along, centre + along, 1.0))
    if not overlap:
        assert check_design(design).markers.count == 12
        return
    said = rf"fixture 'cable' overlaps the receptor \(row 2, column 1\) by {overlap}; move it away"
    with refused("fixture-overlaps-receptor") as caught:
        check_design(design)
    caught.match(said)


def test_a_body_in_the_way_of_a_red_tip_or_around_a_receptor() -> None:
    plain = with_fixtures()
    markers = make_markers(plain, plain.surface())
    reach = markers.height_mm[4]
    before = tube_point(plain, 4, 1.0 + 1.5 / reach, 0.0)
    with refused("fixture-overlaps-receptor") as caught:
        check_design(with_fixtures(block(before, 1.0)))
    caught.match(r"\(row 1, column 0\)")
    farther = tube_point(plain, 4, 1.0 + 2.2 / reach, 0.0)
    check_design(with_fixtures(block(farther, 1.0)))
    # Its surface touches no tube, but all tips are in it.
    whole = BOX | {"centre_mm": [0.0, 0.0, 60.0], "size_mm": [400.0] * 3}
    with refused("fixture-overlaps-receptor") as caught:
        check_design(with_fixtures(whole))
    caught.match("11 more")


def test_a_mesh_from_a_file_is_checked_by_its_triangles() -> None:
    plain = with_fixtures()
    cube = meshed(block(tube_point(plain, 2, 0.8, 0.0), 1.0, 20.0))
    table = {"vertices_mm": cube.vertices_mm.tolist(), "triangles": cube.triangles.tolist()}
    with refused("fixture-overlaps-receptor") as caught:
        check_design(with_fixtures({"name": "mine", "kind": "mesh"} | table))
    caught.match("'mine'")


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (22.0, ""),
        (26.1999, ""),
        (26.3, "reaches 0.1 mm into the wall (0.8 mm thick) at (29.30, 0.00"),
        (29.0, "goes through the wall (0.8 mm thick)"),
        (34.0, ""),
    ],
)
def test_fixtures_and_the_wall(x: float, message: str) -> None:
    """A slab whose outer edge is 3 mm from its middle; the inner face is at 29.2 mm."""
    slab = BOX | {"centre_mm": [x, 0.0, 110.0], "size_mm": [6.0, 1e-3, 2.0]}
    design = with_fixtures(slab)
    if not message:
        check_design(design)
        return
    with refused("fixture-in-wall") as caught:
        check_design(design)
    caught.match(re.escape(f"the fixture 'plug' {message}"))


def test_a_body_that_is_nowhere_near_the_wall_with_its_corners_still_meets_it() -> None:
    """A long slat through the wall: only points between its corners are in it."""
    design = with_fixtures()
    slat = meshed(
        BOX | {"centre_mm": [0.0, 27.0, 60.0], "size_mm": [90.0, 1.0, 1.0], "turn_deg": 0.0}
    )
    assert wall_overlap_mm(design, design.surface(), slat)[0] > 0.5
    rest = meshed(BOX | {"centre_mm": [0.0, 60.0, 60.0], "size_mm": [90.0, 1.0, 1.0]})
    assert wall_overlap_mm(design, design.surface(), rest)[0] == 0.0


def test_a_bar_wider_than_the_far_end_is_refused() -> None:
    cone = {"diameter_near_mm": 40.0, "diameter_far_mm": 8.0, "length_mm": 30.0}
    layout = {
        "kind": "straight",
        "rows": 1,
        "columns": 4,
        "height_near_mm": 1.0,
        "height_far_mm": 1.0,
    }
    said = r"light bar reaches .* into the wall at .*radius 5 mm\); lower light.bar_radius_mm"
    with refused("light-bar-in-wall") as caught:
        check_design(of_shape("cone", cone, layout, light={"bar_radius_mm": 5.0}))
    caught.match(said)


PAD = {"width_mm": 50.0, "height_mm": 40.0}
ALONE = {
    "kind": "explicit",
    "positions": [[0.0, 0.0]],
    "heights": "constant",
    "height_near_mm": 3.0,
}


@pytest.mark.parametrize(("off", "words"), [(0.0, "0 mm"), (1.1, "1.10 mm")])
def test_a_fisheye_in_a_receptor_is_refused(off: float, words: str) -> None:
    """It sees the rim, as its field is wider than a half space."""
    layout = ALONE | {"positions": [[off, 0.0]]}
    near = FISHEYE | {"stand_off_mm": 3.0}
    said = rf"the camera stands inside the receptor number 0 .* {words} from the tube's axis"
    with refused("camera-inside-receptor") as caught:
        check_design(of_shape("plane", PAD, layout, camera=near))
    caught.match(said)
    check_design(of_shape("plane", PAD, layout | {"positions": [[6.0, 0.0]]}, camera=near))


@pytest.mark.parametrize(
    ("size", "words"), [(4.0, "inside the fixture 'plug'"), (2.0, "on the fixture 'plug'")]
)
def test_a_camera_in_a_fixture_is_refused(size: float, words: str) -> None:
    camera = SMALL | {"stand_off_mm": 30.0}
    body = {"centre_mm": [0.0, 0.0, -31.0], "size_mm": [3.0, 3.0, size]}
    design = make_design(layout=FEW, camera=camera)
    data = design.model_dump(mode="json") | {"fixtures": [BOX | body]}
    with refused("camera-on-fixture") as caught:
        check_design(Design.model_validate(data))
    caught.match(f"the camera stands {words}")
    data["fixtures"][0]["size_mm"][2] = 1.9
    check_design(Design.model_validate(data))


def test_a_camera_behind_a_patch_that_bulges_towards_it_is_refused() -> None:
    points = [
        [[x, y, 0.02 * (x * x + y * y) - 20.0] for x in (-25.0, 0.0, 25.0)]
        for y in (-20.0, 0.0, 20.0)
    ]
    layout = {"kind": "straight", "rows": 2, "columns": 3, "heights": "constant"}
    for stand_off in ("fit", 15.0, 19.5):
        near = FISHEYE | {"stand_off_mm": stand_off}
        with refused("camera-inside-wall"):
            check_design(of_shape("patch", {"points_mm": points}, layout, camera=near))


def test_bodies_beyond_the_edges_are_not_in_the_wall() -> None:
    """Rims are left out: connectors sit on them."""
    end = BOX | {"centre_mm": [29.6, 0.0, -6.0], "size_mm": [4.0, 4.0, 6.0]}
    check_design(with_fixtures(end))
    with refused("fixture-in-wall"):
        check_design(with_fixtures(end | {"size_mm": [4.0, 4.0, 14.0]}))
    points = [
        [[x, y, -0.004 * (x * x + y * y)] for x in (-25.0, 0.0, 25.0)] for y in (-20.0, 0.0, 20.0)
    ]
    layout = {"kind": "straight", "rows": 2, "columns": 3, "heights": "constant"}
    data = of_shape("patch", {"points_mm": points}, layout, camera=SMALL).model_dump(mode="json")
    for x, touches in ((28.5, False), (26.0, True)):
        beside = BOX | {"centre_mm": [x, 0.0, -2.0], "size_mm": [4.0, 4.0, 8.0]}
        design = Design.model_validate(data | {"fixtures": [beside]})
        depth, _ = wall_overlap_mm(
            design, design.surface(), fixture_mesh(design.fixtures[0], tolerance_mm=0.01)
        )
        assert (depth > 0.0) is touches
