"""Axes of the receptor tubes, their painted bands and their holes, from markers and surface."""

from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import BoolArray, FloatArray
from shapes.errors import DesignError

OVERSHOOT_mm = 0.05
"""How far a hole's cutter runs past the end face, so that the faces never coincide."""


@dataclass(frozen=True, kw_only=True)
class ReceptorAxes:
    """Rods along the receptors' axes; arrays are (n, 3) mm over markers.

    Attributes
    ----------
    root_mm : (n, 3) float
        Where the tube begins, inside the wall.
    tip_mm : (n, 3) float
        Centre of the end face.
    band_mm : (n, 3) float
        Where the painted band begins; the root if the whole tube is painted.
    hole_start_mm, hole_end_mm : (n, 3) float
        Axis of the hole's cutter, from outside the outer face to beyond the end face.
    painted : (n,) bool
        Whether the whole tube is painted (the band is not shorter than the receptor).
    """

    root_mm: FloatArray
    tip_mm: FloatArray
    band_mm: FloatArray
    hole_start_mm: FloatArray
    hole_end_mm: FloatArray
    painted: BoolArray


def rim_sag_mm(surface: Surface, markers: Markers, radius_mm: float) -> tuple[FloatArray, ...]:
    """Highest and lowest point of a tangent disc's edge above the outer face, (n,) mm each.

    A disc of ``radius_mm`` in the tangent plane of each marker: positive where its edge stands
    out of the surface (convex), negative where it dips under it (concave).
    """
    along = surface.tangents(markers.uv)[:, 0]
    first = along / np.linalg.norm(along, axis=1, keepdims=True)
    second = np.cross(markers.normal, first)
    angle = np.pi / 4.0 * np.arange(8)
    ring = first[:, None] * np.cos(angle)[:, None] + second[:, None] * np.sin(angle)[:, None]
    centre = surface.point(markers.uv)
    points = (centre[:, None] + radius_mm * ring).reshape(-1, 3)
    foot = surface.chart(points)
    height = np.einsum("ni,ni->n", points - surface.point(foot), surface.normal(foot))
    height = height.reshape(-1, 8)
    return height.max(axis=1), height.min(axis=1)


def root_depth_mm(design: Design, surface: Surface, markers: Markers) -> FloatArray:
    """Depth below the outer face at which each tube's flat root lies wholly in the wall, (n,) mm.

    Raises
    ------
    DesignError
        If the wall curves away so much under a tube that no flat root stays inside it.
    """
    thickness = design.wall.thickness_mm
    high, low = rim_sag_mm(surface, markers, design.receptor.diameter_outer_mm / 2.0)
    least, most = np.maximum(high, 0.0), thickness + np.minimum(low, 0.0)
    bad = np.flatnonzero(most - least <= 0.05 * thickness)
    if bad.size:
        worst = bad[np.argmin((most - least)[bad])]
        raise DesignError(
            f"a receptor of row {markers.row[worst]} does not fit the curved wall: under its "
            f"{design.receptor.diameter_outer_mm:g} mm tube the surface falls by "
            f"{high[worst]:.2f} mm in a wall of {thickness:g} mm; lower "
            "receptor.diameter_outer_mm or raise wall.thickness_mm"
        )
    return (least + most) / 2.0


def receptor_axes(design: Design, surface: Surface, markers: Markers) -> ReceptorAxes:
    """Axes of all tubes, bands and holes."""
    receptor = design.receptor
    depth = root_depth_mm(design, surface, markers)
    root = surface.point(markers.uv, -depth)
    painted = receptor.band_marker_mm >= markers.height_mm - 1e-9
    band = markers.tip_mm + receptor.band_marker_mm * markers.normal
    # Half a tube diameter outside, the whole disc of the cutter is clear of any sane surface.
    outside = surface.point(markers.uv, receptor.diameter_outer_mm / 2.0)
    return ReceptorAxes(
        root_mm=root,
        tip_mm=markers.tip_mm,
        band_mm=np.where(painted[:, None], root, band),
        hole_start_mm=outside,
        hole_end_mm=markers.tip_mm - OVERSHOOT_mm * markers.normal,
        painted=painted,
    )
