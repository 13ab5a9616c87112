"""The fast subset of ``verification``, designs drawn at random, and how a case is evaluated."""

import warnings
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import verification
from phytac_shapes import REGISTRY
from phytac_shapes.errors import DesignError
from verification.case import Case, Cases, Evidence, Expect, Outcome, evaluate, unreadable
from verification.test_random_designs import random_cases

MODULES = [
    import_module(f"verification.{path.stem}")
    for path in sorted(Path(verification.__file__).parent.glob("test_*.py"))
]
GROUPS: dict[str, Cases] = {module.__name__: module.CASES for module in MODULES}


SLOW = (
    *("hyperboloid clamped at its ends, t/L 0.01", "free hyperboloid, t/L 0.1"),
    "presses on cuboid",
)
"""Claims of the mesh's error against much finer meshes: the first on shells like a third's, the
last as ``tests/mechanics/test_press.py`` checks it on a cylinder."""


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=case.name, marks=[pytest.mark.long] * (case.name in SLOW))
        for cases in GROUPS.values()
        for case in cases.fast()
    ],
)
def test_fast_subset(case: Case) -> None:
    outcome = evaluate(case)
    assert outcome.verdict != "wrong", outcome.why


@settings(max_examples=12, deadline=None)
@given(shape=st.sampled_from(sorted(REGISTRY)), seed=st.integers(0, 2**31 - 1))
def test_random_designs_are_never_wrong(shape: str, seed: int) -> None:
    case = random_cases(1, seed=seed, shape=shape)[0]
    case.values["mesh"] = False
    outcome = evaluate(case)
    assert outcome.verdict != "wrong", outcome.why


def test_there_are_enough_cases_of_every_shape_and_no_two_alike() -> None:
    every = [case for cases in GROUPS.values() for case in cases]
    assert len(every) >= 1000
    for shape in REGISTRY:
        assert sum(case.shape == shape for case in every) >= 20
    for name, cases in GROUPS.items():
        assert len({case.name for case in cases}) == len(cases), name


GOOD = "the wall is too thin to print (0.3 mm < 0.4 mm); raise wall.thickness_mm to 0.4"


def outcome_of(check: Any, expect: Expect = "right") -> Outcome:
    return evaluate(Case(name="n", check=check, expect=expect))


def off_by(error: Any, tolerance: float = 1.0) -> Any:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("reference", error, tolerance)

    return check


def rejects(text: str) -> Any:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        raise DesignError("some-rule", text)

    return check


def test_right_is_within_every_tolerance() -> None:
    assert outcome_of(off_by([0.2, -0.9])).verdict == "right"
    assert outcome_of(off_by([0.2, -1.1])).verdict == "wrong"
    # max() must not hide a NaN among the numbers.
    for bad in (np.nan, np.inf):
        assert outcome_of(off_by([0.2, bad, 0.1])).verdict == "wrong"


def test_an_answer_without_a_reference_is_wrong() -> None:
    assert outcome_of(lambda _, __: None).why == "nothing was compared with anything"


def test_arrays_of_another_shape_are_wrong() -> None:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.close("reference", np.zeros((3, 2)), np.zeros(2), 1.0)

    assert "shape (3, 2), not (2,)" in outcome_of(check).why


def test_statements_count_those_that_do_not_hold() -> None:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.true("all positive", np.array([True, False, False]))

    assert "off by 2 (at most 0)" in outcome_of(check).why


def test_crashes_and_warnings_are_wrong() -> None:
    def crash(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("reference", 0.0, 1.0)
        raise ZeroDivisionError("by zero")

    def warn(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("reference", 0.0, 1.0)
        warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)

    assert outcome_of(crash).why == "crashed: ZeroDivisionError: by zero"
    assert outcome_of(warn).why == "warned: RuntimeWarning: divide by zero"
    assert outcome_of(warn, "refused").verdict == "wrong"


def test_errors_count_where_the_case_permits_them() -> None:
    assert outcome_of(rejects(GOOD), "refused").verdict == "refused"
    assert outcome_of(rejects(GOOD), "either").verdict == "refused"
    assert outcome_of(rejects(GOOD), "right").why.startswith("refused, though it is possible")
    assert outcome_of(off_by(0.0), "refused").why == "not refused"
    assert outcome_of(off_by(0.0), "either").verdict == "right"


def test_findings_before_an_error_count() -> None:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("the message's figure", 0.5, 0.1)
        raise DesignError("some-rule", GOOD)

    assert "the message's figure" in outcome_of(check, "refused").why


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (GOOD, ""),
        ("camera.fill: input should be greater than 0.05 (got nan)", ""),
        ("", "is empty"),
        ("Traceback (most recent call last): 3", "the program's own 'Traceback'"),
        ("cannot read 'a.csv': ValueError; give another", "the program's own 'ValueError'"),
        ("x.toml: got <class 'int'> 3; set it", "the program's own '<class"),
        ("the error is nan of 3; lower it", "not a number"),
        ("the design is bad; lower something", "neither a number nor a field"),
        ("the wall is 0.3 mm thick", "does not name the fix"),
        ("lower it: 3 " * 100, "1199 characters long"),
    ],
)
def test_readable(message: str, why: str) -> None:
    assert why in unreadable(message)
    assert bool(why) == bool(unreadable(message))
