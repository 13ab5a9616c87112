from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.fabrication.hardware import assembly_checks
from phytac_design.fabrication.hardware.assembly_checks import verdict
from phytac_design.fabrication.hardware.by_mesh import MeshKernel
from phytac_design.fabrication.hardware.checks import (
    hidden_rays,
    light_leaks,
    meets,
    sides_of_joint,
)
from phytac_design.fabrication.hardware.hardware_assembly import check_hardware, make_hardware
from phytac_design.fabrication.hardware.screws import SCREWS
from phytac_design.fabrication.hardware.sensor_solids import SHELL, SWITCHES, hardware_solids
from phytac_design.fabrication.hardware.solid_nodes import Circle, Difference, Prism, Rod, Union
from phytac_design.geometry.envelope import edge_mm
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import merged
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_facts import manifold_facts, trimesh_facts
from phytac_design.solids.solid_mesh import to_triangles
from tests.fabrication.hardware_cases import SHIPPED, case, changed, solids, switches
from tests.long_cases import TUBES, with_long
from tests.refusals import refused

every_shape = pytest.mark.parametrize("name", with_long(SHIPPED, TUBES))


def judged(name: str, bodies: dict[str, Any]) -> Any:
    design, surface, markers, kit = case(name)
    made = switches(design, surface, markers)
    cameras = list(cameras_of(design, surface))
    return verdict(Sensor.of(design, surface, markers), made, cameras, kit, bodies)


@every_shape
def test_printed_parts_are_watertight_and_one_body(name: str) -> None:
    kit = case(name)[3]
    printed = [part.name for part in kit.parts if part.printed]
    assert len(printed) >= 2
    for part in printed:
        solid = solids(name)[part]
        for facts in (manifold_facts(solid), trimesh_facts(to_triangles(solid))):
            assert (facts.watertight, facts.bodies) == (True, 1), part
        assert solid.volume() > 100.0


@every_shape
def test_assemblies_pass_all_checks(name: str) -> None:
    found = judged(name, solids(name))
    assert found.meets_mm3 == {}
    assert found.pairs == len(solids(name)) * (len(solids(name)) - 1) // 2
    assert all(sides.agree for sides in found.sides)
    assert (found.uncovered, found.leaks, found.hidden) == (0, 0, 0)
    assert min(found.rays, found.lines) > 1000
    found.raise_failure()


@pytest.fixture
def no_collisions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the time of a verdict goes into them: for tests of its other parts."""
    monkeypatch.setattr(assembly_checks, "meets", lambda _: {})


def test_a_collision_is_found_and_named() -> None:
    bodies = dict(solids("cylinder60"))
    bodies["bar"] = bodies["bar"].translate((0.0, 1.0, 0.0))
    found = judged("cylinder60", bodies)
    # The bar's core is 2.4 mm thick and moves 1 mm into a gap of 0.4 mm around ø6 mm.
    assert found.meets_mm3["bar / connector"] > 0.1
    with refused("hardware-collides"):
        found.raise_failure()


def test_common_volumes_are_exact() -> None:
    kernel = MeshKernel(case("cylinder60")[1], 0.01)
    one, other = (
        kernel.solid(Prism(outline=Circle(radius_mm=3.0), low_mm=low, high_mm=low + 2.0))
        for low in (0.0, 1.5)
    )
    assert meets({"a": one, "b": other}) == {"a / b": pytest.approx(np.pi * 9.0 * 0.5, rel=1e-9)}
    assert meets({"a": one, "b": other.translate((0.0, 0.0, 0.5))}) == {}


@pytest.mark.usefixtures("no_collisions")
def test_a_screw_mismatch_is_found() -> None:
    """The mount's holes are for M2.5, the cover's for M2: the labs' complaint."""
    design, surface, _, kit = case("cylinder60")
    joint = next(joint for joint in kit.joints if joint.name == "camera")
    wrong = replace(joint, screw=SCREWS["M2.5"])
    mount = next(part for part in kit.parts if part.name == "mount")
    other = replace(mount, node=Difference(body=mount.node, tools=wrong.holding()))
    made = replace(kit, parts=tuple(other if p is mount else p for p in kit.parts))
    bodies = solids("cylinder60") | hardware_solids(design, surface, made, tolerance_mm=0.05)
    meshes = {key: to_triangles(bodies[key]) for key in ("mount", "cover")}
    sides = sides_of_joint(joint, meshes)
    assert (set(sides.passing), set(sides.holding)) == ({"M2"}, {"M2.5"})
    assert not sides.agree
    found = judged("cylinder60", bodies)
    with refused("screw-holes-misaligned"):
        found.raise_failure()


@pytest.mark.parametrize("size", sorted(SCREWS))
def test_measured_holes_are_those_of_the_screw(size: str) -> None:
    design = changed(
        "cylinder60",
        hardware={
            "screw_camera": size,
            "wall_mm": 2.0 * SCREWS[size].nominal_mm + 3.0,
            "front_room_mm": 5.0,
            "back_room_mm": 2.0,
            "lens_length_mm": 60.0,
            "board_size_mm": (60.0, 60.0),
            "board_holes_mm": ((22.0, 22.0), (-22.0, -22.0)),
        },
    )
    surface = design.surface()
    kit = make_hardware(design, surface)
    bodies = hardware_solids(design, surface, kit, tolerance_mm=0.05)
    joint = next(joint for joint in kit.joints if joint.name == "camera")
    sides = sides_of_joint(joint, {name: to_triangles(body) for name, body in bodies.items()})
    assert set(sides.passing) == set(sides.holding) == {size}
    screw = SCREWS[size]
    assert joint.length_mm in screw.lengths_mm
    assert joint.length_mm - joint.grip_mm >= 1.5 * screw.nominal_mm - 1e-9
    assert joint.length_mm - joint.grip_mm <= joint.depth_mm


@pytest.mark.usefixtures("no_collisions")
def test_a_hole_to_the_outside_leaks_light() -> None:
    name = "cylinder60"
    _, surface, _, kit = case(name)
    mount = next(part for part in kit.parts if part.name == "mount")
    drill = Rod(start_mm=(0.0, 0.0, -25.0), end_mm=(60.0, 0.0, -25.0), radius_mm=2.0)
    open_mount = MeshKernel(surface, 0.04).solid(Difference(body=mount.node, tools=(drill,)))
    found = judged(name, solids(name) | {"mount": open_mount})
    assert found.leaks > 0
    with refused("light-leaks"):
        found.raise_failure()


def test_a_leak_is_as_large_as_its_solid_angle() -> None:
    """A sphere of light in a closed box with a round hole: the share of rays is the hole's."""
    kernel = MeshKernel(case("cylinder60")[1], 0.01)
    box = Prism(outline=Circle(radius_mm=10.0), low_mm=-10.0, high_mm=10.0)
    room = Prism(outline=Circle(radius_mm=9.0), low_mm=-9.0, high_mm=9.0)
    hole = Prism(outline=Circle(radius_mm=5.0), low_mm=8.0, high_mm=11.0)
    count = 20000
    closed = to_triangles(kernel.solid(Difference(body=box, tools=(room,))))
    assert light_leaks(closed, np.zeros((1, 3)), count) == (0, count)
    open_box = to_triangles(kernel.solid(Difference(body=box, tools=(room, hole))))
    leaks, _ = light_leaks(open_box, np.zeros((1, 3)), count)
    share = (1.0 - 10.0 / np.hypot(10.0, 5.0)) / 2.0
    assert leaks / count == pytest.approx(share, rel=0.02)


@pytest.mark.usefixtures("no_collisions")
def test_a_body_before_the_markers_is_found() -> None:
    name = "cylinder60"
    spoke = Rod(start_mm=(0.0, 0.0, -2.0), end_mm=(29.0, 0.0, -2.0), radius_mm=1.0)
    _, surface, _, kit = case(name)
    mount = next(part for part in kit.parts if part.name == "mount")
    held = MeshKernel(surface, 0.04).solid(Union(parts=(mount.node, spoke)))
    found = judged(name, solids(name) | {"mount": held})
    assert found.hidden > 0
    with refused("hardware-hides-markers"):
        replace(found, meets_mm3={}, leaks=0).raise_failure()


def test_the_bar_that_the_scene_knows_does_not_count_as_hiding() -> None:
    design, surface, markers, _ = case("cylinder60")
    thick = design.model_copy(
        update={"light": design.light.model_copy(update={"bar_radius_mm": 2.0})}
    )
    cameras = list(cameras_of(design, surface))
    bar = to_triangles(solids("cylinder60")["bar"])
    assert hidden_rays(Sensor.of(design, surface, markers), cameras, bar)[0] == 0
    # A scene with a thinner bar than the printed one would be wrong, and is found out.
    flat = Rod(start_mm=(0.0, 0.0, 5.0), end_mm=(0.0, 0.0, 120.0), radius_mm=6.0)
    fat = to_triangles(MeshKernel(surface, 0.01).solid(flat))
    assert hidden_rays(Sensor.of(thick, surface, markers), cameras, fat)[0] > 0


@every_shape
def test_the_lens_stands_where_the_camera_does(name: str) -> None:
    design, surface, _, kit = case(name)
    (camera,) = cameras_of(design, surface)
    for part in (part for part in kit.parts if part.name == "camera"):
        front = solids(name)[part.name].bounding_box()[5]
        assert front == pytest.approx(
            camera.position_mm[2] + design.hardware.lens_pupil_mm, abs=1e-6
        )


@pytest.mark.parametrize(
    "name", with_long(("cylinder60", "cone", "cuboid", "hemisphere", "patch"), TUBES)
)
def test_the_camera_sees_the_whole_edge(name: str) -> None:
    design, surface, _, kit = case(name)
    (camera,) = cameras_of(design, surface)
    parts = [p.name for p in kit.parts if not p.name.startswith(("camera", "bar", "light_strip"))]
    tree = RayTree(merged([to_triangles(solids(name)[part]) for part in parts]))
    line = edge_mm(surface, 0, -design.wall.thickness_mm) - camera.position_mm
    length = np.linalg.norm(line, axis=1)
    start = np.broadcast_to(camera.position_mm, line.shape)
    assert (tree.cast(start, line / length[:, None], length).triangle < 0).all()


def test_a_camera_at_the_far_end_has_the_same_hardware_turned() -> None:
    near, far = (
        changed("cylinder60", camera={"ends": ends}, light={"bar_radius_mm": 0.0})
        for ends in ("near", "far")
    )
    parts = {}
    for design in (near, far):
        surface = design.surface()
        kit = make_hardware(design, surface)
        parts[design.camera.ends] = hardware_solids(design, surface, kit, tolerance_mm=0.05)
    assert set(parts["near"]) == set(parts["far"])
    for name, solid in parts["near"].items():
        low, high = np.reshape(solid.bounding_box(), (2, 3))
        other = np.reshape(parts["far"][name].bounding_box(), (2, 3))
        turned = np.array([[low[0], -high[1], 120.0 - high[2]], [high[0], -low[1], 120.0 - low[2]]])
        assert parts["far"][name].volume() == pytest.approx(solid.volume(), rel=1e-9)
        if not name.startswith("screw"):
            assert other == pytest.approx(turned, abs=0.05)


def test_two_cameras_get_two_mounts_and_no_bar() -> None:
    design = changed("cylinder60", camera={"ends": "both"})
    kit = make_hardware(design, design.surface())
    names = {part.name for part in kit.parts if part.printed}
    assert names == {"mount_near", "mount_far", "cover_near", "cover_far"}
    assert "hide" in kit.left_out["light bar"]


@pytest.mark.parametrize(
    ("name", "tables", "code"),
    [
        ("cylinder60", {"hardware": {"screw_clamp": "M5"}}, "set-screw-edge-distance"),
        ("cylinder60", {"hardware": {"screw_camera": "M5"}}, "screw-thread-too-short"),
        ("cylinder60", {"hardware": {"wall_mm": 2.0}}, "set-screw-thread-short"),
        (
            "cylinder60",
            {"hardware": {"board_size_mm": (180.0, 180.0)}},
            "hardware-exceeds-bed",
        ),
        ("cylinder60", {"hardware": {"lens_diameter_mm": 70.0}}, "hardware-part-too-wide"),
        (
            "cylinder60",
            {"camera": {"stand_off_mm": 34.0}, "hardware": {"lens_pupil_mm": 32.0,
             "lens_length_mm": 40.0}},
            "camera-unit-too-long",
        ),
        ("cylinder60", {"hardware": {"lens_length_mm": 5.0}}, "mount-before-lens"),
        ("cone", {"hardware": {"lens_diameter_mm": 44.0}}, "hardware-part-too-wide"),
        ("cylinder60", {"light": {"bar_radius_mm": 3.0},
                        "hardware": {"adapter": "handle", "adapter_diameter_mm": 60.0}},
         "adapter-too-wide"),
        ("plane", {"hardware": {"adapter": "handle"}}, "adapter-on-sheet"),
        ("plane", {"shape": {"tilt_deg": 40.0}, "hardware": {"clamps": 5},
                   "camera": {"stand_off_mm": 90.0}}, "rim-lean-too-large"),
        ("plane", {"wall": {"rim_length_mm": 1.0}, "hardware": {"clamps": 5}}, "rim-too-short"),
        ("cylinder60", {"wall": {"rim_length_mm": 0.0}, "hardware": {"clamps": 5}},
         "hardware-needs-rim"),
        (
            "cylinder60",
            {"wall": {"thickness_mm": 0.4, "rim_flange_mm": 0.4, "rim_length_mm": 6.0}},
            "set-screw-too-strong",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(name: str, tables: dict[str, Any], code: str) -> None:
    design = changed(name, **tables)
    with refused(code):
        make_hardware(design, design.surface())
    if design.hardware != case(name)[0].hardware:
        with refused(code):
            check_hardware(design, design.surface())


@pytest.mark.parametrize(
    ("hardware", "match"),
    [
        ({"board_holes_mm": ((30.0, 0.0), (-17.0, 0.0))}, r"hole .* at \(30, 0\)"),
        ({"lens_pupil_mm": 30.0}, "lens_pupil_mm must be less"),
        ({"screw_camera": "M7"}, "screw_camera"),
    ],
)
def test_sizes_that_contradict_are_refused(hardware: dict[str, Any], match: str) -> None:
    with refused("field-invalid") as caught:
        changed("cylinder60", hardware=hardware)
    caught.match(match)


def test_defaults_of_shipped_designs_are_never_refused_early() -> None:
    bare = changed("cylinder60", wall={"rim_length_mm": 0.0})
    check_hardware(bare, bare.surface())


def test_shell_and_switches_are_in_the_comparison() -> None:
    assert {SHELL, SWITCHES} <= set(solids("cylinder60"))
    bodies = dict(solids("cylinder60"))
    bodies["connector"] = bodies["connector"].translate((0.0, 0.0, -1.0))
    found = meets(bodies)
    assert found["shell / connector"] > 100.0
