"""Equilibrium paths under large displacements: by load, by displacement, or by arc-length.

An increment that converges need not have followed the path: across a limit load Newton's method
finds the snapped shell. So each increment is held against the tangents at its ends, and against
the sign of the (extended) tangent, which no regular path changes; where either objects, the
increment is halved, and what shorter increments do not mend is marked ``jumped``.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from phytac_design.mechanics.large.newton import (
    Control,
    Equilibrium,
    Loading,
    NotConvergedError,
    Step,
    System,
    increment,
)
from phytac_design.mechanics.large.stability import STRAY, stray
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

CUTBACKS = 10
"""How often an increment may be halved before the path is given up."""
MOST = 200
"""Increments tried between two stops, so that shrinking ones cannot go on for ever."""
SHORTEST = 1.0 / 16.0
"""Share of the way left down to which an increment is shortened to follow the path."""
DESIRED = 6
"""Iterations per increment that an arc-length step aims at."""


@dataclass(frozen=True, kw_only=True)
class ByLoad:
    """λ reaches ``target`` at once: ``change_wanted`` is what is left of it."""

    change_wanted: float

    def change(self, step: Step) -> float:
        """δλ; see :class:`newton.Control`."""
        return self.change_wanted - step.gained


@dataclass(frozen=True, kw_only=True)
class ByDisplacement:
    """DOF ``dof`` (6·node + axis, a translation) moves by ``distance_mm`` in this increment."""

    dof: int
    distance_mm: float

    def change(self, step: Step) -> float:
        """δλ; see :class:`newton.Control`."""
        drive = float(step.drive[self.dof])
        if drive == 0.0:
            raise NotConvergedError("the controlled displacement does not feel the load")
        gap = self.distance_mm - float(step.moved[self.dof]) - float(step.balance[self.dof])
        return gap / drive


@dataclass(frozen=True, kw_only=True)
class ByArc:
    """Root mean square translation of all nodes is ``arc_mm`` in this increment (Crisfield 1981).

    The first step runs along the tangent, onward from ``previous`` (6N,), the increment before;
    then the constraint is linearised about the motion so far, and met exactly at convergence.
    """

    arc_mm: float
    previous: FloatArray

    def change(self, step: Step) -> float:
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
            raise NotConvergedError("the path turns at a right angle within one increment")
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
        rate=system.from_rest,
        negative_pivots=0,
    )


def solve_large(
    model: ShellModel, loading: Loading, *, factors: Iterable[float] = (1.0,)
) -> list[Equilibrium]:
    """Equilibria at the load factors ``factors``, in that order, under load control.

    Each is tried in one increment, halved where it does not converge or leaves the path. Past a
    limit load the state found is a snapped one; it is marked ``jumped``.

    Parameters
    ----------
    model : ShellModel
        The shell.
    loading : Loading
        Forces, pressure and prescribed motion at λ = 1.
    factors : iterable of float
        Load factors to stop at.

    Raises
    ------
    NumericalError
        If an equilibrium is not found, e.g. past a limit load: the message tells how far the path
        went and why it ended.
    """
    system = System(model, loading)
    return _visit(
        system,
        np.asarray(list(factors), dtype=np.float64),
        lambda here: here.load_factor,
        lambda change: ByLoad(change_wanted=change),
        Guard(pace=lambda _: 1.0, mark=lambda here: here.negative_pivots),
        "load factor",
    )


def trace_displacement(
    model: ShellModel, loading: Loading, *, dof: int, stops_mm: Iterable[float]
) -> list[Equilibrium]:
    """Equilibria at which one translation has the values ``stops_mm``; λ follows.

    Passes load limits (snap-through), not turns of the displacement itself (snap-back): states
    found beyond one are marked ``jumped``.

    Parameters
    ----------
    model, loading
        See :func:`solve_large`.
    dof : int
        6·node + axis (0, 1, 2) of a free DOF.
    stops_mm : iterable of float
        Displacements to stop at, mm, in order.

    Raises
    ------
    NumericalError
        As in :func:`solve_large`; or if ``dof`` is not a free translation.
    """
    system = System(model, loading)
    if dof % 6 > 2 or not 0 <= dof < model.fixed.size or model.fixed.ravel()[dof]:
        raise NumericalError(f"dof {dof} is not a free translation (6·node + 0, 1 or 2)")
    node, axis = divmod(dof, 6)
    return _visit(
        system,
        np.asarray(list(stops_mm), dtype=np.float64),
        lambda here: float(here.state.displacement_mm[node, axis]),
        lambda change: ByDisplacement(dof=dof, distance_mm=change),
        Guard(
            pace=lambda here: float(here.rate[dof]),
            mark=lambda here: _sign(here, float(here.rate[dof])),
        ),
        "displacement (mm)",
    )


@dataclass(frozen=True, kw_only=True)
class Guard:
    """What tells a path that was followed from one that was left.

    Attributes
    ----------
    pace : callable
        Change of the controlled quantity per unit of λ at a state.
    mark : callable
        Sign of the extended tangent (with the control), or the count of negative pivots.
    """

    pace: Callable[[Equilibrium], float]
    mark: Callable[[Equilibrium], int | None]

    def left(self, before: Equilibrium, after: Equilibrium, move: float) -> bool:
        """Whether the increment of ``move`` from one state to the other left the path."""
        ends = [self.pace(before), self.pace(after)]
        if 0.0 in ends or self.mark(before) != self.mark(after):
            return True
        tangents = [
            move / pace * _translations(state.rate)
            for pace, state in zip(ends, (before, after), strict=True)
        ]
        moved = after.state.displacement_mm - before.state.displacement_mm
        return stray(moved, *tangents) > STRAY


def _translations(motion: FloatArray) -> FloatArray:
    return motion.reshape(-1, 6)[:, :3]


def _sign(here: Equilibrium, pace: float) -> int | None:
    """Sign of det K times that of ``pace``: of the tangent extended by its control."""
    if here.negative_pivots is None:
        return None
    return (1 if here.negative_pivots % 2 == 0 else -1) * (1 if pace > 0.0 else -1)


def _visit(
    system: System,
    stops: FloatArray,
    where: Callable[[Equilibrium], float],
    control: Callable[[float], Control],
    guard: Guard,
    label: str,
) -> list[Equilibrium]:
    """Walk from stop to stop; ``jumped`` stays set behind an increment that left the path."""
    if not np.all(np.isfinite(stops)):
        raise NumericalError(f"a {label} to stop at is not finite (got {stops.tolist()})")
    here, out = at_rest(system), []
    for stop in stops.tolist():
        try:
            here = _reach(system, here, stop, where, control, guard)
        except _PathEndError as end:
            here = end.last
            raise NumericalError(
                f"no equilibrium at {label} {stop:.6g}: the path ends at {where(here):.6g}, load "
                f"factor {here.load_factor:.6g} ({end}); likely a limit point: follow the path by "
                "displacement or arc-length"
            ) from end
        out.append(here)
    return out


class _PathEndError(NumericalError):
    """No increment leads on from the state ``last``."""

    def __init__(self, message: str, last: Equilibrium) -> None:
        super().__init__(message)
        self.last = last


def _reach(
    system: System,
    here: Equilibrium,
    stop: float,
    where: Callable[[Equilibrium], float],
    control: Callable[[float], Control],
    guard: Guard,
) -> Equilibrium:
    """Go on to ``stop``, halving increments that fail and doubling after those that do not.

    A state found off the path is kept while shorter increments are tried. If they end before
    it, it is taken, marked ``jumped``.
    """
    share, spent = 1.0, 0
    off: tuple[Equilibrium, bool] | None = None  # the state, and whether it is at the stop
    for _ in range(MOST):
        if where(here) == stop:
            return here
        left = stop - where(here)
        move = left if share >= 1.0 else share * left
        found: tuple[Equilibrium, bool] | None = None
        try:
            there = increment(system, here, control(move), brisk=off is not None)
            if not guard.left(here, there, move):
                found = there, move == left
            elif off is None:
                off = there, move == left
        except NotConvergedError as error:
            spent += 1
            if spent > CUTBACKS:
                raise _PathEndError(str(error), here) from error
        if found is None and off is not None and share <= SHORTEST:
            found = replace(off[0], jumped=True), off[1]
        if found is None:
            share /= 2.0
            continue
        here = replace(found[0], jumped=here.jumped or found[0].jumped)
        share, spent = min(2.0 * share, 1.0), max(spent - 1, 0)
        if found[1]:
            return here
        off = _ahead(off, where(here), left, where)
    raise _PathEndError(f"{MOST} increments did not suffice", here)


def _ahead(
    off: tuple[Equilibrium, bool] | None,
    place: float,
    way: float,
    where: Callable[[Equilibrium], float],
) -> tuple[Equilibrium, bool] | None:
    """Return the state kept, if it still lies ahead."""
    return off if off is not None and (where(off[0]) - place) * way > 0.0 else None


def trace_arc(
    model: ShellModel,
    loading: Loading,
    *,
    first_mm: float,
    longest_mm: float,
    stop: Callable[[Equilibrium], bool],
    most: int = 500,
) -> list[Equilibrium]:
    """Equilibrium path by arc-length: through load limits and through snap-backs.

    Parameters
    ----------
    model, loading
        See :func:`solve_large`.
    first_mm, longest_mm : float
        First and longest increment: root mean square translation of all nodes, mm. Increments
        adapt to the iterations needed.
    stop : callable
        Whether an equilibrium is the last wanted.
    most : int
        Increments allowed.

    Raises
    ------
    NumericalError
        If an increment does not converge after halvings, or ``stop`` is never met.
    """
    system = System(model, loading)
    here, arc = at_rest(system), first_mm
    previous = np.zeros(model.fixed.size)
    out: list[Equilibrium] = []
    for _ in range(most):
        for cut in range(CUTBACKS + 1):
            try:
                there = increment(system, here, ByArc(arc_mm=arc, previous=previous))
                break
            except NotConvergedError as error:
                if cut == CUTBACKS:
                    raise NumericalError(
                        f"the path ends at load factor {here.load_factor:.6g} after {len(out)} "
                        f"increments ({error}); take shorter increments or refine the mesh"
                    ) from error
                arc /= 2.0
        previous = np.zeros_like(previous)
        travelled = there.state.displacement_mm - here.state.displacement_mm
        previous.reshape(-1, 6)[:, :3] = travelled
        here = replace(there, jumped=here.jumped or _strayed(here, there, travelled))
        out.append(here)
        if stop(here):
            return out
        arc = min(longest_mm, arc * min(2.0, np.sqrt(DESIRED / max(here.iterations, 1))))
    raise NumericalError(
        f"{most} increments do not reach the stop asked for (load factor now "
        f"{here.load_factor:.6g}); allow more or longer increments"
    )


def _strayed(before: Equilibrium, after: Equilibrium, travelled: FloatArray) -> bool:
    """Whether an increment of arc-length left the path, or passed a branching point."""
    along = [float(np.sum(_translations(state.rate) * travelled)) for state in (before, after)]
    if _sign(before, along[0]) != _sign(after, along[1]) and before.iterations:
        return True
    length = float(np.linalg.norm(travelled))
    tangents = [
        np.sign(way)
        * length
        / np.linalg.norm(state.rate.reshape(-1, 6)[:, :3])
        * _translations(state.rate)
        for way, state in zip(along, (before, after), strict=True)
    ]
    return stray(travelled, *tangents) > STRAY
