"""Equilibrium paths under large displacements: by load, by displacement, or by arc-length."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

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
from phytac_design.mechanics.solve import ShellModel
from shapes.arrays import FloatArray
from shapes.errors import NumericalError

CUTBACKS = 10
"""How often an increment may be halved before the path is given up."""
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
    )


def solve_large(
    model: ShellModel, loading: Loading, *, factors: Iterable[float] = (1.0,)
) -> list[Equilibrium]:
    """Equilibria at the load factors ``factors``, in that order, under load control.

    Each is tried in one increment, halved where it does not converge.

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
        "load factor",
    )


def trace_displacement(
    model: ShellModel, loading: Loading, *, dof: int, stops_mm: Iterable[float]
) -> list[Equilibrium]:
    """Equilibria at which one translation has the values ``stops_mm``; λ follows.

    Passes load limits (snap-through), not turns of the displacement itself (snap-back).

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
        "displacement (mm)",
    )


def _visit(
    system: System,
    stops: FloatArray,
    where: Callable[[Equilibrium], float],
    control: Callable[[float], Control],
    label: str,
) -> list[Equilibrium]:
    """Walk from stop to stop, halving increments that fail and doubling after those that do not."""
    if not np.all(np.isfinite(stops)):
        raise NumericalError(f"a {label} to stop at is not finite (got {stops.tolist()})")
    here, out = at_rest(system), []
    for stop in stops.tolist():
        share, spent = 1.0, 0
        while where(here) != stop:
            left = stop - where(here)
            move = left if share >= 1.0 else share * left
            try:
                there = increment(system, here, control(move))
            except NotConvergedError as error:
                share, spent = share / 2.0, spent + 1
                if spent > CUTBACKS:
                    raise NumericalError(
                        f"no equilibrium at {label} {stop:.6g}: the path ends at "
                        f"{where(here):.6g}, load factor {here.load_factor:.6g} ({error}); likely "
                        "a limit point: follow the path by displacement or arc-length"
                    ) from error
                continue
            arrived = move == left
            here, share, spent = there, min(2.0 * share, 1.0), max(spent - 1, 0)
            if arrived:
                break
        out.append(here)
    return out


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
        here = there
        out.append(here)
        if stop(here):
            return out
        arc = min(longest_mm, arc * min(2.0, np.sqrt(DESIRED / max(here.iterations, 1))))
    raise NumericalError(
        f"{most} increments do not reach the stop asked for (load factor now "
        f"{here.load_factor:.6g}); allow more or longer increments"
    )
