"""Writing data sets: ``dataset.json`` and ``samples.npz`` in one folder (``docs/datasets.md``).

:mod:`phytac_design.datasets.samples_reader` reads them.
"""

import io
import json
import os
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.datasets.samples import INDENTERS, STATUSES, THEORIES, DataSetInfo, Samples
from phytac_design.datasets.samples_check import (
    ARRAYS,
    COUNTS,
    MISSING,
    PARTS,
    ROWS,
    check_values,
    names_of,
    shape_of,
)
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError, OutputError

FORMAT, SCHEMA = "phytac-dataset", (1, 0)
TABLE, FILE, FRAMES = "dataset.json", "samples.npz", "frames"
SHIFT_STEP_PX = 2.0**-9
"""0.002 px, a twentieth of the noise of a centroid; multiples of a power of two are exact."""
FORCE_STEP_N = 2.0**-10
FRAME = re.compile(r"(\d{6,9})(_far)?\.(png|jpg)")


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
        steps["shift_px"] = SHIFT_STEP_PX
    for part, (_, prefix) in ROWS.items():
        rows = getattr(samples, part)
        if rows is not None:
            values |= {n: getattr(rows, n.removeprefix(prefix)) for n in names_of([part])}
    rows = samples.key_nodes
    if rows is not None:
        steps |= {
            "key_u_mm": rows.step_mm,
            "key_stiffness_force_N": rows.step_N,
            "key_force_N": FORCE_STEP_N,
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
    found = FRAME.fullmatch(name)
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
