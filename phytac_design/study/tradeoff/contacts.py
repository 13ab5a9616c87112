"""The standard contacts of a design: what the force error of a setting is measured on."""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.indenters import Touches, flat_touches
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

COUNT = 16
"""Contacts of the standard set."""
LEAST_SHARE = 0.2
"""The least force of the set over the design's greatest (5 N of 25 N)."""
TRIED = 40
"""Places looked at for each that is wanted; those beside a rim are passed over."""
GRID = 129
"""Points along each side of the chart that areas and rims are sampled at."""
STEPS = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""Powers of the inverse of the root of x⁴ = x + 1: the evenest additive sequence in 3 numbers."""


@dataclass(frozen=True, kw_only=True)
class StandardContacts:
    """Contacts (c,), one at a time, of the design's mean patch radius.

    Attributes
    ----------
    uv : (c, 2) float
        Places.
    force_N : (c,) float
        Forces, from a fifth of the design's greatest to all of it.
    radius_mm : float
        Of every patch.
    """

    uv: FloatArray
    force_N: FloatArray
    radius_mm: float

    @property
    def touches(self) -> Touches:
        """The same as touches, each a sample of its own."""
        count = len(self.uv)
        return flat_touches(
            Contacts(
                sample=np.arange(count),
                uv=self.uv,
                radius_mm=np.full(count, self.radius_mm),
                force_N=self.force_N,
                samples=count,
            )
        )


def standard_contacts(design: Design, surface: Surface, count: int = COUNT) -> StandardContacts:
    """Return places spread evenly over the area and away from the rims, forces spread evenly.

    The places stand at least one patch radius (its far side, that is) off every open edge, where
    place and force are nearly degenerate. The same design always has the same contacts.

    Raises
    ------
    DesignError
        If no place is that far from the rims.
    """
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    numbers = (0.5 + np.arange(1, count * TRIED + 1)[:, None] * STEPS) % 1.0
    uv = even_places(surface, numbers[:, :2])
    rim = rim_points(surface)
    off = np.full(len(uv), np.inf)
    for part in np.array_split(rim, max(len(rim) // 256, 1)):
        gap = np.linalg.norm(surface.point(uv)[:, None] - part[None], axis=2)
        off = np.minimum(off, gap.min(axis=1, initial=np.inf))
    kept = np.flatnonzero(off >= 2.0 * radius)[:count]
    if len(kept) == 0:
        raise DesignError(
            f"no place on this sensor is {2.0 * radius:g} mm from its rims, so it has no standard "
            "contacts to measure a force error on; lower training.patch_radius_max_mm or make the "
            "sensor larger"
        )
    least = max(training.force_min_N, LEAST_SHARE * training.force_max_N)
    force = least + (training.force_max_N - least) * numbers[: len(kept), 2]
    return StandardContacts(uv=uv[kept], force_N=force, radius_mm=radius)


def even_places(surface: Surface, unit: FloatArray) -> FloatArray:
    """Chart positions (n, 2) of points (n, 2) of the unit square, even over the outer area."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, GRID), np.linspace(v0, v1, GRID)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    area = np.sqrt(np.maximum(np.linalg.det(surface.metric(grid)), 0.0)).reshape(GRID, GRID)
    rows = area.mean(axis=1)
    cumulated = np.append(0.0, np.cumsum((rows[1:] + rows[:-1]) / 2.0))
    at_u = np.interp(unit[:, 0], cumulated / cumulated[-1], u)
    at_v = np.empty(len(unit))
    for k, place in enumerate(at_u):
        own = area[int(np.clip(np.searchsorted(u, place), 0, GRID - 1))]
        along = np.append(0.0, np.cumsum((own[1:] + own[:-1]) / 2.0))
        share = along / along[-1] if along[-1] > 0.0 else np.linspace(0.0, 1.0, GRID)
        at_v[k] = np.interp(unit[k, 1], share, v)
    return np.column_stack([at_u, at_v])


def rim_points(surface: Surface) -> FloatArray:
    """Points (r, 3) along all open edges of the outer face, mm."""
    parts = [np.zeros((0, 3))]
    for axis, end in surface.edges():
        uv = np.empty((GRID, 2))
        uv[:, axis] = surface.domain[axis, end]
        low, high = surface.domain[1 - axis]
        uv[:, 1 - axis] = np.linspace(low, high, GRID)
        parts.append(surface.point(uv))
    return np.concatenate(parts)
