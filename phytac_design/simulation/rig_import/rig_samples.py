"""Markers that the decoder detects in a user's pictures, and the samples made of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import (
    FOUND_WELL,
    FrameMeasurement,
    locate_markers,
    measure_frame,
    rest_positions,
)
from phytac_decoder.vision.segmentation import check_image
from phytac_design.datasets.samples import REAL, Samples, truth_rows
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.contacts import Contacts, Switching, assign_forces
from phytac_design.simulation.rig_import.rig_frames import FrameSource
from phytac_design.simulation.rig_import.rig_log import RigLog
from phytac_design.simulation.switch_law import switch_law
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

REASONS = (
    f"fewer than {100 * FOUND_WELL:.0f} % of the markers were found",
    "the camera has moved since the rest frame, farther than its mount allows",
    "a contact far above the threshold of a switch did not turn it on",
    "a switch was read as on that no contact of the log presses",
)


@dataclass(frozen=True, kw_only=True)
class RigSetup:
    """A sensor and its pictures.

    Attributes
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    bundle : Bundle
        Its decoder.
    sources : tuple of Source
        Pictures of each camera.
    """

    design: Design
    surface: Surface
    markers: Markers
    bundle: Bundle
    sources: tuple[FrameSource, ...]

    def frames(self, numbers: IntArray) -> tuple[ImageArray, ...]:
        """One picture of each camera, by their numbers (cameras,)."""
        return tuple(
            source.read(int(number)) for source, number in zip(self.sources, numbers, strict=True)
        )


def rest_positions_of(
    rig: RigSetup, rest: list[str], progress: Callable[[str], None]
) -> FloatArray | None:
    """Rest positions (n, 2) px, measured in pictures of the unloaded sensor; None without any.

    Raises
    ------
    InputError
        If there is not one for each camera, or it is of no use.
    """
    if not rest:
        progress(
            "warning: no --rest: shifts are against the design's predicted rest positions, so that "
            "errors of print and assembly count as motion"
        )
        return None
    if len(rest) != len(rig.sources):
        raise InputError(
            "camera-count",
            f"--rest was given {len(rest)} times for {len(rig.sources)} cameras; give one of each, "
            "the near end's first",
        )
    images = []
    for text, source in zip(rest, rig.sources, strict=True):
        number = source.find(text)
        images.append(read_image(Path(text)) if number is None else source.read(number))
    bits = locate_markers(rig.bundle, images).switch_on
    if bits.any():
        progress(f"warning: {int(bits.sum())} switches read as on in the picture at rest; is it?")
    return rest_positions(rig.bundle, images)


def measure_samples(
    rig: RigSetup,
    log: RigLog,
    numbers: IntArray,
    samples: IntArray,
    rest_px: FloatArray | None,
    progress: Callable[[str], None],
) -> dict[int, FrameMeasurement]:
    """What the pictures of some samples show; those that show no sensor are noted.

    Parameters
    ----------
    numbers : (cameras, s) int
        Picture of each sample.
    samples : (m,) int
        Samples to look at.

    Raises
    ------
    InputError
        If the pictures are of another size than the bundle's cameras.
    """
    say_every = 25
    order = samples[np.argsort(numbers[0, samples], kind="stable")]
    seen: dict[int, FrameMeasurement] = {}
    for count, sample in enumerate(map(int, order)):
        name = rig.sources[0].names[numbers[0, sample]]
        try:
            frames = rig.frames(numbers[:, sample])
        except InputError as error:
            log.problems.add(sample, f"line {log.first_line[sample]}: {error}")
            continue
        if count == 0:
            for frame, camera in zip(frames, rig.bundle.cameras, strict=True):
                check_image(frame, width_px=camera.width_px, height_px=camera.height_px)
        try:
            seen[sample] = measure_frame(rig.bundle, frames, rest_px=rest_px)
        except InputError as error:
            log.problems.add(sample, f"line {log.first_line[sample]}: frame {name!r}: {error}")
        if (count + 1) % say_every == 0 or count + 1 == len(order):
            progress(f"import: {count + 1} of {len(order)} frames")
    return seen


def samples_of(
    rig: RigSetup,
    touches: Contacts,
    seen: list[FrameMeasurement],
    *,
    time_s: FloatArray,
    sequence: IntArray,
) -> tuple[Samples, str]:
    """Samples of what was pressed and seen, (s,) each, and a doubt about the forces' unit, or "".

    The true switch states of a rig are not known: those read stand for them, and a contact's
    force is shared among the switches under it that were read as on, as in simulation.
    """
    bits = np.zeros((len(seen), rig.markers.count), dtype=np.bool_)
    for row, measured in zip(bits, seen, strict=True):
        row[measured.koi] = True
    radius = rig.design.switch.footprint_diameter_mm / 2.0
    share = footprint_shares(rig.surface, touches, rig.markers.uv, radius)
    switching = assign_forces(touches, share, bits)
    remarks = _remarks(rig, touches, share, seen, bits, switching)
    rows, columns = np.nonzero(remarks)
    order = np.argsort(rows, kind="stable")
    return Samples(
        markers=rig.markers.count,
        time_s=time_s,
        sequence=sequence,
        light=np.ones(len(seen)),
        status=np.where(remarks.any(axis=1), 1, 0),
        theory=np.full(len(seen), REAL, dtype=np.int64),
        total_N=np.bincount(touches.sample, weights=touches.force_N, minlength=len(seen)).astype(
            np.float64
        ),
        contacts=touches.counts,
        reasons=REASONS,
        reason_sample=rows[order],
        reason_index=columns[order],
        bits=bits,
        bits_read=bits,
        shift_px=np.stack([measured.shift_px for measured in seen]),
        touches=touches.table(rig.surface),
        truth=truth_rows(bits, switching.owner, switching.receptor_force_N),
    ), _doubt(rig, touches, share, switching) or _elsewhere(remarks)


def _remarks(
    rig: RigSetup,
    touches: Contacts,
    share: FloatArray,
    seen: list[FrameMeasurement],
    bits: BoolArray,
    switching: Switching,
) -> BoolArray:
    """Which of ``REASONS`` holds for each sample, (s, 4)."""
    sure = 2.0  # a footprint that carries this many times its switch's threshold must turn it on
    out = np.zeros((len(seen), len(REASONS)), dtype=np.bool_)
    for row, measured in zip(out, seen, strict=True):
        row[0] = measured.found.mean() < FOUND_WELL
        row[1] = bool(measured.moved_cameras(rig.bundle, None))
    if not rig.design.has_switches:
        return out
    limit = sure * switch_law(rig.design, rig.markers).on_N
    must = share * touches.force_N[:, None] > limit
    np.logical_or.at(out[:, 2], touches.sample, (must & ~bits[touches.sample]).any(axis=1))
    out[:, 3] = (bits & (switching.owner < 0)).any(axis=1)
    return out


def _elsewhere(remarks: BoolArray) -> str:
    """Doubt about the places of contacts, from ``REASONS`` (s, 4) of samples; empty for none."""
    most = 0.25  # largest share of samples whose switches are on elsewhere; 0 in simulated logs
    count = int(remarks[:, 2:].any(axis=1).sum())
    if count <= most * len(remarks):
        return ""
    return (
        f"in {count} of {len(remarks)} samples the switches that are on are not those that the log "
        "presses: do its rows belong to these pictures (numbers of frames one off? --offset-s?), "
        "and are positions and radii right?"
    )


def _doubt(rig: RigSetup, touches: Contacts, share: FloatArray, switching: Switching) -> str:
    """Doubt about the unit of forces, from the thresholds they overcame; empty for none."""
    # Forces whose median is below this share of the thresholds they overcame are in another unit.
    weak = 0.3
    carried = share * touches.force_N[:, None]
    mine = switching.owner[touches.sample] == np.arange(len(touches.sample))[:, None]
    ratio = (carried / switch_law(rig.design, rig.markers).on_N)[mine]
    if len(ratio) == 0 or np.median(ratio) >= weak:
        return ""
    return (
        f"switches turned on at {np.median(ratio):.2g} times their threshold (median of "
        f"{len(ratio)}): are the forces in N, and radii and positions right?"
    )
