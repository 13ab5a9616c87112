"""Section through one receptor with its switch in place, drawn larger than life."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.paint_map import INKS
from phytac_design.fabrication.documents.sheet_drawing import (
    DrawnLine,
    Item,
    Layer,
    Page,
    Text,
    svg_text,
)
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout import Markers
from phytac_shapes.arrays import FloatArray

SCALE = 8.0
RESIN, RUBBER = "#d6d0c4", "#ecdeb0"


def section_svg(design: Design, markers: Markers, switches: SwitchSet) -> str:
    """SVG of the section of a receptor of median height: outer face on top, tube downwards."""
    around_mm = 4.5  # half of the wall that is shown
    marker = int(np.argsort(markers.height_mm, kind="stable")[markers.count // 2])
    kind = (int(switches.bowl[marker]), int(switches.length[marker]))
    wall, tall = design.wall.thickness_mm, float(markers.height_mm[marker])
    outer, hole = (
        0.5 * design.receptor.diameter_outer_mm,
        0.5 * design.receptor.diameter_hole_mm,
    )
    profile = switches.profile(kind)
    top = float(profile[:, 1].max())
    half = max(around_mm, 0.5 * design.switch.footprint_diameter_mm + 1.5)
    band = min(design.receptor.band_marker_mm, tall)
    end = wall + tall
    paint = INKS[design.layout.colours[markers.colour[marker]]]
    items: list[Item] = []
    for side in (-1.0, 1.0):
        items.append(_box(side, (hole, half), (0.0, wall), RESIN))
        items.append(_box(side, (hole, outer), (wall, end - band), RESIN))
        items.append(_box(side, (hole, outer), (end - band, end), paint))
    stem = profile[-2:]
    points = np.concatenate([profile, profile[::-1] * [-1.0, 1.0]]) * [1.0, -1.0]
    items.append(DrawnLine(points=points, closed=True, fill=RUBBER, width_mm=0.02))
    radius, deep = float(stem[0, 0]), -float(stem[0, 1])
    items.append(_box(1.0, (-radius, radius), (deep - 1.0, deep), INKS["red"]))
    shift = np.array([half + 1.0, top + 1.5])
    scaled = [_scaled(item.moved(shift)) for item in items]
    width, height = SCALE * (2.0 * half + 14.0), SCALE * (top + end + 3.0)
    words = [
        (0.0, -0.6 * top, f"switch {switches.label(kind)}, bowl outside"),
        (0.0, 0.5 * wall, "glue under the bowl's rim"),
        (0.0, end - 0.5 * band, f"painted {design.layout.colours[markers.colour[marker]]}"),
        (0.0, end + 0.9, "red tip, towards the inside"),
    ]
    at = [SCALE * np.array([2.0 * half + 2.0, y + shift[1]]) for _, y, _ in words]
    texts = [Text(at=a, text=w[2], size_mm=5.0) for a, w in zip(at, words, strict=True)]
    page = Page(width_mm=width, height_mm=height, layers=[Layer(items=[*scaled, *texts])])
    return svg_text(page)


def _box(
    side: float, across: tuple[float, float], deep: tuple[float, float], fill: str
) -> DrawnLine:
    (x0, x1), (y0, y1) = across, deep
    points = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) * [side, 1.0]
    return DrawnLine(points=points, closed=True, fill=fill, width_mm=0.02)


def _scaled(item: Item) -> Item:
    if not isinstance(item, DrawnLine):
        return item
    points: FloatArray = item.points * SCALE
    return DrawnLine(
        points=points, closed=item.closed, stroke=item.stroke, fill=item.fill, width_mm=0.2
    )
