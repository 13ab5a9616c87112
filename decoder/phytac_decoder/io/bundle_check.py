"""Whether the arrays of a bundle fit together, before anything is made of them."""

from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import parameter_count
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError

INTEGERS = ("colour", "neighbours", "read_by")
PARTIAL = ("tip_on_px", "shown_rest_px", "shown_tip_on_px")
"""Arrays with NaN for what is not seen."""
CAMERAS_MAX = 2
NUMBER_MAX = 1e6
"""Largest noise, px, and largest force, N, that a bundle may speak of."""
SHOWN_LETTERS = 200
"""Letters of a fault in a file that a message shows."""


def check_arrays(arrays: dict[str, Any], count: int, networks: list[str], folder: Path) -> None:
    """Check what every bundle has.

    Raises
    ------
    InputError
        If an array is missing, of another shape or type, or not finite.
    """
    n = count
    expected: dict[str, tuple[int, ...]] = {
        "colour": (n,),
        "position_mm": (n, 3),
        "rest_px": (n, 2),
        "tip_bias_px": (n, 2),
        "tip_on_px": (n, 2),
        "tip_red_rest_px": (n,),
        "tip_red_on_px": (n,),
        "shift_to_mm": (n, 2),
        "stiffness": (n, n),
        "compliance_px": (2 * n, n),
        "height_z_mm": (n,),
        "neighbours": (n, 8),
        "read_by": (n,),
        "threshold_N": (n,),
    } | {f"network.{name}": (parameter_count(),) for name in networks}
    _check(arrays, expected, n, folder)


def check_count(arrays: dict[str, Any], count: int, folder: Path) -> None:
    """Check the number of markers, before any array is made of that size.

    Raises
    ------
    InputError
        If the arrays are of another number.
    """
    if "rest_px" not in arrays:
        raise InputError(f"{folder}/bundle.safetensors lacks 'rest_px'; rebuild the decoder")
    found = len(np.atleast_1d(arrays["rest_px"]))
    if count != found:
        raise InputError(
            f"{folder}/bundle.safetensors: rest_px has {found} rows, expected {count} for {count} "
            "markers; the two files are of different builds"
        )


def check_shown(arrays: dict[str, Any], count: int, cameras: int, folder: Path) -> None:
    """Check what a bundle of several cameras has besides: what each of them shows.

    Raises
    ------
    InputError
        See :func:`check_arrays`; also if a camera does not show a marker that it reads.
    """
    if not 1 <= cameras <= CAMERAS_MAX:
        raise InputError(
            f"{folder}/bundle.json has {cameras} cameras, a sensor has one or two; rebuild the "
            "decoder"
        )
    if cameras == 1:
        return
    expected: dict[str, tuple[int, ...]] = {
        "shown_rest_px": (cameras, count, 2),
        "shown_tip_on_px": (cameras, count, 2),
        "shown_tip_red_rest_px": (cameras, count),
        "shown_tip_red_on_px": (cameras, count),
    }
    _check(arrays, expected, count, folder)
    own = arrays["shown_rest_px"][arrays["read_by"], np.arange(count)]
    if not np.isfinite(own).all():
        marker = int(np.flatnonzero(~np.isfinite(own).all(axis=1))[0])
        raise InputError(
            f"{folder}/bundle.safetensors: marker {marker} is read by a camera that does not show "
            "it; rebuild the decoder"
        )


def _check(
    arrays: dict[str, Any], expected: dict[str, tuple[int, ...]], count: int, folder: Path
) -> None:
    for name, shape in expected.items():
        if name not in arrays:
            raise InputError(f"{folder}/bundle.safetensors lacks {name!r}; rebuild the decoder")
        if arrays[name].shape != shape:
            raise InputError(
                f"{folder}/bundle.safetensors: {name} has shape {arrays[name].shape}, "
                f"expected {shape} for {count} markers; the two files are of different builds"
            )
        kind = np.int64 if name in INTEGERS else np.float64
        if arrays[name].dtype != kind:
            raise InputError(
                f"{folder}/bundle.safetensors: {name} is {arrays[name].dtype}, expected "
                f"{np.dtype(kind)}; rebuild the decoder"
            )
        if name not in PARTIAL and not np.isfinite(arrays[name]).all():
            raise InputError(
                f"{folder}/bundle.safetensors: {name} holds numbers that are not finite"
            )


def check_indices(
    arrays: dict[str, Any], count: int, colours: int, cameras: int, folder: Path
) -> None:
    """Check that ids, colours and cameras are among those there are.

    Raises
    ------
    InputError
        If one is not.
    """
    for name, low, high in (
        ("neighbours", -1, count),
        ("colour", 0, colours),
        ("read_by", 0, cameras),
    ):
        if arrays[name].min(initial=low) < low or arrays[name].max(initial=low) >= high:
            raise InputError(
                f"{folder}/bundle.safetensors: {name} points beyond the bundle's {high} entries; "
                "rebuild the decoder"
            )


def fault_of(error: Exception) -> str:
    """What is wrong with a table, in words of the file's, not of the program's."""
    if isinstance(error, KeyError):
        return f"{error} is missing"
    if isinstance(error, ValueError) and "broadcast" not in str(error):
        return str(error)[:SHOWN_LETTERS]
    return "a value is not of the kind or the size that it should be"


def positive(value: Any, name: str) -> float:
    """Number from 0 to ``NUMBER_MAX``."""
    number = float(value)
    if not 0.0 <= number <= NUMBER_MAX:
        raise ValueError(f"{name} must lie within 0 and {NUMBER_MAX:g} (got {number:g})")
    return number


def no_number(name: str) -> float:
    """Refuse NaN and infinity, which JSON has not."""
    raise ValueError(f"{name} is no number of JSON")


def numbers(values: Any, count: int) -> FloatArray:
    """So many finite numbers (count,).

    Raises
    ------
    ValueError
        If they are not.
    """
    out = np.asarray(values, dtype=np.float64)
    if out.shape != (count,) or not np.isfinite(out).all():
        raise ValueError(f"expected {count} finite numbers (got {values!r})")
    return out


def above_zero(value: Any) -> float:
    """A finite number above zero.

    Raises
    ------
    ValueError
        If it is not.
    """
    number = float(numbers([value], 1)[0])
    if number <= 0.0:
        raise ValueError(f"expected a number above zero (got {value!r})")
    return number
