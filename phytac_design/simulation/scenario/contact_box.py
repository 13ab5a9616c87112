"""The part of a chart that contacts cover."""

import numpy as np

from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.scenario.contact_placement import ChartWindow
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

CELLS = 128
"""Cells along each axis of the chart in which the patches are looked up."""


def contact_box(surface: Surface, uv: FloatArray, reach_mm: FloatArray) -> ChartBox:
    """Box of the chart around all patches, to about a cell of ``CELLS`` and never less.

    Patches are sought in space, as pressure is (distances are chords), so seams and poles are
    places like any other. Without any patch the box is empty: the middle of the chart.

    Parameters
    ----------
    surface : Surface
        The outer face.
    uv : (m, 2) float
        Centres of patches.
    reach_mm : (m,) float
        Their sizes from the centre.
    """
    start, end = surface.domain.T
    if len(uv) == 0:
        middle = (start + end) / 2.0
        return ChartBox(low=middle, high=middle.copy(), whole=np.zeros(2, dtype=np.bool_))
    axes = [np.linspace(a, b, CELLS + 1) for a, b in zip(start, end, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    at = surface.point(grid.reshape(-1, 2))
    corner = at.reshape(CELLS + 1, CELLS + 1, 3)
    diagonal = max(
        float(np.linalg.norm(corner[1:, 1:] - corner[:-1, :-1], axis=2).max()),
        float(np.linalg.norm(corner[1:, :-1] - corner[:-1, 1:], axis=2).max()),
    )
    covered = np.zeros(len(at), dtype=np.bool_)
    for reach in np.unique(reach_mm):
        covered |= _near(at, surface.point(uv[reach_mm == reach]), float(reach) + diagonal)
    marks = covered.reshape(corner.shape[:2])
    box = [
        _covered(np.asarray(marks.any(axis=1 - k)), axes[k], closed=surface.periodic[k])
        for k in range(2)
    ]
    return ChartBox(
        low=np.array([low for low, _, _ in box]),
        high=np.array([high for _, high, _ in box]),
        whole=np.array([whole for _, _, whole in box]),
    )


def _near(at: FloatArray, centres: FloatArray, reach_mm: float) -> BoolArray:
    """Whether points (g, 3) lie within reach of any of the centres (m, 3), (g,)."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(centres).query(at, distance_upper_bound=reach_mm)
    return np.asarray(np.isfinite(distance))


def _covered(marks: BoolArray, stations: FloatArray, *, closed: bool) -> tuple[float, float, bool]:
    """Ends of the shortest interval around marked stations, and whether it is the whole axis."""
    first, last = float(stations[0]), float(stations[-1])
    held = np.flatnonzero(marks)
    if not closed:
        low, high = float(stations[held[0]]), float(stations[held[-1]])
        return low, high, bool(low <= first and high >= last)
    # The two ends of a closed axis are one station.
    held = np.unique(held % CELLS)
    gaps = np.diff(np.append(held, held[0] + CELLS))
    widest = int(np.argmax(gaps))
    if gaps[widest] <= 2:
        return first, last, True
    low = float(stations[held[(widest + 1) % len(held)]])
    return low, float(stations[held[widest]]), False


def window_grid(part: ChartWindow) -> FloatArray:
    """Places (m, 2) all over a part of the chart, no farther apart than cells of ``CELLS``."""
    share = np.linspace(0.0, 1.0, CELLS + 1)
    return part.at(np.stack(np.meshgrid(share, share, indexing="ij"), axis=-1).reshape(-1, 2))
