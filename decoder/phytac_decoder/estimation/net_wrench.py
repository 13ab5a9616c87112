"""Net force and moment of the forces on a sensor, with their standard deviations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class Wrench:
    """Net force and moment on the sensor, in the sensor's axes.

    Attributes
    ----------
    force_N : (3,) float
        Sum of all forces.
    moment_Nmm : (3,) float
        Sum of their moments, N·mm, about the reference point.
    force_sd_N, moment_sd_Nmm : (3,) float, optional
        Standard deviation of each component.
    """

    force_N: FloatArray
    moment_Nmm: FloatArray
    force_sd_N: FloatArray | None = None
    moment_sd_Nmm: FloatArray | None = None


def wrench_of_forces(force_N: FloatArray, point_mm: FloatArray, about_mm: FloatArray) -> Wrench:
    """Return the net force and moment of forces (k, 3) at points (k, 3).

    Parameters
    ----------
    force_N, point_mm : (k, 3) float
        Forces on the sensor and where they act.
    about_mm : (3,) float
        Point about which moments are taken.
    """
    moment = np.cross(point_mm - about_mm, force_N).sum(axis=0)
    return Wrench(force_N=force_N.sum(axis=0), moment_Nmm=moment)


def wrench_of_contacts(
    contacts: Sequence[LocatedContact],
    normals: FloatArray,
    about_mm: FloatArray,
    *,
    places: ResponseTable | None = None,
    shear_sd: float = 0.0,
) -> Wrench:
    """Return the net force and moment of contacts, each a force at its centre.

    The force of a contact is its normal force, inward, and the force along the surface where that
    is observed. Standard deviations are by linear propagation of those of normal force, centre and
    force along the surface; these, and contacts, count as independent.

    Parameters
    ----------
    contacts : sequence of LocatedContact
        Of one frame.
    normals : (c, 3) float
        Outward unit normals at their centres.
    about_mm : (3,) float
        Point about which moments are taken.
    places : ResponseTable, optional
        Tables of the surface; without them, or where a centre's standard deviation is not finite,
        there are no standard deviations.
    shear_sd : float
        Standard deviation, over the normal force, of each component of a force along the surface
        that is not observed.
    """
    count = len(contacts)
    point = np.array([one.point_mm for one in contacts]).reshape(count, 3)
    normal_N = np.array([one.force_N for one in contacts])[:, None]
    seen = np.array([one.shear_observed for one in contacts], dtype=bool)
    shear = np.array([one.shear_N for one in contacts]).reshape(count, 3)
    force = np.where(seen[:, None], shear, 0.0) - normal_N * normals.reshape(count, 3)
    out = wrench_of_forces(force, point, about_mm)
    sd_N = np.array([one.sd_N for one in contacts])[:, None]
    sd_mm = np.array([one.sd_mm for one in contacts]).reshape(count, 2, 1)
    if places is None or not np.isfinite(sd_mm).all():
        return out
    arm, axes = point - about_mm, places.axes[places.nearest(point)]
    # Errors of the force (c, 6, 3): by the normal force, the centre along and around, and the force
    # along the surface; and those of the moment.
    errors = np.zeros((count, 6, 3))
    errors[:, 0] = -sd_N * normals
    errors[:, 1:3] = -sd_mm * normal_N[:, :, None] * places.normal_slopes(point)
    for k, one in enumerate(contacts):
        if seen[k]:
            size, own = np.linalg.eigh(one.shear_covariance_N2)
            errors[k, 3:] = (own * np.sqrt(np.maximum(size, 0.0))).T
        else:
            errors[k, 3:5] = shear_sd * one.force_N * axes[k]
    turning = np.cross(arm[:, None], errors)
    turning[:, 1:3] += np.cross(sd_mm * axes, force[:, None])
    return replace(
        out,
        force_sd_N=np.sqrt(np.sum(errors**2, axis=(0, 1))),
        moment_sd_Nmm=np.sqrt(np.sum(turning**2, axis=(0, 1))),
    )
