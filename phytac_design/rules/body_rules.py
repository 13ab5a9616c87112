"""Rules on the bodies before the camera, and on where cameras stand: nothing runs into anything."""

import numpy as np

from phytac_design.design.safe_rounding import at_least
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_mesh
from phytac_design.geometry.overlaps import distance_mm, tube_overlaps_mm, within
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.render_scene import fixture_mesh
from phytac_design.rules.refusal import refuse
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

ROUND = 1e-3
"""Tolerance of a rod's polygon, as a share of a tube's radius."""
TOUCH = 1e-6
"""Bodies that overlap by no more than this share of their size only touch."""
FINE = 0.1
"""The wall is looked for to this share of its thickness between a body's corners."""


def check_fixtures(sensor: Sensor) -> None:
    """Check that fixtures keep clear of receptors and wall, and the light bar of the wall."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    tolerance = ROUND * design.receptor.diameter_outer_mm / 2.0
    bar = bar_mesh(design, surface, tolerance_mm=tolerance)
    if len(bar.triangles):
        depth, place = wall_overlap_mm(design, surface, bar)
        # In a dome the bar's end is fitted to the wall by a few rays only.
        if depth > FINE * design.wall.thickness_mm:
            refuse(
                "light-bar-in-wall",
                f"the light bar reaches {_mm(depth)} into the wall at {_at(place)} (radius "
                f"{design.light.bar_radius_mm:g} mm); lower light.bar_radius_mm, or set it to 0 "
                "for no bar",
            )
    for fixture in design.fixtures:
        mesh = fixture_mesh(fixture, tolerance_mm=tolerance)
        _check_receptors(design, markers, mesh, fixture.name)
        depth, place = wall_overlap_mm(design, surface, mesh)
        if depth > 0.0:
            through = depth >= design.wall.thickness_mm * (1.0 - TOUCH)
            how = "goes through the wall" if through else f"reaches {_mm(depth)} into the wall"
            refuse(
                "fixture-in-wall",
                f"the fixture {fixture.name!r} {how} ({design.wall.thickness_mm:g} mm thick) at "
                f"{_at(place)}; move it inward or make it smaller",
            )


def _check_receptors(design: Design, markers: Markers, mesh: TriangleMesh, name: str) -> None:
    """Refuse a fixture in a tube, or in the way of a red tip."""
    out = design.tip_travel_mm
    parts = (
        ("receptor", markers.tip_mm, design.receptor.diameter_tube_mm / 2.0),
        (
            "pushed-out red tip of receptor",
            markers.tip_mm + out * markers.direction,
            design.switch.tip_diameter_mm / 2.0,
        ),
    )
    for what, end, radius in parts:
        depth = tube_overlaps_mm(markers.base_mm, end, radius, mesh)
        depth = np.where(within(end, mesh), np.maximum(depth, radius), depth)
        met = depth > TOUCH * radius
        if not met.any():
            continue
        worst = int(np.argmax(np.round(depth, 9)))
        more = int(met.sum()) - 1
        others = f", and {more} more by less" if more else ""
        refuse(
            "fixture-overlaps-receptor",
            f"the fixture {name!r} overlaps the {what} {markers.name(worst)} by "
            f"{_mm(depth[worst])}{others}; move it away from there by more than that, make it "
            "smaller, or lower the receptors' height",
        )


def wall_overlap_mm(
    design: Design, surface: Surface, mesh: TriangleMesh
) -> tuple[float, FloatArray]:
    """How far a body's surface reaches into the sensing wall, 0 to its thickness, mm; and where.

    Pieces of triangles are halved wherever the wall may be nearer than they are large, down to
    ``FINE`` of the wall's thickness.
    """
    once_hit = 0.1  # share of them that is looked at if the wall was met, for how deep it is
    # Pieces of a body's surface that are looked at: enough unless it runs close along a wall.
    pieces_max = 100_000
    thickness = design.wall.thickness_mm
    pieces = mesh.vertices_mm[mesh.triangles]
    depth, _ = _wall_depth_mm(surface, thickness, mesh.vertices_mm)
    best, place = float(depth.max()), mesh.vertices_mm[int(depth.argmax())]
    seen = 0
    while len(pieces) and seen <= pieces_max * (once_hit if best > 0.0 else 1.0):
        seen += len(pieces)
        middle = pieces.mean(axis=1)
        size = np.linalg.norm(pieces - middle[:, None], axis=2).max(axis=1)
        depth, away = _wall_depth_mm(surface, thickness, middle)
        found = float(depth.max(initial=0.0))
        if found > best:
            best, place = found, middle[int(depth.argmax())]
        if best >= thickness:
            break
        pieces = _halved(pieces[(away < size) & (size > FINE * thickness)])
    return (best if best > TOUCH * thickness else 0.0), place


def _wall_depth_mm(
    surface: Surface, thickness: float, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Depth of points (n, 3) in the wall below its inner face, 0 outside of it; how far it is."""
    below, on_wall, away = _below_inner_face(surface, thickness, points)
    inside = on_wall & (below > 0.0) & (below <= thickness)
    return np.where(inside, below, 0.0), np.where(inside, 0.0, away)


def _below_inner_face(
    surface: Surface, thickness: float, points: FloatArray
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Way of points (n, 3) from the inner face outward, and whether the surface is under them.

    The last is a bound from below on their distance from the wall, (n,) mm.
    """
    foot = surface.chart(points)
    height = np.sum((points - surface.point(foot)) * surface.normal(foot), axis=1)
    low, high = surface.domain[:, 0], surface.domain[:, 1]
    on_wall = np.asarray(((foot >= low) & (foot <= high)).all(axis=1))
    away = np.maximum(np.maximum(height, -thickness - height), 0.0)
    return height + thickness, on_wall, away


def _halved(pieces: FloatArray) -> FloatArray:
    """Triangles (k, 3, 3) cut in two across their longest edge, (2 k, 3, 3)."""
    edge = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=2).argmax(axis=1)
    order = (edge[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(np.take_along_axis(pieces, order[:, :, None], axis=1), 1, 0)
    middle = (a + b) / 2.0
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def check_cameras(sensor: Sensor) -> None:
    """Check that no camera's centre lies in a receptor, in a fixture, or behind the wall."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    tolerance = ROUND * design.receptor.diameter_outer_mm / 2.0
    bodies = [(f.name, fixture_mesh(f, tolerance_mm=tolerance)) for f in design.fixtures]
    for camera in sensor.cameras:
        centre = camera.position_mm
        place = f"its centre is at {_at(centre)}"
        _check_tubes(design, markers, centre, place)
        for name, mesh in bodies:
            gap = distance_mm(centre, mesh)
            inside = bool(within(centre[None], mesh)[0])
            if inside or gap <= TOUCH * design.wall.thickness_mm:
                refuse(
                    "camera-on-fixture",
                    f"the camera stands {'inside' if inside else 'on'} the fixture {name!r} "
                    f"({place}, {_mm(gap)} {'below' if inside else 'from'} its surface); move "
                    "the fixture or change camera.stand_off_mm",
                )
        below, on_wall, _ = _below_inner_face(surface, design.wall.thickness_mm, centre[None])
        if on_wall[0] and below[0] >= 0.0:
            refuse(
                "camera-inside-wall",
                f"the camera stands in or behind the wall ({place}, {_mm(below[0])} beyond the "
                "inner face); raise camera.stand_off_mm by more than that",
            )


def _check_tubes(design: Design, markers: Markers, centre: FloatArray, place: str) -> None:
    """Refuse a camera in a tube or before a red tip."""
    arm = centre - markers.base_mm
    along = np.sum(arm * markers.direction, axis=1)
    aside = np.linalg.norm(arm - along[:, None] * markers.direction, axis=1)
    out = design.tip_travel_mm
    tube = (along <= markers.height_mm) & (aside <= design.receptor.diameter_tube_mm / 2.0)
    red = (along <= markers.height_mm + out) & (aside <= design.switch.tip_diameter_mm / 2.0)
    hit = np.flatnonzero((along >= 0.0) & (tube | red))
    if hit.size:
        worst = int(hit[aside[hit].argmin()])
        reach = markers.height_mm[worst] + out - along[worst]
        refuse(
            "camera-inside-receptor",
            f"the camera stands inside the receptor {markers.name(worst)} ({place}, "
            f"{_mm(aside[worst])} from the tube's axis and {_mm(reach)} below where its red tip "
            'comes out to); raise camera.stand_off_mm by more than that, or set it to "fit"',
        )


def _mm(length: float) -> str:
    """Length for a message, rounded up: users move things by more than that."""
    rounded = at_least(round(length, 6), 3 if length >= 1.0 else 2)
    return f"{float(rounded):.2f} mm" if 1.0 <= length < 10.0 else f"{rounded} mm"


def _at(place: FloatArray) -> str:
    """Coordinates for a message."""
    return "(" + ", ".join(f"{round(float(value), 2) + 0.0:.2f}" for value in place) + ") mm"
