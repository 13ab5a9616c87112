"""Paint of an evaluated design transferred to the receptors of designs like it.

The visible point of a receptor, and the change of what is visible when it turns, are expressed in
the receptor's own frame and transferred unscaled; scaling them with band and tube is no closer to
exact evaluations.
"""

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.layout import Markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.simulation.linear_response import rigid_slope
from phytac_design.study.advice.design_evaluation import EvaluatedDesign
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray


class PaintTransfer:
    """Image motion of the paint of designs like an evaluated one.

    For each camera it keeps, in the receptors' frames, the offset (n, 3) mm from the tip to the
    visible paint, and how this point would have to move (n, 3, 6), per mm and radian of the wall,
    to show what the paint does besides moving rigidly: another part of it becomes visible.
    """

    def __init__(self, base: EvaluatedDesign) -> None:
        self.base = base
        self.offsets: list[FloatArray] = []
        self.turns: list[FloatArray] = []
        markers, views = base.markers, base.views
        for number, camera in enumerate(cameras_of(base.design, base.surface)):
            watched, frame = views["paint_points_mm"][number], _frames(markers, camera)
            self.offsets.append(np.einsum("nkj,nj->nk", frame, watched - markers.tip_mm))
            image = camera.jacobian(watched)
            rest = views["paint_slopes"][number] - rigid_slope(image, watched - markers.mid_mm)
            seen = views["seen_by"][number][:, None, None]
            motion = np.linalg.pinv(np.where(seen, image, 0.0)) @ np.where(seen, rest, 0.0)
            self.turns.append(_rotated(motion, np.swapaxes(frame, 1, 2)))

    def slopes(
        self, surface: Surface, markers: Markers, cameras: tuple[Camera, ...]
    ) -> tuple[list[FloatArray], IntArray]:
        """Image motion per wall motion for each camera (n, 2, 6), 0 if unseen; camera of each."""
        base = self.base
        like = np.arange(markers.count)
        if markers.count != base.markers.count:
            # Markers of other layouts show what the nearest along the sensor show.
            before = base.surface.unwrap(base.markers.uv)[:, 1]
            after = surface.unwrap(markers.uv)[:, 1]
            like = np.abs(after[:, None] - before).argmin(axis=1)
        slopes = []
        for number, camera in enumerate(cameras):
            frame = _frames(markers, camera)
            watched = markers.tip_mm + np.einsum("nk,nkj->nj", self.offsets[number][like], frame)
            image = camera.jacobian(watched)
            turns = _rotated(self.turns[number][like], frame)
            slope = rigid_slope(image, watched - markers.mid_mm) + image @ turns
            seen = base.views["seen_by"][number][like]
            slopes.append(np.where(seen[:, None, None], slope, 0.0))
        return slopes, base.views["camera"][like]


def _frames(markers: Markers, camera: Camera) -> FloatArray:
    """Unit vectors (n, 3, 3) of each receptor: along it, towards the camera, across."""
    axis = markers.direction
    sight = camera.position_mm - markers.tip_mm
    side = sight - np.sum(sight * axis, axis=1, keepdims=True) * axis
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return np.stack([axis, side, np.cross(axis, side)], axis=1)


def _rotated(maps: FloatArray, frame: FloatArray) -> FloatArray:
    """Maps (n, 3, 6) of translation and rotation from ``frame`` (n, 3, 3) to the outer frame."""
    out = np.swapaxes(frame, 1, 2)
    return np.concatenate([out @ part @ frame for part in (maps[:, :, :3], maps[:, :, 3:])], axis=2)
