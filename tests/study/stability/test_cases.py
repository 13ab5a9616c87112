"""The cases: enough, unique, plain data; a few of every room are run, and designs drawn."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phytac_design.study.stability.case import Case
from phytac_design.study.stability.judge import judge
from phytac_design.study.stability.rooms import ROOMS, drawn
from phytac_design.study.stability.run import choose
from phytac_shapes import REGISTRY
from phytac_shapes.errors import InputError

SHARE = 4
"""Cases of each room that are run here, the first and the last among them."""
SLOW = ("fine facets", "1600", "5 m", "ø2 m", "20 m away", "patch", "thin", "as it is")


def some() -> list[Case]:
    out = []
    for room in ROOMS.values():
        quick = [c for c in room.cases() if not any(word in c.name for word in SLOW)]
        out += [quick[k * (len(quick) - 1) // (SHARE - 1)] for k in range(SHARE)]
    return out


def test_there_are_enough_of_every_shape_and_no_two_alike() -> None:
    every = choose()
    assert len(every) >= 500
    assert len({case.key for case in every}) == len(every)
    for shape in REGISTRY:
        assert sum(case.shape == shape for case in every) >= 20
    for case in every:
        assert json.loads(json.dumps(case.values, allow_nan=True)) is not None
        assert case.check in ROOMS[case.room].checks


def test_cases_are_the_same_every_time() -> None:
    # As text: not a number is not equal to itself.
    assert repr(choose()) == repr(choose())


@pytest.mark.parametrize("case", some(), ids=lambda case: case.key)
def test_a_few_of_every_room(case: Case) -> None:
    outcome = judge(case, ROOMS[case.room].checks)
    assert outcome.verdict != "wrong", outcome.why


@settings(max_examples=12, deadline=None)
@given(shape=st.sampled_from(sorted(REGISTRY)), seed=st.integers(0, 2**31 - 1))
def test_drawn_designs_are_never_wrong(shape: str, seed: int) -> None:
    case = drawn.random_cases(1, seed=seed, shape=shape)[0]
    case.values["mesh"] = False
    outcome = judge(case, ROOMS[case.room].checks)
    assert outcome.verdict != "wrong", outcome.why


def test_fewer_are_taken_evenly_and_more_are_drawn() -> None:
    every = choose()
    few = choose(count=40)
    assert len(few) == 40
    assert len({case.room for case in few}) >= len(ROOMS) - 2
    more = choose(count=len(every) + 9, seed=3)
    assert more[: len(every)] != []
    assert [case.room for case in more[len(every) :]] == ["random designs"] * 9
    assert len({case.key for case in more}) == len(more)
    assert all(case.shape == "cone" for case in choose(shape="cone"))


def test_no_such_room_or_shape() -> None:
    with pytest.raises(InputError, match="no room 'shel'; did you mean 'shell'"):
        choose(room="shel")
    with pytest.raises(InputError, match="no shape 'torus'"):
        choose(shape="torus")
    with pytest.raises(InputError, match="leave out one"):
        choose(room="design file", shape="cone")
