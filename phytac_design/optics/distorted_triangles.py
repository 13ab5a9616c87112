"""Bounds of triangles on the image of a lens with distortion.

A triangle appears as a spherical triangle about the camera's centre; its edges are arcs of great
circles, whose images are curved. An arc of angle α deviates from its chord by at most ``B α² / 8``,
where B bounds the second derivative of the lens's map across an arc. Triangles with a large
deviation are split on the sphere. The pieces only bound the search: pixels are tested against the
full triangle.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Lens
from phytac_design.core.kernels import in_bands, kernel
from phytac_design.optics.rays import pixel_rays
from phytac_design.optics.zbuffer import View
from phytac_shapes.arrays import FloatArray

DROP, KEEP, SPLIT = 0, 1, 2


class LensBounds:
    """Field of a lens, and how strongly it bends and stretches arcs.

    ``edge`` is the angle of the farthest pixel, radians; ``table`` (m, 3) has angles up to it,
    and bounds up to each of the second derivative, px/rad², and the first, px/rad.
    """

    def __init__(self, lens: Lens) -> None:
        table = 256
        safety = 1.5  # on the sampled second derivative of the lens
        self.edge = _edge_rad(lens)
        angle = np.linspace(0.0, self.edge, table)
        bend, stretch = _derivatives(lens, np.minimum(angle, lens.field_rad - 0.003))
        bounds = safety * np.maximum.accumulate(np.column_stack([bend, stretch]), axis=0)
        self.table = np.column_stack([angle, bounds])


@lru_cache(maxsize=16)
def lens_bounds(lens: Lens) -> LensBounds:
    """The :class:`LensBounds` of a lens, kept for the last few."""
    return LensBounds(lens)


def _edge_rad(lens: Lens) -> float:
    """Angle of the farthest direction that any pixel sees, up to half an image beyond the frame."""
    margin_rad = 0.02
    w, h = lens.width_px, lens.height_px
    left, top, right, bottom = -w / 2.0 - 1.0, -h / 2.0 - 1.0, 1.5 * w + 1.0, 1.5 * h + 1.0
    x, y = np.linspace(left, right, 512), np.linspace(top, bottom, 512)
    border = np.concatenate(
        [np.column_stack([x, np.full_like(x, side)]) for side in (top, bottom)]
        + [np.column_stack([np.full_like(y, side), y]) for side in (left, right)]
    )
    rays = lens.unproject(border)
    if not np.isfinite(rays).all():
        return lens.field_rad
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return min(lens.field_rad, float(angle.max()) + margin_rad)


def _derivatives(lens: Lens, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Largest second derivative across, and first derivative along, arcs at angles (m,)."""
    step = 1e-3
    turn = 2.0 * np.pi * np.arange(12) / 12.0
    heading = np.pi * np.arange(6) / 6.0
    t, p, g = (a.ravel() for a in np.meshgrid(angle, turn, heading, indexing="ij"))
    sine, cosine = np.sin(t), np.cos(t)
    here = np.column_stack([sine * np.cos(p), sine * np.sin(p), cosine])
    away = np.column_stack([cosine * np.cos(p), cosine * np.sin(p), -sine])
    aside = np.column_stack([-np.sin(p), np.cos(p), np.zeros_like(p)])
    along = np.cos(g)[:, None] * away + np.sin(g)[:, None] * aside
    ahead = lens.project(np.cos(step) * here + np.sin(step) * along)
    behind = lens.project(np.cos(step) * here - np.sin(step) * along)
    second = (ahead - 2.0 * lens.project(here) + behind) / step**2
    first = (ahead - behind) / (2.0 * step)
    speed = np.linalg.norm(first, axis=1)
    across = np.abs(second[:, 0] * first[:, 1] - second[:, 1] * first[:, 0]) / speed
    # Fast along the arc as well: where the speed changes, the chord's parameter is not the arc's.
    shape = (len(angle), -1)
    bend = np.nan_to_num(across).reshape(shape).max(axis=1)
    return bend, np.nan_to_num(speed).reshape(shape).max(axis=1)


def _angle(directions: FloatArray) -> FloatArray:
    """Angle from the axis, same shape without the last axis."""
    off = np.hypot(directions[..., 0], directions[..., 1])
    return np.asarray(np.arctan2(off, directions[..., 2]))


def project_beyond(
    lens: Lens, directions: FloatArray, angle: FloatArray, edge: float
) -> FloatArray:
    """Pixels (n, 2) of unit directions (n, 3), continued straight out beyond the angle ``edge``.

    ``angle`` (n,) is theirs from the axis.
    """
    out = lens.project(directions)
    far = np.flatnonzero(~(angle < edge))
    if len(far):
        d = directions[far]
        off = np.hypot(d[:, 0], d[:, 1])
        unit = np.where(off[:, None] > 0.0, d[:, :2] / np.maximum(off, 1e-300)[:, None], [1.0, 0.0])
        rim = np.column_stack([np.sin(edge) * unit, np.full(len(far), np.cos(edge))])
        beyond = (angle[far] - edge)[:, None] * unit * lens.focal_px
        out[far] = lens.project(rim) + beyond
    return out


def distorted_view(
    points: FloatArray, triangles: NDArray[np.int32], camera: Camera, rays: FloatArray | None = None
) -> View:
    """Pieces of triangles (T, 3) with corners ``points`` (V, 3), camera frame, ready to fill.

    ``rays`` are the lens's pixel rays unless given (any shape with rows, for other windows).
    """
    lens = camera.lens
    reach = lens_bounds(lens)
    unit, angle, image = np.empty_like(points), np.empty(len(points)), np.empty((len(points), 2))

    def look(first: int, last: int) -> None:
        rows = slice(first, last)
        distance = np.linalg.norm(points[rows], axis=1)
        unit[rows] = points[rows] / np.where(distance > 0.0, distance, np.nan)[:, None]
        angle[rows] = _angle(unit[rows])
        image[rows] = project_beyond(lens, unit[rows], angle[rows], reach.edge)

    in_bands(look, len(points))
    bulge = np.zeros(len(triangles))
    state = np.zeros(len(triangles), dtype=np.uint8)

    def some(first: int, last: int) -> None:
        rows = slice(first, last)
        _measure(unit, angle, triangles[rows], reach.table, bulge[rows], state[rows])

    in_bands(some, len(triangles))
    split = np.flatnonzero(state == SPLIT).astype(np.int32)
    pieces, bulges, sources = _split(lens, reach, unit[triangles[split]], split)
    kept = np.flatnonzero(state == KEEP).astype(np.int32)
    sources = np.concatenate([kept, sources])
    order = np.argsort(sources, kind="stable")
    sources = sources[order]
    return View(
        camera=points,
        triangles=triangles[sources],
        image=np.concatenate([image[triangles[kept]], pieces])[order],
        bulge=np.concatenate([bulge[kept], bulges])[order],
        source=sources,
        lens=np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px]),
        rays=pixel_rays(lens) if rays is None else rays,
        origin=np.zeros(2, dtype=np.int64),
    )


Pieces = tuple[FloatArray, FloatArray, NDArray[np.int32]]
"""Corners on the image (P, 3, 2) px, bulge (P,) px and triangle (P,) of pieces."""


def _split(lens: Lens, reach: LensBounds, corner: FloatArray, source: NDArray[np.int32]) -> Pieces:
    """Pieces of triangles with unit corners (T, 3, 3) with small deviations."""
    splits_max = 12
    done: list[Pieces] = [(np.empty((0, 3, 2)), np.empty(0), np.empty(0, dtype=np.int32))]
    for level in range(splits_max):
        if not len(source):
            break
        corner, source = _quarters(corner), np.repeat(source, 4)
        flat = np.ascontiguousarray(corner.reshape(-1, 3))
        index = np.arange(len(flat), dtype=np.int32).reshape(-1, 3)
        bulge, state = np.zeros(len(index)), np.zeros(len(index), dtype=np.uint8)
        angle = _angle(flat)
        _measure(flat, angle, index, reach.table, bulge, state)
        again = state == SPLIT
        # The last level is kept as it is, with its large bound.
        finished = (state == KEEP) | (again & (level == splits_max - 1))
        kept = index[finished].ravel()
        pixels = project_beyond(lens, flat[kept], angle[kept], reach.edge).reshape(-1, 3, 2)
        done.append((pixels, bulge[finished], source[finished]))
        corner, source = corner[again], source[again]
    pieces, bulges, sources = (np.concatenate(part) for part in zip(*done, strict=True))
    return pieces, bulges, sources


@kernel
def _measure(
    unit: FloatArray,
    angle: FloatArray,
    triangles: NDArray[np.int32],
    table: FloatArray,
    bulge: FloatArray,
    state: NDArray[np.uint8],
) -> None:
    """Bulge (P,) px of pieces, and KEEP, SPLIT or DROP; ``table`` of LensBounds."""
    everywhere_px = 1e9
    # Pieces beyond this angle from the axis, and so short, are unbounded.
    back_rad, back_arc = np.deg2rad(174.0), 0.05
    arc_max = 0.5  # longest arc of a piece, radians: the bound holds for short arcs
    # Pieces with a larger bulge are split: inside, and across the border of the field.
    bulge_px, rim_px = 1.5, 16.0
    edge, cells = table[-1, 0], len(table) - 1
    for t in range(len(triangles)):
        arc, least, most = 0.0, np.inf, 0.0
        for i in range(3):
            p, q = triangles[t, i], triangles[t, (i + 1) % 3]
            x, y, z = unit[p, 0] - unit[q, 0], unit[p, 1] - unit[q, 1], unit[p, 2] - unit[q, 2]
            arc = max(arc, x * x + y * y + z * z)
            least, most = min(least, angle[p]), max(most, angle[p])
        arc = 2.0 * np.arcsin(min(np.sqrt(arc) / 2.0, 1.0))
        far = most + arc
        if not least - arc <= edge:  # Also where a corner is the camera's centre, NaN.
            state[t] = DROP
            continue
        limit = bulge_px
        row = min(int(far / edge * cells) + 1, cells)
        bulge[t] = table[row, 1] * arc * arc / 8.0 + 1e-6
        if far >= edge:  # The extrapolated map has a kink: the bound is the length of the arc.
            limit = rim_px
            bulge[t] = max(bulge[t], (table[-1, 2] + 1.0) * arc)
        if far > back_rad:
            bulge[t] = everywhere_px
            limit = everywhere_px if arc <= back_arc else 0.0
        state[t] = SPLIT if bulge[t] > limit or arc > arc_max else KEEP


def _quarters(corner: FloatArray) -> FloatArray:
    """Four pieces (4 P, 3, 3) of each, cut at the middle directions of the edges."""
    middle = corner + corner[:, [1, 2, 0]]
    size = np.linalg.norm(middle, axis=2, keepdims=True)
    middle /= np.where(size > 0.0, size, 1.0)
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    ab, bc, ca = middle[:, 0], middle[:, 1], middle[:, 2]
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)
