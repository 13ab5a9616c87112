"""Strips on paper as they are cast, and their webs as they lie on the shell."""

from typing import Any

import numpy as np

from phytac_design.core.figures import svg
from phytac_design.fabrication.documents.paint_map import (
    POINTS,
    marker_numbers,
    sheet_of_paper,
    write,
)
from phytac_design.fabrication.molds.strip_layout import footprint
from phytac_design.fabrication.switch_strips import StripSet, SwitchStrip, kinds_of, strip_label
from phytac_design.geometry.triangles import TriangleMesh, grid_triangles, merged
from phytac_design.layout.sensor import Sensor
from phytac_shapes.arrays import FloatArray


def strips_svg(sensor: Sensor, strips: StripSet) -> str:
    """SVG of the different strips, 1:1, each with the markers of the first of its label."""
    gap_mm, label_mm = 3.0, 14.0
    shown = [strips.alike(number) for number in strips.numbers]
    wide = max(shape.diameter_mm for shape in strips.switches.bowls)
    prints = [footprint(alike[0], wide + gap_mm) for alike in shown]
    width = label_mm + max(each.size_mm[0] for each in prints)
    height = sum(float(each.size_mm[1]) for each in prints) + gap_mm
    figure, axes = sheet_of_paper(width, height)
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    names, y = marker_numbers(sensor.markers), height - gap_mm
    for alike, each in zip(shown, prints, strict=True):
        y -= float(each.size_mm[1])
        places = each.places_mm + np.array([label_mm, y])
        write(axes, (1.0, y + 0.5 * float(each.size_mm[1])), strip_label(alike[0].number), 4.0)
        _drawn(axes, strips, alike[0], places, [names[marker] for marker in alike[0].markers])
    return svg(figure)


def _drawn(
    axes: Any, strips: StripSet, strip: SwitchStrip, places: FloatArray, names: list[str]
) -> None:
    rubber = "#ecdeb0"
    pen: dict[str, Any] = {"facecolor": rubber, "edgecolor": "#000000", "linewidth": 0.15 * POINTS}
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for first, last in strip.bridges:
        way = places[last] - places[first]
        aside = np.array([-way[1], way[0]]) / np.hypot(*way)
        aside *= 0.5 * strips.section.web_width_mm
        corners = [places[first] - aside, places[last] - aside]
        corners += [places[last] + aside, places[first] + aside]
        axes.fill(*np.transpose(corners), **pen)
    for at, kind, name in zip(places, kinds_of(strip, strips.switches), names, strict=True):
        rim = 0.5 * strips.switches.bowls[kind[0]].diameter_mm
        axes.fill(*(at + rim * ring).T, **pen)
        write(axes, at.tolist(), name, 1.2, horizontalalignment="center")


def wrapped_webs(sensor: Sensor, strips: StripSet, *, pull_mm: float = 0.0) -> TriangleMesh:
    """Webs of all strips on the shell, one mesh of bars, moved out along the receptors' axes.

    Bars end at the switches' axes: they run through the bowls.
    """
    steps = 8
    surface, markers = sensor.surface, sensor.markers
    pairs = np.concatenate([strip.markers[strip.bridges] for strip in strips.webs])
    share = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
    ends = surface.point(markers.uv)
    chord = (1.0 - share) * ends[pairs[:, 0]] + share * ends[pairs[:, 1]]
    uv = surface.chart(chord.reshape(-1, 3))
    foot, normal = (each.reshape(chord.shape) for each in (surface.point(uv), surface.normal(uv)))
    axis = -markers.direction
    foot = foot + pull_mm * ((1.0 - share) * axis[pairs[:, 0]] + share * axis[pairs[:, 1]])
    along = np.gradient(foot, axis=0)
    aside = np.cross(normal, along)
    aside *= 0.5 * strips.section.web_width_mm / np.linalg.norm(aside, axis=2, keepdims=True)
    up = strips.section.web_mm * normal
    rings = np.stack([foot - aside, foot + aside, foot + aside + up, foot - aside + up], axis=2)
    ids = np.arange(4 * (steps + 1)).reshape(-1, 4)
    sides = grid_triangles(ids, closed=True)
    caps = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = np.concatenate([sides, caps, caps[:, ::-1] + ids[-1, 0]])
    return merged(
        [
            TriangleMesh(vertices_mm=rings[:, k].reshape(-1, 3), triangles=triangles)
            for k in range(len(pairs))
        ]
    )
