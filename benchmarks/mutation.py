"""Mutation score of the packages that decide forces: the share of small changes that tests notice.

``python -m benchmarks.mutation [--parts optics,layout] [--minutes 15] [--again]`` tries the drawn
mutants of each package whose outcome is not known, for so many minutes each, and then makes the
rows. Outcomes are kept in ``benchmarks/results/mutants.jsonl`` until the mutated file changes, so
that a run that was stopped continues. ``--again`` tries survivors without a reason in
``survivors.toml`` once more, with more tests.
"""

import json
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from time import monotonic
from typing import Any

from benchmarks.harness import RESULTS, Table, run_parts
from benchmarks.mutant_runs import Runner
from benchmarks.mutants import PACKAGES, Mutant, draw
from benchmarks.tables import SURVIVORS

OUTCOMES = RESULTS / "mutants.jsonl"
COUNT = 40
"""Mutants of each package."""
Known = dict[str, dict[str, Any]]


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927)."""
    z2 = 1.96**2
    middle = (successes + z2 / 2.0) / (count + z2)
    spread = (z2 * (successes * (count - successes) / count + z2 / 4.0)) ** 0.5 / (count + z2)
    return middle - spread, middle + spread


def read_outcomes() -> Known:
    """Return what is known of mutants, by key."""
    if not OUTCOMES.is_file():
        return {}
    entries = map(json.loads, OUTCOMES.read_text("utf-8").splitlines())
    return {entry["key"]: entry for entry in entries}


def keep_drawn(package: str, drawn: Sequence[Mutant]) -> None:
    """Keep outcomes of drawn mutants alone, in the order of packages and of the draw."""
    known, keys = read_outcomes(), [mutant.key for mutant in drawn]
    kept = {name: [e for e in known.values() if e["package"] == name] for name in PACKAGES}
    kept[package] = [known[key] for key in keys if key in known]
    lines = (json.dumps(entry, ensure_ascii=False) for own in kept.values() for entry in own)
    OUTCOMES.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def reasons() -> list[dict[str, str]]:
    """Return why survivors survive: tables of ``file``, ``was``, ``now`` and ``reason``."""
    found: list[dict[str, str]] = tomllib.loads(SURVIVORS.read_text("utf-8")).get("survivor", [])
    return found


def try_mutants(package: str, mutants: Sequence[Mutant], *, minutes: float, again: bool) -> Known:
    """Try mutants until the time is over; return what is known of the package's, in their order."""
    known, runner = read_outcomes(), None
    end, own = monotonic() + 60.0 * minutes, {}
    explained = {(each["file"], each["was"], each["now"]) for each in reasons()}
    for mutant in mutants:
        entry = known.get(mutant.key)
        retried = (
            again
            and entry is not None
            and entry["outcome"] == "survived"
            and (mutant.file, entry["was"], entry["now"]) not in explained
        )
        if (entry is None or retried) and monotonic() < end:
            runner = runner or Runner()
            begin = monotonic()
            outcome = runner.meet(mutant, again=retried)
            was, now = mutant.change()
            first = (entry or {}).get("first", outcome.outcome)
            entry = {"package": package, "key": mutant.key, "line": mutant.last_line}
            entry |= {"was": was, "now": now, "first": first} | asdict(outcome)
            where = f"{mutant.file}:{mutant.last_line}"
            print(f"{entry['outcome']:8} {monotonic() - begin:4.0f} s {where}: {was} -> {now}")
            with OUTCOMES.open("a", encoding="utf-8") as stream:
                print(json.dumps(entry, ensure_ascii=False), file=stream, flush=True)
        if entry is None:
            break
        own[mutant.key] = entry
    return own


def add_rows(table: Table, package: str, *, count: int, minutes: float, again: bool) -> None:
    """Score of one package."""
    drawn = draw(package)
    own = try_mutants(package, drawn[:count], minutes=minutes, again=again)
    keep_drawn(package, drawn)
    if not own:
        raise SystemExit(f"{package}: no mutant was tried; give more --minutes")
    late = sum(entry["outcome"] == "timeout" for entry in own.values())
    noticed, source = _score([entry["outcome"] for entry in own.values()])
    note = f"{late} of them by running out of time"
    table.goal(
        f"{package}: mutants that tests notice", noticed, "%", ">= 85", source=source, note=note
    )
    noticed, source = _score([entry["first"] for entry in own.values()])
    case = f"{package}: of the same when first tried"
    table.add(case, noticed, "%", "before tests were written for survivors", source)


def _score(outcomes: list[str]) -> tuple[float, str]:
    """Return the share of mutants that were noticed, in percent, and its interval in words."""
    noticed, count = len(outcomes) - outcomes.count("survived"), len(outcomes)
    low, high = (100.0 * share for share in wilson(noticed, count))
    words = f"{noticed} of {count} drawn; 95 % interval {low:.0f} to {high:.0f} %"
    return 100.0 * noticed / count, words


def parts(
    *, quick: bool, minutes: float = 15.0, again: bool = False
) -> dict[str, Callable[[Table], None]]:
    """Return one part for each package."""
    count = 2 if quick else COUNT
    return {
        package: partial(add_rows, package=package, count=count, minutes=minutes, again=again)
        for package in PACKAGES
    }


if __name__ == "__main__":
    run_parts("mutation", parts, __doc__ or "", minutes=15.0, again=False)
