"""Small square windows of a frame, one per spot of paint: its weight and centroid, fast.

A table over chroma (Cr, Cb), the colour model's own, gives each paint's coverage, and a matrix
product sums the moments. Spots of one paint share no pixel: a
window is cut half way between their edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from decoder.follow_codes import Codes16, Floats32
from shapes.arrays import BoolArray, FloatArray, IntArray

SLACK_px = (0.4, 1.0)
"""A window is laid anew once its spot has moved this far: the less, the nearer rivals are."""
SLACK_SHARE = 0.5
"""Share of the clear way from a spot's edge to its border that either spot may move before."""
BORDER_LEAST = 0.15
"""A border keeps at least this share of the way between two spots on either side."""
CLASS_COST = 7000.0
"""What another size of window costs in calls, in samples."""
SAMPLES_MOST = 1 << 17
"""Windows of one size are split into blocks of so many samples: they stay in the cache."""


class Moments(NamedTuple):
    """Paint of spots; arrays over m of them.

    ``weight`` (m,) px is the paint's area with partial pixels counted in part, ``centroid_px``
    (m, 2) its centroid (no place at all without paint), ``rim`` (m,) the weight in the
    outermost pixels of the window.
    """

    weight: FloatArray
    centroid_px: FloatArray
    rim: FloatArray


class _Block:
    """Windows of one size.

    Parameters
    ----------
    first, spots : int
        Their place in the order of all windows, and their number.
    side, stride : int
        Pixels a side, and from one sample to the next.
    paints : list of (int, int, (1, 65536) float32)
        Which windows are looked up in which table.
    space : (1, s) float32
        Room for the coverage of all samples.
    codes : (h, w) uint16
        What the windows are of.
    """

    def __init__(
        self,
        *,
        first: int,
        spots: int,
        side: int,
        stride: int,
        paints: list[tuple[int, int, Floats32]],
        space: Floats32,
        codes: Codes16,
    ) -> None:
        self.part = slice(first, first + spots)
        self.first, self.side, self.stride = first, side, stride
        self.offset = np.arange(0, side, stride, dtype=np.float32)
        taken = len(self.offset)
        each = taken**2
        self.size = spots * each
        self._cover = space[0, : self.size].reshape(spots, each)
        self._lookup = [
            (slice(start * each, stop * each), table, space[:, start * each : stop * each])
            for start, stop, table in paints
        ]
        self.mask = np.ones((spots, taken, taken), dtype=np.float32)
        self._mask = self.mask.reshape(spots, each)
        self.cut = np.zeros(spots, dtype=np.bool_)
        self._any_cut = False
        y, x = np.meshgrid(self.offset, self.offset, indexing="ij")
        last = self.offset[-1]
        rim = (x == 0) | (y == 0) | (x == last) | (y == last)
        # One sample stands for stride² pixels.
        basis = np.stack([np.ones_like(x), x, y, rim], axis=-1).reshape(-1, 4)
        self._basis = (basis * np.float32(stride**2)).astype(np.float32)
        # Every window there can be, as the rows that it takes, each one item: copied as a whole.
        height, width = codes.shape
        self._rows: NDArray[np.void] = np.ndarray(
            ((height - side) * width + width - side + 1, taken),
            np.dtype((np.void, 2 * side)),
            buffer=codes,
            strides=(2, 2 * width * stride),
        )

    def cover(self, corner: IntArray) -> Floats32:
        """Coverage (spots, samples) in windows with these first pixels, as cut."""
        codes = self._rows[corner].view(np.uint16)
        if self.stride > 1:
            codes = np.ascontiguousarray(codes.reshape(-1, self.side)[:, :: self.stride])
        codes = codes.reshape(1, -1)
        for part, table, room in self._lookup:
            cv2.LUT(codes[:, part], table, dst=room)
        if self._any_cut:
            self._cover *= self._mask
        return self._cover

    def sums(self, corner: IntArray, out: Floats32) -> None:
        """Weight, first moments about the windows' corners, and rim into ``out`` (spots, 4)."""
        np.matmul(self.cover(corner), self._basis, out=out)

    def lay(self, which: IntArray, cuts: "_Cuts", rows: slice) -> None:
        """Cut windows ``which`` (m,) as ``rows`` of ``cuts`` say."""
        inside = cuts.inside[rows]
        need = inside.any(axis=1)
        self.mask[which[self.cut[which] & ~need]] = 1.0
        self.cut[which] = need
        self._any_cut = bool(self.cut.any())
        if not need.any():
            return
        mask = np.ones((int(need.sum()), len(self.offset), len(self.offset)), dtype=np.float32)
        for k in np.flatnonzero(inside.any(axis=0)).tolist():
            along_x = self.offset * cuts.unit_x[rows, k][need, None]
            along_y = self.offset * cuts.unit_y[rows, k][need, None]
            part = (cuts.far[rows, k][need, None] - along_y)[:, :, None] - along_x[:, None, :]
            np.minimum(mask, part, out=mask)
        np.maximum(mask, 0.0, out=mask)
        self.mask[which[need]] = mask


class _Cuts(NamedTuple):
    """Borders of m windows against r rivals each.

    A pixel at p from the window's corner counts ``far - unit · p``, between 0 and 1; ``inside``
    (m, r) are the borders that cross the window, ``nearest`` (m,) px is the nearest border's
    distance from the spot.
    """

    far: Floats32
    unit_x: Floats32
    unit_y: Floats32
    inside: BoolArray
    nearest: FloatArray

    @classmethod
    def between(
        cls, own: FloatArray, rivals: FloatArray, skew: FloatArray, last: FloatArray
    ) -> "_Cuts":
        """Borders between spots and rivals.

        Parameters
        ----------
        own : (m, 2) float
            Spots, from their windows' corners.
        rivals : (m, r, 2) float
            Rivals minus spots.
        skew : (m, r) float
            How far the borders lie beyond the middle, px.
        last : (m,) float
            Last pixel of the windows.
        """
        x, y = rivals[:, :, 0], rivals[:, :, 1]
        gap = np.maximum(np.hypot(x, y), 1e-6)
        x, y = x / gap, y / gap
        border = np.maximum(gap / 2.0 + skew, BORDER_LEAST * gap)
        border = np.minimum(border, (1.0 - BORDER_LEAST) * gap)
        far = border + (own[:, :1] * x + own[:, 1:] * y) + 0.5
        # The corner of the window that lies farthest along.
        corner = last[:, None] * (np.maximum(x, 0.0) + np.maximum(y, 0.0))
        return cls(
            far=far.astype(np.float32),
            unit_x=x.astype(np.float32),
            unit_y=y.astype(np.float32),
            inside=far - 1.0 < corner,
            nearest=border.min(axis=1, initial=np.inf),
        )


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
    codes : (h, w) uint16
        What to look at, as it is at each look: see :class:`decoder.follow_codes.Codes`.
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
        codes: Codes16,
        stride: IntArray,
    ) -> None:
        count = len(half_px)
        size_px = codes.shape[1], codes.shape[0]
        self._codes, self._size, self._tables = codes, np.array(size_px), tables
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
            most = max(SAMPLES_MOST // len(range(0, each, step)) ** 2, 1)
            pieces = np.array_split(spots, -(-len(spots) // most))
            parts += [(piece, each, step) for piece in pieces]
        samples = [len(spots) * len(range(0, side, step)) ** 2 for spots, side, step in parts]
        space = np.zeros((1, max(samples, default=0)), dtype=np.float32)
        self._blocks = [self._block(spots, side, step, space) for spots, side, step in parts]
        # What each look hands to each block.
        self._work = [
            (block, self._corner[block.part], self._sums[block.part]) for block in self._blocks
        ]
        self._firsts = [block.first for block in self._blocks]
        self._steps = np.array([1, size_px[0]])
        self.pixels = sum(samples)

    def _block(self, spots: IntArray, side: int, stride: int, space: Floats32) -> _Block:
        paint = self._paint[spots]
        change = [0, *(np.flatnonzero(np.diff(paint)) + 1).tolist(), len(spots)]
        tables = [
            (start, stop, self._tables[paint[start]][None])
            for start, stop in pairwise(change)
            if stop > start
        ]
        return _Block(
            first=int(spots[0]),
            spots=len(spots),
            side=side,
            stride=stride,
            paints=tables,
            space=space,
            codes=self._codes,
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
        space = np.zeros((1, len(own) * len(range(0, side, stride)) ** 2), dtype=np.float32)
        block = self._block(own, side, stride, space)
        origin = self._placed(centre_px[own], sides)
        rows = np.arange(len(own))
        block.lay(rows, self._cuts(own, origin, sides, centre_px), slice(None))
        sums = np.zeros((len(own), 4), dtype=np.float32)
        block.sums(origin @ self._steps, sums)
        back = np.argsort(order)
        return _moments(sums[back], origin[back])

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

    def _cuts(self, spots: IntArray, origin: FloatArray | IntArray, side: IntArray, centre: FloatArray) -> _Cuts:
        everywhere = np.concatenate([centre, np.full((1, 2), 1e6)])
        own = centre[spots]
        return _Cuts.between(
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
