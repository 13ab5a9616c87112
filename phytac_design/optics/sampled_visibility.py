"""Visible fraction of every marker from a few rays each, for the design search.

The exact z-buffer on a subset of its pixels: in a window around each marker's paint, every k-th
pixel of every k-th row. The marker's receptor is rendered alone, then all pieces of other parts
that reach a pixel of the grid are rendered into a second z-buffer. Where k is 1 (small markers) the
fraction is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Pinhole
from phytac_design.core.kernels import in_bands, kernel
from phytac_design.optics.raster import marker_windows, pieces_by_marker, project_scene
from phytac_design.optics.rays import pixel_rays
from phytac_design.optics.render_scene import FIRST_MARKER, RenderScene
from phytac_design.optics.zbuffer import Point, View, corner, fill, meets, outline, reach
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """Per marker, (n,): visible fraction, rays that met its paint alone, and in the scene."""

    fraction: FloatArray
    alone: IntArray
    visible: IntArray


def sampled_fraction(scene: RenderScene, camera: Camera, *, rays: int = 64) -> Sampled:
    """Visible fraction of every marker's paint from about ``rays`` rays through pixel centres.

    A marker with fewer pixels than that gets all of them and so its exact fraction; others get
    a square grid of their pixels, with at least about ``rays`` on the paint.
    """
    band = 32  # markers that a thread takes at a time; near ones cost more than far ones
    chunk = 32  # pieces of the fixed parts that are skipped together where they are far away
    view = project_scene(scene, camera, rays=np.empty((0, 0, 3)))
    pinhole = isinstance(camera.lens, Pinhole)
    chosen, starts = pieces_by_marker(scene, view)
    code = scene.part[view.source[chosen]]
    is_paint = (code >= FIRST_MARKER) & (code % 2 == FIRST_MARKER % 2)
    before = np.concatenate([[0], np.cumsum(is_paint)])
    windows = marker_windows(view, chosen[is_paint], before[starts], camera)
    grids = _grids(windows, _steps(view, chosen[is_paint], before[starts], rays))
    first = np.concatenate([[0], np.cumsum(grids[:, 3] * grids[:, 4])])
    directions = np.empty((0, 3))
    if not pinhole:
        directions = _directions(camera, grids, int(first[-1]))
    # Pieces that are looked at together: chunks of the fixed parts, then each receptor.
    bounds = np.concatenate([np.arange(0, starts[0], chunk), starts])
    boxes = np.empty((len(bounds) - 1, 5))

    def measure(low: int, high: int) -> None:
        _boxes(view, pinhole, chosen, bounds[low : high + 1], boxes[low:high])

    in_bands(measure, len(boxes))
    counts = np.zeros((scene.count, 2), dtype=np.int64)
    size = np.array([camera.width_px, camera.height_px])

    def some(low: int, high: int) -> None:
        _count(view, pinhole, chosen, bounds, boxes, low, grids, first, directions, scene.part,
               size, counts[low:high])  # fmt: skip

    in_bands(some, scene.count, band_rows=band)
    alone, visible = counts[:, 0], counts[:, 1]
    fraction = np.divide(visible, alone, out=np.zeros(scene.count), where=alone > 0)
    return Sampled(fraction=fraction, alone=alone, visible=visible)


def _steps(view: View, chosen: NDArray[np.int32], starts: IntArray, rays: int) -> IntArray:
    """Step between the pixels of each marker's grid, (n,)."""
    area = np.zeros(len(starts) - 1)
    _areas(view, chosen, starts, area)
    return np.maximum(1, np.floor(np.sqrt(area / rays))).astype(np.int64)


@kernel
def _areas(view: View, chosen: NDArray[np.int32], starts: IntArray, area: FloatArray) -> None:
    """Half of the area (n,) px² of each marker's pieces: the other half looks away."""
    for i in range(len(area)):
        for piece in chosen[starts[i] : starts[i + 1]]:
            a, b, c = outline(view, piece)
            twice = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
            if twice < np.inf:
                area[i] += twice / 4.0


def _grids(windows: IntArray, steps: IntArray) -> IntArray:
    """First column and row, step, columns and rows (n, 5) of each marker's grid."""
    half = steps[:, None] // 2
    counts = np.maximum(0, (windows[:, 2:] - half + steps[:, None] - 1) // steps[:, None])
    return np.column_stack([windows[:, :2] + half, steps, counts])


def _directions(camera: Camera, grids: IntArray, count: int) -> FloatArray:
    """Rays (count, 3) of all pixels of all grids, row by row."""
    pixels = np.concatenate(
        [
            np.stack(
                np.meshgrid(left + step * np.arange(columns), top + step * np.arange(rows)), axis=-1
            ).reshape(-1, 2)
            for left, top, step, columns, rows in grids.tolist()
        ]
    )
    inside = np.all((pixels >= 0) & (pixels < [camera.width_px, camera.height_px]), axis=1)
    out = np.empty((count, 3))
    x, y = pixels[inside].T
    out[inside] = pixel_rays(camera.lens)[y, x]
    out[~inside] = camera.lens.unproject(pixels[~inside].astype(np.float64))
    return out


@kernel
def _nearest(view: View, pinhole: bool, piece: int) -> float:
    """Upper bound of the inverse depth of a piece's pixels, as :func:`fill` measures it, 1/mm.

    The scene of a pinhole is cut before its plane, so that all depths are positive.
    """
    p, q, r = corner(view, piece, 0), corner(view, piece, 1), corner(view, piece, 2)
    if pinhole:
        return 1.0 / min(p[2], q[2], r[2])
    # No point of a triangle is farther from a corner than the other two are.
    far = max(_distance(p, q), _distance(p, r))
    least = _distance(p, (0.0, 0.0, 0.0)) - far
    return 1.0 / least if least > 0.0 else np.inf


@kernel
def _distance(p: Point, q: Point) -> float:
    return float(np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2))


@kernel
def _boxes(
    view: View,
    pinhole: bool,
    chosen: NDArray[np.int32],
    bounds: IntArray,
    boxes: FloatArray,
) -> None:
    """Boxes px of groups of pieces, and their greatest inverse depth, (g, 5)."""
    for g in range(len(boxes)):
        x0, y0, x1, y1, near = np.inf, np.inf, -np.inf, -np.inf, 0.0
        for piece in chosen[bounds[g] : bounds[g + 1]]:
            a, b, c, d = reach(view, piece)
            x0, y0, x1, y1 = min(x0, a), min(y0, b), max(x1, c), max(y1, d)
            near = max(near, _nearest(view, pinhole, piece))
        boxes[g, 0], boxes[g, 1], boxes[g, 2], boxes[g, 3], boxes[g, 4] = x0, y0, x1, y1, near


@kernel
def _gather(
    view: View,
    pinhole: bool,
    chosen: NDArray[np.int32],
    bounds: IntArray,
    boxes: FloatArray,
    grid: IntArray,
    farthest: float,
    own: int,
    near: NDArray[np.int32],
) -> int:
    """Write the pieces outside of group ``own`` that reach a grid into ``near``; how many.

    Without those that lie behind the inverse depth ``farthest``: they hide nothing before it.
    """
    left, top, step, columns, rows = grid
    count = 0
    for group in range(len(boxes)):
        x0, y0, x1, y1, nearest = boxes[group]
        if (
            group == own
            or nearest < farthest
            or not (meets(x0, x1, left, step, columns) and meets(y0, y1, top, step, rows))
        ):
            continue
        for piece in chosen[bounds[group] : bounds[group + 1]]:
            x0, y0, x1, y1 = reach(view, piece)
            if (
                meets(x0, x1, left, step, columns)
                and meets(y0, y1, top, step, rows)
                and _nearest(view, pinhole, piece) >= farthest
            ):
                near[count] = piece
                count += 1
    return count


@kernel
def _farthest(
    owner: NDArray[np.int32], inverse: FloatArray, codes: NDArray[np.int32], paint: int
) -> float:
    """Least inverse depth of a grid's pixels that show a paint; inf if none does."""
    least = np.inf
    for row in range(owner.shape[0]):
        for column in range(owner.shape[1]):
            t = owner[row, column]
            if t >= 0 and codes[t] == paint:
                least = min(least, inverse[row, column])
    return least


@kernel
def _count(
    view: View,
    pinhole: bool,
    chosen: NDArray[np.int32],
    bounds: IntArray,
    boxes: FloatArray,
    start: int,
    grids: IntArray,
    first: IntArray,
    directions: FloatArray,
    codes: NDArray[np.int32],
    size: IntArray,
    counts: IntArray,
) -> None:
    """Grid pixels of each marker's paint alone, and those of them that the scene leaves visible."""
    near = np.empty(len(view.source), dtype=np.int32)
    for i in range(start, start + len(counts)):
        left, top, step, columns, rows = grids[i]
        if rows == 0 or columns == 0:
            continue
        rays = np.empty((0, 0, 3))
        if len(directions):
            rays = directions[first[i] : first[i + 1]].reshape(rows, columns, 3)
        here = View(
            view.camera, view.triangles, view.image, view.bulge, view.source, view.lens, rays,
            np.array([left, top]), step,
        )  # fmt: skip
        grid, paint = (left, top, step, 0.0, 0.0), FIRST_MARKER + 2 * i
        own = len(boxes) - len(grids) + i
        alone = np.full((rows, columns), -1, dtype=np.int32)
        depth = np.zeros((rows, columns))
        fill(here, chosen[bounds[own] : bounds[own + 1]], grid, alone, depth)
        farthest = _farthest(alone, depth, codes, paint)
        found = _gather(view, pinhole, chosen, bounds, boxes, grids[i], farthest, own, near)
        other = np.full((rows, columns), -1, dtype=np.int32)
        front = np.zeros((rows, columns))
        # In the scene's order: of equal depths the first wins, as in the full image.
        fill(here, np.sort(near[:found]), grid, other, front)
        for row in range(rows):
            for column in range(columns):
                t = alone[row, column]
                if t < 0 or codes[t] != paint:
                    continue
                counts[i - start, 0] += 1
                x, y = left + step * column, top + step * row
                z, o = front[row, column], other[row, column]
                level = z == depth[row, column]
                if 0 <= x < size[0] and 0 <= y < size[1]:
                    counts[i - start, 1] += z < depth[row, column] or (level and t < o)
