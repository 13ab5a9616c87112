"""What the estimator ``auto`` tells of a frame: its contacts."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactFit
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class LocatedContact:
    """One contact.

    Attributes
    ----------
    markers : (m,) int
        Key nodes of interest that it tripped, and switches that cannot be read which it must have;
        none for one found by motion alone that reaches no switch's threshold.
    share : (m,) float
        Share of the force that each of them carries.
    force_N, sd_N : float
        Normal force, and its standard deviation.
    raw_N, raw_sd_N : float
        The same before what was learnt from the sensor's own data, or is presumed of prints.
    point_mm : (3,) float
        Centre, on the tangent plane of the outer face.
    radius_mm : float
        Of the even disc with the same second moment.
    sd_mm : (2,) float
        Standard deviations of the centre, along and around.
    moments_mm2 : (3,) float
        Second moments xx, xy, yy less those of the tables' disc.
    signal_px : float
        Shift of all markers together, px per newton.
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


@dataclass(frozen=True, kw_only=True)
class FitState:
    """How the fit of a frame stands.

    Attributes
    ----------
    fit : Fit
        With contacts that are suspected.
    misfit : float
        That of the last frame whose contacts were looked for anew.
    age : int
        Frames since that one.
    """

    fit: ContactFit
    misfit: float
    age: int = 0


@dataclass(frozen=True, kw_only=True)
class ContactDetection:
    """What one frame tells.

    Attributes
    ----------
    contacts : list of Located
        Those with switches first.
    misfit : float
        Weighted sum of squares of what is left, per number: 1 where noise is as expected.
    shift_px : (2n,) float
        What the contacts explain, and those that are suspected.
    stand : Stand, optional
        To go on from in the next frame.
    """

    contacts: list[LocatedContact]
    misfit: float
    shift_px: FloatArray
    stand: FitState | None = None

    def receptor_forces_N(self, count: int) -> FloatArray:
        """Force (n,) N on each marker: contacts' forces shared among their switches."""
        out = np.zeros(count)
        for contact in self.contacts:
            out[contact.markers] += contact.force_N * contact.share
        return out
