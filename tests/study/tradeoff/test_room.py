"""Clearance that markers keep under load: the visibility error of presses."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from phytac_design.engine.stage import Context
from phytac_design.optics.loaded_visibility import LoadedVisibility
from phytac_design.study.tradeoff.pilot import (
    built_clearance,
    clearance_between,
    relative_clearance,
    visibility_error,
)


def test_clearance_is_the_minimum_of_visible_fraction_and_relative_gaps() -> None:
    """By hand: undisturbed, half hidden, a gap closed by three quarters, fused with another."""
    rest = np.full(4, 8.0)
    clearance = relative_clearance(
        np.array([1.0, 0.5, 1.0, 0.9]),
        (np.array([8.0, 6.0, 2.0, 8.0]), np.array([8.0, 8.0, 4.0, 0.0])),
        (rest, rest),
    )
    assert clearance.tolist() == [1.0, 0.5, 0.25, 0.0]


def test_undefined_gaps_are_ignored() -> None:
    """No marker of that colour, or one that touches at rest already."""
    nothing = np.array([np.inf, 0.0])
    assert relative_clearance(np.ones(2), (nothing,), (nothing,)).tolist() == [1.0, 1.0]


def view(gap: float, fraction: float) -> LoadedVisibility:
    """Two markers, the second as at rest."""
    one = np.ones(1)
    gaps = np.array([gap, 8.0])
    return LoadedVisibility(
        hidden=one.astype(np.int64), fused=one.astype(np.int64), press_gap_same_px=one,
        press_gap_other_px=one, press_crosstalk_px=one, shift_px=one, first_force_N=one,
        first_marker=one.astype(np.int64), least_fraction=np.array([fraction, 1.0]),
        least_gap_same_px=gaps, least_gap_other_px=gaps, crosstalk_px=one,
        crosstalk_still_px=one,
    )  # fmt: skip


def test_clearance_between_a_view_under_load_and_one_at_rest() -> None:
    assert clearance_between(view(2.0, 0.9), view(8.0, 1.0)).tolist() == [0.25, 1.0]
    other = replace(view(8.0, 1.0), least_gap_other_px=np.array([1.0, 8.0]))
    assert clearance_between(other, view(8.0, 1.0)).tolist() == [0.125, 1.0]


@pytest.mark.parametrize(
    ("sector", "expected"), [(False, [1.0, 0.5, 0.25, 1.0]), (True, [0.5, 0.25])]
)
def test_rows_represent_their_markers_where_one_sector_was_pressed(
    sector: bool, expected: list[float]
) -> None:
    eight = np.full(4, 8.0)
    loaded = np.array([8.0, 4.0, 2.0, 8.0])
    arrays = {
        "views": {"gap_same_colour_px": eight, "gap_other_colour_px": eight},
        "underload": {
            "least_fraction": np.ones(4), "least_gap_same_px": loaded, "least_gap_other_px": eight
        },
    }  # fmt: skip
    context: Any = SimpleNamespace(
        arrays=arrays.__getitem__,
        facts=lambda _: {"sector_only": sector},
        markers=SimpleNamespace(row=np.array([3, 3, 7, 7])),
    )
    assert built_clearance(cast("Context", context)).tolist() == expected


def test_the_error_is_that_of_the_worst_marker() -> None:
    assert visibility_error([1.0, 0.5, 0.75], [1.0, 0.75, 0.625]) == 0.25
    assert visibility_error([], []) == 0.0
