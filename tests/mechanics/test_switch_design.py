"""Inverse design of switches: what fits, what is refused and why; rubbers from tests."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.switch_command import switch
from phytac_design.design.design_file import to_toml
from phytac_design.design.switch_table import SwitchSection
from phytac_design.mechanics.switch import bowl_check
from phytac_design.mechanics.switch import design as inverse
from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.buckling import first_buckling
from phytac_design.mechanics.switch.curve import press_bowl, snap_of
from phytac_design.mechanics.switch.design import SwitchDesign, design_switch
from phytac_design.mechanics.switch.feasible_range import FeasibleRange, misfit
from phytac_design.mechanics.switch.hyperelastic import Ogden, Yeoh, neo_hookean
from phytac_design.mechanics.switch.material_fit import fit_uniaxial, uniaxial_stress
from phytac_design.mechanics.switch.rubbers import rubber
from phytac_design.mechanics.switch.switch_inputs import space_of
from phytac_design.mechanics.switch.switch_report import curve_plot, release_notes
from phytac_design.mechanics.switch.switch_space import SwitchSpace, Tolerance
from phytac_design.mechanics.switch.tolerance import limit_load, threshold_spread
from phytac_shapes.errors import DesignError, OutputError
from tests.designs import small
from tests.refusals import refused
from verification import switch_cases

TPU = rubber("tpu-8400n")
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def made() -> SwitchDesign:
    return design_switch(0.5, TPU, SwitchSpace())


def test_switch_meets_its_threshold(made: SwitchDesign) -> None:
    again = snap_of(press_bowl(made.bowl, TPU.material, refine=3, steps=5, end_mm=0.6))
    assert again
    assert again.limit_N == pytest.approx(0.5, rel=0.01)
    assert abs(made.error) <= 0.004


def test_switch_fits_space_mold_and_rubber(made: SwitchDesign) -> None:
    space, snap = made.space, made.snap
    assert made.bowl.diameter_mm <= space.footprint_diameter_mm
    assert made.bowl.thickness_mm >= space.wall_min_mm
    assert made.bowl.depth_mm + made.bowl.thickness_mm <= space.depth_max_mm + 1e-9
    assert space.release_margin * 0.5 < snap.valley_N < 0.95 * snap.limit_N
    assert made.visible_mm >= space.visible_mm
    assert snap.strain < TPU.strain_max
    # It snaps until its underside lies on the shell.
    clear = np.interp(snap.stroke_mm, made.curve.stroke_mm, made.curve.clearance_mm)
    assert clear == pytest.approx(0.0, abs=0.01)


def test_snap_ends_where_the_force_is_back() -> None:
    flat = Bowl(diameter_mm=4.6, depth_mm=1.3, thickness_mm=0.15)
    pressed = press_bowl(flat, TPU.material, end_mm=2.2, steps=40)
    free = replace(pressed, clearance_mm=np.ones_like(pressed.stroke_mm))  # no seat at all
    snap = snap_of(free)
    assert snap
    stroke, force, strain = free.dense()
    back = np.flatnonzero((stroke > snap.limit_stroke_mm + 0.05) & (force >= snap.limit_N))
    assert snap.stroke_mm == pytest.approx(stroke[back[0]], abs=0.01)
    assert snap.stroke_mm < snap.travel_mm
    assert snap.strain == pytest.approx(strain[stroke <= snap.stroke_mm].max(), rel=0.02)
    fell = stroke > snap.limit_stroke_mm
    assert snap.valley_N == pytest.approx(force[fell].min(), rel=1e-3)


def test_curve_between_points_is_the_curve(made: SwitchDesign) -> None:
    stroke, force, _ = made.curve.dense()
    fine = press_bowl(made.bowl, TPU.material, refine=2, steps=16, end_mm=0.7)
    assert np.interp(fine.stroke_mm, stroke, force) == pytest.approx(fine.force_N, abs=2e-4)


def test_tolerance_by_slopes_and_by_sampling(made: SwitchDesign) -> None:
    small_band = Tolerance(thickness_mm=0.004, modulus=0.02)
    spread = threshold_spread(made.bowl, TPU.material, small_band, threshold_N=0.5)
    half = 0.5 * (spread.high_N - spread.low_N)
    assert half == pytest.approx(spread.sensitivity_N, rel=0.06)
    assert 2.0 < spread.exponent_thickness < 3.0
    only = threshold_spread(
        made.bowl, TPU.material, Tolerance(thickness_mm=0.0, modulus=0.1), threshold_N=0.5
    )
    assert only.sensitivity_N == pytest.approx(0.049)
    assert only.high_N == pytest.approx(0.549, rel=0.01)
    thicker = replace(made.bowl, thickness_mm=made.bowl.thickness_mm + 0.004)
    more = snap_of(press_bowl(thicker, TPU.material, steps=6, end_mm=0.65))
    less = snap_of(press_bowl(made.bowl, TPU.material, steps=6, end_mm=0.65))
    assert more
    assert less
    slope = np.log(more.limit_N / less.limit_N) / np.log(
        thicker.thickness_mm / made.bowl.thickness_mm
    )
    assert slope == pytest.approx(spread.exponent_thickness, rel=0.02)


def test_thick_soft_bowls_stay_axisymmetric_and_thin_ones_do_not(made: SwitchDesign) -> None:
    assert made.buckling == {}
    thin = switch_cases.clamped_cap(scale=0.5, arc=True, steps=40, end=0.02, cells=(30, 1))
    found = first_buckling(thin.model, thin.points, modes=(2, 3))
    stable = first_buckling(thin.model, thin.points[:1], modes=(2, 3))
    falls = int(np.argmax(np.diff(thin.load) < 0.0))
    assert set(found) == {2, 3}
    assert all(0 < index <= falls for index in found.values())
    assert stable == {}


@pytest.mark.usefixtures("coarse_switches")
def test_refusal_says_what_would_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bowl_check, "FILLETS", bowl_check.FILLETS[:1])
    with refused("switch-infeasible") as error:
        design_switch(0.1, TPU, SwitchSpace())
    error.match("From .* N fit")
    low, high = (float(x) for x in str(error.value).split("rubber of ")[1].split()[:3:2])
    assert 0.0 < low < high < 10.0


@pytest.mark.usefixtures("coarse_switches")
def test_misfits_agree_with_the_inverse_design(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bowl_check, "FILLETS", bowl_check.FILLETS[:1])
    space = SwitchSpace()
    thinnest = limit_load(
        bowl_check.bowl_of(space, bowl_check.fillets(space)[0], 1.65, 0.2),
        TPU.material,
        hole_diameter_mm=space.hole_diameter_mm,
        refine=1,
    )
    assert misfit(0.1, TPU, space) == (
        f"with the thinnest wall that the mold casts (0.2 mm) it snaps at {thinnest:.3g} N"
    )
    assert misfit(1.02 * float(thinnest or 0.0), TPU, space) == ""
    assert misfit(5.0, TPU, space).startswith("no wall gives it")


def test_hopeless_requests_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bowl_check, "FILLETS", bowl_check.FILLETS[:1])
    known = FeasibleRange(modulus_MPa=10.0, min_N=0.3, max_N=1.2, min_wall_mm=0.2, max_wall_mm=0.35)
    monkeypatch.setattr(inverse, "feasible_range", lambda *_: known)
    with refused("switch-infeasible"):
        design_switch(1000.0, TPU, SwitchSpace())
    monkeypatch.setattr(
        inverse, "feasible_range", lambda _, space: None if space.wall_min_mm > 0.3 else known
    )
    with refused("switch-infeasible"):
        design_switch(0.5, TPU, SwitchSpace(wall_min_mm=0.4))


@pytest.mark.parametrize("threshold", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_thresholds_are_refused(threshold: float) -> None:
    with refused("threshold-not-positive"):
        design_switch(threshold, TPU, SwitchSpace())


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"footprint_diameter_mm": 2.0}, "bowl-no-room"),
        ({"pitch_mm": 2.1}, "bowl-no-room"),
        ({"stem_diameter_mm": 1.6}, "stem-wider-than-hole"),
        ({"visible_mm": 3.0}, "bowl-too-shallow"),
        ({"recess_mm": float("nan")}, "switch-size-invalid"),
    ],
)
def test_bad_spaces_are_refused(change: dict[str, float], code: str) -> None:
    with refused(code):
        SwitchSpace(**change)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"thickness_mm": 1.8}, "bowl-wall-too-thick"),
        ({"depth_mm": 2.2}, "bowl-too-tall"),
        ({"diameter_mm": float("nan")}, "bowl-size-not-positive"),
        ({"pad_diameter_mm": 4.0}, "bowl-pad-size"),
        ({"fillet_mm": 1.5}, "bowl-without-membrane"),
    ],
)
def test_bad_bowls_are_refused(change: dict[str, float], code: str) -> None:
    shape = {"diameter_mm": 4.6, "depth_mm": 1.65, "thickness_mm": 0.25} | change
    with refused(code):
        press_bowl(Bowl(**shape), TPU.material)


def test_bad_rubbers_are_refused() -> None:
    with refused("rubber-poisson-invalid"):
        neo_hookean(modulus_MPa=10.0, poisson=0.5)
    with refused("rubber-modulus-invalid"):
        TPU.of_modulus(0.0)
    with refused("rubber-unknown"):
        rubber("chewing-gum")


def test_ogden_fit_recovers_treloar() -> None:
    law = Ogden(shear_terms_MPa=(0.63, 0.0012, -0.01), exponents=(1.3, 5.0, -2.0), bulk_MPa=100.0)
    stretch = np.linspace(1.05, 7.0, 40)
    found = fit_uniaxial(stretch, uniaxial_stress(law, stretch), law="ogden")
    assert found.error < 1e-3
    assert found.material.poisson == pytest.approx(0.49)


def test_yeoh_fit_recovers_its_terms() -> None:
    law = Yeoh(coefficients_MPa=(0.5, -0.01, 0.002), bulk_MPa=50.0)
    stretch = np.linspace(0.7, 3.0, 30)
    noise = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(30)
    found = fit_uniaxial(stretch, uniaxial_stress(law, stretch) * noise, law="yeoh")
    assert isinstance(found.material, Yeoh)
    assert found.material.coefficients_MPa[0] == pytest.approx(0.5, rel=0.05)
    assert 0.001 < found.error < 0.03


def test_bad_tests_are_refused() -> None:
    stretch = np.linspace(1.1, 3.0, 10)
    with refused("tensile-too-few-readings"):
        fit_uniaxial(stretch[:3], stretch[:3], law="yeoh")
    with refused("rubber-fit-negative-stiffness"):
        fit_uniaxial(stretch, -stretch, law="yeoh")
    with refused("rubber-fit-unstable"):
        fit_uniaxial(stretch, 2.0 - 0.5 * stretch, law="yeoh")


def test_space_follows_the_design() -> None:
    design = small(switch={"footprint_diameter_mm": 4.0, "tip_recess_mm": 0.2})
    space = space_of(design)
    assert space.diameter_mm <= 4.0
    assert space.stroke_mm == pytest.approx(design.switch.stroke_mm)


def test_plot_is_svg(made: SwitchDesign) -> None:
    text = curve_plot(made)
    root = ET.fromstring(text)  # noqa: S314 - our own text
    assert root.tag == f"{SVG}svg"
    words = [element.text or "" for element in root.iter(f"{SVG}text")]
    for word in (f"limit {made.snap.limit_N:.3f} N", "Threshold switch for 0.5 N", "force (N)"):
        assert word in words
    assert curve_plot(made) == text


def test_a_release_that_the_design_assumes_wrongly_is_noted(made: SwitchDesign) -> None:
    valley = made.snap.valley_N
    assert release_notes(made, SwitchSection(release_N=valley + 0.02)) == []
    (note,) = release_notes(made, SwitchSection(release_N=valley + 0.1))
    assert note.endswith(f"set switch.release_N = {valley:.2g}")
    # The table's release belongs to the table's threshold.
    twice = SwitchSection(threshold_N=1.0, release_N=2.0 * valley)
    assert release_notes(made, twice) == []


@pytest.mark.usefixtures("coarse_switches")
def test_command(made: SwitchDesign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    app = typer.Typer()
    app.command()(switch)
    runner = CliRunner()
    path = tmp_path / "small.toml"
    path.write_text(to_toml(small()), encoding="utf-8")
    words = [str(path), "--threshold-N", "0.4", "--json", "--plot", str(tmp_path / "c.svg")]
    out = runner.invoke(app, words)
    assert out.exit_code == 0, out.output
    facts = json.loads(out.stdout)
    assert facts["limit_N"] == pytest.approx(0.4, rel=0.01)
    assert max(facts["curve"]["force_N"]) >= facts["limit_N"] - 1e-4
    assert any("assumed" in text for text in facts["warnings"])
    table = {"regions": [{"threshold_N": 0.7, "rows": [0, 1]}], "release_N": 0.1}
    path.write_text(to_toml(small(switch=table)))
    # The design's own threshold is that of the bowl made before.
    monkeypatch.setattr(inverse, "design_switch", lambda own, *_: {0.5: made}[own])
    out = runner.invoke(app, [str(path)])
    assert "regions with 0.7 N" in out.stderr
    assert "set switch.release_N = " in out.stderr
    monkeypatch.undo()
    assert (tmp_path / "c.svg").read_text().startswith("<svg")
    late = runner.invoke(app, [str(path), "--plot", str(tmp_path / "c.png")])
    assert isinstance(late.exception, OutputError)
    bad = runner.invoke(app, [str(path), "--threshold-N", "0"])
    assert isinstance(bad.exception, DesignError)
