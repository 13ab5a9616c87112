"""Switches on the coarse mesh alone, for tests of what is beside them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import pytest

from phytac_design.mechanics.switch import design, feasible_range
from phytac_design.stages import switch_stage


@contextmanager
def coarse_bowls() -> Iterator[None]:
    """Switches on the coarse mesh alone, four times as quick: for tests of what is beside them."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (design, "press_bowl"),
            (design, "limit_load"),
            (feasible_range, "press_bowl"),
        ):
            patch.setattr(module, name, partial(_coarse, getattr(module, name)))
        patch.setattr(switch_stage, "design_switch", _same_bowl)
        yield


def _coarse(exact: Callable[..., object], *given: object, **settings: object) -> object:
    return exact(*given, **{**settings, "refine": 1})


_BOWLS: dict[str, design.SwitchDesign] = {}


def _same_bowl(*given: object) -> design.SwitchDesign:
    """Most designs of tests have the same switch: each process solves it once."""
    key = repr(given)
    if key not in _BOWLS:
        _BOWLS[key] = design.design_switch(*given)
    return _BOWLS[key]
