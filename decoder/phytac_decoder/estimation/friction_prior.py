"""Contacts with or without friction: a prior with a spike at no force along the surface.

A contact is fitted with force along the surface unknown, which costs accuracy where there is none.
Beforehand it is as likely that there is none as that there is some. The probability of each after
the frame, and the mean and covariance over both, follow from the fit in closed form (Savage-Dickey
density ratio; Verdinelli, Wasserman 1995).
"""

import numpy as np

from phytac_decoder.estimation.contact_shifts import SHEAR_START
from phytac_shapes.arrays import FloatArray

SHEAR_SPREAD = 3.0
"""Errors of the force along the surface over their standard deviations by the fit, which does not
know the errors of the tables; on virtual prints of cylinder60, so that 90 % intervals hold 90 %."""


def average_over_friction(
    x: FloatArray, covariance: FloatArray, *, shear_sd: float
) -> tuple[FloatArray, FloatArray]:
    """Return unknowns (8,) and covariance (8, 8) of a contact, averaged over both cases.

    Parameters
    ----------
    x, covariance : (8,), (8, 8) float
        Those of the fit, under a normal prior of the force along the surface.
    shear_sd : float
        Standard deviation of that prior.
    """
    ratio, own = x[SHEAR_START:], covariance[SHEAR_START:, SHEAR_START:]
    inverse = np.linalg.inv(own)
    # Density of no force along the surface after the frame, over that before; at most the prior's.
    size = np.minimum(SHEAR_SPREAD**2 * np.sqrt(np.linalg.det(own)), shear_sd**2)
    odds = shear_sd**2 / size * np.exp(-0.5 * float(ratio @ inverse @ ratio) / SHEAR_SPREAD**2)
    square = odds / (1.0 + odds)
    gain = covariance[:, SHEAR_START:] @ inverse
    change = gain @ ratio
    mean = x - square * change
    between = square * (1.0 - square) * np.outer(change, change)
    return mean, covariance - square * gain @ covariance[SHEAR_START:] + between
