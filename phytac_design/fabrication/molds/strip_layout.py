"""Places of strips in molds: shelves of strips, one label before each strip."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from phytac_design.fabrication.molds.plate_grid import (
    LEAST,
    PlacedStrip,
    PlateLayout,
    Run,
    SwitchKind,
)
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.fabrication.switch_strips import StripSet, SwitchStrip
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

KEY_LINES = 2
"""Lines of cells for keys, the first and the last. Short strips stand on the last line too,
between its keys."""


@dataclass(frozen=True, kw_only=True)
class Room:
    """Largest grid of cells that fits the printer's bed, for strips.

    Attributes
    ----------
    columns, lines : int
        Cells each way, those of keys and labels among them.
    pitch_mm : float
        Side of a cell.
    """

    columns: int
    lines: int
    pitch_mm: float

    @property
    def width_mm(self) -> float:
        """Room for one strip beside its label."""
        return (self.columns - 1) * self.pitch_mm

    @property
    def height_mm(self) -> float:
        """Room for strips above each other."""
        return (self.lines - KEY_LINES) * self.pitch_mm

    def holds(self, size_mm: FloatArray) -> bool:
        """Whether a strip of a width and height (2,) fits."""
        return bool(size_mm[0] <= self.width_mm and size_mm[1] <= self.height_mm)


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """A strip turned to lie in the least rectangle, long side along x.

    Attributes
    ----------
    places_mm : (m, 2) float
        Axes of its switches from the rectangle's low corner.
    size_mm : (2,) float
        Sides of the rectangle: half a cell around each axis.
    """

    places_mm: FloatArray
    size_mm: FloatArray


def footprint(strip: SwitchStrip, pitch_mm: float, scale: float = 1.0) -> Footprint:
    """Turn a strip, its rubber's shrinkage taken out by ``scale``."""
    angle = np.radians(np.arange(180.0))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    at = scale * np.einsum("mi,jik->kmj", strip.flat_mm, turn)
    width, height = np.ptp(at, axis=1).T + pitch_mm
    # Among equals (single switches) the first.
    best = int(np.where(width >= height - 1e-9, np.round(width * height, 6), np.inf).argmin())
    at = at[best] - at[best].min(axis=0) + 0.5 * pitch_mm
    return Footprint(places_mm=at, size_mm=at.max(axis=0) + 0.5 * pitch_mm)


def plan_strip_sets(
    strips: StripSet, switches: SwitchSet, room: Room, scale: float
) -> list[PlateLayout]:
    """Fewest sets for all strips, then the fewest castings.

    A set that is cast several times needs fewer cavities of strips that are alike.
    """
    pitch = room.pitch_mm
    need = {number: len(strips.alike(number)) for number in strips.numbers}
    prints = {n: footprint(strips.alike(n)[0], pitch, scale) for n in strips.numbers}
    # Tall strips first: shelves are as tall as their first strip.
    order = sorted(strips.numbers, key=lambda n: (-round(prints[n].size_mm[1], 3), n))
    tried = []
    for castings in range(1, max(need.values()) + 1):
        wanted = [n for n in order for _ in range(-(-need[n] // castings))]
        sets = _fill(wanted, {n: prints[n].size_mm for n in wanted}, room)
        tried.append((len(sets), castings, sets))
    count, castings, sets = min(tried, key=lambda each: each[:2])
    return [
        _layout(own, strips, switches, prints, pitch, (k + 1, count), castings)
        for k, own in enumerate(sets)
    ]


@dataclass(kw_only=True)
class _Set:
    """Strips as (number, x, y) of their low corners, and shelves as [y, height, used width]."""

    spots: list[tuple[int, float, float]] = field(default_factory=list)
    shelves: list[list[float]] = field(default_factory=list)


def _fill(wanted: Sequence[int], size_mm: Mapping[int, FloatArray], room: Room) -> list[_Set]:
    """First set and shelf with room for each strip.

    Raises
    ------
    NumericalError
        If there is none.
    """
    sets: list[_Set] = []
    for number in wanted:
        width, height = size_mm[number]
        for own in (*sets, _Set()):
            spot = _spot(own.shelves, width + room.pitch_mm, height, room)
            if spot is not None:
                if not own.spots:
                    sets.append(own)
                own.spots.append((number, *spot))
                break
        else:
            raise NumericalError(
                "strip-exceeds-mold",
                f"a strip of {width:.1f} x {height:.1f} mm found no place in a mold with room for "
                f"{room.width_mm:.1f} x {room.height_mm:.1f} mm; please report this design",
            )
    return sets


def _spot(
    shelves: list[list[float]], width: float, height: float, room: Room
) -> tuple[float, float] | None:
    """Low corner on the first shelf with room, or on a new one; None if there is none."""
    pitch, small = room.pitch_mm, 1e-9
    top, side = (room.lines - 1) * pitch, room.columns * pitch
    # Cells between the keys on the last line.
    start, end = pitch, side - 2.0 * pitch
    for shelf in shelves:
        free = (end if shelf[0] + shelf[1] > top + small else side) - shelf[2]
        if height <= shelf[1] + small and width <= free + small:
            spot = shelf[2], shelf[0]
            shelf[2] += width
            return spot
    y = shelves[-1][0] + shelves[-1][1] if shelves else pitch
    if y + height <= top + small:
        x = 0.0
    elif y + height <= top + pitch + small and start + width <= end + small:
        x = start
    else:
        return None
    shelves.append([y, height, x + width])
    return x, y


def _layout(
    own: _Set,
    strips: StripSet,
    switches: SwitchSet,
    prints: Mapping[int, Footprint],
    pitch: float,
    which: tuple[int, int],
    castings: int,
) -> PlateLayout:
    """Grid just large enough for the strips of a set."""
    y, height, used = own.shelves[-1]
    between = min(x for _, x, low in own.spots if low == y) > 0.0
    # On the last line keys stand on both sides.
    wide = max(used + 2.0 * pitch * between, *(shelf[2] for shelf in own.shelves))
    cells_wide, cells_tall = (int(np.ceil(side / pitch - 1e-9)) for side in (wide, y + height))
    placed: list[PlacedStrip] = []
    places: dict[SwitchKind, list[tuple[float, float]]] = {}
    for number, x, y in own.spots:
        strip, outline = strips.alike(number)[0], prints[number]
        # Cells count from the middle of the first.
        cells = (outline.places_mm + np.array([x + pitch, y])) / pitch - 0.5
        at = [(float(column), float(line)) for column, line in cells]
        placed.append(
            PlacedStrip(
                number=number,
                cells=tuple(at),
                bridges=tuple((int(a), int(b)) for a, b in strip.bridges),
                label_cell=(x / pitch, (y + 0.5 * outline.size_mm[1]) / pitch - 0.5),
            )
        )
        for marker, cell in zip(strip.markers, at, strict=True):
            places.setdefault(switches.kind_of(marker), []).append(cell)
    return PlateLayout(
        columns=max(LEAST, cells_wide),
        lines=max(LEAST, cells_tall if between else 1 + cells_tall),
        runs=tuple(
            Run(kind=kind, line=0, start=0, count=len(cells), places=tuple(cells))
            for kind, cells in sorted(places.items())
        ),
        number=which[0],
        total=which[1],
        strips=tuple(placed),
        castings=castings,
    )
