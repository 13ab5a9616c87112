"""Schema of a data set's arrays: how each is stored, and checks that they fit together.

``docs/datasets.md`` has the same table.
"""

import io
import json
import lzma
import os
import re
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.datasets.samples import (
    FAILED,
    STATUSES,
    THEORIES,
    DataSetInfo,
    KeyNodeRows,
    Samples,
    TouchRows,
    TruthRows,
)
from phytac_design.mechanics.indenter import INDENTERS
from phytac_shapes.arrays import FloatArray
from phytac_shapes.bounded_reader import read_bytes, read_text
from phytac_shapes.errors import InputError, OutputError, cause_of

MISSING = -(2**15)
"""Value of a shift of a marker that was not found."""


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


FORMAT, SCHEMA = "phytac-dataset", (1, 0)
TABLE, FILE, FRAMES = "dataset.json", "samples.npz", "frames"


def write_samples(
    folder: Path, samples: Samples, meta: DataSetInfo, *, frames: Sequence[str] = ()
) -> DataSetInfo:
    """Write a data set, completely or not at all; equal samples give equal bytes.

    Parameters
    ----------
    folder : Path
        Created if it does not exist; other files in it are kept.
    samples : Samples
        Samples; parts that are None are left out.
    meta : DataSetInfo
        Description; its ``frames`` are ignored.
    frames : sequence of str
        Names of images that are in ``folder/frames`` already (``000012.png``,
        ``000012_far.png`` of sample 12); their hashes become part of the data set.

    Returns
    -------
    Meta
        With the images' hashes.

    Raises
    ------
    InputError
        If the samples are inconsistent, or an image is missing.
    OutputError
        If the folder holds something else or cannot be written.
    """
    where = f"data set for {folder}"
    arrays, scales = _stored(samples, where)
    rows = (samples.touches, samples.truth, samples.key_nodes)
    sizes = (0 if part is None else len(part.sample) for part in rows)
    all_counts = (samples.count, samples.markers, *sizes, len(samples.reason_sample))
    counts = dict(zip(COUNTS, all_counts, strict=True))
    for name, array in arrays.items():
        if array.shape != shape_of(name, counts):
            raise InputError(
                "samples-array-shape",
                f"{where}: {name} has shape {array.shape}, expected {shape_of(name, counts)} for "
                f"{counts['samples']} samples and {counts['markers']} markers",
            )
    check_values(arrays, counts | {"reasons": len(samples.reasons)}, where)
    for name in frames:
        check_frame(name, counts["samples"], where)
    meta = replace(meta, frames={name: file_hash(folder / FRAMES / name) for name in frames})
    packed = _packed(arrays)
    _check_folder(folder)
    table = _table(samples, meta, arrays, scales, counts, packed, where)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _replace(folder / FILE, packed)
        _replace(folder / TABLE, table)
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write the data set {folder}: {error.strerror}"
        ) from None
    return meta


def _check_folder(folder: Path) -> None:
    """Reject a folder with another program's file of the same name."""
    path = folder / TABLE
    try:
        if path.exists() and f'"{FORMAT}"' not in path.read_text(encoding="utf-8"):
            raise OutputError(
                "output-foreign", f"{path} is not a data set's; choose another folder or remove it"
            )
    except (OSError, UnicodeDecodeError):
        raise OutputError(
            "output-foreign", f"{path} is not a data set's; choose another folder"
        ) from None


def _replace(path: Path, data: bytes) -> None:
    """Write a file atomically: a crash leaves the old or the new one."""
    part = path.with_name(f".{path.name}.part")
    with part.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _stored(
    samples: Samples, where: str
) -> tuple[dict[str, NDArray[Any]], dict[str, dict[str, float]]]:
    """Return arrays as stored, and scale and step of those that are rounded."""
    # 0.002 px, a twentieth of the noise of a centroid; multiples of a power of two are exact.
    shift_step_px = 2.0**-9
    force_step_n = 2.0**-10
    values: dict[str, Any] = {name: getattr(samples, name) for name in names_of(["samples"])}
    steps: dict[str, float] = {}
    points = {name: getattr(samples, name) for name in names_of(["points"])}
    if any(value is not None for value in points.values()):
        if any(value is None for value in points.values()):
            raise InputError(
                "samples-points-incomplete",
                f"{where}: {', '.join(points)} go together; give all or none",
            )
        values |= points
        steps["shift_px"] = shift_step_px
    for part, (_, prefix) in ROWS.items():
        rows = getattr(samples, part)
        if rows is not None:
            values |= {n: getattr(rows, n.removeprefix(prefix)) for n in names_of([part])}
    rows = samples.key_nodes
    if rows is not None:
        steps |= {
            "key_u_mm": rows.step_mm,
            "key_stiffness_force_N": rows.step_N,
            "key_force_N": force_step_n,
        }
    arrays: dict[str, NDArray[Any]] = {}
    scales: dict[str, dict[str, float]] = {}
    for name in ARRAYS:
        if name in steps:
            arrays[name], scales[name] = _rounded(np.asarray(values[name]), steps[name], name)
        elif name in values:
            arrays[name] = _as_kind(np.asarray(values[name]), name, where)
    return arrays, scales


def _as_kind(values: NDArray[Any], name: str, where: str) -> NDArray[Any]:
    """Return values of the stored type; reject those outside its range."""
    kind = np.dtype(ARRAYS[name].kinds[0])
    if kind.kind in "iu":
        limits = np.iinfo(kind)
        inside = (limits.min <= values) & (values <= limits.max)
        if values.dtype.kind not in "iub" or not inside.all():
            raise InputError(
                "samples-not-whole-numbers", f"{where}: {name} must be whole numbers within {kind}"
            )
    return np.ascontiguousarray(values.astype(kind))


def _rounded(values: FloatArray, step: float, name: str) -> tuple[NDArray[Any], dict[str, float]]:
    """Return multiples of a step as 16-bit numbers, or as float32 for a larger range."""
    whole, wide = (np.dtype(kind) for kind in ARRAYS[name].kinds)
    limits = np.iinfo(whole)
    number = np.rint(values / step) + 0.0
    known = number[~np.isnan(number)]
    low = MISSING + 1 if whole.kind == "i" else 0
    outside = known.size and (known.min() < low or known.max() > limits.max)
    if outside or (name != "shift_px" and known.size < number.size):
        return (number * step).astype(wide), {"scale": 1.0, "step": step}
    return np.where(np.isnan(number), MISSING, number).astype(whole), {"scale": step, "step": step}


def _packed(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return NumPy's npz with fixed times, order and compression.

    LZMA packs arrays of 4 KiB to 1 MiB better; below it gains nothing, and above it is slow.
    """
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        for name, array in arrays.items():
            data = io.BytesIO()
            np.lib.format.write_array(data, array, version=(1, 0), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.external_attr, info.create_system = 0o644 << 16, 3
            lzma = 2**12 <= array.nbytes <= 2**20
            info.compress_type = zipfile.ZIP_LZMA if lzma else zipfile.ZIP_DEFLATED
            file.writestr(info, data.getbuffer(), compresslevel=6)
    return out.getvalue()


def check_frame(name: str, samples: int, where: str) -> None:
    """Reject the name of an image of no sample."""
    frame = re.compile(r"(\d{6,9})(_far)?\.(png|jpg)")
    found = frame.fullmatch(name)
    if found is None or int(found[1]) >= samples:
        raise InputError(
            "samples-picture-name",
            f"{where}: {name!r} is no picture of its {samples} samples; they are named 000000.png, "
            "000000_far.png, …",
        )


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError("file-unreadable", f"{path} cannot be read ({error.strerror})") from None


def table_hash(table: Mapping[str, Any]) -> str:
    """Return the SHA-256 of ``dataset.json`` without its ``checksum``, in any formatting."""
    rest = {key: value for key, value in table.items() if key != "checksum"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()


def _table(
    samples: Samples,
    meta: DataSetInfo,
    arrays: Mapping[str, NDArray[Any]],
    scales: Mapping[str, Mapping[str, float]],
    counts: Mapping[str, int],
    packed: bytes,
    where: str,
) -> bytes:
    """Return ``dataset.json``."""
    described = {}
    for name, array in arrays.items():
        stored = ARRAYS[name]
        described[name] = {
            "dtype": array.dtype.str,
            "shape": list(stored.shape),
            "unit": stored.unit,
        } | dict(scales.get(name, {}))
    if arrays.get("shift_px", np.zeros(0)).dtype.kind == "i":
        described["shift_px"]["missing"] = MISSING
    table = {
        "format": FORMAT,
        "schema_version": f"{SCHEMA[0]}.{SCHEMA[1]}",
        "simulated": meta.simulated,
        "what": meta.what,
        "design": meta.design,
        "design_hash": meta.design_hash,
        "route": meta.route,
        "seed": meta.seed,
        "hashes": meta.hashes,
        "notes": meta.notes,
        "parts": [part for part in PARTS if any(ARRAYS[name].part == part for name in arrays)],
        "counts": dict(counts),
        "arrays": described,
        "statuses": list(STATUSES),
        "theories": list(THEORIES),
        "indenters": list(INDENTERS),
        "reasons": list(samples.reasons),
        "file": {"name": FILE, "bytes": len(packed), "sha256": sha256(packed).hexdigest()},
        "frames": meta.frames,
    }
    try:
        table["checksum"] = table_hash(table)
        text = json.dumps(table, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            "samples-notes-invalid", f"{where}: notes must be plain JSON ({error}); correct them"
        ) from None
    return (text + "\n").encode()


BYTES_MAX = 2**34
"""Larger data sets are rejected before they are unpacked."""
AGAIN = "copy it again from where it came, or make it again"


def read_samples(
    folder: Path,
    *,
    expect_design_hash: str | None = None,
    check_frames: bool = False,
    bytes_max: int = BYTES_MAX,
) -> tuple[Samples, DataSetInfo]:
    """Read a data set and check it.

    Parameters
    ----------
    folder : Path
        Holds ``dataset.json`` and ``samples.npz``.
    expect_design_hash : str, optional
        Required hash of the design.
    check_frames : bool
        Also compare the hashes of the images.
    bytes_max : int
        Largest memory of its arrays.

    Raises
    ------
    InputError
        If a file is missing, truncated, altered, of a newer schema, of another design, or has
        invalid contents.
    """
    # Exceptions of Python's zip and NumPy for damaged files.
    broken = (
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
        struct.error,
        EOFError,
        KeyError,
        NotImplementedError,
        OSError,
        OverflowError,
        RuntimeError,
        SyntaxError,
        tokenize.TokenError,
        TypeError,
        ValueError,
    )
    table = _read_table(folder)
    if expect_design_hash is not None and table["design_hash"] != expect_design_hash:
        raise InputError(
            "data-set-other-design",
            f"{folder} is a data set of the design {table['design']!r} with hash "
            f"{str(table['design_hash'])[:12]}…, expected {expect_design_hash[:12]}…; use data of "
            "this very design, or the design it was made with",
        )
    try:
        counts = _counts(table, folder)
        names = names_of([part for part in PARTS if part in _list(table["parts"])])
        meta = _meta(table)
        reasons = tuple(_text(reason) for reason in _list(table["reasons"]))
        _check_words(table)
        _check_rest(meta, counts)
        memory = sum(8 * int(np.prod(shape_of(name, counts), dtype=object)) for name in names)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "data-set-table-invalid",
            f"{folder / TABLE} is not a data set's: {type(error).__name__} {cause_of(error)}; "
            f"{AGAIN}",
        ) from None
    if memory > bytes_max:
        raise InputError(
            "data-set-too-large",
            f"{folder} declares {memory / 2**30:.3g} GiB of arrays, more than the "
            f"{bytes_max / 2**30:.3g} GiB allowed; raise bytes_max if that is right",
        )
    data = _read_file(folder, table)
    try:
        arrays = _unpacked(data, names, counts, bytes_max)
    except broken as error:
        raise InputError(
            "data-set-unreadable",
            f"{folder / FILE} cannot be read ({type(error).__name__}: {cause_of(error)}); {AGAIN}",
        ) from None
    check_values(arrays, counts | {"reasons": len(reasons)}, str(folder))
    for name in meta.frames:
        check_frame(name, counts["samples"], str(folder))
        if check_frames and file_hash(folder / FRAMES / name) != meta.frames[name]:
            raise InputError(
                "data-set-picture-altered",
                f"{folder / FRAMES / name} is not the picture it was; {AGAIN}",
            )
    try:
        return _samples(arrays, table, counts, reasons), meta
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "data-set-table-invalid",
            f"{folder / TABLE}: {type(error).__name__} {cause_of(error)}; {AGAIN}",
        ) from None


def _read_table(folder: Path) -> dict[str, Any]:
    table_bytes_max = 2**28
    path = folder / TABLE
    try:
        table = json.loads(read_text(path, bytes_max=table_bytes_max))
    except OSError as error:
        raise InputError(
            "data-set-not-found",
            f"no data set in {folder} ({TABLE}: {error.strerror}); give the folder that "
            "`phytac simulate` or `phytac import` wrote",
        ) from None
    except (ValueError, RecursionError) as error:
        raise InputError(
            "data-set-table-invalid", f"{path} is not JSON ({cause_of(error)}); {AGAIN}"
        ) from None
    if not isinstance(table, dict) or table.get("format") != FORMAT:
        raise InputError(
            "data-set-unknown-format", f"{path} is not a data set's (format is not {FORMAT!r})"
        )
    version = str(table.get("schema_version")).split(".")
    if len(version) != 2 or not all(part.isdecimal() for part in version):
        raise InputError(
            "data-set-schema-version", f"{path} has no readable schema_version; {AGAIN}"
        )
    major, minor = map(int, version)
    if major != SCHEMA[0] or minor > SCHEMA[1]:
        raise InputError(
            "data-set-schema-version",
            f"{path} has schema {major}.{minor}, this version reads {SCHEMA[0]}.0 to "
            f"{SCHEMA[0]}.{SCHEMA[1]}; get the newest phytac-design or make it again",
        )
    try:
        same = table.get("checksum") == table_hash(table)
    except (TypeError, ValueError, RecursionError):
        same = False
    if not same:
        raise InputError(
            "data-set-altered", f"{path} was altered: its checksum does not fit; {AGAIN}"
        )
    return table


def _counts(table: Mapping[str, Any], folder: Path) -> dict[str, int]:
    counts = {name: table["counts"][name] for name in COUNTS}
    for name, count in counts.items():
        if type(count) is not int or not 0 <= count < 2**31:
            raise InputError(
                "data-set-table-invalid", f"{folder / TABLE}: counts.{name} is {count!r}; {AGAIN}"
            )
    return counts


def _meta(table: Mapping[str, Any]) -> DataSetInfo:
    seed = table["seed"]
    if type(table["simulated"]) is not bool or (seed is not None and type(seed) is not int):
        raise TypeError("simulated or seed is of another kind")
    return DataSetInfo(
        simulated=table["simulated"],
        what=_text(table["what"]),
        design=_text(table["design"]),
        design_hash=_text(table["design_hash"]),
        route=_text(table["route"]),
        seed=seed,
        hashes={key: _text(value) for key, value in table["hashes"].items()},
        notes=dict(table["notes"]),
        frames={key: _text(value) for key, value in table["frames"].items()},
    )


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r} should be a list")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} should be text")
    return value


def _check_words(table: Mapping[str, Any]) -> None:
    """Check that codes have the same meaning here, and parts exist."""
    words = {"statuses": STATUSES, "theories": THEORIES, "indenters": INDENTERS}
    for name, known in words.items():
        if table[name] != list(known):
            raise ValueError(f"{name} are {table[name]}, expected {list(known)}")
    if "samples" not in table["parts"] or not set(_list(table["parts"])) <= set(PARTS):
        raise ValueError(f"parts are {table['parts']}, known: {', '.join(PARTS)}")


def _check_rest(meta: DataSetInfo, counts: Mapping[str, int]) -> None:
    """Check that rest positions, if there are any, are of all markers."""
    if meta.rest_px is not None and len(meta.rest_px) != counts["markers"]:
        raise ValueError(f"notes.rest_px is of {len(meta.rest_px)} markers")


def _read_file(folder: Path, table: Mapping[str, Any]) -> bytes:
    path = folder / FILE
    try:
        size, expected = int(table["file"]["bytes"]), _text(table["file"]["sha256"])
        found = path.stat().st_size
        if found != size:
            how = "truncated" if found < size else "altered"
            raise InputError(
                "data-set-altered", f"{path} has {found} bytes, expected {size}: {how}; {AGAIN}"
            )
        data = read_bytes(path, bytes_max=BYTES_MAX)
    except OSError as error:
        raise InputError(
            "data-set-unreadable", f"{path} cannot be read ({error.strerror}); {AGAIN}"
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "data-set-table-invalid", f"{folder / TABLE}: file: {cause_of(error)}; {AGAIN}"
        ) from None
    if sha256(data).hexdigest() != expected:
        raise InputError(
            "data-set-altered", f"{path} was altered: its checksum is not that of {TABLE}; {AGAIN}"
        )
    return data


def _unpacked(
    data: bytes, names: list[str], counts: Mapping[str, int], bytes_max: int
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an npz, each of its shape and one of its types."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        found = file.namelist()
        if sorted(found) != sorted(f"{name}.npy" for name in names):
            raise ValueError(f"it holds {', '.join(found)}, expected {', '.join(names)}")
        if sum(info.file_size for info in file.infolist()) > bytes_max:
            raise ValueError("it unpacks to more than its arrays")
        return {
            name: _array(file, f"{name}.npy", ARRAYS[name].kinds, shape_of(name, counts))
            for name in names
        }


def _array(
    file: zipfile.ZipFile, name: str, kinds: tuple[str, ...], expected: tuple[int, ...]
) -> NDArray[Any]:
    with file.open(name) as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise ValueError(f"{name} is of another npy version")
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(member, max_header_size=4096)
        if dtype.str not in kinds or by_columns:
            raise ValueError(f"{name} is {dtype.str}, expected {' or '.join(kinds)}")
        if shape != expected:
            raise ValueError(f"{name} has shape {shape}, expected {expected}")
        size = int(np.prod(shape, dtype=object)) * dtype.itemsize
        # zipfile compares its checksum at the end of the file.
        data = member.read(size)
        if len(data) != size or member.read(1):
            raise ValueError(f"{name} is shorter or longer than its shape")
    if dtype.kind == "b" and np.frombuffer(data, dtype=np.uint8).max(initial=0) > 1:
        raise ValueError(f"{name} holds bytes that are neither true nor false")
    return np.frombuffer(data, dtype=dtype).reshape(shape)


def _samples(
    arrays: Mapping[str, NDArray[Any]],
    table: Mapping[str, Any],
    counts: Mapping[str, int],
    reasons: tuple[str, ...],
) -> Samples:
    values: dict[str, Any] = {
        name: _value(name, array, table["arrays"][name]) for name, array in arrays.items()
    }
    steps = {
        name: float(entry["step"]) for name, entry in table["arrays"].items() if "step" in entry
    }

    parts: dict[str, Any] = {}
    for part, (kind, prefix) in ROWS.items():
        names = [name for name in names_of([part]) if name in values]
        if names:
            rows = {name.removeprefix(prefix): values.pop(name) for name in names}
            if part == "key_nodes":
                rows["step_mm"] = steps["key_u_mm"]
                rows["step_N"] = steps["key_stiffness_force_N"]
            parts[part] = kind(**rows)
    return Samples(markers=counts["markers"], reasons=reasons, **values, **parts)


def _value(name: str, array: NDArray[Any], entry: Mapping[str, Any]) -> NDArray[Any]:
    """Return numbers as used: float64, int64, bool."""
    if entry["dtype"] != array.dtype.str:
        raise ValueError(f"{name} is {array.dtype.str}, not {entry['dtype']}")
    if array.dtype.kind == "b":
        return array.copy()
    if array.dtype.kind in "iu" and len(ARRAYS[name].kinds) == 1:
        return array.astype(np.int64)
    out = array.astype(np.float64)
    if len(ARRAYS[name].kinds) == 1:
        return out
    scale = float(entry["scale"])
    if not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f"the scale of {name} is {scale}")
    if name == "shift_px" and array.dtype.kind == "i":
        if entry["missing"] != MISSING:
            raise ValueError(f"missing shifts are {entry['missing']}, expected {MISSING}")
        out[array == MISSING] = np.nan
    out *= scale
    return out
