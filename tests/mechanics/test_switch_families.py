"""Switches that do not snap: closed forms, CalculiX, spreads, what fits, and the comparison."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.switch_command import switch
from phytac_design.design.design_file import to_toml
from phytac_design.fabrication.molds import mold_files
from phytac_design.fabrication.molds.make import MoldSet
from phytac_design.fabrication.molds.mold_files import MoldFiles
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch import cup_design, family_report, switch_families
from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.cup_design import CupDesign, cup_spread, design_cup
from phytac_design.mechanics.switch.cup_press import press_cup
from phytac_design.mechanics.switch.family_spread import FamilyTolerance, spread_of
from phytac_design.mechanics.switch.hyperelastic import Yeoh, neo_hookean
from phytac_design.mechanics.switch.material_fit import uniaxial_stress
from phytac_design.mechanics.switch.rubbers import rubber
from phytac_design.mechanics.switch.soft_cup import CupFamily, SoftCup
from phytac_design.mechanics.switch.switch_families import compare_families
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_design.optics import tip_travel
from phytac_shapes.errors import DesignError
from tests.designs import small
from tests.refusals import refused
from verification.bowl_calculix import ccx_curve

SPACE = SwitchSpace(draft_deg=0.5)
TRAVEL_mm = 0.76
PLUNGER = SoftCup(
    family="plunger",
    diameter_mm=4.6,
    height_mm=4.5,
    side_mm=0.62,
    roof_mm=0.8,
    hub_diameter_mm=2.0,
)
MEMBRANE = SoftCup(
    family="membrane",
    diameter_mm=6.0,
    height_mm=2.0,
    side_mm=0.8,
    roof_mm=0.3,
    hub_diameter_mm=2.0,
    boss_mm=0.5,
)


@pytest.fixture(scope="module")
def made() -> CupDesign:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cup_design, "RULES", replace(cup_design.RULES, plunger_heights=(3.0,)))
        return design_cup("plunger", 0.5, rubber("dragon-skin-20"), SPACE, travel_mm=TRAVEL_mm)


def test_small_press_of_a_tall_plunger_is_that_of_a_tube() -> None:
    soft = neo_hookean(modulus_MPa=1.0, poisson=0.3)

    def way_per_newton(height_mm: float) -> float:
        tube = replace(PLUNGER, height_mm=height_mm, draft_deg=0.0)
        return 0.01 / float(press_cup(tube, soft, travel_mm=0.01, steps=2).force_at(0.01))

    area = np.pi * PLUNGER.side_mm * (PLUNGER.diameter_mm - PLUNGER.side_mm)
    # Roof and glued end give way alike in both.
    assert way_per_newton(12.0) - way_per_newton(6.0) == pytest.approx(6.0 / area, rel=0.01)


def test_small_press_of_a_thin_roof_is_that_of_a_plate() -> None:
    cup = SoftCup(
        family="membrane",
        diameter_mm=30.0,
        height_mm=2.0,
        side_mm=5.0,
        roof_mm=0.2,
        hub_diameter_mm=6.0,
        boss_mm=2.0,
        fillet_mm=0.02,
    )
    curve = press_cup(cup, neo_hookean(modulus_MPa=1.0, poisson=0.3), travel_mm=0.001, steps=2)
    outer, inner = 10.0, 3.0
    bending = 0.2**3 / (12.0 * (1.0 - 0.3**2))
    ratio = (inner / outer) ** 2
    # Clamped at its edge, around a rigid hub (Timoshenko).
    shape = 1.0 - ratio - ratio * np.log(ratio) ** 2 / (1.0 - ratio)
    exact = 0.001 * 16.0 * np.pi * bending / (outer**2 * shape)
    assert curve.force_at(0.001) == pytest.approx(exact, rel=0.04)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not on PATH")
@pytest.mark.parametrize("cup", [PLUNGER, MEMBRANE], ids=lambda cup: cup.family)
def test_cups_in_calculix(cup: SoftCup, tmp_path: Path) -> None:
    curve = press_cup(cup, rubber("dragon-skin-20").material, travel_mm=TRAVEL_mm)
    end = curve.at("pad_mm", TRAVEL_mm)
    _, force = ccx_curve(tmp_path, curve.body, stroke_mm=end, steps=6)
    assert curve.force_at(TRAVEL_mm) == pytest.approx(force[-1], rel=0.01)


def test_design_meets_its_threshold_and_fits(made: CupDesign) -> None:
    cup, curve = made.cup, made.curve
    assert abs(made.error) < 0.005
    assert cup.diameter_mm == SPACE.footprint_diameter_mm
    assert SPACE.wall_min_mm <= cup.side_mm
    assert cup.web_mm > SPACE.core_min_mm - 1e-9
    assert TRAVEL_mm < made.stop_mm <= SPACE.stroke_mm
    assert np.all(np.diff(curve.force_N[curve.tip_mm <= made.stop_mm]) > 0.0)
    assert made.stop_N > made.limit_N
    assert all(way > TRAVEL_mm + 0.075 for way in made.buckling.values())
    assert made.strain <= made.rubber.strain_max


def test_spread_of_a_plunger_is_within_twenty_percent(made: CupDesign) -> None:
    spread = made.spread
    assert spread.band < 0.2
    assert spread.modulus == pytest.approx(0.1)
    # All at their limits, solved at once instead of one after the other.
    weak = replace(
        made.cup,
        side_mm=made.cup.side_mm - 0.05,
        roof_mm=made.cup.roof_mm - 0.05,
        diameter_mm=made.cup.diameter_mm - 0.05,
    )
    other = press_cup(weak, made.rubber.material.scaled(0.9), travel_mm=TRAVEL_mm)
    assert other.force_at(TRAVEL_mm - 0.05) == pytest.approx(spread.worst_low_N, rel=0.01)


def test_spread_of_power_laws() -> None:
    powers = {"thickness": (0.5, 2.0), "diameter": (4.0, -1.0), "height": (1.0, 1.5)}

    def factor(name: str, error: float) -> float:
        size, power = powers[name]
        return (1.0 + error / size) ** power

    spread = spread_of(factor, FamilyTolerance(), threshold_N=2.0)
    assert spread.thickness == pytest.approx(0.2, rel=1e-3)
    assert spread.diameter == pytest.approx(0.0125, rel=1e-2)
    assert spread.height == pytest.approx(0.075, rel=1e-2)
    assert spread.worst_high_N == pytest.approx(
        2.0 * 1.1**2 * 1.1 * (1.0 - 0.0125) ** -1.0 * 1.05**1.5, rel=1e-3
    )
    total = np.sqrt(0.2**2 + 0.1**2 + 0.0125**2 + 0.075**2)
    assert 0.5 * (spread.high_N - spread.low_N) / 2.0 == pytest.approx(0.98 * total, rel=0.03)
    assert spread.band == pytest.approx(spread.high_N / 2.0 - 1.0)
    none = FamilyTolerance(thickness_mm=0.0, diameter_mm=0.0, height_mm=0.0, modulus=0.0)
    assert spread_of(factor, none, threshold_N=2.0).band == 0.0


def test_spread_that_reaches_no_switch_is_refused(made: CupDesign) -> None:
    thin = replace(made.cup, side_mm=0.2)
    with refused("tolerance-prevents-switch"):
        cup_spread(thin, made.rubber, FamilyTolerance(thickness_mm=0.15), 0.5, 0.1)


@pytest.mark.parametrize(
    ("family", "name", "part"),
    [("plunger", "ecoflex-00-30", "thickest wall"), ("membrane", "tpu-8400n", "thinnest wall")],
)
def test_refusal_gives_the_force_of_the_last_wall(
    family: CupFamily, name: str, part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rules = replace(cup_design.RULES, plunger_heights=(2.5,), membrane_sides=(0.5,))
    monkeypatch.setattr(cup_design, "RULES", rules)
    with refused("switch-infeasible") as error:
        design_cup(family, 0.5, rubber(name), SPACE, travel_mm=TRAVEL_mm)
    error.match(part)


def test_bad_requests_are_refused() -> None:
    with refused("threshold-not-positive"):
        design_cup("plunger", 0.0, rubber("rtv615"), SPACE, travel_mm=TRAVEL_mm)
    with refused("switch-travel-invalid"):
        design_cup("plunger", 0.5, rubber("rtv615"), SPACE, travel_mm=1.5)
    with refused("cup-size-not-positive"):
        replace(PLUNGER, roof_mm=0.0)
    with refused("cup-size-not-positive"):
        replace(PLUNGER, side_mm=float("nan"))
    with refused("cup-without-web"):
        replace(PLUNGER, side_mm=1.3)


@pytest.mark.parametrize(
    ("name", "at_half"), [("dragon-skin-30", 0.2139), ("sortaclear-40", 0.3068), ("rtv615", 0.3850)]
)
def test_measured_rubbers_at_half_strain(name: str, at_half: float) -> None:
    material = rubber(name).material
    assert isinstance(material, Yeoh)
    assert float(uniaxial_stress(material, np.array([1.5]))[0]) == pytest.approx(at_half, rel=0.04)


def test_travel_of_tips_shows_half_the_red() -> None:
    sensor = Sensor(small())
    travel = tip_travel.tip_travel_on_mm(sensor)
    own = sensor.design.switch
    known = np.isfinite(travel)
    assert known.sum() >= 0.8 * len(travel)
    assert (travel[known] > own.tip_recess_mm).all()
    assert (travel[known] < own.stroke_mm).all()
    rest = tip_travel._red_px(sensor, own.stroke_mm, on=False)
    full = tip_travel._red_px(sensor, own.stroke_mm, on=True)
    median = float(np.median(travel[known]))
    there = tip_travel._red_px(sensor, median, on=True)
    near = known & (np.abs(travel - median) < 0.02) & (full > 20.0)
    share = (there - rest)[near] / (full - rest)[near]
    assert np.median(share) == pytest.approx(0.5, abs=0.05)


def test_comparison_puts_the_smallest_spread_first(
    made: CupDesign, monkeypatch: pytest.MonkeyPatch
) -> None:
    def one(family: str, *given: object, **settings: object) -> CupDesign:
        assert settings["travel_max_mm"] == 0.8
        if family == "membrane":
            raise DesignError("switch-infeasible", "no web")
        band = 0.3 if given[1] is hard else 0.12
        return replace(made, spread=replace(made.spread, band=band))

    soft, hard = rubber("dragon-skin-20"), rubber("rtv615")
    monkeypatch.setattr(switch_families, "design_cup", one)
    travel = np.array([0.72, np.nan, TRAVEL_mm, 0.8])
    found = compare_families(0.5, [hard, soft], SPACE, travel)
    assert [(item.family, item.rubber.name) for item in found[:2]] == [
        ("plunger", "dragon-skin-20"),
        ("plunger", "rtv615"),
    ]
    assert {item.family for item in found[2:]} == {"bowl", "membrane"}
    assert all(item.reason and item.spread is None for item in found[2:])
    assert found[0].receptors_N == pytest.approx(made.curve.force_at(np.array([0.72, 0.8])))
    with refused("switch-unreadable"):
        compare_families(0.5, [soft], SPACE, np.array([np.nan]))


def test_bowl_beside_them_has_its_own_band(monkeypatch: pytest.MonkeyPatch) -> None:
    bowl = Bowl(diameter_mm=4.6, depth_mm=1.77, thickness_mm=0.217, fillet_mm=0.24)
    known = SimpleNamespace(bowl=bowl, snap=SimpleNamespace(limit_N=0.5, valley_N=0.31, strain=0.5))
    monkeypatch.setattr(switch_families, "find_bowl", lambda *_: (known, []))
    found = compare_families(
        0.5, [rubber("tpu-8400n")], SPACE, np.array([TRAVEL_mm]), families=["bowl"]
    )
    spread = found[0].spread
    assert spread
    assert spread.height == 0.0
    # Its threshold grows as wall^2.3 (test_switch_design).
    assert spread.thickness == pytest.approx(2.3 * 0.05 / 0.217, rel=0.05)
    assert spread.band > 0.4


def test_command_compares(made: CupDesign, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(switch)
    path = tmp_path / "mine.toml"
    path.write_text(to_toml(small()))

    def one(family: str, *_: object, **__: object) -> CupDesign:
        if family == "membrane":
            raise DesignError("switch-infeasible", "no web")
        # Without a tapered stem no mold releases.
        return replace(made, space=replace(made.space, stem_diameter_mm=1.45))

    monkeypatch.setattr(switch_families, "design_cup", one)
    monkeypatch.setattr(tip_travel, "tip_travel_on_mm", lambda _: np.array([TRAVEL_mm]))
    words = [str(path), "--family", "auto", "--material", "dragon-skin-20"]
    result = CliRunner().invoke(app, [*words, "--json", "--plot", str(tmp_path / "a.svg")])
    assert result.exit_code == 0, result.output
    plain = json.loads(result.stdout)
    assert plain["recommended"] == {"family": "plunger", "rubber": "dragon-skin-20"}
    first = plain["candidates"][0]
    assert first["hysteresis_N"] == 0.0
    assert first["release_N"] == pytest.approx(
        first["switch"]["curve"]["force_N"][0] + 0.5, rel=0.01
    )
    assert [one["fits"] for one in plain["candidates"]] == [True, False, False]
    assert (tmp_path / "a.svg").read_text().startswith("<")

    def files(made: list[MoldSet], switches: SwitchSet, **_: object) -> MoldFiles:
        count = sum(each.plan.cavities for each in made)
        text = f"{count} {switches.threshold_N[0]:g}"
        return MoldFiles(contents={"mold/cavities.csv": text.encode()})

    # Their content is tested with the molds.
    monkeypatch.setattr(mold_files, "mold_files", files)
    run = CliRunner().invoke(app, [*words, "--molds", str(tmp_path / "out")])
    assert run.exit_code == 0, run.output
    cavities, threshold = (tmp_path / "out" / "mold" / "cavities.csv").read_text().split()
    assert int(cavities) >= Sensor(small()).markers.count
    assert threshold == "0.5"
    text = run.stdout
    assert "recommended: plunger of dragon-skin-20" in text
    assert "no web" in text
    none = CliRunner().invoke(app, [*words[:2], "membrane", *words[3:]])
    assert getattr(none.exception, "code", "") == "switch-infeasible"
    assert "no web" in none.output
    # A design says itself what is compared.
    path.write_text(to_toml(small(switch={"family": "best", "material": "dragon-skin-20"})))
    own = CliRunner().invoke(app, [str(path), "--json"])
    assert own.exit_code == 0, own.output
    rubbers = {one["rubber"] for one in json.loads(own.stdout)["candidates"]}
    assert rubbers == {"dragon-skin-20"}
    path.write_text(to_toml(small()))
    bare = CliRunner().invoke(app, [words[0], "--molds", str(tmp_path)])
    assert getattr(bare.exception, "code", "") == "switch-molds-without-family"
    wrong = CliRunner().invoke(app, [*words[:2], "spring"])
    assert getattr(wrong.exception, "code", "") == "switch-family-unknown"


@pytest.mark.parametrize(("family", "compared"), [("auto", 1), ("bowl", 0)])
def test_molds_of_a_bowl_are_refused_after_the_comparison_or_before_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, family: str, compared: int
) -> None:
    """A comparison takes minutes: its table is printed, and not made for bowls alone."""
    bowl = SimpleNamespace(design=object(), family="bowl", rubber=SimpleNamespace(name="tpu-8400n"))
    calls: list[object] = []

    def compare(*_: object, **__: object) -> list[SimpleNamespace]:
        calls.append(bowl)
        return [bowl]

    monkeypatch.setattr(switch_families, "compare_families", compare)
    monkeypatch.setattr(family_report, "candidates_text", lambda *_, **__: "the table")
    monkeypatch.setattr(tip_travel, "tip_travel_on_mm", lambda _: np.array([TRAVEL_mm]))
    app = typer.Typer()
    app.command()(switch)
    words = ["cylinder60", "--family", family, "--molds", str(tmp_path / "out")]
    run = CliRunner().invoke(app, words)
    assert getattr(run.exception, "code", "") == "switch-molds-of-bowl"
    assert len(calls) == compared
    assert ("the table" in run.stdout) == bool(compared)
    assert not (tmp_path / "out").exists()
