"""How tall receptors are, and where they point."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.arc import along_u
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


def profile_heights_mm(
    design: Design, surface: Surface, uv: FloatArray, *, in_rows: bool
) -> FloatArray:
    """Heights (n,) by the distance along the surface, from its near to its far end.

    With rows, from the first row to the last, so that these have the heights of the design.
    ``line-of-sight`` starts from the near height.
    """
    layout = design.layout
    near, far = layout.height_near_mm, layout.height_far_mm
    if layout.heights in {"constant", "line-of-sight"}:
        return np.full(len(uv), near)
    stations = np.linspace(0.0, 1.0, 1025)
    share = np.interp(uv[:, 0], along_u(surface, stations), stations)
    if in_rows:
        spread = float(np.ptp(share))
        share = (share - share.min()) / spread if spread > 0.0 else np.zeros(len(uv))
    power = layout.height_exponent if layout.heights == "power" else 1.0
    return np.asarray(near + (far - near) * share**power)


def directions(design: Design, surface: Surface, uv: FloatArray, normal: FloatArray) -> FloatArray:
    """Unit vectors from base to tip, (n, 3).

    Raises
    ------
    DesignError
        If a receptor would lie more in the wall than on it.
    """
    # Cosine of the largest angle between a receptor and the wall's normal.
    lean_max = np.cos(np.radians(60.0))
    receptor = design.receptor
    inward = np.asarray(-normal + 0.0)
    if receptor.direction == "normal" or (
        receptor.direction == "tilted" and receptor.tilt_deg == 0.0
    ):
        return inward
    if receptor.direction == "tilted":
        along = surface.tangents(uv)[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        lean = np.radians(receptor.tilt_deg)
        return np.asarray(np.cos(lean) * inward - np.sin(lean) * along)
    to_axis = -surface.point(uv) * np.array([1.0, 1.0, 0.0])
    size = np.linalg.norm(to_axis, axis=1)
    out = to_axis / np.maximum(size, 1e-300)[:, None]
    cosine = np.sum(out * inward, axis=1)
    worst = int(np.argmin(cosine))
    if cosine[worst] < lean_max:
        raise DesignError(
            "receptor-direction-too-oblique",
            f"receptors towards the axis would lie in the wall of the {surface.name} (marker "
            f"{worst} leans {np.degrees(np.arccos(np.clip(cosine[worst], -1.0, 1.0))):.0f}° from "
            "the wall's normal, at most 60°); set receptor.direction to 'normal'",
        )
    return np.asarray(out)
