"""Every room at its extremes: right, refused or wrong; worst errors, balances, units, symmetry.

``python -m benchmarks.stability [--quick] [--workers 2]``; what was found so far is kept in a
journal under ``$PHYTAC_DATA`` (or the system's temporary folder), so that a run that is stopped
goes on where it was.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.harness import Table, argument_parser
from phytac_design.study.stability.case import Finding, Outcome
from phytac_design.study.stability.judge import unreadable
from phytac_design.study.stability.rooms import ROOMS
from phytac_design.study.stability.run import Report, choose, run

QUICK = 40
PAGE = Path(__file__).parents[1] / "docs" / "stability.md"
LIMIT_S = 720.0
KINDS = {
    "reference": ("worst error against a reference", "text-book, published, or another program"),
    "units": ("worst difference in other units", "the same case in its own units"),
    "balance": ("worst balance of forces, moments or energy", "no force is lost"),
    "symmetry": ("worst difference under symmetry or other axes", "the same case unturned"),
    "float32": ("worst loss in single precision", "the same data in double precision"),
}


def nearest(outcomes: Sequence[Outcome], kind: str) -> Finding | None:
    """Of all findings of a kind that have a tolerance, the one that comes nearest to it."""
    found = [
        finding
        for outcome in outcomes
        for finding in outcome.findings
        if finding.kind == kind and finding.tolerance > 0.0
    ]
    return max(found, key=lambda f: f.error / f.tolerance, default=None)


def add_rows(table: Table, report: Report) -> None:
    """All rows of a run."""
    outcomes = report.outcomes
    table.add(
        "cases over all rooms and shapes",
        len(outcomes),
        "cases",
        reference=500,
        source="project target",
        target=">= 500",
    )
    note = "; ".join(f"{o.room}: {o.name}: {o.why}" for o in report.wrong)[:1000]
    table.add(
        "wrong",
        len(report.wrong),
        "cases",
        reference=0,
        source="project target",
        target="== 0",
        note=note,
    )
    refused = [outcome for outcome in outcomes if outcome.verdict == "refused"]
    poor = [outcome for outcome in refused if unreadable(outcome.message)]
    table.add(
        "refusals that a user cannot make sense of",
        len(poor),
        "cases",
        reference=0,
        source=f"{len(refused)} refusals: a sentence with a figure or a field, and what mends it",
        target="== 0",
    )
    for name, row in report.counts().items():
        found = f"{row['right']} right, {row['refused']} refused, {row['wrong']} wrong"
        about = ROOMS[name].about
        table.add(f"{name}: cases", sum(row.values()), "cases", reference=about, source=found)
    for name in report.counts():
        _room_rows(table, name, [outcome for outcome in outcomes if outcome.room == name])
    seconds = sum(outcome.seconds for outcome in outcomes)
    table.add(
        "processor time of all cases", seconds, "s", reference="none", source="sum over the workers"
    )
    table.add(
        f"wall time, {report.workers} workers",
        report.seconds,
        "s",
        reference=LIMIT_S,
        source="project target: 12 min on two quiet cores",
        target=f"<= {LIMIT_S:g}",
        note=f"{report.fresh} cases run, {len(report.outcomes) - report.fresh} from the journal",
    )


def _room_rows(table: Table, name: str, own: Sequence[Outcome]) -> None:
    for kind, (what, source) in KINDS.items():
        worst = nearest(own, kind)
        if worst is None:
            continue
        table.add(
            f"{name}: {what}",
            worst.error,
            "",
            reference=0.0,
            source=f"{source}: {worst.reference}",
            target=f"<= {worst.tolerance:g}",
            note="of all findings the one nearest to its own tolerance",
        )
    numbers = [outcome.facts["condition"] for outcome in own if "condition" in outcome.facts]
    if numbers:
        table.add(
            f"{name}: largest condition number",
            max(numbers),
            "",
            reference=min(numbers),
            source="smallest of the room",
        )


def main() -> None:
    """Run, write rows and the page."""
    parser = argument_parser(__doc__ or "")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    from phytac_design.study.stability.table import page

    folder = Path(os.environ.get("PHYTAC_DATA", tempfile.gettempdir())) / "stability"
    cases = choose(count=QUICK if given.quick else None)
    report = run(
        cases,
        workers=given.workers,
        out=None if given.quick else folder,
        progress=lambda text: print(text, flush=True),
    )
    table = Table("stability")
    add_rows(table, report)
    if not given.quick:
        table.write()
        PAGE.write_text(page(report), encoding="utf-8")
        # What is written is done: the next run begins anew, with times of its own.
        (folder / "journal.jsonl").unlink()


if __name__ == "__main__":
    main()
