from typing import Any

import numpy as np
import pytest

from phytac_design.design.hardware_table import BOARDS, HardwareSection
from phytac_design.design.print_rules_table import PROCESSES
from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.assembly_checks import parts_list, verdict
from phytac_design.fabrication.hardware.bar import strip_mm
from phytac_design.fabrication.hardware.hardware_assembly import make_hardware
from phytac_design.fabrication.hardware.screws import SCREWS
from phytac_design.fabrication.hardware.sensor_solids import hardware_solids, sensor_solids
from phytac_design.fabrication.printing.print_checks import check_body
from phytac_design.geometry.triangles import prisms
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_facts import manifold_facts
from phytac_design.solids.solid_mesh import to_manifold, to_triangles
from tests.fabrication.hardware_cases import case, changed, solids, switches

SMALL: dict[str, Any] = {"rows": 4, "columns": 8}


def made(design: Design) -> tuple[Any, dict[str, Any]]:
    """Kit and solids of a design whose assembly passes all checks."""
    surface = design.surface()
    markers = make_markers(design, surface)
    kit = make_hardware(design, surface)
    bowls = switches(design, surface, markers)
    sensor = sensor_solids(Sensor.of(design, surface, markers), bowls, tolerance_mm=0.05)
    hardware = hardware_solids(design, surface, kit, tolerance_mm=0.05)
    cameras = list(cameras_of(design, surface))
    found = verdict(Sensor.of(design, surface, markers), bowls, cameras, kit, sensor | hardware)
    found.raise_failure()
    assert all(manifold_facts(body).bodies == 1 for body in hardware.values())
    return kit, hardware


@pytest.mark.parametrize(
    ("name", "tables"),
    [
        ("cylinder60", {"print_rules": {"process": "fdm", **PROCESSES["fdm"]}}),
        ("cylinder60", {"camera": {"ends": "both"}}),
        # Far away the view is narrow: no room for a spigot.
        ("cylinder60", {"camera": {"stand_off_mm": 150.0}}),
        ("cuboid", {"hardware": {"clamps": 3}}),
        ("cone", {"hardware": {"board": "raspberry-pi-v2", **BOARDS["raspberry-pi-v2"]}}),
    ],
)
def test_variants_pass_all_checks(name: str, tables: dict[str, Any]) -> None:
    design = changed(name, **tables, layout=SMALL)
    kit, hardware = made(design)
    assert len(hardware) == len(kit.parts) > 8


def test_tray_socket_and_inserts() -> None:
    design = changed(
        "cylinder60",
        hardware={"imu": "seat", "adapter": "handle", "thread": "heat-set"},
        layout=SMALL,
    )
    kit, hardware = made(design)
    assert {"imu_seat", "imu", "adapter"} <= set(hardware)
    listed = {(part["part"], part["note"]): part for part in parts_list(kit, hardware)}
    inserts = [part for (name, _), part in listed.items() if name.startswith("heat-set")]
    assert sum(part["count"] for part in inserts) == 2 + 4 + 3 + 4
    # The shaft goes in freely, as deep as asked, and no deeper.
    radius, depth = 15.0, design.hardware.adapter_depth_mm
    low = float(hardware["adapter"].bounding_box()[5])
    for share, free in ((1.0, True), (1.2, False)):
        ends = np.array([[0.0, 0.0, low + 1.0]]), np.array([[0.0, 0.0, low - share * depth]])
        shaft = to_manifold(prisms(*ends, radius, 64))
        assert ((shaft ^ hardware["adapter"]).volume() < 1e-6) is free


def test_presets_set_what_is_not_given() -> None:
    assert HardwareSection().board_size_mm == (38.0, 38.0)
    pi = HardwareSection(board="raspberry-pi-v2", back_room_mm=9.0)
    assert (pi.board_size_mm, pi.back_room_mm) == ((25.0, 23.862), 9.0)
    own = HardwareSection(board="32x32", board_size_mm=(33.0, 32.0))
    assert own.board_size_mm == (33.0, 32.0)
    assert own.board_holes_mm == BOARDS["32x32"]["board_holes_mm"]
    assert HardwareSection(**own.model_dump()) == own


def test_screws_are_the_standard_ones() -> None:
    """ISO 4762 heads (dk, k), ISO 273 medium clearance, tap drills of coarse threads."""
    expected = {
        "M2": (3.8, 2.0, 2.4, 1.6),
        "M2.5": (4.5, 2.5, 2.9, 2.05),
        "M3": (5.5, 3.0, 3.4, 2.5),
        "M4": (7.0, 4.0, 4.5, 3.3),
        "M5": (8.5, 5.0, 5.5, 4.2),
        "M6": (10.0, 6.0, 6.6, 5.0),
    }
    for name, (head, height, clearance, tap) in expected.items():
        screw = SCREWS[name]
        assert (screw.head_mm, screw.head_height_mm) == (head, height)
        assert (screw.clearance_mm, screw.tap_mm) == (clearance, tap)
        pitch = screw.nominal_mm - screw.tap_mm
        assert screw.minor_mm == pytest.approx(screw.nominal_mm - 1.22687 * pitch, abs=0.06)


def test_the_bar_stays_within_the_cylinder_of_the_scene() -> None:
    design, surface, _, _ = case("cylinder60")
    radius, length = design.light.bar_radius_mm, surface.bounds_mm()[1, 2]
    ends = np.array([[0.0, 0.0, 4.9]]), np.array([[0.0, 0.0, length]])
    cylinder = to_manifold(prisms(*ends, radius, 256))
    for name in ("bar", "light_strip_1", "light_strip_2"):
        inside = solids("cylinder60")[name].trim_by_plane((0.0, 0.0, -1.0), -length)
        assert inside.volume() > 50.0
        assert (inside - cylinder).volume() < 1e-6
    width, thick = strip_mm(design)
    assert width > 3.0
    assert thick == pytest.approx(1.19, abs=0.02)


def test_the_cable_leaves_the_cover() -> None:
    design, _, _, _ = case("cylinder60")
    cover, camera = solids("cylinder60")["cover"], solids("cylinder60")["camera"]
    low = cover.bounding_box()[2] + design.hardware.wall_mm + 2.0
    assert low < camera.bounding_box()[2]
    ends = np.array([[0.0, -40.0, low]]), np.array([[0.0, -10.0, low]])
    assert (to_manifold(prisms(*ends, 1.9, 32)) ^ cover).volume() < 1e-6


@pytest.mark.parametrize("board", ["38x38", "raspberry-pi-v2"])
def test_posts_of_the_cover_are_joined_to_walls_that_they_are_near(board: str) -> None:
    """Those of the default board would stand 0.05 mm off the cover's walls."""
    design = changed("cone", hardware={"board": board, **BOARDS[board]}, layout=SMALL)
    surface = design.surface()
    kit = make_hardware(design, surface)
    cover = hardware_solids(design, surface, kit, tolerance_mm=0.05)["cover"]
    found = check_body(to_triangles(cover), design.print_rules, spacing_mm=1.0)
    assert [item.rule for item in found.violations] == []
