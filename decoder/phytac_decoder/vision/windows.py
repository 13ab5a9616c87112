"""Small square windows of a frame, one per spot of paint: its weight and centroid, fast.

A table over chroma (Cr, Cb), the colour model's own, gives each paint's coverage, and a matrix
product sums the moments. Spots of one paint share no pixel: a
window is cut half way between their edges.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from phytac_decoder.vision.colour_codes import Floats32, Picture
from phytac_decoder.vision.window_batches import Block, Cuts, Space
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SLACK_px = (0.4, 1.0)
"""A window is laid anew once its spot has moved this far: the less, the nearer rivals are."""
SLACK_SHARE = 0.5
"""Share of the clear way from a spot's edge to its border that either spot may move before."""
CLASS_COST = 7000.0
"""What another size of window costs in calls, in samples."""
BLOCK_px = 1 << 16
"""Windows of one size are split into blocks of so many pixels: they stay in the cache."""
CALLS_px = 16000
"""What turning pixels into codes costs in calls, for each block, in pixels of a whole frame."""
PIXEL_COST = 1.2
"""What it costs for a window's pixel over what it costs for one of a whole frame."""


class Moments(NamedTuple):
    """Paint of spots; arrays over m of them.

    ``weight`` (m,) px is the paint's area with partial pixels counted in part, ``centroid_px``
    (m, 2) its centroid (no place at all without paint), ``rim`` (m,) the weight in the
    outermost pixels of the window.
    """

    weight: FloatArray
    centroid_px: FloatArray
    rim: FloatArray


class Windows:
    """Windows that follow n spots of paint, in :func:`window_order`, over one camera's frames.

    Parameters
    ----------
    half_px : (n,) float
        From a spot's centre to the edge of its window.
    reach_px : (n,) float
        From there to the edge of its paint.
    paint : (n,) int
        Its paint: row of ``tables``.
    tables : (k, 65536) float32
        From :func:`coverage_tables`.
    rivals : (n, r) int
        Spots of the same paint nearby, nearest first; n for none.
    skew_px : (n, r) float
        How much nearer to the rival the border lies than half way: half of how much the spot
        reaches farther towards the rival than the rival does towards it.
    picture : Picture
        What to look at, as it is at each look.
    stride : (n,) int
        2 takes every other pixel in both directions, and so on.
    """

    def __init__(
        self,
        *,
        half_px: FloatArray,
        reach_px: FloatArray,
        paint: IntArray,
        tables: Floats32,
        rivals: IntArray,
        skew_px: FloatArray,
        picture: Picture,
        stride: IntArray,
    ) -> None:
        count = len(half_px)
        height, width = picture.codes.shape
        size_px = width, height
        self._picture, self._size, self._tables = picture, np.array(size_px), tables
        self._rivals, self._skew, self._paint, self._stride = rivals, skew_px, paint, stride
        self._rival_of = np.ascontiguousarray(rivals.T)
        self._side = _sides(half_px, stride, size_px)
        self._alone = (rivals == count).all(axis=1)
        self._reach, self._slack = reach_px, np.full((count, 1), SLACK_px[1])
        self._anchor = np.full((count, 2), np.inf)
        self._origin, self._corner = np.zeros((count, 2)), np.zeros(count, dtype=np.int64)
        self._sums = np.zeros((count, 4), dtype=np.float32)
        kinds = np.unique(np.column_stack([stride, self._side]), axis=0).tolist()
        parts = []
        for step, each in kinds:
            spots = np.flatnonzero((self._side == each) & (stride == step))
            most = max(BLOCK_px // (len(range(0, each, step)) * each), 1)
            pieces = np.array_split(spots, -(-len(spots) // most))
            parts += [(piece, each, step) for piece in pieces]
        space = Space.of([(len(spots), side, step) for spots, side, step in parts])
        self._blocks = [self._block(spots, side, step, space) for spots, side, step in parts]
        # What each look hands to each block.
        self._work = [
            (block, self._corner[block.part], self._sums[block.part]) for block in self._blocks
        ]
        self._firsts = [block.first for block in self._blocks]
        self._steps = np.array([1, size_px[0]])
        self.pixels = sum(block.mask.size for block in self._blocks)

    def _block(self, spots: IntArray, side: int, stride: int, space: Space) -> Block:
        paint = self._paint[spots]
        change = [0, *(np.flatnonzero(np.diff(paint)) + 1).tolist(), len(spots)]
        tables = [
            (start, stop, self._tables[paint[start]][None])
            for start, stop in pairwise(change)
            if stop > start
        ]
        return Block(
            first=int(spots[0]),
            spots=len(spots),
            side=side,
            stride=stride,
            paints=tables,
            space=space,
            picture=self._picture,
        )

    def look(self, centre_px: FloatArray) -> Moments:
        """Moments of all spots, where each is expected: (n, 2), finite."""
        moved = np.abs(centre_px - self._anchor) > self._slack
        if moved.any():
            self._follow(moved.any(axis=1), centre_px)
        for block, corner, sums in self._work:
            block.sums(corner, sums)
        return _moments(self._sums, self._origin)

    def look_at(self, spots: IntArray, centre_px: FloatArray, more_px: float) -> Moments:
        """Moments of ``spots`` (m,) in windows that reach ``more_px`` farther than usual.

        Parameters
        ----------
        centre_px : (n, 2) float
            Where all spots are expected: the others are rivals.
        """
        stride = int(self._stride[spots].min())
        half = (int(self._side[spots].max()) // 2 + more_px) / stride
        most = (int(self._size.min()) - 1) // (2 * stride)
        side = 2 * stride * min(int(np.ceil(half)), most) + 1
        order = np.argsort(self._paint[spots], kind="stable")
        own, sides = spots[order], np.full(len(spots), side)
        block = self._block(own, side, stride, Space.of([(len(own), side, stride)]))
        origin = self._placed(centre_px[own], sides)
        rows = np.arange(len(own))
        block.lay(rows, self._cuts(own, origin, sides, centre_px), slice(None))
        sums = np.zeros((len(own), 4), dtype=np.float32)
        block.sums(origin @ self._steps, sums)
        back = np.argsort(order)
        return _moments(sums[back], origin[back])

    @property
    def convert_cost(self) -> float:
        """What it costs to turn each window into codes by itself, in pixels of a whole frame."""
        pixels = sum(block.mask.size * block.stride for block in self._blocks)
        return PIXEL_COST * pixels + CALLS_px * len(self._blocks)

    def border_weight(self) -> FloatArray:
        """Paint (n,) px of each spot, where the last look saw it, on a border to a rival."""
        out = np.zeros(len(self._sums))
        for block, corner, _ in self._work:
            cover = block.cover(corner).reshape(block.mask.shape)
            on = np.where(block.mask < 1.0, cover, 0.0)
            out[block.part] = on.sum(axis=(1, 2)) * block.stride**2
        return out

    def _placed(self, centre: FloatArray, side: IntArray) -> IntArray:
        """First column and row (m, 2) of windows around centres (m, 2)."""
        corner = np.rint(centre).astype(np.int64) - (side // 2)[:, None]
        return np.asarray(np.minimum(np.maximum(corner, 0), self._size - side[:, None]))

    def _follow(self, moved: BoolArray, centre: FloatArray) -> None:
        """Lay windows anew where spots, or their rivals, have moved."""
        which = np.flatnonzero(moved)
        self._anchor[which] = centre[which]
        origin = self._placed(centre[which], self._side[which])
        self._origin[which], self._corner[which] = origin, origin @ self._steps
        near = np.append(moved, False)[self._rival_of].any(axis=0)
        near |= moved
        near &= ~self._alone
        spots = np.flatnonzero(near)
        if len(spots) == 0:
            return
        cuts = self._cuts(spots, self._origin[spots], self._side[spots], centre)
        clear = SLACK_SHARE * (cuts.nearest - self._reach[spots])
        least, most = SLACK_px
        self._slack[spots, 0] = np.minimum(np.maximum(clear, least), most)
        edges = np.searchsorted(spots, self._firsts).tolist()
        for block, start, stop in zip(self._blocks, edges, [*edges[1:], len(spots)], strict=True):
            if stop > start:
                block.lay(spots[start:stop] - block.first, cuts, slice(start, stop))

    def _cuts(
        self, spots: IntArray, origin: FloatArray | IntArray, side: IntArray, centre: FloatArray
    ) -> Cuts:
        everywhere = np.concatenate([centre, np.full((1, 2), 1e6)])
        own = centre[spots]
        return Cuts.between(
            own - origin,
            everywhere[self._rivals[spots]] - own[:, None],
            self._skew[spots],
            side.astype(np.float64) - 1.0,
        )


def _moments(sums: Floats32, origin: FloatArray | IntArray) -> Moments:
    """Moments of sums (m, 4) over windows with corners ``origin``."""
    total = sums.astype(np.float64)
    weight = total[:, 0]
    centroid = total[:, 1:3]
    centroid /= np.maximum(weight, 1e-6)[:, None]
    centroid += origin
    return Moments(weight, centroid, total[:, 3])


def window_order(
    half_px: FloatArray, paint: IntArray, stride: IntArray, size_px: tuple[int, int]
) -> IntArray:
    """Order (n,) in which :class:`Windows` wants its spots: by window, then by paint."""
    return np.lexsort((paint, _sides(half_px, stride, size_px), stride))


def _sides(half_px: FloatArray, stride: IntArray, size_px: tuple[int, int]) -> IntArray:
    """Pixels a side (n,) of windows; an odd number of samples."""
    most = np.maximum((min(size_px) - 1) // (2 * stride), 1)
    steps = np.clip(np.ceil(half_px / stride).astype(np.int64), 1, most)
    side: IntArray = 2 * stride * steps + 1
    for each in np.unique(stride):
        side[stride == each] = _grouped(side[stride == each], int(each))
    return side


def _grouped(side: IntArray, stride: int) -> IntArray:
    """Sides (n,) rounded up to a few: fewest pixels, with a price on each further size."""
    sizes, count = np.unique(side, return_counts=True)
    most = len(sizes)
    best: list[tuple[float, Sequence[int]]] = [(0.0, ())]
    for stop in range(1, most + 1):
        area = (float(sizes[stop - 1]) / stride) ** 2
        choices = [
            (
                best[start][0] + CLASS_COST + area * float(count[start:stop].sum()),
                (*best[start][1], stop - 1),
            )
            for start in range(stop)
        ]
        best.append(min(choices))
    chosen = sizes[list(best[most][1])]
    return np.asarray(chosen[np.searchsorted(chosen, side)])
