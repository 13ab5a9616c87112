"""Verdicts: what is right, refused, wrong; which refusals a person can read."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from phytac_design.study.stability.case import Case, Evidence, Expect, Outcome
from phytac_design.study.stability.judge import judge, unreadable
from phytac_shapes.errors import DesignError

GOOD = "the wall is too thin to print (0.3 mm < 0.4 mm); raise wall.thickness_mm to 0.4"


def verdict(check: Any, expect: Expect = "right") -> Outcome:
    case = Case(room="r", name="n", check="c", expect=expect, values={"a": 1})
    return judge(case, {"c": check})


def off_by(error: Any, tolerance: float = 1.0) -> Any:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("reference", error, tolerance)

    return check


def refuses(text: str) -> Any:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        raise DesignError(text)

    return check


def test_right_is_within_every_tolerance() -> None:
    assert verdict(off_by([0.2, -0.9])).verdict == "right"
    assert verdict(off_by([0.2, -1.1])).verdict == "wrong"
    # The largest of numbers among which one is none must not hide that one.
    for bad in (np.nan, np.inf):
        assert verdict(off_by([0.2, bad, 0.1])).verdict == "wrong"


def test_an_answer_held_against_nothing_is_wrong() -> None:
    outcome = verdict(lambda _, __: None)
    assert outcome.why == "nothing was held against anything"


def test_arrays_of_another_shape_are_wrong() -> None:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.close("reference", np.zeros((3, 2)), np.zeros(2), 1.0)

    assert "shape (3, 2), not (2,)" in verdict(check).why


def test_statements_count_what_does_not_hold() -> None:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.true("all positive", np.array([True, False, False]))

    assert "off by 2 (at most 0)" in verdict(check).why


def test_crashes_and_warnings_are_wrong() -> None:
    def crash(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("reference", 0.0, 1.0)
        raise ZeroDivisionError("by zero")

    def warn(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("reference", 0.0, 1.0)
        warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)

    assert verdict(crash).why == "crashed: ZeroDivisionError: by zero"
    assert verdict(warn).why == "warned: RuntimeWarning: divide by zero"
    assert verdict(warn, "refused").verdict == "wrong"


def test_refusals_where_they_may_be() -> None:
    assert verdict(refuses(GOOD), "refused").verdict == "refused"
    assert verdict(refuses(GOOD), "either").verdict == "refused"
    assert verdict(refuses(GOOD), "right").why.startswith("refused, though it is possible")
    assert verdict(off_by(0.0), "refused").why == "not refused"
    assert verdict(off_by(0.0), "either").verdict == "right"


def test_what_was_found_before_a_refusal_counts() -> None:
    def check(_: Mapping[str, Any], found: Evidence) -> None:
        found.add("the message's figure", 0.5, 0.1)
        raise DesignError(GOOD)

    assert "the message's figure" in verdict(check, "refused").why


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (GOOD, ""),
        ("camera.fill: input should be greater than 0.05 (got nan)", ""),
        ("", "says nothing"),
        ("Traceback (most recent call last): 3", "the program's own 'Traceback'"),
        ("cannot read 'a.csv': ValueError; give another", "the program's own 'ValueError'"),
        ("x.toml: got <class 'int'> 3; set it", "the program's own '<class"),
        ("the error is nan of 3; lower it", "not a number"),
        ("the design is bad; lower something", "neither a number nor a field"),
        ("the wall is 0.3 mm thick", "what would mend it"),
        ("lower it: 3 " * 100, "1199 characters long"),
    ],
)
def test_readable(message: str, why: str) -> None:
    assert why in unreadable(message)
    assert bool(why) == bool(unreadable(message))


def test_outcomes_come_back_from_plain_data() -> None:
    outcome = verdict(off_by(0.5))
    assert Outcome.of(outcome.plain()) == outcome
    assert outcome.worst is not None
    assert outcome.worst.error == 0.5
