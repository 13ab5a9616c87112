"""True over claimed discretisation error, on shells whose error is known, and of presses."""

import numpy as np

from benchmarks.harness import Table
from phytac_shapes.arrays import FloatArray
from verification.mesh_error import FACTOR_MAX, error_cases, judge
from verification.press_error import DESIGNS, PLACES, PressedDesign, PressErrors

SOURCE = "the same element on resolved meshes, extrapolated"
HELD_MIN = ">= 95"
"""Share of cases in which extrapolated motion is within its claimed error."""
LARGE = tuple(
    (name, place)
    for name in ("cylinder60", "cone", "hemisphere", "grip", "plane")
    for place in (0, 1, 2)
)
"""Designs and places of presses with large displacements."""


def add_rows(table: Table, *, quick: bool) -> None:
    """One row for each shell and mesh, and a summary."""
    factors: list[float] = []
    outside: list[float] = []
    extrapolated: list[float] = []
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
            extrapolated.append(one.extrapolated / one.claimed)
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
    _add_share(table, "extrapolated motion of shells", np.array(extrapolated))
    _add_presses(table, quick=quick)


def _add_presses(table: Table, *, quick: bool) -> None:
    """Presses on shipped designs, linear and with large displacements, and the decoder's tables."""
    designs = [PressedDesign(name) for name in (DESIGNS[4:5] if quick else DESIGNS)]
    linear = [design.linear() for design in designs]
    tables = [design.tables() for design in designs]
    pressed = {design.design.name: design for design in designs}
    large = [pressed[name].large(place) for name, place in LARGE if name in pressed]
    for what, each in (
        (f"linear presses, {len(PLACES)} on each of {len(designs)} designs", linear),
        (f"tables of auto, {len(PLACES)} places on each of {len(designs)} designs", tables),
        ("presses with large displacements", large),
    ):
        _add_share(
            table,
            what,
            np.concatenate([one.extrapolated / one.claimed for one in each]),
            f"median error {_median(each, 'extrapolated')} %, not extrapolated "
            f"{_median(each, 'plain')} %, claimed {_median(each, 'claimed')} %",
        )


def _median(found: list[PressErrors], name: str) -> str:
    return f"{100.0 * np.median(np.concatenate([getattr(one, name) for one in found])):.2g}"


def _add_share(table: Table, what: str, factors: FloatArray, note: str = "") -> None:
    """Add how often the true error is within the claimed one."""
    counts = f"{int((factors <= 1.0).sum())} of {len(factors)}; at most {factors.max():.2f} times"
    table.goal(
        f"mesh error: {what}: within the claimed error",
        100.0 * float((factors <= 1.0).mean()),
        "%",
        HELD_MIN,
        note=f"{counts}; {note}" if note else counts,
    )
