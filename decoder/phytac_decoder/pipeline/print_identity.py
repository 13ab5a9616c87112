"""Whether a trained decoder reads the print that it was trained on.

Prints of one design differ by more than a trained decoder errs, and nothing in a frame of pressed
markers shows it. At rest it shows: every print has its markers elsewhere by some hundredths of a
millimetre. The rest frame is compared with those that the decoder learnt from, for any pose and
focus of the cameras.
"""

from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.camera.camera_motion import MARKED, MOTION_UNKNOWNS, tabulate_camera_motion
from phytac_decoder.io.bundle import Bundle
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class IdentitySettings:
    """Limits of the comparison."""

    same_mm: float = 0.03
    """Largest median distance of markers of the same print. Printers place them to 0.05 mm, so
    that markers of two prints are 0.08 mm apart; a centroid known to 0.1 px, with 5 px to the
    millimetre, is known to 0.02 mm."""
    iterations: int = 10
    markers_min: int = 8
    """Fewer markers do not show more than the cameras' pose."""


SETTINGS = IdentitySettings()


def print_gap_mm(bundle: Bundle, rest_px: FloatArray) -> float | None:
    """Return how far markers (median, mm) are from where the nearest learnt print has them.

    Parameters
    ----------
    bundle : Bundle
        With the rest positions of the prints that it learnt from.
    rest_px : (n, 2) float
        Rest positions now; NaN where a marker was not found.

    Returns
    -------
    float or None
        None if the bundle has not learnt, or if too few markers are found.
    """
    gaps = [_gap_mm(bundle, rest_px - learnt_px) for learnt_px in bundle.learnt_rest_px]
    known = [gap for gap in gaps if gap is not None]
    return min(known, default=None)


def _gap_mm(bundle: Bundle, moved_px: FloatArray) -> float | None:
    """Return the median distance of markers moved by (n, 2) px, less the motion of cameras."""
    found = np.asarray(np.isfinite(moved_px).all(axis=1))
    if np.count_nonzero(found) < SETTINGS.markers_min * len(bundle.cameras):
        return None
    table = tabulate_camera_motion(bundle.cameras, bundle.read_by, bundle.head_mm, MARKED)
    rows = np.repeat(found, 2)
    target = np.where(found[:, None], moved_px, 0.0).reshape(-1)
    b = np.zeros(MOTION_UNKNOWNS * len(bundle.cameras))
    left, weight = target, rows.astype(np.float64)
    for _ in range(SETTINGS.iterations):
        root = np.sqrt(weight)
        b = b + np.linalg.lstsq((table.first * root).T, root * left, rcond=None)[0]
        left = target - table.shift_px(b)
        off = np.hypot.reduce(left.reshape(-1, 2), axis=1)
        usual = max(float(np.median(off[found])), 1e-6)
        # Cauchy's weights: dirt or a neighbour's paint displaces some markers.
        weight = np.repeat(found / (1.0 + (off / (2.0 * usual)) ** 2), 2)
    # A motion of the camera along three axes shows the scale in two directions.
    along = table.first.reshape(len(bundle.cameras), MOTION_UNKNOWNS, -1)[:, :3]
    px_per_mm = np.sqrt(np.sum(along**2, axis=(0, 1)).reshape(-1, 2).sum(axis=1) / 2.0)
    return float(np.median(off[found] / px_per_mm[found]))


def for_this_print(bundle: Bundle) -> Bundle:
    """Return the decoder for the print whose rest positions the bundle has.

    On another print than those that it learnt from, what it learnt of their stiffness and forces is
    undone, and intervals allow for the scatter of prints.
    """
    gap_mm = print_gap_mm(bundle, bundle.rest_px)
    locator = bundle.model.locator
    if gap_mm is None or gap_mm <= SETTINGS.same_mm or bundle.other_print_mm:
        return bundle
    unlearnt = locator and locator.for_another_print()
    model = replace(bundle.model, locator=unlearnt, measured=None)
    return replace(bundle, model=model, other_print_mm=gap_mm)
