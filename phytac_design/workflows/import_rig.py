"""``phytac import``: the log and the pictures of a user's rig, as a data set."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.camera.lens import Lens
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_design.datasets.samples import (
    DataSetInfo,
    Samples,
    inputs_alone,
    key_nodes,
    rest_note,
)
from phytac_design.datasets.samples_file import FRAMES, file_hash, write_samples
from phytac_design.design.camera_files import read_lens
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES, encode_png
from phytac_design.simulation.rig_import.rig_contacts import contacts_of, sequences_of
from phytac_design.simulation.rig_import.rig_frames import (
    FrameFolder,
    FrameSource,
    match_frames,
    open_source,
)
from phytac_design.simulation.rig_import.rig_log import RigLog, RowProblems, read_rig_log
from phytac_design.simulation.rig_import.rig_samples import (
    RigSetup,
    measure_samples,
    rest_positions_of,
    samples_of,
)
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.bounded_reader import doubt_about_end
from phytac_shapes.errors import InputError, OutputError


@dataclass(frozen=True, kw_only=True)
class ImportLimits:
    """Limits of warnings and refusals."""

    lens_warn_px: float = 1.0
    lens_share_max: float = 0.02
    """Largest difference of a calibrated lens from the design's, over the image's half diagonal."""
    lens_grid: int = 21
    pause_intervals: float = 20.0
    """Pauses of this many usual intervals are reported."""


LIMITS = ImportLimits()

KEEPS = ("inputs", "points", "frames")


@dataclass(frozen=True, kw_only=True)
class ImportSettings:
    """How to read a rig's files.

    Attributes
    ----------
    off_mm : float
        Farthest that a contact may lie off the wall.
    tolerance_s, offset_s, fps : float or None
        Largest difference of times; seconds to add to the log's clock; pictures per second.
    radius_mm : float or None
        Of contacts whose radius the log does not say; the middle of the design's if not given.
    keep : str
        One of ``KEEPS``.
    skip_bad : bool
        Leave samples with problems out instead of refusing.
    """

    off_mm: float = 2.0
    tolerance_s: float | None = None
    offset_s: float = 0.0
    fps: float | None = None
    radius_mm: float | None = None
    keep: str = "points"
    skip_bad: bool = False


@dataclass(frozen=True, kw_only=True)
class ImportResult:
    """What became of a log.

    Attributes
    ----------
    samples : Samples
        All that was kept.
    meta : Meta
        What it is.
    problems : Problems
        Of the samples that were left out.
    left_out : int
        How many those are.
    """

    samples: Samples
    meta: DataSetInfo
    problems: RowProblems
    left_out: int


def import_rig(
    design: Design,
    log_path: Path,
    *,
    frames: Sequence[Path],
    bundle: Path,
    out: Path,
    rest: Sequence[str] = (),
    cameras: Sequence[Path] = (),
    settings: ImportSettings | None = None,
    progress: Callable[[str], None] = print,
) -> ImportResult:
    """Read a rig's log and pictures, check them, and write them as a data set.

    Parameters
    ----------
    design : Design
        Of the sensor on the rig.
    log_path : Path
        CSV of contacts.
    frames : sequence of Path
        Folder of images, or video, of each camera; the near end's first.
    bundle : Path
        Folder of the design's decoder.
    out : Path
        Folder to make; it appears whole or not at all.
    rest : sequence of str
        Picture of the unloaded sensor for each camera: the name or number of one of its frames,
        or a file.
    cameras : sequence of Path
        Lens calibration of each camera, to compare with the design's.
    settings : Settings, optional
        How to read them.
    progress : callable
        Called with each line of progress.

    Raises
    ------
    InputError
        If a file is not usable; all problems of its rows, then of its pictures, in one error.
    OutputError
        If ``out`` is there already, or cannot be written.
    """
    chosen, out = settings or ImportSettings(), out.resolve()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(
            "output-exists", f"{out} is there already; choose another folder or remove it"
        )
    rig = _rig(design, bundle, frames, chosen)
    notes: dict[str, Any] = {"settings": asdict(chosen)}
    notes["lenses"] = _check_lenses(rig.bundle, cameras, progress)
    problems = RowProblems(where=str(log_path))
    log = read_rig_log(log_path, problems)
    doubt = doubt_about_end(log_path)
    if doubt:
        progress(f"warning: {doubt}")
    training = design.training
    radius_mm = chosen.radius_mm
    if radius_mm is None:
        radius_mm = 0.5 * (training.patch_radius_min_mm + training.patch_radius_max_mm)
    if "radius_mm" not in log.numbers:
        notes["radius_assumed_mm"] = radius_mm
    touches = contacts_of(
        log,
        Sensor.of(design, rig.surface, rig.markers),
        off_mm=chosen.off_mm,
        radius_mm=radius_mm,
    )
    clock: dict[str, Any] = {"offset_s": chosen.offset_s, "tolerance_s": chosen.tolerance_s}
    numbers = np.stack([match_frames(log, source, **clock) for source in rig.sources])
    times = _times(log, rig.sources[0], numbers[0], notes)
    if not chosen.skip_bad:
        problems.raise_all()
    rest_px = rest_positions_of(rig, list(rest), progress)
    sound = np.setdiff1d(np.arange(log.samples), problems.samples)
    seen = measure_samples(rig, log, numbers, sound, rest_px, progress)
    if not chosen.skip_bad:
        problems.raise_all()
    if not seen:
        raise InputError("rig-no-usable-samples", f"no sample is usable: {problems.text()}")
    samples = _kept(rig, log, touches, seen, times, notes)
    for doubt in notes["doubts"]:
        progress(f"warning: {doubt}")
    notes |= {
        "left_out": log.samples - samples.count,
        "log": log_path.name,
        "log_says": list(log.remarks),
        "rest": [Path(text).name for text in rest],
        **({} if rest_px is None else rest_note(rest_px)),
    }
    meta = DataSetInfo(
        simulated=False,
        what=f"measured: {samples.count} samples of a rig with {design.name}",
        design=design.name,
        design_hash=design_hash(design),
        route="camera",
        hashes={"log": file_hash(log_path), "bundle": file_hash(bundle / "bundle.safetensors")},
        notes=notes,
    )
    if chosen.keep == "inputs":
        model, noise_px = rig.bundle.model, rig.bundle.noise_centroid_px
        notes["stiffness_size_N_mm"] = model.stiffness_size_N_mm
        rows = key_nodes(model, samples, noise_px=noise_px)
        samples = inputs_alone(samples, rows)
    pictures = numbers[:, sorted(seen)] if chosen.keep == "frames" else numbers[:, :0]
    meta = _write(rig.sources, out, samples, meta, pictures)
    left_out = log.samples - samples.count
    return ImportResult(samples=samples, meta=meta, problems=problems, left_out=left_out)


def _rig(design: Design, bundle: Path, frames: Sequence[Path], chosen: ImportSettings) -> RigSetup:
    """Sensor, decoder and pictures, if they are of one another."""
    if chosen.keep not in KEEPS:
        raise InputError(
            "rig-keep-unknown", f"keep must be one of {', '.join(KEEPS)} (got {chosen.keep!r})"
        )
    decoder = load_bundle(bundle)
    if decoder.design_hash != design_hash(design):
        raise InputError(
            "decoder-of-other-design",
            f"the decoder in {bundle} was built for another state of the design "
            f"{decoder.design!r}; build {design.name!r} again, or name the design it was "
            "built from",
        )
    if len(frames) != len(decoder.cameras):
        raise InputError(
            "camera-count",
            f"the sensor {design.name!r} has {len(decoder.cameras)} cameras (got {len(frames)} "
            "folders or videos); give --frames once for each, the near end's first",
        )
    surface = design.surface()
    return RigSetup(
        design=design,
        surface=surface,
        markers=make_markers(design, surface),
        bundle=decoder,
        sources=tuple(open_source(where, fps=chosen.fps) for where in frames),
    )


def _times(log: RigLog, source: FrameSource, number: IntArray, notes: dict[str, Any]) -> FloatArray:
    """When each sample was taken, (s,): by the log's clock, the pictures', or their order."""
    notes["clock"] = "log"
    times = log.time_s
    if times is None and source.time_s is not None:
        times = np.where(number >= 0, source.time_s[number], np.nan)
        notes["clock"] = "frames"
    if times is None:
        notes["clock"] = "none: frames are counted"
        return number.astype(np.float64)
    latest = np.fmax.accumulate(np.concatenate([[-np.inf], times[:-1]]))
    log.problems.add_rows(
        (times <= latest) & (number >= 0),
        np.arange(len(times)),
        log.first_line,
        lambda k: (
            f"its time {times[k]:.6g} s is not after {latest[k]:.6g} s of a sample before; put "
            "samples in the order of time"
        ),
    )
    return times


def _kept(
    rig: RigSetup,
    log: RigLog,
    touches: Contacts,
    seen: Mapping[int, FrameMeasurement],
    times: FloatArray,
    notes: dict[str, Any],
) -> Samples:
    """Samples that were seen, renumbered; doubts go to ``notes``."""
    good = np.array(sorted(seen), dtype=np.int64)
    touches = touches.pick(np.flatnonzero(np.isin(touches.sample, good)), good)
    first = np.unique(log.sample, return_index=True)[1][good]
    given = log.numbers["sequence"][first] if "sequence" in log.numbers else None
    near_mm = rig.design.training.patch_radius_min_mm
    samples, doubt = samples_of(
        rig,
        touches,
        [seen[int(sample)] for sample in good],
        time_s=times[good] - times[good[0]],
        sequence=sequences_of(given, touches, rig.surface.point(touches.uv), near_mm),
    )
    notes["time_start_s"] = float(times[good[0]])
    notes["doubts"] = [text for text in (doubt, _gaps(samples.time_s)) if text]
    return samples


def _gaps(time_s: FloatArray) -> str:
    """Pauses in the log, as a sentence; empty for none."""
    step = np.diff(time_s)
    usual = float(np.median(step)) if len(step) else 0.0
    long = np.flatnonzero(step > LIMITS.pause_intervals * usual)
    if len(long) == 0:
        return ""
    return (
        f"{len(long)} pauses of more than {LIMITS.pause_intervals:g} times the usual "
        f"{usual:.3g} s; the first of {step[long[0]]:.3g} s at {time_s[long[0]]:.3f} s"
    )


def _check_lenses(
    bundle: Bundle, files: Sequence[Path], progress: Callable[[str], None]
) -> list[dict[str, float]]:
    """Differences of calibrated lenses from those that the decoder was made for."""
    if files and len(files) != len(bundle.cameras):
        raise InputError(
            "camera-count",
            f"--camera was given {len(files)} times for {len(bundle.cameras)} cameras; give one of "
            "each, the near end's first",
        )
    out = []
    for path, camera in zip(files, bundle.cameras, strict=False):
        made, found = camera.lens, read_lens(path)
        if (made.width_px, made.height_px) != (found.width_px, found.height_px):
            raise InputError(
                "lens-image-size",
                f"{path} is of {found.width_px}x{found.height_px} px, the decoder was made for "
                f"{made.width_px}x{made.height_px}; calibrate the camera mode of the design",
            )
        away = lens_difference_px(made, found)
        most, limit = (
            float(away.max()),
            LIMITS.lens_share_max * 0.5 * np.hypot(made.width_px, made.height_px),
        )
        said = (
            f"{path}: this lens images the sensor up to {most:.1f} px (median "
            f"{np.median(away):.1f}) from where the design's does"
        )
        fix = "set camera.calibration in the design to this file and build again"
        if not most <= limit:
            raise InputError("lens-differs", f"{said}, more than {limit:.1f} px; {fix}")
        if most > LIMITS.lens_warn_px:
            progress(f"warning: {said}; {fix}")
        out.append({"most_px": most, "median_px": float(np.median(away))})
    return out


def lens_difference_px(made: Lens, found: Lens) -> FloatArray:
    """How far apart (m,) px two lenses image the same directions, over the first one's image.

    Infinite where the second one sees nothing.
    """
    x = np.linspace(0.0, made.width_px - 1.0, LIMITS.lens_grid)
    y = np.linspace(0.0, made.height_px - 1.0, LIMITS.lens_grid)
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    directions = made.unproject(pixels)
    seen = np.isfinite(directions).all(axis=1)
    away = np.linalg.norm(found.project(directions[seen]) - pixels[seen], axis=1)
    return np.where(np.isfinite(away), away, np.inf)


def _write(
    sources: Sequence[FrameSource],
    out: Path,
    samples: Samples,
    meta: DataSetInfo,
    pictures: IntArray,
) -> DataSetInfo:
    """Write the data set beside its place, and put it there whole."""
    part = out.with_name(f".{out.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        (part / FRAMES).mkdir(parents=True)
        names = [
            _keep_frame(source, int(number), part / FRAMES / f"{sample:06d}{mark}")
            for source, mark, row in zip(sources, CAMERA_SUFFIXES, pictures, strict=False)
            for sample, number in enumerate(row)
        ]
        if not names:
            (part / FRAMES).rmdir()
        meta = write_samples(part, samples, meta, frames=sorted(names))
        if out.exists():
            out.rmdir()
        part.replace(out)
    except OSError as error:
        raise OutputError("output-not-writable", f"cannot write {out}: {error.strerror}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return meta


def _keep_frame(source: FrameSource, number: int, target: Path) -> str:
    """Keep a picture: a PNG or JPEG as it is, any other as PNG; its name."""
    if isinstance(source, FrameFolder):
        suffix = source.files[number].suffix.lower().replace("jpeg", "jpg")
        if suffix in (".png", ".jpg"):
            return Path(shutil.copyfile(source.files[number], target.with_suffix(suffix))).name
    path = target.with_suffix(".png")
    path.write_bytes(encode_png(source.read(number)))
    return path.name
