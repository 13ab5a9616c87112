"""The log of a user's rig: contacts with position and force, as CSV (``docs/datasets.md``)."""

import csv
from collections.abc import Callable
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from phytac_design.mechanics.indenter import INDENTERS
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import InputError

PLACES = (("x_mm", "y_mm", "z_mm"), ("u", "v"), ("marker",), ("row", "column"))
"""Ways to state a position, each a set of columns."""
FORCES = (("force_N",), ("fx_N", "fy_N", "fz_N"))
MATCHES = ("frame", "timestamp_s")
KNOWN = (
    *MATCHES,
    *("sample", "sequence", "radius_mm", "length_mm", "turn_deg", "indenter"),
    *(name for ways in (PLACES, FORCES) for way in ways for name in way),
)
BENCH = {
    "contact_marker": "marker",
    "contact_u": "u",
    "contact_v": "v",
    "contact_x_mm": "x_mm",
    "contact_y_mm": "y_mm",
    "contact_z_mm": "z_mm",
    "patch_radius_mm": "radius_mm",
}
"""Columns of ``phytac calibrate`` and of the bench's log, and what they are called here."""
SPLIT = "fields are separated by commas, decimals by a point"


@dataclass(frozen=True, kw_only=True)
class RowProblems:
    """What is wrong with samples, collected for one error.

    Attributes
    ----------
    where : str
        The file.
    found : list of (int, str)
        Sample and sentence.
    """

    where: str
    found: list[tuple[int, str]] = field(default_factory=list)

    def add(self, sample: int, text: str) -> None:
        """Note one problem."""
        self.found.append((int(sample), text))

    def add_rows(
        self, bad: BoolArray, sample: IntArray, line: IntArray, text: Callable[[int], str]
    ) -> None:
        """Note ``text(row)`` for each bad row (r,), of its sample and line (r,)."""
        for row in np.flatnonzero(bad).tolist():
            self.add(sample[row], f"line {line[row]}: {text(row)}")

    @property
    def samples(self) -> IntArray:
        """Samples with problems, sorted."""
        return np.unique(np.array([sample for sample, _ in self.found], dtype=np.int64))

    def text(self) -> str:
        """All of it as one sentence, the first ten problems in full."""
        shown = 10
        lines = list(dict.fromkeys(text for _, text in self.found))
        more = f" and {len(lines) - shown} more" if len(lines) > shown else ""
        count = f"{len(lines)} problems in " if len(lines) > 1 else ""
        return (
            f"{count}{self.where} ({len(self.samples)} samples): {'; '.join(lines[:shown])}{more}"
        )

    def raise_all(self) -> None:
        """Raise them all.

        Raises
        ------
        InputError
            If there are any.
        """
        if self.found:
            raise InputError(
                "rig-rows-invalid",
                f"{self.text()}; correct them, or leave these samples out with --skip-bad",
            )


@dataclass(frozen=True, kw_only=True)
class RigLog:
    """A log; arrays run over its r rows, or over its s samples, in the order they first occur.

    Attributes
    ----------
    path : Path
        The file.
    line : (r,) int
        Line that each row stands on.
    sample : (r,) int
        Sample that each row belongs to.
    numbers : dict of (r,) float
        Columns of numbers by name; NaN where a problem was noted.
    indenter : (r,) int
        Index into ``INDENTERS``.
    frame : tuple of str
        Name or number of each sample's picture; empty where the log has no such column.
    time_s : (s,) float or None
        When each was taken, if the log says so.
    first_line : (s,) int
        Line on which each sample begins.
    remarks : tuple of str
        Comment lines before the names of the columns.
    problems : RowProblems
        What is wrong with single rows.
    """

    path: Path
    line: IntArray
    sample: IntArray
    numbers: dict[str, FloatArray]
    indenter: IntArray
    frame: tuple[str, ...]
    time_s: FloatArray | None
    first_line: IntArray
    remarks: tuple[str, ...]
    problems: RowProblems

    def note(self, bad: BoolArray, text: Callable[[int], str]) -> None:
        """Note ``text(row)`` as a problem of each bad row (r,)."""
        self.problems.add_rows(bad, self.sample, self.line, text)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.first_line)


def read_rig_log(path: Path, problems: RowProblems) -> RigLog:
    """Read a log; what is wrong with single rows goes to ``problems``.

    Raises
    ------
    InputError
        If the file cannot be read, or its columns say too little, too much or too strange.
    """
    names, rows, remarks = read_rows(path)
    names = _with_notes(names, rows)
    _check_names(path, names)
    columns = {name: [row[name] for _, row in rows] for name in names if name != "displacement_mm"}
    line = np.array([number for number, _ in rows], dtype=np.int64)
    frames = columns.get("frame")
    keys = columns.get("sample") or [str(number) for number in line]
    order = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    sample = np.array([order[key] for key in keys], dtype=np.int64)
    first = np.unique(sample, return_index=True)[1].astype(np.int64)
    _check_samples(columns, sample, first, line, problems)
    _check_twice(columns, sample, line, problems)
    numbers = _numbers(columns, sample, line, problems)
    times = numbers.pop("timestamp_s", None)
    return RigLog(
        path=path,
        line=line,
        sample=sample,
        numbers=numbers,
        indenter=_indenters(columns, sample, line, problems),
        frame=tuple(frames[row] for row in first) if frames else (),
        time_s=None if times is None else times[first],
        first_line=line[first],
        remarks=remarks,
        problems=problems,
    )


def read_rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]], tuple[str, ...]]:
    """Column names, (line, fields by name) of each row, and the comments at the top.

    The comment before a row becomes its field ``#``.

    Raises
    ------
    InputError
        If the file cannot be read, holds no rows, or some of another length.
    """
    bytes_max = 1 << 28  # a log of days; a larger one is something else
    try:
        lines = read_text(path, encoding="utf-8-sig", bytes_max=bytes_max).splitlines()
    except UnicodeDecodeError:
        raise InputError("file-not-csv", f"{path} is not a CSV file: it is not even text") from None
    except OSError as error:
        raise InputError("file-unreadable", f"no log at {path} ({error.strerror})") from None
    names: list[str] = []
    rows: list[tuple[int, dict[str, str]]] = []
    remarks: list[str] = []
    note = ""
    for number, text in enumerate(lines, start=1):
        if text.lstrip().startswith("#"):
            note = text
            if not names:
                remarks.append(text.strip("# \t"))
        elif text.strip():
            cells = [cell.strip() for cell in next(csv.reader([text]))]
            if not names:
                names = [BENCH.get(cell, cell) for cell in cells]
                continue
            if len(cells) != len(names):
                raise InputError(
                    "csv-row-length",
                    f"{path} line {number}: {len(cells)} fields for {len(names)} columns; {SPLIT}",
                )
            rows.append((number, dict(zip(names, cells, strict=True)) | {"#": note}))
    if not rows:
        raise InputError(
            "csv-empty", f"{path} holds no contacts: a line of column names and rows are due"
        )
    return names, rows, tuple(remarks)


def _with_notes(names: list[str], rows: list[tuple[int, dict[str, str]]]) -> list[str]:
    """Take frame, time and sample from the bench's comment lines, where a log has them."""
    from phytac_design.fabrication.calibration_rig.log_template import NOTE

    found = [NOTE.match(row["#"].strip()) for _, row in rows]
    if set(MATCHES) & set(names) or not all(found):
        return names
    for (_, row), note in zip(rows, found, strict=True):
        if note is not None:
            step, row["frame"], row["timestamp_s"] = note.groups()
            row["sample"] = f"{step}, {row['frame']}"
    return [*names, "frame", "timestamp_s", "sample"]


def _check_names(path: Path, names: list[str]) -> None:
    if len(names) == 1 and (";" in names[0] or "\t" in names[0]):
        raise InputError("csv-separator", f"{path}: the columns' names stand in one field; {SPLIT}")
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                "csv-column-duplicate", f"{path}: column {name!r} stands there twice; keep one"
            )
        if name in KNOWN or name == "displacement_mm":
            continue
        stem = name.rpartition("_")[0]
        alike = [known for known in KNOWN if known.lower() == name.lower()]
        same = [known for known in KNOWN if stem and known.rpartition("_")[0] == stem]
        same = [] if alike else same
        near = alike or same or get_close_matches(name, KNOWN, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(KNOWN)}"
        if same:
            hint = f"units are those of {same[0]!r}: convert its numbers and call it so"
        raise InputError("csv-column-unknown", f"{path}: unknown column {name!r}; {hint}")
    for what, ways in (("position", PLACES), ("force", FORCES)):
        begun = [way for way in ways if set(way) & set(names)]
        if len(begun) != 1 or not set(begun[0]) <= set(names):
            sets = " or ".join(",".join(way) for way in ways)
            raise InputError(
                "csv-columns-ambiguous",
                f"{path}: a contact's {what} must be given by exactly one of {sets}",
            )
    if not set(MATCHES) & set(names):
        raise InputError(
            "rig-frame-column-missing",
            f"{path}: which picture belongs to which row is not said; add a column 'frame' (file "
            "name or number) or 'timestamp_s'",
        )


def _check_samples(
    columns: dict[str, list[str]],
    sample: IntArray,
    first: IntArray,
    line: IntArray,
    problems: RowProblems,
) -> None:
    """Contacts of one sample share its picture, and no other sample has it."""
    for name in (*MATCHES, "sequence"):
        cells = columns.get(name)
        if cells is None:
            continue
        for row, number in enumerate(sample):
            if cells[row] != cells[first[number]]:
                problems.add(
                    int(number),
                    f"line {line[row]}: {name} is {cells[row]!r}, but {cells[first[number]]!r} on "
                    f"line {line[first[number]]} of the same sample",
                )
        owner: dict[str, int] = {}
        for number, row in enumerate(first):
            earlier = owner.setdefault(cells[row], number)
            if earlier != number and name != "sequence":
                problems.add(
                    number,
                    f"line {line[row]}: {name} {cells[row]!r} is that of line "
                    f"{line[first[earlier]]}; contacts of one picture share a value in a column "
                    "'sample'",
                )


def _check_twice(
    columns: dict[str, list[str]], sample: IntArray, line: IntArray, problems: RowProblems
) -> None:
    """A contact that stands twice in a sample would count twice."""
    owner: dict[tuple[str, ...], int] = {}
    for row, cells in enumerate(zip(*columns.values(), strict=True)):
        # In a log without samples each row is one of its own.
        earlier = owner.setdefault((str(sample[row]), *cells), row)
        if earlier != row:
            problems.add(
                int(sample[row]),
                f"line {line[row]}: the same as line {line[earlier]}, in one sample; remove one",
            )


def _numbers(
    columns: dict[str, list[str]], sample: IntArray, line: IntArray, problems: RowProblems
) -> dict[str, FloatArray]:
    """Columns of numbers; a place may be left out where the force is zero."""
    whole = ("sequence", "row", "column", "marker")
    texts = ("frame", "sample", "indenter")
    out = {name: _floats(cells) for name, cells in columns.items() if name not in texts}
    force = next(way for way in FORCES if set(way) <= set(out))
    none = np.all([out[name] == 0.0 for name in force], axis=0)
    places = {name for way in PLACES for name in way}
    for name, values in out.items():
        bad = ~np.isfinite(values)
        if name in places:
            bad &= ~none
        if name in whole:
            bad |= np.isfinite(values) & (values != np.rint(values))
        kind = "whole number" if name in whole else "finite number"
        said = [f"{name} is not a {kind} (got {cell[:100]!r})" for cell in columns[name]]
        problems.add_rows(bad, sample, line, said.__getitem__)
        values[bad] = np.nan
    for name in sorted({"radius_mm", "length_mm"} & set(out)):
        said = [f"{name} is negative ({value:g})" for value in out[name]]
        problems.add_rows(out[name] < 0.0, sample, line, said.__getitem__)
    return out


def _floats(cells: list[str]) -> FloatArray:
    out = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        try:
            # Python's own grouping of digits is nobody's in a log.
            out[k] = np.nan if "_" in cell else float(cell)
        except ValueError:
            continue
    return out


def _indenters(
    columns: dict[str, list[str]], sample: IntArray, line: IntArray, problems: RowProblems
) -> IntArray:
    cells = columns.get("indenter", [INDENTERS[0]] * len(sample))
    known = np.array([cell in INDENTERS for cell in cells])
    said = f"indenter must be one of {', '.join(INDENTERS)}"
    problems.add_rows(~known, sample, line, lambda k: f"{said} (got {cells[k][:100]!r})")
    return np.array([INDENTERS.index(cell) if cell in INDENTERS else 0 for cell in cells])
