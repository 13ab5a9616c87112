"""What a red tip that is out covers of its own marker's paint, in any pose."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.optics.frame_renderer import sample_offsets
from phytac_design.optics.raster import marker_windows, pieces_by_marker, project_scene
from phytac_design.optics.render_scene import RenderScene, paint_owner
from phytac_design.optics.zbuffer import View, fill
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SAMPLES = 8
"""Samples per pixel."""


class TipCover:
    """One camera's view of single receptors, tip in and tip out.

    Parameters
    ----------
    rest, on : Scene
        The same scene with all tips in, and out.
    camera : Camera
        That sees it.
    pivots_mm : (n, 3) float
        Points that motions are of.
    """

    def __init__(
        self, rest: RenderScene, on: RenderScene, camera: Camera, pivots_mm: FloatArray
    ) -> None:
        self.scenes, self.camera, self.pivots_mm = (rest, on), camera, pivots_mm
        owner = rest.triangle_owner
        self.order = np.argsort(owner, kind="stable")
        self.starts = np.searchsorted(owner[self.order], np.arange(rest.count + 1))

    def shift_px(self, motion: FloatArray, bits: BoolArray) -> FloatArray:
        """Shift (n, 2) px of each paint's centroid because its tip is out; 0 where it is not.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation (rad) of the wall under each marker.
        bits : (n,) bool
            Switches that are on.
        """
        out = np.zeros((len(bits), 2))
        ids = np.flatnonzero(bits)
        if len(ids):
            before, after = (self._centroids(scene, motion, ids) for scene in self.scenes)
            out[ids] = np.nan_to_num(after - before)
        return out

    def _centroids(self, scene: RenderScene, motion: FloatArray, ids: IntArray) -> FloatArray:
        """Centroids (m, 2) px of the paint of receptors ``ids`` (m,), each alone."""
        own = np.concatenate([self.order[self.starts[i] : self.starts[i + 1]] for i in ids])
        vertices, index = np.unique(scene.triangles[own], return_inverse=True)
        some = replace(
            scene,
            vertices=scene.vertices[vertices],
            triangles=index.reshape(-1, 3).astype(np.int32),
            part=scene.part[own],
            vertex_owner=scene.vertex_owner[vertices],
        ).moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
        view = project_scene(some, self.camera)
        chosen, starts = pieces_by_marker(some, view)
        windows = marker_windows(view, chosen, starts, self.camera)
        # One more entry, for the triangle -1.
        paint = np.append(paint_owner(some.part) >= 0, False)
        out = np.full((len(ids), 2), np.nan)
        for k, i in enumerate(ids):
            if windows[i, 2] > 0:
                out[k] = self._centroid(view, chosen[starts[i] : starts[i + 1]], windows[i], paint)
        return out

    def _centroid(
        self, view: View, chosen: NDArray[np.int32], window: IntArray, paint: BoolArray
    ) -> FloatArray:
        """Centroid (2,) px of the paint that pieces show in a window."""
        left, top, columns, rows = (int(value) for value in window)
        x, y = np.meshgrid(np.arange(columns) + left, np.arange(rows) + top)
        total = np.zeros(3)
        for right, down in sample_offsets(SAMPLES):
            here = view
            if view.rays.shape[0] > 0:
                pixels = np.column_stack([x.ravel() + right, y.ravel() + down])
                rays = self.camera.lens.unproject(pixels).reshape(rows, columns, 3)
                here = view._replace(rays=rays, origin=np.array([left, top]))
            owner = np.full((rows, columns), -1, dtype=np.int32)
            grid = (left, top, 1, float(right), float(down))
            fill(here, chosen, grid, owner, np.zeros(owner.shape))
            seen = paint[owner]
            total += [seen.sum(), (x[seen] + right).sum(), (y[seen] + down).sum()]
        return np.asarray(total[1:] / total[0] if total[0] > 0.0 else np.full(2, np.nan))
