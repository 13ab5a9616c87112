"""Rest frames of a source: their mean, refused if the sensor moved or was pressed meanwhile."""

from collections.abc import Sequence

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Source
from phytac_decoder.io.frame_sources import first_frames
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_shapes.arrays import ImageArray, IntArray
from phytac_shapes.errors import InputError


def take_rest_frames(bundle: Bundle, source: Source, count: int) -> list[ImageArray]:
    """Mean (h, w, 3) uint8 of the next ``count`` frames of each camera.

    Raises
    ------
    InputError
        If the sensor was not at rest, see :func:`check_at_rest`, or see
        :func:`phytac_decoder.io.frame_sources.first_frames`.
    """
    taken = first_frames(source, count)
    check_at_rest(calibrate_rest(bundle, taken.mean), taken.first, taken.last)
    return taken.mean


def pressed_note(koi: IntArray) -> str:
    """Say which switches (k,) are on in rest frames; empty if none is."""
    names_max = 5
    if not koi.size:
        return ""
    names = ", ".join(map(str, koi[:names_max])) + (", …" if koi.size > names_max else "")
    return f"switches are on in the rest frame, those of receptors {names} ({koi.size} in all)"


def check_at_rest(bundle: Bundle, first: Sequence[ImageArray], last: Sequence[ImageArray]) -> None:
    """Refuse rest frames of a sensor that was not at rest.

    Parameters
    ----------
    bundle : Bundle
        Calibrated to their mean.
    first, last : sequence of (h, w, 3) uint8
        The first and the last one of each camera.

    Raises
    ------
    InputError
        If switches are on, all markers moved together, or some moved against the others.
    """
    # The scatter of all markers shows what is noise; weak markers scatter more than others.
    motion_max_px, scatters, few = 0.2, 8.0, 2
    before, after = (measure_frame(bundle, images) for images in (first, last))
    step = after.shift_px - before.shift_px
    step = step[np.isfinite(step).all(axis=1)]
    common = np.median(step, axis=0)
    off = np.abs(step - common)
    limit_px = np.maximum(scatters * np.median(off, axis=0) / 0.6745, motion_max_px)
    pressed = np.count_nonzero((off > limit_px).any(axis=1)) > few
    switched = set(before.koi.tolist()) != set(after.koi.tolist())
    if after.koi.size and not switched:
        raise InputError(
            "rest-frame-pressed",
            f"{pressed_note(after.koi)}: what presses there would count as nothing; lift it and "
            "start again",
        )
    if switched or pressed or np.hypot(*common) > motion_max_px:
        raise InputError(
            "rest-frames-unsteady",
            f"markers moved by up to {np.linalg.norm(step, axis=1).max():.2f} px while the rest "
            f"frames were taken{', and switches changed' if switched else ''}; leave the sensor "
            "alone, fasten camera and shell, and start again",
        )
