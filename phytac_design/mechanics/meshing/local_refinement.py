"""Lines of a product mesh that stay fine in one part of the chart and thin out elsewhere."""

import numpy as np

from phytac_design.mechanics.meshing.quad_grid import SETTINGS, limited, place
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


def thinned_lines(
    surface: Surface,
    axis: int,
    lines: FloatArray,
    *,
    part: tuple[float, float],
    margin_mm: float,
) -> FloatArray:
    """Positions of lines across ``axis``: the spacing of ``lines`` in a part, wider elsewhere.

    Parameters
    ----------
    surface : Surface
        The outer face.
    axis : int
        0 for lines at constant u, 1 for lines at constant v.
    lines : (k,) float
        Lines of the fine mesh, both limits included, ascending.
    part : (float, float)
        Where the part starts and ends. On a periodic axis it may run over the seam: the start then
        exceeds the end.
    margin_mm : float
        How far the fine spacing continues beyond the part, at least.
    """
    low, high = surface.domain[axis]
    period = float(high - low) if surface.periodic[axis] else np.inf
    x = np.linspace(low, high, SETTINGS.samples)
    spacing = np.interp(x, (lines[1:] + lines[:-1]) / 2.0, np.diff(lines))
    start, end = part
    if start > end:
        end += period
    # Distance beyond the part in chart units, and in the shortest millimetres of any line.
    beyond = np.min(
        [
            np.maximum.reduce([start - (x + turn), x + turn - end, np.zeros_like(x)])
            for turn in ((0.0,) if period == np.inf else (-period, 0.0, period))
        ],
        axis=0,
    )
    # Element size far from the part over that of the fine mesh. On a tube pressed in its middle the
    # tips are then off as on the mesh that is fine all over; at 3 twice, at 4 four times as much.
    coarsest = 2.5
    near = beyond * _shortest(surface, axis, x) <= margin_mm
    return place(x, limited(x, np.where(near, 1.0, coarsest) * spacing, period))


def _shortest(surface: Surface, axis: int, x: FloatArray) -> float:
    """Least length per unit of the chart along ``axis``, mm."""
    low, high = surface.domain[1 - axis]
    other = np.linspace(low, high, SETTINGS.cross_lines)
    uv = np.zeros((len(other), len(x), 2))
    uv[..., axis], uv[..., 1 - axis] = x, other[:, None]
    metric = surface.metric(uv.reshape(-1, 2))[:, axis, axis]
    return float(np.sqrt(metric.min()))
