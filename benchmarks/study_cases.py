"""The design spaces that search is measured on: cylinder, cone and hemisphere."""

import os
from pathlib import Path
from typing import Any

from phytac_design.core.threads import THREADS
from phytac_design.study.search.design_space import DesignSpace, Params, make_space
from phytac_design.study.search.sampler import sobol
from phytac_design.study.search.study_file import Study

THIN = {
    "receptor.diameter_outer_mm": 2.4,
    "receptor.diameter_hole_mm": 1.4,
    "switch.footprint_diameter_mm": 3.8,
    "switch.tip_diameter_mm": 1.0,
}
WALL = {"field": "wall.thickness_mm", "low": 0.5, "high": 1.5}
BAND = {"field": "receptor.band_marker_mm", "low": 0.3, "high": 1.5}
POWER = {"field": "layout.height_exponent", "low": 1.0, "high": 4.0}
SPACES: dict[str, dict[str, Any]] = {
    "cylinder": {
        "design": "cylinder60",
        "fixed": THIN | {"layout.heights": "power"},
        "variable": [
            {"field": "layout.rows", "low": 12, "high": 31},
            {"field": "layout.columns", "low": 8, "high": 28, "step": 2},
            {"field": "layout.spiral_angle_deg", "low": 30.0, "high": 70.0},
            {"field": "layout.height_far_mm", "low": 6.0, "high": 14.0},
            {"field": "shape.length_mm", "low": 90.0, "high": 120.0},
            POWER,
            WALL,
            BAND,
        ],
    },
    "cone": {
        "design": "cone",
        "fixed": {"switch.footprint_diameter_mm": 3.8},
        "variable": [
            {"field": "layout.rows", "low": 8, "high": 20},
            {"field": "layout.columns", "low": 8, "high": 22, "step": 2},
            {"field": "layout.height_far_mm", "low": 3.0, "high": 9.0},
            {"field": "shape.diameter_far_mm", "low": 30.0, "high": 50.0},
            POWER,
            WALL,
            BAND,
        ],
    },
    "hemisphere": {
        "design": "hemisphere",
        "variable": [
            {"field": "layout.count", "low": 40, "high": 110},
            {"field": "layout.height_near_mm", "low": 0.8, "high": 2.5},
            {"field": "shape.diameter_outer_mm", "low": 36.0, "high": 60.0},
            WALL,
            BAND,
        ],
    },
}


def study_of(shape: str, **tables: Any) -> tuple[Study, DesignSpace]:
    """Study and space of a shape."""
    study = Study.model_validate({"name": f"bench-{shape}", **SPACES[shape], **tables})
    return study, make_space(study, Path())


def drawn(study: Study, space: DesignSpace, count: int, first: int = 0) -> list[Params]:
    """Candidates of a space, spread evenly."""
    return [space.params(share) for share in sobol(len(space.axes), study.seed, first, count)]


def one_thread() -> None:
    """Kernels of this process on one thread: figures are per core."""
    os.environ[THREADS] = "1"
