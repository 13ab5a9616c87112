"""Equilibrium paths by displacement or by arc-length, through limit points; for verification."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phytac_design.mechanics.large.load_path import (
    SETTINGS,
    ByArc,
    PathCheck,
    arc_deviation,
    at_rest,
    path_sign,
    translations,
    visit,
)
from phytac_design.mechanics.large.newton import (
    Equilibrium,
    NewtonStep,
    NotConvergedError,
    System,
    increment,
)
from phytac_design.mechanics.large.stability import PATH_DEVIATION_MAX
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class ByDisplacement:
    """DOF ``dof`` (6·node + axis, a translation) moves by ``distance_mm`` in this increment."""

    dof: int
    distance_mm: float

    def change(self, step: NewtonStep) -> float:
        """δλ; see :class:`newton.Control`."""
        drive = float(step.drive[self.dof])
        if drive == 0.0:
            raise NotConvergedError(
                "path-direction-lost", "the controlled displacement does not feel the load"
            )
        gap = self.distance_mm - float(step.moved[self.dof]) - float(step.balance[self.dof])
        return gap / drive


def trace_displacement(
    model: ShellModel, load: Any, *, dof: int, stops_mm: Iterable[float]
) -> list[Equilibrium]:
    """Equilibria at which one translation has the values ``stops_mm``; λ follows.

    Passes load limits (snap-through), not turns of the displacement itself (snap-back): states
    found beyond one are marked ``jumped``.

    Parameters
    ----------
    model, load
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
    system = System(model, load)
    if dof % 6 > 2 or not 0 <= dof < model.fixed.size or model.fixed.ravel()[dof]:
        raise NumericalError(
            "path-dof-invalid", f"dof {dof} is not a free translation (6·node + 0, 1 or 2)"
        )
    node, axis = divmod(dof, 6)
    return visit(
        system,
        np.asarray(list(stops_mm), dtype=np.float64),
        lambda here: float(here.state.displacement_mm[node, axis]),
        lambda change: ByDisplacement(dof=dof, distance_mm=change),
        PathCheck(
            pace=lambda here: float(here.rate[dof]),
            mark=lambda here: path_sign(here, float(here.rate[dof])),
        ),
        "displacement (mm)",
    )


def trace_arc(
    model: ShellModel,
    load: Any,
    *,
    first_mm: float,
    longest_mm: float,
    stop: Callable[[Equilibrium], bool],
    max_increments: int = 500,
) -> list[Equilibrium]:
    """Equilibrium path by arc-length: through load limits and through snap-backs.

    Parameters
    ----------
    model, load
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
    system = System(model, load)
    here, arc = at_rest(system), first_mm
    previous = np.zeros(model.fixed.size)
    out: list[Equilibrium] = []
    for _ in range(max_increments):
        for cut in range(SETTINGS.max_cutbacks + 1):
            try:
                there = increment(system, here, ByArc(arc_mm=arc, previous=previous))
                break
            except NotConvergedError as error:
                if cut == SETTINGS.max_cutbacks:
                    raise NumericalError(
                        "path-ended-early",
                        f"the path ends at load factor {here.load_factor:.6g} after {len(out)} "
                        f"increments ({error}); take shorter increments or refine the mesh",
                    ) from error
                arc /= 2.0
        previous = np.zeros_like(previous)
        travelled = there.state.displacement_mm - here.state.displacement_mm
        previous.reshape(-1, 6)[:, :3] = travelled
        here = replace(there, jumped=here.jumped or _left_path(here, there, travelled))
        out.append(here)
        if stop(here):
            return out
        arc = min(
            longest_mm, arc * min(2.0, np.sqrt(SETTINGS.arc_iterations / max(here.iterations, 1)))
        )
    raise NumericalError(
        "tracing-increments-exhausted",
        f"{max_increments} increments do not reach the stop (load factor now "
        f"{here.load_factor:.6g}); allow more or longer increments",
    )


def _left_path(before: Equilibrium, after: Equilibrium, travelled: FloatArray) -> bool:
    """Whether an increment of arc-length deviates from the path, or passed a branching point."""
    along = [float(np.sum(translations(state.rate) * travelled)) for state in (before, after)]
    if path_sign(before, along[0]) != path_sign(after, along[1]) and before.iterations:
        return True
    return arc_deviation(before, after) > PATH_DEVIATION_MAX
