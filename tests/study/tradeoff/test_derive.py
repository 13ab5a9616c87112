"""Presets from fronts, by rule."""

from itertools import product

import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.study.tradeoff.derive import WANTED, FINE_s, derive, most_beaten
from phytac_design.study.tradeoff.front import Measured
from phytac_design.study.tradeoff.joint import CAD, LOAD, MECHANICS, SCORE, accuracy_of
from phytac_shapes.errors import NumericalError


def front(speed: float) -> list[Measured]:
    """A made-up front on which each step of a group costs and gains a fixed factor."""
    return [
        Measured(
            settings={"receptors": True, **CAD[c], **MECHANICS[m], **LOAD[k], **SCORE[s]},
            seconds=speed * (10.0 + 2.0**c + 2.0**m + 3.0**k + 3.0**s),
            cpu_s=1.0,
            peak_MB=1.0,
            errors={
                "force": 0.3 / 2.0**m,
                "visibility": 0.1 / 4.0**k,
                "volume": 2e-3 / 4.0**c,
                "score": 0.4 / 2.0**s,
            },
        )
        for c, m, k, s in product(*map(range, map(len, (CAD, MECHANICS, LOAD, SCORE))))
    ]


def test_presets_are_the_cheapest_that_are_good_enough() -> None:
    fronts = {"a": front(1.0), "b": front(2.0)}
    found = derive(fronts)
    for name, wanted in WANTED.items():
        own = next(p for p in fronts["a"] if accuracy_of(p.settings) == found[name])
        assert all(own.errors[q] <= most for q, most in wanted.items())
        cheaper = [
            p
            for p in fronts["a"]
            if p.seconds < own.seconds and (name == "draft" or p.settings["print_tools"])
        ]
        assert all(any(p.errors[q] > most for q, most in wanted.items()) for p in cheaper)
    assert found["fine"].place_share == MECHANICS[-1]["place_share"]
    assert found["fine"].frames == SCORE[-1]["frames"]
    assert max(most_beaten(found, fronts).values()) == 0.0


def test_fine_keeps_its_time() -> None:
    slow = {"a": front(FINE_s / 100.0)}
    found = derive(slow)["fine"]
    own = next(p for p in slow["a"] if accuracy_of(p.settings) == found)
    assert own.seconds <= FINE_s
    assert found.refine < MECHANICS[-1]["refine"] or found.frames < SCORE[-1]["frames"]
    with pytest.raises(NumericalError, match="no measured setting is built in"):
        derive({"a": front(FINE_s)})


def test_a_preset_that_is_beaten_is_told_of() -> None:
    fronts = {"a": front(1.0)}
    bad = accuracy_of(fronts["a"][0].settings)
    slow = [
        Measured(
            settings=p.settings,
            seconds=2.0 * p.seconds if accuracy_of(p.settings) == bad else p.seconds,
            cpu_s=1.0,
            peak_MB=1.0,
            errors=p.errors,
        )
        for p in fronts["a"]
    ]
    assert most_beaten({"x": bad}, {"a": slow})["x", "a"] > 0.1
    assert set(most_beaten(PRESETS, fronts)) == {(name, "a") for name in PRESETS}


def test_a_setting_that_checks_less_is_no_rival() -> None:
    fronts = {"a": front(1.0)}
    checked = next(p for p in fronts["a"] if p.settings["print_tools"])
    careless = Measured(
        settings={**checked.settings, "print_tools": False},
        seconds=0.5 * checked.seconds,
        cpu_s=1.0,
        peak_MB=1.0,
        errors=checked.errors,
    )
    own = accuracy_of(checked.settings)
    before = most_beaten({"x": own}, fronts)["x", "a"]
    assert most_beaten({"x": own}, {"a": [*fronts["a"], careless]})["x", "a"] == before < 0.5
    assert most_beaten({"x": accuracy_of(careless.settings)}, {"a": [careless, checked]}) == {
        ("x", "a"): 0.0
    }


def test_a_rule_that_nothing_meets_is_refused() -> None:
    poor = [
        Measured(settings=p.settings, seconds=1.0, cpu_s=1.0, peak_MB=1.0,
                 errors={**p.errors, "force": 0.9})
        for p in front(1.0)
    ]  # fmt: skip
    with pytest.raises(NumericalError, match="good enough for draft"):
        derive({"a": poor})
