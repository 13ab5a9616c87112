"""Where a scenario presses: places drawn on the surface, or read from the file."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from phytac_design.simulation.contacts import JITTER_MM, JITTER_SHARE, tangent_step
from phytac_design.simulation.scenario.scenario_sections import ContactsSection, GivenContact
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

SURFACE_GAP_MAX_mm = 10.0
"""A point given by hand may lie this far beyond its patch's radius from the surface."""
CELLS = 128
"""Cells along each side of the touched part in tables of area."""
STATIONS = 513
"""Stations along an edge in tables of its length."""

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


def chart_window(surface: Surface, touch: ContactsSection) -> ChartWindow:
    """Touched part of the chart.

    Raises
    ------
    DesignError
        If it runs over a seam that the surface does not have.
    """
    start, end = surface.domain.T
    span = end - start
    first = np.array([touch.along[0], touch.around[0]])
    size = np.array([touch.along[1], touch.around[1]]) - first
    if size[1] < 0.0:
        if not surface.periodic[1]:
            raise DesignError(
                "range-over-open-seam",
                f"touch.around runs over a seam, but the {surface.name} is open there (got "
                f"{list(touch.around)}); let it grow",
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
    part = chart_window(surface, touch)
    if touch.placement == "anywhere":
        return _by_area(part)
    if touch.placement == "rims":
        return _near_edges(part, touch.rim_mm)
    return _on_receptors(part, markers, jitter_of(touch, least_mm))


def jitter_of(touch: ContactsSection, least_mm: float) -> float:
    """How far from a receptor's middle it is hit, along and around, mm."""
    if touch.jitter_mm is not None:
        return touch.jitter_mm
    return min(JITTER_MM, JITTER_SHARE * least_mm)


def traverse(surface: Surface, markers: Markers, touch: ContactsSection) -> IntArray:
    """Receptors of the touched part, column after column and row after row.

    Off a lattice they are taken strip by strip around, each along the sensor.
    """
    held = np.flatnonzero(chart_window(surface, touch).holds(markers.uv))
    if markers.in_rows:
        return held[np.lexsort((markers.row[held], markers.column[held]))]
    strips = max(round(float(np.sqrt(len(held)))), 1)
    rank = np.argsort(np.argsort(markers.uv[held, 1], kind="stable"), kind="stable")
    return held[np.lexsort((markers.uv[held, 0], rank * strips // max(len(held), 1)))]


def _nothing(what: str) -> DesignError:
    return DesignError(
        "contact-range-empty",
        f"the touched part of the chart holds no {what}; widen touch.along and touch.around",
    )


def _on_receptors(part: ChartWindow, markers: Markers, jitter_mm: float) -> PlaceSampler:
    held = np.flatnonzero(part.holds(markers.uv))
    if len(held) == 0:
        raise _nothing("receptor")

    def place(receptor: IntArray, draw: FloatArray) -> FloatArray:
        any_of = held[np.minimum((draw[:, 0] * len(held)).astype(np.int64), len(held) - 1)]
        ids = np.where(receptor >= 0, receptor, any_of)
        step = jitter_mm * (2.0 * draw[:, 2:4] - 1.0)
        return tangent_step(part.surface, markers.uv[ids], step)

    return place


def _by_area(part: ChartWindow) -> PlaceSampler:
    """Even over the area of the part that senses."""
    middle = (np.arange(CELLS) + 0.5) / CELLS
    grid = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
    places = part.at(grid)
    area = _area_elements(part.surface, places)
    if not float(np.where(part.surface.sensing(places), area, 0.0).sum()) > 0.0:
        raise _nothing("area that senses")
    whole = np.concatenate([[0.0], np.cumsum(area)])
    whole /= whole[-1]

    def place(_: IntArray, draw: FloatArray) -> FloatArray:
        cell = np.clip(np.searchsorted(whole, draw[:, 0], side="right") - 1, 0, CELLS**2 - 1)
        corner = np.stack(np.divmod(cell, CELLS), axis=1)
        uv = part.at((corner + draw[:, 1:3]) / CELLS)
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
    stations = np.linspace(0.0, 1.0, STATIONS)
    tables: list[FloatArray] = []
    for axis, side in surface.edges():
        edge = surface.domain[axis, side]
        reached = part.low[axis] if side == 0 else part.low[axis] + part.size[axis]
        if abs(float(reached - edge)) > 1e-9 * span[axis]:
            continue
        other = 1 - axis
        uv = np.empty((STATIONS, 2))
        uv[:, axis] = edge
        uv[:, other] = part.low[other] + stations * part.size[other]
        speed = np.sqrt(surface.metric(part.wrapped(uv))[:, other, other])
        steps = (speed[1:] + speed[:-1]) / 2.0 * part.size[other] / (STATIONS - 1)
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
        if away > SURFACE_GAP_MAX_mm + item.radius_mm:
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
