"""The presets are what was measured: none is beaten by more than a tenth on a committed front."""

import pytest

from benchmarks.tradeoff_fronts import DOMINATED, committed_fronts
from phytac_design.design.accuracy import PRESETS
from phytac_design.study.tradeoff.derive import derive, most_beaten


def test_presets_are_what_the_rule_makes_of_the_committed_fronts() -> None:
    assert derive(committed_fronts()) == PRESETS


@pytest.mark.parametrize("design", ["cylinder60", "hemisphere", "grip"])
def test_no_preset_is_beaten_by_more_than_a_tenth(design: str) -> None:
    beaten = most_beaten(PRESETS, committed_fronts())
    own = {name: share for (name, of), share in beaten.items() if of == design}
    assert set(own) == set(PRESETS)
    assert max(own.values()) <= DOMINATED
