"""Paint of a judged design, carried along by the receptors of designs like it.

The point of a receptor that is watched, and what turning shows besides moving it, are taken in the
receptor's own frame and carried along as they are, whatever its sizes: stretching them with band
and tube was looked at, and is no nearer to whole runs.
"""

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.layout import Markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.simulation.response import rigid_slope
from phytac_design.study.advice.design_evaluation import EvaluatedDesign
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray


class CarriedPaint:
    """What designs like a judged one show.

    Parameters
    ----------
    base : Judged
        The design.
    """

    def __init__(self, base: EvaluatedDesign) -> None:
        self.base = base
        self.local, self.more = local_paint(base)

    def slopes(
        self, surface: Surface, markers: Markers, cameras: tuple[Camera, ...]
    ) -> tuple[list[FloatArray], IntArray]:
        """How paint moves on each camera's image (n, 2, 6), 0 if unseen; which camera reads it."""
        base = self.base
        like = np.arange(markers.count)
        if markers.count != base.markers.count:
            # Markers of other layouts show what those as far along show.
            before, after = (one.unwrap(m.uv)[:, 1] for one, m in
                             ((base.surface, base.markers), (surface, markers)))  # fmt: skip
            like = np.abs(after[:, None] - before[None]).argmin(axis=1)
        slopes = []
        for number, camera in enumerate(cameras):
            frame = frames_of(markers, camera)
            watched = markers.tip_mm + np.einsum("nk,nkj->nj", self.local[number][like], frame)
            image = camera.jacobian(watched)
            more = _turned(self.more[number][like], frame)
            slope = rigid_slope(image, watched - markers.mid_mm) + image @ more
            seen = base.views["seen_by"][number][like]
            slopes.append(np.where(seen[:, None, None], slope, 0.0))
        return slopes, base.views["camera"][like]


def frames_of(markers: Markers, camera: Camera) -> FloatArray:
    """Unit vectors (n, 3, 3) of each receptor: along it, towards the camera, across."""
    axis = markers.direction
    sight = camera.position_mm - markers.tip_mm
    side = sight - np.sum(sight * axis, axis=1, keepdims=True) * axis
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return np.stack([axis, side, np.cross(axis, side)], axis=1)


def local_paint(base: EvaluatedDesign) -> tuple[list[FloatArray], list[FloatArray]]:
    """From each tip to the paint that each camera sees, in the frames of the receptors.

    Returns
    -------
    offsets : list of (n, 3) float
        mm.
    more : list of (n, 3, 6) float
        How this point would have to move, per mm and radian of the wall, to show what the paint
        does besides moving with it: another part of it comes into sight.
    """
    offsets, more = [], []
    markers, views = base.markers, base.views
    for number, camera in enumerate(cameras_of(base.design, base.surface)):
        watched, frame = views["paint_points_mm"][number], frames_of(markers, camera)
        offsets.append(np.einsum("nkj,nj->nk", frame, watched - markers.tip_mm))
        image = camera.jacobian(watched)
        besides = views["paint_slopes"][number] - rigid_slope(image, watched - markers.mid_mm)
        seen = views["seen_by"][number][:, None, None]
        apart = np.linalg.pinv(np.where(seen, image, 0.0)) @ np.where(seen, besides, 0.0)
        more.append(_turned(apart, np.swapaxes(frame, 1, 2)))
    return offsets, more


def _turned(more: FloatArray, frame: FloatArray) -> FloatArray:
    """Maps (n, 3, 6) of translation and rotation, given in ``frame`` (n, 3, 3), as seen outside."""
    out = np.swapaxes(frame, 1, 2)
    parts = [out @ part @ frame for part in (more[:, :, :3], more[:, :, 3:])]
    return np.concatenate(parts, axis=2)
