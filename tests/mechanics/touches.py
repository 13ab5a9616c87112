"""Contacts of one kind, made from few numbers."""

import numpy as np

from phytac_design.simulation.contacts import Contacts
from phytac_shapes.arrays import FloatArray


def make_touches(
    uv: FloatArray,
    kind: int,
    *,
    radius_mm: FloatArray | float,
    length_mm: FloatArray | float = 0.0,
    turn_rad: FloatArray | float = 0.0,
    friction: FloatArray | tuple[float, float] = (0.0, 0.0),
) -> Contacts:
    """One sample of touches at ``uv`` (c, 2), each of 1 N."""
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    count = len(uv)

    def each(value: FloatArray | float) -> FloatArray:
        return np.broadcast_to(np.asarray(value, dtype=np.float64), count).copy()

    return Contacts(
        sample=np.zeros(count, dtype=np.int64),
        uv=uv,
        radius_mm=each(radius_mm),
        force_N=np.ones(count),
        samples=1,
        indenter=np.full(count, kind, dtype=np.int64),
        length_mm=each(length_mm),
        turn_rad=each(turn_rad),
        friction=np.broadcast_to(np.asarray(friction, dtype=np.float64), (count, 2)).copy(),
    )
