"""The shell of a sensor whose markers are inserts, and what the camera sees of it."""

import numpy as np
import pytest

from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell.receptor_stiffness import tube_sizes_mm
from phytac_design.optics.render_scene import RESIN, RenderScene, build_scene, paint_owner
from phytac_design.solids.cad import cad_facts, shell_cad
from phytac_design.solids.mesh_facts import shell_facts
from phytac_design.solids.solid_mesh import painted_manifolds, shell_manifold
from phytac_shapes.arrays import FloatArray
from tests.fabrication.cases import design

TOLERANCE_mm = 0.005
RECEPTOR = {"colouring": "insert"}


def sensor(**sections: dict[str, object]) -> Sensor:
    sections["receptor"] = RECEPTOR | sections.get("receptor", {})
    return Sensor(design(**sections))


def test_shell_has_bores_seats_and_shorter_wider_tubes() -> None:
    one = sensor(layout={"height_near_mm": 4.0, "height_far_mm": 4.0})
    receptor, wall = one.design.receptor, one.design.wall
    solid = shell_manifold(one, tolerance_mm=TOLERANCE_mm)
    facts = shell_facts(solid, one.surface, one.markers)
    plain = Sensor(design(receptor={"diameter_hole_mm": 0.0}))
    post = shell_manifold(plain, tolerance_mm=TOLERANCE_mm).volume()
    bare = post - np.pi * 1.5**2 * plain.markers.height_mm.sum()
    tube, bore, seat = (
        value / 2.0
        for value in (
            receptor.diameter_tube_mm,
            receptor.diameter_bore_mm,
            receptor.diameter_seat_mm,
        )
    )
    depth = receptor.depth_seat_mm
    cone = np.pi * depth / 3.0 * (seat**2 + seat * bore + bore**2)
    own = np.pi * (tube**2 - bore**2) * 3.0
    own -= cone + np.pi * bore**2 * (wall.thickness_mm - depth)
    # The curved wall takes some 3 % of each of these away or adds it.
    assert facts.volume_mm3 - bare == pytest.approx(one.markers.count * own, rel=0.03)
    assert list(painted_manifolds(one)) == ["resin"]


def test_both_kernels_make_the_same_shell() -> None:
    one = sensor()
    assert (one.markers.height_mm > 1.0).any()
    assert (one.markers.height_mm < 1.0).any()  # without a tube
    for glued in (False, True):
        facts = cad_facts(shell_cad(one, glued=glued))
        mesh = shell_manifold(one, tolerance_mm=TOLERANCE_mm, glued=glued)
        assert facts.valid
        assert facts.solids == 1
        assert mesh.volume() == pytest.approx(facts.volume_mm3, rel=1e-4)


def test_solid_pins_leave_through_holes_in_the_shell_alone() -> None:
    one = sensor(receptor={"diameter_hole_mm": 0.0})
    shell = shell_manifold(one, tolerance_mm=0.02)
    assert shell.genus() == 1 + one.markers.count
    assert shell_manifold(one, tolerance_mm=0.02, glued=True).genus() == 1


def _ring(scene: RenderScene, one: Sensor, marker: int) -> tuple[FloatArray, FloatArray]:
    """Distance from the axis and from the base of a marker's paint."""
    corners = scene.vertices[np.unique(scene.triangles[paint_owner(scene.part) == marker])]
    arm = corners - one.markers.base_mm[marker]
    along = arm @ one.markers.direction[marker]
    return np.linalg.norm(arm - along[:, None] * one.markers.direction[marker], axis=1), along


def test_scene_shows_what_is_printed() -> None:
    one = sensor()
    scene = build_scene(one, tolerance_mm=0.01)
    receptor, last = one.design.receptor, one.markers.count - 1
    tall = float(one.markers.height_mm[last])
    off, along = _ring(scene, one, last)
    assert [off.min(), off.max()] == pytest.approx([0.8, 1.5])
    assert [along.min(), along.max()] == pytest.approx([tall - 1.0, tall])
    own = (scene.triangle_owner == last) & (scene.part == RESIN)
    points = scene.vertices[np.unique(scene.triangles[own])] - one.markers.base_mm[last]
    height = points @ one.markers.direction[last]
    width = np.linalg.norm(points - height[:, None] * one.markers.direction[last], axis=1)
    assert width.max() == pytest.approx(receptor.diameter_tube_mm / 2.0)
    assert height[width > 1.6].max() == pytest.approx(tall - 1.0)


def test_short_receptors_have_no_tube() -> None:
    one = sensor()
    diameter, height = tube_sizes_mm(one.design, one.markers)
    short = one.markers.height_mm <= 1.0
    assert (diameter[short] == 3.0).all()
    assert (height[short] == one.markers.height_mm[short]).all()
    assert diameter[~short] == pytest.approx(one.design.receptor.diameter_tube_mm)
    assert height[~short] == pytest.approx(one.markers.height_mm[~short] - 1.0)


def test_paint_in_several_materials_is_the_same_shell_as_pens() -> None:
    painted = sensor(receptor={"colouring": "paint"})
    printed = sensor(receptor={"colouring": "multi-material"})
    assert list(painted_manifolds(painted)) == list(painted_manifolds(printed))
    assert shell_manifold(painted).volume() == shell_manifold(printed).volume()
