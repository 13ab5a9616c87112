"""Areas that two discs share, and discs that a straight edge cuts off."""

import numpy as np

from phytac_shapes.arrays import FloatArray


def disc_overlap_share(
    distance: FloatArray, r_contact: FloatArray | float, r_foot: FloatArray | float
) -> FloatArray:
    """Share of a contact disc's area that lies inside a footprint disc, 0 … 1.

    The lens of two circles in closed form (derived here: two circular segments). Arguments
    broadcast; all in mm, radii > 0.
    """
    d, a, b = np.broadcast_arrays(distance, r_contact, r_foot)
    d = np.maximum(np.asarray(d, dtype=np.float64), 1e-300)
    # Cosines clipped at ±1 make the formula hold for discs apart and discs inside each other.
    half_a = np.arccos(np.clip((d * d + a * a - b * b) / (2.0 * d * a), -1.0, 1.0))
    half_b = np.arccos(np.clip((d * d + b * b - a * a) / (2.0 * d * b), -1.0, 1.0))
    lens = a * a * segment(half_a) + b * b * segment(half_b)
    return np.asarray(np.clip(lens / (np.pi * a * a), 0.0, 1.0))


def cut_disc_centroid(gap: FloatArray, radius: FloatArray | float) -> FloatArray:
    """Distance from a straight edge of the centroid of the part of a disc on its own side.

    Parameters
    ----------
    gap : (...) float
        Distance of the disc's centre from the edge, >= 0; broadcast with ``radius``, > 0, mm.
    """
    d, a = np.broadcast_arrays(np.asarray(gap, dtype=np.float64), radius)
    half = np.arccos(np.minimum(d / a, 1.0))
    return np.asarray(d + 2.0 / 3.0 * a * np.sin(half) ** 3 / (np.pi - segment(half)))


def segment(half: FloatArray) -> FloatArray:
    """Area of a unit circle's segment with half-angle ``half``; exact for small angles too."""
    return np.asarray(half - np.sin(half) * np.cos(half))
