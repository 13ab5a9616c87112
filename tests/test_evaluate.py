"""Judging decoders: errors, intervals, groups, files, refusals."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle, save_bundle
from phytac_design.cli.app import app
from phytac_design.datasets.samples import FLAGGED, DataSetInfo, Samples
from phytac_design.datasets.samples_file import file_hash, write_samples
from phytac_design.design.design_file import design_hash, to_toml
from phytac_design.training.evaluation.decoded_contacts import decode_contacts
from phytac_design.training.evaluation.evaluation_plots import decoded_against_true
from phytac_design.training.evaluation.groups import ContactPositions, contact_positions, groups_of
from phytac_design.training.join_datasets import join_samples
from phytac_design.training.training_data import DataSet
from phytac_design.workflows.evaluate_decoder import TABLE, evaluate
from phytac_shapes.errors import DesignError
from tests.decoder.toy_sensor import toy_bundle
from tests.designs import small
from tests.drawn_presses import meta_of, presses
from tests.refusals import refused

TOY = toy_bundle()
N = len(TOY.colour)
UV = np.column_stack([np.linspace(0.0, 1.0, N), np.linspace(0.0, 1.0, N, endpoint=False)])
ESTIMATORS = ("fem", "fem_nn", "fem_nn_identity", "koi_inverse")


def toy_samples(count: int = 60, seed: int = 0, **options: float) -> Samples:
    """Presses on the toy sensor."""
    return presses(TOY.model, UV, count=count, seed=seed, **options)


def toy_meta(**changes: object) -> DataSetInfo:
    """Of the toy sensor."""
    return meta_of(TOY.design, TOY.design_hash, **changes)


@pytest.fixture(autouse=True)
def _without_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take most of the time, and are looked at by one test."""
    if "pictures" not in request.node.name:
        monkeypatch.setattr("phytac_design.workflows.evaluate_decoder.draw", lambda *_: {})


@pytest.fixture
def judge(tmp_path: Path) -> Callable[..., Path]:
    """Evaluate the toy decoder quietly; the result's folder."""
    save_bundle(TOY, tmp_path / "decoder")

    def run(*sets: Samples, metas: tuple[DataSetInfo, ...] = (), **options: object) -> Path:
        folders = []
        for number, samples in enumerate(sets):
            folders.append(tmp_path / f"data-{number}")
            meta = metas[number] if metas else toy_meta()
            write_samples(folders[-1], samples, meta)
        settings = {"out": tmp_path / "result", "progress": lambda _: None} | options
        evaluate(tmp_path / "decoder", folders, **settings)
        return Path(settings["out"])

    return run


def facts_of(out: Path) -> dict:
    """What an evaluation says."""
    return json.loads((out / TABLE).read_text())


def test_what_is_decoded_is_given_to_the_contact_that_presses() -> None:
    samples = toy_samples(20)
    assert samples.touches is not None
    decoded = decode_contacts(TOY.model, samples)
    assert tuple(decoded.decoded_N) == ESTIMATORS
    np.testing.assert_allclose(decoded.decoded_N["koi_inverse"], samples.touches.force_N, rtol=1e-9)
    np.testing.assert_allclose(decoded.decoded_N["fem"], samples.touches.force_N, rtol=1e-9)
    assert decoded.tripped.all()
    assert decoded.read.all()
    np.testing.assert_allclose(decoded.elsewhere_N["koi_inverse"], 0.0, atol=1e-9)
    assert (decoded.missed, decoded.false) == (0, 0)
    assert decoded.on + decoded.off == 20 * N


def test_missed_and_false_switches_failed_samples_and_light_touches_are_counted() -> None:
    samples = toy_samples(10, contacts_max=1)
    assert samples.touches is not None
    assert samples.truth is not None
    assert samples.bits_read is not None
    pressed = samples.truth.marker
    read = samples.bits_read.copy()
    read[0, pressed[0]] = False
    off = (pressed[1] + 1) % N
    read[1, off] = True
    shift = samples.shift_px.copy()
    shift[1, off, 0] = 4.0
    shift[2] = np.nan
    kept = samples.truth.sample != 3
    light = {name: getattr(samples.truth, name)[kept] for name in ("sample", "marker", "force_N")}
    odd = replace(
        samples,
        bits_read=read,
        shift_px=shift,
        status=np.where(np.arange(10) == 2, 2, 0),
        truth=replace(samples.truth, touch=samples.truth.touch[kept], **light),
    )
    decoded = decode_contacts(TOY.model, odd, estimators=["koi_inverse"])
    assert decoded.sample.tolist() == [0, 1, 3, 4, 5, 6, 7, 8, 9]
    assert (decoded.missed, decoded.false) == (1, 1)
    assert decoded.on + decoded.off == 9 * N
    value = decoded.decoded_N["koi_inverse"]
    assert value[0] == 0.0
    assert not decoded.read[0]
    assert decoded.elsewhere_N["koi_inverse"][1] == pytest.approx(4.0)
    assert decoded.tripped.tolist() == [True, True, False, *[True] * 6]
    assert decoded.force_N[2] == samples.touches.force_N[3]
    np.testing.assert_allclose(value[3:], samples.touches.force_N[4:])


def test_contacts_that_share_a_switch_are_evaluated_by_what_its_owner_carries() -> None:
    samples = toy_samples(1, contacts_max=1)
    assert samples.touches is not None
    two = {
        name: np.repeat(getattr(samples.touches, name), 2, axis=0)
        for name in samples.touches.__dataclass_fields__
    }
    two["force_N"] = two["force_N"] / 2.0
    both = replace(samples, touches=replace(samples.touches, **two), contacts=np.array([2]))
    decoded = decode_contacts(TOY.model, both)
    assert decoded.tripped.tolist() == [True, False]
    np.testing.assert_allclose(decoded.decoded_N["fem"][0], decoded.force_N[0])


class _Broken(ForceModel):
    """Gives nonsense."""

    def forces(self, *_: object) -> np.ndarray:
        return np.full(N, np.nan)


def test_an_estimator_that_gives_no_number_is_named() -> None:
    broken = _Broken(**{name: getattr(TOY.model, name) for name in TOY.model.__dataclass_fields__})
    with refused("estimator-not-finite"):
        decode_contacts(broken, toy_samples(2))


def test_groups_part_the_contacts() -> None:
    sets = [toy_samples(80, 1), toy_samples(20, 2)]
    grips = toy_meta(notes={"scenario": {"kind": "grips"}})
    items = [
        DataSet(folder=Path(), samples=samples, meta=meta, sha256="")
        for samples, meta in zip(sets, (toy_meta(), grips), strict=True)
    ]
    joined = join_samples(sets)
    assert joined.touches is not None
    decoded = decode_contacts(TOY.model, joined, estimators=["fem"])
    where = ContactPositions(along=joined.touches.uv[:, 0], around=joined.touches.uv[:, 1])
    groups = groups_of(items, joined, decoded, where)
    total = len(joined.touches.sample)
    for name in ("contact", "small", "force", "height", "along", "around", "data"):
        masks = np.stack(list(groups[name].values()))
        assert (masks.sum(axis=0) == 1).all(), name
        assert masks.any(axis=1).all(), name
    assert groups["all"]["all"].sum() == total
    alone = joined.contacts[joined.touches.sample] == 1
    first = joined.touches.sample < 80
    np.testing.assert_array_equal(groups["contact"]["single"], alone & first)
    np.testing.assert_array_equal(groups["contact"]["grip"], ~first)
    assert list(groups["data"]) == ["drawn for a test (1)", "drawn for a test (2)"]
    for low, high in pairwise((0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0)):
        mask = groups["force"][f"{low:g} to {high:g} N"]
        chosen = joined.touches.force_N[mask]
        assert chosen.min() >= low
        assert chosen.max() < high


def test_places_are_shares_of_the_way() -> None:
    where = contact_positions(
        small(), np.array([[0.0, 0.0], [15.0, np.pi / 2.0], [60.0, 1.9 * np.pi]])
    )
    np.testing.assert_allclose(where.along, [0.0, 0.25, 1.0], atol=1e-12)
    np.testing.assert_allclose(where.around, [0.0, 0.25, 0.95], atol=1e-12)


def test_files_hold_the_results(judge: Callable[..., Path]) -> None:
    samples = toy_samples(60, noise_px=0.1)
    out = judge(samples)
    facts = facts_of(out)
    assert list(facts["estimators"]) == list(ESTIMATORS)
    score = facts["estimators"]["koi_inverse"]["all"]["all"]
    # A newton moves a marker by a pixel: noise of 0.1 px is an error of 0.1 N.
    assert score["rmse_N"]["value"] == pytest.approx(0.1, rel=0.25)
    assert score["rmse_N"]["low"] < score["rmse_N"]["value"] < score["rmse_N"]["high"]
    assert samples.touches is not None
    assert facts["contacts"]["judged"] == score["contacts"] == len(samples.touches.sample)
    assert facts["samples"] == {"ok": 60, "flagged": 0, "failed": 0, "judged": 60}
    assert facts["switches"]["missed_rate"] == 0.0
    assert facts["theories"] == {"rest": 0, "linear": 60, "large": 0, "real": 0}
    rows = list(csv.DictReader((out / "contacts.csv").read_text().splitlines()))
    assert len(rows) == 4 * score["contacts"]
    mine = [row for row in rows if row["estimator"] == "koi_inverse"]
    error = np.array([float(row["error_N"]) for row in mine])
    assert np.sqrt((error**2).mean()) == pytest.approx(score["rmse_N"]["value"], rel=1e-4)
    text = (out / "tables.md").read_text()
    assert f"| {score['rmse_N']['value']:.3f} [" in text
    assert "## By force" in text
    assert "By height" not in text
    assert "in simulation" in text


def test_pictures_are_readable_and_change_with_the_data(judge: Callable[..., Path]) -> None:
    out = judge(toy_samples(40, noise_px=0.1))
    first = {path.name: path.read_bytes() for path in sorted(out.glob("*.png"))}
    assert sorted(first) == [
        "absolute_error.png",
        "accuracy.png",
        "decoded.png",
        "relative_error.png",
    ]
    for data in first.values():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert min(image.shape[:2]) > 300
        assert 0.01 < (image < 200).any(axis=2).mean() < 0.6
    files = {path.name: path.read_bytes() for path in out.iterdir()}
    judge(toy_samples(40, noise_px=0.1))
    assert {path.name: path.read_bytes() for path in out.iterdir()} == files
    judge(toy_samples(40, noise_px=2.0))
    assert all((out / name).read_bytes() != data for name, data in first.items())


def test_dots_stand_where_they_belong() -> None:
    samples = toy_samples(1, contacts_max=1)
    decoded = decode_contacts(TOY.model, samples, estimators=["fem"])
    force = decoded.force_N

    def dot(share: float) -> tuple[float, float]:
        """Row and column of the second estimator's dot."""
        both = {"fem": force, "koi_inverse": share * force}
        data = decoded_against_true(replace(decoded, decoded_N=both))
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(float)
        # Of all that is drawn, dots of the second estimator alone are blue.
        rows, columns = np.nonzero(image[..., 0] - image[..., 2] > 40.0)
        return float(np.median(rows)), float(np.median(columns))

    low, high = dot(0.2), dot(0.7)
    assert low[0] > high[0] + 30.0
    assert abs(low[1] - high[1]) < 2.0


def test_real_data_report_nothing_about_their_switches(judge: Callable[..., Path]) -> None:
    real = replace(toy_meta(), simulated=False, route="camera", seed=None)
    out = judge(toy_samples(30), metas=(real,))
    assert facts_of(out)["switches"] is None
    assert "measured" in (out / "tables.md").read_text().splitlines()[0]


def test_light_touches_and_failures_reach_the_tables(judge: Callable[..., Path]) -> None:
    samples = toy_samples(30, contacts_max=1)
    assert samples.truth is not None
    none = np.zeros(0, dtype=np.int64)
    kept = samples.truth.sample > 4
    truth = {
        name: getattr(samples.truth, name)[kept]
        for name in ("sample", "marker", "force_N", "touch")
    }
    failed = replace(
        samples,
        status=np.where(np.arange(30) == 29, 2, 0),
        reasons=("dark",),
        reason_sample=np.array([29]),
        reason_index=np.array([0]),
        truth=replace(samples.truth, **truth),
        bits=samples.bits & (np.arange(30) > 4)[:, None],
        bits_read=samples.bits & (np.arange(30) > 4)[:, None],
    )
    out = judge(failed)
    facts = facts_of(out)
    assert facts["samples"]["failed"] == 1
    assert facts["contacts"]["judged"] == 24
    assert facts["contacts"]["tripped_none"] == 5
    for section in ("contact", "small", "force"):
        members = facts["estimators"]["fem"][section].values()
        assert sum(score["contacts"] for score in members) == 24
    assert samples.touches is not None
    largest = samples.touches.force_N[:5].max()
    assert facts["contacts"]["tripped_none_force_N_largest"] == pytest.approx(largest)
    assert "5 that tripped no switch left out" in (out / "tables.md").read_text()
    lines = list(csv.DictReader((out / "contacts.csv").read_text().splitlines()))
    assert [row["decoded_N"] for row in lines[:20]] == [""] * 20
    nothing = dict.fromkeys(("sample", "marker", "touch"), none)
    empty = replace(samples.truth, force_N=np.zeros(0), **nothing)
    dark = np.zeros_like(samples.bits)
    with refused("no-switch-tripped"):
        judge(replace(samples, truth=empty, bits=dark, bits_read=dark))


def test_what_cannot_be_evaluated_is_rejected(judge: Callable[..., Path], tmp_path: Path) -> None:
    samples = toy_samples(10)
    bare = replace(samples, bits=None, bits_read=None, shift_px=None, touches=None, truth=None)
    with refused("samples-without-points"):
        judge(bare)
    with refused("data-set-other-design"):
        judge(samples, metas=(meta_of("other", "f" * 64),))
    more = presses(wider(TOY), np.zeros((N + 1, 2)), count=5, seed=0)
    with refused("data-sets-marker-count") as caught:
        judge(more)
    caught.match(f"{N + 1} markers, the decoder of one with {N}")
    with refused("decoder-of-other-design"):
        judge(samples, design="cylinder60")
    with pytest.raises(DesignError):
        judge(samples, design="nowhere")
    assert not (tmp_path / "result").exists()
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / "mine.txt").write_text("mine")
    said: list[str] = []
    with refused("output-foreign"):
        judge(samples, progress=said.append)
    assert not [text for text in said if text.startswith("evaluate:")], "worked before it asked"
    judge(samples, force=True)


def wider(bundle: Bundle) -> ForceModel:
    """The model of a sensor with one more marker."""
    return replace(bundle.model, compliance_px=np.eye(2 * N + 2)[:, ::2])


def test_a_design_gives_heights_and_sides(tmp_path: Path) -> None:
    design = small()
    bundle = replace(TOY, design=design.name, design_hash=design_hash(design))
    save_bundle(bundle, tmp_path / "decoder")
    uv = np.column_stack([np.linspace(1.0, 59.0, N), np.linspace(0.0, 6.2, N)])
    samples = presses(TOY.model, uv, count=50, seed=0, noise_px=0.05)
    write_samples(tmp_path / "data", samples, meta_of(design.name, bundle.design_hash))
    words = ["evaluate", str(tmp_path / "decoder"), str(tmp_path / "data"), "--json"]
    runner = CliRunner()
    alone = runner.invoke(app, words)
    assert alone.exit_code == 0, alone.output
    assert "add --design FILE" in alone.stderr
    assert "along" not in json.loads(alone.stdout)["estimators"]["fem"]
    (tmp_path / "design.toml").write_text(to_toml(small(shape={"length_mm": 62.0})))
    assert "add --design FILE" in runner.invoke(app, words).stderr
    (tmp_path / "design.toml").write_text(to_toml(design))
    found = json.loads(runner.invoke(app, words).stdout)
    assert found["out"] == str(tmp_path / "decoder-evaluation")
    assert len(found["estimators"]["fem"]["along"]) == 10
    assert len(found["estimators"]["fem"]["around"]) == 8
    plain = runner.invoke(app, [*words[:3], "--out", str(tmp_path / "there")])
    assert "koi_inverse" in plain.stdout
    every = {name: own["all"]["all"]["relative_error"] for name, own in found["estimators"].items()}
    best = min(every, key=lambda name: every[name]["value"])
    verdict, after = plain.stdout.splitlines()[-2:]
    assert verdict.startswith(f"best estimator: {best}, ")
    assert f"error {100.0 * every[best]['value']:.2f} % (the published" in verdict
    assert after.startswith(f"next: phytac live {tmp_path / 'decoder'} 0")
    assert "By side" in (tmp_path / "there" / "tables.md").read_text()


def test_evaluation_on_training_data_warns(judge: Callable[..., Path], tmp_path: Path) -> None:
    said: list[str] = []
    judge(toy_samples(), progress=said.append)
    assert not any("was trained on" in text for text in said)
    trained = replace(TOY, notes={"data_sha256": [file_hash(tmp_path / "data-0" / "dataset.json")]})
    save_bundle(trained, tmp_path / "decoder")
    judge(toy_samples(), progress=said.append, force=True)
    assert sum("data-0 is what this decoder was trained on" in text for text in said) == 1


def test_data_whose_samples_are_mostly_flagged_warn(judge: Callable[..., Path]) -> None:
    samples, said = toy_samples(20), []
    few = np.arange(5)
    for count, warned in ((5, False), (6, True)):
        few = np.arange(count)
        flagged = replace(
            samples,
            status=np.where(np.arange(20) < count, FLAGGED, samples.status),
            reasons=("a switch was read as on that no contact of the log presses",),
            reason_sample=few,
            reason_index=np.zeros(count, dtype=np.int64),
        )
        said.clear()
        judge(flagged, progress=said.append, force=True)
        assert any(f"{count} of 20 samples are flagged" in text for text in said) is warned


def test_measured_data_of_a_sensor_without_switches_are_refused(
    judge: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ForceModel, "without_switches", True)
    with refused("evaluation-without-switches"):
        judge(toy_samples(5), metas=(replace(toy_meta(), simulated=False),))
