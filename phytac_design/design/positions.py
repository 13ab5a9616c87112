"""Positions of markers from a CSV file: the `explicit` layout."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import DesignError


def read_positions(path: Path) -> dict[str, Any]:
    """Read ``positions``, ``position_colours`` and ``position_heights_mm`` of a design's layout.

    The first line names the columns: ``u,v`` (chart coordinates) or ``x_mm,y_mm,z_mm``, then
    ``colour`` and ``height_mm`` if wanted. Blank lines and lines that begin with ``#`` are skipped.

    Raises
    ------
    DesignError
        If the file cannot be read or a line is not acceptable, with the line's number.
    """
    try:
        text = read_text(path, encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise DesignError(
            "positions-file-invalid", f"{path} is not a CSV file: it is not text; save it as UTF-8"
        ) from None
    except OSError as error:
        raise DesignError(
            "positions-file-unreadable",
            f"cannot read positions from {path}: {error.strerror}; layout.positions_csv is "
            "relative to the design file",
        ) from None
    try:
        lines = _lines(text)
    except csv.Error as error:
        raise DesignError(
            "positions-file-invalid", f"{path} is not a CSV file: {error}; save it as u,v lines"
        ) from None
    if not lines:
        raise DesignError(
            "positions-empty",
            f"{path} has no positions; write u,v or x_mm,y_mm,z_mm as its first line, then one "
            "position on each",
        )
    (first, names), rows = lines[0], lines[1:]
    place = ("u", "v") if {"u", "v"} <= set(names) else ("x_mm", "y_mm", "z_mm")
    known = {*place, "colour", "height_mm"}
    if not set(place) <= set(names) <= known or len(set(names)) != len(names):
        raise DesignError(
            "positions-columns",
            f"{path}, line {first}: columns must be u,v or x_mm,y_mm,z_mm, then colour and "
            f"height_mm if wanted (got {','.join(names)[:120]})",
        )
    rows_max = 50_000
    if not 1 <= len(rows) <= rows_max:
        raise DesignError(
            "positions-count",
            f"{path} has {len(rows)} positions; give 1 to {rows_max}, one on each line",
        )
    table = [_row(path, number, names, cells) for number, cells in rows]
    out: dict[str, Any] = {"positions": [[row[name] for name in place] for row in table]}
    for name, field in (("colour", "position_colours"), ("height_mm", "position_heights_mm")):
        if name in names:
            out[field] = [row[name] for row in table]
    return out


def _lines(text: str) -> list[tuple[int, list[str]]]:
    """Number and cells of each line that says something."""
    return [
        (number, [cell.strip() for cell in next(csv.reader([line], strict=True))])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]


def _row(path: Path, number: int, names: list[str], cells: list[str]) -> dict[str, Any]:
    """One line's cells by name, numbers as numbers."""
    if len(cells) != len(names):
        raise DesignError(
            "positions-row-length",
            f"{path}, line {number}: {len(names)} cells are needed ({','.join(names)}), got "
            f"{len(cells)}; correct the line",
        )
    row: dict[str, Any] = {}
    for name, cell in zip(names, cells, strict=True):
        if name == "colour":
            row[name] = cell
            continue
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value) or (name == "height_mm" and value <= 0.0):
            wanted = "a height above 0" if name == "height_mm" else "a number"
            raise DesignError(
                "positions-value-invalid",
                f"{path}, line {number}: {name} must be {wanted} (got {cell[:120]!r})",
            )
        row[name] = value
    return row
