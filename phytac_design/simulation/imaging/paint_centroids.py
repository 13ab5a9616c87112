"""Where the paint of every marker is on the image, without an image.

The paint that faces the camera is a handful of triangles per marker. They move rigidly with their
receptor; each counts with its area on the image and with the chroma that the decoder would see in
its light, so that turning away and shading move the centroid as they do in a frame. A tube hides
its own far side; what neighbours hide is left to ``optics.loaded_visibility``.
"""

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.vision.segmentation import ColourModel
from phytac_design.layout import Markers
from phytac_design.optics.light import Strip, triangle_light
from phytac_design.optics.paint import resin_of, to_srgb
from phytac_design.optics.render_scene import RenderScene, paint_owner
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


class PaintPoints:
    """Paint of some markers of one scene, through one camera.

    Parameters
    ----------
    scene : Scene
        At rest.
    camera : Camera
        Through which they are read.
    markers : Markers
        Of the scene.
    chosen : (n,) bool
        Markers to follow.
    colours, colour : ColourModel, (n,) int
        The decoder's paints, and the class of each marker's.
    strip, paint
        Light and albedo, see ``triangle_light``.
    """

    def __init__(
        self,
        scene: RenderScene,
        camera: Camera,
        markers: Markers,
        *,
        chosen: BoolArray,
        colours: ColourModel,
        colour: IntArray,
        strip: Strip | None = None,
        paint: FloatArray | None = None,
    ) -> None:
        owner = paint_owner(scene.part)
        own = np.flatnonzero((owner >= 0) & chosen[owner])
        self.scene = scene.part_of(own)
        self.owner, self.camera, self.count = owner[own], camera, scene.count
        self.strip, self.paint = strip, paint
        self.chroma = colours.chroma[colour[self.owner]]
        self.wall = np.array(resin_of(scene.paints, scene.table)) if colours.dots else None
        self.counts = colours.counts
        self.pivots_mm = markers.mid_mm
        corners = self.scene.vertices[self.scene.triangles]
        # The end face looks along the axis, the band away from it.
        axis = (markers.tip_mm - markers.base_mm)[self.owner]
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        arm = corners.mean(axis=1) - markers.tip_mm[self.owner]
        along = np.sum(arm * axis, axis=1, keepdims=True)
        out = arm - along * axis + np.where(along > -1e-6, 1e6, 0.0) * axis
        self.sign = np.sign(np.sum(_normals(corners) * out, axis=1))

    def centroids(self, motion: FloatArray, brightness: float = 1.0) -> FloatArray:
        """Centroid (n, 2) px of each marker's paint; NaN for one that is not followed or seen.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation (rad) of the wall under each marker.
        brightness : float
            Of the light.
        """
        moved = self.scene.moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
        corners = moved.vertices[moved.triangles]
        image = self.camera.project(moved.vertices)[moved.triangles]
        back = self.camera.position_mm - corners.mean(axis=1)
        faces = self.sign * np.sum(_normals(corners) * back, axis=1) > 0.0
        a, b = image[:, 1] - image[:, 0], image[:, 2] - image[:, 0]
        area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        light = triangle_light(moved, self.camera, strip=self.strip, paint=self.paint)
        weight = np.where(faces & np.isfinite(area), area, 0.0) * self._seen_chroma(
            brightness * light
        )
        centre = np.nan_to_num(image.mean(axis=1))
        total = np.bincount(self.owner, weights=weight, minlength=self.count)
        sums = [
            np.bincount(self.owner, weights=weight * centre[:, k], minlength=self.count)
            for k in range(2)
        ]
        found = np.column_stack(sums) / np.where(total > 0.0, total, np.nan)[:, None]
        last = np.array([self.camera.width_px, self.camera.height_px]) - 0.5
        with np.errstate(invalid="ignore"):
            inside = np.all((found >= -0.5) & (found <= last), axis=1)
        return np.where(inside[:, None], found, np.nan)

    def slope(self) -> FloatArray:
        """How centroids move with the wall under each marker, (n, 2, 6): px per mm, px per rad.

        A receptor that turns shows more paint on one side and less on the other, so its centroid
        is no point of it. NaN where no paint is followed or seen.
        """
        step = 2e-3  # of the wall's motion, mm and rad, by which slopes are found
        out = np.full((self.count, 2, 6), np.nan)
        for k in range(6):
            motion = np.zeros((self.count, 6))
            motion[:, k] = step
            out[:, :, k] = (self.centroids(motion) - self.centroids(-motion)) / (2.0 * step)
        return out

    def _seen_chroma(self, light: FloatArray) -> FloatArray:
        """What each triangle (T,) counts for by its share of its paint's full chroma."""
        # Red less luma to Cr, blue less luma to Cb (as OpenCV has it).
        chroma_of_rgb = np.array([0.713, 0.564])
        luma_of_rgb = np.array([0.299, 0.587, 0.114])
        srgb = to_srgb(light)
        if self.wall is not None:
            contrast = np.abs((srgb - self.wall) @ luma_of_rgb)
            srgb = np.outer(contrast, [0.0, 0.0, 1.0])
        luma = srgb @ luma_of_rgb
        chroma = chroma_of_rgb * (srgb[:, [0, 2]] - luma[:, None])
        size = np.linalg.norm(self.chroma, axis=1)
        share = np.sum(chroma * self.chroma, axis=1) / size**2
        return self.counts(share)


def _normals(corners: FloatArray) -> FloatArray:
    """Normals (T, 3) of triangles (T, 3, 3), not normalised."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
