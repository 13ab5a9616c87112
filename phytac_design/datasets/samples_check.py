"""Schema of a data set's arrays: how each is stored, and checks that they fit together.

``docs/datasets.md`` has the same table.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.datasets.samples import (
    FAILED,
    INDENTERS,
    STATUSES,
    THEORIES,
    KeyNodeRows,
    TouchRows,
    TruthRows,
)
from phytac_shapes.errors import InputError

MISSING = -(2**15)
"""Value of a shift of a marker that was not found."""
COUNT_MAX = 2**31 - 1


@dataclass(frozen=True)
class Stored:
    """Storage of one array.

    Attributes
    ----------
    part : str
        Part of the data set it belongs to.
    kinds : tuple of str
        Possible types; a second one, float32, is for ranges beyond the first.
    shape : tuple of str and int
        Counts by name, or fixed sizes.
    unit : str
        Unit of the numbers, or of the numbers times ``step``.
    low, high : float
        Bounds of the numbers; -inf and inf for any finite number.
    """

    part: str
    kinds: tuple[str, ...]
    shape: tuple[str | int, ...]
    unit: str = "-"
    low: float = -np.inf
    high: float = np.inf


S, C, T, K = ("samples",), ("contacts",), ("truth",), ("key_nodes",)
F8, I4, U1 = ("<f8",), ("<i4",), ("|u1",)
ARRAYS: dict[str, Stored] = {
    "time_s": Stored("samples", F8, S, "s"),
    "sequence": Stored("samples", I4, S, low=0),
    "light": Stored("samples", F8, S, low=0),
    "status": Stored("samples", U1, S, high=len(STATUSES) - 1),
    "theory": Stored("samples", U1, S, high=len(THEORIES) - 1),
    "total_N": Stored("samples", ("<f4",), S, "N", low=0),
    "contacts": Stored("samples", ("<u2",), S),
    "reason_sample": Stored("samples", I4, ("remarks",), low=0),
    "reason_index": Stored("samples", I4, ("remarks",), low=0),
    "bits": Stored("points", ("|b1",), (*S, "markers")),
    "bits_read": Stored("points", ("|b1",), (*S, "markers")),
    "shift_px": Stored("points", ("<i2", "<f4"), (*S, "markers", 2), "px"),
    "touch_sample": Stored("touches", I4, C, low=0),
    "touch_uv": Stored("touches", F8, (*C, 2), "chart"),
    "touch_point_mm": Stored("touches", F8, (*C, 3), "mm"),
    "touch_radius_mm": Stored("touches", F8, C, "mm", low=0),
    "touch_force_N": Stored("touches", F8, C, "N", low=0),
    "touch_indenter": Stored("touches", U1, C, high=len(INDENTERS) - 1),
    "touch_length_mm": Stored("touches", F8, C, "mm", low=0),
    "touch_turn_rad": Stored("touches", F8, C, "rad"),
    "touch_friction": Stored("touches", F8, (*C, 2)),
    "truth_sample": Stored("truth", I4, T, low=0),
    "truth_marker": Stored("truth", I4, T, low=0),
    "truth_force_N": Stored("truth", F8, T, "N", low=0),
    "truth_touch": Stored("truth", I4, T, low=-1),
    "key_sample": Stored("key_nodes", I4, K, low=0),
    "key_marker": Stored("key_nodes", I4, K, low=0),
    "key_u_mm": Stored("key_nodes", ("<i2", "<f4"), (*K, 9), "mm"),
    "key_height_z_mm": Stored("key_nodes", F8, ("markers",), "mm"),
    "key_stiffness_force_N": Stored("key_nodes", ("<i2", "<f4"), K, "N"),
    "key_force_N": Stored("key_nodes", ("<u2", "<f4"), K, "N", low=0),
}
"""By name in the file, in its order."""
PARTS = ("samples", "points", "touches", "truth", "key_nodes")
ROWS: dict[str, tuple[Any, str]] = {
    "touches": (TouchRows, "touch_"),
    "truth": (TruthRows, "truth_"),
    "key_nodes": (KeyNodeRows, "key_"),
}
"""Class of the rows of a part, and prefix of its arrays."""
COUNTS = ("samples", "markers", "contacts", "truth", "key_nodes", "remarks")


def names_of(parts: "list[str] | tuple[str, ...]") -> list[str]:
    """Return the arrays of some parts."""
    return [name for name, stored in ARRAYS.items() if stored.part in parts]


def shape_of(name: str, counts: Mapping[str, int]) -> tuple[int, ...]:
    """Return the shape of an array."""
    return tuple(counts[size] if isinstance(size, str) else size for size in ARRAYS[name].shape)


def check_values(arrays: Mapping[str, NDArray[Any]], counts: Mapping[str, int], where: str) -> None:
    """Check ranges, ids, order and consistency of stored arrays of the right shapes.

    Parameters
    ----------
    arrays : dict of arrays
        As stored, by name.
    counts : dict of int
        See ``COUNTS``; also ``reasons``, the number of sentences.
    where : str
        Data set, the start of an error message.

    Raises
    ------
    InputError
        If a number is invalid.
    """
    for name, array in arrays.items():
        _check_range(name, array, where)
    _check_ids(arrays, counts, where)
    _check_status(arrays, where)
    if "truth_touch" in arrays:
        _check_pairs("truth", arrays, counts["markers"], where)
        owner, touched = arrays["truth_touch"], arrays.get("touch_sample")
        owned = owner >= 0
        if touched is None or np.any(touched[owner[owned]] != arrays["truth_sample"][owned]):
            raise _bad(
                where,
                "samples-ids-inconsistent",
                "truth_touch names contacts of other samples, or none are there",
            )
    if "key_sample" in arrays:
        _check_pairs("key", arrays, counts["markers"], where)
    if "touch_sample" in arrays:
        found = np.bincount(arrays["touch_sample"], minlength=counts["samples"])
        if not np.array_equal(found, arrays["contacts"]):
            raise _bad(
                where, "samples-counts-differ", "contacts does not count the rows of touch_sample"
            )


def _check_ids(arrays: Mapping[str, NDArray[Any]], counts: Mapping[str, int], where: str) -> None:
    """Check that ids exist and rows are in the order of their samples."""
    limits = {
        "_sample": counts["samples"],
        "_marker": counts["markers"],
        "_touch": counts["contacts"],
        "_index": counts["reasons"],
    }
    for name, array in arrays.items():
        top = next((limits[end] for end in limits if name.endswith(end)), None)
        if top is not None and array.max(initial=-1) >= top:
            raise _bad(
                where,
                "samples-id-unknown",
                f"{name} points beyond its {top} entries (got {array.max()})",
            )
        if name.endswith("_sample") and np.any(np.diff(array) < 0):
            raise _bad(where, "samples-not-ordered", f"{name} is not in the order of the samples")


def _check_range(name: str, array: NDArray[Any], where: str) -> None:
    stored = ARRAYS[name]
    # Only shifts may be missing.
    values = array[~np.isnan(array)] if name == "shift_px" and array.dtype.kind == "f" else array
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise _bad(where, "samples-not-finite", f"{name} holds numbers that are not finite")
    if values.size and (values.min() < stored.low or values.max() > stored.high):
        raise _bad(
            where,
            "samples-value-range",
            f"{name} must lie within {stored.low:g} and {stored.high:g} "
            f"(got {float(values.min()):g} to {float(values.max()):g})",
        )
    if name == "shift_px":
        gone = array == MISSING if array.dtype.kind == "i" else np.isnan(array)
        if np.any(gone[..., 0] != gone[..., 1]):
            raise _bad(
                where,
                "samples-shift-incomplete",
                "shift_px lacks one of a marker's two coordinates",
            )


def _check_status(arrays: Mapping[str, NDArray[Any]], where: str) -> None:
    """Check that just the samples that are not ok have reasons; failed ones have no key nodes."""
    status = arrays["status"]
    wrong = np.flatnonzero((status > 0) != np.isin(np.arange(len(status)), arrays["reason_sample"]))
    if len(wrong):
        name = STATUSES[status[wrong[0]]]
        raise _bad(
            where,
            "samples-status-inconsistent",
            f"sample {wrong[0]} is {name} {'with' if name == 'ok' else 'without'} a reason",
        )
    if "key_sample" in arrays and np.any(status[arrays["key_sample"]] == FAILED):
        raise _bad(where, "samples-status-inconsistent", "key_sample names failed samples")


def _check_pairs(start: str, arrays: Mapping[str, NDArray[Any]], markers: int, where: str) -> None:
    """Check that there is one row for each pair of sample and marker, ascending."""
    pair = arrays[f"{start}_sample"].astype(np.int64) * markers + arrays[f"{start}_marker"]
    if np.any(np.diff(pair) <= 0):
        raise _bad(
            where, "samples-not-ordered", f"rows of {start}_marker are double or not in order"
        )


def _bad(where: str, code: str, what: str) -> InputError:
    return InputError(code, f"{where}: {what}; make the data set again")
