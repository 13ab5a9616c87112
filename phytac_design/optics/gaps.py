"""Distances on the image between the visible pixels of different markers."""

import numpy as np
from numpy.typing import NDArray

from phytac_design.optics.kernels import kernel
from shapes.arrays import FloatArray, IntArray


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
    y, x = np.nonzero(_outline(marker))
    owner = marker[y, x]
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(len(colour) + 1))
    pixels = np.column_stack([x, y])[order].astype(np.int64)
    squared = np.full((len(colour), 2), np.inf)
    _nearest(pixels, starts, colour, squared)
    gaps = np.sqrt(squared)
    return gaps[:, 0], gaps[:, 1]


def _outline(marker: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels of a marker with one of the four neighbours not of it, or on the image's border."""
    padded = np.pad(marker, 1, constant_values=-1)
    inner = np.ones(marker.shape, dtype=bool)
    h, w = marker.shape
    for dy, dx in ((0, 1), (2, 1), (1, 0), (1, 2)):
        inner &= padded[dy : dy + h, dx : dx + w] == marker
    return np.asarray((marker >= 0) & ~inner)


@kernel
def _nearest(pixels: IntArray, starts: IntArray, colour: IntArray, squared: FloatArray) -> None:
    """Least squared distance, own colour in column 0, others in column 1 of ``squared`` (n, 2).

    Pairs whose bounding boxes are already farther apart than the best so far are skipped.
    """
    n = len(colour)
    box = np.zeros((n, 4), dtype=np.int64)
    for i in range(n):
        if starts[i] < starts[i + 1]:
            own = pixels[starts[i] : starts[i + 1]]
            box[i] = own[:, 0].min(), own[:, 1].min(), own[:, 0].max(), own[:, 1].max()
    for i in range(n):
        for j in range(i):
            if starts[i] == starts[i + 1] or starts[j] == starts[j + 1]:
                continue
            kind = 0 if colour[i] == colour[j] else 1
            dx = max(0, box[i, 0] - box[j, 2], box[j, 0] - box[i, 2])
            dy = max(0, box[i, 1] - box[j, 3], box[j, 1] - box[i, 3])
            if dx * dx + dy * dy >= max(squared[i, kind], squared[j, kind]):
                continue
            best = np.int64(1) << 60
            for p in range(starts[i], starts[i + 1]):
                for q in range(starts[j], starts[j + 1]):
                    ex = pixels[p, 0] - pixels[q, 0]
                    ey = pixels[p, 1] - pixels[q, 1]
                    best = min(best, ex * ex + ey * ey)
            squared[i, kind] = min(squared[i, kind], best)
            squared[j, kind] = min(squared[j, kind], best)
