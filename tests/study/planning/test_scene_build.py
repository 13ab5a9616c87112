"""Builds of a scene: the whole sensor's forces in the region, warnings outside it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.simulation.dataset import Dataset
from phytac_design.stages import STAGES
from phytac_design.stages.build import BuildResult, run_stages, select_stages
from phytac_design.stages.decoder_stage import tips_in_play
from phytac_design.stages.response_stage import image_response_of, truth_solver
from phytac_design.study.planning import run_plan as run_plan_module
from phytac_design.study.planning.plan import BuildPlan, plan_scene
from phytac_design.study.planning.run_plan import (
    Progress,
    ReferencePresses,
    audit,
    force_errors,
    reference_presses,
    run_plan,
)
from tests.designs import small
from tests.study.planning.scenes import scene


def quiet(_: str) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def whole() -> Context:
    """The small design's decoder, of all of its surface."""
    stages = select_stages(["decoder"])
    return run_stages(small(), stages, accuracy="draft", seed=0, progress=quiet)[0]


@pytest.fixture(scope="module")
def planned() -> BuildPlan:
    return plan_scene(small(), scene(), accuracy=PRESETS["draft"], speed=1.0)


@pytest.fixture(scope="module")
def result(planned: BuildPlan, tmp_path_factory: pytest.TempPathFactory) -> BuildResult:
    out = tmp_path_factory.mktemp("scene") / "finger"
    return run_plan(planned, out, progress=quiet)[0]


@pytest.fixture(scope="module")
def bundle(result: BuildResult) -> Bundle:
    return load_bundle(result.out / "decoder")


def context_on(planned: BuildPlan, whole: Context) -> Context:
    """The scene's context on what the camera sees of the whole sensor."""
    context = planned.resolved.context()
    context.folders.update(whole.folders)
    return context


def bundle_of(context: Context) -> Bundle:
    return load_bundle(context.folders["decoder"] / EXPORT / "decoder")


def test_only_what_the_scene_needs_runs(result: BuildResult) -> None:
    assert set(result.ran) <= {"views", "response", "places", "twin", "decoder"}
    files = {p.relative_to(result.out).as_posix() for p in result.out.rglob("*") if p.is_file()}
    assert files == {
        "design.toml",
        "manifest.json",
        "decoder/bundle.json",
        "decoder/bundle.safetensors",
        "report/plan.json",
    }


def test_tables_are_the_whole_ones(bundle: Bundle, whole: Context, planned: BuildPlan) -> None:
    # In linear theory they are the same, place by place.
    assert planned.resolved.accuracy.place_orders == 1
    mine, every = bundle.model.locator, bundle_of(whole).model.locator
    assert mine is not None
    assert every is not None
    near = every.places.nearest(mine.places.point_mm)
    assert len(near) < 0.6 * len(every.places.point_mm)
    assert np.allclose(every.places.point_mm[near], mine.places.point_mm, atol=1e-9)
    assert np.allclose(every.places.shift_px[near], mine.places.shift_px, rtol=1e-4, atol=1e-6)


def test_matrices_are_those_of_receptors_in_play(
    bundle: Bundle, whole: Context, planned: BuildPlan
) -> None:
    played, every = planned.resolved.in_play, bundle_of(whole)
    assert np.allclose(
        bundle.model.compliance_px[:, played], every.model.compliance_px[:, played], rtol=1e-9
    )
    assert not bundle.model.compliance_px[:, ~played].any()
    assert (bundle.force_readable == played).all()
    assert bundle.notes["scene"]["in_play"] == np.flatnonzero(played).tolist()
    said = f"it reads forces on {int(played.sum())} of {len(played)} markers"
    assert any(said in sentence for sentence in bundle.limits())


def test_forces_in_the_region_are_the_whole_decoders(
    bundle: Bundle, whole: Context, planned: BuildPlan
) -> None:
    presses = reference_presses(context_on(planned, whole), 5)
    assert np.isfinite(presses.shift_px).all()
    for estimator in ("auto", "koi_inverse"):
        mine = force_errors(bundle.model, presses, estimator)
        full = force_errors(bundle_of(whole).model, presses, estimator)
        valid = np.isfinite(mine)
        assert valid.sum() >= 3
        assert np.abs(mine - full)[valid].max() < 0.01
        assert np.abs(mine[valid]).max() < 0.5


def test_the_audit_presses_each_place_with_its_own_force(
    whole: Context, planned: BuildPlan
) -> None:
    context = context_on(planned, whole)
    presses, solver = reference_presses(context, 3), truth_solver(context)
    see, contacts = image_response_of(context), presses.contacts
    assert np.ptp(contacts.force_N) > 1.0
    for k, shift in enumerate(presses.shift_px):
        motion = solver.solve(contacts.of(k), contacts.force_N[k : k + 1]).motion
        assert motion is not None
        np.testing.assert_allclose(shift, see.shift(motion), atol=1e-9)


def test_forces_outside_raise_a_warning(bundle: Bundle, whole: Context, planned: BuildPlan) -> None:
    resolved = planned.resolved
    data = Dataset.from_arrays(whole.arrays("twin"), "test")
    contacts = data.contacts
    alone = contacts.counts[contacts.sample] == 1
    outside = 0
    for k in np.flatnonzero(alone):
        sample = contacts.sample[k]
        koi = np.flatnonzero(data.switching.bits[sample])
        if len(koi) == 0 or resolved.in_play[koi].any():
            continue
        outside += 1
        measured = FrameMeasurement(
            koi=koi,
            shift_px=data.shift_px[sample],
            found=np.ones(len(resolved.in_play), dtype=np.bool_),
        )
        for estimator in ("auto", "koi_inverse"):
            forces = measured.forces_N(bundle, estimator)
            assert measured.warnings(bundle, forces, estimator=estimator)
    assert outside >= 5


def test_no_alarm_inside(bundle: Bundle, whole: Context, planned: BuildPlan) -> None:
    presses = reference_presses(context_on(planned, whole), 5)
    for shift, bits in zip(presses.shift_px, presses.switching.bits, strict=True):
        koi = np.flatnonzero(bits)
        if len(koi) == 0:
            continue
        measured = FrameMeasurement(
            koi=koi, shift_px=shift, found=np.ones(len(bits), dtype=np.bool_)
        )
        forces = measured.forces_N(bundle, "auto")
        assert measured.warnings(bundle, forces, estimator="auto") == []


def test_blind_tips_out_of_play_never_count() -> None:
    rest, on = np.array([9.0, 9.0, 2.0]), np.array([10.0, 10.0, 50.0])
    played = np.array([True, False, False])
    tips = tips_in_play(np.zeros((3, 2)), rest, on, played)
    assert tips.red_on_px[[0, 2]].tolist() == [10.0, 50.0]
    assert tips.readable.tolist() == [False, True, True]
    # No red that such a tip shows, at rest or out, turns it on.
    assert tips.threshold_px[1] > max(rest[1], 1.25 * rest[1] + 4.0)


def test_audit_stands_beside_the_plan(result: BuildResult, planned: BuildPlan) -> None:
    written = json.loads((result.out / "report" / "plan.json").read_text())
    assert written["scene"]["name"] == "finger"
    assert set(written["audit"]["stages"]) == set(result.ran)
    for count in written["audit"]["counts"].values():
        assert count["actual"] == pytest.approx(count["predicted"], rel=0.5)
    error = written["audit"]["error"]
    assert error["presses"] + error["tripped_no_switch"] <= 6
    assert error["presses"] >= 3
    assert 0.0 < error["actual"] < 0.3
    assert error["predicted"] == planned.error["force"]


def test_the_audit_presses_a_finer_shell_than_the_draft_has(
    result: BuildResult, planned: BuildPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    refines = []

    def presses(context: Context, progress: Progress) -> ReferencePresses:
        refines.append(context.accuracy.truth_refine)
        return reference_presses(context, 1, progress)

    monkeypatch.setattr(run_plan_module, "reference_presses", presses)
    context = planned.resolved.context()
    context.folders.update(result.folders)
    audit(planned, context, ran={}, used_s=0.0, progress=quiet)
    assert refines == [PRESETS["standard"].truth_refine]
    assert refines[0] > planned.resolved.accuracy.truth_refine


def test_a_second_build_takes_all_from_the_cache(result: BuildResult, tmp_path: Path) -> None:
    again = plan_scene(small(), scene(), accuracy=PRESETS["draft"], speed=1.0)
    ours = [row for row in again.rows if row.action != "left out"]
    assert {row.action for row in ours} == {"cached"}
    assert again.seconds == 0.0
    assert run_plan(again, tmp_path / "again", errors=False, progress=quiet)[0].ran == ()


def test_without_a_scene_keys_do_not_change() -> None:
    context = Context(design=small(), accuracy=PRESETS["draft"], seed=0)
    keys = {stage.name: "0" for stage in STAGES}
    for stage in STAGES:
        plain = stage.inputs(context, keys)
        assert set(plain) == {"reads", "knobs", "needs", "seed", "graphics"}
        limited = replace(context, scene=scene())
        assert ("scene" in stage.inputs(limited, keys)) == bool(stage.scene)
