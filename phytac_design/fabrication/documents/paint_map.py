"""The paint map: every receptor at 1:1 on the unrolled surface; the table of its switches."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil
from typing import Any

import numpy as np

from phytac_design.core.figures import new_figure
from phytac_design.design.spec import Design
from phytac_design.fabrication.bill import csv_text
from phytac_design.fabrication.documents.unroll import UnrolledSurface, unroll
from phytac_design.fabrication.inserts.sprues import plan_sprues
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.fabrication.switch_strips import StripSet, strip_label
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import DISPLAY_COLOURS
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

MARGIN_mm = 8.0
"""Edge that printers leave white."""
HEAD_mm, FOOT_mm = 20.0, 13.0
OVERLAP_mm = 10.0
"""Strip that neighbouring sheets share."""
BAR_mm = 100
POINTS = 72.0 / 25.4
"""Points per millimetre."""
INKS = {name: "#{:02x}{:02x}{:02x}".format(*rgba[:3]) for name, rgba in DISPLAY_COLOURS.items()} | {
    "yellow": "#d8b400",
    "magenta": "#c2189b",
    "cyan": "#0fa3b1",
    "white": "#e6e6e6",  # seen on white paper
    "black": "#000000",
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
    sprues : tuple of (int, str)
        First marker of each sprue of inserts, and its label.
    marks_mm : (r, 2) float
        Centres of the reference marks on the map, beyond the outline of the sensing surface.
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
    sprues: tuple[tuple[int, str], ...]
    marks_mm: FloatArray
    text_mm: float

    @property
    def box_mm(self) -> FloatArray:
        """Corners [[x0, y0], [x1, y1]] of the map with its border, y upwards."""
        border_mm = 4.0  # border around the map for markers that overlap its edges
        points = np.concatenate([*self.unrolled.outline, self.place_mm, self.marks_mm])
        return np.stack([points.min(axis=0) - border_mm, points.max(axis=0) + border_mm])


def marker_numbers(markers: Markers) -> tuple[str, ...]:
    """``row.column`` of each marker, or its number where there are no rows."""
    if not markers.in_rows:
        return tuple(map(str, range(markers.count)))
    return tuple(f"{r}.{c}" for r, c in zip(markers.row, markers.column, strict=True))


def switch_labels(switches: SwitchSet) -> tuple[str, ...]:
    """Label of each marker's switch; () without switches."""
    kinds = zip(switches.bowl.tolist(), switches.length.tolist(), strict=True)
    names = {kind: switches.label(kind) for kind in switches.kinds}
    return tuple(names[kind] for kind in kinds)


def strip_labels(strips: StripSet) -> tuple[str, ...]:
    """Label of each marker's strip, with the strip's place in ``mold/strips.csv``."""
    names = {
        int(marker): f"{strip_label(strip.number)}-{piece}"
        for piece, strip in enumerate(strips.strips, start=1)
        for marker in strip.markers
    }
    return tuple(names[marker] for marker in range(len(names)))


def make_map(sensor: Sensor, switches: SwitchSet, strips: StripSet | None = None) -> PaintMap:
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
        switch=(strip_labels(strips) if strips else switch_labels(switches))
        or ("",) * markers.count,
        paint=tuple(names[k] for k in markers.colour),
        sprues=tuple((one.markers[0], one.label) for one in plan_sprues(sensor))
        if design.receptor.has_inserts
        else (),
        marks_mm=_marks(unrolled, sensor),
        text_mm=float(np.clip(text_share * nearest, 0.9, 1.7)),
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


def _marks(unrolled: UnrolledSurface, sensor: Sensor) -> FloatArray:
    """Places (r, 2) of reference marks on the map: straight out from the edge beside them."""
    marks, (low, high) = sensor.reference_marks, sensor.surface.domain.T
    margin = 1e-3 * (high - low) * ~np.array(sensor.surface.periodic)
    inside = np.clip(marks.edge_uv, low + margin, high - margin)
    piece = unrolled.piece(inside)
    edge = unrolled.flat(marks.edge_uv, piece)
    out = edge - unrolled.flat(inside, piece)
    return np.asarray(
        edge + marks.distance_mm[:, None] * out / np.linalg.norm(out, axis=1, keepdims=True)
    )


def sheet_of_paper(width_mm: float, height_mm: float) -> tuple[Any, Any]:
    """Figure of a size, and axes all over it in millimetres, y downwards from the top left."""
    figure = new_figure((width_mm / 25.4, height_mm / 25.4), constrained=False)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), zorder=1)
    axes.set(xlim=(0.0, width_mm), ylim=(height_mm, 0.0))
    axes.set_axis_off()
    return figure, axes


def line(
    axes: Any, points: FloatArray, width_mm: float, dash_mm: float = 0.0, colour: str = "#000000"
) -> None:
    """Draw a line through points (k, 2)."""
    # Dashes are counted in widths of the line.
    style: Any = (0, (dash_mm / width_mm,) * 2) if dash_mm else "solid"
    width = width_mm * POINTS
    axes.plot(*points.T, color=colour, linewidth=width, linestyle=style, solid_capstyle="butt")


def write(axes: Any, at: Sequence[float], text: str, size_mm: float, **style: Any) -> None:
    """Write a line of text on its baseline."""
    axes.text(
        *at,
        text,
        fontsize=size_mm * POINTS,
        parse_math=False,
        clip_on=True,
        **style,
    )


def discs(axes: Any, centres: FloatArray, radius_mm: float, **style: Any) -> None:
    """Draw discs around centres (n, 2)."""
    from matplotlib.collections import EllipseCollection

    size = [2.0 * radius_mm]
    axes.add_collection(
        EllipseCollection(
            size,
            size,
            [0.0],
            units="xy",
            offsets=centres,
            offset_transform=axes.transData,
            **{"linewidths": 0.0, "zorder": 2.5, **style},
        ),
        autolim=False,
    )


def draw_map(axes: Any, drawn: PaintMap) -> None:
    """Draw the map on axes whose limits are chosen: along upwards, around to the right."""
    for edge in drawn.unrolled.outline:
        line(axes, np.concatenate([edge, edge[:1]]), 0.18)
    for edge in drawn.unrolled.seams:
        line(axes, edge, 0.35, 2.0, "#e07000")
    receptor, size = drawn.design.receptor, drawn.text_mm
    radius, grey = receptor.diameter_outer_mm / 2.0, "#9a9a9a"
    (x0, x1), (y0, y1) = np.sort(axes.get_xlim()), np.sort(axes.get_ylim())

    def names(marker: int, at: FloatArray, colour: str) -> None:
        """Marker's number above it and its switch's label below."""
        reach = radius + 2.0 * size
        if x0 - reach < at[0] < x1 + reach and y0 - reach < at[1] < y1 + reach:
            style = {"color": colour, "horizontalalignment": "center"}
            write(axes, (at[0], at[1] + radius + 0.15 * size), drawn.number[marker], size, **style)
            write(axes, (at[0], at[1] - radius - 0.9 * size), drawn.switch[marker], size, **style)

    for marker, at in drawn.ghosts:
        style = {"linewidths": 0.1 * POINTS, "linestyles": [(0, (5.0, 5.0))]}
        discs(axes, at[None], radius, facecolors="none", edgecolors=grey, **style)
        names(marker, at, grey)
    discs(axes, drawn.place_mm, radius, facecolors=[INKS[paint] for paint in drawn.paint])
    if drawn.design.has_switches:
        discs(axes, drawn.place_mm, receptor.diameter_hole_mm / 2.0, facecolors="#ffffff")
        tip = drawn.design.switch.tip_diameter_mm / 2.0
        discs(axes, drawn.place_mm, tip, facecolors=INKS["red"])
    for marker, at in enumerate(drawn.place_mm):
        names(marker, at, "#000000")
    for marker, text in drawn.sprues:
        place = drawn.place_mm[marker] + [radius + 0.4 * size, -0.4 * size]
        write(axes, place.tolist(), text, 1.2 * size, fontweight="bold")
    _draw_marks(axes, drawn)


def _draw_marks(axes: Any, drawn: PaintMap) -> None:
    """Draw the reference marks with their names; nothing without."""
    if not len(drawn.marks_mm):
        return
    size = drawn.text_mm
    across = drawn.design.reference_marks.diameter_mm
    discs(axes, drawn.marks_mm, across / 2.0, facecolors=INKS[drawn.design.layout.colours[0]])
    for mark, at in enumerate(drawn.marks_mm):
        write(axes, (at[0] + across, at[1]), f"M{mark}", size)


def whole_page(drawn: PaintMap, *, inside: bool = False) -> Any:
    """Figure of the whole map on one sheet of its own size, for the SVG.

    ``inside`` mirrors it: as the receptors stand before the one who paints them.
    """
    size = np.ptp(drawn.box_mm, axis=0)
    width = max(float(size[0]), BAR_mm + 20.0) + 2.0 * MARGIN_mm
    height = float(size[1]) + HEAD_mm + FOOT_mm + 2.0 * MARGIN_mm
    return _page(drawn, (width, height), (np.zeros(2), size), inside=inside)[0]


def paper_pages(drawn: PaintMap) -> list[Any]:
    """Figures of sheets of paper with the map seen from outside, then of its mirror image."""
    sheets = {"A4": (210.0, 297.0), "letter": (215.9, 279.4)}
    size = np.ptp(drawn.box_mm, axis=0)
    upright = sheets[drawn.design.bench.sheet]
    ways = [_tiling(size, paper) for paper in (upright, upright[::-1])]
    paper, room, count = min(ways, key=lambda way: way[2][0] * way[2][1])
    pages = []
    for inside, row, column in product((False, True), range(count[1]), range(count[0])):
        start = np.array([column, row]) * (room - OVERLAP_mm)
        end = np.minimum(start + room, size)
        many = count[0] * count[1] > 1
        name = f"sheet {chr(ord('A') + row)}{column + 1} of {count[1]} × {count[0]}" if many else ""
        figure, axes = _page(drawn, paper, (start, end), inside=inside, sheet=name)
        _joins(axes, end - start, (column, row), count)
        pages.append(figure)
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


def _page(
    drawn: PaintMap,
    paper: tuple[float, float],
    span: tuple[FloatArray, FloatArray],
    *,
    inside: bool,
    sheet: str = "",
) -> tuple[Any, Any]:
    """Figure and axes (mm) of a page with the part of the map between two corners of its box.

    The corners are counted from the top left of the picture, y downwards.
    """
    figure, axes = sheet_of_paper(*paper)
    (left, top), (right, bottom) = span[0].tolist(), span[1].tolist()
    low, high = drawn.box_mm.tolist()
    width, height = right - left, bottom - top
    x, y = MARGIN_mm, MARGIN_mm + HEAD_mm
    part = figure.add_axes(
        (x / paper[0], 1.0 - (y + height) / paper[1], width / paper[0], height / paper[1])
    )
    limits = (high[0] - left, high[0] - right) if inside else (low[0] + left, low[0] + right)
    part.set(xlim=limits, ylim=(high[1] - bottom, high[1] - top))
    part.set_axis_off()
    draw_map(part, drawn)
    _frame(axes, drawn, *paper, inside, sheet)
    return figure, axes


def _joins(axes: Any, size: FloatArray, at: tuple[int, int], count: tuple[int, int]) -> None:
    """Lines along the strips that a sheet shares with its neighbours, and crosses on them."""
    corner = np.array([MARGIN_mm, MARGIN_mm + HEAD_mm])
    places: list[list[float]] = [[], []]
    for axis in (0, 1):
        if at[axis] > 0:
            places[axis].append(float(corner[axis] + OVERLAP_mm / 2.0))
        if at[axis] < count[axis] - 1:
            places[axis].append(float(corner[axis] + size[axis] - OVERLAP_mm / 2.0))
        for place in places[axis]:
            ends = np.stack([corner, corner + size])
            ends[:, axis] = place
            line(axes, ends, 0.15, 1.0, "#555555")
    if places[0] or places[1]:
        middle = (corner + size / 2.0).tolist()
        for x, y in product(places[0] or [middle[0]], places[1] or [middle[1]]):
            for reach in ([[-3.0, 0.0], [3.0, 0.0]], [[0.0, -3.0], [0.0, 3.0]]):
                line(axes, np.array([x, y]) + reach, 0.15)


def _frame(
    axes: Any, drawn: PaintMap, width: float, height: float, inside: bool, sheet: str
) -> None:
    """Head with title, legend and notes; foot with the scale bars."""
    side_bar_mm = 50
    design = drawn.design
    side = "seen from inside (mirrored)" if inside else "seen from outside"
    title = "map of inserts" if design.receptor.has_inserts else "paint map"
    left, top, foot = MARGIN_mm, MARGIN_mm, height - MARGIN_mm
    write(axes, (left, top + 4.0), f"{design.name}: {title}, {side}, 1:1", 4.0)
    here = (width - MARGIN_mm, top + 4.0)
    write(axes, here, sheet, 3.5, horizontalalignment="right")
    for row, text in enumerate(map_notes(drawn)):
        write(axes, (left, top + 8.0 + 3.2 * row), text, 2.4)
    scale_bar(axes, np.array([left + 4.0, foot - 4.0]), BAR_mm)
    scale_bar(axes, np.array([left, foot - 4.0]), side_bar_mm, upright=True)
    x = left + BAR_mm + 12.0
    for name in [*dict.fromkeys(design.layout.colours), *(["red"] if design.has_switches else [])]:
        discs(axes, np.array([[x, foot - 6.0]]), 1.2, facecolors=INKS[name])
        words = f"{name} tip" if name == "red" else name
        write(axes, (x + 2.0, foot - 5.1), words, 2.6)
        x += 5.0 + 1.6 * len(words)


def map_notes(drawn: PaintMap) -> Sequence[str]:
    """Lines of explanation under the title."""
    design, unrolled = drawn.design, drawn.unrolled
    number = "row.column" if any("." in name for name in drawn.number) else "marker number"
    below = tips = ""
    if design.has_switches:
        below, tips = "; below: its switch", "; the tips of the switches red"
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
            f"{number}{below}. At the bottom: {bottom}."
        ),
        f"{_colouring_note(design)}{tips}. Orange dashes: seams; grey: seen again across a seam.",
        f"Outer face {unrolled.note}; {scale}.",
        *_mark_notes(design),
    )


def _colouring_note(design: Design) -> str:
    """How the receptors get their colours."""
    if design.receptor.has_inserts:
        return "In bold, beside its first insert: the label of a sprue"
    if design.receptor.colouring == "multi-material":
        return "Receptors are printed in these colours"
    return f"Paint end face and last {design.receptor.band_marker_mm:g} mm of each receptor"


def _mark_notes(design: Design) -> Sequence[str]:
    """How the reference marks are painted; nothing without."""
    table = design.reference_marks
    if not table.count:
        return ()
    near, far = table.rows_mm
    return (
        (
            f"M0, M1, …: reference marks, {design.layout.colours[0]} dots of "
            f"{table.diameter_mm:g} mm on the inner side of the rim, {near:.2f} and {far:.2f} mm "
            "from the wall by turns; M0 stands half a step aside."
        ),
    )


def marks_csv(sensor: Sensor, drawn: PaintMap) -> str:
    """CSV with a line for each reference mark."""
    marks, design = sensor.reference_marks, sensor.design
    rows = []
    for k in range(marks.count):
        x, y, _ = marks.point_mm[k]
        angle = np.degrees(np.arctan2(y, x)) % 360.0
        numbers = [marks.distance_mm[k], angle, *marks.point_mm[k], *drawn.marks_mm[k]]
        rows.append(
            [f"M{k}", ("near", "far")[marks.end[k]], design.layout.colours[0]]
            + [f"{value + 0.0:.4f}" for value in np.round(numbers, 4)]
        )
    columns = "mark rim paint from_wall_mm angle_deg x_mm y_mm z_mm map_x_mm map_y_mm"
    return csv_text(columns.split(), rows)


def scale_bar(axes: Any, start: FloatArray, length_mm: int, *, upright: bool = False) -> None:
    """Draw a bar with a tick at every 10 mm, to the right or upwards."""
    along = np.array([0.0, -1.0]) if upright else np.array([1.0, 0.0])
    aside = np.array([1.0, 0.0]) if upright else np.array([0.0, -1.0])
    line(axes, np.stack([start, start + length_mm * along]), 0.2)
    for tick in range(0, length_mm + 1, 10):
        foot = start + tick * along
        line(axes, np.stack([foot, foot + 2.0 * aside]), 0.2)
    if not upright:
        end = start + np.array([float(length_mm), 3.6])
        write(axes, end.tolist(), f"{length_mm} mm", 2.6, horizontalalignment="right")


def placement_csv(surface: Surface, markers: Markers, switches: SwitchSet, drawn: PaintMap) -> str:
    """CSV with a line for each marker; row and column are empty where there are no rows."""
    outer = surface.point(markers.uv)
    threshold = switches.threshold_N[switches.bowl]
    length = switches.lengths_mm[switches.length]
    rows = []
    for k in range(markers.count):
        place = [int(markers.row[k]), int(markers.column[k])] if markers.in_rows else ["", ""]
        numbers = np.concatenate([outer[k], drawn.place_mm[k], drawn.stretch[k]])
        rows.append(
            [k, *place, drawn.paint[k], drawn.switch[k], f"{threshold[k]:g}", f"{length[k]:.1f}"]
            + [f"{value + 0.0:.4f}" for value in numbers.round(4)]
        )
    # Point on the outer face; place on the map (around, along); local scale of the map.
    columns = (
        "marker row column paint switch threshold_N length_mm x_mm y_mm z_mm "
        "map_x_mm map_y_mm map_scale_least map_scale_most"
    )
    return csv_text(columns.split(), rows)
