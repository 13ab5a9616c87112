"""Pieces of triangles for lenses that bend lines: where on the image each one can reach.

A triangle is seen as a spherical triangle about the camera's centre; its edges are arcs of great
circles, whose images are curved. An arc of angle α strays from its chord by at most ``B α² / 8``,
where B bounds the second derivative of the lens's map across an arc. Triangles that would stray
far are split on the sphere. Pieces only say where to look: pixels are tested against the whole
triangle.
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

BULGE_PX = 1.5
RIM_PX = 16.0
"""Pieces whose edges may stray farther than this are split: inside, and across the field's rim."""
SPLITS_MAX = 12
ARC_MAX = 0.5
"""Longest arc of a piece, radians: the bound is one for short arcs."""
SAFETY = 1.5
"""On the sampled second derivative of the lens."""
BACK_RAD = np.deg2rad(174.0)
BACK_ARC = 0.05
"""Pieces that reach farther from the axis than this, once so short, may lie anywhere."""
MARGIN_RAD = 0.02
TABLE = 256
BORDER = 512
EVERYWHERE_PX = 1e9
DROP, KEEP, SPLIT = 0, 1, 2


class Reach:
    """How far a lens looks for its image, and how strongly it bends and stretches arcs.

    ``edge`` is the angle of the farthest pixel, radians; ``table`` (TABLE, 3) has angles up to it,
    and bounds up to each of the second derivative, px/rad², and the first, px/rad.
    """

    def __init__(self, lens: Lens) -> None:
        self.edge = _edge_rad(lens)
        angle = np.linspace(0.0, self.edge, TABLE)
        bend, stretch = _derivatives(lens, np.minimum(angle, lens.field_rad - 0.003))
        bounds = SAFETY * np.maximum.accumulate(np.column_stack([bend, stretch]), axis=0)
        self.table = np.column_stack([angle, bounds])


@lru_cache(maxsize=16)
def reach_of(lens: Lens) -> Reach:
    """The :class:`Reach` of a lens, kept for the last few."""
    return Reach(lens)


def _edge_rad(lens: Lens) -> float:
    """Angle of the farthest direction that any pixel sees, up to half an image beyond the frame."""
    w, h = lens.width_px, lens.height_px
    left, top, right, bottom = -w / 2.0 - 1.0, -h / 2.0 - 1.0, 1.5 * w + 1.0, 1.5 * h + 1.0
    x, y = np.linspace(left, right, BORDER), np.linspace(top, bottom, BORDER)
    border = np.concatenate(
        [np.column_stack([x, np.full_like(x, side)]) for side in (top, bottom)]
        + [np.column_stack([np.full_like(y, side), y]) for side in (left, right)]
    )
    rays = lens.unproject(border)
    if not np.isfinite(rays).all():
        return lens.field_rad
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return min(lens.field_rad, float(angle.max()) + MARGIN_RAD)


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


def spread(lens: Lens, directions: FloatArray, angle: FloatArray, edge: float) -> FloatArray:
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


def bent_view(
    points: FloatArray, triangles: NDArray[np.int32], camera: Camera, rays: FloatArray | None = None
) -> View:
    """Pieces of triangles (T, 3) with corners ``points`` (V, 3), camera frame, ready to fill.

    ``rays`` are the lens's pixel rays unless given (any shape with rows, for other windows).
    """
    lens = camera.lens
    reach = reach_of(lens)
    unit, angle, image = np.empty_like(points), np.empty(len(points)), np.empty((len(points), 2))

    def look(first: int, last: int) -> None:
        rows = slice(first, last)
        distance = np.linalg.norm(points[rows], axis=1)
        unit[rows] = points[rows] / np.where(distance > 0.0, distance, np.nan)[:, None]
        angle[rows] = _angle(unit[rows])
        image[rows] = spread(lens, unit[rows], angle[rows], reach.edge)

    in_bands(look, len(points))
    bulge = np.zeros(len(triangles))
    state = np.zeros(len(triangles), dtype=np.uint8)

    def some(first: int, last: int) -> None:
        rows = slice(first, last)
        _measure(unit, angle, triangles[rows], reach.table, bulge[rows], state[rows])

    in_bands(some, len(triangles))
    split = np.flatnonzero(state == SPLIT).astype(np.int32)
    finer = _split(lens, reach, unit[triangles[split]], split)
    count = int((state == KEEP).sum()) + len(finer[2])
    corners, pieces = np.empty((count, 3), dtype=np.int32), np.empty((count, 3, 2))
    bulges, sources = np.empty(count), np.empty(count, dtype=np.int32)
    _merge(triangles, image, bulge, state, finer, (corners, pieces, bulges, sources))
    return View(
        camera=points,
        triangles=corners,
        image=pieces,
        bulge=bulges,
        source=sources,
        lens=np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px]),
        rays=pixel_rays(lens) if rays is None else rays,
        origin=np.zeros(2, dtype=np.int64),
    )


Pieces = tuple[FloatArray, FloatArray, NDArray[np.int32]]
"""Corners on the image (P, 3, 2) px, bulge (P,) px and triangle (P,) of pieces."""


def _split(lens: Lens, reach: Reach, corner: FloatArray, source: NDArray[np.int32]) -> Pieces:
    """Pieces of triangles with unit corners (T, 3, 3) that stray little enough, by triangle."""
    done: list[Pieces] = [(np.empty((0, 3, 2)), np.empty(0), np.empty(0, dtype=np.int32))]
    for left in reversed(range(SPLITS_MAX)):
        if not len(source):
            break
        corner, source = _quarters(corner), np.repeat(source, 4)
        flat = np.ascontiguousarray(corner.reshape(-1, 3))
        index = np.arange(len(flat), dtype=np.int32).reshape(-1, 3)
        bulge, state = np.zeros(len(index)), np.zeros(len(index), dtype=np.uint8)
        angle = _angle(flat)
        _measure(flat, angle, index, reach.table, bulge, state)
        again = state == SPLIT
        # The last ones are too fine to split on: let them reach anywhere they may.
        whole = (state == KEEP) | (again & (left == 0))
        kept = index[whole].ravel()
        pixels = spread(lens, flat[kept], angle[kept], reach.edge).reshape(-1, 3, 2)
        done.append((pixels, bulge[whole], source[whole]))
        corner, source = corner[again], source[again]
    pieces, bulges, sources = (np.concatenate(part) for part in zip(*done, strict=True))
    order = np.argsort(sources, kind="stable")
    return np.ascontiguousarray(pieces[order]), bulges[order], sources[order]


@kernel
def _merge(
    triangles: NDArray[np.int32],
    image: FloatArray,
    bulge: FloatArray,
    state: NDArray[np.uint8],
    finer: Pieces,
    out: tuple[NDArray[np.int32], FloatArray, FloatArray, NDArray[np.int32]],
) -> None:
    """Write kept triangles and ``finer`` pieces of split ones, in the order of the triangles.

    ``out`` gets the triangles' corners, the pieces' corners on the image, bulge and triangle.
    """
    pieces, bulges, sources = finer
    corners, pixels, reaches, names = out
    at, piece = 0, 0
    for t in range(len(triangles)):
        count = 1 if state[t] == KEEP else 0
        while state[t] == SPLIT and piece + count < len(sources) and sources[piece + count] == t:
            count += 1
        for k in range(count):
            for i in range(3):
                corners[at, i] = triangles[t, i]
                for axis in range(2):
                    if state[t] == KEEP:
                        pixels[at, i, axis] = image[triangles[t, i], axis]
                    else:
                        pixels[at, i, axis] = pieces[piece + k, i, axis]
            reaches[at] = bulge[t] if state[t] == KEEP else bulges[piece + k]
            names[at] = t
            at += 1
        if state[t] == SPLIT:
            piece += count


@kernel
def _measure(
    unit: FloatArray,
    angle: FloatArray,
    triangles: NDArray[np.int32],
    table: FloatArray,
    bulge: FloatArray,
    state: NDArray[np.uint8],
) -> None:
    """Bulge (P,) px of pieces, and whether to keep, split or drop each; ``table`` (TABLE, 3)."""
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
        limit = BULGE_PX
        row = min(int(far / edge * cells) + 1, cells)
        bulge[t] = table[row, 1] * arc * arc / 8.0 + 1e-6
        if far >= edge:  # The continued map has a kink: an arc strays no farther than it is long.
            limit = RIM_PX
            bulge[t] = max(bulge[t], (table[-1, 2] + 1.0) * arc)
        if far > BACK_RAD:
            bulge[t] = EVERYWHERE_PX
            limit = EVERYWHERE_PX if arc <= BACK_ARC else 0.0
        state[t] = SPLIT if bulge[t] > limit or arc > ARC_MAX else KEEP


def _quarters(corner: FloatArray) -> FloatArray:
    """Four pieces (4 P, 3, 3) of each, cut at the middle directions of the edges."""
    middle = corner + corner[:, [1, 2, 0]]
    size = np.linalg.norm(middle, axis=2, keepdims=True)
    middle /= np.where(size > 0.0, size, 1.0)
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    ab, bc, ca = middle[:, 0], middle[:, 1], middle[:, 2]
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)
