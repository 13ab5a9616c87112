"""Equilibrium paths under large displacements: load steps, with cutbacks and path checks.

An increment that converges need not have followed the path: across a limit load Newton's method
finds the snapped shell. So each increment is compared with the tangents at its ends, and with the
sign of the (extended) tangent, which does not change along a regular path. Where one of them
disagrees the increment is halved. If shorter increments disagree too, the path bends sharply or has
a critical point ahead: it is followed by arc-length. If the control turns back on the way, or the
tangent's inertia (its number of negative eigenvalues, or the sign of its determinant) is another at
the end, the shell snaps, and the state is marked ``jumped``. Else the end of the path is returned:
a dip of the control by less than 1 % on the way, from which the path returns with the inertia that
it had, is no snap.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phytac_design.mechanics.large.newton import (
    Control,
    Equilibrium,
    NewtonStep,
    NotConvergedError,
    System,
    increment,
)
from phytac_design.mechanics.large.stability import PATH_DEVIATION_MAX, path_deviation
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class PathSettings:
    """Limits of a path in load steps."""

    max_cutbacks: int = 10
    """Halvings of an increment before the path ends."""
    max_increments: int = 200
    """Increments tried between two stops."""
    min_increment_share: float = 1.0 / 16.0
    """Shortest increment, as a share of the remaining distance, that is tried to follow the
    path."""
    arc_share: float = 1.0 / 8.0
    """First arc-length, as a share of the distance to the state that is off the path."""
    dip_share: float = 0.01
    """Least fall of the control on the way, of its value at the stop, that is a snap. The open
    cylinder that is pulled apart has one of 0.001 at half its load."""
    arc_iterations: int = 6
    """Iterations per increment that an arc-length aims at."""


SETTINGS = PathSettings()


@dataclass(frozen=True, kw_only=True)
class ByLoad:
    """λ changes by ``change_wanted`` in this increment."""

    change_wanted: float

    def change(self, step: NewtonStep) -> float:
        """δλ; see :class:`newton.Control`."""
        return self.change_wanted - step.gained


@dataclass(frozen=True, kw_only=True)
class ByArc:
    """Root mean square translation of all nodes is ``arc_mm`` in this increment (Crisfield 1981).

    The first step runs along the tangent, onward from ``previous`` (6N,), the increment before;
    then the constraint is linearised about the motion so far, and met exactly at convergence.
    """

    arc_mm: float
    previous: FloatArray

    def change(self, step: NewtonStep) -> float:
        """δλ; see :class:`newton.Control`."""
        count = len(step.moved) / 6.0
        move, tangent, fix = (
            v.reshape(-1, 6)[:, :3].ravel() for v in (step.moved, step.drive, step.balance)
        )
        if not np.any(move):
            onward = self.previous.reshape(-1, 6)[:, :3].ravel() @ tangent
            sign = -1.0 if onward < 0.0 else 1.0
            return float(sign * self.arc_mm * np.sqrt(count) / np.linalg.norm(tangent))
        gap = count * self.arc_mm**2 - float(move @ move)
        slope = float(move @ tangent)
        if slope == 0.0:
            raise NotConvergedError(
                "path-turns-sharply", "the path turns at a right angle within one increment"
            )
        return (0.5 * gap - float(move @ fix)) / slope


def at_rest(system: System) -> Equilibrium:
    """Return the unloaded state."""
    return Equilibrium(
        load_factor=0.0,
        state=system.shell.rest(),
        reactions=np.zeros((len(system.model.nodes_mm), 6)),
        residual=0.0,
        last_step=0.0,
        iterations=0,
        rate=system.initial_rate,
        negative_pivots=0,
    )


def solve_large(
    model: ShellModel, load: Any, *, factors: Iterable[float] = (1.0,)
) -> list[Equilibrium]:
    """Equilibria at the load factors ``factors``, in that order, under load control.

    Each is tried in one increment, halved where it does not converge or leaves the path. Past a
    limit load the state found is a snapped one; it is marked ``jumped``.

    Parameters
    ----------
    model : ShellModel
        The shell.
    load : (6N,) float, dense or scipy.sparse
        Dead nodal forces (N) and moments (N mm, fixed axes) at λ = 1.
    factors : iterable of float
        Load factors to stop at.

    Raises
    ------
    NumericalError
        If an equilibrium is not found, e.g. past a limit load: the message says where the path
        ended and why.
    """
    system = System(model, load)
    return visit(
        system,
        np.asarray(list(factors), dtype=np.float64),
        lambda here: here.load_factor,
        lambda change: ByLoad(change_wanted=change),
        PathCheck(pace=lambda _: 1.0, mark=lambda here: here.negative_pivots),
        "load factor",
    )


@dataclass(frozen=True, kw_only=True)
class PathCheck:
    """Whether an increment followed the path.

    Attributes
    ----------
    pace : callable
        Change of the controlled quantity per unit of λ at a state.
    mark : callable
        Sign of the extended tangent (with the control), or the count of negative pivots.
    """

    pace: Callable[[Equilibrium], float]
    mark: Callable[[Equilibrium], int | None]

    def deviates(self, before: Equilibrium, after: Equilibrium, move: float) -> bool:
        """Whether the increment of ``move`` from one state to the other deviates from the path."""
        ends = [self.pace(before), self.pace(after)]
        if 0.0 in ends or self.mark(before) != self.mark(after):
            return True
        tangents = [
            move / pace * translations(state.rate)
            for pace, state in zip(ends, (before, after), strict=True)
        ]
        moved = after.state.displacement_mm - before.state.displacement_mm
        return path_deviation(moved, *tangents) > PATH_DEVIATION_MAX


def translations(motion: FloatArray) -> FloatArray:
    """Translations (N, 3) of a motion (6N,) or (N, 6)."""
    return motion.reshape(-1, 6)[:, :3]


def arc_deviation(before: Equilibrium, after: Equilibrium) -> float:
    """Deviation of an increment from tangents at its ends that are as long as it is."""
    moved = after.state.displacement_mm - before.state.displacement_mm
    length = float(np.linalg.norm(moved))
    tangents = []
    for state in (before, after):
        tangent = translations(state.rate)
        way = np.sign(float(np.sum(tangent * moved)))
        tangents.append(way * length / np.linalg.norm(tangent) * tangent)
    return path_deviation(moved, *tangents)


def path_sign(here: Equilibrium, pace: float) -> int | None:
    """Sign of det K times that of ``pace``: of the tangent extended by its control."""
    if here.negative_pivots is None:
        return None
    return (1 if here.negative_pivots % 2 == 0 else -1) * (1 if pace > 0.0 else -1)


def visit(
    system: System,
    stops: FloatArray,
    where: Callable[[Equilibrium], float],
    control: Callable[[float], Control],
    check: PathCheck,
    label: str,
) -> list[Equilibrium]:
    """Advance from stop to stop; ``jumped`` stays set once an increment deviates."""
    if not np.all(np.isfinite(stops)):
        raise NumericalError(
            "path-stop-not-finite", f"a {label} to stop at is not finite (got {stops.tolist()})"
        )
    here, out = at_rest(system), []
    for stop in stops.tolist():
        try:
            here = _advance_to(system, here, stop, where, control, check)
        except _PathEndError as end:
            here = end.last
            raise NumericalError(
                "no-equilibrium",
                f"no equilibrium at {label} {stop:.6g}: the path ends at {where(here):.6g}, load "
                f"factor {here.load_factor:.6g} ({end}); likely a limit point: follow the path by "
                "displacement or arc-length",
            ) from end
        out.append(here)
    return out


class _PathEndError(NumericalError):
    """No increment leads on from the state ``last``."""

    def __init__(self, code: str, message: str, last: Equilibrium) -> None:
        super().__init__(code, message)
        self.args = (code, message, last)
        self.last = last


def _advance_to(
    system: System,
    here: Equilibrium,
    stop: float,
    where: Callable[[Equilibrium], float],
    control: Callable[[float], Control],
    check: PathCheck,
) -> Equilibrium:
    """Advance to ``stop``, halving increments that fail and doubling after those that do not.

    A state found off the path is kept while shorter increments are tried. If they end before
    it, the path is followed by arc-length; where that meets a critical point the state off the
    path is taken, marked ``jumped``.
    """
    share, spent = 1.0, 0
    off: tuple[Equilibrium, bool] | None = None  # the state, and whether it is at the stop
    for _ in range(SETTINGS.max_increments):
        if where(here) == stop:
            return here
        left = stop - where(here)
        move = left if share >= 1.0 else share * left
        found: tuple[Equilibrium, bool] | None = None
        try:
            there = increment(system, here, control(move), quick=off is not None)
            if not check.deviates(here, there, move):
                found = there, move == left
            elif off is None:
                off = there, move == left
        except NotConvergedError as error:
            spent += 1
            if spent > SETTINGS.max_cutbacks:
                raise _PathEndError(error.code, str(error), here) from error
        if found is None and off is not None and share <= SETTINGS.min_increment_share:
            target = _Target(where=where, place=where(off[0]), control=control, check=check)
            followed = _follow(system, here, off[0], target)
            found = followed or replace(off[0], jumped=True), off[1]
        if found is None:
            share /= 2.0
            continue
        here = replace(found[0], jumped=here.jumped or found[0].jumped)
        share, spent = min(2.0 * share, 1.0), max(spent - 1, 0)
        if found[1]:
            return here
        off = _still_ahead(off, where(here), left, where)
    raise _PathEndError(
        "path-increments-exhausted", f"{SETTINGS.max_increments} increments did not suffice", here
    )


@dataclass(frozen=True, kw_only=True)
class _Target:
    """Value ``place`` of the controlled quantity that a path is followed to."""

    where: Callable[[Equilibrium], float]
    place: float
    control: Callable[[float], Control]
    check: PathCheck

    def ahead(self, here: Equilibrium) -> float:
        """Change that is still needed."""
        return self.place - self.where(here)


def _follow(
    system: System, here: Equilibrium, off: Equilibrium, target: _Target
) -> Equilibrium | None:
    """State at the target along the path by arc-length; None if the shell snaps before.

    Parameters
    ----------
    system : System
        The shell and its load.
    here : Equilibrium
        Where the path is followed from.
    off : Equilibrium
        State at the target that may not be on the path.
    target : _Target
        Where the path is followed to.
    """
    nodes = len(system.model.nodes_mm)
    apart = off.state.displacement_mm - here.state.displacement_mm
    arc = SETTINGS.arc_share * float(np.linalg.norm(apart)) / np.sqrt(nodes)
    way = np.sign(target.ahead(here))
    previous = way * np.sign(target.check.pace(here)) * here.rate
    cuts, peak, mark = 0, way * target.where(here), target.check.mark(here)
    for _ in range(SETTINGS.max_increments):
        try:
            there = increment(system, here, ByArc(arc_mm=arc, previous=previous))
            lost = arc_deviation(here, there) > PATH_DEVIATION_MAX
        except NotConvergedError:
            lost = True
        if lost:
            cuts += 1
            if cuts > SETTINGS.max_cutbacks:
                return None
            arc /= 2.0
            continue
        peak = max(peak, way * target.where(there))
        if peak - way * target.where(there) > SETTINGS.dip_share * abs(target.place):
            return None
        if way * target.ahead(there) <= 0.0:
            try:
                end = increment(system, here, target.control(target.ahead(here)))
            except NotConvergedError:
                return None
            moved = end.state.displacement_mm - here.state.displacement_mm
            near = float(np.linalg.norm(moved)) <= 1.5 * arc * np.sqrt(nodes)
            return end if near and target.check.mark(end) == mark else None
        previous = np.zeros((nodes, 6))
        previous[:, :3] = there.state.displacement_mm - here.state.displacement_mm
        previous, here = previous.ravel(), there
        arc *= min(2.0, np.sqrt(SETTINGS.arc_iterations / max(here.iterations, 1)))
    return None


def _still_ahead(
    off: tuple[Equilibrium, bool] | None,
    place: float,
    way: float,
    where: Callable[[Equilibrium], float],
) -> tuple[Equilibrium, bool] | None:
    """Return the kept state, if it still lies ahead."""
    return off if off is not None and (where(off[0]) - place) * way > 0.0 else None
