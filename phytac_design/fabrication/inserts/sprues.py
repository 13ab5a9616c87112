"""Which inserts are on which sprue, where on it, and how they are pushed in.

A sprue holds the inserts of one colour and one column or row, whichever takes less time. There are
three ways to push them in:

- ``together``: their bores are parallel, the bar is pushed towards the wall as it is;
- ``wrapped``: one after another, while the bar bends around the wall. The next insert must come out
  of the wall by its own length while the last one is home, which takes bars that are long between
  two inserts, or short inserts;
- ``single``: they are broken off one by one. They stand side by side, in their order.

Bars of the first two are developed: the wall's curve through the markers, at the bar's height over
it, keeps its length, and its sideways turn (on cones, domes) is kept in the plane.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.bill import csv_text
from phytac_design.fabrication.inserts.sprue_sizes import SprueSizes, sprue_sizes
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

Push = Literal["together", "wrapped", "single"]
Way = Literal["row", "column", ""]
"""Lines along which sprues hold inserts; "" where there are none."""

STRAIN_MAX = 0.03
"""Largest strain of a bar that is bent onto the wall: half of the 6 % at which cured standard resin
breaks (data sheets of makers of SLA resin)."""


@dataclass(frozen=True, kw_only=True)
class Sprue:
    """Inserts that are printed on one bar.

    Attributes
    ----------
    label : str
        Letter of the colour, column or row, and letter of the piece where there are several.
    colour : str
        Paint that the inserts have.
    markers : tuple of int
        Markers in their order on the bar, which begins at the label.
    place_mm : (k, 2) float
        Axes of the inserts in the plane of the bar, seen from the inserts' inner ends.
    length_mm : (k,) float
        Inserts, from the outer face to their end.
    strain : float
        Largest of the bar while it is pushed in; 0 for ``single``.
    way : str
        ``together``, ``wrapped`` or ``single``.
    """

    label: str
    colour: str
    markers: tuple[int, ...]
    place_mm: FloatArray
    length_mm: FloatArray
    strain: float
    way: Push

    def size_mm(self, sizes: SprueSizes, head_mm: float) -> FloatArray:
        """Corners [[x0, y0], [x1, y1]] of the sprue on the bed, the tab included."""
        reach = 0.5 * max(head_mm, sizes.width)
        low, high = self.place_mm.min(axis=0) - reach, self.place_mm.max(axis=0) + reach
        low[0] = min(low[0], self.place_mm[0, 0] - reach - sizes.letter * len(self.label))
        return np.stack([low, high])


def insert_lengths_mm(design: Design, markers: Markers) -> FloatArray:
    """Length (n,) of each insert, from the outer face to the end face, to a micrometre."""
    return np.round(design.wall.thickness_mm + markers.height_mm, 3)


def plan_sprues(sensor: Sensor) -> list[Sprue]:
    """Sprues of a design with inserts, by column or row and colour.

    Raises
    ------
    DesignError
        If not even a sprue with one insert fits the printer's bed.
    """
    markers = sensor.markers
    ways: list[Way] = ["row", "column"] if markers.lattice is not None else ["row"]
    if not markers.in_rows:
        ways = [""]
    plans = [_plan(sensor, way) for way in ways]
    return min(plans, key=_handling)


def _handling(sprues: Sequence[Sprue]) -> float:
    """Work to push a plan's inserts in, in inserts that need not be broken off first.

    The ratios are those of the default times of the table ``[effort]``, which is no part of the
    sensor: what is printed must not depend on it.
    """
    sprue, single = 5.0, 2.0
    return sum(
        sprue + len(one.markers) * (single if one.way == "single" else 1.0) for one in sprues
    )


def sprue_room_mm(design: Design) -> float:
    """Length of the bed for a sprue's label and the axes of its inserts.

    Raises
    ------
    DesignError
        If not even one insert with its label fits.
    """
    sizes = sprue_sizes(design.receptor, design.print_rules)
    bed = max(design.print_rules.bed_mm[:2])
    room = bed - design.receptor.diameter_head_mm
    if room <= 6.0 * sizes.letter:
        raise DesignError(
            "sprue-exceeds-bed",
            f"no sprue of inserts fits a bed of {bed:g} mm; raise print_rules.bed_mm, or set "
            'receptor.colouring = "paint"',
        )
    return room


def _plan(sensor: Sensor, way: Way) -> list[Sprue]:
    """Sprues along rows, along columns, or (``""``) of all markers of a colour in their order."""
    design, markers = sensor.design, sensor.markers
    sizes = sprue_sizes(design.receptor, design.print_rules)
    room = sprue_room_mm(design)
    lengths = insert_lengths_mm(design, markers)
    out: list[Sprue] = []
    for name, ids in _groups(design, markers, way):
        place, strain = developed(sensor.surface, markers.uv[ids], sizes, way)
        pieces = _cut(place, room, name, sizes)
        pushed = [
            _push(design, markers.direction[ids[a:b]], lengths[ids[a:b]], place[a:b], strain)
            for a, b in pieces
        ]
        if not way or any(push == "single" for push, _ in pushed):
            step = design.receptor.diameter_head_mm + design.print_rules.gap_min_mm
            place = np.column_stack([step * np.arange(len(ids)), np.zeros(len(ids))])
            pieces = _cut(place, room, name, sizes)
            pushed = [("single", 0.0)] * len(pieces)
        for number, ((start, end), (push, strain)) in enumerate(zip(pieces, pushed, strict=True)):
            own = ids[start:end]
            out.append(
                Sprue(
                    label=name + (_letters(number) if len(pieces) > 1 else ""),
                    colour=design.layout.colours[markers.colour[own[0]]],
                    markers=tuple(own.tolist()),
                    place_mm=_along_x(place[start:end]),
                    length_mm=lengths[own],
                    strain=strain,
                    way=push,
                )
            )
    return out


def _push(
    design: Design,
    axes: FloatArray,
    length_mm: FloatArray,
    place_mm: FloatArray,
    strain: float,
) -> tuple[Push, float]:
    """How the inserts of a bar are pushed in, and its largest strain meanwhile.

    Parameters
    ----------
    axes : (k, 3) float
        Directions of the bores.
    length_mm, place_mm : (k,) and (k, 2) float
        Inserts, and their places on the bar.
    strain : float
        Of the bar on the wall.
    """
    thickness = sprue_sizes(design.receptor, design.print_rules).thickness
    # A barrel may lean in its bore until it touches on both sides.
    lean = 2.0 * design.receptor.gap_insert_mm / float(length_mm.max())
    cosine = float(np.clip(axes @ axes.T, -1.0, 1.0).min())
    if strain <= STRAIN_MAX and np.arccos(cosine) <= lean:
        return "together", strain
    # A beam, clamped at the last insert, whose end is moved out without being turned: 3 t d / l².
    span = np.linalg.norm(np.diff(place_mm, axis=0), axis=1)
    lift = 3.0 * thickness * length_mm[1:] / span**2
    most = strain + float(lift.max(initial=0.0))
    return ("wrapped", most) if most <= STRAIN_MAX else ("single", 0.0)


def _cut(
    place_mm: FloatArray, room_mm: float, name: str, sizes: SprueSizes
) -> list[tuple[int, int]]:
    """Starts and ends of the pieces of a line; those of several have one more letter."""
    pieces = list(_pieces(place_mm, room_mm - sizes.letter * len(name)))
    if len(pieces) > 1:
        pieces = list(_pieces(place_mm, room_mm - sizes.letter * (len(name) + 1)))
    return pieces


def _groups(design: Design, markers: Markers, way: Way) -> Iterator[tuple[str, IntArray]]:
    """Name and markers of each line and colour; of each colour where there are no rows."""
    names = design.layout.colours
    colours = np.array([names.index(names[k]) for k in markers.colour])
    lines = {"row": markers.row, "column": markers.column, "": np.zeros_like(markers.row)}[way]
    for line in np.unique(lines).tolist():
        for colour in np.unique(colours[lines == line]).tolist():
            number = str(line) if way else ""
            own = np.flatnonzero((lines == line) & (colours == colour))
            yield names[colour][0].upper() + number, own


def _letters(number: int) -> str:
    """Letters that count: A to Z, then AA."""
    last = chr(ord("A") + number % 26)
    return last if number < 26 else _letters(number // 26 - 1) + last


def _pieces(place_mm: FloatArray, room_mm: float) -> Iterator[tuple[int, int]]:
    """Starts and ends of pieces of a row, as equal as may be, that are no longer than the room."""
    reach = np.ptp(place_mm, axis=0)
    count = max(1, int(np.ceil(np.hypot(*reach) / room_mm)))
    while count < len(place_mm):
        ends = np.linspace(0, len(place_mm), count + 1).round().astype(int)
        if all(np.hypot(*np.ptp(place_mm[a:b], axis=0)) <= room_mm for a, b in pairwise(ends)):
            break
        count += 1
    ends = np.linspace(0, len(place_mm), count + 1).round().astype(int).tolist()
    return pairwise(ends)


def _along_x(place_mm: FloatArray) -> FloatArray:
    """Places turned and moved so that the first is the origin and the last lies along +x."""
    arm = place_mm - place_mm[0]
    reach = float(np.hypot(*arm[-1]))
    if reach == 0.0:
        return np.asarray(arm)
    cosine, sine = arm[-1] / reach
    return np.asarray(arm @ np.array([[cosine, -sine], [sine, cosine]]))


def developed(
    surface: Surface, uv: FloatArray, sizes: SprueSizes, way: Way, steps: int = 16
) -> tuple[FloatArray, float]:
    """Places (k, 2) mm of a line's markers in the plane of its bar, and the bar's greatest strain.

    Parameters
    ----------
    uv : (k, 2) float
        Markers of one line in their order: along a row v grows, across a seam too; along a column
        it takes the shorter way around.
    steps : int
        Samples between two markers.

    Returns
    -------
    place_mm : (k, 2) float
        Places.
    strain : float
        Tensile strain that is equivalent (von Mises) to the bar's bending and twisting.
    """
    if len(uv) == 1:
        return np.zeros((1, 2)), 0.0
    v = uv[:, 1].copy()
    if surface.periodic[1]:
        low, high = surface.domain[1]
        back = 0.5 * (high - low) if way == "column" else 0.0
        v[1:] = v[0] + np.cumsum(np.mod(np.diff(v) + back, high - low) - back)
    at = np.arange(steps * (len(uv) - 1) + 1) / steps
    marker = np.arange(len(uv))
    along = np.column_stack([np.interp(at, marker, uv[:, 0]), np.interp(at, marker, v)])
    if surface.periodic[1]:
        along[:, 1] = low + np.mod(along[:, 1] - low, high - low)
    points, normals = surface.point(along, sizes.middle), surface.normal(along)
    chord = np.diff(points, axis=0)
    length = np.linalg.norm(chord, axis=1)
    unit = chord / length[:, None]
    # Turn of the line in the tangent plane, from one chord to the next, seen from inside: there
    # the inserts' ends are, which point up on the bed.
    turn = np.arctan2(
        np.einsum("ni,ni->n", -normals[1:-1], np.cross(unit[:-1], unit[1:])),
        np.einsum("ni,ni->n", unit[:-1], unit[1:]),
    )
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    plane = np.cumsum(length[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    place = np.concatenate([np.zeros((1, 2)), plane])[::steps]
    change = np.diff(normals, axis=0) / length[:, None]
    bend = np.einsum("ni,ni->n", change, unit)
    twist = np.linalg.norm(change - bend[:, None] * unit, axis=1)
    strain, shear = 0.5 * sizes.thickness * bend, sizes.thickness * twist
    return place, float(np.sqrt(strain**2 + shear**2 / 3.0).max())


def plates(
    sprues: Sequence[Sprue], design: Design
) -> dict[str, list[list[tuple[Sprue, FloatArray]]]]:
    """Beds full of sprues of one colour: by colour, beds with their sprues and places (2,) mm.

    Sprues lie one beside the other, shorter ones end to end, in their order.
    """
    sizes = sprue_sizes(design.receptor, design.print_rules)
    head, (wide, deep, _) = design.receptor.diameter_head_mm, design.print_rules.bed_mm
    wide, deep = max(wide, deep), min(wide, deep)
    out: dict[str, list[list[tuple[Sprue, FloatArray]]]] = {}
    for colour in dict.fromkeys(sprue.colour for sprue in sprues):
        beds: list[list[tuple[Sprue, FloatArray]]] = [[]]
        x = y = shelf = 0.0
        for sprue in (one for one in sprues if one.colour == colour):
            low, high = sprue.size_mm(sizes, head)
            size = high - low
            if x > 0.0 and x + size[0] > wide:
                x, y, shelf = 0.0, y + shelf + sizes.gap, 0.0
            if beds[-1] and y + size[1] > deep:
                beds.append([])
                x = y = shelf = 0.0
            beds[-1].append((sprue, np.array([x, y]) - low))
            x, shelf = x + size[0] + sizes.gap, max(shelf, float(size[1]))
        out[colour] = beds
    return out


def placement_csv(markers: Markers, sprues: Sequence[Sprue]) -> str:
    """CSV with a line for each insert, in the order of sprues and of inserts from the label on."""
    rows = []
    for sprue in sprues:
        for place, (marker, length) in enumerate(
            zip(sprue.markers, sprue.length_mm.tolist(), strict=True), start=1
        ):
            cell = [int(markers.row[marker]), int(markers.column[marker])]
            where = cell if markers.in_rows else ["", ""]
            rows.append(
                [sprue.label, sprue.colour, sprue.way, place, marker, *where, f"{length:.3f}"]
            )
    columns = "sprue colour way place marker row column length_mm"
    return csv_text(columns.split(), rows)
