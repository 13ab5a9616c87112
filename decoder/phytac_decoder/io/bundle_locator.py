"""The estimator ``auto`` in a bundle: its tables, what it presumes, and what it has learnt."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactPrior, ShiftNoise
from phytac_decoder.estimation.force_correction import LENGTH, ForceCorrection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle_check import above_zero, numbers
from phytac_decoder.mechanics.interaction_table import InteractionTable
from phytac_decoder.mechanics.membrane_stretching import BergerWall
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

PREFIX, PAIR, WALL, RATIO = "places.", "pair_", "wall_", "noise_ratio"
PLACES_MIN = 4
KINDS: dict[str, Any] = {
    "shift_px": np.float32,
    PAIR + "coordinates": np.float32,
    PAIR + "axes_px": np.float32,
    WALL + "slopes": np.float32,
    WALL + "number": np.int64,
}
"""Of numbers in arrays; float64 of all others."""


def locator_table(locator: ContactLocator) -> dict[str, Any]:
    """What stands in ``bundle.json``."""
    prior, noise, learnt = locator.prior, locator.noise, locator.correction
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
    if learnt is not None:
        table["learnt"] = {
            "low_mm": learnt.low_mm.tolist(),
            "size_mm": learnt.size_mm,
            "force_max_N": learnt.force_max_N,
            "spread": learnt.spread,
            "spread_share": learnt.spread_share,
            "lengths": list(learnt.lengths),
        }
    return table


def response_arrays(places: ResponseTable) -> dict[str, Any]:
    """Arrays of tables, and of those of pairs and flat walls if there are any, by name."""
    arrays: dict[str, Any] = _arrays(places, "shift_px")
    if places.pairs is not None:
        own = _arrays(places.pairs.grid, "coordinates") | {"axes_px": places.pairs.axes_px}
        arrays |= {PAIR + name: value for name, value in own.items()}
    if places.walls is not None:
        walls = places.walls
        own = {"number": walls.wall, "slopes": walls.slopes, "most": np.array([walls.most])}
        arrays |= {WALL + name: value for name, value in own.items()}
    return arrays


def _arrays(places: ResponseTable, rows: str) -> dict[str, Any]:
    return {
        "point_mm": places.point_mm,
        "along": places.along,
        "around": places.around,
        rows: places.shift_px,
    }


def response_from_arrays(
    arrays: Mapping[str, Any], radius_mm: float, top_N: float = np.inf
) -> ResponseTable:
    """Tables of :func:`response_arrays` for a disc of a radius and forces up to one."""

    def made(
        prefix: str,
        rows: str,
        pairs: InteractionTable | None = None,
        walls: BergerWall | None = None,
    ) -> ResponseTable:
        return ResponseTable(
            point_mm=arrays[prefix + "point_mm"],
            along=arrays[prefix + "along"],
            around=arrays[prefix + "around"],
            shift_px=arrays[prefix + rows],
            radius_mm=radius_mm,
            top_N=top_N,
            pairs=pairs,
            walls=walls,
        )

    pairs, walls = None, None
    # Up to schema 1.9 tables of pairs were of another kind, by rows.
    if PAIR + "coordinates" in arrays:
        pairs = InteractionTable(grid=made(PAIR, "coordinates"), axes_px=arrays[PAIR + "axes_px"])
    if WALL + "slopes" in arrays:
        walls = BergerWall(
            wall=arrays[WALL + "number"],
            slopes=arrays[WALL + "slopes"],
            most=float(arrays[WALL + "most"][0]),
        )
    return made("", "shift_px", pairs, walls)


def locator_arrays(locator: ContactLocator) -> dict[str, Any]:
    """What stands in ``bundle.safetensors``."""
    places, learnt = locator.places, locator.correction
    arrays = response_arrays(places)
    if locator.noise.ratio is not None:
        arrays[RATIO] = locator.noise.ratio
    if learnt is not None:
        arrays |= {"centre": learnt.centre, "weight": learnt.weight}
    return {PREFIX + name: value for name, value in arrays.items()}


def locator_from(
    table: Mapping[str, Any],
    arrays: Mapping[str, Any],
    *,
    position_mm: FloatArray,
    neighbours: IntArray,
    threshold_N: FloatArray,
    folder: Path,
) -> ContactLocator:
    """Undo both.

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
    if PAIR + "rows" in own:  # of schema 1.9 and before, see response_from_arrays
        own = {name: value for name, value in own.items() if not name.startswith(PAIR)}
    _check(own, 2 * len(position_mm), learnt="learnt" in table, folder=folder)
    correction = None
    if "learnt" in table:
        said = table["learnt"]
        # Up to schema 1.6 there was one for all.
        place, force, signal = said.get("lengths", (LENGTH, LENGTH, LENGTH))
        correction = ForceCorrection(
            centre=own["centre"],
            weight=own["weight"],
            low_mm=numbers(said["low_mm"], 3),
            size_mm=above_zero(said["size_mm"]),
            force_max_N=above_zero(said["force_max_N"]),
            spread=above_zero(said["spread"]),
            spread_share=float(numbers([said["spread_share"]], 1)[0]),
            lengths=(above_zero(place), above_zero(force), above_zero(signal)),
        )
    radius_mm = above_zero(table["radius_mm"])
    prior, noise = table["prior"], table["noise"]
    mean, sd = numbers(prior["moments_mm2"], 3), numbers(prior["moments_sd_mm2"], 3)
    return ContactLocator(
        # Up to schema 1.7 there was none.
        places=response_from_arrays(
            own, radius_mm, above_zero(table["top_N"]) if "top_N" in table else np.inf
        ),
        position_mm=position_mm,
        neighbours=neighbours,
        footprint_mm=above_zero(table["footprint_mm"]),
        threshold_N=threshold_N,
        prior=ContactPrior(
            place_mm=above_zero(prior["place_mm"]),
            moments_mm2=(float(mean[0]), float(mean[1]), float(mean[2])),
            moments_sd_mm2=(above_zero(sd[0]), above_zero(sd[1]), above_zero(sd[2])),
        ),
        noise=ShiftNoise(
            centroid_px=above_zero(noise["centroid_px"]),
            share=float(numbers([noise["share"]], 1)[0]),
            switched_px=float(numbers([noise["switched_px"]], 1)[0]),
            # Up to schema 1.5 there was none.
            ratio=own.get(RATIO),
        ),
        correction=correction,
    )


def _check(own: Mapping[str, Any], columns: int, *, learnt: bool, folder: Path) -> None:
    where = f"{folder}/bundle.safetensors"
    for name in _wanted(own, learnt=learnt):
        if name not in own:
            raise InputError(f"{where} lacks '{PREFIX}{name}'; rebuild the decoder")
    for name, shape in _expected(own, columns, learnt=learnt).items():
        value, kind = own[name], KINDS.get(name, np.float64)
        if value.shape != shape or value.dtype != kind:
            raise InputError(
                f"{where}: {PREFIX}{name} is {value.dtype} {value.shape}, expected "
                f"{np.dtype(kind)} {shape}; the two files are of different builds"
            )
        if not np.isfinite(value).all():
            raise InputError(f"{where}: {PREFIX}{name} holds numbers that are not finite")
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


def _some(own: Mapping[str, Any], prefix: str) -> bool:
    """Whether there are tables of pairs or walls, or parts of them."""
    return any(name.startswith(prefix) for name in own)


def _wanted(own: Mapping[str, Any], *, learnt: bool) -> list[str]:
    """Names of all arrays that must be there."""
    wanted = ["point_mm", "along", "around", "shift_px", *(["centre", "weight"] if learnt else [])]
    if _some(own, PAIR):
        wanted += [
            PAIR + name for name in ("point_mm", "along", "around", "coordinates", "axes_px")
        ]
    if _some(own, WALL):
        wanted += [WALL + name for name in ("number", "slopes", "most")]
    return wanted


def _expected(own: Mapping[str, Any], columns: int, *, learnt: bool) -> dict[str, tuple[int, ...]]:
    """Shapes of all arrays, by name."""
    count = len(own["point_mm"])
    orders = own["shift_px"].shape[1] if own["shift_px"].ndim == 3 else 0
    shapes = dict.fromkeys(("point_mm", "along", "around"), (count, 3))
    expected: dict[str, tuple[int, ...]] = shapes | {"shift_px": (count, max(orders, 1), columns)}
    if _some(own, PAIR):
        pairs = len(own[PAIR + "point_mm"])
        expected |= dict.fromkeys((PAIR + n for n in ("point_mm", "along", "around")), (pairs, 3))
        axes = own[PAIR + "axes_px"].shape[0] if own[PAIR + "axes_px"].ndim else 0
        expected |= {PAIR + "coordinates": (pairs, pairs, axes), PAIR + "axes_px": (axes, columns)}
    if _some(own, WALL):
        slopes = own[WALL + "slopes"]
        # Powers of v from 0, of which the first stands for rows of the force's.
        powers, modes = slopes.shape[1:] if slopes.ndim == 3 else (0, 1)
        powers = powers if 1 < powers <= orders else 2
        expected |= {WALL + "number": (count,), WALL + "slopes": (count, powers, modes)}
        expected[WALL + "most"] = (1,)
    if RATIO in own:
        expected[RATIO] = (columns,)
    if learnt:
        expected |= {"weight": (len(own["weight"]),), "centre": (len(own["weight"]), 5)}
    return expected
