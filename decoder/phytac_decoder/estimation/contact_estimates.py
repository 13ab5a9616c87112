"""Results of the estimator ``auto`` for one frame."""

from dataclasses import dataclass, field

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactFit
from phytac_shapes.arrays import FloatArray, IntArray

SHEAR_SHARE_MAX = 0.5
"""Largest :attr:`LocatedContact.shear_share` of a force along the surface that is reported."""


@dataclass(frozen=True, kw_only=True)
class LocatedContact:
    """One contact.

    Attributes
    ----------
    markers : (m,) int
        Switches that it turned on, and unreadable switches that it must have turned on; none for
        a contact that was found by motion alone and reaches no switch's threshold.
    share : (m,) float
        Share of the force that each of them carries.
    force_N, sd_N : float
        Normal force, and its standard deviation.
    raw_N, raw_sd_N : float
        The same before the correction, or before the spread of prints is added.
    point_mm : (3,) float
        Centre, on the tangent plane of the outer face.
    radius_mm : float
        Radius of the uniform disc with the same second moment.
    sd_mm : (2,) float
        Standard deviations of the centre, along and around.
    moments_mm2 : (3,) float
        Second moments xx, xy, yy less those of the tables' disc.
    signal_px : float
        Shift of all markers together, px per newton.
    shear_N : (3,) float
        Force along the surface on the sensor, in the sensor's axes.
    shear_covariance_N2 : (3, 3) float
        Its covariance.
    shear_share : float
        Standard deviation of that force in its best known direction over what it was before the
        frame: near 0 the markers determine it, from 1 on they say nothing about it.
    """

    markers: IntArray
    share: FloatArray
    force_N: float
    sd_N: float
    raw_N: float
    raw_sd_N: float
    point_mm: FloatArray
    radius_mm: float
    sd_mm: FloatArray
    moments_mm2: FloatArray
    signal_px: float
    shear_N: FloatArray = field(default_factory=lambda: np.zeros(3))
    shear_covariance_N2: FloatArray = field(default_factory=lambda: np.diag(np.full(3, np.inf)))
    shear_share: float = 1.0

    @property
    def shear_sd_N(self) -> FloatArray:
        """Standard deviation (3,) of each component of the force along the surface."""
        return np.sqrt(np.maximum(self.shear_covariance_N2.diagonal(), 0.0))

    @property
    def shear_observed(self) -> bool:
        """Whether the markers say more about the force along the surface than the prior does."""
        return self.shear_share <= SHEAR_SHARE_MAX


@dataclass(frozen=True, kw_only=True)
class FitState:
    """The fit of a frame, from which the next frame starts.

    Attributes
    ----------
    fit : ContactFit
        Fit, with tentative contacts.
    reduced_chi2 : float
        That of the last frame whose contacts were searched for.
    noise_scale : float
        Noise of that frame over the usual one.
    age : int
        Frames since that one.
    """

    fit: ContactFit
    reduced_chi2: float
    noise_scale: float = 1.0
    age: int = 0


@dataclass(frozen=True, kw_only=True)
class ContactDetection:
    """Contacts of one frame.

    Attributes
    ----------
    contacts : list of LocatedContact
        Those with switches first.
    reduced_chi2 : float
        Weighted sum of squared residuals per degree of freedom: 1 where noise is as expected.
    noise_scale : float
        Noise of this frame over the usual one, where that is predicted; the other figures are by
        this noise.
    hidden_N : float
        Force of a contact that is not reported and may be there: on unreadable switches, where the
        markers do not show it clearly enough, or anywhere if no switch is on; 0 if there is none.
    shift_px : (2n,) float
        Predicted shifts: of all contacts, tentative ones included, and by motion of the cameras.
    motion, motion_sd : (q,) float
        Motion of the cameras since the rest frame and its standard deviations, see
        :class:`phytac_decoder.camera.camera_motion.CameraMotion`; empty if it is not estimated.
    state : FitState, optional
        Warm start of the next frame.
    """

    contacts: list[LocatedContact]
    reduced_chi2: float
    shift_px: FloatArray
    motion: FloatArray = field(default_factory=lambda: np.zeros(0))
    motion_sd: FloatArray = field(default_factory=lambda: np.zeros(0))
    state: FitState | None = None
    noise_scale: float = 1.0
    hidden_N: float = 0.0

    @property
    def chi2_of_usual(self) -> float:
        """Reduced χ² by the usual noise in place of this frame's."""
        return self.reduced_chi2 * self.noise_scale**2

    def receptor_forces_N(self, count: int) -> FloatArray:
        """Return the force (n,) N on each marker: contacts' forces shared among their switches."""
        out = np.zeros(count)
        for contact in self.contacts:
            out[contact.markers] += contact.force_N * contact.share
        return out
