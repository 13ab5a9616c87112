"""Small square windows of a frame, one per spot of paint: its weight and centroid, fast.

Only pixels inside the windows are read. A table over chroma (Cr, Cb), the colour model's own, gives
each paint's coverage, and a matrix product sums the moments. Spots of one paint share no pixel: a
window is cut half way between their edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from decoder.segmentation import COSINE_MIN, ColourModel
from shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

Floats32 = NDArray[np.float32]

SLACK_px = (0.4, 1.0)
"""A window is laid anew once its spot has moved this far: the less, the nearer rivals are."""
SLACK_SHARE = 0.5
"""Share of the clear way from a spot's edge to its border that either spot may move before."""
BORDER_LEAST = 0.15
"""A border keeps at least this share of the way between two spots on either side."""
CLASS_COST_px = 7000.0
"""What another size of window costs in calls, in pixels."""
CODES = 1 << 16


class Moments(NamedTuple):
    """Paint of spots; arrays over m of them.

    ``weight`` (m,) px is the paint's area with partial pixels counted in part, ``centroid_px``
    (m, 2) its centroid (no place at all without paint), ``rim`` (m,) the weight in the
    outermost pixels of the window.
    """

    weight: FloatArray
    centroid_px: FloatArray
    rim: FloatArray


def coverage_tables(model: ColourModel) -> Floats32:
    """Coverage (k, 65536) by each paint of a model, over Cr · 256 + Cb; 0 in other classes."""
    flat = np.arange(CODES, dtype=np.uint16)
    plane = np.stack([flat >> 8, flat & 255], axis=-1) - 128.0
    full = np.linalg.norm(model.chroma, axis=1)
    along = plane @ (model.chroma / full[:, None]).T
    size = np.linalg.norm(plane, axis=1)
    best = np.argmax(along / np.maximum(size, 1e-9)[:, None], axis=1)
    picked = along[np.arange(CODES), best]
    painted = (picked >= COSINE_MIN * size) & (picked >= model.floor * full[best])
    shares = [
        np.where(painted & (best == paint), model.coverage(flat, paint), 0.0)
        for paint in range(len(full))
    ]
    return np.asarray(shares, dtype=np.float32)


@dataclass
class _Block:
    """Windows of one size and their buffers; ``spots`` of them, ``taken`` samples a side.

    Attributes
    ----------
    first, spots : int
        Their place in the order of all windows, and their number.
    side, stride : int
        Pixels a side, and from one sample to the next.
    paints : list of (int, int, (65536,) float32)
        Which windows are looked up in which table.
    """

    first: int
    spots: int
    side: int
    stride: int
    paints: list[tuple[int, int, Floats32]]
    tones: ImageArray = field(init=False)
    chroma: ImageArray = field(init=False)
    coded: NDArray[np.uint16] = field(init=False)
    weight: Floats32 = field(init=False)
    mask: Floats32 = field(init=False)
    basis: Floats32 = field(init=False)
    offset: Floats32 = field(init=False)
    cut: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        self.offset = np.arange(0, self.side, self.stride, dtype=np.float32)
        taken = len(self.offset)
        rows = self.spots * taken
        # One long row: OpenCV's vector instructions leave the end of each row to slower ones.
        self.tones = np.zeros((1, rows * self.side, 3), dtype=np.uint8)
        # Cb first: the low byte of the table's index.
        self.chroma = np.zeros((1, rows * self.side, 2), dtype=np.uint8)
        self.coded = self.chroma.view(np.uint16)[:, :, 0]
        self.weight = np.zeros((1, rows * taken), dtype=np.float32)
        self.mask = np.ones((self.spots, taken, taken), dtype=np.float32)
        self.cut = np.zeros(self.spots, dtype=np.bool_)
        y, x = np.meshgrid(self.offset, self.offset, indexing="ij")
        last = self.offset[-1]
        rim = (x == 0) | (y == 0) | (x == last) | (y == last)
        # One sample stands for stride² pixels.
        self.basis = np.stack([np.ones_like(x), x, y, rim], axis=-1).reshape(-1, 4)
        self.basis = (self.basis * np.float32(self.stride**2)).astype(np.float32)

    def sums(self, frame: ImageArray, origin: IntArray, out: Floats32) -> None:
        """Weight, first moments about the windows' corners, and rim into ``out`` (spots, 4)."""
        height, width = frame.shape[:2]
        row = 3 * width
        taken = len(self.offset)
        windows: NDArray[np.uint8] = np.ndarray(
            (height - self.side + 1, width - self.side + 1, taken, 3 * self.side),
            np.uint8,
            buffer=frame,
            strides=(row, 3, self.stride * row, 1),
        )
        pixels = windows[origin[:, 1], origin[:, 0]].reshape(1, -1, 3)
        cv2.cvtColor(pixels, cv2.COLOR_BGR2YCrCb, dst=self.tones)
        cv2.mixChannels([self.tones], [self.chroma], [1, 1, 2, 0])
        coded = self.coded
        if self.stride > 1:
            every = coded.reshape(-1, self.side)[:, :: self.stride]
            coded = np.ascontiguousarray(every).reshape(1, -1)
        for start, stop, table in self.paints:
            part = slice(start * taken**2, stop * taken**2)
            cv2.LUT(coded[:, part], table, dst=self.weight[:, part])
        weight = self.weight.reshape(self.spots, -1)
        if self.cut.any():
            weight *= self.mask.reshape(self.spots, -1)
        np.matmul(weight, self.basis, out=out)

    def lay(self, which: IntArray, cuts: "_Cuts", rows: IntArray) -> None:
        """Cut windows ``which`` (m,) as rows ``rows`` (m,) of ``cuts`` say."""
        need = cuts.inside[rows].any(axis=1)
        self.mask[which[self.cut[which] & ~need]] = 1.0
        self.cut[which] = need
        if not need.any():
            return
        which, rows = which[need], rows[need]
        mask = np.ones((len(rows), len(self.offset), len(self.offset)), dtype=np.float32)
        for k in np.flatnonzero(cuts.inside[rows].any(axis=0)):
            along_x = self.offset * cuts.unit[rows, k, 0, None]
            along_y = self.offset * cuts.unit[rows, k, 1, None]
            part = (cuts.far[rows, k, None] - along_y)[:, :, None] - along_x[:, None, :]
            np.minimum(mask, part, out=mask)
        np.maximum(mask, 0.0, out=mask)
        self.mask[which] = mask


class _Cuts(NamedTuple):
    """Borders of m windows against r rivals each.

    A pixel at p from the window's corner counts ``far - unit · p``, between 0 and 1; ``inside``
    (m, r) are the borders that cross the window, ``nearest`` (m,) px is the nearest border's
    distance from the spot.
    """

    far: Floats32
    unit: Floats32
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
        gap = np.maximum(np.hypot(rivals[:, :, 0], rivals[:, :, 1]), 1e-6)
        unit = rivals / gap[:, :, None]
        border = np.clip(gap / 2.0 + skew, BORDER_LEAST * gap, (1.0 - BORDER_LEAST) * gap)
        far = border + (own[:, None] * unit).sum(axis=2) + 0.5
        # The corner of the window that lies farthest along.
        corner = last[:, None] * np.maximum(unit, 0.0).sum(axis=2)
        return cls(
            far=far.astype(np.float32),
            unit=unit.astype(np.float32),
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
    size_px : (int, int)
        Width and height of the frames.
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
        size_px: tuple[int, int],
        stride: IntArray,
    ) -> None:
        count = len(half_px)
        self._size, self._tables = np.array(size_px), tables
        self._rivals, self._skew, self._paint, self._stride = rivals, skew_px, paint, stride
        self._side = _sides(half_px, stride, size_px)
        self._alone = (rivals == count).all(axis=1)
        self._reach, self._slack = reach_px, np.full(count, SLACK_px[1])
        self._anchor = np.full((count, 2), np.inf)
        self._origin = np.zeros((count, 2), dtype=np.int64)
        self._sums = np.zeros((count, 4), dtype=np.float32)
        self._blocks: list[_Block] = []
        kinds = np.unique(np.column_stack([stride, self._side]), axis=0)
        for step, each in kinds.tolist():
            spots = np.flatnonzero((self._side == each) & (stride == step))
            self._blocks.append(self._block(spots, each, step))
        self.pixels = int(sum(block.weight.size for block in self._blocks))

    def _block(self, spots: IntArray, side: int, stride: int) -> _Block:
        paint = self._paint[spots]
        change = [0, *(np.flatnonzero(np.diff(paint)) + 1).tolist(), len(spots)]
        tables = [
            (start, stop, self._tables[paint[start]][None])
            for start, stop in pairwise(change)
            if stop > start
        ]
        first = int(spots[0]) if len(spots) else 0
        return _Block(first=first, spots=len(spots), side=side, stride=stride, paints=tables)

    def look(self, frame: ImageArray, centre_px: FloatArray) -> Moments:
        """Moments of all spots.

        Parameters
        ----------
        frame : (h, w, 3) uint8
            BGR, in one piece of memory.
        centre_px : (n, 2) float
            Where each is expected; finite.
        """
        away = np.abs(centre_px - self._anchor)
        moved = np.maximum(away[:, 0], away[:, 1]) > self._slack
        if moved.any():
            self._follow(moved, centre_px)
        for block in self._blocks:
            part = slice(block.first, block.first + block.spots)
            block.sums(frame, self._origin[part], self._sums[part])
        return _moments(self._sums, self._origin)

    def look_at(
        self, frame: ImageArray, spots: IntArray, centre_px: FloatArray, more_px: float
    ) -> Moments:
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
        block = self._block(own, side, stride)
        origin = self._corner(centre_px[own], sides)
        rows = np.arange(len(own))
        block.lay(rows, self._cuts(own, origin, sides, centre_px), rows)
        sums = np.zeros((len(own), 4), dtype=np.float32)
        block.sums(frame, origin, sums)
        back = np.argsort(order)
        return _moments(sums[back], origin[back])

    def border_weight(self) -> FloatArray:
        """Paint (n,) px of each spot, in the last look, that lies on a border to a rival."""
        out = np.zeros(len(self._sums))
        for block in self._blocks:
            on = np.where(block.mask < 1.0, block.weight.reshape(block.mask.shape), 0.0)
            out[block.first : block.first + block.spots] = on.sum(axis=(1, 2)) * block.stride**2
        return out

    def _corner(self, centre: FloatArray, side: IntArray) -> IntArray:
        corner = np.rint(centre).astype(np.int64) - (side // 2)[:, None]
        return np.asarray(np.clip(corner, 0, self._size - side[:, None]))

    def _follow(self, moved: BoolArray, centre: FloatArray) -> None:
        """Lay windows anew where spots, or their rivals, have moved."""
        self._anchor[moved] = centre[moved]
        self._origin[moved] = self._corner(centre[moved], self._side[moved])
        changed = np.append(moved, False)
        near = (moved | changed[self._rivals].any(axis=1)) & ~self._alone
        spots = np.flatnonzero(near)
        if len(spots) == 0:
            return
        cuts = self._cuts(spots, self._origin[spots], self._side[spots], centre)
        clear = SLACK_SHARE * (cuts.nearest - self._reach[spots])
        self._slack[spots] = np.clip(clear, *SLACK_px)
        edges = np.searchsorted(spots, [block.first for block in self._blocks])
        for block, start, stop in zip(self._blocks, edges, [*edges[1:], len(spots)], strict=True):
            if stop > start:
                block.lay(spots[start:stop] - block.first, cuts, np.arange(start, stop))

    def _cuts(self, spots: IntArray, origin: IntArray, side: IntArray, centre: FloatArray) -> _Cuts:
        everywhere = np.concatenate([centre, np.full((1, 2), 1e6)])
        own = centre[spots]
        return _Cuts.between(
            own - origin,
            everywhere[self._rivals[spots]] - own[:, None],
            self._skew[spots],
            side.astype(np.float64) - 1.0,
        )


def _moments(sums: Floats32, origin: IntArray) -> Moments:
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
        # Rows are left out before their colours are computed, columns afterwards.
        area = float(sizes[stop - 1]) ** 2 * (0.7 / stride + 0.3 / stride**2)
        choices = [
            (
                best[start][0] + CLASS_COST_px + area * float(count[start:stop].sum()),
                (*best[start][1], stop - 1),
            )
            for start in range(stop)
        ]
        best.append(min(choices))
    chosen = sizes[list(best[most][1])]
    return np.asarray(chosen[np.searchsorted(chosen, side)])
