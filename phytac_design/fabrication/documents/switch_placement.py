"""Table of the switch of each marker."""

import numpy as np

from phytac_design.fabrication.bill import csv_text
from phytac_design.fabrication.documents.paint_map import PaintMap
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout import Markers
from phytac_shapes import Surface

COLUMNS = (
    "marker",
    "row",
    "column",
    "paint",
    "switch",
    "threshold_N",
    "length_mm",
    "x_mm",
    "y_mm",
    "z_mm",
    "map_x_mm",
    "map_y_mm",
    "map_scale_least",
    "map_scale_most",
)
"""Point on the outer face; place on the paint map (around, along); local scale of the map."""


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
    return csv_text(COLUMNS, rows)
