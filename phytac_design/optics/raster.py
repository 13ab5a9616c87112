"""Exact z-buffer for a pinhole camera: which triangle owns each pixel centre, and how deep.

Each triangle is filled row by row between its exact edge crossings; inverse depth is the plane
through the triangle evaluated at the pixel, ``1/z = N·(x', y', 1) / N·p0`` with ``N`` the
triangle's normal and ``(x', y')`` the pixel on the image plane at unit depth, which is linear on
the image (perspective-correct). Float64 throughout, no fixed point, no back-face culling.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from decoder.camera import PinholeCamera
from phytac_design.optics.clip import clip_near
from phytac_design.optics.scene import FIRST_MARKER, Scene
from shapes.arrays import FloatArray, IntArray

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
EDGE_PX = 1e-9
"""Pixels this close outside an edge belong to the triangle: shared edges leave no holes."""
AREA_PX2 = 1e-15
"""Twice the image area below which a triangle is seen edge-on, and skipped."""


def kernel(function: Kernel) -> Kernel:
    """Compile with numba, cached on disk, free of the interpreter lock; 1 / 0 is inf."""
    return cast("Kernel", numba.njit(cache=True, nogil=True, error_model="numpy")(function))


@dataclass(frozen=True, kw_only=True)
class Buffers:
    """What each pixel centre sees, (height, width) each.

    Attributes
    ----------
    part : int32
        Part code of the scene; 0 where nothing is hit.
    depth : float64
        Camera z, mm; inf where nothing is hit.
    triangle : int32
        Index of the triangle in the scene; -1 where nothing is hit.
    """

    part: NDArray[np.int32]
    depth: FloatArray
    triangle: NDArray[np.int32]


class Projected(NamedTuple):
    """A scene ready to fill: clipped at the near plane, in camera frame and on the image.

    ``camera`` (V, 3) mm, ``image`` (V, 2) px, ``triangles`` (T, 3) and ``source`` (T,), the index
    of the scene's triangle that each came from; ``lens`` = (focal, cx, cy) px.
    """

    camera: FloatArray
    image: FloatArray
    triangles: NDArray[np.int32]
    source: NDArray[np.int32]
    lens: FloatArray


def project_scene(scene: Scene, camera: PinholeCamera) -> Projected:
    """Bring a scene into the camera; triangles behind the near plane are cut away."""
    points, triangles, source = clip_near(camera.to_camera(scene.vertices), scene.triangles)
    # Vertices left behind the near plane belong to no triangle any more.
    depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
    image = camera.focal_px * points[:, :2] / depth[:, None] + camera.centre_px
    return Projected(
        camera=points,
        image=image,
        triangles=triangles,
        source=source,
        lens=np.array([camera.focal_px, *camera.centre_px]),
    )


def rasterise(scene: Scene, camera: PinholeCamera) -> Buffers:
    """Exact ID map and depth of a scene: one sample per pixel centre, nearest triangle wins.

    Of triangles at the very same depth the first in the scene wins, so a run is repeatable.
    """
    view = project_scene(scene, camera)
    shape = (camera.height_px, camera.width_px)
    triangle = np.zeros(shape, dtype=np.int32)
    part = np.zeros(shape, dtype=np.int32)
    depth = np.zeros(shape)

    def band(first: int, last: int) -> None:
        rows = slice(first, last)
        triangle[rows] = -1
        fill(view, 0, first, triangle[rows], depth[rows])
        _finish(triangle[rows], scene.part, part[rows], depth[rows])

    in_bands(band, camera.height_px)
    return Buffers(part=part, depth=depth, triangle=triangle)


def workers() -> int:
    """Threads to use: the cores this process may run on, at most eight."""
    return max(1, min(8, len(os.sched_getaffinity(0))))


def in_bands(work: Callable[[int, int], None], rows: int, *, band_rows: int = 0) -> None:
    """Call ``work(first, last)`` on bands of rows, on as many threads as there are cores.

    ``band_rows`` bounds the height of a band (and so its memory); 0 gives each thread one band.
    """
    threads = workers()
    size = band_rows or -(-rows // threads)
    starts = list(range(0, rows, size))
    stops = [min(start + size, rows) for start in starts]
    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(work, starts, stops))


@kernel
def _crossing(
    start: tuple[float, float], end: tuple[float, float], y: float, span: tuple[float, float]
) -> tuple[float, float]:
    """Narrow a row's span (first, last) to the inner side of one edge."""
    first, last = span
    dx, dy = end[0] - start[0], end[1] - start[1]
    if dy > 0.0:
        last = min(last, start[0] + dx * ((y - start[1]) / dy) + EDGE_PX)
    elif dy < 0.0:
        first = max(first, start[0] + dx * ((y - start[1]) / dy) - EDGE_PX)
    elif dx * (y - start[1]) < -EDGE_PX * abs(dx):
        last = first - 1.0
    return first, last


@kernel
def fill(
    view: Projected, left: int, top: int, owner: NDArray[np.int32], inverse: FloatArray
) -> None:
    """Fill triangles into the window whose first pixel is (left, top).

    ``owner`` gets ``source`` of the nearest triangle, ``inverse`` its 1/z (0 = nothing yet).
    """
    focal, cx, cy = view.lens
    rows, columns = owner.shape
    for t in range(view.triangles.shape[0]):
        ia, ib, ic = view.triangles[t]
        a, b, c = view.image[ia], view.image[ib], view.image[ic]
        low, high = min(a[1], b[1], c[1]) - EDGE_PX, max(a[1], b[1], c[1]) + EDGE_PX
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if high < top or low > top + rows - 1 or abs(area) < AREA_PX2:
            continue
        if area < 0.0:  # Turn it, so that the inside of every edge has the same sign.
            ib, ic, b, c = ic, ib, c, b
        p, q, r = view.camera[ia], view.camera[ib], view.camera[ic]
        ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        plane = nx * p[0] + ny * p[1] + nz * p[2]
        if plane == 0.0:
            continue
        near, far = 1.0 / min(p[2], q[2], r[2]), 1.0 / max(p[2], q[2], r[2])
        slope = nx / (focal * plane)
        for row in range(max(0, int(np.ceil(low - top))), min(rows - 1, int(high - top)) + 1):
            y = float(row + top)
            span = (float(left), float(left + columns - 1))
            span = _crossing((a[0], a[1]), (b[0], b[1]), y, span)
            span = _crossing((b[0], b[1]), (c[0], c[1]), y, span)
            span = _crossing((c[0], c[1]), (a[0], a[1]), y, span)
            if span[1] < span[0]:
                continue
            base = (nz + (ny * (y - cy) - nx * cx) / focal) / plane
            for column in range(int(np.ceil(span[0])) - left, int(np.floor(span[1])) - left + 1):
                z = min(max(base + slope * (column + left), far), near)
                if z > inverse[row, column]:
                    inverse[row, column] = z
                    owner[row, column] = view.source[t]


@kernel
def _finish(
    triangle: NDArray[np.int32],
    codes: NDArray[np.int32],
    part: NDArray[np.int32],
    depth: FloatArray,
) -> None:
    """Part codes from triangles, and depth from inverse depth, in place."""
    for row in range(triangle.shape[0]):
        for column in range(triangle.shape[1]):
            t = triangle[row, column]
            if t >= 0:
                part[row, column] = codes[t]
                depth[row, column] = 1.0 / depth[row, column]
            else:
                depth[row, column] = np.inf


def pixels_alone(scene: Scene, camera: PinholeCamera) -> tuple[IntArray, IntArray]:
    """Pixels of each marker's paint and red tip if its receptor were the only thing, (n,) each.

    The receptor's own tube and tip still hide parts of it. Pixels up to half an image beyond the
    frame count too, so that a marker which leaves the picture is not seen whole.
    """
    view = project_scene(scene, camera)
    owner = scene.triangle_owner[view.source]
    order = np.argsort(owner, kind="stable")
    view = view._replace(triangles=view.triangles[order], source=view.source[order])
    starts = np.searchsorted(owner[order], np.arange(scene.count + 1))
    size = np.array([camera.width_px, camera.height_px])
    limits = np.concatenate([-(size // 2), size + size // 2])
    counts = np.zeros((scene.count, 2), dtype=np.int64)

    def some(first: int, last: int) -> None:
        _count_alone(view, starts[first : last + 1], limits, scene.part, counts[first:last])

    in_bands(some, scene.count)
    return counts[:, 0], counts[:, 1]


@kernel
def _count_alone(
    view: Projected,
    starts: IntArray,
    limits: IntArray,
    codes: NDArray[np.int32],
    counts: IntArray,
) -> None:
    """Fill each marker's triangles ``starts[i]:starts[i + 1]`` in a window of its own; count.

    ``limits`` (left, top, right, bottom) bounds the windows; ``counts`` (n, 2) gets paint and red.
    """
    for i in range(len(starts) - 1):
        triangles = view.triangles[starts[i] : starts[i + 1]]
        x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
        for corner in triangles.ravel():
            x0, x1 = min(x0, view.image[corner, 0]), max(x1, view.image[corner, 0])
            y0, y1 = min(y0, view.image[corner, 1]), max(y1, view.image[corner, 1])
        x0, y0 = np.floor(max(x0, limits[0])), np.floor(max(y0, limits[1]))
        x1, y1 = np.ceil(min(x1, limits[2])), np.ceil(min(y1, limits[3]))
        if x1 < x0 or y1 < y0:
            continue
        owner = np.full((int(y1 - y0) + 1, int(x1 - x0) + 1), -1, dtype=np.int32)
        own = Projected(
            view.camera, view.image, triangles, view.source[starts[i] : starts[i + 1]], view.lens
        )
        fill(own, int(x0), int(y0), owner, np.zeros(owner.shape))
        for t in owner.ravel():
            if t >= 0 and codes[t] >= FIRST_MARKER:
                counts[i, codes[t] % 2] += 1
