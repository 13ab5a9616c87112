"""How segmentation errs with the place of a marker on the pixels."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from phytac_shapes.arrays import FloatArray

CELL_px = 0.1
"""Places on the pixels this far apart are misjudged independently."""


def pixel_phase_error(place_px: FloatArray, number: int) -> FloatArray:
    """Error (n, 2) of standard deviation 1 that depends on the place (n, 2) px of a marker alone.

    Segmentation takes pixels in and out as a marker moves over them: places ``CELL_px`` apart err
    independently, the same place always errs alike.
    """
    cell = np.floor(np.nan_to_num(place_px) / CELL_px).astype(np.int64).astype(np.uint64)
    marker = np.arange(len(cell), dtype=np.uint64)
    key = np.full(len(cell), number, dtype=np.uint64)
    for part in (marker, cell[:, 0], cell[:, 1]):
        key = _mixed(key ^ part)
    both = np.column_stack([_mixed(key), _mixed(_mixed(key))])
    share = ((both >> np.uint64(11)).astype(np.float64) + 0.5) / 2.0**53
    return np.asarray(ndtri(share), dtype=np.float64)


def _mixed(key: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Next number of splitmix64 (Steele, Lea and Flood 2014)."""
    key = key + np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(key ^ (key >> np.uint64(31)))
