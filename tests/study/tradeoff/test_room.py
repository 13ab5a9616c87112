"""Room that markers keep under load: the visibility error of presses."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from phytac_design.engine.stage import Context
from phytac_design.optics.loaded_visibility import UnderLoad
from phytac_design.study.tradeoff.room import room_between, room_left, room_of, visibility_error


def test_room_is_the_least_of_what_is_seen_and_of_gaps_over_those_at_rest() -> None:
    """By hand: undisturbed, half hidden, a gap closed by three quarters, fused with another."""
    rest = np.full(4, 8.0)
    room = room_of(
        np.array([1.0, 0.5, 1.0, 0.9]),
        (np.array([8.0, 6.0, 2.0, 8.0]), np.array([8.0, 8.0, 4.0, 0.0])),
        (rest, rest),
    )
    assert room.tolist() == [1.0, 0.5, 0.25, 0.0]


def test_gaps_that_tell_nothing_take_no_room() -> None:
    """No marker of that colour, or one that touches at rest already."""
    nothing = np.array([np.inf, 0.0])
    assert room_of(np.ones(2), (nothing,), (nothing,)).tolist() == [1.0, 1.0]


def look(gap: float, fraction: float) -> UnderLoad:
    """Two markers, the second as at rest."""
    one = np.ones(1)
    gaps = np.array([gap, 8.0])
    return UnderLoad(
        hidden=one.astype(np.int64), fused=one.astype(np.int64), press_gap_same_px=one,
        press_gap_other_px=one, press_crosstalk_px=one, shift_px=one, first_force_N=one,
        first_marker=one.astype(np.int64), least_fraction=np.array([fraction, 1.0]),
        least_gap_same_px=gaps, least_gap_other_px=gaps, crosstalk_px=one,
        crosstalk_still_px=one,
    )  # fmt: skip


def test_room_between_a_look_and_one_at_rest() -> None:
    assert room_between(look(2.0, 0.9), look(8.0, 1.0)).tolist() == [0.25, 1.0]
    other = replace(look(8.0, 1.0), least_gap_other_px=np.array([1.0, 8.0]))
    assert room_between(other, look(8.0, 1.0)).tolist() == [0.125, 1.0]


@pytest.mark.parametrize(
    ("sector", "expected"), [(False, [1.0, 0.5, 0.25, 1.0]), (True, [0.5, 0.25])]
)
def test_rows_stand_for_their_markers_where_one_sector_was_pressed(
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
    assert room_left(cast("Context", context)).tolist() == expected


def test_the_error_is_that_of_the_worst_marker() -> None:
    assert visibility_error([1.0, 0.5, 0.75], [1.0, 0.75, 0.625]) == 0.25
    assert visibility_error([], []) == 0.0
