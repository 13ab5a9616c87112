"""Recordings of a stream as Parquet."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from phytac_shapes.errors import InputError, MissingPartError, OutputError, cause_of


def to_parquet(
    recording: Path,
    target: Path,
    *,
    force: bool = False,
    report: Callable[[str], None] = lambda _: None,
) -> tuple[int, int]:
    """Write a CSV of ``phytac serve`` as Parquet; returns the number of rows and columns.

    Columns keep their names. ``valid`` becomes a boolean, ``markers`` a list of integers, and empty
    cells are null.

    Parameters
    ----------
    recording : Path
        CSV of ``--record`` or ``--record-regions``.
    target : Path
        File to make; it is complete or absent.
    force : bool
        Overwrite it.
    report : callable
        Called with a line if the last row is cut off and left out.

    Raises
    ------
    InputError
        If the recording is none.
    MissingPartError
        If pyarrow is not installed.
    OutputError
        If the target is there, or cannot be written.
    """
    arrow = parquet_library()
    if target.suffix.lower() != ".parquet":
        raise InputError(
            "file-ending", f"this writes Parquet (got {target.name}); end its name in .parquet"
        )
    if target.exists() and not force:
        raise OutputError(
            "output-exists", f"{target} is there already; add --force, or choose another name"
        )
    table = _read(arrow, recording, report)
    half = target.with_name(target.name + ".part")
    try:
        arrow.parquet.write_table(table, half, compression="zstd")
        half.replace(target)
    except OSError as error:
        half.unlink(missing_ok=True)
        raise OutputError(
            "output-not-writable", f"{target} cannot be written ({error.strerror or error})"
        ) from None
    return table.num_rows, table.num_columns


def parquet_library() -> Any:
    """Pyarrow, with what reads CSV and writes Parquet.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import pyarrow as pa
        import pyarrow.compute
        import pyarrow.csv
        import pyarrow.parquet
    except ImportError:
        raise MissingPartError.of_library("Parquet", "pyarrow", "design") from None
    return pa


def _read(arrow: Any, recording: Path, report: Callable[[str], None]) -> Any:
    """The recording's table, typed."""
    numbers = [
        "timestamp_s",
        "total_N",
        "force_N",
        "x_mm",
        "y_mm",
        "z_mm",
        "size_mm",
        "since_s",
        "sd_N",
        *(
            f"{name}_{part}{axis}_N"
            for name in ("shear", "net_force")
            for part in ("", "sd_")
            for axis in "xyz"
        ),
        *(f"net_moment_{part}{axis}_Nmm" for part in ("", "sd_") for axis in "xyz"),
        *(form.format(axis) for form in ("normal_{}", "moment_about_{}_mm") for axis in "xyz"),
    ]
    types = dict.fromkeys(numbers, arrow.float64()) | {"valid": arrow.bool_()}
    # Empty where a frame has no contact.
    types |= dict.fromkeys(("sequence", "contacts", "contact", "id"), arrow.int64())
    types |= dict.fromkeys(("markers", "region", "warnings"), arrow.string())
    try:
        data = recording.read_bytes()
        rows = data[: data.rfind(b"\n") + 1]
        if len(rows) < len(data):
            report(f"{recording}: the last row does not end; it is left out")
        names = rows.partition(b"\n")[0].decode().rstrip("\r").split(",")
        types |= {name: arrow.float64() for name in names if name.startswith("region_")}
        table = arrow.csv.read_csv(
            arrow.BufferReader(rows),
            convert_options=arrow.csv.ConvertOptions(
                column_types=types,
                true_values=["1"],
                false_values=["0"],
                strings_can_be_null=True,
                null_values=[""],
            ),
        )
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError("file-unreadable", f"no recording at {recording} ({reason})") from None
    except arrow.ArrowInvalid as error:
        raise InputError(
            "recording-invalid",
            f"{recording} is no recording: {str(error).splitlines()[0]}; give a file of "
            "`phytac serve --record` or --record-regions as it was written",
        ) from None
    if not {"sequence", "timestamp_s", "valid"} <= set(table.column_names):
        raise InputError(
            "recording-invalid",
            f"{recording} is no recording: no columns sequence, timestamp_s and valid; give a file "
            "of `phytac serve --record` or --record-regions",
        )
    if "markers" in table.column_names:
        place = table.column_names.index("markers")
        try:
            each = arrow.compute.split_pattern(table["markers"], " ")
            table = table.set_column(place, "markers", each.cast(arrow.list_(arrow.int32())))
        except arrow.ArrowInvalid as error:
            raise InputError(
                "recording-invalid", f"{recording} is no recording: markers: {cause_of(error)}"
            ) from None
    return table
