"""Square windows of a frame, one per spot of paint: the paint's area and centroid.

The colour model's coverage table over chroma (Cr, Cb) weights each pixel, and one matrix product
per window size sums the moments. Windows of spots of one paint are cut at the border half way
between them, so that no pixel counts for two spots.
"""

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

Floats32 = NDArray[np.float32]


class Moments(NamedTuple):
    """Paint of m spots.

    ``weight`` (m,) px is the paint's area with partial pixels counted in part, ``centroid_px``
    (m, 2) its centroid (meaningless without paint), ``rim`` (m,) the weight in the outermost
    pixels of the window.
    """

    weight: FloatArray
    centroid_px: FloatArray
    rim: FloatArray

    @classmethod
    def of(cls, sums: Floats32, corner: IntArray) -> "Moments":
        """Moments of weights, first moments and rims (m, 4) about the windows' corners (m, 2)."""
        total = sums.astype(np.float64)
        weight = total[:, 0]
        centroid = total[:, 1:3] / np.maximum(weight, 1e-6)[:, None] + corner
        return cls(weight, centroid, total[:, 3])


def larger(offset: FloatArray) -> FloatArray:
    """Size (m,) of offsets (m, 2) along x or y, whichever is larger."""
    x, y = np.abs(offset).T
    return np.asarray(np.maximum(x, y))


def border_lines(own: FloatArray, rivals: FloatArray) -> Floats32:
    """Borders half way between m spots and r rivals each.

    Parameters
    ----------
    own : (m, 2) float
        Spots, from their windows' corners, px.
    rivals : (m, r, 2) float
        Rivals minus spots, px.

    Returns
    -------
    (m, r, 3) float32
        Coefficients of 1, x and y: clipped to 0 … 1 they are the share with which the pixel at
        (x, y) from the window's corner counts.
    """
    gap = np.maximum(np.hypot(rivals[:, :, 0], rivals[:, :, 1]), 1e-6)[:, :, None]
    unit = rivals / gap
    offset = 0.5 * (gap + 1.0) + (own[:, None] * unit).sum(axis=2, keepdims=True)
    return np.concatenate([offset, -unit], axis=2, dtype=np.float32)


class WindowGroup:
    """Windows of one size, read together.

    Parameters
    ----------
    spots : (m,) int
        Numbers of the windows' spots, ordered by paint.
    paint : (m,) int
        Their paints: rows of ``tables``.
    side, stride : int
        Pixels per side, and from one sample to the next.
    tables : (k, 65536) float32
        Coverage of each paint over Cr · 256 + Cb.

    Attributes
    ----------
    mask : (m, samples) float32
        Share with which each sample counts.
    """

    def __init__(
        self, spots: IntArray, paint: IntArray, side: int, stride: int, tables: Floats32
    ) -> None:
        self.spots, self.side, self.stride = spots, side, stride
        offset = np.arange(0, side, stride, dtype=np.float32)
        self._rows, self._row = len(offset), np.dtype((np.void, 3 * side))
        x, y = (part.ravel() for part in np.meshgrid(offset, offset))
        rim = (x == 0) | (y == 0) | (x == offset[-1]) | (y == offset[-1])
        self._plane = np.stack([np.ones_like(x), x, y])
        # One sample stands for stride² pixels.
        self._basis = np.float32(stride**2) * np.column_stack([*self._plane, rim])
        self.mask = np.ones((len(spots), len(x)), dtype=np.float32)
        self._cover = np.empty_like(self.mask)
        edges = [0, *(np.flatnonzero(np.diff(paint)) + 1).tolist(), len(spots)]
        self._lookups = [
            (slice(start * len(x), stop * len(x)), tables[paint[start]][None])
            for start, stop in pairwise(edges)
            if stop > start
        ]
        # One long row: OpenCV's vector instructions leave the end of each row to slower ones.
        pixels = len(spots) * self._rows * side
        self._ycc: ImageArray = np.empty((1, pixels, 3), dtype=np.uint8)
        self._planes: list[ImageArray] = [np.empty((1, pixels), dtype=np.uint8) for _ in range(3)]
        self._chroma: ImageArray = np.empty((1, pixels, 2), dtype=np.uint8)

    def cut(self, rows: IntArray, lines: Floats32) -> None:
        """Cut windows ``rows`` (m,) by borders (m, r, 3); each sample counts by the nearest."""
        last = self._plane[1, -1]
        # The least value that a border has in the window is that of its farthest corner.
        least = lines[:, :, 0] + last * np.minimum(lines[:, :, 1:], 0.0).sum(axis=2)
        crossing = (least < 1.0).any(axis=0)
        used = lines[:, crossing]
        share = (used.reshape(-1, 3) @ self._plane).reshape(*used.shape[:2], self.mask.shape[1])
        self.mask[rows] = np.maximum(share.min(axis=1, initial=1.0), 0.0)

    def coverage(self, frame: ImageArray, corner: IntArray) -> Floats32:
        """Coverage (m, samples) in windows with first pixels ``corner`` (m, 2), as cut."""
        height, width = frame.shape[:2]
        side, stride = self.side, self.stride
        # All windows there can be, by their first pixels; each row is one item, copied as a whole.
        windows = np.ndarray(
            ((height - side) * width + width - side + 1, self._rows),
            self._row,
            buffer=frame,
            strides=(3, 3 * width * stride),
        )
        pixels = windows[corner[:, 1] * width + corner[:, 0]].view(np.uint8).reshape(1, -1, 3)
        cv2.cvtColor(pixels, cv2.COLOR_BGR2YCrCb, dst=self._ycc)
        cv2.split(self._ycc, self._planes)
        # Cb first: the low byte.
        cv2.merge([self._planes[2], self._planes[1]], self._chroma)
        codes = self._chroma.view(np.uint16).reshape(-1, side)[:, ::stride].reshape(1, -1)
        cover = self._cover.reshape(1, -1)
        for part, table in self._lookups:
            cv2.LUT(codes[:, part], table, dst=cover[:, part])
        self._cover *= self.mask
        return self._cover

    def sums(self, frame: ImageArray, corner: IntArray) -> Floats32:
        """Weight, first moments about the windows' corners, and rim: (m, 4)."""
        return np.asarray(self.coverage(frame, corner) @ self._basis)


class PaintWindows:
    """Windows that follow n spots of paint over one camera's frames.

    Parameters
    ----------
    half_px : (n,) float
        From a spot's centre to the edge of its window.
    paint : (n,) int
        Its paint: row of ``tables``.
    tables : (k, 65536) float32
        From :meth:`phytac_decoder.vision.segmentation.ColourModel.coverage_tables`.
    rivals : (n, r) int
        Spots of the same paint nearby, nearest first; n for none.
    size_px : (int, int)
        Width and height of the frames.
    stride : (n,) int
        2 reads every other pixel in both directions, and so on.
    """

    group_samples_max = 1 << 16
    """Samples of windows that are read together: larger arrays leave the processor's cache."""
    slack_px = 0.75
    """A window is placed and cut again after its spot has moved this far."""

    def __init__(
        self,
        *,
        half_px: FloatArray,
        paint: IntArray,
        tables: Floats32,
        rivals: IntArray,
        size_px: tuple[int, int],
        stride: IntArray,
    ) -> None:
        count = len(half_px)
        self._size, self._tables = np.array(size_px), tables
        self._rivals, self._paint, self._stride = rivals, paint, stride
        self._side = self._odd_side(half_px, stride)
        for step in np.unique(stride):
            # Few sizes, as each is read by itself, and few windows of the largest.
            own = self._side[stride == step]
            sizes = np.quantile(own, (0.4, 0.7, 0.9, 1.0), method="higher")
            self._side[stride == step] = sizes[np.searchsorted(sizes, own)]
        self._anchor = np.full((count, 2), np.inf)
        self._corner = np.zeros((count, 2), dtype=np.int64)
        self._groups = []
        for step, side in np.unique(np.column_stack([stride, self._side]), axis=0).tolist():
            spots = np.flatnonzero((self._side == side) & (stride == step))
            spots = spots[np.argsort(paint[spots], kind="stable")]
            samples = len(spots) * len(range(0, side, step)) ** 2
            for part in np.array_split(spots, -(-samples // self.group_samples_max)):
                self._groups.append(WindowGroup(part, paint[part], side, step, tables))

    @property
    def pixels(self) -> int:
        """Pixels read of each frame."""
        return sum(group.mask.size for group in self._groups)

    def look(self, frame: ImageArray, centre_px: FloatArray) -> Moments:
        """Moments of all spots, near where each is expected: (n, 2), finite."""
        moved = larger(centre_px - self._anchor) > self.slack_px
        if moved.any():
            self._place(moved, centre_px)
        sums = np.empty((len(moved), 4), dtype=np.float32)
        for group in self._groups:
            sums[group.spots] = group.sums(frame, self._corner[group.spots])
        return Moments.of(sums, self._corner)

    def look_wider(
        self, frame: ImageArray, spots: IntArray, centre_px: FloatArray, more_px: float
    ) -> Moments:
        """Moments of ``spots`` (m,) in windows that reach ``more_px`` farther than usual.

        ``centre_px`` (n, 2) is where all spots are expected: the others are rivals.
        """
        stride = self._stride[spots].min()
        half = self._side[spots].max() // 2 + more_px
        (side,) = self._odd_side(np.array([half]), stride)
        order = np.argsort(self._paint[spots], kind="stable")
        own = spots[order]
        group = WindowGroup(own, self._paint[own], int(side), int(stride), self._tables)
        corner = self._corners(centre_px[own], side)
        group.cut(np.arange(len(own)), self._lines(own, corner, centre_px))
        back = np.argsort(order)
        return Moments.of(group.sums(frame, corner)[back], corner[back])

    def border_weight(self, frame: ImageArray) -> FloatArray:
        """Paint (n,) px of each spot, as placed in the last look, on a border to a rival."""
        out = np.zeros(len(self._side))
        for group in self._groups:
            cover = group.coverage(frame, self._corner[group.spots])
            on_border = np.where(group.mask < 1.0, cover, 0.0).sum(axis=1)
            out[group.spots] = on_border * group.stride**2
        return out

    def _odd_side(self, half: FloatArray, stride: IntArray) -> IntArray:
        """Pixels per side (m,), an odd number of samples, that fits into the frame."""
        most = np.maximum((int(self._size.min()) - 1) // (2 * stride), 1)
        steps = np.clip(np.ceil(half / stride).astype(np.int64), 1, most)
        return np.asarray(2 * stride * steps + 1)

    def _corners(self, centre: FloatArray, side: IntArray) -> IntArray:
        """First column and row (m, 2) of windows around centres (m, 2)."""
        side = np.reshape(side, (-1, 1))
        corner = np.rint(centre).astype(np.int64) - side // 2
        return np.asarray(np.clip(corner, 0, self._size - side))

    def _lines(self, spots: IntArray, corner: IntArray, centre: FloatArray) -> Floats32:
        own = centre[spots]
        rivals = np.append(centre, [[1e6, 1e6]], axis=0)[self._rivals[spots]]
        return border_lines(own - corner, rivals - own[:, None])

    def _place(self, moved: BoolArray, centre: FloatArray) -> None:
        """Place windows of moved spots (n,) again; cut them and those of their rivals."""
        self._anchor[moved] = centre[moved]
        self._corner[moved] = self._corners(centre[moved], self._side[moved])
        near = moved | np.append(moved, False)[self._rivals].any(axis=1)
        lines = self._lines(np.flatnonzero(near), self._corner[near], centre)
        number = np.cumsum(near) - 1
        for group in self._groups:
            rows = np.flatnonzero(near[group.spots])
            if len(rows):
                group.cut(rows, lines[number[group.spots[rows]]])
