"""Reading data sets of :mod:`phytac_design.datasets.samples_writer`, all contents checked."""

import io
import json
import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.datasets.samples import INDENTERS, STATUSES, THEORIES, DataSetInfo, Samples
from phytac_design.datasets.samples_check import (
    ARRAYS,
    COUNT_MAX,
    COUNTS,
    MISSING,
    PARTS,
    ROWS,
    check_values,
    names_of,
    shape_of,
)
from phytac_design.datasets.samples_writer import (
    FILE,
    FORMAT,
    FRAMES,
    SCHEMA,
    TABLE,
    check_frame,
    file_hash,
    table_hash,
)
from phytac_shapes.bounded_reader import read_bytes, read_text
from phytac_shapes.errors import InputError, cause_of

TABLE_BYTES_MAX = 2**28
BYTES_MAX = 2**34
"""Larger data sets are rejected before they are unpacked."""
BROKEN = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, KeyError,
    NotImplementedError, OSError, OverflowError, RuntimeError, SyntaxError, tokenize.TokenError,
    TypeError, ValueError,
)  # fmt: skip
"""Exceptions of Python's zip and NumPy for damaged files."""
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
    except BROKEN as error:
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
    path = folder / TABLE
    try:
        table = json.loads(read_text(path, bytes_max=TABLE_BYTES_MAX))
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
        if type(count) is not int or not 0 <= count <= COUNT_MAX:
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


def _read_file(folder: Path, table: Mapping[str, Any]) -> bytes:
    path = folder / FILE
    try:
        size, expected = int(table["file"]["bytes"]), _text(table["file"]["sha256"])
        found = path.stat().st_size
        if found != size:
            raise InputError(
                "data-set-altered", f"{path} has {found} bytes, expected {size}: truncated; {AGAIN}"
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
