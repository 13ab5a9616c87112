"""Windows of one size, looked at in one go, and the borders that they are cut along."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.vision.colour_codes import Converter, Floats32, Picture
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

LAY_MOST = 1 << 20
"""Most borders times pixels that are laid in one go: 4 MB of numbers."""
BORDER_LEAST = 0.15
"""A border keeps at least this share of the way between two spots on either side."""


class Space:
    """Room for windows of so many samples, out of so many pixels."""

    def __init__(self, samples: int, pixels: int) -> None:
        self.cover: Floats32 = np.zeros((1, samples), dtype=np.float32)
        self.converter = Converter(pixels)

    @classmethod
    def of(cls, kinds: list[tuple[int, int, int]]) -> "Space":
        """Room for any of blocks of (spots, side, stride)."""
        rows = [
            (spots * len(range(0, side, stride)), side, stride) for spots, side, stride in kinds
        ]
        samples = [row * len(range(0, side, stride)) for row, side, stride in rows]
        return cls(max(samples, default=0), max((row * side for row, side, _ in rows), default=0))


class Block:
    """Windows of one size.

    Parameters
    ----------
    first, spots : int
        Their place in the order of all windows, and their number.
    side, stride : int
        Pixels a side, and from one sample to the next.
    paints : list of (int, int, (1, 65536) float32)
        Which windows are looked up in which table.
    space : Space
        Room for what is on the way; blocks share it.
    picture : Picture
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
        space: Space,
        picture: Picture,
    ) -> None:
        self.part = slice(first, first + spots)
        self.first, self.side, self.stride = first, side, stride
        self.offset = np.arange(0, side, stride, dtype=np.float32)
        taken = len(self.offset)
        each = taken**2
        self._cover = space.cover[0, : spots * each].reshape(spots, each)
        self._lookup = [
            (slice(start * each, stop * each), table, space.cover[:, start * each : stop * each])
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
        self._plane = np.ascontiguousarray(basis[:, :3].T, dtype=np.float32)
        self._picture, self._convert = picture, space.converter.part(spots * taken * side)
        self._rows = self._all_rows(picture.codes, 2)

    def _all_rows(self, image: NDArray[Any], size: int) -> NDArray[np.void]:
        """Every window there can be as the rows that it takes, each one item: copied as a whole.

        By their first pixels in the order of memory; ``size`` bytes a pixel.
        """
        height, width = image.shape[:2]
        return np.ndarray(
            ((height - self.side) * width + width - self.side + 1, len(self.offset)),
            np.dtype((np.void, size * self.side)),
            buffer=image,
            strides=(size, size * width * self.stride),
        )

    def cover(self, corner: IntArray) -> Floats32:
        """Coverage (spots, samples) in windows with these first pixels, as cut."""
        if self._picture.whole:
            codes = self._rows[corner].view(np.uint16)
        else:
            pixels = self._all_rows(self._picture.frame, 3)[corner].view(np.uint8)
            codes = self._convert.run(pixels.reshape(1, -1, 3))
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

    def lay(self, which: IntArray, cuts: "Cuts", rows: slice) -> None:
        """Cut windows ``which`` (m,) as ``rows`` of ``cuts`` say."""
        inside = cuts.inside[rows]
        need = inside.any(axis=1)
        self.mask[which[self.cut[which] & ~need]] = 1.0
        self.cut[which] = need
        self._any_cut = bool(self.cut.any())
        if not need.any():
            return
        crossing = np.flatnonzero(inside.any(axis=0))
        lines = cuts.lines[rows][need][:, crossing]
        laid, each = which[need], self._plane.shape[1]
        step = max(LAY_MOST // (len(crossing) * each), 1)
        for start in range(0, len(laid), step):
            # The nearest border counts; a matrix product has all of them in one go.
            some = lines[start : start + step]
            mask = (some.reshape(-1, 3) @ self._plane).reshape(*some.shape[:2], each).min(axis=1)
            self._mask[laid[start : start + step]] = np.maximum(np.minimum(mask, 1.0), 0.0)


class Cuts(NamedTuple):
    """Borders of m windows against r rivals each.

    A pixel at (x, y) from the window's corner counts ``lines · (1, x, y)``, between 0 and 1, with
    ``lines`` (m, r, 3); ``inside`` (m, r) are the borders that cross the window, ``nearest`` (m,)
    px is the nearest border's distance from the spot.
    """

    lines: Floats32
    inside: BoolArray
    nearest: FloatArray

    @classmethod
    def between(
        cls, own: FloatArray, rivals: FloatArray, skew: FloatArray, last: FloatArray
    ) -> "Cuts":
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
            lines=np.stack([far, -x, -y], axis=-1, dtype=np.float32, casting="same_kind"),
            inside=far - 1.0 < corner,
            nearest=border.min(axis=1, initial=np.inf),
        )
