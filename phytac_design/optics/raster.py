"""Exact ID map of any lens: which triangle owns each pixel centre, and how deep it lies."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Lens, Pinhole
from phytac_design.core.kernels import in_bands, kernel
from phytac_design.optics.distorted_triangles import distorted_view
from phytac_design.optics.render_scene import FIRST_MARKER, RESIN, RenderScene
from phytac_design.optics.zbuffer import View, fill
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Buffers:
    """What each pixel centre sees, (height, width) each.

    Attributes
    ----------
    part : int32
        Part code of the scene; 0 where nothing is hit.
    depth : float64
        Camera z, mm (of a lens that looks back it can be negative); inf where nothing is hit.
    triangle : int32
        Index of the triangle in the scene; -1 where nothing is hit.
    """

    part: NDArray[np.int32]
    depth: FloatArray
    triangle: NDArray[np.int32]


def project_scene(scene: RenderScene, camera: Camera, *, rays: FloatArray | None = None) -> View:
    """Bring a scene into the camera: cut at a pinhole's near plane, split for other lenses.

    Without faces of closed bodies that look away from the camera, which others hide. ``rays``
    replace the rays of all pixels for a lens with distortion.
    """
    points = camera.to_camera(scene.vertices)
    lens, triangles = camera.lens, scene.triangles
    shown = np.arange(len(triangles), dtype=np.int32)
    if scene.closed:
        shown = shown[_shown(points, triangles, scene.part)]
        triangles = triangles[shown]
    if not isinstance(lens, Pinhole):
        view = distorted_view(points, triangles, camera, rays)
        return view._replace(source=shown[view.source])
    points, triangles, source = clip_near(points, triangles)
    # Vertices left behind the near plane belong to no triangle any more.
    depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
    image = lens.focal_px * points[:, :2] / depth[:, None] + lens.centre_px
    return View(
        camera=points,
        triangles=triangles,
        image=image[triangles],
        bulge=np.zeros(len(triangles)),
        source=shown[source],
        lens=np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px]),
        rays=np.empty((0, 0, 3)),
        origin=np.zeros(2, dtype=np.int64),
    )


@kernel
def _shown(points: FloatArray, triangles: NDArray[np.int32], part: NDArray[np.int32]) -> BoolArray:
    """Whether triangles (T,) look at the camera, or belong to no receptor; camera frame."""
    shown = np.ones(len(triangles), dtype=np.bool_)
    for t in range(len(triangles)):
        if part[t] < FIRST_MARKER and part[t] != RESIN:
            continue
        a, b, c = triangles[t]
        ax, ay, az = points[a]
        bx, by, bz = points[b]
        cx, cy, cz = points[c]
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        shown[t] = volume <= 0.0
    return shown


def all_pieces(view: View) -> NDArray[np.int32]:
    """Indices of all pieces of a view."""
    return np.arange(len(view.source), dtype=np.int32)


def rasterise(scene: RenderScene, camera: Camera, *, view: View | None = None) -> Buffers:
    """Exact ID map and depth of a scene: one sample per pixel centre, nearest triangle wins.

    Of triangles at the very same depth the first in the scene wins, so a run is repeatable.
    ``view`` is ``project_scene(scene, camera)``, where it is known already.
    """
    view = project_scene(scene, camera) if view is None else view
    chosen = all_pieces(view)
    shape = (camera.height_px, camera.width_px)
    triangle = np.zeros(shape, dtype=np.int32)
    part = np.zeros(shape, dtype=np.int32)
    depth = np.zeros(shape)

    def band(first: int, last: int) -> None:
        rows = slice(first, last)
        triangle[rows] = -1
        fill(view, chosen, (0, first, 1, 0.0, 0.0), triangle[rows], depth[rows])
        _finish(triangle[rows], scene.part, view.rays[rows], part[rows], depth[rows])

    in_bands(band, camera.height_px)
    return Buffers(part=part, depth=depth, triangle=triangle)


@kernel
def _finish(
    triangle: NDArray[np.int32],
    codes: NDArray[np.int32],
    rays: FloatArray,
    part: NDArray[np.int32],
    depth: FloatArray,
) -> None:
    """Part codes from triangles, and depth from inverse depth or distance, in place."""
    for row in range(triangle.shape[0]):
        for column in range(triangle.shape[1]):
            t = triangle[row, column]
            if t >= 0:
                part[row, column] = codes[t]
                along = 1.0 if rays.shape[0] == 0 else rays[row, column, 2]
                depth[row, column] = along / depth[row, column]
            else:
                depth[row, column] = np.inf


def owner_sums(owner: NDArray[np.int32], count: int) -> FloatArray:
    """Pixels of each of ``count`` markers in an owner image, and sums of their x and y, (n, 3)."""
    sums = np.zeros((count, 3))
    _sum_owners(owner, sums)
    return sums


@kernel
def _sum_owners(owner: NDArray[np.int32], sums: FloatArray) -> None:
    """Add each marker's pixels, and their x and y, to ``sums`` (n, 3)."""
    for y in range(owner.shape[0]):
        for x in range(owner.shape[1]):
            k = owner[y, x]
            if 0 <= k < len(sums):
                sums[k, 0] += 1.0
                sums[k, 1] += x
                sums[k, 2] += y


def points_seen(
    scene: RenderScene, camera: Camera, buffers: Buffers, y: IntArray, x: IntArray
) -> FloatArray:
    """Points (n, 3) mm, sensor frame, that pixels (x, y) show; NaN for background.

    Intersection of the pixel's ray with the plane of its triangle.
    """
    t = buffers.triangle[y, x]
    ray = camera.rays(np.column_stack([x, y]).astype(np.float64))
    corners = scene.vertices[scene.triangles[np.maximum(t, 0)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    height = np.sum((corners[:, 0] - camera.position_mm) * normal, axis=1)
    distance = height / np.sum(ray * normal, axis=1)
    distance[t < 0] = np.nan
    return np.asarray(camera.position_mm + distance[:, None] * ray)


def paint_alone(
    scene: RenderScene,
    camera: Camera,
    *,
    view: View | None = None,
    offset_px: tuple[float, float] = (0.0, 0.0),
    beyond: bool = True,
) -> FloatArray:
    """Pixels of each marker's paint, and sums of their x and y, with its receptor rendered alone.

    The receptor's own tube and tip still hide parts of it. (n, 3).

    Parameters
    ----------
    view : View, optional
        ``project_scene(scene, camera)``, where it is known already.
    offset_px : (x, y)
        Place of the sample in each pixel; the centre by default.
    beyond : bool
        Whether pixels up to half an image beyond the frame count too, where the lens has an image,
        so that the visible fraction of a marker that leaves the picture drops.
    """
    view = project_scene(scene, camera) if view is None else view
    chosen, starts = pieces_by_marker(scene, view)
    windows = marker_windows(view, chosen, starts, camera)
    sums = np.zeros((scene.count, 3))
    if not beyond:
        windows = clipped(windows, camera)
    # The view has the rays of the pixel centres of the image and no others.
    apart = leaves(windows, camera) | bool(any(offset_px))
    apart &= (view.rays.shape[0] > 0) & (windows[:, 2] > 0)
    inside = np.where(apart[:, None], 0, windows)

    def some(first: int, last: int) -> None:
        rows, own = slice(first, last), starts[first : last + 1]
        _sum_alone(view, chosen, own, inside[rows], offset_px, scene.part, sums[rows])

    in_bands(some, scene.count)
    for i in np.flatnonzero(apart):
        one, own = slice(i, i + 1), starts[i : i + 2]
        here = window_rays(view, camera.lens, windows[i], offset_px)
        _sum_alone(here, chosen, own, windows[one], offset_px, scene.part, sums[one])
    return sums


def pixels_alone(scene: RenderScene, camera: Camera) -> IntArray:
    """Pixels (n,) of each marker's paint when its receptor is rendered alone."""
    return paint_alone(scene, camera)[:, 0].astype(np.int64)


def window_rays(view: View, lens: Lens, window: IntArray, offset_px: tuple[float, float]) -> View:
    """View with the rays of the pixels of one window (4,), which may reach beyond the image."""
    left, top, columns, rows = (int(value) for value in window)
    x, y = np.meshgrid(np.arange(columns) + left, np.arange(rows) + top)
    rays = lens.unproject(np.column_stack([x.ravel(), y.ravel()]) + np.array(offset_px))
    return view._replace(rays=rays.reshape(rows, columns, 3), origin=np.array([left, top]))


def pieces_by_marker(scene: RenderScene, view: View) -> tuple[NDArray[np.int32], IntArray]:
    """Pieces marker after marker, and where each marker's start, (n + 1,); fixed parts first."""
    owner = scene.triangle_owner[view.source]
    order = np.argsort(owner, kind="stable").astype(np.int32)
    return order, np.searchsorted(owner[order], np.arange(scene.count + 1))


def marker_windows(
    view: View, chosen: NDArray[np.int32], starts: IntArray, camera: Camera
) -> IntArray:
    """Left, top, columns, rows (n, 4) of the pixels that each marker's pieces can reach.

    Cut at half an image beyond the frame; no columns where nothing is left.
    """
    size = np.array([camera.width_px, camera.height_px])
    limits = np.concatenate([-(size // 2), size + size // 2])
    windows = np.zeros((len(starts) - 1, 4), dtype=np.int64)
    _windows(view, chosen, starts, limits, windows)
    return windows


def clipped(windows: IntArray, camera: Camera) -> IntArray:
    """Windows (n, 4) clipped to the image."""
    low = np.maximum(windows[:, :2], 0)
    high = np.minimum(windows[:, :2] + windows[:, 2:], [camera.width_px, camera.height_px])
    size = np.maximum(high - low, 0)
    size[(size == 0).any(axis=1)] = 0
    return np.concatenate([low, size], axis=1)


def leaves(windows: IntArray, camera: Camera) -> BoolArray:
    """Whether windows (n, 4) reach beyond the image."""
    end = windows[:, :2] + windows[:, 2:]
    beyond = (windows[:, :2] < 0).any(axis=1)
    beyond |= (end > [camera.width_px, camera.height_px]).any(axis=1)
    return np.asarray(beyond & (windows[:, 2] > 0))


@kernel
def _windows(
    view: View,
    chosen: NDArray[np.int32],
    starts: IntArray,
    limits: IntArray,
    windows: IntArray,
) -> None:
    """Bounding boxes of each marker's pieces, in ``windows`` (n, 4)."""
    for i in range(len(starts) - 1):
        x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
        for piece in chosen[starts[i] : starts[i + 1]]:
            bulge = view.bulge[piece]
            for corner in range(3):
                x, y = view.image[piece, corner]
                x0, x1 = min(x0, x - bulge), max(x1, x + bulge)
                y0, y1 = min(y0, y - bulge), max(y1, y + bulge)
        x0, y0 = np.floor(max(x0, limits[0])), np.floor(max(y0, limits[1]))
        x1, y1 = np.ceil(min(x1, limits[2])), np.ceil(min(y1, limits[3]))
        if x1 >= x0 and y1 >= y0:
            windows[i, 0], windows[i, 1] = int(x0), int(y0)
            windows[i, 2], windows[i, 3] = int(x1 - x0) + 1, int(y1 - y0) + 1


@kernel
def _sum_alone(
    view: View,
    chosen: NDArray[np.int32],
    starts: IntArray,
    windows: IntArray,
    offset_px: tuple[float, float],
    codes: NDArray[np.int32],
    sums: FloatArray,
) -> None:
    """Fill each marker's pieces in a window of its own; see :func:`paint_alone`."""
    for i in range(len(starts) - 1):
        left, top, columns, rows = windows[i]
        if columns == 0:
            continue
        owner = np.full((rows, columns), -1, dtype=np.int32)
        own, (right, down) = chosen[starts[i] : starts[i + 1]], offset_px
        fill(view, own, (left, top, 1, right, down), owner, np.zeros(owner.shape))
        for row in range(rows):
            for column in range(columns):
                t = owner[row, column]
                if t >= 0 and codes[t] >= FIRST_MARKER and codes[t] % 2 == 0:
                    sums[i, 0] += 1.0
                    sums[i, 1] += column + left + right
                    sums[i, 2] += row + top + down


def clip_near(
    points: FloatArray, triangles: NDArray[np.int32]
) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]:
    """Cut triangles at camera z = 1 µm, below which nothing is drawn.

    Parameters
    ----------
    points : (V, 3) float
        Vertices in the camera frame, mm.
    triangles : (T, 3) int32
        Vertex indices.

    Returns
    -------
    points, triangles, source
        Vertices with the new ones appended, triangles in front of the plane (none has a vertex
        behind it), and the index of the triangle that each came from, in rising order.
    """
    near_mm = 1e-3  # camera z below which nothing is drawn
    front = points[:, 2] >= near_mm
    source = np.arange(len(triangles), dtype=np.int32)
    if bool(front.all()):
        return points, triangles, source
    count = front[triangles].sum(axis=1)
    cut = np.flatnonzero((count == 1) | (count == 2))
    # Turn each cut triangle so that the vertex alone on its side comes first.
    side = front[triangles[cut]]
    alone = np.where(count[cut] == 1, side.argmax(axis=1), side.argmin(axis=1))
    turned = triangles[cut][np.arange(len(cut))[:, None], (alone[:, None] + np.arange(3)) % 3]
    p = points[turned]
    share = (near_mm - p[:, :1, 2]) / (p[:, 1:, 2] - p[:, :1, 2])
    crossing = p[:, :1] + share[:, :, None] * (p[:, 1:] - p[:, :1])
    crossing[:, :, 2] = near_mm
    at = len(points) + 2 * np.arange(len(cut))
    one = count[cut] == 1
    tips = np.column_stack([turned[:, 0], at, at + 1])[one]
    first = np.column_stack([at, turned[:, 1], turned[:, 2]])[~one]
    second = np.column_stack([at, turned[:, 2], at + 1])[~one]
    whole = count == 3
    faces = np.concatenate([triangles[whole], tips, first, second]).astype(np.int32)
    origin = np.concatenate([source[whole], cut[one], cut[~one], cut[~one]]).astype(np.int32)
    order = np.argsort(origin, kind="stable")
    return np.concatenate([points, crossing.reshape(-1, 3)]), faces[order], origin[order]
