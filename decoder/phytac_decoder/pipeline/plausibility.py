"""Results that cannot be: a frame with one of them is not valid, and no force of it is delivered.

A robot that reads only whether a frame is valid, and the number, must be safe. Each check compares
a result with what the sensor can carry, or with another estimate that presumes less.
"""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.io.bundle import Bundle
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class PlausibilitySettings:
    """Limits of results, in standard deviations where they have some."""

    sds: float = 3.0
    """Standard deviations that are allowed on top of a limit, up to the largest force that the
    sensor is designed for: a disturbed picture widens them without end."""
    force_sds: float = 1.0
    """Standard deviations that are allowed on top of the largest force of a contact."""
    force_share: float = 1.5
    """Largest force of a contact, over that which the sensor is designed for."""
    rim_share: float = 0.8
    """Distance of a contact from the nearest tabulated place, over their spacing, from which it is
    beyond a rim; within the surface half a diagonal is 0.71."""
    total_share: float = 0.6
    total_N: float = 3.0
    """Largest difference between the sums of ``auto`` and of the compliance inverse, over the
    larger one, and besides. Linear tables are off by a third at the largest force."""
    chi2_max: float = 25.0
    """Largest reduced χ² where noise was fitted: five standard deviations for the usual marker."""


SETTINGS = PlausibilitySettings()


def implausible(bundle: Bundle, found: ContactDetection, inverse_N: FloatArray) -> list[str]:
    """Return why contacts that ``auto`` found cannot be, one sentence each; empty for none.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    found : ContactDetection
        The contacts.
    inverse_N : (n,) float
        Forces by the compliance inverse.
    """
    locator = bundle.model.locator
    out: list[str] = []
    if locator is None or not found.contacts:
        return out
    force = np.array([contact.force_N for contact in found.contacts])
    sd = np.array([contact.sd_N for contact in found.contacts])
    if not np.isfinite([force, sd]).all():
        return ["forces that are not determined at all"]
    margin = np.minimum(SETTINGS.sds * sd, bundle.force_max_N)
    limit = SETTINGS.force_share * bundle.force_max_N
    if (force - np.minimum(SETTINGS.force_sds * sd, margin) > limit).any():
        out.append(
            f"a contact of {force.max():.0f} N, and the sensor is designed for "
            f"{bundle.force_max_N:g} N"
        )
    points, places = np.stack([one.point_mm for one in found.contacts]), locator.places
    gap = np.linalg.norm(points - places.point_mm[places.nearest(points)], axis=1)
    beyond = gap > SETTINGS.rim_share * places.spacing_mm
    if beyond.any():
        out.append(f"a contact of {force[beyond].max():.1f} N beyond the end of the surface")
    switched = np.array([len(contact.markers) > 0 for contact in found.contacts])
    total, other = float(force[switched].sum()), float(inverse_N.sum())
    allowed = SETTINGS.total_N + SETTINGS.total_share * max(total, other)
    if abs(total - other) > allowed + float(np.hypot.reduce(margin[switched], initial=0.0)):
        out.append(
            f"a sum of {total:.1f} N by the response tables and of {other:.1f} N by the compliance"
        )
    if locator.noise.fitted and found.reduced_chi2 > SETTINGS.chi2_max:
        out.append(
            f"markers are {np.sqrt(found.reduced_chi2):.1f} times their noise from where these "
            "contacts put them"
        )
    return out
