"""Lengths and areas along a chart, and their inverses."""

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

AREA_U, AREA_V = 256, 32
"""Cells of the tables of area."""


def _shares(steps: FloatArray) -> FloatArray:
    """Cumulative shares (..., k + 1) from 0 to 1 of non-negative steps (..., k)."""
    whole = np.concatenate([np.zeros_like(steps[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)
    return np.asarray(whole / whole[..., -1:])


def along_u(surface: Surface, shares: FloatArray) -> FloatArray:
    """Chart coordinates u (n,) at shares (n,) of the arc length along the middle of the chart."""
    cells = 1024  # interpolated they invert to about 1e-6 of the sensor
    (u0, u1), (v0, v1) = surface.domain
    edges = np.linspace(u0, u1, cells + 1)
    middle = (edges[:-1] + edges[1:]) / 2.0
    at = np.column_stack([middle, np.full(cells, (v0 + v1) / 2.0)])
    speed = np.sqrt(surface.metric(at)[:, 0, 0])
    if float(np.ptp(speed)) <= 1e-12 * float(speed.max()):
        return np.asarray(u0 + (u1 - u0) * shares)
    return np.interp(shares, _shares(speed), edges)


def area_elements(surface: Surface, u: FloatArray, v: FloatArray) -> FloatArray:
    """Area of the outer face per unit of chart, (u, v) grid, mm²."""
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    metric = surface.metric(grid)
    det = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    return np.asarray(np.sqrt(np.maximum(det, 0.0)).reshape(len(u), len(v)))


def by_area(surface: Surface, shares: FloatArray, *, inset_mm: float = 0.0) -> FloatArray:
    """Chart coordinates (n, 2) of places given by area, (n, 2) in [0, 1].

    The first share is the area with smaller u, the second the area with smaller v at that u: equal
    boxes of shares are equal areas of the surface. Area within ``inset_mm`` of an open edge (along
    the chart's lines) is excluded.
    """
    (u0, u1), (v0, v1) = _inset_domain(surface, inset_mm)
    edges_u, edges_v = np.linspace(u0, u1, AREA_U + 1), np.linspace(v0, v1, AREA_V + 1)
    middle_u, middle_v = (edges_u[:-1] + edges_u[1:]) / 2.0, (edges_v[:-1] + edges_v[1:]) / 2.0
    area = area_elements(surface, middle_u, middle_v)
    u = np.interp(shares[:, 0], _shares(area.sum(axis=1)), edges_u)
    bands = np.clip(np.searchsorted(edges_u, u, side="right") - 1, 0, AREA_U - 1)
    across = _shares(area)
    v = np.empty_like(u)
    for band in np.unique(bands):
        own = bands == band
        v[own] = np.interp(shares[own, 1], across[band], edges_v)
    return np.column_stack([u, v])


def _inset_domain(surface: Surface, inset_mm: float) -> FloatArray:
    """Chart limits (2, 2) moved in by ``inset_mm`` at open edges, half of the way at most.

    The move is measured where the chart is narrowest, so that it is nowhere less.
    """
    out = surface.domain.copy()
    for axis, end in surface.edges():
        low, high = surface.domain[axis]
        stations = np.linspace(0.0, 1.0, AREA_V + 1)
        from_edge = stations if end == 0 else 1.0 - stations
        across = np.linspace(surface.domain[1 - axis, 0], surface.domain[1 - axis, 1], 33)
        grid = np.empty((len(across), AREA_V + 1, 2))
        grid[..., axis] = low + (high - low) * from_edge
        grid[..., 1 - axis] = across[:, None]
        metric = surface.metric(grid.reshape(-1, 2))[:, axis, axis].reshape(grid.shape[:2])
        speed = np.sqrt(metric)
        steps = (speed[:, :-1] + speed[:, 1:]) / 2.0 * (high - low) / AREA_V
        far = np.concatenate([np.zeros((len(across), 1)), np.cumsum(steps, axis=1)], axis=1)
        share = max(float(np.interp(inset_mm, row, stations)) for row in far)
        share = min(share, 0.49)
        out[axis, end] = low + (high - low) * (share if end == 0 else 1.0 - share)
    return np.asarray(out)
