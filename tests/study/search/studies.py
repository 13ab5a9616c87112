"""Small studies for tests: a design whose levels take a few hundredths of a second."""

from pathlib import Path
from typing import Any

from phytac_design.study.search.design_space import DesignSpace, make_space
from phytac_design.study.search.study_file import Study
from tests.designs import small

DATA: dict[str, Any] = {
    "name": "tiny",
    "design": "cylinder60",
    "seed": 3,
    "variable": [
        {"field": "layout.rows", "low": 4, "high": 12},
        {"field": "layout.columns", "low": 8, "high": 20, "step": 2},
        {"field": "wall.thickness_mm", "low": 0.5, "high": 1.5},
    ],
    "constraint": [{"measure": "marker_count", "max": 200}],
    "objective": [
        {"measure": "marker_count", "goal": "max"},
        {"measure": "mass_g", "goal": "min"},
    ],
    "budget": {"candidates": 24},
    "sampling": {"batch": 8, "start": 8},
}


def tiny(**changes: Any) -> Study:
    """A study of the small design; tables in ``changes`` take the place of its own."""
    return Study.model_validate(DATA | changes)


def space_of(study: Study) -> DesignSpace:
    """Its space, around the small design."""
    return make_space(study, Path(), small())
