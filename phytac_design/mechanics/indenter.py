"""Contact patches under indenters of a shape, with friction."""

from dataclasses import dataclass

from phytac_shapes.arrays import FloatArray, IntArray

INDENTERS = ("flat", "sphere", "cylinder")
"""Pressure of each: even over a disc; Hertz's over a disc; Hertz's across a strip, even along."""
FLAT, SPHERE, CYLINDER = range(3)
"""Indices into ``INDENTERS``."""


@dataclass(frozen=True, kw_only=True)
class Indentations:
    """Contact patches on the outer face; arrays run over c patches.

    Attributes
    ----------
    uv : (c, 2) float
        Centre, chart coordinates.
    radius_mm : (c,) float
        Radius of a disc, or half-width of a cylinder's strip.
    force_N : (c,) float
        Inward normal force.
    indenter : (c,) int
        Index into ``INDENTERS``.
    length_mm : (c,) float
        Length of a cylinder's strip; 0 for the others.
    turn_rad : (c,) float
        A cylinder's axis: angle from the direction of growing u in the tangent plane at the
        centre, right-handed about the outward normal.
    friction : (c, 2) float
        Tangential over normal force, in the direction of growing u and square to it (right-handed
        about the outward normal). Spread as the pressure is.
    """

    uv: FloatArray
    radius_mm: FloatArray
    force_N: FloatArray
    indenter: IntArray
    length_mm: FloatArray
    turn_rad: FloatArray
    friction: FloatArray
