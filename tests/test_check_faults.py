"""``phytac check``: every independent fault at once, other units, and a change that repairs."""

import contextlib
import json
import re
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from phytac_design.cli import check_command, output
from phytac_design.design.design_file import parse_design, to_toml
from phytac_design.design.spec import Design
from phytac_design.design.unit_hints import unit_hints
from phytac_design.rules.check import RULES, broken_rules, check_design
from phytac_design.rules.design_review import checkup
from phytac_design.simulation.scenario.linear_error import NEARLY_LINEAR, linear_error
from phytac_design.study.advice.quick_repair import quick_repair, readable_switches, seen_at_rest
from phytac_design.workflows import design_check, switch_feasibility
from phytac_design.workflows.design_check import snapping_words, unreadable_fault
from phytac_shapes.errors import DesignError, NumericalError
from tests.designs import changed, small
from tests.refusals import refused
from tests.test_cli import phytac

COARSE = {"width_px": 432, "height_px": 324, "focal_px": 161.0}
READING = {"width_px": 648, "height_px": 486, "focal_px": 241.5}
"""Enough pixels to read all switches."""


def codes(**tables: Any) -> list[str]:
    return [fault.code for fault in broken_rules(small(**tables))]


def test_independent_faults_are_listed_together() -> None:
    bad: dict[str, Any] = {
        "wall": {"thickness_mm": 0.3},
        "receptor": {"diameter_hole_mm": 0.3},
        "training": {"patch_radius_max_mm": 40.0},
        "camera": {"stand_off_mm": 3.0},
    }
    first = ["wall-too-thin", "hole-too-small", "patch-exceeds-sensor", "rim-outside-view"]
    assert codes(**bad) == first
    with refused("wall-too-thin"):
        check_design(small(**bad))


def test_what_follows_from_a_fault_is_not_listed() -> None:
    # A wall without a hollow has no place for receptors, cameras or hardware.
    assert codes(wall={"thickness_mm": 31.0}) == ["wall-too-thick"]
    # Receptors through the axis hide from every camera.
    assert codes(layout={"height_far_mm": 40.0}) == ["tips-collide"]
    # Facets follow the thickness: a wall in metres would fill the memory.
    thin = {"wall": {"thickness_mm": 0.0008}, "light": {"bar_radius_mm": 2.0}}
    faults = broken_rules(changed("hemisphere", **thin))
    assert [fault.code for fault in faults] == ["wall-too-thin"]
    assert broken_rules(small()) == []


def test_rules_need_rules_before_them() -> None:
    before: set[str] = set()
    for name, (_, needs) in RULES.items():
        assert set(needs.split()) <= before, name
        before.add(name)


@pytest.mark.parametrize(
    ("table", "field", "value", "words"),
    [
        ("shape", "length_mm", 6, "looks like cm: lengths are in mm, and 6 cm are 60 mm"),
        ("shape", "length_mm", 0.06, "looks like m: lengths are in mm, and 0.06 m are 60 mm"),
        ("shape", "diameters_mm", [50.0, 4.6], "= 4.6 looks like cm"),
        ("wall", "thickness_mm", 0.08, "looks like cm: lengths are in mm, and 0.08 cm are 0.8 mm"),
        ("wall", "thickness_mm", 800, "looks like µm"),
        ("receptor", "diameter_outer_mm", 0.003, "looks like m"),
        ("camera", "stand_off_mm", 0.03, "looks like m"),
    ],
)
def test_other_units_are_recognised(table: str, field: str, value: Any, words: str) -> None:
    (hint,) = unit_hints({table: {field: value}})
    assert hint.startswith(f"{table}.{field} = ")
    assert words in hint


@pytest.mark.parametrize(
    "data",
    [
        {"shape": {"length_mm": 60, "diameter_outer_mm": 12.0}, "camera": {"stand_off_mm": "fit"}},
        {"receptor": {"diameter_hole_mm": 0}, "wall": {"thickness_mm": True}},
        {"shape": {"length_mm": "6", "diameters_mm": [[1.0]]}, "wall": 3},
        {"shape": {"length_mm": 10**400, "diameter_outer_mm": float("nan")}},
        "name",
    ],
)
def test_usual_lengths_and_no_numbers_have_no_hint(data: Any) -> None:
    assert unit_hints(data) == []


def test_refusals_and_the_check_name_the_unit() -> None:
    whole = small().model_dump(mode="json")
    with refused("field-invalid") as caught:
        parse_design({**whole, "shape": {**whole["shape"], "length_mm": 0.06}}, "file")
    caught.match("0.06 m are 60 mm")
    with refused("wall-too-thin") as caught:
        check_design(small(wall={"thickness_mm": 0.08}))
    caught.match("0.08 cm are 0.8 mm")
    thin = {"wall_min_mm": 0.05}
    report = checkup(small(wall={"thickness_mm": 0.1}, camera=COARSE, print_rules=thin))
    assert any("0.1 cm are 1 mm" in warning for warning in report["warnings"])


def hidden() -> dict[str, Any]:
    return {"light": {"bar_radius_mm": 10.5}, "camera": COARSE}


def test_a_quick_repair_passes_the_check() -> None:
    design = small(**hidden())
    assert not seen_at_rest(check_design(design)).clear.all()
    found = quick_repair(design)
    assert found is not None
    assert found.words.startswith("light.bar_radius_mm 10.5 → 8.5 mm")
    assert found.fields == {"light.bar_radius_mm": 8.5}
    assert found.design.light.bar_radius_mm == 8.5
    assert checkup(found.design)["clear"]
    # Without time nothing is tried.
    assert quick_repair(design, seconds=-1.0) is None


def test_an_angle_or_a_camera_with_more_pixels_separates_fused_markers() -> None:
    straight = {"rows": 10, "columns": 18, "spiral_angle_deg": 0.0, "height_far_mm": 4.0}
    narrow = {"footprint_diameter_mm": 4.0}
    few = {"width_px": 160, "height_px": 120, "focal_px": 60.0}
    for design, wanted in (
        (small(layout=straight, switch=narrow, camera=COARSE), "layout.spiral_angle_deg 0 → "),
        (small(camera=few), "camera.width_px 160 → "),
    ):
        assert not seen_at_rest(check_design(design)).clear.all()
        found = quick_repair(design)
        assert found is not None
        assert found.words.startswith(wanted)
        assert checkup(found.design)["clear"]


def test_a_broken_rule_is_repaired_as_well() -> None:
    found = quick_repair(small(camera={**COARSE, "stand_off_mm": 3.0}))
    assert found is not None
    assert found.fields == {"camera.stand_off_mm": "fit"}
    assert found.words == 'camera.stand_off_mm 3.0 → "fit"'
    rows = quick_repair(small(layout={"rows": 14}, camera=COARSE))
    assert rows is not None
    assert set(rows.fields) == {"layout.rows"}
    assert checkup(rows.design)["clear"]


def pad(**camera: Any) -> Design:
    """A plane whose camera looks straight into some holes."""
    camera = {"width_px": 864, "height_px": 648, "focal_px": 322.0, **camera}
    return changed("plane", layout={"rows": 5, "columns": 5}, camera=camera)


def test_changes_of_tips_and_camera_are_tried_until_switches_are_read() -> None:
    asked: list[float] = []

    def fits(design: Design) -> None:
        asked.append(design.switch.stroke_mm)
        if design.switch.stroke_mm > 1.5:
            raise DesignError("switch-infeasible", "too shallow a bowl; raise the footprint")

    found = readable_switches(pad(), fits=lambda _: None)
    best = found[0]
    assert not best.reason
    assert best.after <= 2 * best.before / 3
    assert seen_at_rest(check_design(best.design)).switch_unreadable.sum() == best.after
    deeper = "switch.tip_recess_mm 0.3 → 0.8, switch.stroke_mm 1.5 → 2"
    assert deeper in {one.words for one in found}
    # Switches that cannot be made are no cure.
    other = readable_switches(pad(), fits=fits)
    assert asked[0] == 2.0
    assert all(one.design.switch.stroke_mm == 1.5 for one in other if not one.reason)
    assert any("too shallow a bowl" in one.reason for one in other)
    # A narrow lens may be wider, which stands nearer; that of this pad is wide (107°).
    assert not any("camera.focal_px" in one.fields for one in found)
    narrow = readable_switches(pad(focal_px=617.0), fits=fits)
    assert any(one.words == "camera.focal_px 617 → 308.5 (109° across)" for one in narrow)
    # Without time nothing is tried.
    assert readable_switches(pad(), fits=fits, seconds=-1.0) == []


def test_a_quarter_of_the_switches_may_be_unreadable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert unreadable_fault(25, 100) is None
    fault = unreadable_fault(26, 100)
    assert fault is not None
    assert fault.code == "switch-unreadable"
    monkeypatch.setattr(design_check, "check_thresholds", lambda *_, **__: None)
    monkeypatch.setattr(check_command, "LOOK_S", 0.0)
    path = tmp_path / "pad.toml"
    path.write_text(to_toml(pad(stand_off_mm=75.0)))
    with pytest.raises(typer.Exit):
        check_command.check(str(path))
    out, err = capsys.readouterr()
    assert "error[switch-unreadable]: the camera cannot read" in err
    assert "of 25 switches cannot be read, too many (see the error)" in out.splitlines()[-1]
    with pytest.raises(typer.Exit):
        check_command.check(str(path), as_json=True)
    facts = json.loads(capsys.readouterr().out)
    assert (facts["visible"], facts["clear"]) == (True, False)


@pytest.fixture
def bowls_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bowls are solved for in ``test_switch_feasibility``."""
    monkeypatch.setattr(switch_feasibility, "misfit", lambda *_: "")
    monkeypatch.setattr(switch_feasibility, "far_too_high", lambda *_: "")
    monkeypatch.setattr(switch_feasibility, "feasible_range", lambda *_: None)


@pytest.mark.usefixtures("bowls_fit")
def test_the_check_ends_with_what_to_do(tmp_path: Path) -> None:
    def run(words: tuple[str, ...] = (), **tables: Any) -> Any:
        path = tmp_path / "mine.toml"
        path.write_text(to_toml(small(**tables)))
        return phytac("check", "mine.toml", *words, cwd=tmp_path)

    good = run(camera=READING)
    assert good.returncode == 0
    verdict, after = good.stdout.splitlines()[-2:]
    assert verdict.startswith("every marker is visible and can be distinguished")
    assert after == "next: phytac build mine.toml"
    assert "field of view 107° x 90°" in good.stdout
    assert "(needs more than 2)" in good.stdout
    # The red of one tip, and what that tip needs.
    (red,) = [line for line in good.stdout.splitlines() if "red" in line and "(px)" in line]
    assert re.search(r"tip hardest to read, row \d+, column \d+: red \(px\) +\d+ when out", red)
    assert "rendering what the camera sees of 112 markers" in good.stderr
    bad = run(**hidden())
    assert bad.returncode == DesignError.exit_code
    last = bad.stdout.splitlines()[-1]
    assert last.startswith("this repairs it: light.bar_radius_mm")
    broken: dict[str, Any] = {"wall": {"thickness_mm": 0.08}, "camera": {"stand_off_mm": 3.0}}
    out = run(("--json",), **broken)
    assert out.returncode == DesignError.exit_code
    facts = json.loads(out.stdout)
    assert [one["code"] for one in facts["faults"]] == ["wall-too-thin", "rim-outside-view"]
    assert facts["clear"] is False
    assert out.stderr.count("error[") == 2
    hint = out.stderr.index("warning: wall.thickness_mm = 0.08 looks like cm")
    assert hint < out.stderr.index("error["), "the likely cause comes first"


@pytest.mark.usefixtures("bowls_fit")
def test_the_check_says_that_a_turned_shell_looks_the_same(tmp_path: Path) -> None:
    path, words = tmp_path / "mine.toml", "the shell looks the same"
    for count in (0, 6):
        path.write_text(to_toml(small(camera=READING, reference_marks={"count": count})))
        out = phytac("check", str(path), cwd=tmp_path).stdout
        assert (words in out) == (count == 0)
        assert ("set reference_marks.count = 6" in out) == (count == 0)


def test_no_repair_is_looked_for_without_end_or_for_a_wrong_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    looked: list[bool] = []

    def forever(*_: Any, **__: Any) -> None:
        looked.append(True)
        # As the reading of a cache does: what stops it must not look like a file's error.
        for _step in range(500):
            with contextlib.suppress(Exception):
                time.sleep(0.01)

    monkeypatch.setattr("phytac_design.study.advice.quick_repair.quick_repair", forever)
    monkeypatch.setattr(check_command, "LOOK_S", 0.1)
    path = tmp_path / "mine.toml"
    before = signal.getsignal(signal.SIGALRM)
    path.write_text(to_toml(small(camera={"stand_off_mm": 3.0})))
    with pytest.raises(typer.Exit):
        check_command.check(str(path))
    assert looked == [True]
    words = f"next: phytac advise {path} evaluates more changes (minutes)\n"
    assert capsys.readouterr().out == words
    assert signal.getsignal(signal.SIGALRM) == before
    path.write_text(to_toml(small(wall={"thickness_mm": 0.08})))
    with pytest.raises(typer.Exit):
        check_command.check(str(path))
    assert looked == [True]
    assert "looks like cm" in capsys.readouterr().err


def test_the_tip_that_is_hardest_to_read_is_one_tip() -> None:
    """Neither that with the least red when out nor that with the most at rest."""
    seen = seen_at_rest(check_design(small(camera=READING)))
    n = len(seen.red_on_px)
    rest, on = np.zeros(n, dtype=np.int64), np.full(n, 400)
    rest[3], on[5], rest[7], on[7] = 200, 90, 150, 150
    tip = replace(seen, red_rest_px=rest, red_on_px=on).weakest_tip()
    assert tip == 7
    report = checkup(small(camera=READING))
    found, figures = report["weakest_tip"], report["visibility"]
    assert found["on_px"] == seen.red_on_px[found["marker"]] >= figures["min_red_on_px"]
    assert found["needed_px"] == pytest.approx(1.3 * found["rest_px"] + 12)
    assert "weakest_tip" not in checkup(small(receptor={"diameter_hole_mm": 0.0}, camera=COARSE))


def test_lines_of_quick_steps_come_seldom(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    times = iter([0.0, 1.0, 2.9, 3.1, 4.0, 7.0])
    report = output.seldom(3.0)
    monkeypatch.setattr("phytac_design.cli.output.time.monotonic", lambda: next(times))
    for step in range(6):
        report(f"step {step}")
    assert capsys.readouterr().err.split("\n")[:-1] == ["step 0", "step 3", "step 5"]


def test_a_rule_that_advice_satisfies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "mine.toml"
    few, hole = {"rows": 5, "columns": 10}, {"diameter_hole_mm": 2.3}
    path.write_text(to_toml(small(layout=few, receptor=hole)))
    out = phytac("check", "mine.toml", cwd=tmp_path)
    assert out.stdout == "this repairs it: receptor.diameter_outer_mm 3 → 3.1 mm\n"
    assert "error[tube-wall-too-thin]" in out.stderr


def test_why_a_shell_does_not_bear_its_force_is_a_whole_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: object, **__: object) -> None:
        text = "the path ends at 3 N (element 7 is distorted; take more elements); take more steps"
        raise NumericalError("path-ends", text)

    monkeypatch.setattr(design_check, "press", fails)
    monkeypatch.setattr(design_check, "linear_error", lambda *_: 1.0)
    (words,) = snapping_words(small())
    assert ": the path ends at 3 N; take a thicker wall" in words


def test_a_shell_that_snaps_under_its_largest_force_is_named() -> None:
    few = {"count": 20}
    assert snapping_words(changed("hemisphere", layout=few)) == []
    soft = changed("hemisphere", layout=few, material={"modulus_MPa": 5.0, "poisson": 0.48})
    (words,) = snapping_words(soft)
    assert words.startswith("the shell does not bear its largest force of 25 N in the middle: ")
    assert "wall.thickness_mm" in words
    # Far from linear, and stiffer by that: it does not snap.
    few = {"rows": 6, "columns": 6}
    flat = changed("plane", layout=few, training={"force_max_N": 8.0})
    assert linear_error(check_design(flat), None) > NEARLY_LINEAR
    assert snapping_words(flat) == []
