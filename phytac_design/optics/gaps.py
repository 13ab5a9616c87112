"""Distances on the image between the visible pixels of different markers."""

import numpy as np
from numpy.typing import NDArray

from phytac_design.core.kernels import in_bands, kernel
from phytac_shapes.arrays import FloatArray, IntArray


def marker_gaps(marker: NDArray[np.int32], colour: IntArray) -> tuple[FloatArray, FloatArray]:
    """Least distance of each marker to another one of its own, and of another, colour.

    Parameters
    ----------
    marker : (h, w) int32
        Marker whose paint each pixel shows, -1 for none.
    colour : (n,) int
        Colour of each marker.

    Returns
    -------
    own, other : (n,) float
        Distance in px between the nearest pixel centres: 1 means touching, so ``gap - 1`` free
        pixels lie between. inf if there is no such marker or this one is not visible.
    """
    pixels, starts = _outlines(marker, len(colour))
    return outline_gaps(pixels, starts, colour)


@kernel
def _on_outline(marker: NDArray[np.int32], y: int, x: int) -> bool:
    """Whether a pixel has a neighbour that shows another marker, or lies on the border."""
    own, (rows, columns) = marker[y, x], marker.shape
    if y == 0 or x == 0 or y == rows - 1 or x == columns - 1:
        return True
    rest = marker[y - 1, x] == own and marker[y + 1, x] == own
    return not (rest and marker[y, x - 1] == own and marker[y, x + 1] == own)


@kernel
def _outlines(marker: NDArray[np.int32], count: int) -> tuple[IntArray, IntArray]:
    """Pixels (m, 2) on the outlines, and where each marker's start, (n + 1,)."""
    starts = np.zeros(count + 1, dtype=np.int64)
    for y in range(marker.shape[0]):
        for x in range(marker.shape[1]):
            if 0 <= marker[y, x] < count and _on_outline(marker, y, x):
                starts[marker[y, x] + 1] += 1
    starts = np.cumsum(starts)
    pixels, place = np.empty((starts[-1], 2), dtype=np.int64), starts.copy()
    for y in range(marker.shape[0]):
        for x in range(marker.shape[1]):
            if 0 <= marker[y, x] < count and _on_outline(marker, y, x):
                at = place[marker[y, x]]
                pixels[at, 0], pixels[at, 1] = x, y
                place[marker[y, x]] += 1
    return pixels, starts


def outline_gaps(
    pixels: IntArray, starts: IntArray, colour: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Least distances as :func:`marker_gaps`, from the markers' outlines.

    Parameters
    ----------
    pixels : (m, 2) int
        Pixels (x, y) on the outlines, marker after marker.
    starts : (n + 1,) int
        Where each marker's pixels start.
    """
    count = len(colour)
    squared = np.full((count, 2), np.inf)
    box = np.zeros((count, 4), dtype=np.int64)
    shown = np.flatnonzero(np.diff(starts))
    if len(shown):
        first = starts[shown]
        box[shown, :2] = np.minimum.reduceat(pixels, first)
        box[shown, 2:] = np.maximum.reduceat(pixels, first)

    def some(first: int, last: int) -> None:
        _outline_gaps(shown[first:last], shown, pixels, starts, box, colour, squared)

    in_bands(some, len(shown))
    gaps = np.sqrt(squared)
    return gaps[:, 0], gaps[:, 1]


@kernel
def _between(a: IntArray, b: IntArray) -> int:
    """Squared distance of two boxes (left, top, right, bottom)."""
    dx, dy = max(0, a[0] - b[2], b[0] - a[2]), max(0, a[1] - b[3], b[1] - a[3])
    return int(dx * dx + dy * dy)


@kernel
def _apart(one: IntArray, other: IntArray, box: IntArray, most: float) -> float:
    """Least squared distance of pixels (m, 2) from others in a box, at most ``most``."""
    best = most
    for p in range(len(one)):
        x, y = one[p, 0], one[p, 1]
        dx, dy = max(0, box[0] - x, x - box[2]), max(0, box[1] - y, y - box[3])
        if dx * dx + dy * dy >= best:
            continue
        for q in range(len(other)):
            ex, ey = x - other[q, 0], y - other[q, 1]
            best = min(best, float(ex * ex + ey * ey))
    return best


@kernel
def _outline_gaps(
    some: IntArray,
    shown: IntArray,
    pixels: IntArray,
    starts: IntArray,
    box: IntArray,
    colour: IntArray,
    squared: FloatArray,
) -> None:
    """Least squared distance, own colour in column 0, others in column 1 of ``squared`` (n, 2).

    The nearest box comes first: most others are then farther away than what it gives.
    """
    near = np.zeros(len(box))
    for i in some:
        one = pixels[starts[i] : starts[i + 1]]
        first = np.array([-1, -1])
        for j in shown:
            near[j] = _between(box[i], box[j])
            kind = 0 if colour[i] == colour[j] else 1
            if j != i and (first[kind] < 0 or near[j] < near[first[kind]]):
                first[kind] = j
        for j in first:
            if j >= 0:
                kind = 0 if colour[i] == colour[j] else 1
                other = pixels[starts[j] : starts[j + 1]]
                squared[i, kind] = _apart(one, other, box[j], squared[i, kind])
        for j in shown:
            kind = 0 if colour[i] == colour[j] else 1
            if j != i and near[j] < squared[i, kind]:
                other = pixels[starts[j] : starts[j + 1]]
                squared[i, kind] = _apart(one, other, box[j], squared[i, kind])
