"""Paint of a judged design, carried along by the receptors of designs like it.

What a camera sees of a receptor is the image of its end face and of the band behind it. Where the
two balance is the point that is watched; as the receptor turns, it shows more of the one and less
of the other. Both are taken in the receptor's own frame and stretched with its sizes.
"""

import numpy as np

from decoder.camera import Camera
from phytac_design.layout import Markers
from phytac_design.optics.view import cameras_of
from phytac_design.spec import Design
from phytac_design.study.advice.judge import Judged
from phytac_design.twin.response import rigid_slope
from shapes import Surface
from shapes.arrays import FloatArray, IntArray

SHARE_MIN = 1e-3
"""Least share of a marker's image that band and end face are taken to have."""


class CarriedPaint:
    """What designs like a judged one show.

    Parameters
    ----------
    base : Judged
        The design.
    """

    def __init__(self, base: Judged) -> None:
        self.base = base
        self.local, self.more = local_paint(base)

    def slopes(
        self, design: Design, surface: Surface, markers: Markers, cameras: tuple[Camera, ...]
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
        band = np.minimum(design.receptor.band_marker_mm, markers.height_mm)
        own = np.minimum(base.design.receptor.band_marker_mm, base.markers.height_mm)[like]
        longer = np.divide(band, own, out=np.ones_like(band), where=own > 0.0)
        wider = design.receptor.diameter_outer_mm / base.design.receptor.diameter_outer_mm
        for number, camera in enumerate(cameras):
            frame = frames_of(markers, camera)
            local = self.local[number][like]
            point, turning = _stretches(band_share(local, own), longer, wider)
            offset = np.einsum("nk,nkj->nj", point * local, frame)
            watched = markers.tip_mm + offset
            image = camera.jacobian(watched)
            more = _turned(turning[:, :, None] * self.more[number][like], frame)
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


def local_paint(base: Judged) -> tuple[list[FloatArray], list[FloatArray]]:
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


def band_share(offset_mm: FloatArray, band_mm: FloatArray) -> FloatArray:
    """Share (n,) of a marker's image that its band takes, its end face taking the rest.

    The end face is at the tip, the band's middle half its width behind.

    Parameters
    ----------
    offset_mm : (n, 3) float
        From the tip to the paint that is seen, along the receptor first.
    band_mm : (n,) float
        Width of the band.
    """
    half = np.where(band_mm > 0.0, band_mm / 2.0, np.inf)
    return np.clip(-offset_mm[:, 0] / half, SHARE_MIN, 1.0 - SHARE_MIN)


def _stretches(
    share: FloatArray, longer: FloatArray, wider: float
) -> tuple[FloatArray, FloatArray]:
    """What offsets (n, 3) to the paint and what turning shows grow by with band and tube.

    A band's image grows with its width and the tube's, the end face's with the tube's twice. The
    centroid is where the two balance, and turning shows more of the one and less of the other.
    """
    ratio = share / (1.0 - share) * longer / wider
    new = ratio / (1.0 + ratio)
    more, balance = new / share, new * (1.0 - new) / (share * (1.0 - share))
    point = np.column_stack([longer * more, wider * more, wider * more])
    return point, np.column_stack([longer * balance, wider * balance, wider * more])


def _turned(more: FloatArray, frame: FloatArray) -> FloatArray:
    """Maps (n, 3, 6) of translation and rotation, given in ``frame`` (n, 3, 3), as seen outside."""
    out = np.swapaxes(frame, 1, 2)
    parts = [out @ part @ frame for part in (more[:, :, :3], more[:, :, 3:])]
    return np.concatenate(parts, axis=2)
