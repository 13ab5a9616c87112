"""A trained decoder knows the print that it was trained on, and reads others as unknown ones."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR
from phytac_decoder.estimation.locator import sd_with_factor
from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.frame_reading import read
from phytac_decoder.pipeline.print_identity import SETTINGS, for_this_print, print_gap_mm
from phytac_design.cli.app import app
from phytac_design.datasets.samples import DataSetInfo, rest_note
from phytac_design.datasets.samples_file import read_samples, write_samples
from phytac_design.engine.stage import Context
from phytac_design.layout import make_markers
from phytac_design.stages.build import BuildResult, run_stages, select_stages
from phytac_design.stages.decoder_stage import assemble_bundle, untrained_model
from phytac_design.workflows import train_decoder
from phytac_design.workflows.evaluate_decoder import evaluate
from phytac_design.workflows.train_decoder import MECHANICS, train
from phytac_shapes.arrays import FloatArray
from tests.drawn_presses import meta_of, presses
from tests.refusals import refused
from tests.test_train import DESIGN, HASH

PRINTER_MM = 0.05
"""How well printers place markers."""


@pytest.fixture(scope="module")
def plain() -> Bundle:
    """The small built sensor's decoder by design alone."""
    stages = select_stages(MECHANICS)
    options = {"accuracy": "draft", "seed": 0, "force": True, "progress": lambda _: None}
    context: Context = run_stages(DESIGN, stages, **options)[0]
    return assemble_bundle(context, untrained_model(context), {})


def moved(camera: Camera, shift_mm: float, turn_deg: float) -> Camera:
    """The camera after it was taken out and put back."""
    turn = cv2.Rodrigues(np.radians([turn_deg, -turn_deg, turn_deg]))[0]
    shift = np.array([shift_mm, -shift_mm, shift_mm])
    return replace(camera, position_mm=camera.position_mm + shift, rotation=turn @ camera.rotation)


def rest_of(bundle: Bundle, number: int, camera: Camera | None = None) -> FloatArray:
    """Rest positions of a print, seen with the noise of a picture."""
    scatter = np.random.default_rng(number).normal(0.0, PRINTER_MM, bundle.head_mm.shape)
    noise = np.random.default_rng([number, camera is None]).normal(0, 0.03, bundle.rest_px.shape)
    there = (camera or bundle.camera).project(bundle.head_mm + scatter * (number > 0))
    return bundle.rest_px + there - bundle.camera.project(bundle.head_mm) + noise


def trained(bundle: Bundle, *, stiffness: float) -> Bundle:
    """As trained on print 1."""
    locator = bundle.model.locator
    assert locator is not None
    box = bundle.position_mm
    fitted = ForceCorrection.plain(low_mm=box.min(axis=0), size_mm=60.0, force_max_N=25.0)
    fitted = replace(fitted, spread_share=0.01, stiffness=stiffness)
    own = replace(locator, places=locator.places.scaled(stiffness), correction=fitted)
    pressed = np.array([20, 4])
    columns = MeasuredColumns(
        marker=pressed, shift_px=bundle.model.compliance_px[:, pressed] / stiffness
    )
    return replace(
        bundle,
        model=replace(bundle.model, locator=own, measured=columns),
        learnt_rest_px=rest_of(bundle, 1)[None],
    )


@pytest.mark.parametrize(("shift_mm", "turn_deg"), [(0.0, 0.0), (0.3, 0.3), (1.0, 1.0)])
def test_a_camera_that_was_put_back_shows_the_same_print(
    plain: Bundle, shift_mm: float, turn_deg: float
) -> None:
    bundle, camera = trained(plain, stiffness=1.2), moved(plain.camera, shift_mm, turn_deg)
    same = print_gap_mm(bundle, rest_of(plain, 1, camera))
    other = print_gap_mm(bundle, rest_of(plain, 2, camera))
    assert same is not None
    assert other is not None
    assert same < SETTINGS.same_mm < 0.7 * other
    now = replace(bundle, rest_px=rest_of(plain, 1, camera))
    assert for_this_print(now) is now


def test_displaced_markers_do_not_make_it_another_print(plain: Bundle) -> None:
    bundle, rest_px = trained(plain, stiffness=1.2), rest_of(plain, 1)
    rest_px[::6] += 3.0
    rest_px[1::6] = np.nan
    gap = print_gap_mm(bundle, rest_px)
    assert gap is not None
    assert gap < SETTINGS.same_mm


def test_too_few_markers_show_no_print(plain: Bundle) -> None:
    rest_px = rest_of(plain, 2)
    rest_px[5:] = np.nan
    assert print_gap_mm(trained(plain, stiffness=1.2), rest_px) is None
    assert print_gap_mm(plain, rest_of(plain, 2)) is None


def test_one_of_several_prints_is_enough(plain: Bundle) -> None:
    both = np.stack([rest_of(plain, 3), rest_of(plain, 2)])
    bundle = replace(trained(plain, stiffness=1.2), learnt_rest_px=both)
    now = replace(bundle, rest_px=rest_of(plain, 2, plain.camera))
    assert for_this_print(now) is now


def test_another_print_is_read_as_an_unknown_one(plain: Bundle) -> None:
    bundle = trained(plain, stiffness=1.2)
    now = for_this_print(replace(bundle, rest_px=rest_of(plain, 2)))
    assert now.other_print_mm > SETTINGS.same_mm
    assert [text for text in now.limits() if text.startswith("another-print: ")]
    assert not [text for text in bundle.limits() if text.startswith("another-print: ")]
    assert now.model.locator is not None
    assert now.model.locator.correction is None
    assert bundle.model.measured is not None
    assert now.model.measured is None
    # A press of 5 N on a sensor as designed.
    shift = 5.0 * plain.model.compliance_px[:, 20].reshape(-1, 2)
    koi = np.array([20])
    learnt, unknown = (each.model.contacts(shift, koi).contacts[0] for each in (bundle, now))
    assert learnt.force_N == pytest.approx(1.2 * unknown.force_N, rel=0.02)
    raw_N = np.array([unknown.force_N]), np.array([unknown.raw_sd_N])
    stated_N = sd_with_factor(*raw_N, LOCATOR.stiffness_sd)[0]
    # The error of linear tables is added.
    assert stated_N <= unknown.sd_N < 1.01 * stated_N
    share = [one.sd_N / one.force_N for one in (learnt, unknown)]
    wider = np.sqrt(LOCATOR.stiffness_sd**2 - bundle.model.locator.correction.spread_share**2)
    assert np.sqrt(share[1] ** 2 - share[0] ** 2) > wider
    inverse = (each.model.forces("koi_inverse", shift, koi)[20] for each in (bundle, now))
    np.testing.assert_allclose(list(inverse), [6.0, 5.0], rtol=1e-6)
    # A second rest frame changes nothing more.
    assert for_this_print(now) is now


def test_without_tables_measured_columns_are_dropped_as_well(plain: Bundle) -> None:
    bundle = trained(plain, stiffness=1.2)
    bundle = replace(bundle, model=replace(bundle.model, locator=None))
    now = for_this_print(replace(bundle, rest_px=rest_of(plain, 2)))
    assert now.model.measured is None
    assert now.other_print_mm > SETTINGS.same_mm
    assert for_this_print(replace(bundle, rest_px=rest_of(plain, 1))).model.measured is not None


def test_a_print_that_cannot_be_recognised_is_a_limit(plain: Bundle) -> None:
    known = trained(plain, stiffness=1.2)
    for bundle, warned in (
        (known, False),
        (replace(known, learnt_rest_px=known.learnt_rest_px[:0]), True),
    ):
        assert any("another print is not noticed" in text for text in bundle.limits()) == warned


def test_a_rest_frame_shows_it(built: BuildResult, tmp_path: Path) -> None:
    bundle = load_bundle(built.out / "decoder")
    rest = cv2.imread(str(built.out / "views" / "frame_rest.png"))
    frame = cv2.imread(str(built.out / "views" / "frame_pressed.png"))
    same = replace(bundle, learnt_rest_px=rest_of(bundle, 0, bundle.camera)[None])
    other = replace(bundle, learnt_rest_px=rest_of(bundle, 2)[None])
    assert calibrate_rest(same, [rest]).other_print_mm == 0.0
    lit = calibrate_rest(other, [rest])
    assert lit.other_print_mm > SETTINGS.same_mm
    assert read(lit, measure_frame(lit, frame), "auto").valid


def test_training_keeps_the_print_and_evaluation_names_another(
    plain: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is learnt does not matter here.
    monkeypatch.setattr(train_decoder, "TRAINERS", train_decoder.TRAINERS[:1])
    monkeypatch.setattr("phytac_design.workflows.evaluate_decoder.draw", lambda *_: {})
    uv = make_markers(DESIGN, DESIGN.surface()).uv
    said: list[str] = []

    def made(name: str, number: int, seed: int) -> Path:
        samples = presses(plain.model, uv, count=30, seed=seed, softer=1.25, noise_px=0.01)
        notes = rest_note(rest_of(plain, number))
        meta = meta_of("tiny", HASH)
        write_samples(tmp_path / name, samples, replace(meta, notes=meta.notes | notes))
        return tmp_path / name

    train(DESIGN, [made("one", 1, 0)], tmp_path / "decoder", accuracy="draft", progress=said.append)
    bundle = load_bundle(tmp_path / "decoder")
    np.testing.assert_allclose(bundle.learnt_rest_px[0], rest_of(plain, 1), atol=1e-3)

    def judge(name: str, number: int, seed: int) -> None:
        data = [made(name, number, seed)]
        evaluate(tmp_path / "decoder", data, tmp_path / f"of {name}", progress=said.append)

    judge("again", 1, 1)
    assert not [text for text in said if "another print" in text]
    judge("two", 2, 2)
    assert [text for text in said if "another print" in text]


def test_evaluation_judges_standard_deviations(
    plain: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("phytac_design.workflows.evaluate_decoder.draw", lambda *_: {})
    save_bundle(replace(plain, design_hash=HASH), tmp_path / "decoder")
    uv = make_markers(DESIGN, DESIGN.surface()).uv
    samples = presses(plain.model, uv, count=30, seed=0, noise_px=0.01)
    write_samples(tmp_path / "data", samples, meta_of("tiny", HASH))
    said = CliRunner().invoke(app, ["evaluate", str(tmp_path / "decoder"), str(tmp_path / "data")])
    assert said.exit_code == 0
    out = tmp_path / "decoder-evaluation"
    intervals = json.loads((out / "evaluation.json").read_text())["intervals"]
    assert intervals["contacts"] > 10
    (line,) = [text for text in said.stdout.splitlines() if "90 % intervals of auto" in text]
    assert f"% of {intervals['contacts']} true forces" in line
    tables = (out / "tables.md").read_text()
    assert f"## Standard deviations\n\n{line}.\n" in tables
    assert f"{intervals['unmatched']} contacts with a switch that was read have no match" in tables


def test_what_is_no_rest_position_is_refused() -> None:
    meta = DataSetInfo(simulated=True, what="x", design="d", design_hash="h", route="points")
    for stored in ("no", [[1.0]], [[1.0, "a"]], [3.0]):
        with refused("data-set-table-invalid"):
            _ = replace(meta, notes={"rest_px": stored}).rest_px
    known = replace(meta, notes=rest_note(np.array([[1.0, 2.0], [np.nan, 1.0]]))).rest_px
    np.testing.assert_array_equal(known, [[1.0, 2.0], [np.nan, np.nan]])


def test_rest_positions_of_other_markers_are_refused(plain: Bundle, tmp_path: Path) -> None:
    uv = make_markers(DESIGN, DESIGN.surface()).uv
    samples = presses(plain.model, uv, count=3, seed=0)
    meta = meta_of("tiny", HASH)
    notes = meta.notes | rest_note(rest_of(plain, 1)[:5])
    write_samples(tmp_path / "data", samples, replace(meta, notes=notes))
    with refused("data-set-table-invalid"):
        read_samples(tmp_path / "data")


def test_measured_columns_are_kept(built: BuildResult, tmp_path: Path) -> None:
    bundle = trained(load_bundle(built.out / "decoder"), stiffness=1.2)
    save_bundle(bundle, tmp_path)
    model = load_bundle(tmp_path).model
    np.testing.assert_allclose(model.response_px, bundle.model.response_px, rtol=1e-6, atol=1e-12)
    columns = MeasuredColumns(marker=np.array([20, 999]), shift_px=model.compliance_px[:, :2])
    save_bundle(replace(bundle, model=replace(model, measured=columns)), tmp_path)
    with refused("bundle-id-invalid"):
        load_bundle(tmp_path)


def test_measured_squares_and_pairs_are_kept(built: BuildResult, tmp_path: Path) -> None:
    bundle = load_bundle(built.out / "decoder")
    model, n = bundle.model, len(bundle.position_mm)
    rows = np.random.default_rng(0).normal(size=(2 * n, 4))
    columns = MeasuredColumns(
        marker=np.array([20, 4]),
        shift_px=model.compliance_px[:, [20, 4]],
        square_px=rows[:, :2],
        pair=np.array([[20, 4], [4, 9]]),
        pair_px=rows[:, 2:],
    )
    save_bundle(replace(bundle, model=replace(model, measured=columns)), tmp_path)
    found = load_bundle(tmp_path).model.measured
    assert found is not None
    assert sorted(found.pairs) == [(9, 4), (20, 4)]
    np.testing.assert_allclose(found.squares[4], rows[:, 1], rtol=1e-6)
    np.testing.assert_allclose(found.pairs[9, 4], rows[:, 3], rtol=1e-6)
    for broken, code in (
        (replace(columns, pair=np.array([[20, n], [4, 4]])), "bundle-id-invalid"),
        (replace(columns, pair_px=rows[:, 3:]), "bundle-array-shape"),
        (replace(columns, square_px=rows[:, :1]), "bundle-array-shape"),
    ):
        save_bundle(replace(bundle, model=replace(model, measured=broken)), tmp_path)
        with refused(code):
            load_bundle(tmp_path)


def test_a_damaged_array_is_refused(built: BuildResult, tmp_path: Path) -> None:
    bundle = load_bundle(built.out / "decoder")
    save_bundle(replace(bundle, learnt_rest_px=np.zeros((1, 3, 2))), tmp_path)
    with refused("bundle-array-shape"):
        load_bundle(tmp_path)
