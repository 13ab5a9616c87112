"""Plans: what runs, why, at what cost; estimator, camera, theory and fixtures chosen."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli import plan_command
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.scene import Scene, load_scene
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.stages import STAGES
from phytac_design.study.planning.cost import features, machine_factor, predict, repeats
from phytac_design.study.planning.plan import BuildPlan, plan_scene
from phytac_design.study.planning.resolve import resolve
from phytac_design.study.planning.unit_costs import MEMORY_MB, CPU_s
from tests.designs import changed, small
from tests.refusals import refused
from tests.study.planning.scenes import scene


def planned(design: Design, wanted: Scene, preset: str = "draft") -> BuildPlan:
    return plan_scene(design, wanted, accuracy=PRESETS[preset], speed=1.0)


def actions(plan: BuildPlan) -> dict[str, str]:
    return {row.stage: row.action for row in plan.rows}


def test_every_stage_has_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path))  # what others built would not run
    plan = planned(small(), load_scene("occlusion"))
    assert [row.stage for row in plan.rows] == [stage.name for stage in STAGES]
    found = actions(plan)
    assert {name for name, action in found.items() if action == "run"} == {"views", "underload"}
    for row in plan.rows:
        assert row.why
        assert row.loses or row.action == "run"
        # A draft has no STEP files, and nothing that a sensor is made with.
        absent = {stage.name for stage in STAGES if stage.only_with}
        assert (row.seconds > 0.0) == (row.stage not in absent)
    assert plan.seconds < 0.5 * plan.whole_seconds
    assert plan.error == {}


@pytest.mark.parametrize("output", ["report", "fabrication"])
def test_a_draft_plans_what_is_printed_and_cast_only_where_it_is_asked_for(output: str) -> None:
    rows = {row.stage: row for row in planned(small(), scene(outputs=[output])).rows}
    for name, setting in (("step", "step"), ("mold", "tools"), ("bench", "tools")):
        made = output == "fabrication"
        assert (rows[name].action != "left out") == made
        assert bool(rows[name].loses) != made
        assert (f"--set {setting}=true" in rows[name].why) != made


def test_whole_and_limited_counts() -> None:
    design = small()
    plan = planned(design, scene())
    assert plan.whole_counts.markers == plan.whole_counts.in_play == 112
    assert plan.counts.repeats == 14
    assert 10 < plan.counts.in_play < 40
    assert plan.counts.places < 0.6 * plan.whole_counts.places
    assert plan.counts.truth_nodes < 0.9 * plan.whole_counts.truth_nodes
    assert plan.counts.contacts == 36
    assert plan.whole_counts.contacts > 100


@pytest.mark.parametrize(
    ("rate", "estimator"), [(None, "auto"), (30.0, "auto"), (480.0, "koi_inverse")]
)
def test_frames_per_second_choose_the_estimator(rate: float | None, estimator: str) -> None:
    camera = {"width_px": 640, "height_px": 480, "focal_px": 239.5}
    resolved = resolve(
        small(camera=camera), scene(frame_rate_Hz=rate, regions=[]), PRESETS["draft"]
    )
    assert resolved.scene.estimator == estimator
    names = [stage.name for stage in resolved.stages]
    assert ("places" in names) == (estimator == "auto")
    assert "ms a frame" in resolved.why["estimator"]


def test_theory_follows_the_pilot() -> None:
    weak = resolve(
        small(), scene(contacts={"force_max_N": 0.6}, error_allowed=0.05), PRESETS["standard"]
    )
    strong = resolve(
        small(), scene(contacts={"force_max_N": 25.0}, error_allowed=0.02), PRESETS["draft"]
    )
    assert weak.accuracy.place_orders == 1
    assert strong.accuracy.place_orders == 4
    # Tables of several powers are not extrapolated from finer meshes, as linear ones of drafts are.
    assert strong.accuracy.refine == PRESETS["draft"].refine + 1
    assert "4 elements" in strong.why["mesh"]
    assert "mesh" not in weak.why
    mild = resolve(small(), scene(contacts={"force_max_N": 0.6}), PRESETS["draft"])
    assert mild.accuracy.place_orders == 1
    assert mild.accuracy.refine == PRESETS["draft"].refine
    # Its first term grows with the force.
    ratio = strong.linear_error / weak.linear_error
    assert 20.0 < ratio < 70.0


def test_only_the_named_camera_of_two() -> None:
    both = small(camera={"ends": "both"}, layout={"heights": "line-of-sight"})
    resolved = resolve(both, scene(camera="far"), PRESETS["draft"])
    assert resolved.design.camera.ends == "far"
    with refused("scene-camera-missing") as caught:
        resolve(small(), scene(camera="far"), PRESETS["draft"])
    caught.match('set camera = "near"')


def test_empty_force_ranges_are_rejected() -> None:
    with refused("scene-range-empty"):
        resolve(small(), scene(contacts={"force_max_N": 0.4}), PRESETS["draft"])
    with refused("scene-range-empty"):
        resolve(small(), scene(contacts={"radius_max_mm": 2.0}), PRESETS["draft"])


def test_sectors_are_found_by_the_markers() -> None:
    for name, turns in (("cylinder60", 16), ("plane", 1), ("hemisphere", 1), ("cuboid", 1)):
        design = changed(name)
        surface = design.surface()
        assert repeats(surface, make_markers(design, surface)) == turns


def test_unit_costs_cover_every_stage_and_grow() -> None:
    names = {stage.name for stage in STAGES}
    assert set(CPU_s) == set(MEMORY_MB) == names
    plan = planned(small(), scene())
    few = features(plan.counts, replace(PRESETS["draft"], step=True, tools=True), small(), scene())
    many = features(plan.whole_counts, PRESETS["fine"], small())
    for table in (CPU_s, MEMORY_MB):
        less, more = predict(table, few), predict(table, many)
        for name in names:
            assert set(table[name]) <= set(few[name])
            assert 0.0 < less[name] <= more[name]
    twice = plan_scene(small(), scene(), accuracy=PRESETS["draft"], speed=2.0)
    assert twice.whole_seconds == pytest.approx(2.0 * plan.whole_seconds)
    assert 0.02 < machine_factor() < 50.0


def test_the_command_prints_the_plan_and_json() -> None:
    app = typer.Typer()
    app.command()(plan_command.plan)
    run = CliRunner()
    done = run.invoke(app, ["cylinder60", "fingertip", "--accuracy", "draft"])
    assert done.exit_code == 0
    assert "left out" in done.stdout
    assert "predicted error of a force" in done.stdout
    plain = run.invoke(app, ["cylinder60", "fabrication", "--json"])
    report = json.loads(plain.stdout)
    assert report["predicted"]["seconds"] >= 0.0
    assert {row["stage"] for row in report["stages"]} == {stage.name for stage in STAGES}


def test_flat_walls_add_to_the_predicted_error(capsys: pytest.CaptureFixture[str]) -> None:
    finger = load_scene("fingertip")
    curved = plan_scene(load_design("cylinder60"), finger, accuracy=PRESETS["standard"])
    flat = plan_scene(load_design("plane"), finger, accuracy=PRESETS["standard"])
    assert "flat wall" not in curved.error
    assert curved.error["force"] < finger.error_allowed < 0.1 < flat.error["force"]
    plan_command.print_plan(curved)
    assert "more than the scene allows" not in capsys.readouterr().err
    plan_command.print_plan(flat)
    assert "finer settings do not help on flat walls" in capsys.readouterr().err


@pytest.mark.parametrize(("worst", "warned"), [(0.26, True), (0.019, False)])
def test_a_press_that_the_prediction_does_not_cover_is_warned_of(
    capsys: pytest.CaptureFixture[str], worst: float, *, warned: bool
) -> None:
    error = {"predicted": 0.014, "allowed": 0.02, "actual": 0.006, "worst": worst, "presses": 6}
    cost = {"predicted": 1.0, "actual": 1.0}
    done = {"stages": {}, "seconds": cost, "memory_MB": cost, "error": error}
    plan_command.print_audit(done, Path("out"))
    assert ("the worst press is further off" in capsys.readouterr().err) == warned
