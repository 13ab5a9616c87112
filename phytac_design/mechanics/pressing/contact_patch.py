"""Where and how hard a sensor is pressed, from a user's words."""

from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class ContactPatch:
    """A contact patch.

    Attributes
    ----------
    uv : (2,) float
        Chart position of its centre.
    radius_mm : float
        Radius, 0 for a point force.
    force_N : float
        Force, positive inward.
    """

    uv: FloatArray
    radius_mm: float
    force_N: float


def parse_contact_patch(
    sensor: Sensor, *, force_N: float, at: str = "", radius_mm: float | None = None
) -> ContactPatch:
    """Contact patch from a user's words.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    force_N : float
        Force, > 0.
    at : str
        A marker's number, or a chart position ``u,v``; "" for the marker nearest the middle.
    radius_mm : float, optional
        Radius, >= 0; the design's largest training patch (a fingertip) if left out.

    Raises
    ------
    DesignError
        If a number is out of range or the position is off the surface.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    radius = design.training.patch_radius_max_mm if radius_mm is None else radius_mm
    if not 0.0 < force_N < np.inf:
        raise DesignError(
            "force-not-positive", f"the force must be a positive number of newtons (got {force_N})"
        )
    if not 0.0 <= radius < np.inf:
        raise DesignError(
            "patch-radius-invalid",
            f"the patch radius must be a number of mm, 0 or more (got {radius})",
        )
    size = float(np.sort(np.ptp(surface.bounds_mm(), axis=0))[1])
    if radius > size / 2.0:
        raise DesignError(
            "patch-radius-invalid",
            f"a patch of radius {radius:g} mm does not fit on a sensor {size:.3g} mm wide; give "
            f"at most {size / 2.0:.3g} mm",
        )
    return ContactPatch(
        uv=_position(surface, markers, at.strip()), radius_mm=radius, force_N=force_N
    )


def middle_marker(surface: Surface, markers: Markers) -> int:
    """Marker nearest the middle of the chart."""
    middle = surface.point(surface.domain.mean(axis=1)[None])
    return int(np.argmin(np.linalg.norm(surface.point(markers.uv) - middle, axis=1)))


def _position(surface: Surface, markers: Markers, at: str) -> FloatArray:
    domain = surface.domain
    if not at:
        return np.asarray(markers.uv[middle_marker(surface, markers)])
    try:
        number = [float(word) for word in at.split(",")]
        marker = int(at) if len(number) == 1 else -1
    except ValueError:
        number, marker = [], -1
    if len(number) == 1 and marker == int(number[0]):
        if not 0 <= marker < markers.count:
            raise DesignError(
                "marker-unknown",
                f"there is no marker {marker}: this design has markers 0 to {markers.count - 1}",
            )
        return np.asarray(markers.uv[marker])
    if len(number) != 2 or not np.all(np.isfinite(number)):
        raise DesignError(
            "place-invalid", f"a place is a marker's number or a chart position u,v (got {at!r})"
        )
    for name, value, (low, high), closed in zip(
        "uv", number, domain.tolist(), surface.periodic, strict=True
    ):
        turns = 2.0 * (high - low)
        if closed and not low - turns <= value <= high + turns:
            angle = np.isclose(high - low, 2.0 * np.pi)
            raise DesignError(
                "contact-off-surface",
                f"{name} = {value:g} is more than two turns beyond {low:g} to {high:g}; it is "
                + ("an angle in radians" if angle else "a length around the surface in mm"),
            )
        if not closed and not low <= value <= high:
            raise DesignError(
                "contact-off-surface",
                f"the load is off the surface: {name} = {value:g} is not between {low:g} and "
                f"{high:g}; move it onto the wall",
            )
    return np.array(number)
