"""Flat maps of surfaces at 1:1, seen from outside, and their stretch.

Three ways, chosen by the surface's own metric:

- *exact*: the unwrapping, or for a cone the sector, keeps every length;
- *gores*: a surface of revolution that is curved both ways is cut along meridians. In each gore
  lengths along the middle meridian and around are true, and so are areas; towards its edges the
  paper is sheared by r'·(v − v_middle);
- *flattened*: anything else, by its unwrapping.

The stretch of a map is the singular values of its Jacobian against the metric: 1 is true to scale.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

MapKind = Literal["exact", "gores", "flattened"]
EXACT = 1e-6
"""Stretch off 1 that counts as none."""
GRID = 33
"""Stations each way at which the stretch is evaluated."""
BORDER = 181
"""Points along each edge."""

FlatMap = Callable[[FloatArray, IntArray], FloatArray]
"""Chart positions (n, 2) and the piece each belongs to (n,), to places on paper (n, 2) mm."""


@dataclass(frozen=True, kw_only=True)
class UnrolledSurface:
    """A surface on paper: x around to the right, y along *upwards*, mm.

    Attributes
    ----------
    kind : str
        ``exact``, ``gores`` or ``flattened``.
    pieces : int
        Pieces of paper, side by side.
    outline : tuple of (m, 2) float
        Closed outline of each piece.
    seams : tuple of (m, 2) float
        Edges that meet another edge on the sensor.
    stretch : (2,) float
        Least and greatest stretch anywhere.
    note : str
        How it was laid flat, for a reader.
    """

    surface: Surface
    kind: MapKind
    pieces: int
    outline: tuple[FloatArray, ...]
    seams: tuple[FloatArray, ...]
    stretch: FloatArray
    note: str
    flat: FlatMap

    def piece(self, uv: FloatArray) -> IntArray:
        """Piece that each chart position lies on, (n,)."""
        return _piece(self.surface, uv, self.pieces)

    def at(self, uv: FloatArray) -> FloatArray:
        """Places on paper (n, 2) of chart positions (n, 2)."""
        return self.flat(uv, self.piece(uv))

    def stretch_at(self, uv: FloatArray) -> FloatArray:
        """Least and greatest stretch at chart positions, (n, 2)."""
        return _stretch(self.surface, self.flat, uv, self.piece(uv))


def unroll(surface: Surface) -> UnrolledSurface:
    """Flatten a surface by the method with the least stretch."""
    grid = _grid(surface)
    one = np.zeros(len(grid), dtype=np.int64)

    def unwrap(uv: FloatArray, piece: IntArray) -> FloatArray:
        del piece
        return surface.unwrap(uv)

    stretch = _stretch(surface, unwrap, grid, one)
    if np.abs(stretch - 1.0).max() < EXACT:
        return _made(surface, unwrap, "exact", 1, "unrolled without stretch")
    if surface.periodic[1] and _round(surface, grid):
        sector = _sector(surface)
        if sector is not None:
            return _made(surface, sector, "exact", 1, "unrolled to a sector without stretch")
        pieces, gores = _gores(surface)
        note = f"cut into {pieces} gores: lengths along their middle and around are true"
        return _made(surface, gores, "gores", pieces, note)
    return _made(surface, unwrap, "flattened", 1, "pressed flat along its two middle lines")


def _made(
    surface: Surface, flat: FlatMap, kind: MapKind, pieces: int, note: str
) -> UnrolledSurface:
    (u0, u1), (v0, v1) = surface.domain
    u, width = np.linspace(u0, u1, BORDER), (v1 - v0) / pieces
    outline: list[FloatArray] = []
    seams: list[FloatArray] = []
    for k in range(pieces):
        own = np.full(BORDER, k)
        v = np.linspace(v0 + k * width, v0 + (k + 1) * width, BORDER)
        near, far = (flat(np.column_stack([np.full(BORDER, end), v]), own) for end in (u0, u1))
        left, right = (
            flat(np.column_stack([u, np.full(BORDER, side)]), own) for side in v[[0, -1]]
        )
        outline.append(np.concatenate([near, right[1:], far[::-1][1:], left[::-1][1:-1]]))
        if surface.periodic[1]:
            seams += [left, right]
    grid = _grid(surface)
    found = _stretch(surface, flat, grid, _piece(surface, grid, pieces))
    return UnrolledSurface(
        surface=surface,
        kind=kind,
        pieces=pieces,
        outline=tuple(outline),
        seams=tuple(seams),
        stretch=np.array([found[:, 0].min(), found[:, 1].max()]),
        note=note,
        flat=flat,
    )


def _grid(surface: Surface) -> FloatArray:
    """Chart positions all over the surface, off its poles, (GRID², 2)."""
    pole_share = 1e-3  # so near a pole, relative to the chart, directions around mean nothing
    (u0, u1), (v0, v1) = surface.domain
    off = pole_share * (u1 - u0) * np.array(surface.poles)
    u = np.linspace(u0 + off[0], u1 - off[1], GRID)
    v = v0 + (v1 - v0) * (np.arange(GRID) + 0.5) / GRID
    return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)


def _piece(surface: Surface, uv: FloatArray, pieces: int) -> IntArray:
    v0, v1 = surface.domain[1]
    share = np.floor((uv[:, 1] - v0) / (v1 - v0) * pieces)
    return np.asarray(np.clip(share, 0, pieces - 1).astype(np.int64))


def _stretch(surface: Surface, flat: FlatMap, uv: FloatArray, piece: IntArray) -> FloatArray:
    step_share = 1e-5  # of the differences, relative to the chart
    span = surface.domain[:, 1] - surface.domain[:, 0]
    low, high = surface.domain.T
    inside = np.clip(uv, low + 2 * step_share * span, high - 2 * step_share * span)
    columns = []
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = step_share * span[axis]
        columns.append((flat(inside + step, piece) - flat(inside - step, piece)) / 2.0)
    J = np.stack(columns, axis=2) / (step_share * span)
    # Singular values of J·T⁻¹, T a square root of the metric (M = TᵀT).
    T = np.linalg.cholesky(surface.metric(inside)).transpose(0, 2, 1)
    values = np.linalg.svd(J @ np.linalg.inv(T), compute_uv=False)
    return np.asarray(values[:, ::-1])


def _round(surface: Surface, grid: FloatArray) -> bool:
    """Whether the metric is independent of v and orthogonal (a surface of revolution)."""
    metric = surface.metric(grid).reshape(GRID, GRID, 2, 2)
    scale = np.abs(metric).max()
    same = np.abs(metric - metric[:, :1]).max() < EXACT * scale
    return bool(same and np.abs(metric[..., 0, 1]).max() < EXACT * scale)


def _radius(surface: Surface, u: FloatArray) -> FloatArray:
    """Length around per unit of v, (n,) mm."""
    at = np.column_stack([u, np.full(len(u), surface.domain[1, 0])])
    return np.asarray(np.sqrt(surface.metric(at)[:, 1, 1]))


def _along(surface: Surface, u: FloatArray) -> FloatArray:
    """Length along from the near end, (n,) mm."""
    at = np.column_stack([u, np.full(len(u), surface.domain[1, 0])])
    return np.asarray(surface.unwrap(at)[:, 1])


def _sector(surface: Surface) -> FlatMap | None:
    """Map of a cone to its sector; None if the radius does not change evenly along."""
    (u0, u1), (v0, v1) = surface.domain
    u = np.linspace(u0, u1, BORDER)
    r, s = _radius(surface, u), _along(surface, u)
    slope = (r[-1] - r[0]) / (s[-1] - s[0])
    if abs(slope) < EXACT or np.abs(r - r[0] - slope * (s - s[0])).max() > EXACT * r.max():
        return None

    def sector(uv: FloatArray, piece: IntArray) -> FloatArray:
        del piece
        far = (r[0] + slope * (_along(surface, uv[:, 0]) - s[0])) / slope
        angle = slope * (uv[:, 1] - (v0 + v1) / 2.0)
        return np.column_stack([far * np.sin(angle), far * np.cos(angle) - r[0] / slope])

    return sector


def _gores(surface: Surface) -> tuple[int, FlatMap]:
    """Number of gores, and the map to them."""
    gores_max = 8
    shear_max = 0.2  # shear at the edge of a gore that more gores are cut for
    (u0, u1), (v0, v1) = surface.domain
    u = np.linspace(u0, u1, BORDER)
    r, s = _radius(surface, u), _along(surface, u)
    slope = float(np.abs(np.diff(r) / np.diff(s)).max())
    pieces = int(np.clip(np.ceil(slope * (v1 - v0) / 2.0 / shear_max), 1, gores_max))
    width = (v1 - v0) / pieces
    paper = width * float(r.max())

    def gores(uv: FloatArray, piece: IntArray) -> FloatArray:
        middle = v0 + (piece + 0.5) * width
        around = _radius(surface, uv[:, 0]) * (uv[:, 1] - middle)
        return np.column_stack([(piece + 0.5) * paper + around, _along(surface, uv[:, 0])])

    return pieces, gores
