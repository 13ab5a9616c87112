"""Workers: hangs and crashes are verdicts, order and journal do not depend on them."""

import json
import multiprocessing
from pathlib import Path

import pytest

from phytac_design.study.stability import rooms, runner
from phytac_design.study.stability.case import Outcome
from tests.study.stability import crew_room
from tests.study.stability.crew_room import case


@pytest.fixture(autouse=True)
def with_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are forked, so that they know the room of this test."""
    monkeypatch.setitem(rooms.ROOMS, "crew", crew_room.ROOM)
    context = multiprocessing.get_context("fork")
    monkeypatch.setattr(multiprocessing, "get_context", lambda _: context)
    # A child forked from here must not wait for a process to start.
    monkeypatch.setattr(runner, "START_S", 0.0)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_hangs_and_crashes_are_verdicts_and_the_rest_goes_on() -> None:
    cases = [
        case("good", 0.5),
        case("hangs", "hang", limit_s=0.5),
        case("dies", "die"),
        case("grows", "grow"),
        case("bad", 2.0),
        case("good again", 0.1),
    ]
    found = runner.run_cases(cases, workers=2)
    assert [o.name for o in found] == [c.name for c in cases]
    assert [o.verdict for o in found] == ["right", "wrong", "wrong", "wrong", "wrong", "right"]
    assert found[1].why == "no answer within 0.5 s"
    assert found[2].why.startswith("the process ended (exit code -")
    assert "MemoryError" in found[3].why
    assert found[4].why == "off by 2 (at most 1) against reference"


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_journal_is_taken_up_and_only_where_it_fits(tmp_path: Path) -> None:
    journal = tmp_path / "new" / "journal.jsonl"
    cases = [case(str(k), 0.1 * k) for k in range(4)]
    ran: list[str] = []

    def note(_: int, outcome: Outcome) -> None:
        ran.append(outcome.name)

    first = runner.run_cases(cases[:2], journal=journal, mark="a")
    # A run that was killed leaves half a line.
    with journal.open("a") as stream:
        stream.write('{"room": "crew", "na')
    again = runner.run_cases(cases, journal=journal, mark="a", done=note)
    assert ran == ["2", "3"]
    assert again[:2] == first
    assert len(journal.read_text().splitlines()) == 5
    ran.clear()
    assert runner.run_cases(cases, journal=journal, mark="a", done=note) == again
    assert ran == []
    runner.run_cases(cases, journal=journal, mark="another program", done=note)
    assert ran == ["0", "1", "2", "3"]
    assert json.loads(journal.read_text().splitlines()[0]) == {"mark": "another program"}
