"""Named regions of a surface (fingers, a palm) and the force on each."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.bounded_reader import read_text, toml_table
from phytac_shapes.errors import InputError, cause_of

REGIONS_MAX, NAME_MAX = 64, 40
"""Largest number of regions, and of letters in a region's name."""
SELECTORS = ("markers", "rows", "columns", "along", "around", "point_mm")


@dataclass(frozen=True, kw_only=True)
class Region:
    """A named set of markers.

    Attributes
    ----------
    name : str
        Of the region.
    markers : tuple of int
        In ascending order; regions may share markers.
    """

    name: str
    markers: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class MarkerChart:
    """Positions of markers on the design's chart; arrays over n markers.

    Attributes
    ----------
    row, column : (n,) int
        Position in the lattice.
    along, around : (n,) float
        Shares, 0 to 1, of u (away from the camera) and of v (around).
    closed : bool
        Whether the surface closes around, so that a box may run over the seam.
    """

    row: IntArray
    column: IntArray
    along: FloatArray
    around: FloatArray
    closed: bool


@dataclass(frozen=True, kw_only=True)
class RegionForces:
    """Sums forces over regions.

    Attributes
    ----------
    regions : sequence of Region
        In the order of every table.
    markers : int
        Of the sensor.
    """

    regions: Sequence[Region]
    markers: int

    @cached_property
    def member(self) -> BoolArray:
        """Which markers (r, n) lie in which region."""
        out = np.zeros((len(self.regions), self.markers), dtype=np.bool_)
        for row, region in enumerate(self.regions):
            out[row, list(region.markers)] = True
        return out

    def of(self, markers: IntArray, forces_N: FloatArray) -> list[float]:
        """Force of each region (r,), N, from those of some markers."""
        out: list[float] = (self.member[:, markers] @ forces_N).tolist()
        return out

    def home(self, markers: Sequence[int], forces_N: Sequence[float]) -> str:
        """Region with most of a contact's force, the first of several; "" if it is in none."""
        inside = self.member[:, list(markers)]
        if not inside.any():
            return ""
        # By number of markers if all forces are zero.
        share = inside @ np.maximum(forces_N, 0.0) + 1e-9 * inside.sum(axis=1)
        return self.regions[int(share.argmax())].name


def load_regions(
    path: Path, position_mm: FloatArray, chart: MarkerChart | None = None
) -> tuple[Region, ...]:
    """Regions of a TOML or JSON file, as marker ids.

    ``regions`` is a list of tables. Each has a ``name`` and conditions, all of which its markers
    must meet: ``markers`` (ids), ``rows`` and ``columns`` (first and last), ``along`` and
    ``around`` (shares of the chart, from and to), ``point_mm`` with ``radius_mm`` (a ball). Tables
    of one name make one region together.

    Parameters
    ----------
    path : Path
        JSON if its suffix is ``.json``, otherwise TOML.
    position_mm : (n, 3) float
        Markers on the outer face.
    chart : Chart, optional
        Needed for rows, columns and shares.

    Raises
    ------
    InputError
        If the file cannot be read, or a region is no region of this sensor.
    """
    data = _read(path)
    unknown = sorted(set(data) - {"regions"})
    tables = data.get("regions")
    if unknown or not isinstance(tables, list) or not tables:
        got = f"unknown key {_short(unknown[0])}" if unknown else "no list of regions"
        raise InputError(
            "regions-file-invalid", f"{path}: {got}; write one or more [[regions]] and nothing else"
        )
    return resolve_regions(tables, f"{path}: ", position_mm, chart)


def resolve_regions(
    tables: Sequence[Any], where: str, position_mm: FloatArray, chart: MarkerChart | None = None
) -> tuple[Region, ...]:
    """Regions of tables, as marker ids; see :func:`load_regions`.

    Parameters
    ----------
    tables : sequence of dict
        One for each part of a region.
    where : str
        Prefix of ``regions[0]`` in messages.
    position_mm, chart
        See :func:`load_regions`.

    Raises
    ------
    InputError
        If one is no region of this sensor.
    """
    found: dict[str, set[int]] = {}
    for number, table in enumerate(tables):
        label = f"{where}regions[{number}]"
        name = _name(table, label)
        found.setdefault(name, set()).update(_selected(table, label, position_mm, chart).tolist())
    if len(found) > REGIONS_MAX:
        raise InputError("regions-too-many", f"{where}{len(found)} regions; {REGIONS_MAX} at most")
    return tuple(Region(name=name, markers=tuple(sorted(ids))) for name, ids in found.items())


def regions_to_table(regions: Sequence[Region]) -> list[dict[str, Any]]:
    """Regions as plain values, for a bundle."""
    return [{"name": region.name, "markers": list(region.markers)} for region in regions]


def regions_from_table(table: object, count: int) -> tuple[Region, ...]:
    """Undo :func:`regions_to_table`, for a sensor of so many markers.

    Raises
    ------
    ValueError
        If it is no list of regions of this sensor.
    """
    if not isinstance(table, list) or not all(
        isinstance(item, dict) and set(item) == {"name", "markers"} for item in table
    ):
        raise ValueError(f"regions are a list of names with markers (got {_short(table)})")
    try:
        return resolve_regions(table, "", np.zeros((count, 3)))
    except InputError as error:
        raise ValueError(str(error)) from None


def _read(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            "file-unreadable", f"no regions at {path} ({reason}); give a TOML or JSON file"
        ) from None
    try:
        data = json.loads(text) if path.suffix.lower() == ".json" else toml_table(text)
    except (ValueError, RecursionError) as error:
        kind = "JSON" if path.suffix.lower() == ".json" else "TOML"
        raise InputError("file-syntax", f"{path} is no {kind}: {cause_of(error)}") from None
    if not isinstance(data, dict):
        raise InputError(
            "regions-file-invalid", f"{path}: no table of regions; see docs/streaming.md"
        )
    return data


def _name(table: object, where: str) -> str:
    if not isinstance(table, dict):
        raise InputError("region-not-table", f"{where}: a region is a table (got {_short(table)})")
    keys = ("name", *SELECTORS, "radius_mm")
    unknown = sorted(set(table) - set(keys))
    if unknown:
        raise InputError(
            "region-unknown-key",
            f"{where}: unknown key {_short(unknown[0])}; known: {', '.join(keys)}",
        )
    name = table.get("name")
    if not isinstance(name, str) or not 1 <= len(name) <= NAME_MAX or not name.isprintable():
        raise InputError(
            "region-name-invalid",
            f"{where}: name must be 1 to {NAME_MAX} printable letters (got {_short(name)})",
        )
    if name != name.strip():
        raise InputError(
            "region-name-invalid",
            f"{where}: name {name!r} begins or ends with a space; take it away",
        )
    return name


def _selected(
    table: Mapping[str, Any], where: str, position_mm: FloatArray, chart: MarkerChart | None
) -> IntArray:
    """Markers (m,) that meet all conditions of a table."""
    given = [key for key in SELECTORS if key in table]
    if not given:
        raise InputError(
            "region-without-condition",
            f"{where}: no condition; give one or more of {', '.join(SELECTORS)}",
        )
    if ("point_mm" in table) != ("radius_mm" in table):
        raise InputError("region-point-incomplete", f"{where}: point_mm and radius_mm go together")
    count = len(position_mm)
    inside = np.ones(count, dtype=np.bool_)
    for key in given:
        label, value = f"{where}.{key}", table[key]
        if key == "markers":
            inside &= np.isin(np.arange(count), _ids(value, label, count))
        elif key == "point_mm":
            (radius,) = _numbers([table["radius_mm"]], f"{where}.radius_mm", 1)
            if not radius > 0.0:
                raise InputError(
                    "region-radius-not-positive",
                    f"{label}: radius_mm must be above 0 (got {radius:g})",
                )
            away = np.linalg.norm(position_mm - _numbers(value, label, 3), axis=1)
            inside &= away <= radius
        elif chart is None:
            raise InputError(
                "region-needs-design",
                f"{label}: rows, columns and shares are known from the design alone; give the "
                "design as well, or use markers or point_mm",
            )
        elif key in {"rows", "columns"}:
            inside &= _in_range(value, label, chart.row if key == "rows" else chart.column)
        else:
            inside &= _in_share(value, label, chart, key)
    if not inside.any():
        raise InputError(
            "region-empty", f"{where} ({table['name']!r}): no marker lies there; widen it"
        )
    return np.flatnonzero(inside)


def _ids(value: object, label: str, count: int) -> list[int]:
    ids: list[Any] = value if isinstance(value, list) else []
    good = all(isinstance(i, int) and not isinstance(i, bool) and 0 <= i < count for i in ids)
    if not good or not ids:
        raise InputError(
            "region-markers-invalid",
            f"{label}: a list of markers, 0 to {count - 1} (got {_short(value)})",
        )
    return ids


def _numbers(value: object, label: str, count: int) -> list[float]:
    items = value if isinstance(value, list) else []
    good = [
        isinstance(item, int | float) and not isinstance(item, bool) and abs(item) < 1e9
        for item in items
    ]
    if len(items) != count or not all(good):
        word = "a number" if count == 1 else f"{count} numbers in a list"
        raise InputError("region-number-invalid", f"{label}: {word} (got {_short(value)})")
    return [float(item) for item in items]


def _in_range(value: object, label: str, of: IntArray) -> BoolArray:
    """Markers (n,) whose row or column lies between the first and last given."""
    first, last = _numbers(value, label, 2)
    if first > last or first < 0 or first != int(first) or last != int(last):
        raise InputError(
            "region-range-invalid", f"{label}: first and last, counted from 0 (got {_short(value)})"
        )
    return np.asarray((of >= first) & (of <= last))


def _in_share(value: object, label: str, chart: MarkerChart, key: str) -> BoolArray:
    """Markers (n,) between two shares of the chart; around a closed one also over the seam."""
    of, closed = (chart.along, False) if key == "along" else (chart.around, chart.closed)
    low, high = _numbers(value, label, 2)
    if not (0.0 <= low <= 1.0 and 0.0 <= high <= 1.0) or (low > high and not closed):
        wrap = " (from above to, over the seam, where the surface closes around)" if closed else ""
        raise InputError(
            "region-share-invalid",
            f"{label}: shares from and to, 0 to 1{wrap} (got {_short(value)})",
        )
    if low <= high:
        return np.asarray((of >= low) & (of <= high))
    return np.asarray((of >= low) | (of <= high))


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
