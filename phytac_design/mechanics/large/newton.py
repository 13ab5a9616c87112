r"""Newton's method for one increment of a shell under large displacements.

Unknowns are the motion x and the load factor λ of ``R(x, λ) = f_int(x) − λ f(x) = 0`` with one
constraint (the control). Each step solves ``K a = −R`` and ``K b = ∂(λf)/∂λ`` and moves by
``a + δλ b``, δλ from the linearised constraint.

Two ways are tried before an increment is given up:

1. the geometric stiffness from the local forces *foreseen* by the last step (mixed Newton of
   Magisano, Leonetti and Garcea 2017), without a line search: few steps, large increments;
2. the consistent tangent with a line search on the work of the residual along the step.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from phytac_design.mechanics.large.corotational import Configuration, Corotational, Local
from phytac_design.mechanics.large.pressure_load import pressure_forces, pressure_stiffness
from phytac_design.mechanics.large.stability import negative_pivots
from phytac_design.mechanics.shell.solve import SUPERLU, ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

RESIDUAL_TOL = 1e-6
"""Largest norm of the unbalanced forces over that of the nodal forces (both scaled)."""
STEP_TOL = 1e-4
"""Largest last step over the whole motion; Newton's next would be about its square."""
ITERATIONS = 40
BRISK = 12
"""Iterations allowed where one tries only to follow a path closely; four to six are common."""
DIVERGED = 1e6
"""Growth of the residual over its first value that ends an attempt; foreseen forces allow much."""
SEARCH_SLACK = 0.8
"""A line search is over when the residual's work has fallen to this share."""
SEARCH_STEPS = 6
TURN = 0.5
"""Largest turn of a node in one step, rad; longer steps are shortened as a whole."""


@dataclass(frozen=True, kw_only=True)
class Loading:
    """What grows with the load factor λ; every part may be left out.

    Attributes
    ----------
    force : (6N,) float
        Dead nodal forces (N) and moments (N mm, fixed axes) at λ = 1.
    pressure_MPa : float
        Pressure at λ = 1 that follows the face, positive along the element normals.
    prescribed : (6N,) float
        Motion of the *held* DOFs at λ = 1, mm and rad (turns about fixed axes).
    """

    force: FloatArray | None = None
    pressure_MPa: float = 0.0
    prescribed: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class Equilibrium:
    """A converged state.

    Attributes
    ----------
    load_factor : float
        λ.
    state : Configuration
        Displacements and finite rotations.
    reactions : (N, 6) float
        Forces (N) and moments (N mm) of the supports on the shell; zero at free DOFs.
    residual : float
        Norm of the unbalanced over that of the nodal forces, scaled by the stiffness.
    last_step : float
        Last correction over the whole motion.
    iterations : int
        Steps taken in this increment, failed attempts not counted; 0 only at rest.
    rate : (6N,) float
        Motion per unit of λ along the path, mm and rad.
    negative_pivots : int or None
        Negative eigenvalues of the last tangent factored, which is that of a state within
        ``last_step`` of this one; None if they cannot be told.
    jumped : bool
        Whether the path from rest to this state cannot be vouched for: somewhere on the way an
        increment left the tangents at its ends or passed a critical point unseen, and shorter
        increments did not mend it. The state is an equilibrium, but the shell may have snapped.
    """

    load_factor: float
    state: Configuration
    reactions: FloatArray
    residual: float
    last_step: float
    iterations: int
    rate: FloatArray
    negative_pivots: int | None
    jumped: bool = False

    @property
    def stable(self) -> bool | None:
        """Whether the shell stays here while the *load* is held; None if that cannot be told.

        Between limit points it does not, even if a displacement control holds it there.
        """
        return None if self.negative_pivots is None else self.negative_pivots == 0


@dataclass(frozen=True, kw_only=True)
class Step:
    """A Newton step before its share of the load is known.

    Attributes
    ----------
    moved : (6N,) float
        Motion of this increment so far, mm and rad.
    gained : float
        Change of λ in this increment so far.
    balance, drive : (6N,) float
        ``a`` and ``b``: motion that balances the residual, and motion per unit of λ.
    """

    moved: FloatArray
    gained: float
    balance: FloatArray
    drive: FloatArray


class Control(Protocol):
    """The constraint that closes the equations."""

    def change(self, step: Step) -> float:
        """δλ such that ``balance + δλ drive`` meets the linearised constraint."""


class NotConvergedError(NumericalError):
    """One attempt at an increment failed; the message tells how."""


class System:
    """Residual, tangent and linear solves of one shell under one loading.

    Parameters
    ----------
    model : ShellModel
        Mesh, section, supports.
    loading : Loading
        What grows with λ.

    Raises
    ------
    NumericalError
        If a load is not finite, has the wrong size, is zero altogether, or if motion is
        prescribed at a DOF that is not held.
    """

    def __init__(self, model: ShellModel, loading: Loading) -> None:
        self.model = model
        self.shell = Corotational(model)
        size = model.fixed.size
        self.force = dense_vector(loading.force, size, "force")
        self.prescribed = dense_vector(loading.prescribed, size, "prescribed motion")
        self.pressure_MPa = float(loading.pressure_MPa)
        if not np.isfinite(self.pressure_MPa):
            raise NumericalError(f"the pressure is not finite (got {self.pressure_MPa})")
        if not (self.pressure_MPa or np.any(self.force) or np.any(self.prescribed)):
            raise NumericalError(
                f"the loading is zero (pressure {self.pressure_MPa:g} MPa, all {size} numbers of "
                "force and motion 0); give a force, a pressure or a motion"
            )
        self.free = np.flatnonzero(~model.fixed.ravel())
        if np.any(self.prescribed[self.free]):
            raise NumericalError("motion is prescribed at a DOF that is not held; hold it first")
        diagonal = model.stiffness.diagonal()
        self.scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        self._slots, self._skeleton = self._reduction()
        self._factor: Any = None

    def _reduction(self) -> tuple[Any, Any]:
        """Where the entries of the free block lie in a full matrix, and an empty free block."""
        full = self.model.stiffness.copy()
        full.data = np.arange(full.nnz, dtype=np.float64)
        free = full[self.free][:, self.free].tocsc()
        slots = free.data.astype(np.int64)
        column = np.repeat(np.arange(len(self.free)), np.diff(free.indptr))
        self._weights = self.scale[self.free[free.indices]] * self.scale[self.free[column]]
        return slots, free

    def applied(self, state: Configuration) -> FloatArray:
        """Forces at λ = 1 in this state, (6N,)."""
        if not self.pressure_MPa:
            return self.force
        deformed = self.model.nodes_mm + state.displacement_mm
        return self.force + self.pressure_MPa * pressure_forces(deformed, self.model.quads)

    def tangent(
        self, local: Local, state: Configuration, factor: float, forces: FloatArray | None
    ) -> Any:
        """∂R/∂x, (6N, 6N)."""
        K = self.shell.tangent(local, forces)
        if self.pressure_MPa:
            deformed = self.model.nodes_mm + state.displacement_mm
            follow = self.shell.assembled(pressure_stiffness(deformed, self.model.quads))
            # Same pattern; a sparse difference would drop zeros from it.
            K.data -= factor * self.pressure_MPa * follow.data
        return K

    def directions(
        self, K: Any, residual: FloatArray, applied: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Motion (6N,) that balances the residual, and motion per unit of λ."""
        from scipy.sparse.linalg import splu

        self._skeleton.data = K.data[self._slots] * self._weights
        self._factor = None  # two factors at once would double the memory
        try:
            factor = self._factor = splu(self._skeleton, **SUPERLU)
        except RuntimeError as error:
            raise NotConvergedError(f"the tangent is singular ({error})") from error
        drive = applied - K @ self.prescribed if np.any(self.prescribed) else applied
        right = np.stack([-residual[self.free], drive[self.free]], axis=1)
        scale = self.scale[self.free, None]
        both = scale * factor.solve(scale * right)
        if not np.all(np.isfinite(both)):
            raise NotConvergedError("the tangent is singular to working precision")
        a, b = np.zeros_like(residual), self.prescribed.copy()
        a[self.free], b[self.free] = both.T
        return a, b

    def forget(self) -> None:
        """Drop the factor of the last tangent."""
        self._factor = None

    def instabilities(self) -> int | None:
        """Negative eigenvalues of the last tangent factored; none was: of that at rest."""
        return 0 if self._factor is None else negative_pivots(self._factor, self._skeleton)

    @cached_property
    def from_rest(self) -> FloatArray:
        """Motion (6N,) per unit of λ from the unloaded state, by the model's own factorisation."""
        drive = self.applied(self.shell.rest()) - self.model.stiffness @ self.prescribed
        return np.asarray(self.model.solve(drive).motion.ravel() + self.prescribed)

    def size(self, vector: FloatArray) -> float:
        """Norm of forces (6N,), scaled so that forces and moments compare."""
        return float(np.linalg.norm(self.scale * vector))

    def length(self, motion: FloatArray) -> float:
        """Norm of a motion (6N,) or (N, 6) in the same scale."""
        return float(np.linalg.norm(motion.ravel() / self.scale))


def dense_vector(value: Any, size: int, label: str) -> FloatArray:
    """Array (size,) of a dense or sparse vector, refused if it is not finite or of another size."""
    if value is None:
        return np.zeros(size)
    dense = np.asarray(value.toarray() if hasattr(value, "toarray") else value, dtype=np.float64)
    if dense.size != size or not np.all(np.isfinite(dense)):
        raise NumericalError(
            f"the {label} needs one finite value per DOF, {size} in all (got {dense.size}, "
            f"{int(np.sum(~np.isfinite(dense)))} of them not finite)"
        )
    return dense.ravel().copy()


def increment(
    system: System, start: Equilibrium, control: Control, *, brisk: bool = False
) -> Equilibrium:
    """Converged state that meets ``control``, from the converged state ``start``.

    ``brisk`` gives up after ``BRISK`` iterations of the first way.

    Raises
    ------
    NotConvergedError
        If neither way converges; the message holds the reason of the last.
    """
    if brisk:
        return _iterate(system, start, control, foresee=True, most=min(BRISK, ITERATIONS))
    try:
        return _iterate(system, start, control, foresee=True)
    except NotConvergedError:
        return _iterate(system, start, control, foresee=False)


def _iterate(
    system: System,
    start: Equilibrium,
    control: Control,
    *,
    foresee: bool,
    most: int | None = None,
) -> Equilibrium:
    most = ITERATIONS if most is None else most
    state, factor = start.state, start.load_factor
    moved = np.zeros(system.model.fixed.size)
    forces: FloatArray | None = None
    first = last_step = residual_size = np.inf
    b = moved
    system.forget()
    for iteration in range(most + 1):
        local = _seen(system, state)
        applied = system.applied(state)
        internal = system.shell.internal(local)
        residual = internal - factor * applied
        residual[system.model.fixed.ravel()] = 0.0
        nodal = max(system.size(internal), system.size(factor * applied), 1e-300)
        residual_size = system.size(residual) / nodal
        if iteration and residual_size <= RESIDUAL_TOL and last_step <= STEP_TOL:
            reactions = np.where(system.model.fixed.ravel(), internal - factor * applied, 0.0)
            return Equilibrium(
                load_factor=factor,
                state=state,
                reactions=reactions.reshape(-1, 6),
                residual=residual_size,
                last_step=last_step,
                iterations=iteration,
                rate=b,
                negative_pivots=system.instabilities(),
            )
        if iteration == 1:
            first = max(system.size(residual), 1e-300)
        if not system.size(residual) <= DIVERGED * first:
            raise NotConvergedError(f"the iteration diverges (residual {residual_size:.2g})")
        if iteration == most:
            break
        if iteration == 0 and start.iterations == 0:
            a, b = np.zeros_like(moved), system.from_rest
        else:
            K = system.tangent(local, state, factor, forces if foresee else None)
            a, b = system.directions(K, residual, applied)
        gained = factor - start.load_factor
        change = control.change(Step(moved=moved, gained=gained, balance=a, drive=b))
        step = a + change * b
        turn = float(np.abs(step.reshape(-1, 6)[:, 3:]).max())
        if turn > TURN:
            step, change = step * (TURN / turn), change * (TURN / turn)
        elif not foresee and iteration:
            step, change = _searched(system, state, factor, residual, (step, change))
        if foresee:
            forces = system.shell.foreseen(local, step)
        state, moved, factor = state.moved(step), moved + step, factor + change
        last_step = system.length(step) / max(system.length(state.motion), 1e-300)
    raise NotConvergedError(
        f"no convergence in {most} iterations (residual {residual_size:.2g}, last step "
        f"{last_step:.2g})"
    )


def _seen(system: System, state: Configuration) -> Local:
    try:
        return system.shell.local(state)
    except (NumericalError, np.linalg.LinAlgError) as error:
        raise NotConvergedError(str(error)) from error


def _searched(
    system: System,
    state: Configuration,
    factor: float,
    residual: FloatArray,
    move: tuple[FloatArray, float],
) -> tuple[FloatArray, float]:
    """Shorten a step until the residual's work along it has fallen (Crisfield 1991, 9.2)."""
    step, change = move
    before = float(step @ residual)
    share = 1.0
    for _ in range(SEARCH_STEPS):
        try:
            there = state.moved(share * step)
            after = system.shell.internal(_seen(system, there))
            after = after - (factor + share * change) * system.applied(there)
            work = float(step[system.free] @ after[system.free])
        except NotConvergedError:
            share *= 0.5
            continue
        if abs(work) <= SEARCH_SLACK * abs(before) or before == 0.0:
            break
        # Secant of the work along the step, kept between a tenth and a half of the last share.
        secant = share * before / (before - work) if before != work else 0.5 * share
        share = min(max(secant, 0.1 * share), 0.5 * share)
    return share * step, share * change
