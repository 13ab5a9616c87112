"""The arrays of a data set's file: what each is, how it is stored, and whether they fit together.

``docs/datasets.md`` has the same table for readers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.datasets.samples import FAILED, INDENTERS, STATUSES, THEORIES
from phytac_shapes.errors import InputError

MISSING = -(2**15)
"""Stored for a shift of a marker that was not found."""
COUNT_MAX = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class Stored:
    """How one array is stored.

    Attributes
    ----------
    part : str
        Part of the data set it belongs to.
    kinds : tuple of str
        Types it may have; a second one, float32, is for ranges that the first does not hold.
    shape : tuple of str and int
        Counts by name, and fixed sizes.
    unit : str
        Of its numbers, or of its numbers times ``step``.
    low, high : float
        Least and largest number that may be stored, -inf and inf for any that is finite.
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
    "time_s": Stored(part="samples", kinds=F8, shape=S, unit="s"),
    "sequence": Stored(part="samples", kinds=I4, shape=S, low=0),
    "light": Stored(part="samples", kinds=F8, shape=S, low=0),
    "status": Stored(part="samples", kinds=U1, shape=S, high=len(STATUSES) - 1),
    "theory": Stored(part="samples", kinds=U1, shape=S, high=len(THEORIES) - 1),
    "total_N": Stored(part="samples", kinds=("<f4",), shape=S, unit="N", low=0),
    "contacts": Stored(part="samples", kinds=("<u2",), shape=S),
    "reason_sample": Stored(part="samples", kinds=I4, shape=("remarks",), low=0),
    "reason_index": Stored(part="samples", kinds=I4, shape=("remarks",), low=0),
    "bits": Stored(part="points", kinds=("|b1",), shape=("samples", "markers")),
    "bits_read": Stored(part="points", kinds=("|b1",), shape=("samples", "markers")),
    "shift_px": Stored(
        part="points", kinds=("<i2", "<f4"), shape=("samples", "markers", 2), unit="px"
    ),
    "touch_sample": Stored(part="touches", kinds=I4, shape=C, low=0),
    "touch_uv": Stored(part="touches", kinds=F8, shape=(*C, 2), unit="chart"),
    "touch_point_mm": Stored(part="touches", kinds=F8, shape=(*C, 3), unit="mm"),
    "touch_radius_mm": Stored(part="touches", kinds=F8, shape=C, unit="mm", low=0),
    "touch_force_N": Stored(part="touches", kinds=F8, shape=C, unit="N", low=0),
    "touch_indenter": Stored(part="touches", kinds=U1, shape=C, high=len(INDENTERS) - 1),
    "touch_length_mm": Stored(part="touches", kinds=F8, shape=C, unit="mm", low=0),
    "touch_turn_rad": Stored(part="touches", kinds=F8, shape=C, unit="rad"),
    "touch_friction": Stored(part="touches", kinds=F8, shape=(*C, 2)),
    "truth_sample": Stored(part="truth", kinds=I4, shape=T, low=0),
    "truth_marker": Stored(part="truth", kinds=I4, shape=T, low=0),
    "truth_force_N": Stored(part="truth", kinds=F8, shape=T, unit="N", low=0),
    "truth_touch": Stored(part="truth", kinds=I4, shape=T, low=-1),
    "key_sample": Stored(part="key_nodes", kinds=I4, shape=K, low=0),
    "key_marker": Stored(part="key_nodes", kinds=I4, shape=K, low=0),
    "key_u_mm": Stored(part="key_nodes", kinds=("<i2", "<f4"), shape=(*K, 9), unit="mm"),
    "key_height_z_mm": Stored(part="key_nodes", kinds=F8, shape=("markers",), unit="mm"),
    "key_stiffness_force_N": Stored(part="key_nodes", kinds=("<i2", "<f4"), shape=K, unit="N"),
    "key_force_N": Stored(part="key_nodes", kinds=("<u2", "<f4"), shape=K, unit="N", low=0),
}
"""By name in the file, in its order."""
PARTS = ("samples", "points", "touches", "truth", "key_nodes")
COUNTS = ("samples", "markers", "contacts", "truth", "key_nodes", "remarks")


def names_of(parts: "list[str] | tuple[str, ...]") -> list[str]:
    """Arrays of some parts."""
    return [name for name, stored in ARRAYS.items() if stored.part in parts]


def shape_of(name: str, counts: Mapping[str, int]) -> tuple[int, ...]:
    """Shape that an array has."""
    return tuple(counts[size] if isinstance(size, str) else size for size in ARRAYS[name].shape)


def check_values(arrays: Mapping[str, NDArray[Any]], counts: Mapping[str, int], where: str) -> None:
    """Check stored arrays of the right shapes: ranges, ids, order, and that they fit together.

    Parameters
    ----------
    arrays : dict of arrays
        As stored, by name.
    counts : dict of int
        See ``COUNTS``; ``reasons`` besides, the number of sentences.
    where : str
        Start of an error's text: which data set.

    Raises
    ------
    InputError
        If a number cannot be right.
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
            raise _bad(where, "truth_touch names contacts of other samples, or none are there")
    if "key_sample" in arrays:
        _check_pairs("key", arrays, counts["markers"], where)
    if "touch_sample" in arrays:
        found = np.bincount(arrays["touch_sample"], minlength=counts["samples"])
        if not np.array_equal(found, arrays["contacts"]):
            raise _bad(where, "contacts does not count the rows of touch_sample")


def _check_ids(arrays: Mapping[str, NDArray[Any]], counts: Mapping[str, int], where: str) -> None:
    """Ids are of things that there are, and rows in the order of their samples."""
    limits = {
        "_sample": counts["samples"],
        "_marker": counts["markers"],
        "_touch": counts["contacts"],
        "_index": counts["reasons"],
    }
    for name, array in arrays.items():
        top = next((limits[end] for end in limits if name.endswith(end)), None)
        if top is not None and array.max(initial=-1) >= top:
            raise _bad(where, f"{name} points beyond its {top} entries (got {array.max()})")
        if name.endswith("_sample") and np.any(np.diff(array) < 0):
            raise _bad(where, f"{name} is not in the order of the samples")


def _check_range(name: str, array: NDArray[Any], where: str) -> None:
    stored = ARRAYS[name]
    # Shifts alone may be missing.
    values = array[~np.isnan(array)] if name == "shift_px" and array.dtype.kind == "f" else array
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise _bad(where, f"{name} holds numbers that are not finite")
    if values.size and (values.min() < stored.low or values.max() > stored.high):
        raise _bad(
            where,
            f"{name} must lie within {stored.low:g} and {stored.high:g} "
            f"(got {float(values.min()):g} to {float(values.max()):g})",
        )
    if name == "shift_px":
        gone = array == MISSING if array.dtype.kind == "i" else np.isnan(array)
        if np.any(gone[..., 0] != gone[..., 1]):
            raise _bad(where, "shift_px lacks one of a marker's two coordinates")


def _check_status(arrays: Mapping[str, NDArray[Any]], where: str) -> None:
    """Every sample that is not ok says why, and no other does; failed ones hold no rows."""
    status = arrays["status"]
    said = np.zeros(len(status), dtype=np.bool_)
    said[arrays["reason_sample"]] = True
    silent = np.flatnonzero((status > 0) & ~said)
    if len(silent):
        raise _bad(where, f"sample {silent[0]} is {STATUSES[status[silent[0]]]} without a reason")
    loud = np.flatnonzero((status == 0) & said)
    if len(loud):
        raise _bad(where, f"sample {loud[0]} is ok, but a reason speaks against it")
    if "key_sample" in arrays and np.any(status[arrays["key_sample"]] == FAILED):
        raise _bad(where, "key_sample names failed samples")


def _check_pairs(start: str, arrays: Mapping[str, NDArray[Any]], markers: int, where: str) -> None:
    """One row for each pair of sample and marker, in their order."""
    pair = arrays[f"{start}_sample"].astype(np.int64) * markers + arrays[f"{start}_marker"]
    if np.any(np.diff(pair) <= 0):
        raise _bad(where, f"rows of {start}_marker are double or not in order")


def _bad(where: str, what: str) -> InputError:
    return InputError(f"{where}: {what}; make the data set again")
