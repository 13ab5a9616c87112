"""The paint map: every receptor at 1:1 on the unrolled surface, on as many sheets as it takes."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.sheet_drawing import (
    Disc,
    DrawnLine,
    Item,
    Layer,
    Page,
    Text,
)
from phytac_design.fabrication.documents.unroll import UnrolledSurface, unroll
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import DISPLAY_COLOURS
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

MARGIN_mm = 8.0
"""Edge that printers leave white."""
HEAD_mm, FOOT_mm = 17.0, 13.0
OVERLAP_mm = 10.0
"""Strip that neighbouring sheets share."""
BAR_mm, TICK_mm = 100, 10
TEXT_mm = (0.9, 1.7)
INKS = {name: "#{:02x}{:02x}{:02x}".format(*rgba[:3]) for name, rgba in DISPLAY_COLOURS.items()} | {
    "yellow": "#d8b400",
    "magenta": "#c2189b",
    "cyan": "#0fa3b1",
}


@dataclass(frozen=True, kw_only=True)
class PaintMap:
    """A map ready to be put on paper.

    Attributes
    ----------
    unrolled : Unrolled
        How the surface was laid flat.
    place_mm : (n, 2) float
        Centre of each marker on the map: around to the right, along *upwards*.
    stretch : (n, 2) float
        Least and greatest stretch of the paper there.
    number, switch : tuple of str
        What each marker and its switch are called.
    paint : tuple of str
        Paint of each marker.
    text_mm : float
        Height of these names.
    """

    design: Design
    unrolled: UnrolledSurface
    place_mm: FloatArray
    ghosts: tuple[tuple[int, FloatArray], ...]
    stretch: FloatArray
    number: tuple[str, ...]
    switch: tuple[str, ...]
    paint: tuple[str, ...]
    text_mm: float

    @property
    def box_mm(self) -> FloatArray:
        """Corners [[x0, y0], [x1, y1]] of the map with its border, y upwards."""
        border_mm = 4.0  # border around the map for markers that overlap its edges
        points = np.concatenate([*self.unrolled.outline, self.place_mm])
        return np.stack([points.min(axis=0) - border_mm, points.max(axis=0) + border_mm])


def marker_numbers(markers: Markers) -> tuple[str, ...]:
    """``row.column`` of each marker, or its number where there are no rows."""
    if not markers.in_rows:
        return tuple(map(str, range(markers.count)))
    return tuple(f"{r}.{c}" for r, c in zip(markers.row, markers.column, strict=True))


def switch_labels(switches: SwitchSet) -> tuple[str, ...]:
    """Label of each marker's switch."""
    kinds = zip(switches.bowl.tolist(), switches.length.tolist(), strict=True)
    names = {kind: switches.label(kind) for kind in switches.kinds}
    return tuple(names[kind] for kind in kinds)


def make_map(sensor: Sensor, switches: SwitchSet) -> PaintMap:
    """Lay out the paint map of a design."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    text_share = 0.2  # height of a marker's number over the distance to its nearest neighbour
    unrolled = unroll(surface)
    place = unrolled.at(markers.uv)
    outer = surface.point(markers.uv)
    gap = np.linalg.norm(outer[:, None] - outer[None], axis=2)
    np.fill_diagonal(gap, np.inf)
    nearest = float(gap.min()) if markers.count > 1 else 10.0
    names = design.layout.colours
    return PaintMap(
        design=design,
        unrolled=unrolled,
        place_mm=place,
        ghosts=_ghosts(unrolled, surface, markers, design.receptor.diameter_outer_mm / 2.0),
        stretch=unrolled.stretch_at(markers.uv),
        number=marker_numbers(markers),
        switch=switch_labels(switches),
        paint=tuple(names[k] for k in markers.colour),
        text_mm=float(np.clip(text_share * nearest, *TEXT_mm)),
    )


def _ghosts(
    unrolled: UnrolledSurface, surface: Surface, markers: Markers, radius_mm: float
) -> tuple[tuple[int, FloatArray], ...]:
    """Markers cut by the seam, once more beside the seam's other edge."""
    if not surface.periodic[1]:
        return ()
    v0, v1 = surface.domain[1]
    width = (v1 - v0) / unrolled.pieces
    piece = unrolled.piece(markers.uv)
    out = []
    for step in (-1, 1):
        edge = v0 + width * (piece + (step > 0))
        beside = np.column_stack([markers.uv[:, 0], edge])
        cut = np.linalg.norm(unrolled.flat(beside, piece) - unrolled.at(markers.uv), axis=1)
        close = np.flatnonzero(cut < radius_mm)
        # From the piece beyond the seam: its own number, and one turn on where pieces run out.
        beyond = piece[close] + step
        turn = np.floor_divide(beyond, unrolled.pieces)
        at = markers.uv[close] - np.column_stack([0.0 * turn, turn * (v1 - v0)])
        place = unrolled.flat(at, beyond % unrolled.pieces)
        out += list(zip(close.tolist(), place, strict=True))
    return tuple(out)


def map_items(drawn: PaintMap, *, inside: bool = False) -> list[Item]:
    """Items of the map at 1:1, its box's top left corner at (0, 0), y downwards.

    ``inside`` mirrors it: as the receptors stand before the one who paints them.
    """
    ghost = "#9a9a9a"
    low, high = drawn.box_mm

    def put(points: FloatArray) -> FloatArray:
        x, y = np.moveaxis(np.asarray(points), -1, 0)
        return np.stack([high[0] - x if inside else x - low[0], high[1] - y], axis=-1)

    out: list[Item] = [
        DrawnLine(points=put(edge), closed=True, stroke="#000000", width_mm=0.18)
        for edge in drawn.unrolled.outline
    ]
    out += [
        DrawnLine(points=put(edge), stroke="#e07000", width_mm=0.35, dash_mm=2.0)
        for edge in drawn.unrolled.seams
    ]
    radius = drawn.design.receptor.diameter_outer_mm / 2.0
    for marker, at in drawn.ghosts:
        out.append(Disc(centre=put(at), radius_mm=radius, stroke=ghost, dash_mm=0.5))
        out += _names(drawn, marker, put(at), ghost)
    hole = drawn.design.receptor.diameter_hole_mm / 2.0
    tip = drawn.design.switch.tip_diameter_mm / 2.0
    for marker, at in enumerate(put(drawn.place_mm)):
        out.append(Disc(centre=at, radius_mm=radius, fill=INKS[drawn.paint[marker]]))
        out.append(Disc(centre=at, radius_mm=hole, fill="#ffffff"))
        out.append(Disc(centre=at, radius_mm=tip, fill=INKS["red"]))
        out += _names(drawn, marker, at, "#000000")
    return out


def _names(drawn: PaintMap, marker: int, at: FloatArray, colour: str) -> list[Item]:
    """Marker's number above it and its switch's label below."""
    radius, size = drawn.design.receptor.diameter_outer_mm / 2.0, drawn.text_mm
    above, below = np.array([0.0, -radius - 0.15 * size]), np.array([0.0, radius + 0.9 * size])
    words = ((drawn.number[marker], above), (drawn.switch[marker], below))
    return [
        Text(at=at + away, text=word, size_mm=size, anchor="middle", colour=colour)
        for word, away in words
    ]


def whole_page(drawn: PaintMap, *, inside: bool = False) -> Page:
    """Whole map on one sheet of its own size, for the SVG."""
    size = np.ptp(drawn.box_mm, axis=0)
    width = max(float(size[0]), BAR_mm + 20.0) + 2.0 * MARGIN_mm
    height = float(size[1]) + HEAD_mm + FOOT_mm + 2.0 * MARGIN_mm
    at = np.array([MARGIN_mm, MARGIN_mm + HEAD_mm])
    items = [item.moved(at) for item in map_items(drawn, inside=inside)]
    return Page(
        width_mm=width,
        height_mm=height,
        layers=[Layer(items=items), Layer(items=_frame(drawn, width, height, inside, ""))],
    )


def paper_pages(drawn: PaintMap) -> list[Page]:
    """Sheets of paper of the map seen from outside, then of its mirror image."""
    return [page for inside in (False, True) for page in _split(drawn, inside=inside)]


def _split(drawn: PaintMap, *, inside: bool) -> list[Page]:
    # Width and height of upright paper, mm.
    sheets = {"A4": (210.0, 297.0), "letter": (215.9, 279.4)}
    size = np.ptp(drawn.box_mm, axis=0)
    upright = sheets[drawn.design.bench.sheet]
    ways = [_tiling(size, paper) for paper in (upright, upright[::-1])]
    paper, room, count = min(ways, key=lambda way: way[2][0] * way[2][1])
    items = map_items(drawn, inside=inside)
    corner = np.array([MARGIN_mm, MARGIN_mm + HEAD_mm])
    pages = []
    for row in range(count[1]):
        for column in range(count[0]):
            start = np.array([column, row]) * (room - OVERLAP_mm)
            end = np.minimum(start + room, size)
            shift = corner - start
            many = count[0] * count[1] > 1
            name = f"sheet {chr(ord('A') + row)}{column + 1} of {count[1]} × {count[0]}"
            marks = _joins(start, end, (column, row), count) if many else []
            layers = [
                Layer(
                    items=[item.moved(shift) for item in [*items, *marks]],
                    window=np.stack([corner, corner + end - start]),
                ),
                Layer(items=_frame(drawn, *paper, inside, name if many else "")),
            ]
            pages.append(Page(width_mm=paper[0], height_mm=paper[1], layers=layers))
    return pages


def _tiling(
    size: FloatArray, paper: tuple[float, float]
) -> tuple[tuple[float, float], FloatArray, tuple[int, int]]:
    """Paper, room for the map on it, and sheets across and down."""
    room = np.array(paper) - 2.0 * MARGIN_mm - [0.0, HEAD_mm + FOOT_mm]
    count = [
        1 if length <= space else ceil((length - OVERLAP_mm) / (space - OVERLAP_mm))
        for length, space in zip(size.tolist(), room.tolist(), strict=True)
    ]
    return paper, room, (count[0], count[1])


def _joins(
    start: FloatArray, end: FloatArray, at: tuple[int, int], count: tuple[int, int]
) -> list[Item]:
    """Lines along the strips that a sheet shares with its neighbours, and crosses on them."""
    out: list[Item] = []
    places: list[list[float]] = [[], []]
    for axis in (0, 1):
        if at[axis] > 0:
            places[axis].append(float(start[axis] + OVERLAP_mm / 2.0))
        if at[axis] < count[axis] - 1:
            places[axis].append(float(end[axis] - OVERLAP_mm / 2.0))
        for place in places[axis]:
            line = np.stack([start, end])
            line[:, axis] = place
            out.append(DrawnLine(points=line, stroke="#555555", width_mm=0.15, dash_mm=1.0))
    middle = (start + end) / 2.0
    xs, ys = places[0] or [float(middle[0])], places[1] or [float(middle[1])]
    for x in xs:
        for y in ys:
            out += _cross(np.array([x, y]))
    return out


def _cross(at: FloatArray) -> list[Item]:
    return [
        DrawnLine(points=at + reach, stroke="#000000", width_mm=0.15)
        for reach in (np.array([[-3.0, 0.0], [3.0, 0.0]]), np.array([[0.0, -3.0], [0.0, 3.0]]))
    ]


def _frame(drawn: PaintMap, width: float, height: float, inside: bool, sheet: str) -> list[Item]:
    """Head with title, legend and notes; foot with the scale bars."""
    side_bar_mm = 50
    design = drawn.design
    side = "seen from inside (mirrored)" if inside else "seen from outside"
    title = f"{design.name}: paint map, {side}, 1:1"
    left, top = MARGIN_mm, MARGIN_mm
    out: list[Item] = [Text(at=np.array([left, top + 4.0]), text=title, size_mm=4.0)]
    if sheet:
        here = np.array([width - MARGIN_mm, top + 4.0])
        out.append(Text(at=here, text=sheet, size_mm=3.5, anchor="end"))
    for line, text in enumerate(map_notes(drawn)):
        out.append(Text(at=np.array([left, top + 8.0 + 3.2 * line]), text=text, size_mm=2.4))
    foot = height - MARGIN_mm
    out += scale_bar(np.array([left + 4.0, foot - 4.0]), BAR_mm)
    out += scale_bar(np.array([left, foot - 4.0]), side_bar_mm, upright=True)
    x = left + BAR_mm + 12.0
    for name in [*dict.fromkeys(design.layout.colours), "red"]:
        out.append(Disc(centre=np.array([x, foot - 6.0]), radius_mm=1.2, fill=INKS[name]))
        words = f"{name} tip" if name == "red" else name
        out.append(Text(at=np.array([x + 2.0, foot - 5.1]), text=words, size_mm=2.6))
        x += 5.0 + 1.6 * len(words)
    return out


def map_notes(drawn: PaintMap) -> Sequence[str]:
    """Lines of explanation under the title."""
    design, unrolled = drawn.design, drawn.unrolled
    number = "row.column" if any("." in name for name in drawn.number) else "marker number"
    least, most = unrolled.stretch
    scale = (
        "true to scale everywhere"
        if unrolled.kind == "exact"
        else f"local scale {least:.3f} to {most:.3f}"
    )
    bottom = "near rim (camera)" if unrolled.surface.periodic[1] else "start of u"
    return (
        (
            "Print at 100 % (no fitting); both bars must measure true. Above each marker: "
            f"{number}; below: its switch. At the bottom: {bottom}."
        ),
        (
            f"Paint end face and last {design.receptor.band_marker_mm:g} mm of each tube; the "
            "tips of the switches red. Orange dashes: seams; grey: seen again across a seam."
        ),
        f"Outer face {unrolled.note}; {scale}.",
    )


def scale_bar(start: FloatArray, length_mm: int, *, upright: bool = False) -> list[Item]:
    """Bar with a tick at every 10 mm, to the right or upwards."""
    along = np.array([0.0, -1.0]) if upright else np.array([1.0, 0.0])
    aside = np.array([1.0, 0.0]) if upright else np.array([0.0, -1.0])
    out: list[Item] = [DrawnLine(points=np.stack([start, start + length_mm * along]), width_mm=0.2)]
    for tick in range(0, length_mm + 1, TICK_mm):
        foot = start + tick * along
        out.append(DrawnLine(points=np.stack([foot, foot + 2.0 * aside]), width_mm=0.2))
    if not upright:
        at = start + np.array([float(length_mm), 3.6])
        out.append(Text(at=at, text=f"{length_mm} mm", size_mm=2.6, anchor="end"))
    return out
