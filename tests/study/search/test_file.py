"""Study files: what they refuse before anything runs, and what they make of ranges."""

from collections.abc import Callable
from pathlib import Path

import pytest

from phytac_design.study.search.design_space import make_space
from phytac_design.study.search.measures import LEVELS, MEASURES, best_proxy
from phytac_design.study.search.study_file import (
    STUDY_FILES,
    load_study,
    parse_study,
    shipped_studies,
)
from phytac_shapes.errors import DesignError
from tests.designs import small
from tests.refusals import refused
from tests.study.search.studies import space_of, tiny

HEAD = 'name = "s"\ndesign = "cylinder60"\n'
ROWS = '[[variable]]\nfield = "layout.rows"\nlow = 4\nhigh = 8\n'


def variable(field: str, rest: str = "low = 1\nhigh = 2") -> str:
    return f'[[variable]]\nfield = "{field}"\n{rest}\n'


REFUSED: dict[str, tuple[str, str]] = {
    "no variable": (HEAD, "variable is missing"),
    "not TOML": ("name = ", "is not TOML"),
    "unknown key": (HEAD + ROWS + "[budget]\ncandidate = 3\n", "did you mean 'candidates'"),
    "empty range": (HEAD + variable("layout.rows", "low = 5\nhigh = 5"), "the range is empty"),
    "no range": (HEAD + variable("layout.rows", ""), "give low and high, or choices"),
    "log from 0": (
        HEAD + variable("wall.thickness_mm", 'low = 0.0\nhigh = 1.0\nscale = "log"'),
        "needs low above 0",
    ),
    "both": (
        HEAD + variable("layout.rows", "low = 1\nhigh = 2\nchoices = [1]"),
        "choices exclude",
    ),
    "twice": (HEAD + ROWS + ROWS, "is there twice"),
    "fixed and variable": (
        HEAD + ROWS + '[fixed]\n"layout.rows" = 5\n',
        "both fixed and variable",
    ),
    "unknown measure": (
        HEAD + ROWS + '[[objective]]\nmeasure = "marker_cuont"\ngoal = "max"\n',
        "did you mean 'marker_count'",
    ),
    "not to be had": (
        HEAD + ROWS + '[[objective]]\nmeasure = "mass_g"\ngoal = "most"\n',
        "objective.0.goal: input should be",
    ),
    "contradiction": (
        HEAD
        + ROWS
        + '[[constraint]]\nmeasure = "mass_g"\nmin = 9\n'
        + '[[constraint]]\nmeasure = "mass_g"\nmax = 8\n',
        "contradict each other",
    ),
    "beyond its range": (
        HEAD + ROWS + '[[constraint]]\nmeasure = "visible_least"\nmin = 1.2\n',
        "contradict each other",
    ),
    "no bound": (HEAD + ROWS + '[[constraint]]\nmeasure = "mass_g"\n', "give min, max or both"),
    "unknown level": (
        HEAD + ROWS + '[ladder]\nrungs = ["rules", "exat"]\n',
        "did you mean 'exact'",
    ),
    "wrong order": (
        HEAD + ROWS + '[ladder]\nrungs = ["rules", "exact", "sampled"]\n',
        "must begin with 'rules' and ascend",
    ),
    "not measured": (
        HEAD
        + ROWS
        + '[[objective]]\nmeasure = "gap_px"\ngoal = "max"\n[ladder]\nrungs = ["rules"]\n',
        "no level of ladder.rungs measures gap_px",
    ),
    "blind press": (
        HEAD + ROWS + '[ladder]\nrungs = ["rules", "load"]\n',
        "need the results of 'exact'",
    ),
    "share of nothing": (HEAD + ROWS + "[ladder.share]\nrules = 0.0\n", "must lie in (0, 1]"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_a_bad_study_is_refused_with_the_reason(case: str) -> None:
    text, words = REFUSED[case]
    with pytest.raises(DesignError) as caught:
        parse_study(STUDY_FILES.parse(text, "s.toml"), "s.toml")
    assert words in str(caught.value)


FIELDS: dict[str, tuple[str, str]] = {
    "layuot.rows": ("low = 1\nhigh = 2", "did you mean 'layout'"),
    "layout.row": ("low = 1\nhigh = 2", "did you mean 'layout.rows'"),
    "layout.rows.first": ("low = 1\nhigh = 2", "has no parts"),
    "layout.rows": ("low = 0\nhigh = 5", "cannot be 0"),
    "layout.columns": ("low = 1.5\nhigh = 5", "is a whole number"),
    "layout.kind": ('choices = ["spiral", "spirals"]', "cannot be 'spirals'"),
    "material.poisson": ("low = 0.3\nhigh = 0.6", "cannot be 0.6"),
}


@pytest.mark.parametrize("field", sorted(FIELDS))
def test_a_field_that_does_not_take_its_values_is_refused(field: str) -> None:
    rest, words = FIELDS[field]
    study = parse_study(STUDY_FILES.parse(HEAD + variable(field, rest), "s.toml"), "s.toml")
    with pytest.raises(DesignError) as caught:
        make_space(study, Path(), small())
    assert words in str(caught.value)


def test_levels_are_those_that_are_needed() -> None:
    assert tiny().levels == ("rules",)
    asked = tiny(constraint=[{"measure": "force_sd_N", "max": 1.0}])
    assert asked.levels == ("rules", "sampled", "exact", "mechanics")
    gap = tiny(ladder={"share": {"sampled": 0.5}}, objective=[{"measure": "gap_px", "goal": "max"}])
    assert gap.level_groups() == [("rules", "sampled"), ("exact",)]


def test_measures_name_levels_and_cheaper_proxies() -> None:
    for name, measure in MEASURES.items():
        if measure.proxy:
            earlier = MEASURES[measure.proxy].rung
            assert LEVELS.index(earlier) < LEVELS.index(measure.rung), name
    assert best_proxy("force_error", frozenset({"surrogate_force_sd_N"})) == "surrogate_force_sd_N"
    assert best_proxy("crosstalk_px", frozenset({"gap_px"})) == ""


AT: list[tuple[dict[str, object], list[object]]] = [
    ({"field": "layout.rows", "low": 4, "high": 6}, [4, 5, 6]),
    ({"field": "layout.rows", "low": 4, "high": 7, "step": 2}, [4, 6]),
    ({"field": "wall.thickness_mm", "low": 1.0, "high": 1.5, "step": 0.25}, [1.0, 1.25, 1.5]),
    ({"field": "layout.kind", "choices": ["spiral", "straight"]}, ["spiral", "straight"]),
]


@pytest.mark.parametrize(("data", "values"), AT)
def test_values_of_steps_and_choices_are_equally_wide(
    data: dict[str, object], values: list[object]
) -> None:
    (axis,) = space_of(tiny(variable=[data])).axes
    shares = [(number + 0.5) / len(values) for number in range(len(values))]
    assert [axis.at(share) for share in shares] == values
    assert axis.at(0.0) == values[0]
    assert axis.at(1.0) == values[-1]
    assert list(axis.grid()) == values


def test_a_logarithmic_range_is_even_by_ratio() -> None:
    data = {"field": "material.modulus_MPa", "low": 10.0, "high": 1000.0, "scale": "log"}
    (axis,) = space_of(tiny(variable=[data])).axes
    assert axis.at(0.5) == pytest.approx(100.0)


def test_params_reach_the_design_and_its_lists() -> None:
    study = tiny(
        design="grip",
        variable=[{"field": "shape.diameters_mm.1", "low": 30.0, "high": 40.0}],
        fixed={"layout.columns": 10},
    )
    design = make_space(study, Path()).design({"shape.diameters_mm.1": 33.0}, name="other")
    assert design.shape.model_dump()["diameters_mm"][1] == 33.0
    assert (design.layout.columns, design.name) == (10, "other")


def test_identity_knows_what_a_study_is() -> None:
    same: list[Callable[[], str]] = [
        lambda: tiny(budget={"candidates": 99}).identity(),
        lambda: tiny(name="other", description="words").identity(),
    ]
    assert {one() for one in same} == {tiny().identity()}
    others = (tiny(seed=4), tiny(constraint=[]), tiny(ladder={"accuracy": "standard"}))
    assert tiny().identity() not in {other.identity() for other in others}


@pytest.mark.parametrize("name", shipped_studies())
def test_shipped_studies_are_whole(name: str) -> None:
    study, folder = load_study(name)
    space = make_space(study, folder)
    assert study.name == name
    assert study.description
    assert study.objective
    assert len(space.axes) == len(study.variable)


def test_an_unknown_study_says_which_there_are() -> None:
    with refused("toml-file-not-found"):
        load_study("densest")
