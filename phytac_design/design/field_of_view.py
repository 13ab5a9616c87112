"""Field of view and focal length: what a data sheet states, and what a lens model needs."""

import numpy as np

from phytac_decoder.camera.lens import Lens

FIELD_OF_VIEW_MAX_deg = 280.0
"""The widest fisheye lenses that are made (such as Entaniya's of 280°)."""
STRAIGHT_MAX_deg = 140.0
"""Lenses without distortion end at about 130°; beyond, their edges would be dark and blurred."""


def focal_of_view_px(unit: Lens, field_of_view_deg: float) -> float:
    """Focal length at which a lens sees this angle from the left to the right edge of its image.

    The principal point counts as the middle of the image; tangential distortion is ignored.

    Parameters
    ----------
    unit : Lens
        The lens with a focal length of 1 px along x.
    field_of_view_deg : float
        Horizontal field of view.

    Raises
    ------
    ValueError
        If no lens that is made sees so much, or the lens model sees no direction that far from
        its axis.
    """
    if field_of_view_deg > FIELD_OF_VIEW_MAX_deg:
        raise ValueError(
            f"no lens sees {field_of_view_deg:g}° across: the widest fisheyes end at "
            f"{FIELD_OF_VIEW_MAX_deg:g}°; give the angle from the left to the right edge of the "
            "image as in the data sheet, or focal_px where the image circle ends before the edges"
        )
    half = np.deg2rad(field_of_view_deg / 2.0)
    edge = unit.project(np.array([[np.sin(half), 0.0, np.cos(half)]]))[0, 0] - unit.cx_px
    # Beyond one focal length per image width, rounding would leave nothing of the focal length.
    if not 0.0 < edge <= unit.width_px:
        raise ValueError(
            f"a {unit.model} lens with this distortion sees less than {field_of_view_deg:g}° "
            f"(its limit is {np.rad2deg(2.0 * unit.field_rad):.1f}°); lower field_of_view_deg, or "
            'set model = "kannala_brandt" for a fisheye'
        )
    if unit.model == "pinhole" and field_of_view_deg > STRAIGHT_MAX_deg:
        raise ValueError(
            f"no lens without distortion sees {field_of_view_deg:g}° across: they end at about "
            f'{STRAIGHT_MAX_deg:g}°; set model = "kannala_brandt" for a fisheye'
        )
    return round(float(unit.width_px / 2.0 / edge), 3)


def fields_of_view_deg(lens: Lens) -> tuple[float, float]:
    """Angles between the middles of opposite image edges: horizontal and vertical.

    Where the image circle ends before the edge, the angle ends there too.
    """
    x, y = lens.centre_px
    edges = np.array(
        [[-0.5, y], [lens.width_px - 0.5, y], [x, -0.5], [x, lens.height_px - 0.5]],
        dtype=np.float64,
    )
    away = lens.unproject(edges)
    angle = np.arctan2(np.hypot(away[:, 0], away[:, 1]), away[:, 2])
    left, right, up, down = np.rad2deg(np.where(np.isfinite(angle), angle, lens.field_rad))
    return float(left + right), float(up + down)
