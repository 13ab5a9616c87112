"""Checks of a bundle's arrays and numbers before anything is made of them."""

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import parameter_count
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError

ARRAYS: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "colour": ("colour", ("n",)),
    "position_mm": ("position_mm", ("n", 3)),
    "head_mm": ("head_mm", ("n", 3)),
    "rest_px": ("rest_px", ("n", 2)),
    "tip_bias_px": ("tip_bias_px", ("n", 2)),
    "tip_on_px": ("tips.on_px", ("n", 2)),
    "tip_red_rest_px": ("tips.red_rest_px", ("n",)),
    "tip_red_on_px": ("tips.red_on_px", ("n",)),
    "read_by": ("read_by", ("n",)),
    "threshold_N": ("threshold_N", ("n",)),
    "shift_to_mm": ("model.shift_to_mm", ("n", 2)),
    "stiffness": ("model.stiffness", ("n", "n")),
    "compliance_px": ("model.compliance_px", ("2n", "n")),
    "height_z_mm": ("model.height_z_mm", ("n",)),
    "neighbours": ("model.neighbours", ("n", 8)),
}
"""Attribute of a bundle and shape of each array, for n markers."""
SHOWN: dict[str, tuple[int | str, ...]] = {
    "shown_rest_px": (2, "n", 2),
    "shown_tip_on_px": (2, "n", 2),
    "shown_tip_red_rest_px": (2, "n"),
    "shown_tip_red_on_px": (2, "n"),
}
"""Further arrays of a bundle of two cameras, the view of each, and their shapes."""

OPTIONAL: dict[str, tuple[int | str, ...]] = {
    "tip_gradual": ("n",),
    "threshold_sd": ("n",),
}
"""Further arrays of a bundle of switches that do not snap, or whose thresholds were learnt."""

MARKS: dict[str, tuple[int | str, ...]] = {
    "mark_point_mm": ("r", 3),
    "mark_colour": ("r",),
    "mark_rest_px": ("r", 2),
    "mark_read_by": ("r",),
    "mark_neighbours": ("r", 8),
}
"""Further arrays of a bundle of a sensor with r reference marks."""

COVERS: dict[str, tuple[int | str, ...]] = {
    "cover_marker": ("k",),
    "cover_tip": ("k",),
    "cover_shift_px": ("k", 2),
}
"""Further arrays of a bundle of a sensor where tips cover k other markers."""

KINDS = {
    "measured_px": np.float32,
    "measured_square_px": np.float32,
    "measured_pair_px": np.float32,
    "receptor_px": np.float32,
    "receptor_pair_px": np.float32,
    "tip_gradual": np.uint8,
}
"""Types of arrays that are neither float64 nor ids."""

MEASURED: dict[str, tuple[int | str, ...]] = {
    "measured_px": ("2n", "m"),
    "measured_marker": ("m",),
}
"""Further arrays of a bundle that has measured the response to forces on m markers."""

MEASURED_LARGE: dict[str, tuple[int | str, ...]] = {
    "measured_square_px": ("2n", "m"),
    "measured_pair": (2, "pairs"),
    "measured_pair_px": ("2n", "pairs"),
}
"""Further arrays of a bundle that has measured large displacements."""

RECEPTORS: dict[str, tuple[int | str, ...]] = {
    "receptor_px": ("receptors", "powers", "2n"),
    "receptor_marker": ("receptors",),
    "receptor_pair": (2, "receptor pairs"),
    "receptor_pair_px": ("receptor pairs", "2n"),
    "receptor_top_N": (1,),
}
"""Further arrays of a bundle that has large displacements by forces on receptors."""


def check_bundle(
    arrays: Mapping[str, Any],
    *,
    markers: int,
    colours: int,
    cameras: int,
    networks: Collection[str],
    folder: Path,
) -> None:
    """Check the arrays that every bundle has: shapes, types, finite numbers, ids.

    Raises
    ------
    InputError
        If an array is missing, of another shape or type, not finite or holds an id that does not
        exist, or if a camera does not show a marker that it reads.
    """
    where, n = f"{folder}/bundle.safetensors", markers
    if not 1 <= cameras <= 2:
        raise InputError(
            "bundle-camera-count",
            f"{folder}/bundle.json has {cameras} cameras, a sensor has one or two; rebuild the "
            "decoder",
        )
    shapes = {name: shape for name, (_, shape) in ARRAYS.items()}
    shapes |= {f"network.{name}": (parameter_count(),) for name in sorted(networks)}
    shapes |= SHOWN if cameras == 2 else {}
    shapes |= {name: shape for name, shape in OPTIONAL.items() if name in arrays}
    # The first array of each says whether there are any.
    for group in (MARKS, COVERS, MEASURED, MEASURED_LARGE, RECEPTORS):
        shapes |= group if next(iter(group)) in arrays else {}
    shapes |= {"learnt_rest_px": ("prints", "n", 2)} if "learnt_rest_px" in arrays else {}
    ids = {"neighbours": (-1, n), "colour": (0, colours), "read_by": (0, cameras)}
    if "mark_point_mm" in arrays:
        r = len(np.atleast_1d(arrays["mark_point_mm"]))
        ids |= {"mark_neighbours": (-1, r), "mark_colour": ids["colour"]}
        ids |= {"mark_read_by": ids["read_by"]}
    named = ("cover_marker", "cover_tip", "measured_marker", "measured_pair", "receptor_marker")
    ids |= {name: (0, n) for name in (*named, "receptor_pair") if name in shapes}
    check_arrays(
        arrays,
        shapes,
        {"n": n, "2n": 2 * n},
        where=where,
        kinds=dict.fromkeys(ids, np.int64) | KINDS,
        # NaN marks what a camera does not see.
        partial=("tip_on_px", "shown_rest_px", "shown_tip_on_px", "mark_rest_px", "learnt_rest_px"),
    )
    for name, (low, high) in ids.items():
        if arrays[name].min(initial=low) < low or arrays[name].max(initial=low) >= high:
            raise InputError(
                "bundle-id-invalid",
                f"{where}: {name} points beyond the bundle's {high} entries; rebuild the decoder",
            )
    if "threshold_sd" in arrays and (arrays["threshold_sd"] <= 0.0).any():
        raise InputError(
            "bundle-threshold-sd-invalid",
            f"{where}: threshold_sd must be positive (got {arrays['threshold_sd'].min():g}); "
            "rebuild the decoder",
        )
    if cameras == 2:
        own = arrays["shown_rest_px"][arrays["read_by"], np.arange(n)]
        hidden = np.flatnonzero(~np.isfinite(own).all(axis=1))
        if len(hidden):
            raise InputError(
                "bundle-marker-hidden",
                f"{where}: marker {hidden[0]} is read by a camera that does not show it; rebuild "
                "the decoder",
            )


def check_arrays(
    arrays: Mapping[str, Any],
    shapes: Mapping[str, tuple[int | str, ...]],
    sizes: dict[str, int],
    *,
    where: str,
    kinds: Mapping[str, Any],
    partial: Collection[str] = (),
    prefix: str = "",
) -> None:
    """Check that arrays exist, have their shapes and types, and hold finite numbers.

    Parameters
    ----------
    shapes : dict
        Expected shape by name, of numbers and names of sizes.
    sizes : dict
        Known sizes; one that is missing is added as the first array has it.
    where : str
        File, the start of a message.
    kinds : dict
        Type by name where it is not float64.
    partial : collection of str
        Arrays that may hold NaN.
    prefix : str
        Start of the names in the file.

    Raises
    ------
    InputError
        If one does not.
    """
    for name, shape in shapes.items():
        if name not in arrays:
            raise InputError(
                "bundle-array-missing", f"{where} lacks '{prefix}{name}'; rebuild the decoder"
            )
        array, kind = arrays[name], np.dtype(kinds.get(name, np.float64))
        for size, length in zip(shape, array.shape, strict=False):
            if isinstance(size, str):
                sizes.setdefault(size, length)
        expected = tuple(sizes.get(size, 0) if isinstance(size, str) else size for size in shape)
        if array.shape != expected:
            raise InputError(
                "bundle-array-shape",
                f"{where}: {prefix}{name} has shape {array.shape}, expected {expected}; the two "
                "files are of different builds",
            )
        if array.dtype != kind:
            raise InputError(
                "bundle-array-type",
                f"{where}: {prefix}{name} is {array.dtype}, expected {kind}; rebuild the decoder",
            )
        if name not in partial and not np.isfinite(array).all():
            raise InputError(
                "bundle-not-finite", f"{where}: {prefix}{name} holds numbers that are not finite"
            )


def describe_fault(error: Exception) -> str:
    """Return the fault of ``bundle.json``, in terms of the file."""
    if isinstance(error, KeyError):
        return f"{error} is missing"
    if isinstance(error, ValueError) and "broadcast" not in str(error):
        return str(error)[:200]
    return "a value has the wrong type or size"


def bounded(value: Any, name: str, *, least: float = 0.0) -> float:
    """Return a number from ``least`` to 1e6."""
    number = float(value)
    if not least <= number <= 1e6:
        raise ValueError(f"{name} must lie between {least:g} and 1e6 (got {number:g})")
    return number


def reject_constant(name: str) -> float:
    """Reject NaN and infinity, which JSON does not have."""
    raise ValueError(f"{name} is no number of JSON")


def finite_float(text: str) -> float:
    """Return a number of a JSON text; raise ``ValueError`` if it is infinite, as 1e400 is."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} is beyond the largest number, 1.8e308")
    return value


def numbers(values: Any, count: int, *, positive: bool = False) -> FloatArray:
    """Return ``count`` finite numbers, (count,).

    Raises
    ------
    ValueError
        If the values are something else, or not above zero where they must be ``positive``.
    """
    out = np.asarray(values, dtype=np.float64)
    if out.shape != (count,) or not np.isfinite(out).all():
        raise ValueError(f"expected {count} finite numbers (got {values!r})")
    if positive and not (out > 0.0).all():
        raise ValueError(f"expected numbers above zero (got {values!r})")
    return out


def number(value: Any, *, positive: bool = False) -> float:
    """Return a finite number; raise ``ValueError`` for anything else."""
    return float(numbers([value], 1, positive=positive)[0])
