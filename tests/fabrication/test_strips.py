"""Strips: which switches they hold, how they fit the shell, their molds, what they save."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import design_hash, load_design
from phytac_design.fabrication.documents.bill_of_materials import switch_parts
from phytac_design.fabrication.documents.recipe import make_recipe, recipe_steps
from phytac_design.fabrication.documents.strip_drawing import strips_svg, wrapped_webs
from phytac_design.fabrication.effort.effort import effort_of, nominal_switches
from phytac_design.fabrication.molds.audit import (
    audit_set,
    check_mold,
    fine_sections,
    halves_of,
    strip_fits,
    volumes_mm3,
)
from phytac_design.fabrication.molds.estimate import mold_volumes
from phytac_design.fabrication.molds.make import MoldSet, make_molds, plan_molds, strips_of
from phytac_design.fabrication.molds.plates import Cells
from phytac_design.fabrication.molds.strip_files import strip_files
from phytac_design.fabrication.molds.strip_layout import footprint
from phytac_design.fabrication.switch_set import CupOutline, SwitchSet
from phytac_design.fabrication.switch_strips import (
    StripSet,
    congruent,
    make_strip,
    refusal,
    root_radius_mm,
    strip_mesh,
    web_gap_mm,
)
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.soft_cup import SoftCup
from phytac_design.rules.check import check_design
from phytac_design.solids.solid_mesh import box, to_manifold, united
from phytac_design.stages.mold_stage import MOLD
from tests.fabrication.bench_cases import context_of, put
from tests.fabrication.cases import design, family_design, shipped
from tests.fabrication.molds import WAYS
from tests.fabrication.test_cup_molds import MEMBRANE, PLUNGER
from tests.refusals import refused

SMALL: dict[str, Any] = {
    "shape": {"length_mm": 24.0},
    "layout": {"rows": 3, "columns": 12, "height_far_mm": 3.0},
}


def planned(
    sections: dict[str, Any] | None = None, **strip: Any
) -> tuple[Sensor, SwitchSet, StripSet]:
    """A small cylinder's strips."""
    case = design(**(SMALL | (sections or {}) | {"strip": {"form": "strip", **strip}}))
    return strips_on(case)


def strips_on(case: Any) -> tuple[Sensor, SwitchSet, StripSet]:
    sensor = Sensor(case)
    switches = nominal_switches(sensor)
    strips = strips_of(sensor, switches)
    assert strips is not None
    return sensor, switches, strips


def of_shipped(name: str, **strip: Any) -> tuple[Sensor, SwitchSet, StripSet]:
    case = shipped(name)
    section = case.strip.model_copy(update={"form": "strip", **strip})
    return strips_on(case.model_copy(update={"strip": section}))


def test_single_switches_have_no_strips_and_designs_keep_their_hash() -> None:
    case = design()
    sensor = Sensor(case)
    assert strips_of(sensor, nominal_switches(sensor)) is None
    assert design_hash(case) == design_hash(design(strip={"web_mm": 0.7}))
    assert design_hash(case) != design_hash(design(strip={"form": "strip"}))


@pytest.mark.parametrize("rows", [1, 2])
def test_every_switch_is_on_one_strip_of_neighbours(rows: int) -> None:
    sensor, _, strips = planned(rows=rows)
    markers = sensor.markers
    assert sorted(np.concatenate([s.markers for s in strips.strips])) == list(range(36))
    for strip in strips.strips:
        own = np.unique(markers.row[strip.markers])
        assert len(own) <= rows
        assert np.ptp(own) < rows
    assert strips.singles == 0
    # Rows of one sensor around are alike, cut in two: each pair comes out of one cavity.
    counts = [len(strips.alike(number)) for number in strips.numbers]
    assert counts == [2] * len(counts)


def test_a_row_lies_flat_at_the_pitch_of_its_web_s_middle() -> None:
    _, _, strips = planned(rows=1, web_mm=0.6)
    strip = strips.strips[0]
    pitch = 2.0 * np.pi * 30.3 / 12.0
    step = np.hypot(*np.diff(strip.flat_mm, axis=0).T)
    assert step == pytest.approx(np.full(5, pitch), rel=1e-4)
    way = strip.flat_mm[-1] - strip.flat_mm[0]
    assert np.hypot(*way) == pytest.approx(5.0 * pitch, rel=1e-4)
    # Bent around R, the faces of a web of thickness t are strained by t/2R of its middle.
    assert strip.bending_max == pytest.approx(0.3 / 30.3, rel=1e-3)
    assert strip.stretch_max < 1e-9


def test_rows_of_a_cone_are_cast_as_arcs() -> None:
    sensor, _, strips = of_shipped("cone", rows=1)
    strip = max(strips.webs, key=lambda each: each.count)
    ends, middle = strip.flat_mm[[0, -1]], strip.flat_mm[strip.count // 2]
    way = ends[1] - ends[0]
    off = middle - ends[0]
    bulge = abs(way[0] * off[1] - way[1] * off[0]) / np.hypot(*way)
    assert bulge > 2.0
    assert strip.stretch_max < 1e-4
    assert sensor.markers.count == sum(each.count for each in strips.strips)


def test_a_dome_s_spirals_become_strips() -> None:
    sensor, _, strips = of_shipped("hemisphere")
    assert strips.singles == 0
    assert len(strips.strips) <= 13
    for strip in strips.strips:
        steps = np.diff(strip.markers)
        assert len(set(steps.tolist())) == 1
    assert max(s.stretch_max for s in strips.strips) < 1e-6
    assert min(web_gap_mm(s, sensor) for s in strips.strips) > 0.5 * 3.8 + 0.3


def test_a_thick_web_on_a_tight_bend_is_refused_with_the_figures() -> None:
    with refused("no-strip-fits") as caught:
        planned(rows=1, web_mm=0.8, strain_max=0.01)
    caught.match(r"strained by 1\.3%.*strip.strain_max = 1.0%")
    made = effort_of(
        Sensor(
            design(**SMALL, strip={"form": "strip", "rows": 1, "web_mm": 0.8, "strain_max": 0.01})
        )
    )
    assert "strain" in made.left_out


def test_stems_that_would_miss_their_holes_are_refused() -> None:
    with refused("no-strip-fits") as caught:
        planned(pitch_error_mm=0.3)
    caught.match("stems would miss their holes by")


def test_clearance_is_what_hole_stem_and_pitch_leave() -> None:
    sensor, switches, strips = planned(rows=1)
    strip = strips.strips[0]
    root = root_radius_mm(switches, switches.kind_of(int(strip.markers[0])))
    assert 0.6 < root < 0.75
    assert strip.clearance_mm == pytest.approx(0.8 - root - 0.05, abs=1e-4)
    single = make_strip(sensor, switches, strip.markers[:1])
    assert single.clearance_mm == pytest.approx(0.8 - root, abs=1e-9)
    assert refusal(single, sensor, switches, land_mm=0.6) == ""


def test_a_web_keeps_clear_of_other_rows_bowls() -> None:
    close = {"shape": {"length_mm": 12.0}, "layout": {**SMALL["layout"], "rows": 4}}
    with refused("no-strip-fits") as caught:
        planned(close, rows=1)
    caught.match("the web would pass a bowl at")


def test_where_one_row_does_not_do_its_switches_stay_single() -> None:
    # On a cone: far rows are bent more than near ones.
    case = family_design("cone", rows=3, columns=10)
    section = case.strip.model_copy(update={"form": "strip", "strain_max": 0.0095})
    case = case.model_copy(update={"strip": section})
    sensor, switches, strips = strips_on(case)
    assert 0 < strips.singles < sensor.markers.count
    assert strips.singles == len(strips.why_single)
    assert all("strip.strain_max" in why for why in strips.why_single.values())
    # They are made in the same molds.
    _, plans = plan_molds(case.mold, case.print_rules, switches, strips=strips)
    made = sum(len(one.cells) * plan.castings for plan in plans for one in plan.strips)
    assert made >= sensor.markers.count


def test_webs_out_of_proportion_are_refused() -> None:
    for strip, word in (
        ({"web_width_mm": 3.0}, "set strip.web_width_mm to at most 2.30"),
        ({"web_mm": 1.4, "strain_max": 0.1}, "set strip.web_mm to at most 0.9"),
        ({"columns": 1, "rows": 1}, "leaves no pairs"),
    ):
        with refused("no-strip-fits") as caught:
            planned(**strip)
        caught.match(word)
    with pytest.raises(ValueError, match="web_width_mm must be at least web_mm"):
        design(strip={"web_mm": 3.0})


def test_pairs_of_two_rows_are_the_shortest_strips() -> None:
    _, _, strips = planned({"layout": {**SMALL["layout"], "rows": 2}}, columns=1)
    assert [strip.count for strip in strips.strips] == [2] * 12


def test_own_positions_have_no_strips() -> None:
    case = design(
        layout={"kind": "explicit", "positions": [[20.0, 0.0], [30.0, 0.2], [40.0, 0.0]]},
        strip={"form": "strip"},
    )
    sensor = Sensor(case)
    with refused("no-strip-fits") as caught:
        strips_of(sensor, nominal_switches(sensor))
    caught.match("neither rows nor spirals")


def test_alike_means_the_same_places_and_lengths_not_mirrored() -> None:
    sensor, switches, strips = planned(rows=2)
    strip = strips.strips[0]
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = replace(strip, flat_mm=strip.flat_mm @ turn.T + 3.0)
    mirrored = replace(strip, flat_mm=strip.flat_mm * [1.0, -1.0])
    assert congruent(strip, moved, switches)
    assert not congruent(strip, mirrored, switches)
    assert not congruent(strip, make_strip(sensor, switches, strip.markers[:-1]), switches)


def test_strips_lie_in_their_least_rectangle() -> None:
    _, _, strips = planned(rows=1)
    found = footprint(strips.strips[0], 7.0)
    assert found.size_mm == pytest.approx([5.0 * np.pi * 60.4 / 12.0 + 7.0, 7.0], abs=0.02)


def test_strips_in_a_mold_keep_clear_of_each_other_keys_and_labels() -> None:
    for name in ("cylinder60", "cone", "hemisphere"):
        sensor, switches, strips = of_shipped(name)
        case = sensor.design
        sizes, plans = plan_molds(case.mold, case.print_rules, switches, strips=strips)
        made = dict.fromkeys(strips.numbers, 0)
        for plan in plans:
            own = np.concatenate([np.array(one.cells) for one in plan.strips])
            which = np.repeat(np.arange(len(plan.strips)), [len(s.cells) for s in plan.strips])
            fixed = np.array([*plan.keys, plan.title, *plan.labels])
            assert np.abs(own[:, None] - fixed).max(axis=2).min() > 0.999
            away = np.linalg.norm(own[:, None] - own, axis=2)
            assert away[which[:, None] != which].min(initial=np.inf) > 0.999
            assert (own > -1e-6).all()
            assert (own < np.array([plan.columns, plan.lines]) - 1.0 + 1e-6).all()
            for one in plan.strips:
                made[one.number] += plan.castings
        assert all(made[n] >= len(strips.alike(n)) for n in strips.numbers)
        assert sizes.spacing_mm is not None


@pytest.fixture(scope="module", params=WAYS)
def cast(request: pytest.FixtureRequest) -> tuple[MoldSet, SwitchSet, StripSet]:
    case = design(
        **SMALL | {"layout": {"rows": 2, "columns": 12, "height_far_mm": 2.0}},
        strip={"form": "strip"},
        mold={"way": request.param},
    )
    _, switches, strips = strips_on(case)
    (made,) = make_molds(case.mold, case.print_rules, switches, strips=strips, tolerance_mm=0.02)
    return made, switches, strips


def test_molds_of_strips_release_close_and_hold_the_strip(
    cast: tuple[MoldSet, SwitchSet, StripSet],
) -> None:
    made, switches, strips = cast
    fine = fine_sections(switches)
    audit = audit_set(made, fine)
    check_mold(made, audit)
    assert audit.undercut_mm2 < 1e-5
    assert set(audit.strips) == set(strips.numbers)
    assert all(fit.bodies == 1 for fit in audit.strips.values())
    assert audit.volume_error < 0.003
    poured, planned_mm3 = volumes_mm3(made, audit, fine), mold_volumes(made.plan, made.sizes)
    assert planned_mm3.rubber_mm3 == pytest.approx(poured["rubber"], rel=0.05)
    printed = sum(made.printed[name].volume_mm3 for name in made.parts)
    assert planned_mm3.printed_mm3 == pytest.approx(printed, rel=0.01)


@pytest.mark.parametrize(("cup", "stop_mm"), [(PLUNGER, 1.2), (MEMBRANE, 1.5)])
def test_switches_of_any_family_are_cast_on_strips(cup: SoftCup, stop_mm: float) -> None:
    sensor, switches, _ = planned({"layout": {**SMALL["layout"], "rows": 2}})
    outline = CupOutline(cup=cup, stop_mm=stop_mm, stem_diameter_mm=1.45)
    cups = replace(switches, bowls=(outline,))
    strips = strips_of(sensor, cups)
    assert strips is not None
    assert strips.singles == 0
    section, rules = sensor.design.mold, sensor.design.print_rules
    (made,) = make_molds(section, rules, cups, strips=strips, tolerance_mm=0.02)
    audit = audit_set(made, fine_sections(cups))
    check_mold(made, audit)
    assert all(fit.bodies == 1 for fit in audit.strips.values())


def test_a_web_that_is_missing_or_too_thick_is_found(
    cast: tuple[MoldSet, SwitchSet, StripSet],
) -> None:
    made, switches, _ = cast
    halves, fine = halves_of(made), fine_sections(switches)
    dome, core = halves
    (thick, half), plan = made.sizes.web_mm, made.plan
    (bar, *_) = Cells(plan, made.sizes).webs((0.0, thick), (half, half))
    corners = np.array(bar.bounding_box()).reshape(2, 3)
    at = corners.mean(axis=0)
    # A plug across the middle of the first web.
    reach = np.array([0.75, 2.0, 1.0])
    plug = bar ^ box(at - reach, at + reach)
    number = plan.strips[0].number
    fits = strip_fits(plan, made.sizes, (united([dome, plug]), core), fine)
    assert fits[number].bodies == 2
    audit = replace(audit_set(made, fine), strips=fits)
    with refused("mold-strip-in-pieces"):
        check_mold(made, audit)
    (deep, *_) = Cells(plan, made.sizes).webs((0.0, 2.5 * thick), (half, half))
    fits = strip_fits(plan, made.sizes, (dome - deep, core), fine)
    assert fits[number].volume_error > 0.02


def test_a_strip_s_volume_is_its_solid_s() -> None:
    _, _, strips = planned(rows=2)
    for number in strips.numbers:
        solid = to_manifold(strip_mesh(strips, number, 0.002))
        assert len(solid.decompose()) == 1
        assert solid.volume() == pytest.approx(strips.rubber_of_mm3(number), rel=2e-3)
    # One bar by hand: trapezoid times the length between two rims, less the rims' curvature.
    web = strips.web_of_mm3(1) / len(strips.alike(1)[0].bridges)
    section = 0.4 * (1.5 - 0.4 * np.tan(np.radians(15.0)))
    strip = strips.alike(1)[0]
    length = np.mean([np.hypot(*(strip.flat_mm[a] - strip.flat_mm[b])) for a, b in strip.bridges])
    assert section * (length - 4.6) < web < section * (length - 4.6 + 0.6)


def test_a_strip_has_no_films_at_its_foot() -> None:
    """Faces of no thickness would lie under the bowls' cavities, where STL files are not closed."""
    sensor, _, strips = planned()
    for number in strips.numbers:
        corner = strip_mesh(strips, number).corners_mm
        up = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
        foot = np.abs(corner[:, :, 2]).max(axis=1) < 1e-6
        assert foot.any()
        assert up[foot].max() <= 0.0
    assert set(strip_files(sensor, strips)) == {
        *(f"mold/strip_S{number}.stl" for number in strips.numbers),
        "mold/strips.csv",
    }


def test_effort_counts_strips_and_uses_their_times() -> None:
    single = effort_of(Sensor(design(**SMALL)))
    sensor, _, strips = planned(rows=1)
    made = effort_of(sensor)
    assert (single.parts["switches"], single.parts["strips"]) == (36, 0)
    assert (made.parts["switches"], made.parts["strips"]) == (0, len(strips.strips))
    assert (made.switches, made.on_strips) == (36, 36)
    each = sensor.design.effort
    count = len(strips.strips)
    assert made.hours["glue"] == pytest.approx(
        (count * each.strip_glue_s + 36 * each.strip_stem_s) / 3600.0
    )
    assert made.hours["trim"] == pytest.approx(
        (count * each.strip_trim_s + 36 * each.strip_stem_trim_s) / 3600.0
    )
    assert made.hours["paint_tips"] == pytest.approx(count * each.strip_tip_s / 3600.0)
    assert made.castings == 1
    assert made.hours["cast"] == pytest.approx(each.cast_s / 3600.0)
    assert "marker pens" in " ".join(made.tools)


def test_the_stage_writes_strips_and_bill_and_facts_agree(tmp_path: Path) -> None:
    case = design(
        **SMALL | {"layout": {"rows": 2, "columns": 8, "height_far_mm": 2.0}},
        strip={"form": "strip"},
        mold={"way": "rigid"},
    )
    context = context_of(case, tmp_path)
    put(context, tmp_path, "mold", {})
    MOLD.run(context, context.folders["mold"])
    facts = context.facts("mold")
    files = sorted(path.name for path in (tmp_path / "mold").rglob("strip*"))
    assert files == ["strip_S1.stl", "strips.csv"]
    assert facts["strips"]["strips"] == 2
    assert facts["strips"]["clearance_mm"] > 0.0
    assert facts["castings"] == sum(each["castings"] for each in facts["sets"])
    table = next((tmp_path / "mold").rglob("strips.csv")).read_text().splitlines()
    assert len(table) == 1 + 16
    over = next(part for part in facts["parts"] if "runs over" in part["part"])
    assert over["count"] == facts["castings"]


def test_documents_say_how_strips_are_made() -> None:
    sensor, _, strips = planned(rows=2)
    recipe = make_recipe(sensor.design, 1e4, 1e5, castings=2)
    steps = " ".join(recipe_steps(sensor.design, recipe, strips))
    assert "Dip the ends of all stems of a strip" in steps
    assert "filled 2 times" in steps
    rows = {row["part"]: row for row in switch_parts(strips.switches, strips)}
    assert rows["strip S1"]["count"] == len(strips.alike(1))
    assert "12 switches, 1.0 to 2.3 mm" in rows["strip S1"]["note"]
    drawing = strips_svg(sensor, strips)
    assert all(f">{name}<" in drawing for name in ("S1", "0.0", "1.0"))
    web = wrapped_webs(sensor, strips)
    away = np.hypot(*web.vertices_mm[:, :2].T)
    assert 30.0 - 1e-6 < away.min() < away.max() < 30.45


def test_the_example_takes_a_third_of_the_hours_and_a_tenth_of_the_parts() -> None:
    before = effort_of(Sensor(load_design("cylinder60")))
    after = effort_of(check_design(load_design("examples/uses/cylinder60_strips.toml")))
    assert not after.left_out
    assert after.parts["hardware"] == before.parts["hardware"]
    assert after.on_strips == after.switches == before.switches
    assert after.parts_handled <= 60
    assert after.parts_handled < before.parts_handled / 10.0
    assert after.hours_total < before.hours_total / 3.0
