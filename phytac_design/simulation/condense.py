"""Mechanics and camera condensed to matrices: what the decoder needs of a sensor."""

from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

ALONG_MIN = 1e-3
"""Sine of the angle between view and normal below which u cannot be observed (0.06°)."""


@dataclass(frozen=True, kw_only=True)
class Condensed:
    """Matrices over n markers; see ``phytac_decoder.estimation.estimators.ForceModel``.

    Attributes
    ----------
    shift_to_mm : (n, 2) float
        a_i of the apparent displacement u_i = a_i · (pixel shift); 0 where u_i is not observable.
    compliance_px : (2n, n) float
        Pixel shifts per newton on each marker's footprint.
    stiffness : (n, n) float
        K of F = K·u, N/mm; rows and columns of markers whose u_i is not observable are 0.
    condition : float
        Condition number of the compliance that K inverts.
    sensitivity_px_mm : (n,) float
        |s_i|: how far a marker's image moves per millimetre of inward motion; small where the
        camera looks along the normal.
    """

    shift_to_mm: FloatArray
    compliance_px: FloatArray
    stiffness: FloatArray
    condition: float
    sensitivity_px_mm: FloatArray


def condense(slope: FloatArray, *, normal: FloatArray, motion: FloatArray) -> Condensed:
    """Condense a marker compliance to pixels and to the apparent displacement u.

    The camera measures two numbers per marker and a tip has three unknown translations, so the
    paper's u has to be *defined*: u_i is the inward motion that would explain the marker's shift
    best if it moved along its normal only, u_i = s·Δ/|s|² with s = J·(-n) the pixels per mm of
    inward motion. K is the inverse of the compliance in u, so every other motion is condensed
    load-free and F = K·u is exact for normal forces on the markers (derived here). Where the
    camera looks along the normal, s vanishes: u_i says nothing, and K counts that marker as
    load-free.

    Parameters
    ----------
    slope : (n, 2, 3) or (n, 2, 6) float
        Derivative of each marker's image by its translation (px/mm), or by that of the wall under
        it and its rotation (px/rad).
    normal : (n, 3) float
        Outward normals.
    motion : (n, 3, n) or (n, 6, n) float
        That motion per newton on each marker.

    Raises
    ------
    NumericalError
        If pressing a marker moves no marker's image, or K cannot be formed to half of double
        precision.
    """
    # Above this the condensed stiffness has lost more than half of double precision.
    condition_max = 1e10
    compliance_px = np.einsum("nij,njm->nim", slope, motion)
    if not np.isfinite(compliance_px).all():
        marker = int(np.flatnonzero(~np.isfinite(compliance_px).all(axis=(1, 2)))[0])
        raise NumericalError(
            "marker-not-seen",
            f"marker {marker}: the shift of its image is not finite: the camera does not see it; "
            "run `phytac check` on the design",
        )
    shift_to_mm, sensitivity = observable(slope[:, :, :3], normal)
    seen = np.flatnonzero(shift_to_mm.any(axis=1))
    # What motion as large could do the other way.
    parts = [slice(k, k + 3) for k in range(0, slope.shape[2], 3)]
    scale = [np.linalg.norm(slope[:, :, part], ord=2, axis=(1, 2)) for part in parts]
    each = [
        own[:, None] * np.abs(motion[:, part]).max(axis=1)
        for own, part in zip(scale, parts, strict=True)
    ]
    possible = np.sum(each, axis=0).max(axis=0)
    still = np.abs(compliance_px).max(axis=(0, 1)) <= ALONG_MIN * possible
    if still.any():
        marker = int(np.argmax(still))
        raise NumericalError(
            "marker-force-unobservable",
            f"marker {marker}: pressing it moves no marker's image: the camera looks along its "
            "normal, so its force cannot be read; place more markers beside it",
        )
    apparent = np.einsum("ni,nim->nm", shift_to_mm, compliance_px)[np.ix_(seen, seen)]
    condition = float(np.linalg.cond(apparent)) if len(seen) else 1.0
    if not condition < condition_max:
        raise NumericalError(
            "compliance-singular",
            f"the markers' compliance cannot be inverted (condition {condition:.2g}): markers "
            "are too close for the wall's thickness; use fewer rows or columns",
        )
    stiffness = np.zeros((len(normal), len(normal)))
    stiffness[np.ix_(seen, seen)] = np.linalg.inv(apparent)
    return Condensed(
        shift_to_mm=shift_to_mm,
        compliance_px=compliance_px.reshape(2 * len(normal), -1),
        stiffness=stiffness,
        condition=condition,
        sensitivity_px_mm=sensitivity,
    )


def observable(slope: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What turns pixel shifts into the apparent displacement u.

    Parameters
    ----------
    slope : (n, 2, 3) float
        Jacobian of the camera at the paint, px/mm.
    normal : (n, 3) float
        Outward normals.

    Returns
    -------
    shift_to_mm, sensitivity_px_mm : (n, 2) and (n,) float
        See :class:`Condensed`.
    """
    inward = -np.einsum("nij,nj->ni", slope, normal)
    sensitivity = np.linalg.norm(inward, axis=1)
    seen = sensitivity > ALONG_MIN * np.linalg.norm(slope, ord=2, axis=(1, 2))
    shift_to_mm = np.zeros_like(inward)
    shift_to_mm[seen] = inward[seen] / sensitivity[seen, None] ** 2
    return shift_to_mm, sensitivity
