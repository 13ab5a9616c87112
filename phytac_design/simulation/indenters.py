"""Contacts as rigs and hands make them: indenters of a shape, with friction."""

from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.indenter import INDENTERS, Indentations
from phytac_design.simulation.contacts import Contacts
from phytac_shapes.arrays import IntArray

__all__ = ["INDENTERS", "Touches", "flat_touches"]


@dataclass(frozen=True, kw_only=True)
class Touches(Contacts, Indentations):
    """Contacts of many samples, with the indenter's shape; arrays run over c contacts."""

    def of(self, sample: int) -> "Touches":
        """Contacts of one sample, as a set of one sample."""
        return self.pick(np.flatnonzero(self.sample == sample), [sample])

    def pick(self, rows: IntArray, samples: "list[int] | IntArray") -> "Touches":
        """Contacts ``rows`` of the given samples, numbered from 0 in that order."""
        number = {int(sample): k for k, sample in enumerate(samples)}
        return Touches(
            sample=np.array([number[int(s)] for s in self.sample[rows]], dtype=np.int64),
            uv=self.uv[rows],
            radius_mm=self.radius_mm[rows],
            force_N=self.force_N[rows],
            samples=len(number),
            indenter=self.indenter[rows],
            length_mm=self.length_mm[rows],
            turn_rad=self.turn_rad[rows],
            friction=self.friction[rows],
        )


def flat_touches(contacts: Contacts) -> Touches:
    """Contacts of even pressure without friction, as ``draw_contacts`` makes them."""
    count = len(contacts.force_N)
    return Touches(
        sample=contacts.sample,
        uv=contacts.uv,
        radius_mm=contacts.radius_mm,
        force_N=contacts.force_N,
        samples=contacts.samples,
        indenter=np.zeros(count, dtype=np.int64),
        length_mm=np.zeros(count),
        turn_rad=np.zeros(count),
        friction=np.zeros((count, 2)),
    )
