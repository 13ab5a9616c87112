"""Force-displacement measurements of a real shell, read from CSV (``docs/formats.md``)."""

import csv
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from phytac_design.layout import Markers
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import InputError

PLACES = {"marker": ("marker",), "chart": ("u", "v"), "point": ("x_mm", "y_mm", "z_mm")}
"""The three ways to state a position, each a set of columns behind ``contact_`` or ``probe_``."""
VALUES = ("patch_radius_mm", "force_N", "displacement_mm")
RADIUS_MIN_mm = 0.05
"""Patches of a smaller radius, but for points, are taken for a wrong unit."""


@dataclass(frozen=True, kw_only=True)
class Measurements:
    """One row per measured displacement.

    Attributes
    ----------
    contact_uv, probe_uv : (n, 2) float
        Chart positions of the centre of the pressed patch and of the place measured.
    radius_mm : (n,) float
        Radius of the patch.
    force_N : (n,) float
        Force, positive inward.
    displacement_mm : (n,) float
        Displacement along the inward normal at the probe, positive inward.
    """

    contact_uv: FloatArray
    probe_uv: FloatArray
    radius_mm: FloatArray
    force_N: FloatArray
    displacement_mm: FloatArray

    @property
    def press(self) -> IntArray:
        """Number of the press that each row belongs to: same place, patch and force, (n,)."""
        key = np.column_stack([self.contact_uv, self.radius_mm, self.force_N])
        return np.unique(key, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def read_measurements(
    path: Path, surface: Surface, markers: Markers, *, wall_mm: float
) -> Measurements:
    """Read and check a CSV file of measurements.

    Parameters
    ----------
    path : Path
        The file; lines that start with ``#`` are skipped.
    surface, markers : Surface, Markers
        The outer face and the receptors on it, which positions refer to.
    wall_mm : float
        Wall thickness: a measured point may lie anywhere in it.

    Raises
    ------
    InputError
        If the file cannot be read, or a column, a number or a position is not usable.
    """
    table = _columns(path)
    for name, low in (("patch_radius_mm", 0.0), ("force_N", np.nextafter(0.0, 1.0))):
        _refuse(path, table[name] < low, name, f"must be {'>= 0' if low == 0 else '> 0'}", table)
    radius = table["patch_radius_mm"]
    tiny = (radius > 0.0) & (radius < RADIUS_MIN_mm)
    what = f"must be 0 (a point) or at least {RADIUS_MIN_mm:g}; is it in mm?"
    _refuse(path, tiny, "patch_radius_mm", what, table)
    contact = _place(path, "contact", table, surface, markers, wall_mm)
    elsewhere = any(name.startswith("probe_") for name in table)
    probe = _place(path, "probe", table, surface, markers, wall_mm) if elsewhere else contact
    return Measurements(
        contact_uv=contact,
        probe_uv=probe,
        radius_mm=table["patch_radius_mm"],
        force_N=table["force_N"],
        displacement_mm=table["displacement_mm"],
    )


def _columns(path: Path) -> dict[str, FloatArray]:
    """Columns of numbers by name, and ``line``, the line of the file that each row stands on."""
    try:
        lines = read_text(path, encoding="utf-8-sig", bytes_max=1 << 26).splitlines()
    except UnicodeDecodeError:
        raise InputError(
            "file-not-csv", f"{path} is not a CSV file: it is not even text; save it as UTF-8"
        ) from None
    except OSError as error:
        raise InputError(
            "file-unreadable", f"no measurements at {path} ({error.strerror})"
        ) from None
    numbered = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    try:
        # Line by line: a quote that is not closed must not swallow the next ones.
        rows = [next(csv.reader([line], strict=True)) for _, line in numbered]
    except csv.Error as error:
        raise InputError(
            "file-not-csv",
            f"{path} is not a CSV file: {error}; save its numbers separated by commas",
        ) from None
    if len(rows) < 2:
        raise InputError(
            "csv-empty",
            f"{path} holds no measurements: {len(rows)} lines; give a line of column names, then "
            "one for each",
        )
    names = [name.strip() for name in rows[0]]
    _check_names(path, names)
    out: list[list[float]] = []
    for (number, _), row in zip(numbered[1:], rows[1:], strict=True):
        if len(row) != len(names):
            raise InputError(
                "csv-row-length",
                f"{path} line {number}: {len(row)} fields for {len(names)} columns; "
                "fields are separated by commas, decimals by a point",
            )
        out.append(
            [float(number), *(_number(path, number, *p) for p in zip(names, row, strict=True))]
        )
    table = np.array(out)
    first, times = np.unique(table[:, 1:], axis=0, return_index=True, return_counts=True)[1:]
    if (times > 1).any():
        again = np.flatnonzero((table[:, 1:] == table[first[times.argmax()], 1:]).all(axis=1))
        raise InputError(
            "csv-row-duplicate",
            f"{path} lines {table[again[0], 0]:.0f} and {table[again[1], 0]:.0f} are the same: "
            "rows that are counted twice make the result look surer than it is; remove one",
        )
    return dict(zip(["line", *names], table.T, strict=True))


def _check_names(path: Path, names: list[str]) -> None:
    places = [name for columns in PLACES.values() for name in columns]
    known = [*VALUES, *(f"{what}_{name}" for what in ("contact", "probe") for name in places)]
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
            raise InputError("csv-column-unknown", f"{path}: unknown column {name[:120]!r}; {hint}")
        if names.count(name) > 1:
            raise InputError(
                "csv-column-duplicate", f"{path}: column {name!r} stands there twice; keep one"
            )
    missing = [name for name in VALUES if name not in names]
    if missing:
        raise InputError(
            "csv-column-missing",
            f"{path}: column {missing[0]!r} is missing (needed: {', '.join(VALUES)})",
        )


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = np.nan if "_" in text else float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(
            "csv-value-invalid",
            f"{path} line {line}: {name} is not a finite number (got {text.strip()[:120]!r}); "
            "correct the value or remove the line",
        )
    return value


def _place(
    path: Path,
    what: str,
    table: dict[str, FloatArray],
    surface: Surface,
    markers: Markers,
    wall_mm: float,
) -> FloatArray:
    """Chart positions (n, 2) from whichever set of columns is there."""
    given = {kind for kind, cols in PLACES.items() if any(f"{what}_{c}" in table for c in cols)}
    if len(given) != 1 or not all(f"{what}_{c}" in table for c in PLACES[next(iter(given))]):
        sets = " or ".join(",".join(f"{what}_{c}" for c in cols) for cols in PLACES.values())
        raise InputError(
            "csv-columns-ambiguous",
            f"{path}: the {what}'s position must be given by exactly one of {sets}",
        )
    kind = given.pop()
    values = np.column_stack([table[f"{what}_{c}"] for c in PLACES[kind]])
    if kind == "marker":
        ids = values[:, 0]
        bad = (ids != np.rint(ids)) | (ids < 0) | (ids >= markers.count)
        _refuse(path, bad, f"{what}_marker", f"must be 0 … {markers.count - 1}", table)
        return np.asarray(markers.uv[ids.astype(np.int64)])
    uv = values if kind == "chart" else surface.chart(values)
    (u0, u1), _ = surface.domain
    bad = ~((uv[:, 0] >= u0) & (uv[:, 0] <= u1))
    if kind == "point":
        depth = np.sum((values - surface.point(uv)) * surface.normal(uv), axis=1)
        off_mm = 0.5  # a reading error, not another frame
        bad |= ~((depth <= off_mm) & (depth >= -wall_mm - off_mm))
    name = f"{what}_{PLACES[kind][0]}"
    _refuse(path, bad, name, f"puts the {what} off the shell (u from {u0:g} to {u1:g})", table)
    return np.asarray(uv, dtype=np.float64)


def _refuse(
    path: Path,
    bad: BoolArray,
    name: str,
    why: str,
    table: dict[str, FloatArray],
) -> None:
    if np.any(bad):
        lines = ", ".join(f"{line:.0f}" for line in table["line"][bad][:5])
        raise InputError(
            "csv-value-range",
            f"{path} line {lines}: {name} {why} (got {table[name][bad][0]:g}, "
            f"{int(bad.sum())} in all); correct the value or remove the line",
        )
