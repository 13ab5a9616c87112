"""Rounding: the error that a solution claims against the true one, over extreme shells."""

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.verification import cases
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

Face = Callable[[FloatArray, FloatArray], FloatArray]
TURNS = 3
"""The same shell is solved in so many other orientations: every number is rounded differently."""
FORCE_N = 1e-9


def panel(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cylindrical panel of radius and length 1; it bends without stretching."""
    return np.column_stack([np.sin(1.5 * a), b, np.cos(1.5 * a)])


def hyperboloid(a: FloatArray, b: FloatArray) -> FloatArray:
    """Part of x² + y² = 1 + z²."""
    radius = np.sqrt(1.0 + b * b)
    return np.column_stack([radius * np.cos(1.5 * a), radius * np.sin(1.5 * a), b])


def strip(a: FloatArray, b: FloatArray) -> FloatArray:
    """Flat, 100 × 1."""
    return np.column_stack([100.0 * a, b, 0.0 * a])


EXTREMES: list[tuple[str, Face, tuple[int, int], dict[str, float]]] = [
    *((f"panel t/R {t:g}", panel, (16, 16), {"thickness": t}) for t in 10.0 ** -np.arange(1, 6)),
    ("panel t/R 0.3", panel, (16, 16), {"thickness": 0.3}),
    *(
        (f"hyperboloid t/R {t:g}", hyperboloid, (16, 16), {"thickness": t})
        for t in (0.1, 1e-3, 1e-5)
    ),
    ("panel, 64 × 64, t/R 1e-4", panel, (64, 64), {"thickness": 1e-4}),
    ("single row of 40, t/L 3e-3", strip, (40, 1), {"thickness": 0.3}),
    ("single row of 40, t/L 1e-4", strip, (40, 1), {"thickness": 0.01}),
    ("single row of 40, t/L 1e-6", strip, (40, 1), {"thickness": 1e-4}),
    ("elements of aspect 100", strip, (10, 10), {"thickness": 0.1}),
    ("ν = 0", panel, (16, 16), {"thickness": 0.01, "poisson": 0.0}),
    ("ν = 0.4999", panel, (16, 16), {"thickness": 0.01, "poisson": 0.4999}),
    ("10 m, E = 1e-3 MPa", panel, (16, 16), {"thickness": 0.01, "modulus": 1e-3, "size": 1e4}),
    ("1 mm, E = 1e6 MPa", panel, (16, 16), {"thickness": 0.01, "modulus": 1e6}),
]


def solve(
    face: Face,
    sides: tuple[int, int],
    turn: FloatArray,
    *,
    thickness: float,
    modulus: float = 1000.0,
    poisson: float = 0.3,
    size: float = 1.0,
) -> tuple[FloatArray, float, float]:
    """Motion under a corner force, clamped along a = 0, turned back; error; condition number."""
    part = cases.patch(face, *sides)
    fixed = cases.no_support(part)
    cases.hold(fixed, part.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(part.nodes), 6))
    loads[-1, :3] = FORCE_N * (turn @ [0.3, 0.2, 1.0])
    model = ShellModel(
        size * part.nodes @ turn.T,
        part.quads,
        part.normals @ turn.T,
        thickness_mm=size * thickness,
        modulus_MPa=modulus,
        poisson=poisson,
        fixed=fixed,
    )
    solution = model.solve(loads.reshape(-1, 1))
    return solution.motion[:, :3, 0] @ turn, solution.error, model.condition()


def add_rows(table: Table) -> None:
    """Claimed error over true error of each extreme shell; its condition number in the note."""
    for name, face, sides, settings in EXTREMES:
        values: dict[str, Any] = dict(settings)
        try:
            motion, claimed, condition = solve(face, sides, np.eye(3), **values)
        except NumericalError as error:
            table.add(
                f"rounding: {name}: refused",
                1.0,
                "-",
                reference="-",
                source="the error that a solution would have claimed",
                note=str(error),
            )
            continue
        others = [solve(face, sides, _turn(seed), **values)[0] for seed in range(1, 1 + TURNS)]
        true = max(float(np.abs(other - motion).max()) for other in others) / np.abs(motion).max()
        table.add(
            f"rounding: {name}: true error / claimed",
            true / claimed,
            "x",
            reference=true,
            source=f"the same shell solved in {TURNS} other orientations",
            target="<= 2",
            note=f"claimed {claimed:.2g}; condition number {condition:.2g}, which alone would "
            f"claim {condition * np.finfo(float).eps:.2g}",
        )


def _turn(seed: int) -> FloatArray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.sign(np.linalg.det(q)))
