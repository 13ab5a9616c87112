"""Visible fraction of every marker from a few rays each, for the design search.

The exact z-buffer on a subset of its pixels: in a window around each marker's paint, every k-th
pixel of every k-th row. The marker's receptor is rendered alone, then all pieces of other parts
that reach a pixel of the grid and are nearer than the farthest paint are rendered into a second
z-buffer. Where k is 1 (small markers) the fraction is exact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Pinhole
from phytac_design.core.kernels import in_bands, kernel
from phytac_design.optics.raster import marker_windows, pieces_by_marker, project_scene
from phytac_design.optics.rays import ray_grid
from phytac_design.optics.render_scene import FIRST_MARKER, RenderScene
from phytac_design.optics.zbuffer import Grid, View, corner, fill, meets, outline, reach
from phytac_shapes.arrays import FloatArray, IntArray

RAYS = 64
"""Rays per marker, about; see ``sampled_fraction``."""
CHUNK = 32
"""Pieces of the fixed parts that are looked at together."""


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """Per marker, (n,): visible fraction, rays that met its paint alone, and in the scene."""

    fraction: FloatArray
    alone: IntArray
    visible: IntArray


def sampled_fraction(scene: RenderScene, camera: Camera, *, rays: int = RAYS) -> Sampled:
    """Visible fraction of every marker's paint from about ``rays`` rays through pixel centres.

    A marker with fewer pixels than that gets all of them and so its exact fraction; others get
    a square grid of their pixels, with at least about ``rays`` on the paint.
    """
    band = 32  # markers that a thread takes at a time; near ones cost more than far ones
    view = project_scene(scene, camera, rays=np.empty((0, 0, 3)))
    chosen, starts = pieces_by_marker(scene, view)
    code = scene.part[view.source[chosen]]
    is_paint = (code >= FIRST_MARKER) & (code % 2 == FIRST_MARKER % 2)
    before = np.concatenate([[0], np.cumsum(is_paint)])
    windows = marker_windows(view, chosen[is_paint], before[starts], camera)
    grids = _grids(windows, _steps(view, chosen[is_paint], before[starts], rays))
    first = np.concatenate([[0], np.cumsum(grids[:, 3] * grids[:, 4])])
    directions = np.empty((0, 3))
    straight = isinstance(camera.lens, Pinhole)
    if not straight:
        pixels = np.empty((first[-1], 2), dtype=np.int64)
        _pixels(grids, pixels)
        directions = ray_grid(camera.lens).at(pixels)
    groups = _groups(view, chosen, starts, straight)
    tiles = _tiles(groups[1], camera, windows)
    counts = np.zeros((scene.count, 2), dtype=np.int64)
    size = np.array([camera.width_px, camera.height_px])

    def some(low: int, high: int) -> None:
        _count(view, chosen, groups, tiles, low, grids, first, directions, scene.part, size,
               counts[low:high])  # fmt: skip

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


@kernel
def _pixels(grids: IntArray, pixels: IntArray) -> None:
    """All pixels (x, y) of all grids, row by row."""
    at = 0
    for i in range(len(grids)):
        left, top, step, columns, rows = grids[i]
        for row in range(rows):
            for column in range(columns):
                pixels[at, 0], pixels[at, 1] = left + step * column, top + step * row
                at += 1


Groups = tuple[IntArray, FloatArray, FloatArray]
"""Starts (g + 1,) of the groups in the list of pieces, their boxes (g, 4) px, and the greatest
1 / z (pinhole) or 1 / distance that any of their pixels can have (g,). First come chunks of the
fixed parts, then one group for each marker."""


def _groups(view: View, chosen: NDArray[np.int32], starts: IntArray, straight: bool) -> Groups:
    """Pieces that are looked at together: each receptor, and chunks of the fixed parts."""
    bounds = np.concatenate([np.arange(0, starts[0], CHUNK), starts])
    boxes, nearest = np.empty((len(bounds) - 1, 4)), np.empty(len(bounds) - 1)

    def some(low: int, high: int) -> None:
        rows = slice(low, high)
        _measure(view, chosen, bounds[low : high + 1], straight, boxes[rows], nearest[rows])

    in_bands(some, len(nearest))
    return bounds, boxes, nearest


@kernel
def _nearest(view: View, piece: int, straight: bool) -> float:
    """Upper bound of 1 / z, or of 1 / distance, over a piece."""
    p, q, r = corner(view, piece, 0), corner(view, piece, 1), corner(view, piece, 2)
    if straight:
        return float(1.0 / min(p[2], q[2], r[2]))
    x, y, z = (p[0] + q[0] + r[0]) / 3.0, (p[1] + q[1] + r[1]) / 3.0, (p[2] + q[2] + r[2]) / 3.0
    wide = 0.0
    for end in (p, q, r):
        dx, dy, dz = end[0] - x, end[1] - y, end[2] - z
        wide = max(wide, dx * dx + dy * dy + dz * dz)
    least = np.sqrt(x * x + y * y + z * z) - np.sqrt(wide)
    return float(1.0 / least) if least > 0.0 else np.inf


@kernel
def _measure(
    view: View,
    chosen: NDArray[np.int32],
    bounds: IntArray,
    straight: bool,
    boxes: FloatArray,
    nearest: FloatArray,
) -> None:
    """Boxes and bounds of the depth of groups of pieces."""
    for g in range(len(nearest)):
        x0, y0, x1, y1, most = np.inf, np.inf, -np.inf, -np.inf, 0.0
        for piece in chosen[bounds[g] : bounds[g + 1]]:
            a, b, c, d = reach(view, piece)
            x0, y0, x1, y1 = min(x0, a), min(y0, b), max(x1, c), max(y1, d)
            most = max(most, _nearest(view, piece, straight))
        boxes[g, 0], boxes[g, 1], boxes[g, 2], boxes[g, 3] = x0, y0, x1, y1
        nearest[g] = most


Tiles = tuple[IntArray, NDArray[np.int32], tuple[int, int, int]]
"""Start of each tile's list, the lists of groups one after the other, and (tiles per row, per
column, side in px)."""


def _tiles(boxes: FloatArray, camera: Camera, windows: IntArray) -> Tiles:
    """Groups that can reach each square tile of the image."""
    tiles_px = (8, 64)  # least and largest side of a tile; about a marker wide
    side = int(np.clip(np.median(windows[:, 2:]), *tiles_px)) if len(windows) else tiles_px[1]
    layout = (camera.width_px // side + 1, camera.height_px // side + 1, side)
    starts = np.zeros(layout[0] * layout[1] + 1, dtype=np.int64)
    _fill_tiles(boxes, layout, starts, np.zeros(0, dtype=np.int32))
    np.cumsum(starts, out=starts)
    lists = np.zeros(int(starts[-1]), dtype=np.int32)
    if len(lists):
        _fill_tiles(boxes, layout, starts.copy(), lists)
    return starts, lists, layout


@kernel
def _fill_tiles(
    boxes: FloatArray, layout: tuple[int, int, int], starts: IntArray, lists: NDArray[np.int32]
) -> None:
    """Count the groups of each tile into ``starts[tile + 1]``, or write them, if lists has room."""
    wide, high, side = layout
    for group in range(len(boxes)):
        x0, y0, x1, y1 = boxes[group]
        if not (x1 >= 0.0 and y1 >= 0.0 and x0 < wide * side and y0 < high * side):
            continue
        last_row, last_column = min(high - 1.0, y1 // side), min(wide - 1.0, x1 // side)
        for row in range(int(max(0.0, y0 // side)), int(last_row) + 1):
            for column in range(int(max(0.0, x0 // side)), int(last_column) + 1):
                tile = row * wide + column
                if len(lists) == 0:
                    starts[tile + 1] += 1
                else:
                    lists[starts[tile]] = group
                    starts[tile] += 1


@kernel
def _gather(
    view: View,
    chosen: NDArray[np.int32],
    groups: Groups,
    tiles: Tiles,
    grid: tuple[Grid, int, int],
    wanted: tuple[int, float, bool],
    stamp: NDArray[np.int32],
    near: NDArray[np.int32],
) -> int:
    """Write the pieces that may lie before a marker's paint into ``near``; how many there are.

    ``wanted`` is the marker's own group, which is excluded, the least 1 / z or 1 / distance of its
    paint, and which of the two it is. ``stamp`` says which marker last met each group.
    """
    bounds, boxes, nearest = groups
    starts, lists, (wide, high, side) = tiles
    (left, top, step, _, _), rows, columns = grid
    own, far, straight = wanted
    right, bottom = left + step * (columns - 1), top + step * (rows - 1)
    count = 0
    for row in range(max(0, top // side), min(high - 1, bottom // side) + 1):
        for column in range(max(0, left // side), min(wide - 1, right // side) + 1):
            tile = row * wide + column
            for group in lists[starts[tile] : starts[tile + 1]]:
                if group == own or stamp[group] == own or nearest[group] < far:
                    continue
                stamp[group] = own
                x0, y0, x1, y1 = boxes[group]
                if not (meets(x0, x1, left, step, columns) and meets(y0, y1, top, step, rows)):
                    continue
                for piece in chosen[bounds[group] : bounds[group + 1]]:
                    x0, y0, x1, y1 = reach(view, piece)
                    if (
                        meets(x0, x1, left, step, columns)
                        and meets(y0, y1, top, step, rows)
                        and _nearest(view, piece, straight) >= far
                    ):
                        near[count] = piece
                        count += 1
    return count


@kernel
def _paint(
    alone: NDArray[np.int32], depth: FloatArray, codes: NDArray[np.int32], paint: int
) -> tuple[int, float]:
    """Pixels of a marker's paint alone, and the least 1 / z or 1 / distance of them."""
    count, far = 0, np.inf
    for row in range(alone.shape[0]):
        for column in range(alone.shape[1]):
            t = alone[row, column]
            if t >= 0 and codes[t] == paint:
                count += 1
                far = min(far, depth[row, column])
    return count, far


@kernel
def _count(
    view: View,
    chosen: NDArray[np.int32],
    groups: Groups,
    tiles: Tiles,
    start: int,
    grids: IntArray,
    first: IntArray,
    directions: FloatArray,
    codes: NDArray[np.int32],
    size: IntArray,
    counts: IntArray,
) -> None:
    """Grid pixels of each marker's paint alone, and those of them that the scene leaves visible."""
    bounds, fixed = groups[0], len(groups[2]) - len(grids)
    stamp = np.full(len(groups[2]), -1, dtype=np.int32)
    near = np.empty(len(view.source), dtype=np.int32)
    straight = len(directions) == 0
    for i in range(start, start + len(counts)):
        left, top, step, columns, rows = grids[i]
        if rows == 0 or columns == 0:
            continue
        rays = np.empty((0, 0, 3))
        if not straight:
            rays = directions[first[i] : first[i + 1]].reshape(rows, columns, 3)
        here = View(
            view.camera, view.triangles, view.image, view.bulge, view.source, view.lens, rays,
            np.array([left, top]), step,
        )  # fmt: skip
        grid, paint, own = (left, top, step, 0.0, 0.0), FIRST_MARKER + 2 * i, fixed + i
        alone = np.full((rows, columns), -1, dtype=np.int32)
        depth = np.zeros((rows, columns))
        fill(here, chosen[bounds[own] : bounds[own + 1]], grid, alone, depth)
        counts[i - start, 0], far = _paint(alone, depth, codes, paint)
        if counts[i - start, 0] == 0:
            continue
        wanted = (own, far, straight)
        found = _gather(view, chosen, groups, tiles, (grid, rows, columns), wanted, stamp, near)
        other = np.full((rows, columns), -1, dtype=np.int32)
        front = np.zeros((rows, columns))
        # In the scene's order: of equal depths the first wins, as in the full image.
        fill(here, np.sort(near[:found]), grid, other, front)
        for row in range(max(0, -(top // step)), min(rows, (size[1] - 1 - top) // step + 1)):
            for column in range(
                max(0, -(left // step)), min(columns, (size[0] - 1 - left) // step + 1)
            ):
                t = alone[row, column]
                if t >= 0 and codes[t] == paint:
                    z, o = front[row, column], other[row, column]
                    level = z == depth[row, column]
                    counts[i - start, 1] += z < depth[row, column] or (level and t < o)
