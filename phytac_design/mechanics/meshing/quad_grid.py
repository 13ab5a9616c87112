r"""Grids of quadrilaterals in the chart: what a mesh is before it becomes a wall.

A product grid has straight lines of nodes along u and v; their spacing follows a *size field* on
each axis: fine where the face bends and next to open edges, growing slowly away from there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

EDGE_NAMES = {(0, 0): "BOTTOM", (0, 1): "TOP", (1, 0): "LEFT", (1, 1): "RIGHT"}
"""Node set of each open edge (axis, end) of the chart."""


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """Size field of a grid."""

    max_turn_rad: float = float(np.radians(20.0))
    """Largest angle between the normals at the ends of an element's side."""
    growth: float = 0.3
    """Largest change of the element size per length along a line."""
    edge_fraction: float = 0.5
    """Element length next to an open edge, where clamped shells bend sharply, over that inside."""
    samples: int = 1025
    """Stations along an axis at which lengths and turns are taken."""
    cross_lines: int = 9
    """Lines along each axis that are sampled."""


SETTINGS = GridSettings()


@dataclass(frozen=True, kw_only=True)
class QuadGrid:
    """Quadrilaterals in the chart.

    Attributes
    ----------
    uv : (N, 2) float
        Chart coordinates of the nodes.
    quads : (E, 4) int
        Corners, all in the same sense.
    sets : mapping of str to (k,) int
        Nodes of each open edge, by ``EDGE_NAMES``.
    around : int or None
        Nodes of each line around, where all nodes come in such lines.
    """

    uv: FloatArray
    quads: IntArray
    sets: Mapping[str, IntArray] = field(default_factory=dict)
    around: int | None = None


def product_grid(surface: Surface, u: FloatArray, v: FloatArray) -> QuadGrid:
    """Grid of the lines ``u`` and ``v``; v without its last value where the chart closes."""
    closed = surface.periodic[1]
    if closed:
        v = v[:-1]
    ids = np.arange(len(u) * len(v)).reshape(len(u), len(v))
    after = np.roll(ids, -1, axis=1) if closed else ids[:, 1:]
    before = ids if closed else ids[:, :-1]
    quads = np.stack([before[:-1], after[:-1], after[1:], before[1:]], axis=-1).reshape(-1, 4)
    sides = {"BOTTOM": ids[0], "TOP": ids[-1], "LEFT": ids[:, 0], "RIGHT": ids[:, -1]}
    return QuadGrid(
        uv=np.column_stack([np.repeat(u, len(v)), np.tile(v, len(u))]),
        quads=quads,
        sets={EDGE_NAMES[edge]: sides[EDGE_NAMES[edge]].copy() for edge in surface.edges()},
        around=len(v) if closed else None,
    )


def axis_lines(
    surface: Surface,
    axis: int,
    *,
    offset_mm: float,
    size_mm: float,
    through: FloatArray | None = None,
) -> FloatArray:
    """Chart positions of lines across ``axis``, both limits included.

    Parameters
    ----------
    surface : Surface
        The outer face.
    axis : int
        0 for lines at constant u, 1 for lines at constant v.
    offset_mm : float
        Face that the nodes lie on, as in :meth:`Surface.point`.
    size_mm : float
        Largest distance between lines.
    through : (k,) float, optional
        Positions that must be lines.
    """
    x = np.linspace(surface.domain[axis, 0], surface.domain[axis, 1], SETTINGS.samples)
    length, turn = _steps(surface, axis, x, offset_mm)
    rate = np.maximum(length / size_mm, turn / SETTINGS.max_turn_rad) / (x[1] - x[0])
    size = 1.0 / np.maximum(rate, 1e-300)  # in chart units
    here = np.concatenate([size[:1], np.minimum(size[1:], size[:-1]), size[-1:]])
    open_ends = [end for side, end in surface.edges() if side == axis]
    for end in open_ends:
        here[-end] *= SETTINGS.edge_fraction
    period = x[-1] - x[0] if surface.periodic[axis] else np.inf
    return place(x, limited(x, here, period), through)


def limited(x: FloatArray, size: FloatArray, period: float = np.inf) -> FloatArray:
    """Size field (n,) at stations x (n,), cut so that it grows by 0.3 per length at most."""
    gap = np.abs(x[:, None] - x)
    gap = np.minimum(gap, np.abs(period - gap))
    return np.asarray(np.min(size + SETTINGS.growth * gap, axis=1))


def place(x: FloatArray, size: FloatArray, through: FloatArray | None = None) -> FloatArray:
    """Positions from x[0] to x[-1] spaced by the size field (n,), at least one step."""
    density = np.concatenate([[0.0], np.cumsum((0.5 / size[1:] + 0.5 / size[:-1]) * np.diff(x))])
    stops = x[[0, -1]]
    if through is not None and len(through):
        inner = np.unique(through)
        minimum = 1e-6 * (x[-1] - x[0])
        inner = inner[(inner > x[0] + minimum) & (inner < x[-1] - minimum)]
        inner = inner[np.diff(inner, prepend=-np.inf) > minimum]
        stops = np.concatenate([x[:1], inner, x[-1:]])
    at = np.interp(stops, x, density)
    counts = np.maximum(1, np.ceil(np.diff(at) - 1e-6)).astype(np.int64)
    marks = np.concatenate([[0], np.cumsum(counts)])
    wanted = np.interp(np.arange(marks[-1] + 1), marks, at)
    out: FloatArray = np.interp(wanted, density, x)
    out[marks] = stops
    return out


def _steps(
    surface: Surface, axis: int, x: FloatArray, offset_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Length (mm) and turn of the normal (rad) between stations, the largest of all lines."""
    low, high = surface.domain[1 - axis]
    other = np.linspace(low, high, SETTINGS.cross_lines)
    uv = np.zeros((len(other), len(x), 2))
    uv[..., axis], uv[..., 1 - axis] = x, other[:, None]
    flat = uv.reshape(-1, 2)
    point = surface.point(flat, offset_mm).reshape(len(other), len(x), 3)
    normal = surface.normal(flat).reshape(point.shape)
    length: FloatArray = np.linalg.norm(np.diff(point, axis=1), axis=2).max(axis=0)
    turn: FloatArray = np.linalg.norm(np.diff(normal, axis=1), axis=2).max(axis=0)
    return length, turn
