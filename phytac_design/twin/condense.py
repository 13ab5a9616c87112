"""Mechanics and camera condensed to matrices: what the decoder needs of a sensor."""

from dataclasses import dataclass

import numpy as np

from decoder.camera import Camera
from shapes.arrays import FloatArray
from shapes.errors import NumericalError

CONDITION_MAX = 1e10
"""Above this the condensed stiffness has lost more than half of double precision."""


@dataclass(frozen=True, kw_only=True)
class Condensed:
    """Matrices over n markers; see ``decoder.estimators.ForceModel``.

    Attributes
    ----------
    shift_to_mm : (n, 2) float
        a_i of the apparent displacement u_i = a_i · (pixel shift).
    compliance_px : (2n, n) float
        Pixel shifts per newton on each marker's footprint.
    stiffness : (n, n) float
        K of F = K·u, N/mm.
    condition : float
        Condition number of the compliance that K inverts.
    """

    shift_to_mm: FloatArray
    compliance_px: FloatArray
    stiffness: FloatArray
    condition: float


def condense(
    camera: Camera, *, watched_mm: FloatArray, normal: FloatArray, motion_mm: FloatArray
) -> Condensed:
    """Condense a marker compliance to pixels and to the apparent displacement u.

    The camera measures two numbers per marker and a tip has three unknown translations, so the
    paper's u has to be *defined*: u_i is the inward motion that would explain the marker's shift
    best if it moved along its normal only, u_i = s·Δ/|s|² with s = J·(-n) the pixels per mm of
    inward motion. K is the inverse of the compliance in u, so every other motion is condensed
    load-free and F = K·u is exact for normal forces on the markers (derived here).

    Parameters
    ----------
    camera : Camera
        The true lens.
    watched_mm : (n, 3) float
        The paint's visible centre.
    normal : (n, 3) float
        Outward normals.
    motion_mm : (n, 3, n) float
        Translation of each watched point per newton on each marker.

    Raises
    ------
    NumericalError
        If K cannot be formed to half of double precision.
    """
    slope = camera.jacobian(watched_mm)
    inward = -np.einsum("nij,nj->ni", slope, normal)
    size = np.sum(inward**2, axis=1)
    if not (np.isfinite(size).all() and (size > 0.0).all()):
        marker = int(np.argmin(np.where(np.isfinite(size), size, -1.0)))
        raise NumericalError(
            f"marker {marker}: pressing it moves its image by nothing; the camera looks along its "
            "normal, so its force cannot be read from one camera"
        )
    shift_to_mm = inward / size[:, None]
    compliance_px = np.einsum("nij,njm->nim", slope, motion_mm)
    apparent = np.einsum("ni,nim->nm", shift_to_mm, compliance_px)
    condition = float(np.linalg.cond(apparent))
    if not condition < CONDITION_MAX:
        raise NumericalError(
            f"the markers' compliance cannot be inverted (condition {condition:.2g}): markers "
            "are too close for the wall's thickness; use fewer rows or columns"
        )
    return Condensed(
        shift_to_mm=shift_to_mm,
        compliance_px=compliance_px.reshape(2 * len(normal), -1),
        stiffness=np.linalg.inv(apparent),
        condition=condition,
    )
