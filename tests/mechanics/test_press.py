"""One press: the figures are those of the theory chosen, and the choice is the estimate's."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import camera_of
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh, marker_mesh
from phytac_design.mechanics.pressing import press as module
from phytac_design.mechanics.pressing.contact_patch import (
    ContactPatch,
    middle_marker,
    parse_contact_patch,
)
from phytac_design.mechanics.pressing.press import Press, bending_strain, press, write_press
from phytac_design.mechanics.pressing.press_report import press_dict, press_text, press_warnings
from phytac_shapes.errors import DesignError, NumericalError
from tests.designs import of_shape, small
from tests.fabrication.cases import built, family_design
from tests.refusals import refused

DESIGN = small()
SURFACE = DESIGN.surface()
MARKERS = make_markers(DESIGN, SURFACE)


def place(force: float, **words: Any) -> ContactPatch:
    return parse_contact_patch(Sensor.of(DESIGN, SURFACE, MARKERS), force_N=force, **words)


@cache
def pressed(force: float, theory: str, **options: Any) -> Press:
    return press(
        Sensor.of(DESIGN, SURFACE, MARKERS),
        place(force, at="45"),
        theory=theory,
        **{"refine": 2, **options},
    )


def alone(
    force: float,
    theory: str,
    refine: int = 2,
    *,
    sensor: Sensor | None = None,
    at: str = "45",
    receptors: bool = True,
) -> Press:
    """A press on the one mesh that holds the markers."""

    def mesh_of(*of: Any, refine: int, **words: Any) -> ShellMesh:
        if refine != own:
            raise DesignError("mesh-markers-too-close", "no mesh holds the markers")
        return marker_mesh(*of, refine=refine, **words)

    own = refine
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "marker_mesh", mesh_of)
        on = sensor or Sensor.of(DESIGN, SURFACE, MARKERS)
        patch_on = parse_contact_patch(on, force_N=force, at=at)
        return press(on, patch_on, theory=theory, refine=refine, receptors=receptors)


def test_place_is_a_marker_a_position_or_the_middle() -> None:
    np.testing.assert_array_equal(place(1.0, at="17").uv, MARKERS.uv[17])
    np.testing.assert_array_equal(place(1.0, at=" 20.5, -7 ").uv, [20.5, -7.0])
    assert place(1.0).radius_mm == DESIGN.training.patch_radius_max_mm
    middle = SURFACE.point(SURFACE.domain.mean(axis=1)[None])[0]
    away = np.linalg.norm(SURFACE.point(MARKERS.uv) - middle, axis=1)
    assert away[middle_marker(SURFACE, MARKERS)] == away.min()
    np.testing.assert_array_equal(place(1.0).uv, MARKERS.uv[middle_marker(SURFACE, MARKERS)])


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ({"force_N": 0.0}, "force-not-positive"),
        ({"force_N": np.nan}, "force-not-positive"),
        ({"force_N": np.inf}, "force-not-positive"),
        ({"radius_mm": -1.0}, "patch-radius-invalid"),
        ({"radius_mm": np.nan}, "patch-radius-invalid"),
        ({"radius_mm": 31.0}, "patch-radius-invalid"),
        ({"at": "30,63"}, "contact-off-surface"),
        ({"at": "30,-20"}, "contact-off-surface"),
        ({"at": "112"}, "marker-unknown"),
        ({"at": "-1"}, "marker-unknown"),
        ({"at": "61,0"}, "contact-off-surface"),
        ({"at": "1,2,3"}, "place-invalid"),
        ({"at": "nan,1"}, "place-invalid"),
        ({"at": "1.5"}, "place-invalid"),
    ],
)
def test_words_that_make_no_press_are_refused(words: dict[str, Any], code: str) -> None:
    with refused(code):
        parse_contact_patch(Sensor.of(DESIGN, SURFACE, MARKERS), **{"force_N": 1.0} | words)


@pytest.mark.parametrize(
    ("name", "unit"), [("cylinder", "an angle in radians"), ("cuboid", "a length .* in mm")]
)
def test_a_place_too_far_around_is_refused_with_the_unit_of_its_chart(name: str, unit: str) -> None:
    sensor = Sensor.of(*built(family_design(name)))
    with pytest.raises(DesignError, match=unit):
        parse_contact_patch(sensor, force_N=1.0, at="30,1000")


def test_linear_motion_grows_with_the_force_and_peaks_under_it() -> None:
    one, two = pressed(1.0, "linear"), pressed(2.0, "linear")
    np.testing.assert_allclose(two.motion, 2.0 * one.motion, rtol=1e-9, atol=1e-12)
    assert two.linear_error == pytest.approx(2.0 * one.linear_error, rel=0.2)
    assert one.peak_mm == pytest.approx(one.centre_mm, rel=0.1)
    assert one.near[0] == 45
    assert one.inward_mm[45] == pytest.approx(one.centre_mm, rel=1e-9)
    # Where no other mesh holds the markers, nothing is extrapolated.
    plain = alone(1.0, "linear")
    at = plain.motion[plain.mesh.marker_nodes]
    arm = MARKERS.tip_mm - MARKERS.mid_mm
    np.testing.assert_allclose(plain.tip_mm, at[:, :3] + np.cross(at[:, 3:], arm), atol=1e-15)
    seen = camera_of(DESIGN, SURFACE).project(MARKERS.tip_mm[[45]] + one.tip_mm[[45]])
    assert one.tip_px is not None
    np.testing.assert_allclose(
        one.tip_px[45], seen[0] - camera_of(DESIGN, SURFACE).project(MARKERS.tip_mm[[45]])[0]
    )


def test_auto_takes_large_displacements_where_linear_is_off() -> None:
    light, hard = pressed(0.3, "auto"), pressed(25.0, "auto")
    assert not light.large
    np.testing.assert_array_equal(light.motion, pressed(0.3, "linear").motion)
    assert hard.large
    linear = pressed(25.0, "linear")
    # The mesh is solved under a force larger by as much as it is too stiff.
    ratio = linear.motion[:, :3].ravel() @ alone(25.0, "linear").motion[:, :3].ravel()
    ratio /= float(np.sum(alone(25.0, "linear").motion[:, :3] ** 2))
    assert ratio > 1.02
    np.testing.assert_allclose(hard.motion, alone(25.0 * ratio, "large").motion, atol=1e-9)
    np.testing.assert_array_equal(hard.motion, pressed(25.0, "large").motion)
    gap = np.linalg.norm(hard.motion[:, :3] - linear.motion[:, :3], axis=1).max()
    truth = gap / np.linalg.norm(hard.motion[:, :3], axis=1).max()
    assert truth > 0.05
    assert 0.5 < hard.linear_error / truth < 2.0
    assert pressed(25.0, "auto", tolerance=10.0).large is False


def test_large_tips_keep_their_distance_from_the_wall() -> None:
    hard = pressed(60.0, "large")
    arm = MARKERS.tip_mm - MARKERS.mid_mm
    turned = arm + hard.tip_mm - hard.wall_mm
    np.testing.assert_allclose(
        np.linalg.norm(turned, axis=1), np.linalg.norm(arm, axis=1), rtol=1e-12
    )
    assert np.linalg.norm(hard.motion[hard.mesh.marker_nodes, 3:], axis=1).max() > 0.05


def test_receptors_stiffen_the_wall() -> None:
    # Fine enough to resolve the wall between tubes.
    plain = pressed(1.0, "linear", receptors=False, refine=6)
    assert 0.9 < pressed(1.0, "linear", refine=6).peak_mm / plain.peak_mm < 0.98
    odd = small(receptor={"diameter_outer_mm": 0.9, "diameter_hole_mm": 0.5})
    markers = make_markers(odd, SURFACE)
    with refused("receptor-stiffness-range"):
        press(Sensor.of(odd, SURFACE, markers), place(1.0), refine=2)
    press(Sensor.of(odd, SURFACE, markers), place(1.0), refine=2, receptors=False)


def test_more_than_the_shell_carries_is_refused() -> None:
    with refused("strain-too-large"):
        pressed(3e3, "large")


def test_no_equilibrium_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise NumericalError("no-equilibrium", "the path ends at 0.6")

    monkeypatch.setattr(module, "solve_large", fails)
    with refused("press-no-equilibrium"):
        press(Sensor.of(DESIGN, SURFACE, MARKERS), place(30.0), theory="large", refine=2)


def test_bending_strain_is_that_of_a_wall_that_bends() -> None:
    mesh = chart_mesh(SURFACE, thickness_mm=0.8, n_along=4, n_around=200)
    motion = np.zeros((len(mesh.nodes_mm), 6))
    motion[:, 5] = 0.1 * np.sin(mesh.uv[:, 1])
    assert bending_strain(mesh, motion) == pytest.approx(0.4 * 0.1 / 29.6, rel=1e-3)
    motion[:] = 0.3  # rigid
    assert bending_strain(mesh, motion) < 1e-12


def test_report_says_what_to_mind() -> None:
    good, off = (replace(pressed(25.0, how), mesh_error=0.01) for how in ("auto", "linear"))
    assert press_warnings(good, tolerance=0.05) == []
    assert "--theory large" in press_warnings(off, tolerance=0.05)[0]
    for change, words in (
        ({"strain": 0.05}, "strain of about 5 %"),
        ({"jumped": True}, "snaps, or may snap"),
        ({"stable": False}, "does not stay"),
        ({"mesh_error": 0.2}, "error of the mesh is up to 20 %"),
        ({"mesh_error": None}, "error of the mesh is not known"),
    ):
        (warning,) = press_warnings(replace(good, **change), tolerance=0.05)
        assert words in warning
    plain = press_dict(good, MARKERS, name="small", tolerance=0.05)
    assert plain["theory"] == "large"
    assert [row["marker"] for row in plain["markers"]] == good.near.tolist()
    assert plain["markers"][0]["tip_mm"] == good.tip_mm[45].tolist()
    text = press_text(good, MARKERS, name="small", tolerance=0.05)
    assert f"peak {good.peak_mm:.4g} mm inward" in text
    assert len(text.splitlines()) == 5 + len(good.near)
    blind = replace(good, tip_px=None)
    assert press_dict(blind, MARKERS, name="x", tolerance=0.05)["markers"][0]["tip_px"] is None
    assert " - " in press_text(blind, MARKERS, name="x", tolerance=0.05)


def test_moved_mesh_is_written(tmp_path: Path) -> None:
    result = pressed(1.0, "linear")
    back = meshio.read(write_press(tmp_path / "a.vtu", result))
    np.testing.assert_array_equal(back.point_data["displacement_mm"], result.motion[:, :3])
    with refused("output-not-writable"):
        write_press(tmp_path / "no" / "a.vtu", result)


def test_motion_is_extrapolated_and_its_error_claimed() -> None:
    """Linear, and with large displacements, against a mesh of twelve elements a pitch."""
    force = 20.0
    for theory in ("linear", "large"):
        fine = alone(force, theory, refine=12)

        def off(result: Press, fine: Press = fine) -> float:
            size = np.linalg.norm(fine.tip_mm, axis=1).max()
            return float(np.linalg.norm(result.tip_mm - fine.tip_mm, axis=1).max() / size)

        plain, done = alone(force, theory, refine=4), pressed(force, theory, refine=4)
        assert off(done) < 0.4 * off(plain)
        assert done.mesh_error is not None
        assert off(done) < done.mesh_error < 0.1
        assert done.centre_mm == pytest.approx(fine.centre_mm, rel=done.mesh_error)
        assert done.centre_mm > plain.centre_mm
        # The peak is of the extrapolated motion, too.
        assert done.peak_mm == pytest.approx(fine.peak_mm, rel=done.mesh_error)
    assert plain.mesh_error is None


def flat_design(thickness_mm: float) -> Design:
    return of_shape(
        "plane",
        {"width_mm": 48.0, "height_mm": 36.0},
        {
            "kind": "straight",
            "rows": 5,
            "columns": 7,
            "heights": "constant",
            "height_near_mm": 2.0,
            "colour_pattern": "checkerboard",
        },
        wall={"thickness_mm": thickness_mm},
    )


def test_a_flat_wall_that_stretches_is_no_worse_for_extrapolation() -> None:
    """It moves half as far as linear theory has it; what that lacks on a mesh is added in part."""
    sensor = Sensor(flat_design(0.5))
    fine, plain = (alone(5.0, "large", n, sensor=sensor, at="17") for n in (9, 3))
    patch = parse_contact_patch(sensor, force_N=5.0, at="17")
    done = press(sensor, patch, theory="large", refine=3)
    linear = press(sensor, patch, theory="linear", refine=3)
    assert done.centre_mm < 0.7 * linear.centre_mm

    def off(result: Press) -> float:
        size = np.linalg.norm(fine.tip_mm, axis=1).max()
        return float(np.linalg.norm(result.tip_mm - fine.tip_mm, axis=1).max() / size)

    assert done.mesh_error is not None
    assert off(done) < off(plain)
    assert off(done) < done.mesh_error


def test_the_linear_term_is_scaled_down_on_a_thin_flat_wall() -> None:
    """In full it would be 5 % of the motion on this coarse mesh."""
    sensor = Sensor(flat_design(0.4))
    patch = parse_contact_patch(sensor, force_N=20.0, at="17")
    fine = alone(20.0, "large", 5, sensor=sensor, at="17", receptors=False).tip_mm
    done = press(sensor, patch, theory="large", refine=2, receptors=False).tip_mm
    size = np.linalg.norm(fine, axis=1).max()
    assert np.linalg.norm(done - fine, axis=1).max() < 0.03 * size


def test_meshes_that_snap_differently_are_not_extrapolated(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = pressed(20.0, "large", refine=4)
    solve = module.solve_large

    def snaps_if_coarse(model: Any, load: Any) -> Any:
        found, *others = solve(model, load)
        return replace(found, jumped=len(model.quads) < len(usual.mesh.quads)), *others

    monkeypatch.setattr(module, "solve_large", snaps_if_coarse)
    apart = press(
        Sensor.of(DESIGN, SURFACE, MARKERS), place(20.0, at="45"), theory="large", refine=4
    )
    assert not apart.jumped
    assert usual.mesh_error is not None
    assert apart.mesh_error == pytest.approx(usual.mesh_error, rel=0.1)
    assert 0.002 < abs(apart.centre_mm / usual.centre_mm - 1.0) < apart.mesh_error
    np.testing.assert_array_equal(apart.motion, usual.motion)


def test_meshes_that_cannot_be_solved_leave_the_press_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: object) -> None:
        raise NumericalError("rounding", "the finer mesh is too thin for its elements")

    monkeypatch.setattr(module, "estimate_error", fails)
    result = press(Sensor.of(DESIGN, SURFACE, MARKERS), place(1.0, at="45"), refine=2)
    assert result.mesh_error is None
    np.testing.assert_array_equal(result.tip_mm, alone(1.0, "auto").tip_mm)


def test_odd_numbers_of_elements_and_single_meshes() -> None:
    fine = pressed(1.0, "linear", refine=6).centre_mm
    done, plain = pressed(1.0, "linear", refine=3), alone(1.0, "linear", 3)
    assert done.mesh_error is not None
    assert abs(done.centre_mm - fine) < 0.5 * abs(plain.centre_mm - fine)
    # Meshes of 1 and 2 elements are too alike here for anything to be extrapolated.
    coarse = pressed(1.0, "linear", refine=1)
    assert coarse.mesh_error is None
    np.testing.assert_array_equal(coarse.tip_mm, alone(1.0, "linear", 1).tip_mm)


def test_unknown_theory_and_tolerance_are_refused() -> None:
    with refused("theory-unknown"):
        pressed(1.0, "cubic")
    with refused("tolerance-invalid"):
        pressed(1.0, "auto", tolerance=0.0)
