"""The estimator ``auto`` in a bundle: its tables, its priors and its fitted correction."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.estimation.contact_fit import ContactPrior, MarkerNoise, ShiftNoise
from phytac_decoder.estimation.force_correction import LEGACY_LENGTHS, ForceCorrection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle_check import check_arrays, number, numbers
from phytac_decoder.mechanics.interaction_table import InteractionTable
from phytac_decoder.mechanics.membrane_stretching import BergerWall
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

PREFIX, PAIR, WALL, NOISE, SHEAR = "places.", "pair_", "wall_", "noise_", "shear_"
FRAME, PLACES_MIN = ("point_mm", "along", "around"), 4
SHAPES: dict[str, tuple[int | str, ...]] = {
    **dict.fromkeys(FRAME, ("places", 3)),
    "shift_px": ("places", "orders", "2n"),
    **dict.fromkeys((PAIR + name for name in FRAME), ("pairs", 3)),
    PAIR + "axes_px": ("axes", "2n"),
    PAIR + "triangle": ("triangle", "axes"),
    WALL + "number": ("places",),
    WALL + "slopes": ("places", "powers", "modes"),
    WALL + "most": (1,),
    NOISE + "still_px": ("2n",),
    NOISE + "moved_px": ("2n",),
    **dict.fromkeys((SHEAR + name for name in FRAME), ("sheared", 3)),
    SHEAR + "shift_px": ("sheared", 2, "2n"),
    "weight": ("contacts",),
    "centre": ("contacts", 5),
}
"""Shapes of all arrays for n markers; interactions, walls, the ratio of noise or its
prediction, and the fitted correction (the last two) may be missing."""


def locator_table(locator: ContactLocator) -> dict[str, Any]:
    """Return the part of ``bundle.json``."""
    places, fitted = locator.places, locator.correction
    return {
        "radius_mm": places.radius_mm,
        **({"top_N": places.top_N} if np.isfinite(places.top_N) else {}),
        **({"linear_error": locator.linear_error} if locator.linear_error else {}),
        "footprint_mm": locator.footprint_mm,
        "prior": _plain(locator.prior),
        "noise": _plain(locator.noise, "markers"),
        **({"learnt": _plain(fitted, "centre", "weight")} if fitted else {}),
    }


def _plain(item: Any, *arrays: str) -> dict[str, Any]:
    """Return a dataclass's fields without its ``arrays``, as plain JSON."""
    names = [field.name for field in fields(item) if field.name not in arrays]
    return {name: np.asarray(getattr(item, name)).tolist() for name in names}


def locator_arrays(locator: ContactLocator) -> dict[str, Any]:
    """Return the arrays of ``bundle.safetensors``."""
    arrays = response_arrays(locator.places)
    if locator.noise.markers:
        arrays[NOISE + "still_px"] = locator.noise.markers.still_px
        arrays[NOISE + "moved_px"] = locator.noise.markers.moved_px
    if locator.correction is not None:
        arrays |= {"centre": locator.correction.centre, "weight": locator.correction.weight}
    return {PREFIX + name: value for name, value in arrays.items()}


def response_arrays(places: ResponseTable) -> dict[str, Any]:
    """Return the arrays of a response table, its interactions and its flat walls, by name."""
    arrays = _grid_arrays(places, "", "shift_px")
    if places.shear is not None:
        arrays |= _grid_arrays(places.shear, SHEAR, "shift_px")
    if places.pairs is not None:
        grid = places.pairs.grid
        arrays |= {PAIR + name: getattr(grid, name) for name in FRAME}
        # An interaction is the same both ways.
        arrays[PAIR + "triangle"] = grid.shift_px[np.tril_indices(len(grid.shift_px))]
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

    def grid(prefix: str, shift_px: NDArray[np.float32], **others: Any) -> ResponseTable:
        frame = {name: arrays[prefix + name] for name in FRAME}
        return ResponseTable(**frame, shift_px=shift_px, radius_mm=radius_mm, top_N=top_N, **others)

    pairs, walls = None, None
    # Up to schema 1.9 the interactions were stored by rows, which this version does not use.
    if PAIR + "axes_px" in arrays:
        rows = _both_ways(arrays, len(arrays[PAIR + "point_mm"]))
        pairs = InteractionTable(grid=grid(PAIR, rows), axes_px=arrays[PAIR + "axes_px"])
    if WALL + "slopes" in arrays:
        walls = BergerWall(
            wall=arrays[WALL + "number"],
            slopes=arrays[WALL + "slopes"],
            most=float(arrays[WALL + "most"][0]),
        )
    # Up to schema 1.13 there was no force along the surface.
    shear = grid(SHEAR, arrays[SHEAR + "shift_px"]) if SHEAR + "shift_px" in arrays else None
    return grid("", arrays["shift_px"], pairs=pairs, walls=walls, shear=shear)


def _both_ways(arrays: Mapping[str, Any], places: int) -> NDArray[np.float32]:
    """Return the coordinates (p, p, r) of interactions over pairs of places."""
    triangle = arrays[PAIR + "triangle"]
    out = np.empty((places, places, triangle.shape[1]), dtype=np.float32)
    one, other = np.tril_indices(places)
    out[one, other] = out[other, one] = triangle
    return out


def locator_from(
    table: Mapping[str, Any],
    arrays: Mapping[str, Any],
    *,
    position_mm: FloatArray,
    neighbours: IntArray,
    threshold_N: FloatArray,
    threshold_sd: FloatArray | None = None,
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
    if PAIR + "coordinates" in own:  # Up to schema 1.22 they were stored both ways.
        rows = own.pop(PAIR + "coordinates")
        own[PAIR + "triangle"] = rows[np.tril_indices(len(rows))]
    _rename_old_noise(own, table["noise"])
    _check(own, 2 * len(position_mm), fitted="learnt" in table, folder=folder)
    correction = None
    if "learnt" in table:
        stored = table["learnt"]
        # Up to schema 1.6 all length scales were the same.
        lengths = numbers(stored.get("lengths", LEGACY_LENGTHS), 3, positive=True).tolist()
        correction = ForceCorrection(
            centre=own["centre"],
            weight=own["weight"],
            low_mm=numbers(stored["low_mm"], 3),
            size_mm=number(stored["size_mm"], positive=True),
            force_max_N=number(stored["force_max_N"], positive=True),
            spread=number(stored["spread"], positive=True),
            spread_share=number(stored["spread_share"]),
            lengths=tuple(lengths),
            # Up to schema 1.14 it was not stored, and nothing used it.
            stiffness=number(stored.get("stiffness", 1.0), positive=True),
            # Up to schema 1.18 it was not stored.
            linear=bool(stored.get("linear", False)),
        )
    prior, noise = table["prior"], table["noise"]
    radius_mm = number(table["radius_mm"], positive=True)
    # Up to schema 1.7 there was no largest force.
    top_N = number(table["top_N"], positive=True) if "top_N" in table else np.inf
    return ContactLocator(
        places=response_from_arrays(own, radius_mm, top_N),
        position_mm=position_mm,
        neighbours=neighbours,
        footprint_mm=number(table["footprint_mm"], positive=True),
        threshold_N=threshold_N,
        threshold_sd=threshold_sd,
        prior=ContactPrior(
            place_mm=number(prior["place_mm"], positive=True),
            moments_mm2=tuple(numbers(prior["moments_mm2"], 3).tolist()),
            moments_sd_mm2=tuple(numbers(prior["moments_sd_mm2"], 3, positive=True).tolist()),
            # Up to schema 1.13 any force was as likely.
            force_N=number(prior.get("force_N", ContactPrior.force_N), positive=True),
            # Up to schema 1.13 there was none.
            shear_sd=number(prior.get("shear_sd", ContactPrior.shear_sd), positive=True),
        ),
        noise=ShiftNoise(
            centroid_px=number(noise["centroid_px"], positive=True),
            share=number(noise["share"]),
            switched_px=number(noise["switched_px"]),
            # Up to schema 1.5 all coordinates had the same noise.
            markers=_marker_noise(own),
            fitted=bool(noise.get("fitted", False)),
        ),
        correction=correction,
        # Up to schema 1.17 it was not stored.
        linear_error=number(table.get("linear_error", 0.0)),
    )


def _rename_old_noise(own: dict[str, Any], noise: dict[str, Any]) -> None:
    """Bring noise of schema 1.23 and before, changing both, to the names of now.

    Fitted noise was a ratio to the usual one, and did not grow with the motion.
    """
    for name in ("still_px", "moved_px"):
        if f"noise_predicted_{name}" in own:
            own[NOISE + name] = own.pop(f"noise_predicted_{name}")
    if "noise_ratio" in own:
        own[NOISE + "still_px"] = number(noise["centroid_px"]) * own.pop("noise_ratio")
        own[NOISE + "moved_px"] = np.zeros_like(own[NOISE + "still_px"])
        noise["fitted"] = True


def _marker_noise(own: Mapping[str, Any]) -> MarkerNoise | None:
    if NOISE + "still_px" not in own:
        return None
    still_px, moved_px = (own[NOISE + name] for name in ("still_px", "moved_px"))
    return MarkerNoise(still_px=still_px, moved_px=moved_px)


def _check(own: Mapping[str, Any], columns: int, *, fitted: bool, folder: Path) -> None:
    where = f"{folder}/bundle.safetensors"
    parts = (PAIR, WALL, NOISE, SHEAR)
    absent = [part for part in parts if not any(n.startswith(part) for n in own)]
    absent += () if fitted else ("weight", "centre")
    shapes = {name: shape for name, shape in SHAPES.items() if not name.startswith(tuple(absent))}
    sizes = {"2n": columns}
    kinds = dict.fromkeys(
        ("shift_px", SHEAR + "shift_px", PAIR + "triangle", PAIR + "axes_px", WALL + "slopes"),
        np.float32,
    ) | {WALL + "number": np.int64}
    check_arrays(own, shapes, sizes, where=where, kinds=kinds, prefix=PREFIX)
    if sizes["places"] < PLACES_MIN:
        raise InputError(
            "bundle-array-shape",
            f"{where}: {PREFIX}point_mm has {sizes['places']} places; rebuild the decoder",
        )
    pairs = sizes.get("pairs", 0)
    if sizes.get("triangle", 0) != pairs * (pairs + 1) // 2:
        raise InputError(
            "bundle-array-shape",
            f"{where}: {PREFIX}{PAIR}triangle has {sizes['triangle']} rows, and {pairs} places "
            f"have {pairs * (pairs + 1) // 2} pairs; the arrays are of different builds",
        )
    # Powers of v from 0; all but the first have rows in shift_px.
    if not 1 < sizes.get("powers", 2) <= max(sizes["orders"], 2):
        raise InputError(
            "bundle-array-shape",
            f"{where}: {PREFIX}{WALL}slopes has {sizes['powers']} powers, and the tables have "
            f"{sizes['orders']} orders; the two files are of different builds",
        )
    for name, high in ((WALL + "most", 1.0), (NOISE + "still_px", np.inf)):
        values = np.asarray(own.get(name, 0.5))
        wrong = values[~((values > 0.0) & (values < high))]
        if len(wrong):
            kind = "a number between 0 and 1" if high == 1.0 else "numbers above zero"
            raise InputError(
                "bundle-value-invalid",
                f"{where}: {PREFIX}{name} holds {wrong[0]:g}, expected {kind}; rebuild the decoder",
            )
