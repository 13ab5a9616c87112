"""Section through one receptor with its switch in place, drawn larger than life."""

import numpy as np

from phytac_design.core.figures import svg
from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.paint_map import INKS, POINTS, sheet_of_paper, write
from phytac_design.fabrication.inserts.insert_solids import insert_profile
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout import Markers


def section_svg(
    design: Design, markers: Markers, switches: SwitchSet, *, scale: float = 8.0
) -> str:
    """SVG of the section of a receptor of median height: outer face on top, tube downwards."""
    around_mm = 4.5  # half of the wall that is shown
    resin, rubber = "#d6d0c4", "#ecdeb0"
    marker = int(np.argsort(markers.height_mm, kind="stable")[markers.count // 2])
    kind = (int(switches.bowl[marker]), int(switches.length[marker]))
    wall, tall = design.wall.thickness_mm, float(markers.height_mm[marker])
    receptor, colour = design.receptor, design.layout.colours[markers.colour[marker]]
    outer, hole = 0.5 * receptor.diameter_outer_mm, 0.5 * receptor.diameter_hole_mm
    profile = switches.profile(kind)
    top = float(profile[:, 1].max())
    half = max(around_mm, 0.5 * design.switch.footprint_diameter_mm + 1.5)
    band, end = min(receptor.band_marker_mm, tall), wall + tall
    width, height = scale * (2.0 * half + 14.0), scale * (top + end + 3.0)
    figure, axes = sheet_of_paper(width, height)
    # In millimetres of the receptor: its axis at x = 0, the outer face at y = 0.
    axes.set(xlim=(-half - 1.0, half + 13.0), ylim=(end + 1.5, -top - 1.5))

    def fill(points: list[tuple[float, float]], ink: str) -> None:
        axes.fill(*np.transpose(points), facecolor=ink, edgecolor="#000000", linewidth=0.2 * POINTS)

    for side in (-1.0, 1.0):
        if receptor.has_inserts:
            shell, insert = _insert_section(design, wall, tall, half)
            fill([(side * x, y) for x, y in shell], resin)
            fill([(side * x, y) for x, y in insert], INKS[colour])
            continue
        for far, low, high, ink in (
            (half, 0.0, wall, resin),
            (outer, wall, end - band, resin),
            (outer, end - band, end, INKS[colour]),
        ):
            x0, x1 = side * hole, side * far
            fill([(x0, low), (x1, low), (x1, high), (x0, high)], ink)
    fill([*(profile * [1.0, -1.0]), *(profile[::-1] * [-1.0, -1.0])], rubber)
    radius, deep = float(profile[-2, 0]), -float(profile[-2, 1])
    tip = [(-radius, deep - 1.0), (radius, deep - 1.0), (radius, deep), (-radius, deep)]
    fill(tip, INKS["red"])
    words = (
        (-0.6 * top, f"switch {switches.label(kind)}, {switches.family(kind[0])} outside"),
        (0.5 * wall, f"glue under the {switches.family(kind[0])}'s rim"),
        (end - 0.5 * band, f"{'insert,' if receptor.has_inserts else 'painted'} {colour}"),
        (end + 0.9, "red tip, towards the inside"),
    )
    for y, text in words:
        write(axes, (half + 1.0, y), text, 5.0)
    return svg(figure)


def _insert_section(
    design: Design, wall: float, tall: float, half: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Corners (x, y) mm of the shell and of the insert, right of the axis."""
    receptor = design.receptor
    bore, seat = receptor.diameter_bore_mm / 2.0, receptor.diameter_seat_mm / 2.0
    tube, foot = receptor.diameter_tube_mm / 2.0, wall + max(tall - receptor.band_marker_mm, 0.0)
    shell = [(seat, 0.0), (half, 0.0), (half, wall), (tube, wall), (tube, foot)]
    shell += [(bore, foot), (bore, receptor.depth_seat_mm)]
    insert = [(float(x), float(y)) for x, y in insert_profile(receptor, wall + tall)]
    return shell, insert
