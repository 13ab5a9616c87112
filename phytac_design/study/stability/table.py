"""The page on stability, from what was found."""

from collections.abc import Sequence

import numpy as np

from phytac_design.study.stability.case import Outcome
from phytac_design.study.stability.rooms import ROOMS
from phytac_design.study.stability.run import Report

KINDS = {
    "reference": "a reference from outside",
    "units": "other units",
    "balance": "forces, moments, energy",
    "symmetry": "symmetry and axes",
    "float32": "single precision",
}
MOST = 6
"""Extreme right answers shown of each room."""
REFUSALS = 3
"""Refusals shown of each room."""
INTRODUCTION = """# Stability at the extremes

Made by `phytac stability --table docs/stability.md`. Every case is either *right* (all that was
found keeps its tolerance against the reference named), *refused* (in a sentence that says what, how
much, and what mends it), or *wrong*. A warning, a crash, a figure that is not a number, or no
answer in time are *wrong* too.
"""
EXTREMES = """Of each room the answers nearest to their tolerance; an error is relative where its
reference says no unit.
"""
WORST = """
## Worst of each room

Error and, in brackets, the tolerance that it comes nearest to. Condition numbers are those of the
stiffness scaled to a unit diagonal (1-norm); of estimators, of what they solve.
"""
NOT_COVERED = """
## Not covered

- Speed and memory: cases end after their time limit or at 8 GiB, and are wrong then; otherwise
  neither is judged here (`docs/verification.md`).
- Whole builds of extreme designs, with reports, drawings and molds: some are built by
  `python -m benchmarks.visibility` and `python -m benchmarks.mechanics`.
- Accuracy of force decoding from frames of a print: `docs/verification.md`, *decoder* and *twin*.
- STEP files through OpenCASCADE: the mesh of the same parameters is checked here, the two are
  compared in `docs/verification.md`, *fabrication*.
- Real prints and cameras.
"""


def page(report: Report) -> str:
    """Markdown of ``docs/stability.md``."""
    counts = report.counts()
    total = {v: sum(row[v] for row in counts.values()) for v in ("right", "refused", "wrong")}
    parts = [
        INTRODUCTION,
        _totals(report, total),
        "| room | what is tried | cases | right | refused | wrong |",
        "|---|---|---|---|---|---|",
        *(
            f"| {name} | {ROOMS[name].about} | {sum(row.values())} | {row['right']} | "
            f"{row['refused']} | {row['wrong']} |"
            for name, row in counts.items()
        ),
        _kinds(report.outcomes),
        "\n## The most extreme right answers\n",
        EXTREMES,
        *(_extremes(name, report.outcomes) for name in counts),
        "\n## How extremes are refused\n",
        *(_refusals(name, report.outcomes) for name in counts),
        *([_wrong(report.wrong)] if report.wrong else []),
        NOT_COVERED,
    ]
    return "\n".join(part for part in parts if part)


def _totals(report: Report, total: dict[str, int]) -> str:
    return (
        f"{len(report.outcomes)} cases, seed {report.seed}: {total['right']} right, "
        f"{total['refused']} refused, **{total['wrong']} wrong**.\n"
    )


def _kinds(outcomes: Sequence[Outcome]) -> str:
    """Worst of each kind of check in each room, as a share of its tolerance."""
    lines = [
        WORST,
        f"| room | {' | '.join(KINDS.values())} | condition numbers |",
        f"|---|{'---|' * (len(KINDS) + 1)}",
    ]
    for room in dict.fromkeys(outcome.room for outcome in outcomes):
        own = [outcome for outcome in outcomes if outcome.room == room]
        cells = [worst_of(own, kind) for kind in KINDS]
        numbers = [o.facts["condition"] for o in own if "condition" in o.facts]
        spread = f"{min(numbers):.2g} … {max(numbers):.2g}" if numbers else ""
        lines.append(f"| {room} | {' | '.join(cells)} | {spread} |")
    return "\n".join(lines)


def worst_of(outcomes: Sequence[Outcome], kind: str) -> str:
    """Error and tolerance of the finding of a kind that comes nearest to its tolerance."""
    found = [
        f
        for outcome in outcomes
        if outcome.verdict == "right"
        for f in outcome.findings
        if f.kind == kind and f.tolerance > 0.0
    ]
    if not found:
        return ""
    worst = max(found, key=lambda f: f.error / f.tolerance)
    return f"{worst.error:.2g} ({worst.tolerance:.2g})"


def _extremes(room: str, outcomes: Sequence[Outcome]) -> str:
    own = [
        (finding, outcome)
        for outcome in outcomes
        if outcome.room == room and outcome.verdict == "right"
        for finding in outcome.findings
        if finding.kind == "reference"
    ]
    own.sort(key=lambda pair: -pair[0].error / max(pair[0].tolerance, 1e-300))
    lines: list[str] = []
    seen: set[str] = set()
    for finding, outcome in own:
        if outcome.name not in seen and len(seen) < MOST:
            seen.add(outcome.name)
            lines.append(
                f"| {_cell(outcome.name)} | {_cell(finding.reference)} | {finding.error:.2g} | "
                f"{finding.tolerance:.2g} |"
            )
    if not lines:
        return ""
    head = f"\n**{room}**\n\n| case | held against | error | tolerance |\n|---|---|---|---|"
    return "\n".join([head, *lines])


def _refusals(room: str, outcomes: Sequence[Outcome]) -> str:
    own = [o for o in outcomes if o.room == room and o.verdict == "refused"]
    chosen = (
        [own[int(k)] for k in np.unique(np.linspace(0, len(own) - 1, REFUSALS).astype(int))]
        if own
        else []
    )
    lines = [f"- *{_cell(o.name)}*: {_cell(o.message)}" for o in chosen]
    return "\n".join([f"\n**{room}**\n", *lines]) if lines else ""


def _wrong(outcomes: Sequence[Outcome]) -> str:
    lines = [f"- {o.room}: *{_cell(o.name)}*: {_cell(o.why)}" for o in outcomes]
    return "\n".join(["\n## Wrong\n", *lines, ""])


def _cell(text: str) -> str:
    """Text that breaks no table, without the places of this machine's files."""
    import re

    plain = re.sub(r"/tmp/[\w./-]*/", "", text)  # noqa: S108 - a pattern, not a file
    return " ".join(plain.split()).replace("|", "\\|").replace("<", "&lt;")
