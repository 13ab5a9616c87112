"""Equilibrium paths of a solid of revolution: by displacement, or by arc-length.

Each step solves ``f(q) = λ p`` with one constraint by Newton's method; it starts on the tangent
and is halved where it does not converge, or strays from the tangents at both ends, so that a
nearby branch is not taken for the path.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from phytac_design.mechanics.large.stability import negative_pivots, stray
from phytac_design.mechanics.shell.factor import SUPERLU
from phytac_design.mechanics.switch.model import AxiModel, State
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

ITERATIONS = 9
RESIDUAL_TOL = 1e-9
"""Largest unbalanced force over the sums of absolute element forces."""
GAP_TOL = 1e-9
EPS = 4.0 * float(np.finfo(np.float64).eps)
"""Rounding of a position, of the body's extent."""
STRAY = 0.35
"""Largest departure of a step from the trapezoidal rule on the tangents at its ends."""
SHORTEST = 1.0 / 24.0
"""Share of the longest step at which a path is given up: creases of the mesh's own size follow."""


@dataclass(frozen=True, kw_only=True)
class Point:
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
        Negative eigenvalues of the tangent under dead load; None if they cannot be told.
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
    points : list of Point
        What was found of it.
    """

    def __init__(self, text: str, points: "list[Point]") -> None:
        super().__init__(text)
        self.points = points


@dataclass(frozen=True, kw_only=True)
class Constraint:
    """``normal · (q − anchor) = distance``; with ``quadratic``, ‖q − anchor‖² = distance²."""

    anchor: FloatArray
    normal: FloatArray
    distance: float
    quadratic: bool = False

    @property
    def slack(self) -> float:
        """What may be left to meet it."""
        return float(GAP_TOL * abs(self.distance) ** (2 if self.quadratic else 1))

    def gap(self, unknowns: FloatArray) -> tuple[FloatArray, float]:
        """Row of the linearised constraint and what is left to meet it."""
        moved = unknowns - self.anchor
        if self.quadratic:
            return 2.0 * moved, self.distance**2 - float(moved @ moved)
        return self.normal, self.distance - float(self.normal @ moved)


def rest(model: AxiModel, load: FloatArray) -> Point:
    """Return the unloaded body.

    Parameters
    ----------
    model : AxiModel
        The body.
    load : (n,) float
        Dead force on the unknowns at λ = 1, N.
    """
    start = np.zeros(model.count)
    return _point(load, start, 0.0, _state(model, start))


def _state(model: AxiModel, unknowns: FloatArray) -> State:
    state = model.state(unknowns)
    if state is None:
        raise NotFoundError("an element of the switch turns inside out; ask for shorter steps")
    return state


def _factor(state: State) -> Any:
    from scipy.sparse.linalg import splu

    try:
        return splu(state.tangent, **SUPERLU)
    except RuntimeError:
        raise NotFoundError("the tangent is singular") from None


def _point(load: FloatArray, unknowns: FloatArray, factor_: float, state: State) -> Point:
    factor = _factor(state)
    return Point(
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
) -> Point:
    """Equilibrium on a constraint, by Newton's method from a guess of q and λ.

    Raises
    ------
    NotFoundError
        If it does not converge.
    """
    unknowns, factor_ = guess
    extent = float(np.abs(model.mesh.nodes_mm).max())
    first = np.inf
    for _ in range(ITERATIONS):
        state = _state(model, unknowns)
        left = state.force - factor_ * load
        row, gap = constraint.gap(unknowns)
        size = float(np.linalg.norm(left))
        # Under a tiny load forces are as good as the positions they come from are rounded.
        rounding = EPS * extent * float(np.linalg.norm(state.tangent.diagonal()))
        floor = max(RESIDUAL_TOL * state.gross_N, rounding, 1e-300)
        if size <= floor and abs(gap) <= constraint.slack:
            return _point(load, unknowns, factor_, state)
        first = min(first, size)
        if not np.isfinite(size) or size > 1e6 * max(first, floor):
            break
        factor = _factor(state)
        balance, drive = factor.solve(-left), factor.solve(load)
        change = (gap - float(row @ balance)) / float(row @ drive)
        unknowns = unknowns + balance + change * drive
        factor_ += change
    raise NotFoundError("Newton's method does not converge")


@dataclass(frozen=True, kw_only=True)
class Course:
    """How a path is followed.

    Attributes
    ----------
    unknown : int
        The unknown that displacement control moves, and that ``end_mm`` is about.
    end_mm : float
        Where the path ends: its signed displacement.
    steps : int
        Steps wanted from rest to there; short ones are taken where the path bends.
    arc : {"never", "needed", "always"}
        Arc-length, where displacement control fails (snap-back), or from the start.
    """

    unknown: int
    end_mm: float
    steps: int = 30
    arc: Literal["never", "needed", "always"] = "needed"


def trace(
    model: AxiModel, load: FloatArray, course: Course, start: Point | None = None
) -> list[Point]:
    """Follow a path from rest (or ``start``) until the followed unknown reaches its end.

    Raises
    ------
    PathError
        If it cannot be followed that far; it holds the points found under the first control.
    """
    points = [start or rest(model, load)]
    if course.arc == "always":
        return _follow(model, load, course, points, arc=True)
    try:
        return _follow(model, load, course, points, arc=False)
    except PathError as error:
        if course.arc == "never":
            raise
        found = error.points
    try:
        return _follow(model, load, course, list(found), arc=True)
    except PathError as error:
        raise PathError(str(error), found) from None


def _follow(
    model: AxiModel, load: FloatArray, course: Course, points: list[Point], *, arc: bool
) -> list[Point]:
    longest = abs(course.end_mm) / course.steps
    step, limit, end = 0.5 * longest, longest, len(points) + 3 * course.steps
    onward = points[-1].unknowns - points[-2].unknowns if len(points) > 1 else points[0].drive
    if arc:
        limit = _arc_of(points, longest, course)
        step = 0.5 * limit
    while (left := _left(course, points[-1])) > 1e-9 * abs(course.end_mm):
        here = points[-1]
        try:
            made, astray = (
                _by_arc(model, load, here, onward, step)
                if arc
                else _by_displacement(model, load, here, course, min(step, left))
            )
        except NotFoundError:
            astray = np.inf
        if astray > STRAY:
            step = 0.5 * step
        else:
            onward = made.unknowns - here.unknowns
            points.append(made)
            limit = _arc_of(points, longest, course) if arc else longest
            step = min(step * float(np.clip(np.sqrt(0.1 / max(astray, 1e-9)), 0.5, 2.0)), limit)
        if step < SHORTEST * limit or len(points) > end:
            raise PathError(
                "the switch's path cannot be followed beyond "
                f"{abs(points[-1].unknowns[course.unknown]):.4g} of {abs(course.end_mm):.4g} mm "
                f"(after {len(points)} points); ask for a thinner wall or a shorter way",
                points,
            )
    return points


def _left(course: Course, point: Point) -> float:
    return float(np.sign(course.end_mm) * (course.end_mm - point.unknowns[course.unknown]))


def _arc_of(points: list[Point], longest: float, course: Course) -> float:
    """Arc-length that moves the followed unknown by about ``longest`` where it moves most."""
    return longest * min(
        float(np.linalg.norm(p.drive) / max(abs(p.drive[course.unknown]), 1e-300)) for p in points
    )


def _by_displacement(
    model: AxiModel, load: FloatArray, here: Point, course: Course, step: float
) -> tuple[Point, float]:
    move = float(np.sign(course.end_mm)) * step
    normal = np.eye(1, model.count, course.unknown)[0]
    rate = move / float(here.drive[course.unknown])
    before = rate * here.drive
    constraint = Constraint(anchor=here.unknowns, normal=normal, distance=move)
    guess = (here.unknowns + before, here.load_factor + rate)
    made = correct(model, load, guess, constraint)
    after = move / float(made.drive[course.unknown]) * made.drive
    return made, stray(made.unknowns - here.unknowns, before, after)


def _by_arc(
    model: AxiModel, load: FloatArray, here: Point, onward: FloatArray, step: float
) -> tuple[Point, float]:
    rate = step / float(np.linalg.norm(here.drive)) * (1.0 if onward @ here.drive >= 0.0 else -1.0)
    before = rate * here.drive
    constraint = Constraint(anchor=here.unknowns, normal=before, distance=step, quadratic=True)
    guess = (here.unknowns + before, here.load_factor + rate)
    made = correct(model, load, guess, constraint)
    moved = made.unknowns - here.unknowns
    after = step / float(np.linalg.norm(made.drive)) * made.drive
    return made, stray(moved, before, after if moved @ after >= 0.0 else -after)
