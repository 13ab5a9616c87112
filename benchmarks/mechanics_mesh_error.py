"""True over claimed discretisation error, on shells whose error is known."""

from benchmarks.harness import Table
from verification.mesh_error import FACTOR_MAX, error_cases, judge

SOURCE = "the same element on resolved meshes, extrapolated"


def add_rows(table: Table, *, quick: bool) -> None:
    """One row for each shell and mesh, and a summary."""
    factors: list[float] = []
    outside: list[float] = []
    cases = 0
    for case in list(error_cases())[:: 12 if quick else 1]:
        cases += 1
        for one in judge(case):
            row = f"mesh error: {case.name}, {one.elements} a side: true over claimed error"
            state = "asymptotic" if one.asymptotic else "not asymptotic"
            note = (
                f"claimed {100.0 * one.claimed:.3g} %, {state}, rate {one.rate:.2f}; true to "
                f"{100.0 * one.uncertainty:.1g} %"
            )
            true = f"{100.0 * one.true:.3g} %"
            judged = one.asymptotic and one.known
            target = f"<= {FACTOR_MAX:g}" if judged else None
            table.add(row, one.factor, "", true, SOURCE, target, note)
            if one.known:
                (factors if one.asymptotic else outside).append(one.factor)
    for name, value, target in (
        ("largest", max(factors), f"<= {FACTOR_MAX:g}"),
        ("smallest", min(factors), f">= {1.0 / FACTOR_MAX:.4f}"),
    ):
        table.goal(
            f"mesh error: {name} true over claimed error, asymptotic",
            value,
            "",
            target,
            note=f"{len(factors)} estimates of {cases} shells",
        )
    more = sum(factor > 1.0 for factor in outside)
    table.add(
        "mesh error: largest true over claimed error, not asymptotic",
        max(outside),
        "",
        1.0,
        SOURCE,
        note=f"{more} of {len(outside)} above 1",
    )
