"""What a red tip that is out covers of its own marker's paint, in any pose."""

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.optics.frame_renderer import sample_offsets
from phytac_design.optics.raster import paint_alone, project_scene
from phytac_design.optics.render_scene import RenderScene
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


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

    samples = 8
    """Samples per pixel."""

    def __init__(
        self, rest: RenderScene, on: RenderScene, camera: Camera, pivots_mm: FloatArray
    ) -> None:
        self.scenes, self.camera, self.pivots_mm = (rest, on), camera, pivots_mm

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
        own = np.flatnonzero(np.isin(scene.triangle_owner, ids))
        some = scene.part_of(own).moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
        view = project_scene(some, self.camera)
        sums = np.zeros((some.count, 3))
        for right, down in sample_offsets(self.samples):
            sums += paint_alone(some, self.camera, view=view, offset_px=(float(right), float(down)))
        return np.asarray(sums[ids, 1:] / np.where(sums[ids, :1] > 0.0, sums[ids, :1], np.nan))
