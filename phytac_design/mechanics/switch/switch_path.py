"""Equilibrium paths of a solid of revolution under displacement control.

Each step solves ``f(q) = λ p`` with one constraint by Newton's method; it starts on the tangent
and is halved where it does not converge, or deviates from the tangents at both ends, so that a
nearby branch is not taken for the path.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.large.stability import negative_pivots, path_deviation
from phytac_design.mechanics.shell.factor import SUPERLU
from phytac_design.mechanics.switch.model import AxiModel, State
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class SwitchPathSettings:
    """Tolerances and limits of a path."""

    max_iterations: int = 9
    residual_tolerance: float = 1e-9
    """Largest unbalanced force over the sums of absolute element forces."""
    constraint_tolerance: float = 1e-9
    """Largest gap of the constraint over the step."""
    max_deviation: float = 0.35
    """Largest departure of a step from the trapezoidal rule on the tangents at its ends."""
    min_step_share: float = 1.0 / 24.0
    """Share of the longest step at which a path ends: creases of the mesh's own size follow."""


SETTINGS = SwitchPathSettings()


@dataclass(frozen=True, kw_only=True)
class PathPoint:
    """One equilibrium.

    Attributes
    ----------
    unknowns : (n,) float
        Displacements, mm.
    load_factor : float
        λ.
    drive : (n,) float
        dq/dλ, mm.
    state : State
        Forces, tangent, stretches.
    negatives : int or None
        Negative eigenvalues of the tangent under dead load; None if they are unknown.
    """

    unknowns: FloatArray
    load_factor: float
    drive: FloatArray
    state: State
    negatives: int | None


class NotFoundError(NumericalError):
    """An increment does not converge."""


class PathError(NumericalError):
    """A path ends before its end.

    Attributes
    ----------
    points : list of PathPoint
        What was found of it.
    """

    def __init__(self, code: str, message: str, points: "list[PathPoint]") -> None:
        super().__init__(code, message)
        self.args = (code, message, points)
        self.points = points


Constraint = Callable[[FloatArray], tuple[FloatArray, float, float]]
"""Row (n,) and gap of a linearised constraint at unknowns (n,), and the gap that is tolerated."""


def _state(model: AxiModel, unknowns: FloatArray) -> State:
    state = model.state(unknowns)
    if state is None:
        raise NotFoundError(
            "switch-element-inverted",
            "an element of the switch turns inside out; ask for shorter steps",
        )
    return state


def _factor(state: State) -> Any:
    from scipy.sparse.linalg import splu

    try:
        return splu(state.tangent, **SUPERLU)
    except RuntimeError:
        raise NotFoundError("switch-tangent-singular", "the tangent is singular") from None


def _point(load: FloatArray, unknowns: FloatArray, factor_: float, state: State) -> PathPoint:
    factor = _factor(state)
    return PathPoint(
        unknowns=unknowns,
        load_factor=factor_,
        drive=factor.solve(load),
        state=state,
        negatives=negative_pivots(factor, state.tangent),
    )


def correct(
    model: AxiModel,
    load: FloatArray,
    guess: tuple[FloatArray, float],
    constraint: Constraint,
) -> PathPoint:
    """Equilibrium on a constraint, by Newton's method from a guess of q and λ.

    Raises
    ------
    NotFoundError
        If it does not converge.
    """
    unknowns, factor_ = guess
    extent = float(np.abs(model.mesh.nodes_mm).max())
    first = np.inf
    for _ in range(SETTINGS.max_iterations):
        state = _state(model, unknowns)
        left = state.force - factor_ * load
        row, gap, slack = constraint(unknowns)
        size = float(np.linalg.norm(left))
        # Under a tiny load forces are as good as the positions they come from are rounded.
        rounding = (
            4.0
            * np.finfo(np.float64).eps
            * extent
            * float(np.linalg.norm(state.tangent.diagonal()))
        )
        floor = max(SETTINGS.residual_tolerance * state.gross_N, rounding, 1e-300)
        if size <= floor and abs(gap) <= slack:
            return _point(load, unknowns, factor_, state)
        first = min(first, size)
        if not np.isfinite(size) or size > 1e6 * max(first, floor):
            break
        factor = _factor(state)
        balance, drive = factor.solve(-left), factor.solve(load)
        change = (gap - float(row @ balance)) / float(row @ drive)
        unknowns = unknowns + balance + change * drive
        factor_ += change
    raise NotFoundError("switch-newton-diverged", "Newton's method does not converge")


@dataclass(frozen=True, kw_only=True)
class PathControl:
    """How a path is followed.

    Attributes
    ----------
    unknown : int
        The unknown that displacement control moves.
    end_mm : float
        Where the path ends: its signed displacement.
    steps : int
        Steps wanted from rest to there; short ones are taken where the path bends.
    """

    unknown: int
    end_mm: float
    steps: int = 30

    @property
    def longest_mm(self) -> float:
        """Longest step of the unknown."""
        return abs(self.end_mm) / self.steps

    def remaining_mm(self, point: PathPoint) -> float:
        """Distance of the unknown to its end."""
        return float(np.sign(self.end_mm) * (self.end_mm - point.unknowns[self.unknown]))

    def longest(self, points: list[PathPoint]) -> float:
        """Longest step in the controlled quantity, after ``points``."""
        del points
        return self.longest_mm

    def advance(
        self, model: AxiModel, load: FloatArray, points: list[PathPoint], step: float
    ) -> tuple[PathPoint, float]:
        """Point a step further, and its deviation from the path (:func:`path_deviation`)."""
        here = points[-1]
        move = float(np.sign(self.end_mm)) * min(step, self.remaining_mm(here))
        normal = np.eye(1, model.count, self.unknown)[0]
        rate = move / float(here.drive[self.unknown])
        before = rate * here.drive
        end = float(here.unknowns[self.unknown]) + move

        def constraint(unknowns: FloatArray) -> tuple[FloatArray, float, float]:
            gap = end - float(unknowns[self.unknown])
            return normal, gap, SETTINGS.constraint_tolerance * abs(move)

        guess = (here.unknowns + before, here.load_factor + rate)
        if len(points) > 1:
            # Parabola by the change of the tangents: an iteration of Newton's method less.
            last = points[-2]
            old = move / float(last.drive[self.unknown])
            way = float(here.unknowns[self.unknown] - last.unknowns[self.unknown])
            half = 0.5 * move / way
            guess = (
                guess[0] + half * (before - old * last.drive),
                guess[1] + half * (rate - old),
            )
        found = correct(model, load, guess, constraint)
        after = move / float(found.drive[self.unknown]) * found.drive
        return found, path_deviation(found.unknowns - here.unknowns, before, after)


def falls(points: Sequence[PathPoint]) -> bool:
    """Whether the load falls along a path at its last point."""
    return float((points[-1].unknowns - points[-2].unknowns) @ points[-1].drive) < 0.0


def trace(
    model: AxiModel, load: FloatArray, control: PathControl, *, to_limit: bool = False
) -> list[PathPoint]:
    """Follow a path from rest until the controlled unknown reaches its end.

    Parameters
    ----------
    model : AxiModel
        The body.
    load : (n,) float
        Dead force on the unknowns at λ = 1, N.
    control : PathControl
        How far, and in which steps.
    to_limit : bool
        End at the first point behind the first maximum of the load, if that comes before.

    Raises
    ------
    PathError
        If it cannot be followed that far; it holds the points found.
    """
    still = np.zeros(model.count)
    points = [_point(load, still, 0.0, _state(model, still))]
    limit = control.longest(points)
    step, max_points = 0.5 * limit, 1 + 3 * control.steps
    while control.remaining_mm(points[-1]) > 1e-9 * abs(control.end_mm):
        try:
            found, deviation = control.advance(model, load, points, step)
        except NotFoundError:
            deviation = np.inf
        if deviation > SETTINGS.max_deviation:
            step = 0.5 * step
        else:
            points.append(found)
            if to_limit and falls(points):
                break
            limit = control.longest(points)
            growth = float(np.clip(np.sqrt(0.1 / max(deviation, 1e-9)), 0.5, 2.0))
            step = min(step * growth, limit)
        if step < SETTINGS.min_step_share * limit or len(points) > max_points:
            raise PathError(
                "switch-path-ended",
                "the switch's path cannot be followed beyond "
                f"{abs(points[-1].unknowns[control.unknown]):.4g} of {abs(control.end_mm):.4g} mm "
                f"(after {len(points)} points); ask for a thinner wall or a shorter way",
                points,
            )
    return points
