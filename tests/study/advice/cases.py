"""Small sensors with a known defect each."""

from functools import cache
from typing import Any

import numpy as np

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.study.advice.design_evaluation import EvaluatedDesign, evaluate_design
from phytac_design.study.advice.design_variables import as_explicit
from tests.designs import of_shape

DRAFT = PRESETS["draft"]
ROWS, COLUMNS = 5, 8


def tube(**tables: Any) -> Design:
    """ø40 × 35, 5 rows × 8 columns, straight: nothing hides."""
    layout = {
        "kind": "straight",
        "rows": ROWS,
        "columns": COLUMNS,
        "colour_pattern": "checkerboard",
        "height_near_mm": 0.8,
        "height_far_mm": 4.0,
    }
    size = {"diameter_outer_mm": 40.0, "length_mm": 35.0}
    layout |= tables.pop("layout", {})
    return of_shape("cylinder", size, layout, **tables)


def with_long_row(row: int, by_mm: float) -> Design:
    """The same, listed, with the receptors of one row too long: they hide the row behind."""
    design = tube()
    markers = make_markers(design, design.surface())
    data = as_explicit(Sensor(design)).model_dump(mode="json")
    heights = np.where(markers.row == row, markers.height_mm + by_mm, markers.height_mm)
    data["layout"]["position_heights_mm"] = heights.tolist()
    return parse_design(data, "long row")


@cache
def judged_tube() -> EvaluatedDesign:
    """The sensor without defect, evaluated."""
    return evaluate_design(tube(), DRAFT)
