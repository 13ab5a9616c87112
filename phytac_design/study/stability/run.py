"""``phytac stability``: choose cases, run them, say what came of them."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from phytac_design.study.stability.case import Case, Outcome
from phytac_design.study.stability.rooms import ROOMS, drawn
from phytac_design.study.stability.runner import run_cases
from phytac_shapes import REGISTRY
from phytac_shapes.errors import InputError

JOURNAL = "journal.jsonl"


@dataclass(frozen=True, kw_only=True)
class Report:
    """All outcomes, in the cases' order, and how long they took.

    Attributes
    ----------
    outcomes : list of Outcome
        One for each case.
    seconds : float
        Wall time of this run; what a journal held took none.
    workers, seed : int
        As asked for.
    fresh : int
        Outcomes of this run; a journal held the others.
    """

    outcomes: list[Outcome]
    seconds: float
    workers: int
    seed: int
    fresh: int

    @property
    def wrong(self) -> list[Outcome]:
        """Those that must be mended."""
        return [outcome for outcome in self.outcomes if outcome.verdict == "wrong"]

    def counts(self) -> dict[str, dict[str, int]]:
        """Outcomes by room and verdict."""
        out: dict[str, dict[str, int]] = {}
        for outcome in self.outcomes:
            room = out.setdefault(outcome.room, {"right": 0, "refused": 0, "wrong": 0})
            room[outcome.verdict] += 1
        return out

    def plain(self) -> dict[str, Any]:
        """As data that JSON holds."""
        return {
            "counts": self.counts(),
            "seconds": round(self.seconds, 3),
            "fresh": self.fresh,
            "workers": self.workers,
            "seed": self.seed,
            "outcomes": [outcome.plain() for outcome in self.outcomes],
        }


def choose(
    *, room: str = "", shape: str = "", count: int | None = None, seed: int = 0
) -> list[Case]:
    """Cases of one room or all, of one shape or all; so many of them.

    Systematic cases come first; where more are asked for, random designs fill up. Fewer are
    taken evenly from all.

    Raises
    ------
    InputError
        If there is no such room or shape, or nothing is left.
    """
    _known(room, list(ROOMS), "room")
    _known(shape, list(REGISTRY), "shape")
    found = [
        case
        for own in ROOMS.values()
        if room in ("", own.name)
        for case in own.cases()
        if shape in ("", case.shape)
    ]
    if count is not None and count > len(found) and room in ("", drawn.ROOM.name):
        found += drawn.random_cases(count - len(found), seed=seed, shape=shape)
    elif count is not None and count < len(found):
        found = [found[k * len(found) // count] for k in range(count)]
    if not found:
        raise InputError(f"no case of room {room!r} has shape {shape!r}; leave out one of the two")
    return found


def _known(name: str, names: Sequence[str], what: str) -> None:
    if name and name not in names:
        near = get_close_matches(name, names, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"no {what} {name!r}{hint} (known: {', '.join(names)})")


def run(
    cases: Sequence[Case],
    *,
    workers: int = 1,
    seed: int = 0,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Report:
    """Run cases; with a folder ``out``, keep a journal there, and all that was found.

    Raises
    ------
    OutputError
        If that folder cannot be written.
    """
    from phytac_design.engine.cache import code_hash

    start, fresh = time.perf_counter(), 0

    def done(number: int, outcome: Outcome) -> None:
        nonlocal fresh
        fresh += 1
        if outcome.verdict == "wrong":
            progress(f"wrong: {outcome.room}: {outcome.name}: {outcome.why}")
        if number % 50 == 0 or number == len(cases):
            progress(f"stability: {number} of {len(cases)} cases")

    outcomes = run_cases(
        cases,
        workers=workers,
        journal=out / JOURNAL if out else None,
        mark=f"{code_hash()} {seed}",
        done=done,
    )
    report = Report(
        outcomes=outcomes,
        seconds=time.perf_counter() - start,
        workers=workers,
        seed=seed,
        fresh=fresh,
    )
    if out:
        from phytac_design.core.json_values import finite

        text = json.dumps(finite(report.plain()), indent=1, ensure_ascii=False)
        (out / "stability.json").write_text(text + "\n", encoding="utf-8")
    return report
