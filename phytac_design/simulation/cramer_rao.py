r"""Cramér-Rao bounds: how well force and place of a contact *can* be read, before it is built.

A contact at chart position (u, v) of radius r and force f shifts the markers' images by
f·c(u, v, r) pixels, linear in f. With independent noise σ on every centroid coordinate the Fisher
information of θ = (f, x, y, r), x and y in mm along and around the surface, is::

    J = GᵀG / σ² + diag(0, 1/σ_x², 1/σ_y², 1/σ_r²)      G = [c, f·∂c/∂x, f·∂c/∂y, f·∂c/∂r]

and the bound of each parameter the root of the diagonal of J⁻¹. The prior states what is known of
place and size without the camera: a contact lies somewhere in the cell of the switch it trips.
No estimator without bias is better on average (van Trees 1968, for random parameters).

Motion of the cameras is a nuisance: q more unknowns b with shifts B·b and the prior precision P.
Eliminating them leaves of the first term::

    Gᵀ (1 - B (BᵀB + σ² P)⁻¹ Bᵀ) G / σ²
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.camera.camera_motion import CameraMotion
from phytac_design.simulation.contacts import tangent_step
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

Shifts = Callable[[FloatArray, FloatArray], FloatArray]
"""(uv (c, 2), radius_mm (c,)) -> pixel shift per newton (c, n, 2) of every marker."""


@dataclass(frozen=True, kw_only=True)
class PositionPrior:
    """Standard deviations of what is known beforehand, mm; inf where nothing is.

    Attributes
    ----------
    place_mm : float
        Position along and around, about the receptor.
    radius_mm : float
        Radius of the patch.
    shear : float
        Force along the surface over the normal force, each component.
    """

    place_mm: float
    radius_mm: float
    shear: float = 0.4

    @property
    def known(self) -> FloatArray:
        """Inverse variances (6,) of force, place, radius and force along the surface."""
        place, shear = self.place_mm**-2, self.shear**-2
        return np.array([0.0, place, place, self.radius_mm**-2, shear, shear])


@dataclass(frozen=True, kw_only=True)
class CramerRaoBound:
    """Least standard deviations over c contacts.

    Attributes
    ----------
    force_N : (c,) float
        Force, position and size unknown but for the prior.
    force_known_N : (c,) float
        Force, position and size known.
    along_mm, around_mm : (c,) float
        Position.
    """

    force_N: FloatArray
    force_known_N: FloatArray
    along_mm: FloatArray
    around_mm: FloatArray


def cell_prior(
    area_mm2: float, count: int, radius_min_mm: float, radius_max_mm: float
) -> PositionPrior:
    """Prior of a contact anywhere in a marker's cell, radius anywhere in its range.

    A disc of radius R has a standard deviation of R/2 along each axis; a range, of its width
    over √12.
    """
    return PositionPrior(
        place_mm=float(np.sqrt(area_mm2 / count / np.pi)) / 2.0,
        radius_mm=max((radius_max_mm - radius_min_mm) / float(np.sqrt(12.0)), 1e-6),
    )


@dataclass(frozen=True, kw_only=True)
class ContactSignals:
    """What c contacts do to all 2n centroid coordinates, per newton.

    Attributes
    ----------
    shift : (c, 2n) float
        px/N.
    slopes : (c, 2n, 3) or (c, 2n, 5) float
        Its change per mm along, around and of radius, px/N/mm; and, where that is unknown, by
        force along the surface over the normal force, px/N.
    """

    shift: FloatArray
    slopes: FloatArray

    def with_shear(self, shear_px: FloatArray) -> "ContactSignals":
        """Return the same with unknown force along the surface: shifts (c, 2, 2n) px/N by it."""
        slopes = [self.slopes[:, :, :3], np.swapaxes(shear_px, 1, 2)]
        return replace(self, slopes=np.concatenate(slopes, axis=2))

    def bound(
        self,
        force_N: FloatArray | float,
        *,
        noise_px: float,
        prior: PositionPrior,
        motion: CameraMotion | None = None,
    ) -> CramerRaoBound:
        """Bounds at forces (c,) or one for all.

        Parameters
        ----------
        force_N : float or (c,) float
            Forces.
        noise_px : float
            Standard deviation of each coordinate of each centroid.
        prior : PositionPrior
            What is known beforehand.
        motion : CameraMotion, optional
            Shifts of the same 2n coordinates by motion of the cameras, with its prior; cameras
            that stand still by default.

        Raises
        ------
        NumericalError
            If noise, force or prior are not positive.
        """
        count = len(self.shift)
        force = np.broadcast_to(np.asarray(force_N, dtype=np.float64), count)
        sizes = (noise_px, prior.place_mm, prior.radius_mm, float(force.min(initial=1.0)))
        if not all(size > 0.0 for size in sizes):
            raise NumericalError(
                "bound-input-not-positive",
                f"a bound needs noise, prior and forces above zero (got noise {sizes[0]:g} px, "
                f"place {sizes[1]:g} mm, radius {sizes[2]:g} mm, force {sizes[3]:g} N); raise "
                "camera.noise_centroid_px or training.force_min_N",
            )
        G = np.concatenate([self.shift[:, :, None], force[:, None, None] * self.slopes], axis=2)
        information = np.swapaxes(G, 1, 2) @ G / noise_px**2
        if motion is not None:
            inner = motion.first @ motion.first.T + noise_px**2 * motion.prior
            cross = motion.first @ G
            information -= np.swapaxes(cross, 1, 2) @ np.linalg.solve(inner, cross) / noise_px**2
        covariance = np.linalg.inv(information + np.diag(prior.known[: G.shape[2]]))
        spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        return CramerRaoBound(
            force_N=spread[:, 0],
            force_known_N=1.0 / np.sqrt(information[:, 0, 0]),
            along_mm=spread[:, 1],
            around_mm=spread[:, 2],
        )


def contact_signals(
    surface: Surface, shifts: Shifts, *, uv: FloatArray, radius_mm: FloatArray | float
) -> ContactSignals:
    """Shifts and their slopes by central differences.

    Parameters
    ----------
    surface : Surface
        The outer face, for steps of equal length in every chart.
    shifts : callable
        Pixel shifts per newton; see ``Shifts``.
    uv : (c, 2) float
        Positions.
    radius_mm : float or (c,) float
        Radii.

    Raises
    ------
    NumericalError
        If a shift is not finite.
    """
    # The same as a share of the patch's radius, so that sensors of every size are alike.
    step_share = 0.05
    step_mm = 0.25  # largest step of the central differences along the surface and in radius
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    count = len(uv)
    radius = np.broadcast_to(np.asarray(radius_mm, dtype=np.float64), count)
    step = np.minimum(step_mm, step_share * radius)
    sides = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    steps = [tangent_step(surface, uv, step[:, None] * side) for side in sides]
    thin = np.minimum(step_mm, 0.25 * radius)
    places = np.concatenate([uv, *steps, uv, uv])
    radii = np.concatenate([np.tile(radius, 5), radius + thin, radius - thin])
    per_N = shifts(places, radii).reshape(7, count, -1)
    if not np.all(np.isfinite(per_N)):
        raise NumericalError(
            "marker-not-seen",
            "a marker's image shift is not finite: a marker is not seen by the camera; run "
            "`phytac check` on the design",
        )
    spans = (
        _span(surface, steps[0], steps[1]),
        _span(surface, steps[2], steps[3]),
        2.0 * thin,
    )
    pairs = ((1, 2), (3, 4), (5, 6))
    slopes = [
        (per_N[a] - per_N[b]) / span[:, None] for (a, b), span in zip(pairs, spans, strict=True)
    ]
    return ContactSignals(shift=per_N[0], slopes=np.stack(slopes, axis=2))


def _span(surface: Surface, first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance (c,) in mm between pairs of positions; a stencil cut by an edge is shorter."""
    distance = np.linalg.norm(surface.point(first) - surface.point(second), axis=1)
    return np.asarray(np.maximum(distance, 1e-9))
