"""The benchmark that judges decoders: its data sets, its figures, and what they are beside."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import decoder_data
from benchmarks.decoder_accuracy import UnitDecoder, bench
from benchmarks.decoder_bounds import bounds, noise_of
from benchmarks.decoder_data import DataSetSpec, data_set, job_of, origin, random_subset
from benchmarks.decoder_evaluation import Evaluation, claims_of, train_decoder
from benchmarks.decoder_rows import (
    ALL,
    MAE,
    RELATIVE,
    TARGETS,
    add_bounds,
    add_claims,
    add_scores,
    add_switches,
    add_tenths,
)
from benchmarks.decoder_shapes import add_rows_cycles
from benchmarks.harness import Table
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.datasets.samples_file import write_samples
from phytac_design.design.spec import Design
from phytac_design.simulation.cramer_rao import cell_prior
from phytac_design.simulation.run.job import Job, data_set_info
from tests.designs import CAMERA, small
from tests.made_up import at, found_of
from tests.refusals import refused

LINEAR: dict[str, object] = {"displacement": "linear"}


def sensor() -> Design:
    """Fifty markers before a small camera."""
    layout = {"rows": 5, "columns": 10, "height_far_mm": 4.0}
    return small(shape={"length_mm": 40.0}, layout=layout, camera=CAMERA)


def job(**changes: object) -> Job:
    """A few draft samples of the small sensor's first print."""
    given = {"unit": 1, "samples": 20, "accuracy": "draft", "solve": LINEAR} | changes
    return job_of(sensor(), **given)  # type: ignore[arg-type]  # each test changes what it tests


@pytest.fixture(scope="module")
def here(own_cache: None, tmp_path_factory: pytest.TempPathFactory) -> UnitDecoder:
    """The small sensor with a dozen samples to learn from."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PHYTAC_DATA", str(tmp_path_factory.mktemp("data")))
        return bench(DataSetSpec(name="small", job=job(), train=12))


@pytest.fixture(scope="module")
def judged(here: UnitDecoder) -> Evaluation:
    """A decoder that learnt from them, judged on the others."""
    bundle, facts = train_decoder(here.context, here.plain, here.train)
    assert set(facts) == {"mechanics", "fem_nn", "fem_nn_identity", "auto"}
    # The shell was at hand: a dozen samples may show its thickness, or not.
    assert facts["auto"]["wall"] != {"even": "not fitted"}
    return here.judged(bundle)


def made_up(this: Job) -> Samples:
    """Samples with nothing in them."""
    count, n = 3, this.markers.count
    return Samples(
        markers=n,
        time_s=np.arange(3.0),
        sequence=np.arange(3),
        light=np.ones(3),
        status=np.zeros(3, dtype=np.int64),
        theory=np.ones(3, dtype=np.int64),
        total_N=np.zeros(3),
        contacts=np.zeros(3, dtype=np.int64),
        bits=np.zeros((count, n), dtype=np.bool_),
        bits_read=np.zeros((count, n), dtype=np.bool_),
        shift_px=np.zeros((count, n, 2)),
    )


def test_data_sets_are_made_once_and_used_again_whoever_made_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def simulate(this: Job, out: Path, *, workers: int) -> None:
        calls.append(workers)
        out.mkdir(parents=True)
        meta = data_set_info(this)
        old = {**meta.hashes, "program": "0" * 64, "job": "0" * 64}
        write_samples(out, made_up(this), replace(meta, hashes=old))

    monkeypatch.setattr(decoder_data, "simulate", simulate)
    monkeypatch.setenv("PHYTAC_DATA", str(tmp_path))
    for _ in range(2):
        samples, meta = data_set("a", job())
        assert samples.count == 3
    assert calls == [0]
    assert "the program as it was then (00000000)" in origin("a", meta)
    assert (tmp_path / "a").is_dir()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"unit": 2}, "scenario"),
        ({"samples": 21}, "scenario"),
        ({"route": "frames"}, "scenario"),
        ({"accuracy": "standard"}, "accuracy"),
    ],
)
def test_another_data_set_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, object], word: str
) -> None:
    monkeypatch.setenv("PHYTAC_DATA", str(tmp_path))
    write_samples(_new(tmp_path / "a"), made_up(job()), data_set_info(job(**change)))
    with refused("output-foreign") as caught:
        data_set("a", job())
    caught.match(f"another data set.*other {word}.*PHYTAC_DATA")


def test_another_seed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHYTAC_DATA", str(tmp_path))
    write_samples(_new(tmp_path / "a"), made_up(job()), replace(data_set_info(job()), seed=2))
    with refused("output-foreign"):
        data_set("a", job())


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


@pytest.mark.long
def test_parts_share_no_sample(here: UnitDecoder) -> None:
    times = [set(part.samples.time_s.tolist()) for part in (here.train, here.test)]
    assert len(times[0]) == 12
    assert len(times[1]) == 8
    assert not times[0] & times[1]
    few, more = random_subset(here.train, 4, seed=0), random_subset(here.train, 7, seed=0)
    assert set(few.samples.time_s) < set(more.samples.time_s) < times[0]


@pytest.mark.long
def test_figures_are_those_of_the_forces(judged: Evaluation) -> None:
    """Mean relative and absolute error, summed up here one contact after the other."""
    samples, model_forces = judged.data.samples, judged.decoded.decoded_N["koi_inverse"]
    assert samples.truth is not None
    assert samples.touches is not None
    mine = []
    for row, touch in enumerate(judged.decoded.touch):
        of_touch = samples.truth.touch == touch
        if of_touch.any():
            true = samples.truth.force_N[of_touch].sum()
            mine.append((abs(model_forces[row] - true), true))
    error, force = np.array(mine).T
    table = Table("x")
    add_scores(table, "here", judged, [(ALL, RELATIVE), (ALL, MAE)], targets=TARGETS)
    rows = {row["case"]: row for row in table.rows}
    head = f"here: koi_inverse, all heights ({len(mine)} contacts)"
    relative = rows[f"{head}: mean relative error"]["value"]
    assert relative == pytest.approx(100.0 * np.mean(error / force))
    assert rows[f"{head}: mean absolute error"]["value"] == pytest.approx(error.mean())
    fem = rows[f"here: fem, all heights ({len(mine)} contacts): mean relative error"]
    assert fem["reference"] == 18.0
    assert "95 %" in fem["note"]


def test_the_worst_tenth_is_reported(judged: Evaluation) -> None:
    decoded = judged.decoded
    low = judged.groups["along"][next(iter(judged.groups["along"]))]
    wrong = decoded.force_N * np.where(low, 1.5, 1.01)
    table = Table("x")
    add_tenths(table, "here", replace(judged, decoded=replace(decoded, decoded_N={"auto": wrong})))
    assert table.rows[0]["value"] == pytest.approx(50.0)
    assert "50 (sign +50" in table.rows[0]["note"]


def test_what_misses_says_what_the_bound_allows(judged: Evaluation) -> None:
    table = Table("x")
    every = {(ALL, RELATIVE): {"auto": "<= 0", "koi_inverse": "<= 1e9"}}
    add_scores(table, "here", judged, [(ALL, RELATIVE)], targets=every)
    rows = {row["case"].split(", ")[0]: row for row in table.rows}
    assert not rows["here: auto"]["holds"]
    assert "the bound allows" in rows["here: auto"]["note"]
    assert rows["here: koi_inverse"]["holds"]
    assert "bound" not in rows["here: koi_inverse"]["note"]
    assert "holds" not in rows["here: fem"]


def test_a_perfect_decoder_has_no_error_and_is_below_the_bound(judged: Evaluation) -> None:
    truth = dict.fromkeys(judged.decoded.decoded_N, judged.decoded.force_N)
    perfect = replace(judged, decoded=replace(judged.decoded, decoded_N=truth))
    table = Table("x")
    add_scores(table, "here", perfect, [(ALL, RELATIVE)])
    add_bounds(table, "here", perfect, target="<= 1.5")
    ratios = [row["value"] for row in table.rows if "over the RMS" in row["case"]]
    assert [row["value"] for row in table.rows[: len(truth)]] == [0.0] * len(truth)
    assert len(ratios) >= 2
    assert not any(ratios)
    add_bounds(table, "here", judged, target="<= 1.5")
    assert [row["value"] for row in table.rows if "over the RMS" in row["case"]][-1] > 0.0


def test_bound_is_the_designs_own_and_grows_with_company(judged: Evaluation) -> None:
    """Alone it is that of ``twin.bound``; other unknown contacts can only make it worse."""
    samples, context = judged.data.samples, judged.context
    noise = np.full((samples.markers, 2), 0.03)
    found = bounds(context, samples, noise)
    rows = judged.decoded.touch[judged.decoded.tripped]
    assert np.isfinite(found.force_N[rows]).all()
    assert np.isnan(found.force_N[judged.decoded.touch[~judged.decoded.tripped]]).all()
    assert np.all(found.force_N[rows] >= found.alone_N[rows] * (1.0 - 1e-9))
    assert samples.touches is not None
    alone = rows[samples.contacts[samples.touches.sample[rows]] == 1]
    np.testing.assert_allclose(found.force_N[alone], found.alone_N[alone])
    twice = bounds(context, samples, 2.0 * noise)
    assert np.all(twice.alone_N[rows] > found.alone_N[rows])
    # By hand for one: two columns of the same information matrix.
    from benchmarks.decoder_bounds import _signals, camera_motion

    chosen = np.isin(np.arange(len(samples.touches.sample)), alone)
    training = context.design.training
    prior = cell_prior(
        context.surface.area_mm2(),
        context.markers.count,
        training.patch_radius_min_mm,
        training.patch_radius_max_mm,
    )
    signals = _signals(context, samples, chosen)
    direct = signals.bound(
        samples.touches.force_N[chosen],
        noise_px=0.03,
        prior=prior,
        motion=camera_motion(context),
    )
    np.testing.assert_allclose(found.force_N[chosen], direct.force_N, rtol=1e-6)


def test_claims_are_matched_by_switch_and_by_place(judged: Evaluation) -> None:
    """Found well, outside its interval, by nobody, with another; and one that is not there."""
    samples = judged.data.samples
    touches, truth = samples.touches, samples.truth
    assert touches is not None
    assert truth is not None
    shift = np.zeros(2 * samples.markers)
    found: list[ContactDetection | None] = [None] * samples.count
    read = 0
    for sample in range(samples.count):
        own = truth.sample == sample
        contacts = []
        for touch in np.unique(truth.touch[own]):
            markers = truth.marker[own & (truth.touch == touch)].tolist()
            force = float(truth.force_N[own & (truth.touch == touch)].sum())
            contacts.append(at(touches.point_mm[touch], markers, force + 1.6 * (-1.0) ** read))
            read += 1
        found[sample] = found_of(*contacts, shift_px=shift)
    fair = claims_of(found, samples)
    assert len(fair.touch) == read
    assert fair.unmatched == 0
    assert fair.covered == 1.0
    several, first = next((k, f) for k, f in enumerate(found) if f and len(f.contacts) > 1)
    one = first.contacts[0]

    def but(changed: ContactDetection) -> list[ContactDetection | None]:
        return [*found[:several], changed, *found[several + 1 :]]

    far = replace(one, force_N=one.force_N + 100.0)
    moved = replace(first, contacts=[far, *first.contacts[1:]])
    assert claims_of(but(moved), samples).covered == pytest.approx(1 - 1 / read)
    # Its switches claimed by nobody; and one by motion alone, far from all.
    nobody = at(np.array([0.0, 0.0, 1e3]), [], 3.0)
    lost = replace(first, contacts=[*first.contacts[1:], nobody])
    claims = claims_of(but(lost), samples)
    assert claims.unmatched == 1
    assert claims.nothing_N.tolist() == [3.0]
    assert claims.nothing_mm[0] > 100.0
    assert (claims.claimed_silent, claims.found_silent) == (1, 0)
    merged = replace(one, markers=np.concatenate([c.markers for c in first.contacts]))
    together = claims_of(but(replace(first, contacts=[merged])), samples)
    assert together.unmatched == len(first.contacts)


def test_contacts_found_by_motion_alone_count_where_one_was_pressed(judged: Evaluation) -> None:
    """A contact whose switches are struck out of the truth counts as found where it was pressed."""
    samples = judged.data.samples
    assert samples.touches is not None
    assert samples.truth is not None
    truth = samples.truth
    tripped = np.isin(np.arange(len(samples.touches.sample)), truth.touch)
    count = np.bincount(samples.touches.sample, weights=tripped, minlength=samples.count)
    several = int(np.flatnonzero((count > 1) & (count == samples.contacts))[0])
    gone, stays = np.flatnonzero(samples.touches.sample == several)[:2]
    keep = truth.touch != gone
    names = ("sample", "marker", "force_N", "touch")
    without = replace(
        samples, truth=replace(truth, **{name: getattr(truth, name)[keep] for name in names})
    )
    found: list[ContactDetection | None] = [None] * samples.count
    point = samples.touches.point_mm
    aside = point[gone] + np.array([0.0, 0.0, 2.0])
    found[several] = found_of(
        at(aside, [], 2.0), at(point[stays] + 9.0, [], 5.0), shift_px=np.zeros(2 * samples.markers)
    )
    claims = claims_of(found, without)
    assert (claims.pressed_silent, claims.found_silent, claims.claimed_silent) == (1, 1, 2)
    assert claims.nothing_N.tolist() == [5.0]


def test_noise_is_that_of_markers_that_are_left_alone(judged: Evaluation) -> None:
    n, count = 6, 200
    rng = np.random.default_rng(0)
    sigma = np.array([0.02, 0.02, 0.05, 0.05, 0.1, 0.1])[:, None]
    explained = np.zeros((count, n, 2))
    explained[:, 0] = 3.0
    shift = explained + sigma * rng.normal(size=(count, n, 2))
    # What moves is explained badly, and must not count.
    shift[:, 0] += 5.0
    samples = replace(judged.data.samples, shift_px=shift, markers=n)
    found = [found_of(shift_px=row.ravel()) for row in explained]
    noise = noise_of([*found], samples)
    np.testing.assert_allclose(noise[1:], np.broadcast_to(sigma[1:], (n - 1, 2)), rtol=0.2)
    assert np.all(noise[0] < 0.11)


def test_rows_of_switches_and_intervals(judged: Evaluation) -> None:
    table = Table("x")
    read = judged.data.samples.bits_read
    assert read is not None
    add_switches(table, "here", judged)
    decoded = judged.decoded
    worse = replace(decoded, missed=decoded.on // 2, false=decoded.off // 50)
    add_switches(table, "here", replace(judged, decoded=worse))
    assert [row["holds"] for row in table.rows] == [True, True, False, False]
    assert table.rows[2]["value"] == pytest.approx(100.0 * (1.0 - worse.missed / decoded.on))
    size = len(judged.claims.truth_N)
    wide = replace(judged.claims, sd_N=np.full(size, 1e3))
    add_claims(table, "here", wide, target=True)
    row = next(row for row in table.rows if "90 % intervals" in row["case"])
    assert row["value"] == pytest.approx(10.0)
    assert not row["holds"]


def test_failed_samples_are_in_no_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: UnitDecoder
) -> None:
    samples = here.train.samples
    status = samples.status.copy()
    status[3] = FAILED
    bad = replace(
        samples,
        status=status,
        reasons=("broken",),
        reason_sample=np.array([3]),
        reason_index=np.array([0]),
    )
    monkeypatch.setenv("PHYTAC_DATA", str(tmp_path))
    write_samples(_new(tmp_path / "b"), bad, here.train.meta)
    train, test = DataSetSpec(name="b", job=here.case.job, train=5).parts()
    assert train.samples.count == 5
    assert test.samples.count == samples.count - 6
    assert samples.time_s[3] not in [*train.samples.time_s, *test.samples.time_s]


@pytest.mark.long
def test_cycles_part_runs_and_reads_nothing_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, here: UnitDecoder
) -> None:
    """Its quick form, on the small sensor at hand."""
    monkeypatch.setenv("PHYTAC_DATA", str(tmp_path))
    monkeypatch.setattr("benchmarks.decoder_shapes.bench", lambda _: here)
    monkeypatch.setattr("benchmarks.decoder_data.small_design", sensor)
    table = Table("x")
    add_rows_cycles(table, quick=True)
    rest = next(row for row in table.rows if "at rest" in row["case"])
    assert "2 rests" in rest["case"]
    assert rest["holds"]
    assert rest["value"] == 0.0
    drifts = [row["value"] for row in table.rows if "drift" in row["case"]]
    # The wall creeps: the same force is read as more.
    assert len(drifts) == 5
    assert 0.2 < max(drifts) < 8.0
