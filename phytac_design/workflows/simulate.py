"""``phytac simulate``: a scenario on a virtual sensor, as a data set.

Every sample depends on the job and its own number alone: it is solved and seen in any process, in
any order, and stored in a journal. What a killed run had done is not done again, and the data set
is the same, byte for byte, for any number of workers.
"""

import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.sensor_limits import id_list
from phytac_decoder.pipeline.decode import FOUND_WELL
from phytac_design.datasets.samples import STATUSES, THEORIES, Samples, inputs_alone, key_nodes
from phytac_design.datasets.samples_reader import read_samples
from phytac_design.datasets.samples_writer import FILE, FRAMES, TABLE, file_hash, write_samples
from phytac_design.optics.exposure import Exposure
from phytac_design.rules.check import check_design
from phytac_design.simulation.imaging.imaging_model import ImagingModel, RestObservation
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.simulation.run.data_set import data_set_info, gather_samples
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.run.journal import Journal, write_whole
from phytac_design.simulation.run.worker_pool import Crew
from phytac_design.simulation.solver import Solver
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder import untrained_model
from phytac_design.stages.views import MARKS, png_bytes
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import DesignError, InputError, OutputError

IMAGING_STREAM = 7
"""Stream of random numbers of what is seen of a sample."""
PROGRESS_INTERVAL_s = 2.0
"""Seconds between lines of progress."""
FEW_FOUND = "less than 95 % of the markers were found"
LONG_S = 120.0
"""More time left than this is told in minutes."""


@dataclass(frozen=True, kw_only=True)
class SimulationResult:
    """What a run did.

    Attributes
    ----------
    out : Path
        The data set.
    samples, solved : int
        Samples in all, and those solved by this run.
    statuses, theories, reasons : dict of str to int
        Samples of each.
    seconds : float
        Of this run.
    """

    out: Path
    samples: int
    solved: int
    statuses: dict[str, int]
    theories: dict[str, int]
    reasons: dict[str, int]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class ImagingReference:
    """What all workers need to know of how the unit is seen, found once.

    Attributes
    ----------
    views : dict
        What the design's cameras are expected to show.
    compliance_px : (2n, n) float or None
        Tells doubtful switches by their motion, where frames are read and some are doubtful.
    rest : RestObservation or str
        What the unloaded unit shows, or why it cannot be read.
    """

    views: dict[str, Any]
    compliance_px: FloatArray | None
    rest: RestObservation | str


def observe_rest(job: Job, progress: Callable[[str], None]) -> ImagingReference:
    """Look at the unit at rest."""
    progress("simulate: the sensor at rest")
    views = expected_views(job.design, job.surface, job.markers)
    eyes = imaging_model(job, views=views)
    compliance = None
    if job.scenario.solve.route == "frames" and not eyes.nominal.tips.readable.all():
        compliance = force_model_of(job).compliance_px
        eyes = imaging_model(job, views=views, compliance_px=compliance)
    if eyes.status:
        progress(f"warning: this sensor cannot be read: {eyes.status}")
    else:
        lost = np.flatnonzero(~np.isfinite(eyes.at_rest.rest_px[:, 0]))
        if len(lost):
            progress(
                f"warning: {len(lost)} of {job.markers.count} markers ({id_list(lost)}) cannot be "
                "told at rest and are missing in every sample: their images are too small or too "
                "blurred; raise camera.f_number or set eyes.lens_blur = false"
            )
    return ImagingReference(views=views, compliance_px=compliance, rest=eyes.rest)


def imaging_model(job: Job, **known: Any) -> ImagingModel:
    """Eyes of the job's unit."""
    settings = job.scenario.eyes.model_dump()
    if settings["noise_pixel"] is None:
        settings["noise_pixel"] = job.design.camera.noise_pixel
    solve = job.scenario.solve
    return ImagingModel(
        job.design,
        job.surface,
        job.unit,
        exposure=Exposure(**settings),
        centroids=solve.centroids,
        samples=solve.samples_per_pixel,
        **known,
    )


def force_model_of(job: Job) -> ForceModel:
    """Force model of the design, from the build's cache or built now."""
    context = run_stages(
        job.design,
        select_stages(["response"]),
        accuracy=job.accuracy,
        seed=0,
        force=True,
        progress=lambda _: None,
    )[0]
    return untrained_model(context)


class SampleWorker:
    """One process's twin of the sensor: what is dear is made once."""

    def __init__(self, plain: Mapping[str, Any], out: Path, sight: ImagingReference) -> None:
        self.job = job = Job.of(plain)
        self.journal, self.frames = Journal(out), out / FRAMES
        solve = job.scenario.solve
        self.solver = Solver(
            job.design,
            job.surface,
            job.unit,
            refine=job.refine,
            displacement=solve.displacement,
            tolerance=solve.tolerance,
            region=job.plan.region,
            local=solve.local,
        )
        self.eyes = imaging_model(
            job, views=sight.views, compliance_px=sight.compliance_px, at_rest=sight.rest
        )

    def sample(self, index: int) -> dict[str, Any]:
        """Solve and see one sample, and store it; its facts."""
        job, plan = self.job, self.job.plan
        rows = np.flatnonzero(plan.touches.sample == index)
        touches = plan.touches.pick(rows, [index])
        moved = self.solver.solve(touches, plan.felt_N[rows])
        rng = np.random.default_rng([job.seed, IMAGING_STREAM, index])
        facts: dict[str, Any] = {
            "status": moved.status,
            "reasons": [moved.reason] if moved.reason else [],
            "theory": moved.theory,
            "frames": {},
        }
        count = job.markers.count
        arrays = {
            "shift_px": np.full((count, 2), np.nan),
            "bits_read": np.zeros(count, dtype=np.bool_),
        }
        if moved.motion is not None:
            bits, light = plan.switching.bits[index], float(plan.light[index])
            if job.scenario.solve.route == "frames":
                frames = self.eyes.frame(moved.motion, bits, light, rng)
                seen = self.eyes.read(frames)
                if job.keep == "frames":
                    facts["frames"] = self.keep_frames(index, frames)
            else:
                seen = self.eyes.points(moved.motion, bits, light, rng)
            if seen.status:
                facts["status"] = "failed"
                facts["reasons"].append(seen.status)
            else:
                arrays = {"shift_px": seen.shift_px, "bits_read": seen.bits & seen.found}
                if seen.found.mean() < FOUND_WELL and facts["status"] == "ok":
                    facts["status"] = "flagged"
                    facts["reasons"].append(FEW_FOUND)
        try:
            self.journal.put(index, arrays, facts)
        except OSError as error:
            raise _full(self.frames.parent, error) from None
        return facts

    def keep_frames(self, index: int, frames: tuple[ImageArray, ...]) -> dict[str, str]:
        """Write the frames of a sample; their hashes by name."""
        out = {}
        for frame, mark in zip(frames, MARKS, strict=False):
            name = f"{index:06d}{mark}.png"
            data = png_bytes(frame)
            try:
                self.frames.mkdir(exist_ok=True)
                write_whole(self.frames / name, data)
            except OSError as error:
                raise _full(self.frames.parent, error) from None
            out[name] = sha256(data).hexdigest()
        return out


def _full(out: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot write {out}: {error.strerror}; make room, then run the same command again: what "
        "is done stays"
    )


def start(plain: Mapping[str, Any], out: Path, sight: ImagingReference) -> SampleWorker:
    """Make a worker's state."""
    return SampleWorker(plain, out, sight)


def work(worker: SampleWorker, index: int) -> dict[str, Any]:
    """Do one sample."""
    return worker.sample(index)


def simulate(
    job: Job,
    out: Path,
    *,
    workers: int = 2,
    force: bool = False,
    progress: Callable[[str], None] = print,
) -> SimulationResult:
    """Simulate a job into ``out``, going on where an earlier run of the same job ended.

    Parameters
    ----------
    job : Job
        What to simulate.
    out : Path
        The data set's own folder.
    workers : int
        Processes; 0 works in this one. The data do not depend on it.
    force : bool
        Replace another data set, or another job's unfinished one.

    Raises
    ------
    DesignError
        If the design or the scenario cannot be simulated.
    OutputError
        If ``out`` cannot be written, is in use, or holds another data set and ``force`` is not
        set.
    """
    begin = time.perf_counter()
    if workers < 0:
        raise DesignError(f"simulate: workers must not be negative (got {workers})")
    check_design(job.design)
    total = job.plan.touches.samples
    ready = finished_data_set(out, job, force=force)
    if ready is not None:
        progress(f"{out} holds this data set already")
        return _result(out, ready, 0, begin)
    journal = Journal(out)
    with journal.opened(job.key, force=force):
        facts = dict(done_before(journal, out / FRAMES, total))
        before = len(facts)
        if before:
            progress(f"simulate: {before} of {total} samples were done before")
        sight = observe_rest(job, progress) if before < total else None
        crew = Crew(start=start, given=(job.plain(), out, sight), work=work, workers=workers)
        said, first = time.monotonic(), 0.0
        for index, item in crew.run(k for k in range(total) if k not in facts):
            facts[index] = item if item is not None else lost(job, journal, index)
            first = first or time.perf_counter()
            if time.monotonic() - said > PROGRESS_INTERVAL_s or len(facts) == total:
                said = time.monotonic()
                progress(_line(facts, before, total, time.perf_counter() - first))
        samples = gather_samples(job, journal)
        if job.keep == "inputs":
            noise_px = job.design.camera.noise_centroid_px
            rows = key_nodes(force_model_of(job), samples, noise_px=noise_px)
            samples = inputs_alone(samples, rows)
        names = [name for index in range(total) for name in facts[index]["frames"]]
        write_samples(out, samples, data_set_info(job), frames=names)
        journal.drop()
    return _result(out, samples, total - before, begin)


def finished_data_set(out: Path, job: Job, *, force: bool) -> Samples | None:
    """Samples of this very job if they are there whole; makes room for it where ``force`` is set.

    Raises
    ------
    OutputError
        If another data set is there and ``force`` is not set.
    """
    if not (out / TABLE).exists():
        foreign = [name for name in (FILE, FRAMES) if (out / name).exists()]
        if foreign and not force and not (out / JOURNAL_FOLDER).exists():
            raise OutputError(
                f"{out} holds {' and '.join(foreign)} of something else; choose another --out, or "
                "add --force to replace them"
            )
        return None
    try:
        samples, meta = read_samples(out, check_frames=True)
    except InputError as error:
        if not force:
            raise OutputError(
                f"{out} holds a data set that is not whole ({error}); add --force to replace it, "
                "or choose another --out"
            ) from None
    else:
        if meta.hashes.get("job") == job.key:
            return samples
        if not force:
            raise OutputError(
                f"{out} holds another data set ({meta.what}), or one by another version of the "
                "program; add --force to replace it, or choose another --out"
            )
    (out / TABLE).unlink()
    shutil.rmtree(out / FRAMES, ignore_errors=True)
    return None


def done_before(journal: Journal, frames: Path, total: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Facts of samples that an earlier run stored whole, their frames included."""
    for index in range(total):
        found = journal.get(index)
        if found is None:
            continue
        pictures = found[1]["frames"].items()
        if all((frames / n).is_file() and file_hash(frames / n) == h for n, h in pictures):
            yield index, found[1]


def lost(job: Job, journal: Journal, index: int) -> dict[str, Any]:
    """Store a sample whose process died twice."""
    count = job.markers.count
    facts = {
        "status": "failed",
        "reasons": ["its process died (memory?)"],
        "theory": "large",
        "frames": {},
    }
    empty = {"shift_px": np.full((count, 2), np.nan), "bits_read": np.zeros(count, dtype=np.bool_)}
    try:
        journal.put(index, empty, facts)
    except OSError as error:
        raise _full(journal.root.parent, error) from None
    return facts


def _line(facts: Mapping[int, Any], before: int, total: int, seconds: float) -> str:
    """One line of progress."""
    new = len(facts) - before
    left = (total - len(facts)) * seconds / max(new - 1, 1)
    odd = Counter(fact["status"] for fact in facts.values())
    words = [f"{odd[status]} {status}" for status in STATUSES[1:] if odd[status]]
    if new > 1:
        words.append(f"{left / 60.0:.0f} min left" if left > LONG_S else f"{left:.0f} s left")
    return f"simulate: {', '.join([f'{len(facts)} of {total} samples', *words])}"


def _result(out: Path, samples: Samples, solved: int, begin: float) -> SimulationResult:
    return SimulationResult(
        out=out,
        samples=samples.count,
        solved=solved,
        statuses={name: int((samples.status == k).sum()) for k, name in enumerate(STATUSES)},
        theories={name: int((samples.theory == k).sum()) for k, name in enumerate(THEORIES)},
        reasons={
            text: int((samples.reason_index == k).sum()) for k, text in enumerate(samples.reasons)
        },
        seconds=time.perf_counter() - begin,
    )
