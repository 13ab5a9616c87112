"""``phytac simulate``: a scenario on a virtual sensor, as a data set.

Every sample depends on the job and its own number alone: it is solved and seen in any process, in
any order, and stored in a journal. What a killed run had done is not done again, and the data set
is the same, byte for byte, for any number of workers.
"""

import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.sensor_limits import id_list
from phytac_decoder.pipeline.decode import FOUND_WELL
from phytac_design.core.journal import Journal, write_atomically
from phytac_design.core.workers import WorkerPool
from phytac_design.datasets.samples import (
    STATUSES,
    THEORIES,
    DataSetInfo,
    Samples,
    inputs_alone,
    key_nodes,
    rest_note,
)
from phytac_design.datasets.samples_file import (
    FRAMES,
    TABLE,
    file_hash,
    read_samples,
    write_samples,
)
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import Exposure
from phytac_design.rules.check import check_design
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES, encode_png
from phytac_design.simulation.imaging.imaging_model import ImagingModel, RestObservation
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.simulation.run.job import Job, data_set_info, gather_samples
from phytac_design.simulation.solver import Solver
from phytac_design.simulation.switch_law import switch_law
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder_stage import untrained_model
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import DesignError, InputError, OutputError

JOURNAL_FOLDER = ".work"
"""Folder of finished samples inside the data set's; removed when the data set is complete."""
TRUTH = "truth.csv"
"""Forces that kept frames were rendered with, for people to read."""
PROGRESS_INTERVAL_s = 2.0
"""Seconds between lines of progress."""


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
    """What all workers need to know of how the sensor is imaged, found once.

    Attributes
    ----------
    views : dict
        What the design's cameras are expected to show.
    compliance_px : (2n, n) float or None
        Confirms doubtful switches by their motion, where frames are read and some are doubtful.
    rest : RestObservation or str
        What the unloaded sensor shows, or why it cannot be read.
    """

    views: dict[str, Any]
    compliance_px: FloatArray | None
    rest: RestObservation | str


def observe_rest(job: Job, progress: Callable[[str], None]) -> ImagingReference:
    """Observe the sensor at rest."""
    law = switch_law(job.design, job.markers, progress)
    if law.refused:
        progress(f"warning: tips are simulated as those of bowls that snap: {law.refused}")
    progress("simulate: the sensor at rest")
    views = expected_views(Sensor.of(job.design, job.surface, job.markers))
    imaging = imaging_model(job, views=views)
    compliance = None
    if job.scenario.solve.route == "frames" and not imaging.nominal.tips.readable.all():
        compliance = force_model_of(job).compliance_px
        imaging = imaging_model(job, views=views, compliance_px=compliance)
    if imaging.status:
        progress(f"warning: this sensor cannot be read: {imaging.status}")
    else:
        lost = np.flatnonzero(~np.isfinite(imaging.at_rest.rest_px[:, 0]))
        if len(lost):
            progress(
                f"warning: {len(lost)} of {job.markers.count} markers ({id_list(lost)}) cannot be "
                "identified at rest and are missing in every sample: their images are too small or "
                "too blurred; raise camera.f_number or set imaging.lens_blur = false"
            )
    return ImagingReference(views=views, compliance_px=compliance, rest=imaging.rest)


def imaging_model(job: Job, **known: Any) -> ImagingModel:
    """Imaging model of the job's sensor instance."""
    settings = job.scenario.imaging.model_dump()
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
    """Simulation of one process; what is expensive is made once."""

    def __init__(self, plain: Mapping[str, Any], out: Path, sight: ImagingReference) -> None:
        self.job = job = Job.of(plain)
        self.journal, self.frames = Journal(out / JOURNAL_FOLDER), out / FRAMES
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
            markers=job.markers,
        )
        self.imaging = imaging_model(
            job, views=sight.views, compliance_px=sight.compliance_px, at_rest=sight.rest
        )

    def sample(self, index: int) -> dict[str, Any]:
        """Solve and see one sample, and store it; its facts."""
        job, plan = self.job, self.job.plan
        rows = np.flatnonzero(plan.touches.sample == index)
        touches = plan.touches.pick(rows, [index])
        moved = self.solver.solve(touches, plan.felt_N[rows])
        # Stream 7 of random numbers is that of what is seen of a sample.
        rng = np.random.default_rng([job.seed, 7, index])
        facts: dict[str, Any] = {
            "status": moved.status,
            "reasons": [moved.reason] if moved.reason else [],
            "theory": moved.theory,
            "frames": {},
        }
        arrays = nothing_seen(job)
        if moved.motion is not None:
            bits, light = plan.switching.bits[index], float(plan.light[index])
            if job.scenario.solve.route == "frames":
                frames = self.imaging.frame(moved.motion, plan.switching.shown[index], light, rng)
                seen = self.imaging.read(frames)
                if job.keep == "frames":
                    facts["frames"] = self.write_frames(index, frames)
            else:
                out = None if plan.switching.out is None else plan.switching.out[index]
                seen = self.imaging.points(moved.motion, bits, light, rng, out=out)
            if seen.status:
                facts["status"] = "failed"
                facts["reasons"].append(seen.status)
            else:
                arrays = {"shift_px": seen.shift_px, "bits_read": seen.bits & seen.found}
                if seen.found.mean() < FOUND_WELL and facts["status"] == "ok":
                    facts["status"] = "flagged"
                    facts["reasons"].append("less than 95 % of the markers were found")
        with writing(self.frames.parent):
            self.journal.put(str(index), facts, arrays)
        return facts

    def write_frames(self, index: int, frames: tuple[ImageArray, ...]) -> dict[str, str]:
        """Write the frames of a sample; their hashes by name."""
        out = {}
        for frame, mark in zip(frames, CAMERA_SUFFIXES, strict=False):
            name = f"{index:06d}{mark}.png"
            data = encode_png(frame)
            with writing(self.frames.parent):
                self.frames.mkdir(exist_ok=True)
                write_atomically(self.frames / name, data)
            out[name] = sha256(data).hexdigest()
        return out


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Report an error of the disk with what to do about it."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            "output-not-writable",
            f"cannot write {out}: {error.strerror}; make room, then run the same command again: "
            "what is done stays",
        ) from None


def nothing_seen(job: Job) -> dict[str, Any]:
    """Arrays of a sample of which nothing could be seen."""
    count = job.markers.count
    return {
        "shift_px": np.full((count, 2), np.nan),
        "bits_read": np.zeros(count, dtype=np.bool_),
    }


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
    """Simulate a job into ``out``, resuming an earlier run of the same job.

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
        raise DesignError(
            "workers-negative", f"simulate: workers must not be negative (got {workers})"
        )
    check_design(job.design)
    total = job.plan.touches.samples
    ready = finished_data_set(out, job, force=force)
    if ready is not None:
        progress(f"{out} holds this data set already")
        return _result(out, ready, 0, begin)
    journal = Journal(out / JOURNAL_FOLDER)
    with journal.opened(job.key, force=force):
        facts = dict(done_before(journal, out / FRAMES, total))
        before = len(facts)
        if before:
            progress(f"simulate: {before} of {total} samples were done before")
        sight = observe_rest(job, progress)
        if job.keep == "frames":
            write_rest(out, job, sight)
        given = (job.plain(), out, sight)
        said, first = time.monotonic(), 0.0
        missing = [index for index in range(total) if index not in facts]
        with WorkerPool(work, workers=workers, start=SampleWorker, arguments=given) as pool:
            for result in pool.run(missing):
                index = missing[result.index]
                facts[index] = store_lost(job, journal, index) if result.lost else result.value
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
        if job.keep == "frames":
            with writing(out):
                write_truth(out / TRUTH, samples)
        write_samples(out, samples, _info(job, sight), frames=names)
        journal.drop()
    return _result(out, samples, total - before, begin)


def write_rest(out: Path, job: Job, sight: ImagingReference) -> None:
    """Write the frame of the unloaded sensor, one a camera, for decoders that read the others."""
    imaging = imaging_model(
        job, views=sight.views, compliance_px=sight.compliance_px, at_rest=sight.rest
    )
    count = job.markers.count
    rng = np.random.default_rng([job.seed, job.plan.touches.samples])
    still, off = np.zeros((count, 6)), np.zeros(count, dtype=np.bool_)
    for frame, mark in zip(imaging.frame(still, off, 1.0, rng), CAMERA_SUFFIXES, strict=False):
        with writing(out):
            write_atomically(out / f"rest{mark}.png", encode_png(frame))


def write_truth(path: Path, samples: Samples) -> None:
    """Write the contacts of every frame as CSV; an unloaded frame has one row, with force 0.

    Frames are named by the start of their file's name, which of two cameras is the same.
    """
    lines = ["frame,force_N,x_mm,y_mm,z_mm"]
    touches = samples.touches
    for sample in range(samples.count):
        own = (
            np.zeros(0, dtype=int) if touches is None else np.flatnonzero(touches.sample == sample)
        )
        if touches is None or not len(own):
            lines.append(f"{sample:06d},0,,,")
            continue
        lines.extend(
            f"{sample:06d},{touches.force_N[k]:.4f},"
            + ",".join(f"{x:.3f}" for x in touches.point_mm[k])
            for k in own
        )
    write_atomically(path, ("\n".join(lines) + "\n").encode())


def _info(job: Job, sight: ImagingReference) -> DataSetInfo:
    """What the data set is, with the rest positions of its print where they can be read."""
    info = data_set_info(job)
    if isinstance(sight.rest, str):
        return info
    return replace(info, notes=info.notes | rest_note(sight.rest.rest_px))


def finished_data_set(out: Path, job: Job, *, force: bool) -> Samples | None:
    """Samples of this very job if they are there whole; makes room for it where ``force`` is set.

    Raises
    ------
    OutputError
        If another data set is there and ``force`` is not set.
    """
    if not (out / TABLE).exists():
        other = out.is_dir() and any(out.iterdir()) and not (out / JOURNAL_FOLDER).exists()
        if other and not force:
            raise OutputError(
                "output-foreign",
                f"{out} is not empty and holds no data set; choose another --out, or add --force "
                "to replace files of the same names",
            )
        return None
    try:
        samples, meta = read_samples(out, check_frames=True)
    except InputError as error:
        if not force:
            raise OutputError(
                "output-foreign",
                f"{out} holds a data set that is not whole ({error}); add --force to replace it, "
                "or choose another --out",
            ) from None
    else:
        if meta.hashes.get("job") == job.key:
            return samples
        if not force:
            raise OutputError(
                "output-foreign",
                f"{out} holds another data set ({meta.what}), or one by another version of the "
                "program; add --force to replace it, or choose another --out",
            )
    (out / TABLE).unlink()
    shutil.rmtree(out / FRAMES, ignore_errors=True)
    return None


def done_before(journal: Journal, frames: Path, total: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Facts of samples that an earlier run stored whole, their frames included."""
    for index in range(total):
        found = journal.get(str(index))
        if found is None:
            continue
        pictures = found[0]["frames"].items()
        if all((frames / n).is_file() and file_hash(frames / n) == h for n, h in pictures):
            yield index, found[0]


def store_lost(job: Job, journal: Journal, index: int) -> dict[str, Any]:
    """Store a sample whose process died twice."""
    facts = {
        "status": "failed",
        "reasons": ["its process died (memory?)"],
        "theory": "large",
        "frames": {},
    }
    with writing(journal.folder.parent):
        journal.put(str(index), facts, nothing_seen(job))
    return facts


def _line(facts: Mapping[int, Any], before: int, total: int, seconds: float) -> str:
    """One line of progress."""
    new = len(facts) - before
    left = (total - len(facts)) * seconds / max(new - 1, 1)
    odd = Counter(fact["status"] for fact in facts.values())
    words = [f"{odd[status]} {status}" for status in STATUSES[1:] if odd[status]]
    if new > 1:
        words.append(f"{left / 60.0:.0f} min left" if left > 120.0 else f"{left:.0f} s left")
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
