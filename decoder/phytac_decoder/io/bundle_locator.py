"""The estimator ``auto`` in a bundle: its tables, its priors and its fitted correction."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactPrior, ShiftNoise
from phytac_decoder.estimation.force_correction import LEGACY_LENGTHS, ForceCorrection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle_check import (
    Shapes,
    above_zero,
    check_arrays,
    numbers,
    positive_numbers,
)
from phytac_decoder.mechanics.interaction_table import InteractionTable
from phytac_decoder.mechanics.membrane_stretching import BergerWall
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

PREFIX, PAIR, WALL, RATIO = "places.", "pair_", "wall_", "noise_ratio"
FRAME = ("point_mm", "along", "around")
PLACES_MIN = 4
KINDS: dict[str, Any] = {
    "shift_px": np.float32,
    PAIR + "coordinates": np.float32,
    PAIR + "axes_px": np.float32,
    WALL + "slopes": np.float32,
    WALL + "number": np.int64,
}
"""Types of arrays that are not float64."""


def locator_table(locator: ContactLocator) -> dict[str, Any]:
    """Return the part of ``bundle.json``."""
    prior, noise, fitted = locator.prior, locator.noise, locator.correction
    table: dict[str, Any] = {
        "radius_mm": locator.places.radius_mm,
        **({"top_N": locator.places.top_N} if np.isfinite(locator.places.top_N) else {}),
        "footprint_mm": locator.footprint_mm,
        "prior": {
            "place_mm": prior.place_mm,
            "moments_mm2": list(prior.moments_mm2),
            "moments_sd_mm2": list(prior.moments_sd_mm2),
        },
        "noise": {
            "centroid_px": noise.centroid_px,
            "share": noise.share,
            "switched_px": noise.switched_px,
        },
    }
    if fitted is not None:
        table["learnt"] = {
            "low_mm": fitted.low_mm.tolist(),
            "size_mm": fitted.size_mm,
            "force_max_N": fitted.force_max_N,
            "spread": fitted.spread,
            "spread_share": fitted.spread_share,
            "lengths": list(fitted.lengths),
        }
    return table


def locator_arrays(locator: ContactLocator) -> dict[str, Any]:
    """Return the arrays of ``bundle.safetensors``."""
    arrays = response_arrays(locator.places)
    if locator.noise.ratio is not None:
        arrays[RATIO] = locator.noise.ratio
    if locator.correction is not None:
        arrays |= {"centre": locator.correction.centre, "weight": locator.correction.weight}
    return {PREFIX + name: value for name, value in arrays.items()}


def response_arrays(places: ResponseTable) -> dict[str, Any]:
    """Return the arrays of a response table, its interactions and its flat walls, by name."""
    arrays = _grid_arrays(places, "", "shift_px")
    if places.pairs is not None:
        arrays |= _grid_arrays(places.pairs.grid, PAIR, "coordinates")
        arrays[PAIR + "axes_px"] = places.pairs.axes_px
    if places.walls is not None:
        walls = places.walls
        arrays |= {
            WALL + "number": walls.wall,
            WALL + "slopes": walls.slopes,
            WALL + "most": np.array([walls.most]),
        }
    return arrays


def _grid_arrays(places: ResponseTable, prefix: str, rows: str) -> dict[str, Any]:
    return {prefix + name: getattr(places, name) for name in FRAME} | {
        prefix + rows: places.shift_px
    }


def response_from_arrays(
    arrays: Mapping[str, Any], radius_mm: float, top_N: float = np.inf
) -> ResponseTable:
    """Return the table of :func:`response_arrays`.

    Parameters
    ----------
    radius_mm : float
        Radius of the tabulated disc.
    top_N : float
        Largest tabulated force.
    """

    def grid(prefix: str, rows: str, **others: Any) -> ResponseTable:
        frame = {name: arrays[prefix + name] for name in FRAME}
        shift_px = arrays[prefix + rows]
        return ResponseTable(**frame, shift_px=shift_px, radius_mm=radius_mm, top_N=top_N, **others)

    pairs, walls = None, None
    # Up to schema 1.9 the interactions were stored by rows, which this version does not use.
    if PAIR + "coordinates" in arrays:
        pairs = InteractionTable(grid=grid(PAIR, "coordinates"), axes_px=arrays[PAIR + "axes_px"])
    if WALL + "slopes" in arrays:
        walls = BergerWall(
            wall=arrays[WALL + "number"],
            slopes=arrays[WALL + "slopes"],
            most=float(arrays[WALL + "most"][0]),
        )
    return grid("", "shift_px", pairs=pairs, walls=walls)


def locator_from(
    table: Mapping[str, Any],
    arrays: Mapping[str, Any],
    *,
    position_mm: FloatArray,
    neighbours: IntArray,
    threshold_N: FloatArray,
    folder: Path,
) -> ContactLocator:
    """Return the locator of :func:`locator_table` and :func:`locator_arrays`.

    Raises
    ------
    InputError
        If an array is missing, of another shape or type, or not finite.
    KeyError, TypeError, ValueError
        If the table is not one of :func:`locator_table`.
    """
    own = {
        name.removeprefix(PREFIX): value
        for name, value in arrays.items()
        if name.startswith(PREFIX)
    }
    if PAIR + "rows" in own:  # schema 1.9 and before, see response_from_arrays
        own = {name: value for name, value in own.items() if not name.startswith(PAIR)}
    _check(own, 2 * len(position_mm), fitted="learnt" in table, folder=folder)
    correction = None
    if "learnt" in table:
        stored = table["learnt"]
        # Up to schema 1.6 all length scales were the same.
        lengths = positive_numbers(stored.get("lengths", LEGACY_LENGTHS), 3).tolist()
        correction = ForceCorrection(
            centre=own["centre"],
            weight=own["weight"],
            low_mm=numbers(stored["low_mm"], 3),
            size_mm=above_zero(stored["size_mm"]),
            force_max_N=above_zero(stored["force_max_N"]),
            spread=above_zero(stored["spread"]),
            spread_share=float(numbers([stored["spread_share"]], 1)[0]),
            lengths=tuple(lengths),
        )
    prior, noise = table["prior"], table["noise"]
    # Up to schema 1.7 there was no largest force.
    top_N = above_zero(table["top_N"]) if "top_N" in table else np.inf
    return ContactLocator(
        places=response_from_arrays(own, above_zero(table["radius_mm"]), top_N),
        position_mm=position_mm,
        neighbours=neighbours,
        footprint_mm=above_zero(table["footprint_mm"]),
        threshold_N=threshold_N,
        prior=ContactPrior(
            place_mm=above_zero(prior["place_mm"]),
            moments_mm2=tuple(numbers(prior["moments_mm2"], 3).tolist()),
            moments_sd_mm2=tuple(positive_numbers(prior["moments_sd_mm2"], 3).tolist()),
        ),
        noise=ShiftNoise(
            centroid_px=above_zero(noise["centroid_px"]),
            share=float(numbers([noise["share"]], 1)[0]),
            switched_px=float(numbers([noise["switched_px"]], 1)[0]),
            # Up to schema 1.5 all coordinates had the same noise.
            ratio=own.get(RATIO),
        ),
        correction=correction,
    )


def _check(own: Mapping[str, Any], columns: int, *, fitted: bool, folder: Path) -> None:
    where = f"{folder}/bundle.safetensors"
    shapes = _expected_shapes(own, columns, fitted=fitted)
    check_arrays(own, shapes, where=where, kinds=KINDS, prefix=PREFIX)
    count = len(own["point_mm"])
    if count < PLACES_MIN:
        raise InputError(f"{where}: {PREFIX}point_mm has {count} places; rebuild the decoder")
    if WALL + "most" in own and not 0.0 < float(own[WALL + "most"][0]) < 1.0:
        raise InputError(
            f"{where}: {PREFIX}{WALL}most holds {own[WALL + 'most'][0]:g}, expected a number "
            "between 0 and 1; rebuild the decoder"
        )
    if RATIO in own and not (own[RATIO] > 0.0).all():
        raise InputError(
            f"{where}: {PREFIX}{RATIO} holds {own[RATIO].min():g}, expected numbers above zero; "
            "rebuild the decoder"
        )


def _expected_shapes(own: Mapping[str, Any], columns: int, *, fitted: bool) -> Shapes:
    """Return shapes by name; a size that only the file knows is taken from the array itself."""

    def size(name: str, axis: int, rank: int) -> int:
        """Return the size of an array's axis; 0 if it is missing or of another rank."""
        array = own.get(name)
        return 0 if array is None or array.ndim != rank else int(array.shape[axis])

    count, orders = size("point_mm", 0, 2), size("shift_px", 1, 3)
    shapes: Shapes = dict.fromkeys(FRAME, (count, 3))
    shapes["shift_px"] = (count, max(orders, 1), columns)
    if any(name.startswith(PAIR) for name in own):
        pairs, axes = size(PAIR + "point_mm", 0, 2), size(PAIR + "axes_px", 0, 2)
        shapes |= dict.fromkeys((PAIR + name for name in FRAME), (pairs, 3))
        shapes |= {PAIR + "axes_px": (axes, columns), PAIR + "coordinates": (pairs, pairs, axes)}
    if any(name.startswith(WALL) for name in own):
        # Powers of v from 0; all but the first have rows in shift_px.
        powers, modes = size(WALL + "slopes", 1, 3), size(WALL + "slopes", 2, 3)
        powers = powers if 1 < powers <= orders else 2
        shapes |= {WALL + "number": (count,), WALL + "slopes": (count, powers, modes)}
        shapes[WALL + "most"] = (1,)
    if RATIO in own:
        shapes[RATIO] = (columns,)
    if fitted:
        contacts = size("weight", 0, 1)
        shapes |= {"weight": (contacts,), "centre": (contacts, 5)}
    return shapes
