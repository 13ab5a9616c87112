"""The standard contacts of a design, on which the force error of settings is measured."""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.arc import by_area
from phytac_design.simulation.contacts import Contacts
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

EVEN_STEPS = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""Steps of an even additive sequence in three dimensions: powers of 1/p, p⁴ = p + 1."""


@dataclass(frozen=True, kw_only=True)
class StandardContacts:
    """Contacts (c,), one at a time, of the design's mean patch radius.

    Attributes
    ----------
    uv : (c, 2) float
        Places.
    force_N : (c,) float
        Forces, from a fifth of the design's largest to all of it.
    radius_mm : float
        Of every patch.
    """

    uv: FloatArray
    force_N: FloatArray
    radius_mm: float

    @property
    def touches(self) -> Contacts:
        """The same as touches, each a sample of its own."""
        count = len(self.uv)
        return Contacts.flat(
            sample=np.arange(count),
            uv=self.uv,
            radius_mm=np.full(count, self.radius_mm),
            force_N=self.force_N,
            samples=count,
        )


def standard_contacts(design: Design, surface: Surface, count: int = 16) -> StandardContacts:
    """Return contacts spread evenly over area and force, away from the rims.

    The places are at least a patch diameter away from every open edge, where place and force are
    nearly degenerate. The same design always has the same contacts.

    Raises
    ------
    DesignError
        If no place is that far from the rims.
    """
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    # Forty candidates for each contact: those near a rim are skipped.
    numbers = (0.5 + np.arange(1, 40 * count + 1)[:, None] * EVEN_STEPS) % 1.0
    uv = by_area(surface, numbers[:, :2])
    away = np.full(len(uv), np.inf)
    for edge in rim_points(surface):
        gap = np.linalg.norm(surface.point(uv)[:, None] - edge[None], axis=2)
        away = np.minimum(away, gap.min(axis=1))
    kept = np.flatnonzero(away >= 2.0 * radius)[:count]
    if len(kept) == 0:
        raise DesignError(
            "standard-contacts-no-room",
            f"no place on this sensor is {2.0 * radius:g} mm from its rims, so it has no standard "
            "contacts to measure a force error on; lower training.patch_radius_max_mm or make the "
            "sensor larger",
        )
    low = max(training.force_min_N, 0.2 * training.force_max_N)
    force = low + (training.force_max_N - low) * numbers[: len(kept), 2]
    return StandardContacts(uv=uv[kept], force_N=force, radius_mm=radius)


def rim_points(surface: Surface, count: int = 129) -> list[FloatArray]:
    """Points (count, 3) along each open edge of the outer face, mm."""
    edges = []
    for axis, end in surface.edges():
        uv = np.empty((count, 2))
        uv[:, axis] = surface.domain[axis, end]
        low, high = surface.domain[1 - axis]
        uv[:, 1 - axis] = np.linspace(low, high, count)
        edges.append(surface.point(uv))
    return edges
