"""Where a shell larger than the bed is cut: planes between receptors, pieces that fit."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class CuttingPlane:
    """A cutting plane: points p with ``normal · p = offset_mm``; ``axis``: number of its frame."""

    axis: int
    normal: FloatArray
    offset_mm: float


def cut_frame(surface: Surface) -> tuple[FloatArray, tuple[int, ...]]:
    """Frame (3, 3) of rows, and those of its axes across which the shell may be cut.

    Tubes and domes are cut across their axis, sheets along rows and columns.
    """
    if surface.periodic[1]:
        return np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), (0,)
    middle = surface.domain.mean(axis=1)[None]
    along = surface.tangents(middle)[0]
    first = along[0] / np.linalg.norm(along[0])
    normal = surface.normal(middle)[0]
    return np.stack([first, np.cross(normal, first), normal]), (0, 1)


def plan_cuts(
    sensor: Sensor, corners_mm: FloatArray, peg_mm: float, share: float = 0.5
) -> list[CuttingPlane]:
    """Planes that part a shell into the fewest pieces that fit the bed.

    Parameters
    ----------
    corners_mm : (n, 3) float
        Corners of the shell.
    peg_mm : float
        How far pegs stand out of a piece.
    share : float
        Where in a gap a cut is made: 0 at its lower end, 1 at its upper one.

    Raises
    ------
    DesignError
        If no planes between receptors make pieces that fit.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    frame, free = cut_frame(surface)
    local = corners_mm @ frame.T
    low, high = local.min(axis=0), local.max(axis=0)
    size = high - low
    bed = np.array(design.print_rules.bed_mm)
    plans: list[tuple[int, int, list[CuttingPlane]]] = []
    for order in permutations(range(3)):
        room = bed[list(order)]
        fixed = [k for k in range(3) if k not in free]
        if np.any(size[fixed] > room[fixed]):
            continue
        cuts: list[CuttingPlane] = []
        for k in free:
            limits = (float(low[k]), float(high[k]), float(room[k]) - peg_mm)
            places = _places(gaps(design, markers, frame[k]), limits, share)
            if places is None:
                break
            cuts += [CuttingPlane(axis=k, normal=frame[k], offset_mm=place) for place in places]
        else:
            count = np.prod([1 + sum(cut.axis == k for cut in cuts) for k in free])
            plans.append((int(count), len(plans), cuts))
    if not plans:
        sides = " x ".join(f"{side:.0f}" for side in size[[1, 2, 0]])
        across = " and ".join(str(np.round(frame[k], 2).tolist()) for k in free)
        raise DesignError(
            "shell-exceeds-bed",
            f"the shell ({sides} mm) does not fit the bed ({bed[0]:g} x {bed[1]:g} x {bed[2]:g} "
            f"mm) and cannot be parted across {across} without cutting through receptors; raise "
            "print_rules.bed_mm, leave room between the layout's rows, or make the sensor smaller",
        )
    return min(plans)[2]


def receptor_spans(
    design: Design, markers: Markers, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Ends (n,) of each receptor along a direction, its hole through the wall included, mm."""
    radius = design.receptor.diameter_tube_mm / 2.0
    outer = markers.base_mm - 2.0 * design.wall.thickness_mm * markers.direction
    slant = np.sqrt(np.clip(1.0 - (markers.direction @ normal) ** 2, 0.0, 1.0))
    ends = np.stack([outer @ normal, markers.tip_mm @ normal])
    return ends.min(axis=0) - radius * slant, ends.max(axis=0) + radius * slant


def gaps(design: Design, markers: Markers, normal: FloatArray) -> FloatArray:
    """Intervals (n, 2) along a direction that no receptor reaches into, mm."""
    reach = design.print_rules.wall_min_mm
    low, high = receptor_spans(design, markers, normal)
    low, high = low - reach, high + reach
    order = np.argsort(low)
    top = np.maximum.accumulate(high[order])
    start, stop = top[:-1], low[order][1:]
    return np.asarray(np.column_stack([start, stop])[stop > start])


def _places(free: FloatArray, span: tuple[float, float, float], share: float) -> list[float] | None:
    """Offsets of cuts between the ends of a span so that no piece exceeds its third number."""
    more = 6  # pieces beyond the least number that are tried along an axis
    low, high, room = span
    if room <= 0.0:
        return None
    least = max(1, int(np.ceil((high - low) / room)))
    places = free[:, 0] + share * (free[:, 1] - free[:, 0])
    for count in range(least, least + more):
        found = _spread(places, (low, high, room), count)
        if found is not None:
            return found
    return None


def _spread(places: FloatArray, span: tuple[float, float, float], count: int) -> list[float] | None:
    """Offsets of ``count - 1`` cuts, as even as the places allow; None if a piece is too long."""
    start, high, room = span
    chosen: list[float] = []
    for left in range(count, 1, -1):
        target = start + (high - start) / left
        inside = places[(places > start) & (places <= start + room)]
        if len(inside) == 0:
            return None
        start = float(inside[np.argmin(np.abs(inside - target))])
        chosen.append(start)
    return chosen if high - start <= room else None
