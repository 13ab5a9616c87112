r"""Quadrilaterals on a dome: a square core around the pole, rings of nodes from there to the rim.

::

        +-----+-----+-----+        Rings have as many nodes as the core has around it. No corner
        |\    |     |    /|        collapses: the four corners of the core have three elements,
        | +---+-----+---+ |        every other inner node has four. The size along a ring follows
        +-|   |     |   |-+        the girth there, so elements keep their shape as the dome
        | |   |  o  |   | |        narrows.
        +-|   |     |   |-+
        | +---+-----+---+ |   o = pole
        |/    |     |    \|
        +-----+-----+-----+
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.meshing import quad_grid
from phytac_design.mechanics.meshing.quad_grid import QuadGrid, limited, place
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class DomeSettings:
    """Proportions of the core and the rings."""

    samples: int = 2049
    roundness: float = 0.45
    """Roundness of the core's outline: 0 a square, 1 a circle (whose corners would be flat)."""
    core_girth: float = 0.87
    """The core ends where the girth falls to this share of 2π times the distance from the pole."""
    max_core_share: float = 0.55
    """Largest share of the way from pole to rim that the core takes."""
    fade: float = 1.0
    """Distance over which rings become round, in core radii."""
    min_core_elements: int = 4
    """Elements across the core at least."""
    max_aspect: float = 3.0
    """An element is at most this much longer than wide: wide ones would waste few, narrow many."""


SETTINGS = DomeSettings()


def dome_grid(surface: Surface, *, offset_mm: float, size_mm: float) -> QuadGrid:
    """Grid of a surface with one pole, elements of about ``size_mm`` in the mean.

    Parameters
    ----------
    surface : Surface
        Closed around v, a pole at one end of u.
    offset_mm : float
        Face that the nodes lie on.
    size_mm : float
        Element size where the girth is that of the mean over the area.

    Raises
    ------
    DesignError
        If both ends are poles.
    """
    if surface.poles[0] == surface.poles[1]:
        raise DesignError(
            "mesh-pole-missing",
            f"mesh: surface '{surface.name}' must have a pole at one end (got {surface.poles}); "
            "open it at one end with a rim",
        )
    (u0, u1), (v0, v1) = surface.domain
    ends = (u1, u0) if surface.poles[1] else (u0, u1)
    u = np.linspace(*ends, SETTINGS.samples)
    s, girth, turn = _meridian(surface, u, offset_mm)
    width = girth / (2.0 * np.pi)  # distance from the axis where the surface is one of revolution
    mean = float(np.trapezoid(width**2, s) / np.trapezoid(width, s))
    half = max(SETTINGS.min_core_elements // 2, int(np.ceil(2.0 * np.pi * mean / size_mm / 8.0)))
    core = _core_radius(s, width)
    ring = np.arange(8 * half)
    inside, quads, rim = _core(half)
    plane = core * inside
    edge = plane[rim]
    even = -0.75 * np.pi + 2.0 * np.pi * ring / len(ring)
    angle = np.unwrap(np.arctan2(edge[:, 1], edge[:, 0]))
    angle += 2.0 * np.pi * np.rint((even - angle) / (2.0 * np.pi))
    radius = np.hypot(*edge.T)
    stations = _rings(s, width, turn, start=float(radius.mean()), count=len(ring))[1:, None]
    reach = min(SETTINGS.fade * core, float(s[-1] - radius.mean()))
    x = np.clip((stations - radius.mean()) / reach, 0.0, 1.0)
    fade = 1.0 - x * x * (3.0 - 2.0 * x)
    away = stations + (radius - radius.mean()) * fade
    turned = even + (angle - even) * fade
    ids = len(plane) + np.arange(stations.size * len(ring)).reshape(-1, len(ring))
    lines = np.concatenate([rim[None], ids])
    after = np.roll(lines, -1, axis=1)
    strip = np.stack([lines[:-1], lines[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    distance = np.concatenate([np.hypot(*plane.T), away.ravel()])
    bearing = np.concatenate([np.arctan2(plane[:, 1], plane[:, 0]), turned.ravel()])
    period = v1 - v0
    uv = np.column_stack(
        [np.interp(distance, s, u), v0 + np.mod(bearing / (2.0 * np.pi) * period, period)]
    )
    uv[ids[-1], 0] = ends[1]
    uv[distance == 0.0] = ends[0], v0
    name = "BOTTOM" if surface.poles[1] else "TOP"
    return QuadGrid(uv=uv, quads=np.concatenate([quads, strip]), sets={name: ids[-1].copy()})


def _meridian(
    surface: Surface, u: FloatArray, offset_mm: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distance from the pole (mm), girth (mm) and turn of the normal (rad) at u, (n,) each."""
    v0, v1 = surface.domain[1]
    uv = np.column_stack([u, np.full_like(u, v0)])
    point, normal = surface.point(uv, offset_mm), surface.normal(uv)
    step = np.linalg.norm(np.diff(point, axis=0), axis=1)
    bend = np.linalg.norm(np.diff(normal, axis=0), axis=1)
    girth = np.sqrt(surface.metric(uv)[:, 1, 1]) * (v1 - v0)
    return np.cumsum(np.append(0.0, step)), girth, np.cumsum(np.append(0.0, bend))


def _core_radius(s: FloatArray, width: FloatArray) -> float:
    """Where the core ends: before the dome's girth falls behind that of a disc."""
    narrow = width[1:] < SETTINGS.core_girth * s[1:]
    end = float(s[1:][np.argmax(narrow)]) if narrow.any() else np.inf
    return min(end, SETTINGS.max_core_share * float(s[-1]))


def _core(half: int) -> tuple[FloatArray, IntArray, IntArray]:
    """Nodes (n, 2) of the unit core, quads, and its outline from corner (−, −) anticlockwise."""
    side = np.arange(-half, half + 1)
    i, j = (k.ravel() for k in np.meshgrid(side, side, indexing="ij"))
    level = np.maximum(np.abs(i), np.abs(j))
    safe = np.maximum(level, 1)
    flat = np.abs(i) >= np.abs(j)
    # Angle of equal steps along the ring of the square that the node lies on.
    lean = np.where(flat, j, -i) / safe * np.where(flat, np.sign(i), np.sign(j)) * np.pi / 4.0
    base = np.where(flat, np.where(i >= 0, 0.0, np.pi), np.where(j > 0, 0.5, -0.5) * np.pi)
    m = level / half
    circle = m[:, None] * np.column_stack([np.cos(base + lean), np.sin(base + lean)])
    square = np.column_stack([i, j]) / half
    share = SETTINGS.roundness * m[:, None]
    nodes = (1.0 - share) * square + share * circle
    ids = np.arange(len(nodes)).reshape(2 * half + 1, -1)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], -1).reshape(-1, 4)
    rim = np.concatenate([ids[:-1, 0], ids[-1, :-1], ids[:0:-1, -1], ids[0, :0:-1]])
    return nodes / np.hypot(*nodes[rim].T).mean(), quads, rim


def _rings(
    s: FloatArray, width: FloatArray, turn: FloatArray, *, start: float, count: int
) -> FloatArray:
    """Distances of the rings from the pole: about square elements, shorter at the rim."""
    here = np.linspace(start, s[-1], 1025)
    across = 2.0 * np.pi * np.interp(here, s, width) / count
    bend = np.maximum(np.interp(here, s, np.gradient(turn, s)), 1e-12)
    limits = quad_grid.SETTINGS
    size = np.maximum(across, across.max() / SETTINGS.max_aspect)
    size = np.minimum(size, limits.max_turn_rad / bend)
    size[-1] *= limits.edge_fraction
    return place(here, limited(here, size))
