"""Molds: cavities are the switches, shrinkages taken out; plates release, close and fit."""

from dataclasses import replace
from pathlib import Path

import manifold3d
import numpy as np
import pytest

from phytac_design.fabrication.molds.audit import (
    Audit,
    audit_set,
    cavities_of,
    check_mold,
    check_release,
    fine_sections,
    fit_of,
    halves_of,
    releases_of,
    shared_mm3,
    volumes_mm3,
)
from phytac_design.fabrication.molds.make import TURNED, MoldSet
from phytac_design.fabrication.switch_set import SwitchSet, revolve, revolved_volume_mm3
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.solids.mesh_export import write_stl
from phytac_design.solids.solid_mesh import to_manifold
from phytac_shapes.arrays import FloatArray
from tests.fabrication.molds import WAYS, molds, switch_set
from tests.fabrication.test_export import assert_admesh_finds_nothing, needs_admesh
from tests.refusals import refused

TWO = switch_set((1.0, 2.0, 6.0, 6.0), (0, 1, 0, 1), {}, {"depth_mm": 1.6, "diameter_mm": 4.2})


def moved(mesh: TriangleMesh, away: FloatArray) -> TriangleMesh:
    return TriangleMesh(vertices_mm=mesh.vertices_mm + away, triangles=mesh.triangles)


def audit_of(made: MoldSet, switches: SwitchSet) -> Audit:
    return audit_set(made, fine_sections(switches))


def changed(made: MoldSet, name: str, mesh: TriangleMesh) -> MoldSet:
    return MoldSet(plan=made.plan, sizes=made.sizes, parts={**made.parts, name: mesh})


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("switches", [switch_set(), TWO], ids=["one bowl", "two bowls"])
def test_every_part_is_sound(way: str, switches: SwitchSet) -> None:
    (made,) = molds(switches, way=way, tolerance_mm=0.01)
    audit = audit_of(made, switches)
    check_mold(made, audit)
    assert audit.undercut_mm2 < 1e-5
    assert audit.draft_deg >= 0.5 - 1e-9
    assert audit.shared_mm3 < 1e-9
    assert audit.volume_error < 0.002
    assert audit.hausdorff_mm < 0.01
    assert set(audit.fits) == set(switches.kinds)
    for name, mesh in made.parts.items():
        solid = to_manifold(mesh)
        holes = made.plan.cavities if name == "core_plate" else 0
        assert (len(solid.decompose()), solid.genus()) == (1, holes), name
        assert solid.volume() == pytest.approx(mesh.volume_mm3)


@pytest.mark.parametrize("way", WAYS)
def test_what_is_left_between_the_halves_is_the_switch_in_closed_form(way: str) -> None:
    """Two spheres and a straight stem by hand; pad, flank and fillets add a little."""
    switches = switch_set((5.0,))
    (made,) = molds(switches, way=way, tolerance_mm=0.01, shrink_rubber=0.0)
    (cavity,) = cavities_of(made.plan, made.sizes, halves_of(made)).values()
    bowl = switches.bowls[0]
    radius, centre = bowl.outer_radius_mm, bowl.centre_mm

    def cap(sphere: float) -> float:
        height = sphere + centre
        return np.pi * height**2 * (3.0 * sphere - height) / 3.0

    stem = np.pi / 3.0 * 5.0 * (0.7**2 + 0.7 * 0.6 + 0.6**2)
    core = np.pi * 0.725**2 * bowl.depth_mm
    least = cap(radius) - cap(radius - bowl.thickness_mm) + stem + core
    assert least < cavity.volume_mm3 < least + 1.0
    low, high = cavity.vertices_mm.min(axis=0), cavity.vertices_mm.max(axis=0)
    assert low[2] == pytest.approx(-5.0, abs=1e-4)
    assert high[2] == pytest.approx(bowl.depth_mm + bowl.thickness_mm + bowl.pad_height_mm)
    assert high[0] == pytest.approx(0.5 * bowl.diameter_mm, abs=0.02)


@pytest.mark.parametrize("way", WAYS)
def test_shrinkage_of_every_step_is_taken_out(way: str) -> None:
    """Print, cast and cure with each material's shrinkage: the switch comes out."""
    rubber, silicone, printer = 0.05, 0.03, 0.02
    switches = switch_set((4.0,))
    (made,) = molds(
        switches,
        way=way,
        tolerance_mm=0.01,
        shrink_rubber=rubber,
        shrink_silicone=silicone,
        shrink_print=printer,
    )
    parts = {}
    for name in made.parts:
        mesh = made.printed[name]
        points = (1.0 - printer) * mesh.vertices_mm
        if way == "silicone-master":
            points = (1.0 - silicone) * points
        if name in TURNED:
            points = points * [1.0, -1.0, -1.0]
        height = made.parts[name].vertices_mm[:, 2].min() - points[:, 2].min()
        parts[name] = TriangleMesh(
            vertices_mm=points + np.array([0.0, 0.0, height]), triangles=mesh.triangles
        )
    (cavity,) = cavities_of(made.plan, made.sizes, halves_of(replace(made, parts=parts))).values()
    true = switches.profile(switches.kinds[0], 1e-4)
    fit = fit_of(cavity, true, rubber)
    assert abs(fit.volume_error) < 0.005
    assert fit.hausdorff_mm < 0.012
    plain = to_manifold(revolve(true, 0.001)).volume()
    assert cavity.volume_mm3 == pytest.approx(plain / 0.95**3, rel=0.005)
    # From a file, in single precision, far from the origin: the same.
    rough = TriangleMesh(
        vertices_mm=np.asarray(cavity.vertices_mm + 4e-6 * np.cos(1e3 * cavity.vertices_mm)),
        triangles=cavity.triangles,
    )
    again = fit_of(rough, true, rubber)
    assert again.hausdorff_mm == pytest.approx(fit.hausdorff_mm, abs=1e-4)


@pytest.mark.parametrize("way", WAYS)
def test_print_scale_is_the_shrinkage_s(way: str) -> None:
    (plain,) = molds(way=way, shrink_silicone=0.0)
    (large,) = molds(way=way, shrink_silicone=0.04, shrink_print=0.1)
    scale = 1.0 / 0.9 / (0.96 if way == "silicone-master" else 1.0)
    for name in plain.parts:
        ratio = large.printed[name].volume_mm3 / plain.printed[name].volume_mm3
        assert ratio == pytest.approx(scale**3, rel=1e-6)


def test_stem_length_moves_the_depth_of_the_cavity() -> None:
    for way in WAYS:
        depths = []
        for reach in (5.0, 6.5):
            (made,) = molds(switch_set((reach,)), way=way, shrink_rubber=0.02)
            halves = halves_of(made)
            (cavity,) = cavities_of(made.plan, made.sizes, halves).values()
            depths.append(-cavity.vertices_mm[:, 2].min())
        assert depths == pytest.approx([5.0 / 0.98, 6.5 / 0.98], abs=1e-4)


def test_a_wrong_switch_is_seen() -> None:
    switches = switch_set((4.0,))
    (made,) = molds(switches)
    (cavity,) = cavities_of(made.plan, made.sizes, halves_of(made)).values()
    other = switch_set((4.0,), None, {"thickness_mm": 0.25})
    fit = fit_of(cavity, other.profile(other.kinds[0], 1e-4), 0.005)
    assert fit.hausdorff_mm > 0.025
    assert fit.volume_error < -0.03
    longer = switch_set((4.1,))
    fit = fit_of(cavity, longer.profile(longer.kinds[0], 1e-4), 0.005)
    assert fit.hausdorff_mm == pytest.approx(0.1, abs=0.005)


@pytest.mark.parametrize(
    ("way", "name"), [("rigid", "core_plate"), ("silicone-master", "core_tray")]
)
def test_a_planted_undercut_is_found_where_it_is(way: str, name: str) -> None:
    """The end of one stem hole widens downwards: nothing else changes."""
    switches = switch_set((8.0,) * 6)
    (made,) = molds(switches, way=way)
    cell = made.plan.runs[0].cells[1]
    centre = made.plan.centre_mm([cell], made.sizes.pitch_mm)[0]
    mesh = made.parts[name]
    off = mesh.vertices_mm[:, :2] - centre
    end = (np.hypot(*off.T) < 0.65) & (np.abs(mesh.vertices_mm[:, 2] + 8.0 / 0.995) < 1e-6)
    assert end.sum() >= 12
    points = mesh.vertices_mm.copy()
    points[end, :2] += off[end] * 0.9
    bad = changed(made, name, TriangleMesh(vertices_mm=points, triangles=mesh.triangles))
    release = releases_of(bad)[name]
    assert release.undercut_mm2 > 0.2
    with refused("mold-does-not-release") as caught:
        check_mold(bad, audit_of(bad, switches))
    caught.match(f"{name} does not release.*along the pull")


def test_too_little_draft_is_found() -> None:
    switches = switch_set((8.0,) * 3)
    (made,) = molds(switches, way="rigid")
    audit = audit_of(made, switches)
    strict = made.sizes.section.model_copy(update={"draft_deg": 0.9})
    sizes = type(made.sizes)(**{**vars(made.sizes), "section": strict})
    with refused("mold-draft-too-small"):
        check_mold(MoldSet(plan=made.plan, sizes=sizes, parts=made.parts), audit)


def test_slope_of_a_known_cone() -> None:
    cone = revolve(np.array([[0.0, 10.0], [1.0, 10.0], [2.0, 0.0], [0.0, 0.0]]), 0.001)
    release = check_release(cone)
    assert release.undercut_mm2 < 1e-7
    assert release.draft_deg == pytest.approx(np.degrees(np.arctan(0.1)), rel=0.003)
    over = revolve(np.array([[0, 3.0], [1, 3.0], [2, 2.0], [1, 1.0], [2, 0.0], [0, 0.0]]), 0.01)
    assert check_release(over).undercut_mm2 == pytest.approx(np.pi * 3.0, rel=1e-6)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("clearance", [0.1, 0.3])
def test_keys_have_the_clearance_that_is_asked(way: str, clearance: float) -> None:
    switches = switch_set((2.0,))
    (made,) = molds(switches, way=way, key_clearance_mm=clearance)
    audit = audit_of(made, switches)
    assert audit.key_gap_mm == pytest.approx(clearance, abs=1e-4)
    if way == "rigid":
        assert audit.cap_gap_mm == pytest.approx(min(clearance, 0.15), abs=1e-4)


def test_plates_that_do_not_mate_are_seen() -> None:
    switches = switch_set()
    (made,) = molds(switches, way="rigid")
    aside = changed(made, "core_plate", moved(made.parts["core_plate"], np.array([0.3, 0.0, 0.0])))
    halves = halves_of(aside)
    assert shared_mm3(*halves) > 1.0
    assert audit_of(aside, switches).key_gap_mm == 0.0
    with refused("mold-volume-mismatch"):
        check_mold(aside, audit_of(aside, switches))


def test_shared_volume_and_wrong_cavities_stop_a_build() -> None:
    switches = switch_set((2.0,))
    (made,) = molds(switches)
    audit = audit_of(made, switches)
    check_mold(made, audit)
    with refused("mold-volume-mismatch"):
        check_mold(made, replace(audit, shared_mm3=0.01))
    off = {kind: replace(fit, volume_error=-0.02) for kind, fit in audit.fits.items()}
    with refused("mold-volume-mismatch"):
        check_mold(made, replace(audit, fits=off))


def test_both_ways_close_around_the_same_rubber() -> None:
    """Silicone poured on the dome tray is the rigid dome plate: same face, same outline."""
    (rigid,), (cast,) = molds(way="rigid", shrink_rubber=0.01), molds(shrink_rubber=0.01)
    if (rigid.plan.columns, rigid.plan.lines) != (cast.plan.columns, cast.plan.lines):
        pytest.fail("the small set must give one grid both ways")
    plate = rigid.parts["dome_plate"].volume_mm3
    dome, core = halves_of(cast)
    assert dome.volume() == pytest.approx(plate, rel=1e-6)
    assert len(dome.decompose()) == len(core.decompose()) == 1
    # Vents go right through the silicone: one hole for each cavity.
    assert core.genus() == cast.plan.cavities


@pytest.mark.parametrize("way", WAYS)
def test_poured_volumes_follow_the_mold(way: str) -> None:
    switches = switch_set()
    (made,) = molds(switches, way=way)
    audit, fine = audit_of(made, switches), fine_sections(switches)
    poured = volumes_mm3(made, audit, fine)
    cells = cavities_of(made.plan, made.sizes, halves_of(made))
    counted = sum(run.count * cells[run.kind].volume_mm3 for run in made.plan.runs)
    assert poured["switches"] == pytest.approx(counted, rel=0.003)
    # The dome half up to the parting plane, by what is left of a block.
    dome, _ = halves_of(made)
    x, y = 0.5 * made.sizes.pitch_mm * np.array([made.plan.columns, made.plan.lines])
    away = made.sizes.section.wall_mm + made.sizes.section.moat_mm
    away += made.sizes.section.overflow_mm * np.tan(np.radians(15.0))
    box = manifold3d.Manifold.cube((2.0 * (x + away), 2.0 * (y + away), 4.0))
    box = box.translate((-x - away, -y - away, 0.0))
    filled = (box - dome).volume()
    assert poured["rubber"] > filled - 1e-6
    assert poured["rubber"] == pytest.approx(filled, rel=0.2)
    if way == "silicone-master":
        assert poured["silicone_dome"] == pytest.approx(dome.volume() / 0.998**3)


def test_long_stems_take_more_rubber_than_the_cores_displace() -> None:
    switches = switch_set((12.0,) * 4, None, {"stem_diameter_mm": 1.5, "pad_diameter_mm": 1.5})
    (made,) = molds(switches, way="rigid", shrink_rubber=0.0)
    audit, fine = audit_of(made, switches), fine_sections(switches)
    dome, core = halves_of(made)
    (cavity,) = cavities_of(made.plan, made.sizes, (dome, core)).values()
    whole = to_manifold(cavity)
    below = whole.trim_by_plane((0.0, 0.0, -1.0), 0.0).volume()
    bowl = fine[0, 0][: int(fine[0, 0][:, 0].argmax()) + 1]
    full = revolved_volume_mm3(np.array([*bowl, [0.0, 0.0]]))
    displaced = full - (whole.volume() - below)
    film = 2.0 * (0.6 + 1.0) * 0.15 * made.sizes.pitch_mm
    more = 4.0 * (below + film - displaced)
    assert more > 0.0
    poured = volumes_mm3(made, audit, fine)["rubber"]
    short = switch_set((1.0,) * 4, None, {"stem_diameter_mm": 1.5, "pad_diameter_mm": 1.5})
    (other,) = molds(short, way="rigid", shrink_rubber=0.0)
    base = volumes_mm3(other, audit_of(other, short), fine_sections(short))["rubber"]
    assert poured - base == pytest.approx(more, rel=0.01)


@needs_admesh
@pytest.mark.parametrize("way", WAYS)
def test_files_need_no_repair(way: str, tmp_path: Path) -> None:
    (made,) = molds(way=way)
    for name in made.parts:
        path = tmp_path / f"{name}.stl"
        write_stl(made.printed[name], path)
        assert_admesh_finds_nothing(path)
