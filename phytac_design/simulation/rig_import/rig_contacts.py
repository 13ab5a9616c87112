"""Contacts of a user's rig on the design's surface: places, forces, and whether they make sense."""

from itertools import pairwise

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import CYLINDER
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.rig_import.rig_log import RigLog
from phytac_design.simulation.scenario.scenario_file import FRICTION_MAX
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError


def contacts_of(log: RigLog, sensor: Sensor, *, off_mm: float, radius_mm: float) -> Contacts:
    """Contacts of a log, in the order of its samples.

    Rows without force are samples without contact. Bad rows are noted in ``log.problems``, and are
    left out.

    Parameters
    ----------
    log : RigLog
        The log.
    design, surface, markers : Design, Surface, Markers
        The sensor; positions refer to its outer face.
    off_mm : float
        Farthest that a contact may lie off the wall.
    radius_mm : float
        Of contacts whose radius the log does not say.

    Raises
    ------
    InputError
        If positions or forces are in another unit, or the forces point the other way.
    """
    radius_min_mm = 0.05  # contacts of a smaller radius are taken for a wrong unit
    design, surface = sensor.design, sensor.surface
    numbers, rows = log.numbers, np.arange(len(log.sample))
    uv = _places(log, sensor, off_mm)
    force, friction = _forces(log, design, surface, uv)
    keep = (force > 0.0) & np.isfinite(uv).all(axis=1) & np.isfinite(friction).all(axis=1)
    order = rows[keep][np.argsort(log.sample[keep], kind="stable")]
    length = numbers.get("length_mm", np.zeros(len(rows)))
    bad = keep & (log.indenter == CYLINDER) & ~(length > 0.0)
    log.note(bad, lambda _: "a cylinder needs its length_mm, above 0")
    radius = np.nan_to_num(numbers.get("radius_mm", np.zeros(len(rows))))
    size = float(np.sort(np.ptp(surface.bounds_mm(), axis=0))[1])
    bad = keep & (radius > 0.0) & ((radius > size / 2.0) | (radius < radius_min_mm))
    log.note(
        bad,
        lambda k: (
            f"a contact of radius {radius[k]:g} mm on a sensor {size:.3g} mm wide; is radius_mm in "
            "mm?"
        ),
    )
    return Contacts(
        sample=log.sample[order],
        uv=uv[order],
        radius_mm=np.nan_to_num(numbers.get("radius_mm", np.full(len(rows), radius_mm))[order]),
        force_N=force[order],
        samples=log.samples,
        indenter=log.indenter[order],
        length_mm=np.nan_to_num(np.where(log.indenter == CYLINDER, length, 0.0)[order]),
        turn_rad=np.radians(np.nan_to_num(numbers.get("turn_deg", np.zeros(len(rows)))[order])),
        friction=friction[order],
    )


def sequences_of(
    given: FloatArray | None, touches: Contacts, points_mm: FloatArray, near_mm: float
) -> IntArray:
    """Number of the press of each sample, (s,): the log's, or samples in a row at one place.

    A sample whose contacts lie within ``near_mm`` of those of the sample before belongs to it.
    """
    if given is not None:
        return np.unique(given, return_inverse=True)[1].reshape(-1).astype(np.int64)
    start = np.searchsorted(touches.sample, np.arange(touches.samples + 1))
    own = [points_mm[a:b] for a, b in pairwise(start)]
    new = [
        not (len(a) == len(b) > 0 and bool(np.all(np.linalg.norm(a - b, axis=1) <= near_mm)))
        for a, b in pairwise(own)
    ]
    return np.concatenate([[0], np.cumsum(new)]).astype(np.int64)


def _places(log: RigLog, sensor: Sensor, off_mm: float) -> FloatArray:
    """Chart positions (r, 2) of all rows; NaN where there is none, or a bad one."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    numbers = log.numbers
    if "x_mm" in numbers:
        points = np.column_stack([numbers[name] for name in ("x_mm", "y_mm", "z_mm")])
        return _on_surface(log, points, design, surface, off_mm)
    if "u" in numbers:
        uv = np.column_stack([numbers["u"], numbers["v"]])
        low, high = surface.domain.T
        closed = np.array(surface.periodic)
        bad = ~closed & ((uv < low) | (uv > high))
        log.note(
            bad.any(axis=1),
            lambda k: (
                f"({uv[k, 0]:g}, {uv[k, 1]:g}) is off the surface, whose chart runs from "
                f"({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g})"
            ),
        )
        return np.where(bad.any(axis=1)[:, None], np.nan, _wrapped(uv, low, high, closed))
    ids = _marker_ids(log, markers)
    return np.where((ids >= 0)[:, None], markers.uv[np.maximum(ids, 0)], np.nan)


def _wrapped(uv: FloatArray, low: FloatArray, high: FloatArray, closed: BoolArray) -> FloatArray:
    return np.where(closed, low + np.mod(uv - low, high - low), uv)


def _marker_ids(log: RigLog, markers: Markers) -> IntArray:
    """Markers (r,) that rows name; -1 where there is none, or no such one."""
    if "marker" in log.numbers:
        named = log.numbers["marker"]
        good = (named >= 0) & (named < markers.count)
        log.note(
            np.isfinite(named) & ~good,
            lambda k: f"marker must be 0 to {markers.count - 1} (got {named[k]:g})",
        )
        return np.where(good, np.nan_to_num(named), -1.0).astype(np.int64)
    if not markers.in_rows:
        raise InputError(
            "rig-layout-without-rows",
            f"{log.path}: this design's layout has no rows and columns; give positions as marker, "
            "u,v or x_mm,y_mm,z_mm",
        )
    row, column = log.numbers["row"], log.numbers["column"]
    known = {
        (int(r), int(c)): number
        for number, (r, c) in enumerate(zip(markers.row, markers.column, strict=True))
    }
    there = np.isfinite(row) & np.isfinite(column)
    out = np.full(len(row), -1, dtype=np.int64)
    out[there] = [
        known.get((int(r), int(c)), -1) for r, c in zip(row[there], column[there], strict=True)
    ]
    log.note(
        there & (out < 0),
        lambda k: f"no marker stands in row {row[k]:g}, column {column[k]:g}",
    )
    return out


def _on_surface(
    log: RigLog,
    points_mm: FloatArray,
    design: Design,
    surface: Surface,
    off_mm: float,
) -> FloatArray:
    """Nearest places (r, 2) of points (r, 3) on the outer face; NaN for those too far off."""
    lengths = {"m": 1000.0, "cm": 10.0, "inches": 25.4, "µm": 0.001}
    given = np.isfinite(points_mm).all(axis=1)
    uv, away = _nearest_places(points_mm[given], design, surface)
    far = away > off_mm
    if len(far) and far.mean() > 0.5:
        for unit, times in lengths.items():
            if (
                np.mean(_nearest_places(points_mm[given] * times, design, surface)[1] > off_mm)
                < 0.1
            ):
                raise InputError(
                    "rig-position-unit",
                    f"{log.path}: positions lie off the surface, but as {unit} most lie on it; "
                    f"columns x_mm, y_mm, z_mm are in mm: multiply them by {times:g}",
                )
    out, gap = np.full((len(points_mm), 2), np.nan), np.zeros(len(points_mm))
    out[given] = np.where(far[:, None], np.nan, uv)
    gap[given] = away
    log.note(
        gap > off_mm,
        lambda k: (
            f"({points_mm[k, 0]:g}, {points_mm[k, 1]:g}, {points_mm[k, 2]:g}) mm is "
            f"{gap[k]:.3g} mm off the surface (at most {off_mm:g}); positions are in the sensor's "
            "frame, origin in the middle of the near rim"
        ),
    )
    return out


def _nearest_places(
    points_mm: FloatArray, design: Design, surface: Surface
) -> tuple[FloatArray, FloatArray]:
    """Nearest places (m, 2) within the surface's edges, and how far off the wall they are, mm."""
    uv = surface.chart(points_mm)
    low, high = surface.domain.T
    uv = np.where(np.array(surface.periodic), uv, np.clip(uv, low, high))
    step = points_mm - surface.point(uv)
    height = np.sum(step * surface.normal(uv), axis=1)
    aside = np.sqrt(np.maximum(np.sum(step**2, axis=1) - height**2, 0.0))
    inward = np.maximum(-height - design.wall.thickness_mm, 0.0)
    away = np.hypot(aside, np.maximum(height, 0.0) + inward)
    return uv, np.where(np.isfinite(away), away, np.inf)


def _forces(
    log: RigLog, design: Design, surface: Surface, uv: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Normal force (r,) N, positive inward, and tangential over normal force (r, 2)."""
    force_units = {"mN": 1e-3, "g": 9.80665e-3}
    ratio_max = 10.0  # of the forces' median over the sensor's greatest; above it is another unit
    numbers = log.numbers
    friction = np.zeros((len(uv), 2))
    if "force_N" in numbers:
        force, turn = numbers["force_N"], "force_N counts pushes on the sensor as positive"
    else:
        vector = np.column_stack([numbers[name] for name in ("fx_N", "fy_N", "fz_N")])
        place = np.where(np.isfinite(uv), uv, surface.domain.mean(axis=1))
        normal, along = surface.normal(place), surface.tangents(place)[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        force = -np.sum(vector * normal, axis=1)
        aside = np.column_stack(
            [np.sum(vector * axis, axis=1) for axis in (along, np.cross(normal, along))]
        )
        pushed = force > 0.0
        friction[pushed] = aside[pushed] / force[pushed, None]
        # Without a place a force has no normal.
        force = np.where(np.isfinite(uv).all(axis=1) | ~vector.any(axis=1), force, np.nan)
        turn = "fx_N, fy_N, fz_N are the force on the sensor, in the sensor's frame"
    known = np.isfinite(force) & (force != 0.0)
    if known.any() and np.mean(force[known] < 0.0) > 0.5:
        raise InputError(
            "rig-force-sign",
            f"{log.path}: most forces pull outward; {turn}: if the load cell gives its own "
            "reaction, turn the sign",
        )
    most = design.training.force_max_N
    middle = float(np.median(force[known])) if known.any() else 0.0
    if middle > ratio_max * most:
        fits = [unit for unit, times in force_units.items() if middle * times <= most]
        guess = f"in {' or '.join(fits)} they would fit; " if fits else ""
        raise InputError(
            "rig-force-unit",
            f"{log.path}: half of the forces are above {middle:g} N, and the sensor is made for up "
            f"to {most:g} N; {guess}convert them to N",
        )
    log.note(
        np.nan_to_num(force) > ratio_max * most,
        lambda k: (
            f"a force of {force[k]:g} N, and the sensor is made for up to {most:g} N; correct or "
            "remove the row, or raise training.force_max_N"
        ),
    )
    log.note(
        np.nan_to_num(force) < 0.0,
        lambda k: f"the force pulls outward ({force[k]:g} N); {turn}",
    )
    slip = np.linalg.norm(friction, axis=1) > FRICTION_MAX
    log.note(
        slip,
        lambda k: (
            f"the force is mostly along the surface ({np.linalg.norm(friction[k]):.3g} times its "
            "normal part); is it in the sensor's frame?"
        ),
    )
    return np.where(slip, np.nan, force), friction
