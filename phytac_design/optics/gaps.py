"""Distances on the image between the visible pixels of different markers."""

import numpy as np
from numpy.typing import NDArray

from phytac_design.optics.kernels import kernel
from shapes.arrays import FloatArray, IntArray

NEAR_PX = 64.0
"""Gaps that are looked for first."""


def marker_gaps(
    marker: NDArray[np.int32], colour: IntArray, *, limit_px: float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Least distance of each marker to another one of its own, and of another, colour.

    Parameters
    ----------
    marker : (h, w) int32
        Marker whose paint each pixel shows, -1 for none.
    colour : (n,) int
        Colour of each marker.
    limit_px : float
        Gaps beyond this are not wanted (and given as inf), which saves time.

    Returns
    -------
    own, other : (n,) float
        Distance in px between the nearest pixel centres: 1 means touching, so ``gap - 1`` free
        pixels lie between. inf if there is no such marker or this one is not visible.
    """
    starts = np.zeros(len(colour) + 1, dtype=np.int64)
    _outline(marker, starts, np.zeros((0, 2), dtype=np.int64))
    np.cumsum(starts, out=starts)
    pixels = np.zeros((int(starts[-1]), 2), dtype=np.int64)
    if len(pixels):
        _outline(marker, starts.copy(), pixels)
    squared = np.full((len(colour), 2), np.inf)
    if limit_px > NEAR_PX:  # What is near rules most of the rest out.
        _nearest(pixels, starts, colour, NEAR_PX, squared)
    _nearest(pixels, starts, colour, float(limit_px), squared)
    gaps = np.sqrt(squared)
    return gaps[:, 0], gaps[:, 1]


@kernel
def _outline(marker: NDArray[np.int32], starts: IntArray, pixels: IntArray) -> None:
    """Pixels of a marker with one of the four neighbours not of it, or on the image's border.

    Counts those of marker i in ``starts[i + 1]``, or writes them from ``starts[i]`` on, if
    ``pixels`` has room.
    """
    rows, columns = marker.shape
    for row in range(rows):
        for column in range(columns):
            i = marker[row, column]
            if i < 0:
                continue
            if (
                0 < row < rows - 1
                and 0 < column < columns - 1
                and marker[row - 1, column] == i
                and marker[row + 1, column] == i
                and marker[row, column - 1] == i
                and marker[row, column + 1] == i
            ):
                continue
            if len(pixels) == 0:
                starts[i + 1] += 1
            else:
                pixels[starts[i], 0], pixels[starts[i], 1] = column, row
                starts[i] += 1


@kernel
def _outside(low: int, high: int, first: int, last: int) -> int:
    """Square of the distance between two ranges on one axis; 0 where they overlap."""
    away = max(0, first - high, low - last)
    return away * away


@kernel
def _boxes(pixels: IntArray, starts: IntArray) -> IntArray:
    """Least x and y, greatest x and y (n, 4) of each marker; -1 last where it is not visible."""
    box = np.zeros((len(starts) - 1, 4), dtype=np.int64)
    box[:, :2], box[:, 2:] = np.int64(1) << 30, -1
    for i in range(len(box)):
        for k in range(starts[i], starts[i + 1]):
            x, y = pixels[k, 0], pixels[k, 1]
            box[i, 0], box[i, 2] = min(box[i, 0], x), max(box[i, 2], x)
            box[i, 1], box[i, 3] = min(box[i, 1], y), max(box[i, 3], y)
    return box


@kernel
def _closer(
    pixels: IntArray, one: tuple[int, int], two: tuple[int, int], box: IntArray, best: float
) -> float:
    """Least squared distance between two ranges of pixels, if below ``best``.

    ``box`` holds the second range: pixels of the first that are too far from it are skipped.
    """
    x0, y0, x1, y1 = box[0], box[1], box[2], box[3]
    for k in range(one[0], one[1]):
        x, y = pixels[k, 0], pixels[k, 1]
        if _outside(x, x, x0, x1) + _outside(y, y, y0, y1) >= best:
            continue
        for m in range(two[0], two[1]):
            ex, ey = pixels[m, 0] - x, pixels[m, 1] - y
            best = min(best, float(ex * ex + ey * ey))
    return best


@kernel
def _nearest(
    pixels: IntArray, starts: IntArray, colour: IntArray, limit: float, squared: FloatArray
) -> None:
    """Least squared distance, own colour in column 0, others in column 1 of ``squared`` (n, 2).

    Pairs of markers whose boxes are farther apart than the best so far, or than ``limit``, are
    skipped.
    """
    n = len(colour)
    box = _boxes(pixels, starts)
    order = np.argsort(box[:, 0])
    most = np.floor(limit * limit) + 1.0  # squared distances are whole
    for first in range(n):
        i = order[first]
        for second in range(first + 1, n):
            j = order[second]
            if box[j, 2] < 0 or box[j, 0] - box[i, 2] > limit:
                break  # Not visible, and last in order; or all that follow are farther.
            kind = 0 if colour[i] == colour[j] else 1
            bound = min(most, max(squared[i, kind], squared[j, kind]))
            apart = _outside(box[i, 0], box[i, 2], box[j, 0], box[j, 2])
            apart += _outside(box[i, 1], box[i, 3], box[j, 1], box[j, 3])
            if apart >= bound:
                continue
            one, two = (starts[i], starts[i + 1]), (starts[j], starts[j + 1])
            best = _closer(pixels, one, two, box[j], bound)
            if best < bound:
                squared[i, kind] = min(squared[i, kind], best)
                squared[j, kind] = min(squared[j, kind], best)
