"""The presets are the cheapest measured settings within their errors, and nothing beats them."""

import pytest

from benchmarks.tradeoff_fronts import DESIGNS, DOMINATED, committed_fronts, preset_problems
from phytac_design.design.accuracy import PRESETS
from phytac_design.study.tradeoff.front import beaten_by
from phytac_design.study.tradeoff.run_tradeoff import presets_of


def test_presets_follow_the_committed_fronts() -> None:
    assert preset_problems(committed_fronts()) == []


@pytest.mark.parametrize("design", DESIGNS)
def test_no_preset_is_beaten_by_more_than_a_tenth(design: str) -> None:
    points = committed_fronts()[design]
    presets = presets_of(points)
    assert set(presets) == set(PRESETS)
    assert max(beaten_by(point, points) for point in presets.values()) <= DOMINATED
