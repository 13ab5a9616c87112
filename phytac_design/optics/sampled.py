"""Visible fraction of every marker from a few rays each: the fast path of a search.

The exact z-buffer on some of its pixels: in a window around each marker's paint, every k-th pixel
of every k-th row is filled, once with the marker's receptor alone and once with the whole scene.
Where k is 1 (small markers) the fraction is the exact one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.camera import Camera
from phytac_design.optics.fill import EDGE_PX, Grid, View, fill
from phytac_design.optics.kernels import in_bands, kernel
from phytac_design.optics.raster import (
    leaves,
    marker_windows,
    pieces_by_marker,
    pixels_alone,
    project_scene,
    rasterise,
    window_rays,
)
from phytac_design.optics.scene import FIRST_MARKER, Scene, paint_owner
from shapes.arrays import FloatArray, IntArray

TILES_PX = (8, 32)
"""Least and largest side of a tile; about a marker wide."""
RAYS = 64
"""Rays per marker, about; see ``sampled_fraction``."""


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """Per marker, (n,): visible fraction, rays that met its paint alone, and in the scene."""

    fraction: FloatArray
    alone: IntArray
    visible: IntArray


def sampled_fraction(scene: Scene, camera: Camera, *, rays: int = RAYS) -> Sampled:
    """Visible fraction of every marker's paint from about ``rays`` rays through pixel centres.

    A marker with fewer pixels than that gets all of them and so its exact fraction; others get
    a square grid of their pixels, with at least about ``rays`` on the paint.
    """
    view = project_scene(scene, camera)
    chosen, starts = pieces_by_marker(scene, view)
    owner = scene.triangle_owner[view.source]
    is_paint = (scene.part[view.source[chosen]] - FIRST_MARKER) % 2 == 0
    is_paint &= scene.part[view.source[chosen]] >= FIRST_MARKER
    before = np.concatenate([[0], np.cumsum(is_paint)])
    windows = marker_windows(view, chosen[is_paint], before[starts], camera)
    steps = _steps(view, chosen[is_paint], before[starts], rays)
    if int(steps.max(initial=1)) == 1:
        return _whole(scene, camera)
    tiles = _tiles(view, camera, windows)
    counts = np.zeros((scene.count, 2), dtype=np.int64)
    size = np.array([camera.width_px, camera.height_px])
    beyond = leaves(windows, camera) & (view.rays.shape[0] > 0)
    inside = np.where(beyond[:, None], 0, windows)

    def some(here: View, boxes: IntArray, first: int, last: int) -> None:
        rows, own = slice(first, last), starts[first : last + 1]
        _count(
            here, chosen, own, tiles, boxes[rows], steps[rows], owner, first, scene.part, size,
            counts[rows],
        )  # fmt: skip

    in_bands(lambda first, last: some(view, inside, first, last), scene.count)
    for i in np.flatnonzero(beyond):
        some(window_rays(view, camera.lens, windows[i]), windows, int(i), int(i) + 1)
    alone, visible = counts[:, 0], counts[:, 1]
    fraction = np.divide(visible, alone, out=np.zeros(scene.count), where=alone > 0)
    return Sampled(fraction=fraction, alone=alone, visible=visible)


def _whole(scene: Scene, camera: Camera) -> Sampled:
    """Exact fractions: the way where no marker has more pixels than it is to have rays."""
    owner = paint_owner(rasterise(scene, camera).part)
    visible = np.bincount(owner[owner >= 0], minlength=scene.count).astype(np.int64)
    alone = pixels_alone(scene, camera)[0]
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
            a, b, c = view.image[piece, 0], view.image[piece, 1], view.image[piece, 2]
            twice = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
            if twice < np.inf:
                area[i] += twice / 4.0


Tiles = tuple[IntArray, NDArray[np.int32], tuple[int, int, int], FloatArray]
"""Start of each tile's list, the lists of pieces one after the other, (tiles per row, per column,
side in px), and the box (x0, y0, x1, y1) of each piece."""


def _tiles(view: View, camera: Camera, windows: IntArray) -> Tiles:
    """Pieces that can reach each square tile of the image."""
    side = int(np.clip(np.median(windows[:, 2:]), *TILES_PX))
    wide, high = camera.width_px // side + 1, camera.height_px // side + 1
    layout = (wide, high, side)
    boxes = np.zeros((len(view.source), 4))
    _boxes(view, boxes)
    starts = np.zeros(wide * high + 1, dtype=np.int64)
    _fill_tiles(boxes, layout, starts, np.zeros(0, dtype=np.int32))
    np.cumsum(starts, out=starts)
    lists = np.zeros(int(starts[-1]), dtype=np.int32)
    _fill_tiles(boxes, layout, starts.copy(), lists)
    return starts, lists, layout, boxes


@kernel
def _boxes(view: View, boxes: FloatArray) -> None:
    """Box (x0, y0, x1, y1) px that holds each piece with its bulge."""
    for piece in range(len(view.source)):
        a, b, c = view.image[piece, 0], view.image[piece, 1], view.image[piece, 2]
        margin = view.bulge[piece] + EDGE_PX
        boxes[piece, 0], boxes[piece, 2] = (
            min(a[0], b[0], c[0]) - margin,
            max(a[0], b[0], c[0]) + margin,
        )
        boxes[piece, 1], boxes[piece, 3] = (
            min(a[1], b[1], c[1]) - margin,
            max(a[1], b[1], c[1]) + margin,
        )


@kernel
def _fill_tiles(
    boxes: FloatArray, layout: tuple[int, int, int], starts: IntArray, lists: NDArray[np.int32]
) -> None:
    """Count the pieces of each tile into ``starts[tile + 1]``, or write them, if lists has room."""
    wide, high, side = layout
    for piece in range(len(boxes)):
        x0, y0, x1, y1 = boxes[piece]
        if not (x1 >= 0.0 and y1 >= 0.0 and x0 < wide * side and y0 < high * side):
            continue
        for row in range(max(0, int(y0 // side)), min(high - 1, int(y1 // side)) + 1):
            for column in range(max(0, int(x0 // side)), min(wide - 1, int(x1 // side)) + 1):
                tile = row * wide + column
                if len(lists) == 0:
                    starts[tile + 1] += 1
                else:
                    lists[starts[tile]] = piece
                    starts[tile] += 1


@kernel
def _meets(low: float, high: float, start: int, step: int, count: int) -> bool:
    """Whether one of the grid's ``count`` lines lies between ``low`` and ``high``."""
    first = max(0.0, np.ceil((low - start) / step))
    return bool(first <= min(count - 1.0, np.floor((high - start) / step)))


@kernel
def _gather(
    tiles: Tiles,
    grid: Grid,
    shape: tuple[int, int],
    seen: tuple[NDArray[np.int32], int],
    near: NDArray[np.int32],
) -> int:
    """Write each piece that may cover a pixel of a grid once into ``near``; how many there are."""
    starts, lists, (wide, high, side), boxes = tiles
    left, top, step = grid[0], grid[1], grid[2]
    right, bottom = left + step * (shape[1] - 1), top + step * (shape[0] - 1)
    stamp, mark = seen
    count = 0
    for row in range(max(0, top // side), min(high - 1, bottom // side) + 1):
        for column in range(max(0, left // side), min(wide - 1, right // side) + 1):
            tile = row * wide + column
            for piece in lists[starts[tile] : starts[tile + 1]]:
                if stamp[piece] == mark:
                    continue
                stamp[piece] = mark
                box = boxes[piece]
                if _meets(box[0], box[2], left, step, shape[1]) and _meets(
                    box[1], box[3], top, step, shape[0]
                ):
                    near[count] = piece
                    count += 1
    return count


@kernel
def _count(
    view: View,
    chosen: NDArray[np.int32],
    starts: IntArray,
    tiles: Tiles,
    windows: IntArray,
    steps: IntArray,
    owner: NDArray[np.int32],
    first: int,
    codes: NDArray[np.int32],
    size: IntArray,
    counts: IntArray,
) -> None:
    """Grid pixels of each marker's paint alone, and those of them that the scene leaves visible."""
    stamp = np.full(len(view.source), -1, dtype=np.int32)
    near = np.empty(len(view.source), dtype=np.int32)
    for i in range(len(starts) - 1):
        paint = FIRST_MARKER + 2 * (first + i)
        step, half = steps[i], steps[i] // 2
        left, top = windows[i, 0] + half, windows[i, 1] + half
        columns = (windows[i, 2] - half + step - 1) // step
        rows = (windows[i, 3] - half + step - 1) // step
        if windows[i, 2] == 0 or rows <= 0 or columns <= 0:
            continue
        grid = (left, top, step, 0.0, 0.0)
        # Pieces in the scene's order: of equals the first wins, as in the whole map.
        pieces = np.sort(near[: _gather(tiles, grid, (rows, columns), (stamp, i), near)])
        own = pieces[owner[pieces] == first + i]
        if windows[i, :2].min() < 0 or (windows[i, :2] + windows[i, 2:] > size).any():
            own = chosen[starts[i] : starts[i + 1]]  # the tiles end with the image
        alone = np.full((rows, columns), -1, dtype=np.int32)
        fill(view, own, grid, alone, np.zeros((rows, columns)))
        scene = np.full((rows, columns), -1, dtype=np.int32)
        fill(view, pieces, grid, scene, np.zeros((rows, columns)))
        for row in range(rows):
            inside = 0 <= top + step * row < size[1]
            for column in range(columns):
                t = alone[row, column]
                if t >= 0 and codes[t] == paint:
                    counts[i, 0] += 1
                    t = scene[row, column]
                    within = inside and 0 <= left + step * column < size[0]
                    counts[i, 1] += within and t >= 0 and codes[t] == paint
