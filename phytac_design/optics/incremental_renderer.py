"""Fast rendering of many poses of one scene: only receptors are drawn again, each in its window.

Shell and bar do not move: their depth is rendered once. For each pose every receptor is rendered
into its own window, which shows the receptor alone. All windows are then composited over the fixed
depth (the nearest wins), and markers are counted and measured inside their windows only. The result
equals that of the full image, pixel for pixel.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.core.kernels import in_bands, kernel
from phytac_design.optics.raster import (
    all_pieces,
    marker_windows,
    pieces_by_marker,
    project_scene,
)
from phytac_design.optics.render_scene import FIRST_MARKER, SHELL, RenderScene
from phytac_design.optics.zbuffer import View, fill
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class RenderSample:
    """Rendered markers of one pose; arrays over n markers.

    Attributes
    ----------
    visible, alone : (n, 3) float
        Pixels of the marker's paint, and sums of their x and y; ``alone`` with its receptor alone.
    pixels : (m, 2) int
        Visible pixels (x, y) on the markers' outlines, marker after marker.
    starts : (n + 1,) int
        Where each marker's pixels start.
    """

    visible: FloatArray
    alone: FloatArray
    pixels: IntArray
    starts: IntArray


class IncrementalRenderer:
    """Renders one scene whose receptors move, from one camera.

    Parameters
    ----------
    scene, camera : Scene, Camera
        The sensor in any pose. Not safe to share between threads.
    wall_setback : float
        Relative increase of the distance between camera and wall. The wall of the scene is fixed,
        but a real one moves with its receptors: a receptor slightly behind it is not hidden.
    """

    def __init__(self, scene: RenderScene, camera: Camera, *, wall_setback: float = 0.0) -> None:
        self.camera = camera
        self.own = np.flatnonzero(scene.triangle_owner >= 0)
        fixed = scene.triangle_owner < 0
        shape = (camera.height_px, camera.width_px)
        self._fixed_depth = np.zeros(shape)
        unowned = np.full(shape, -1, dtype=np.int32)
        for part in (fixed & (scene.part == SHELL), fixed & (scene.part != SHELL)):
            view = project_scene(_part_of(scene, np.flatnonzero(part)), camera)
            _fill_all(view, unowned, self._fixed_depth)
            if wall_setback > 0.0:
                self._fixed_depth /= 1.0 + wall_setback
                wall_setback = 0.0
        self._nearest = self._fixed_depth.copy()
        self._marker = np.full(shape, -1, dtype=np.int32)
        self._written = np.zeros((0, 4), dtype=np.int64)

    def render(self, scene: RenderScene) -> RenderSample:
        """Render the same scene in another pose (from ``RenderScene.moved``)."""
        moving = _part_of(scene, self.own)
        view = project_scene(moving, self.camera)
        chosen, starts = pieces_by_marker(moving, view)
        windows = _clipped(marker_windows(view, chosen, starts, self.camera), self.camera)
        ends = np.cumsum(np.concatenate([[0], windows[:, 2] * windows[:, 3]]))
        triangle = np.full(int(ends[-1]), -1, dtype=np.int32)
        inverse = np.zeros(int(ends[-1]))
        alone, visible = np.zeros((scene.count, 3)), np.zeros((scene.count, 3))

        def fill_markers(first: int, last: int) -> None:
            some = slice(first, last)
            _fill_windows(
                view,
                chosen,
                starts[first : last + 1],
                windows[some],
                ends[some],
                moving.part,
                triangle,
                inverse,
                alone[some],
            )

        def composite(first: int, last: int) -> None:
            rows = (first, last)
            _restore(self._written, rows, self._fixed_depth, self._nearest, self._marker)
            _composite(windows, ends, rows, triangle, inverse, self._nearest, self._marker)

        def measure(first: int, last: int) -> None:
            some = slice(first, last)
            _measure(
                first, windows[some], ends[some], self._marker, visible[some], pixels, found[some]
            )

        in_bands(fill_markers, scene.count)
        in_bands(composite, self.camera.height_px)
        self._written = windows
        # Outlines of each marker fit the stretch of its window; untouched pages cost nothing.
        pixels = np.empty((int(ends[-1]), 2), dtype=np.int64)
        found = np.zeros(scene.count, dtype=np.int64)
        in_bands(measure, scene.count)
        return RenderSample(
            visible=visible,
            alone=alone,
            pixels=np.concatenate(
                [np.zeros((0, 2), dtype=np.int64)]
                + [pixels[start : start + k] for start, k in zip(ends[:-1], found, strict=True)]
            ),
            starts=np.cumsum(np.concatenate([[0], found])),
        )


def _fill_all(view: View, owner: NDArray[np.int32], inverse: FloatArray) -> None:
    """Fill a view into a whole image."""
    chosen = all_pieces(view)

    def band(first: int, last: int) -> None:
        rows = slice(first, last)
        fill(view, chosen, (0, first, 1, 0.0, 0.0), owner[rows], inverse[rows])

    in_bands(band, len(owner))


def _part_of(scene: RenderScene, chosen: IntArray) -> RenderScene:
    """Scene of some of the triangles, with all vertices."""
    return replace(scene, triangles=scene.triangles[chosen], part=scene.part[chosen])


def _clipped(windows: IntArray, camera: Camera) -> IntArray:
    """Windows (n, 4) clipped to the image."""
    low = np.maximum(windows[:, :2], 0)
    high = np.minimum(windows[:, :2] + windows[:, 2:], [camera.width_px, camera.height_px])
    size = np.maximum(high - low, 0)
    size[(size == 0).any(axis=1)] = 0
    return np.concatenate([low, size], axis=1)


@kernel
def _fill_windows(
    view: View,
    chosen: NDArray[np.int32],
    starts: IntArray,
    windows: IntArray,
    ends: IntArray,
    codes: NDArray[np.int32],
    triangle: NDArray[np.int32],
    inverse: FloatArray,
    sums: FloatArray,
) -> None:
    """Fill each marker's pieces into its stretch of ``triangle`` and ``inverse``.

    ``triangle`` becomes the marker whose paint a pixel shows, -2 for other parts, -1 for nothing;
    ``sums`` (n, 3) its pixels, sum of x and sum of y.
    """
    for i in range(len(windows)):
        left, top, columns, rows = windows[i]
        if columns == 0:
            continue
        first, last = ends[i], ends[i] + rows * columns
        owner = triangle[first:last].reshape((rows, columns))
        near = inverse[first:last].reshape((rows, columns))
        fill(view, chosen[starts[i] : starts[i + 1]], (left, top, 1, 0.0, 0.0), owner, near)
        for row in range(rows):
            for column in range(columns):
                t = owner[row, column]
                if t < 0:
                    continue
                code = codes[t] - FIRST_MARKER
                if code >= 0 and code % 2 == 0:
                    owner[row, column] = code // 2
                    sums[i, 0] += 1.0
                    sums[i, 1] += column + left
                    sums[i, 2] += row + top
                else:
                    owner[row, column] = -2


@kernel
def _restore(
    windows: IntArray,
    band: tuple[int, int],
    fixed_depth: FloatArray,
    nearest: FloatArray,
    marker: NDArray[np.int32],
) -> None:
    """Restore the fixed scene under the windows, in a band of rows."""
    for i in range(len(windows)):
        left, top, columns, rows = windows[i]
        for y in range(max(top, band[0]), min(top + rows, band[1])):
            nearest[y, left : left + columns] = fixed_depth[y, left : left + columns]
            marker[y, left : left + columns] = -1


@kernel
def _composite(
    windows: IntArray,
    ends: IntArray,
    band: tuple[int, int],
    owner: NDArray[np.int32],
    inverse: FloatArray,
    nearest: FloatArray,
    marker: NDArray[np.int32],
) -> None:
    """Composite windows into a band of rows: the nearest wins, and the first of equal depths."""
    for i in range(len(windows)):
        left, top, columns, rows = windows[i]
        for y in range(max(top, band[0]), min(top + rows, band[1])):
            at = ends[i] + (y - top) * columns
            for x in range(columns):
                if inverse[at + x] > nearest[y, left + x]:
                    nearest[y, left + x] = inverse[at + x]
                    marker[y, left + x] = max(owner[at + x], -1)


@kernel
def _measure(
    start: int,
    windows: IntArray,
    ends: IntArray,
    marker: NDArray[np.int32],
    sums: FloatArray,
    pixels: IntArray,
    found: IntArray,
) -> None:
    """Measure the markers from ``start`` on: number of pixels, sum of x and sum of y (n, 3).

    The ``found`` pixels on each outline (a 4-neighbour is not of the marker, or beyond the image)
    are written to ``pixels`` from the marker's entry of ``ends`` on.
    """
    height, width = marker.shape
    for i in range(len(windows)):
        left, top, columns, rows = windows[i]
        own = start + i
        for y in range(top, top + rows):
            for x in range(left, left + columns):
                if marker[y, x] != own:
                    continue
                sums[i, 0] += 1.0
                sums[i, 1] += x
                sums[i, 2] += y
                if (
                    y == 0
                    or x == 0
                    or y == height - 1
                    or x == width - 1
                    or marker[y - 1, x] != own
                    or marker[y + 1, x] != own
                    or marker[y, x - 1] != own
                    or marker[y, x + 1] != own
                ):
                    at = ends[i] + found[i]
                    pixels[at, 0], pixels[at, 1] = x, y
                    found[i] += 1
