"""The visibility error of presses: how wrong a build is about the room that markers keep.

The worst of all markers together would not do: a few presses where it is tightest find it, and
say nothing of the markers that none of them comes near.
"""

from collections.abc import Sequence

import numpy as np

from phytac_design.engine.stage import Context
from phytac_design.optics.loaded_visibility import UnderLoad
from phytac_shapes.arrays import FloatArray


def room_of(
    fraction: FloatArray, gaps_px: Sequence[FloatArray], rest_px: Sequence[FloatArray]
) -> FloatArray:
    """Room (n,) that each marker keeps: 1 is undisturbed, 0 hidden or fused.

    The least of its visible fraction and of its gaps over those at rest.

    Parameters
    ----------
    fraction : (n,) float
        Visible fraction under load.
    gaps_px, rest_px : each (n,) float
        Gaps to markers of its own colour and of others, under load and at rest. One that is
        infinite (no such marker) or nothing at rest tells nothing.
    """
    room = np.array(fraction, dtype=np.float64)
    for gap, rest in zip(gaps_px, rest_px, strict=True):
        known = np.isfinite(rest) & (rest > 0.0)
        room = np.minimum(room, np.divide(gap, rest, out=np.ones_like(room), where=known))
    return room


def room_between(loaded: UnderLoad, rest: UnderLoad) -> FloatArray:
    """Room (n,) of each marker over all presses of one look, with another look without any."""
    return room_of(
        loaded.least_fraction,
        (loaded.least_gap_same_px, loaded.least_gap_other_px),
        (rest.least_gap_same_px, rest.least_gap_other_px),
    )


def room_left(context: Context) -> FloatArray:
    """Room that markers keep over all presses of the stage ``underload``.

    Where one sector stands for all, only its markers were pressed: then the least of each row,
    (rows,); otherwise of each marker, (n,).
    """
    rest, loaded = context.arrays("views"), context.arrays("underload")
    room = room_of(
        loaded["least_fraction"],
        (loaded["least_gap_same_px"], loaded["least_gap_other_px"]),
        (rest["gap_same_colour_px"], rest["gap_other_colour_px"]),
    )
    if not context.facts("underload")["sector_only"]:
        return room
    _, row = np.unique(context.markers.row, return_inverse=True)
    least = np.full(int(row.max()) + 1, np.inf)
    np.minimum.at(least, row, room)
    return least


def visibility_error(room: Sequence[float], finest: Sequence[float]) -> float:
    """Greatest difference of the room that any marker (or row) keeps."""
    return float(np.abs(np.subtract(room, finest)).max(initial=0.0))
