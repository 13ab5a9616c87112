"""Red tips that, when they are out, cover the paint of another marker behind them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.vision.switch_detection import TipCovers
from phytac_design.optics.raster import owner_sums
from phytac_design.optics.render_scene import paint_owner, red_owner
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SHIFT_MIN_px = 0.02
"""Smaller shifts are below noise."""


def exact_covers(rest: NDArray[np.int32], on: NDArray[np.int32], count: int) -> TipCovers:
    """Return covers by the ID maps of a sensor with all tips in, and out.

    A centroid moves away from the pixels that it loses.
    """
    paint, red = paint_owner(rest), red_owner(on)
    sums = owner_sums(paint, count)
    lost = np.flatnonzero((paint >= 0) & (red >= 0) & (paint != red))
    key = paint.ravel()[lost].astype(np.int64) * count + red.ravel()[lost]
    pair, own = np.unique(key, return_inverse=True)
    marker, tip = pair // count, pair % count
    area = np.bincount(own, minlength=len(pair))
    row, column = np.divmod(lost, rest.shape[1])
    place = np.stack([np.bincount(own, axis, len(pair)) for axis in (column, row)], axis=1)
    whole = sums[marker]
    left = whole[:, 1:] - place
    centre = whole[:, 1:] / whole[:, :1]
    shift = left / np.maximum(whole[:, 0] - area, 1.0)[:, None] - centre
    kept = np.linalg.norm(shift, axis=1) >= SHIFT_MIN_px
    return TipCovers(marker=marker[kept], tip=tip[kept], shift_px=shift[kept])


def as_detected(
    covers: TipCovers, count: int, detect: Callable[[BoolArray], FloatArray]
) -> TipCovers:
    """Return covers as large as the marker detector finds them, on average.

    Pixels beside a tip, where its colour mixes with the paint's, are lost too.

    Parameters
    ----------
    detect : callable
        Positions (n, 2) px of markers that it finds with some of the tips (n,) out.
    """
    share_min, share_max = 0.5, 2.0  # of the exact ones, for a few pairs that scatter
    if not len(covers.marker):
        return covers
    behind, before = _two_sides(covers)
    out = np.zeros(count, dtype=np.bool_)
    out[before] = True
    exact = covers.shift(out)[behind]
    found = (detect(out) - detect(np.zeros_like(out)))[behind]
    known = np.isfinite(found)
    share = float(found[known] @ exact[known]) / max(float(np.sum(exact[known] ** 2)), 1e-12)
    share = float(np.clip(share, share_min, share_max)) if known.any() else 1.0
    return TipCovers(marker=covers.marker, tip=covers.tip, shift_px=share * covers.shift_px)


def _two_sides(covers: TipCovers) -> tuple[IntArray, IntArray]:
    """Return markers whose own tip stays in, and tips that are out and cover them."""
    behind: set[int] = set()
    before: set[int] = set()
    for marker, tip in zip(covers.marker.tolist(), covers.tip.tolist(), strict=True):
        if marker not in before and tip not in behind:
            behind.add(marker)
            before.add(tip)
    return np.array(sorted(behind)), np.array(sorted(before))
