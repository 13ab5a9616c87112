"""Where a scenario presses: places drawn on the surface, or read from the file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from phytac_design.simulation.contacts import rig_jitter_mm, tangent_step
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.scenario.scenario_file import ContactsSection, GivenContact
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

PlaceSampler = Callable[[IntArray, FloatArray], FloatArray]
"""(number (m,) of a receptor to press, or -1 for any; four random numbers (m, 4) in [0, 1)) ->
chart positions (m, 2), NaN where that draw hits nothing."""


@dataclass(frozen=True, kw_only=True)
class ChartWindow:
    """Part of the chart that is touched.

    Attributes
    ----------
    low, size : (2,) float
        Its corner and its size in chart coordinates; it may run over the seam of a closed axis.
    surface : Surface
        The outer face.
    """

    low: FloatArray
    size: FloatArray
    surface: Surface

    def holds(self, uv: FloatArray) -> BoolArray:
        """Whether chart positions (m, 2) lie in it, (m,)."""
        start, end = self.surface.domain.T
        beyond = uv - self.low
        turned = np.where(self.surface.periodic, np.mod(beyond, end - start), beyond)
        slack = 1e-9 * (end - start)
        return np.asarray(np.all((turned >= -slack) & (turned <= self.size + slack), axis=1))

    def at(self, shares: FloatArray) -> FloatArray:
        """Chart positions (m, 2) at shares (m, 2) of it, within the chart."""
        return self.wrapped(self.low + shares * self.size)

    def wrapped(self, uv: FloatArray) -> FloatArray:
        """Chart positions brought back over the seam of closed axes, (m, 2)."""
        start, end = self.surface.domain.T
        around = start + np.mod(uv - start, end - start)
        return np.where(np.array(self.surface.periodic), around, np.clip(uv, start, end))


def chart_window(
    surface: Surface, along: Sequence[float], around: Sequence[float], where: str = "touch"
) -> ChartWindow:
    """Part of the chart between two shares along it and two around it; ``where`` has them.

    Raises
    ------
    DesignError
        If it runs over a seam that the surface does not have.
    """
    start, end = surface.domain.T
    span = end - start
    first = np.array([along[0], around[0]])
    size = np.array([along[1], around[1]]) - first
    if size[1] < 0.0:
        if not surface.periodic[1]:
            raise DesignError(
                "range-over-open-seam",
                f"{where}.around runs over a seam, but the {surface.name} is open there (got "
                f"{list(around)}); let it grow",
            )
        size[1] += 1.0
    return ChartWindow(low=start + first * span, size=size * span, surface=surface)


def place_sampler(
    surface: Surface, markers: Markers, touch: ContactsSection, least_mm: float
) -> PlaceSampler:
    """Way to draw places.

    Parameters
    ----------
    surface : Surface
        The outer face.
    markers : Markers
        Receptors as designed: a rig presses where they should be.
    touch : ContactsSection
        Placement and part of the chart.
    least_mm : float
        Smallest radius of a patch.

    Raises
    ------
    DesignError
        If the touched part holds no receptor, no area that senses or no open edge.
    """
    part = chart_window(surface, touch.along, touch.around)
    if touch.placement == "anywhere":
        return _by_area(part)
    if touch.placement == "rims":
        return _near_edges(part, touch.rim_mm)
    held = pressed_receptors(surface, markers, touch)
    return _on_receptors(part, markers, held, jitter_of(touch, least_mm))


def jitter_of(touch: ContactsSection, least_mm: float) -> float:
    """How far from a receptor's middle it is hit, along and around, mm."""
    if touch.jitter_mm is not None:
        return touch.jitter_mm
    return rig_jitter_mm(least_mm)


def pressed_receptors(surface: Surface, markers: Markers, touch: ContactsSection) -> IntArray:
    """Receptors (m,) in the touched part and the columns of a scenario.

    Raises
    ------
    DesignError
        If there are none.
    """
    held = chart_window(surface, touch.along, touch.around).holds(markers.uv)
    if touch.columns is not None:
        held &= np.isin(grid_numbers(markers)[1], touch.columns)
    if not held.any():
        raise _nothing("receptor of these columns" if touch.columns else "receptor")
    return np.flatnonzero(held)


def grid_numbers(markers: Markers) -> tuple[IntArray, IntArray]:
    """Row (n,) and column (n,) of each receptor.

    Off a lattice, strips along the sensor, about as many as receptors in each, are its columns.
    """
    if markers.in_rows:
        return markers.row, markers.column
    count = markers.count
    strips = max(round(float(np.sqrt(count))), 1)
    rank = np.argsort(np.argsort(markers.uv[:, 1], kind="stable"), kind="stable")
    column = rank * strips // max(count, 1)
    order = np.lexsort((markers.uv[:, 0], column))
    row = np.empty(count, dtype=np.int64)
    row[order] = np.arange(count) - np.searchsorted(column[order], column[order])
    return row, column


def traverse(surface: Surface, markers: Markers, touch: ContactsSection) -> IntArray:
    """Receptors of the touched part, column after column and row after row."""
    held = pressed_receptors(surface, markers, touch)
    row, column = grid_numbers(markers)
    return held[np.lexsort((row[held], column[held]))]


def _nothing(what: str) -> DesignError:
    return DesignError(
        "contact-range-empty",
        f"the touched part of the chart holds no {what}; widen touch.along and touch.around, or "
        "give other columns",
    )


def _on_receptors(
    part: ChartWindow, markers: Markers, held: IntArray, jitter_mm: float
) -> PlaceSampler:
    def place(receptor: IntArray, draw: FloatArray) -> FloatArray:
        any_of = held[np.minimum((draw[:, 0] * len(held)).astype(np.int64), len(held) - 1)]
        ids = np.where(receptor >= 0, receptor, any_of)
        step = jitter_mm * (2.0 * draw[:, 2:4] - 1.0)
        return tangent_step(part.surface, markers.uv[ids], step)

    return place


def _by_area(part: ChartWindow) -> PlaceSampler:
    """Even over the area of the part that senses."""
    cells = 128  # cells along each side of the touched part in tables of area
    middle = (np.arange(cells) + 0.5) / cells
    grid = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
    places = part.at(grid)
    area = _area_elements(part.surface, places)
    if not float(np.where(part.surface.sensing(places), area, 0.0).sum()) > 0.0:
        raise _nothing("area that senses")
    whole = np.concatenate([[0.0], np.cumsum(area)])
    whole /= whole[-1]

    def place(_: IntArray, draw: FloatArray) -> FloatArray:
        cell = np.clip(np.searchsorted(whole, draw[:, 0], side="right") - 1, 0, cells**2 - 1)
        corner = np.stack(np.divmod(cell, cells), axis=1)
        uv = part.at((corner + draw[:, 1:3]) / cells)
        return np.where(part.surface.sensing(uv)[:, None], uv, np.nan)

    return place


def _area_elements(surface: Surface, uv: FloatArray) -> FloatArray:
    """Area of the outer face per unit of chart at (m, 2), (m,) mm²."""
    metric = surface.metric(uv)
    det = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    return np.asarray(np.sqrt(np.maximum(det, 0.0)))


def _near_edges(part: ChartWindow, rim_mm: float) -> PlaceSampler:
    """Within ``rim_mm`` of the open edges that the part reaches, even along them, in the part."""
    surface = part.surface
    start, end = surface.domain.T
    span = end - start
    held: list[tuple[int, float, float]] = []
    count = 513  # stations along an edge in tables of its length
    stations = np.linspace(0.0, 1.0, count)
    tables: list[FloatArray] = []
    for axis, side in surface.edges():
        edge = surface.domain[axis, side]
        reached = part.low[axis] if side == 0 else part.low[axis] + part.size[axis]
        if abs(float(reached - edge)) > 1e-9 * span[axis]:
            continue
        other = 1 - axis
        uv = np.empty((count, 2))
        uv[:, axis] = edge
        uv[:, other] = part.low[other] + stations * part.size[other]
        speed = np.sqrt(surface.metric(part.wrapped(uv))[:, other, other])
        steps = (speed[1:] + speed[:-1]) / 2.0 * part.size[other] / (count - 1)
        tables.append(np.concatenate([[0.0], np.cumsum(steps)]))
        held.append((axis, float(edge), 1.0 if side == 0 else -1.0))
    if not held:
        raise _nothing("open edge")
    until = np.cumsum([table[-1] for table in tables])
    until /= until[-1]

    def place(_: IntArray, draw: FloatArray) -> FloatArray:
        which = np.minimum(np.searchsorted(until, draw[:, 0], side="right"), len(held) - 1)
        out = np.full((len(draw), 2), np.nan)
        for number, (axis, edge, inward) in enumerate(held):
            own = which == number
            far = draw[own, 1] * tables[number][-1]
            uv = np.empty((len(far), 2))
            uv[:, axis] = edge
            share = np.interp(far, tables[number], stations)
            uv[:, 1 - axis] = part.low[1 - axis] + share * part.size[1 - axis]
            speed = np.sqrt(surface.metric(part.wrapped(uv))[:, axis, axis])
            uv[:, axis] += inward * draw[own, 2] * rim_mm / np.maximum(speed, 1e-12)
            out[own] = part.wrapped(uv)
        good = surface.sensing(out) & part.holds(out)
        return np.where(good[:, None], out, np.nan)

    return place


def places_at(surface: Surface, markers: Markers, items: tuple[GivenContact, ...]) -> FloatArray:
    """Chart positions (c, 2) of contacts given by hand.

    Raises
    ------
    DesignError
        If one names a receptor that the layout does not have, or a point with no nearest one.
    """
    return np.array([_place_at(surface, markers, k, item) for k, item in enumerate(items)]).reshape(
        -1, 2
    )


def _place_at(surface: Surface, markers: Markers, number: int, item: GivenContact) -> FloatArray:
    # A point given by hand may lie this far beyond its patch's radius from the surface.
    gap_max_mm = 10.0
    where = f"touch.at.{number}"
    start, end = surface.domain.T
    if item.point_mm is not None:
        found = surface.chart(np.array([item.point_mm]))[0]
        if not np.isfinite(found).all():
            raise DesignError(
                "contact-point-ambiguous",
                f"{where}: no point of the {surface.name} is nearest to point_mm = "
                f"{list(item.point_mm)}; move it off the axis",
            )
        closed = np.array(surface.periodic)
        uv = np.asarray(np.where(closed, found, np.clip(found, start, end)))
        away = float(np.linalg.norm(surface.point(uv[None])[0] - np.array(item.point_mm)))
        if away > gap_max_mm + item.radius_mm:
            raise DesignError(
                "contact-point-off-surface",
                f"{where}: point_mm = {list(item.point_mm)} is {away:.3g} mm from the "
                f"{surface.name}; give a point on its outer face, in mm, in the sensor's frame",
            )
        return uv
    if item.along is not None and item.around is not None:
        return np.asarray(start + np.array([item.along, item.around]) * (end - start))
    if item.marker is not None:
        if item.marker >= markers.count:
            raise DesignError(
                "marker-unknown",
                f"{where}: the layout has receptors 0 to {markers.count - 1} (got marker = "
                f"{item.marker})",
            )
        return np.asarray(markers.uv[item.marker])
    if not markers.in_rows:
        raise DesignError(
            "layout-without-rows", f"{where}: this layout has no rows; name the receptor by marker"
        )
    here = (markers.row == item.row) & (markers.column == item.column)
    if not here.any():
        raise DesignError(
            "marker-unknown",
            f"{where}: the layout has no receptor in row {item.row}, column {item.column} (rows "
            f"0 to {markers.row.max()}, columns 0 to {markers.column.max()})",
        )
    return np.asarray(markers.uv[np.argmax(here)])


CELLS = 128
"""Cells along each axis of the chart in which the patches are looked up."""


def contact_box(surface: Surface, uv: FloatArray, reach_mm: FloatArray) -> ChartBox:
    """Box of the chart around all patches, to about a cell of ``CELLS`` and never less.

    Patches are sought in space, as pressure is (distances are chords), so seams and poles are
    places like any other. Without any patch the box is empty: the middle of the chart.

    Parameters
    ----------
    surface : Surface
        The outer face.
    uv : (m, 2) float
        Centres of patches.
    reach_mm : (m,) float
        Their sizes from the centre.
    """
    start, end = surface.domain.T
    if len(uv) == 0:
        middle = (start + end) / 2.0
        return ChartBox(low=middle, high=middle.copy(), whole=np.zeros(2, dtype=np.bool_))
    axes = [np.linspace(a, b, CELLS + 1) for a, b in zip(start, end, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    at = surface.point(grid.reshape(-1, 2))
    corner = at.reshape(CELLS + 1, CELLS + 1, 3)
    diagonal = max(
        float(np.linalg.norm(corner[1:, 1:] - corner[:-1, :-1], axis=2).max()),
        float(np.linalg.norm(corner[1:, :-1] - corner[:-1, 1:], axis=2).max()),
    )
    covered = np.zeros(len(at), dtype=np.bool_)
    for reach in np.unique(reach_mm):
        covered |= _near(at, surface.point(uv[reach_mm == reach]), float(reach) + diagonal)
    marks = covered.reshape(corner.shape[:2])
    box = [
        _covered(np.asarray(marks.any(axis=1 - k)), axes[k], closed=surface.periodic[k])
        for k in range(2)
    ]
    return ChartBox(
        low=np.array([low for low, _, _ in box]),
        high=np.array([high for _, high, _ in box]),
        whole=np.array([whole for _, _, whole in box]),
    )


def _near(at: FloatArray, centres: FloatArray, reach_mm: float) -> BoolArray:
    """Whether points (g, 3) lie within reach of any of the centres (m, 3), (g,)."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(centres).query(at, distance_upper_bound=reach_mm)
    return np.asarray(np.isfinite(distance))


def _covered(marks: BoolArray, stations: FloatArray, *, closed: bool) -> tuple[float, float, bool]:
    """Ends of the shortest interval around marked stations, and whether it is the whole axis."""
    first, last = float(stations[0]), float(stations[-1])
    held = np.flatnonzero(marks)
    if not closed:
        low, high = float(stations[held[0]]), float(stations[held[-1]])
        return low, high, bool(low <= first and high >= last)
    # The two ends of a closed axis are one station.
    held = np.unique(held % CELLS)
    gaps = np.diff(np.append(held, held[0] + CELLS))
    widest = int(np.argmax(gaps))
    if gaps[widest] <= 2:
        return first, last, True
    low = float(stations[held[(widest + 1) % len(held)]])
    return low, float(stations[held[widest]]), False


def window_grid(part: ChartWindow) -> FloatArray:
    """Places (m, 2) all over a part of the chart, no farther apart than cells of ``CELLS``."""
    share = np.linspace(0.0, 1.0, CELLS + 1)
    return part.at(np.stack(np.meshgrid(share, share, indexing="ij"), axis=-1).reshape(-1, 2))
