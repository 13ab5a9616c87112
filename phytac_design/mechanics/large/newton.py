r"""Newton's method for one increment of a shell under large displacements.

Unknowns are the motion x and the load factor λ of ``R(x, λ) = f_int(x) − λ f(x) = 0`` with one
constraint (the control). Each step solves ``K a = −R`` and ``K b = ∂(λf)/∂λ`` and moves by
``a + δλ b``, δλ from the linearised constraint.

Two methods are tried before an increment fails:

1. the geometric stiffness from the local forces *predicted* by the last step (mixed Newton of
   Magisano, Leonetti and Garcea 2017), without a line search: few steps, large increments;
2. the consistent tangent with a line search on the work of the residual along the step.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from phytac_design.mechanics.large.corotational import Configuration, Corotational, LocalElements
from phytac_design.mechanics.large.free_block import FreeBlock
from phytac_design.mechanics.large.stability import negative_pivots
from phytac_design.mechanics.shell.solve import SUPERLU, ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class NewtonSettings:
    """Tolerances and limits of one increment."""

    residual_tolerance: float = 1e-6
    """Largest norm of the unbalanced forces over that of the nodal forces (both scaled)."""
    step_tolerance: float = 1e-4
    """Largest last step over the whole motion; Newton's next would be about its square."""
    max_iterations: int = 40
    max_iterations_quick: int = 12
    """Iterations of a quick attempt; four to six are common."""
    divergence_factor: float = 1e6
    """Growth of the residual over its first value that ends an attempt."""
    line_search_target: float = 0.8
    """A line search is over when the residual's work has fallen to this share."""
    line_search_steps: int = 6
    max_rotation_rad: float = 0.5
    """Largest rotation of a node in one step; longer steps are scaled down."""


SETTINGS = NewtonSettings()


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
        ``last_step`` of this one; None if they are unknown.
    jumped : bool
        Whether the path from rest to this state is uncertain: an increment deviated from the
        tangents at its ends or passed a critical point, and shorter increments did too. The state
        is an equilibrium, but the shell may have snapped.
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
        """Whether the shell stays here while the *load* is held; None if that is unknown.

        Between limit points it does not, even if a displacement control holds it there.
        """
        return None if self.negative_pivots is None else self.negative_pivots == 0


@dataclass(frozen=True, kw_only=True)
class NewtonStep:
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

    def change(self, step: NewtonStep) -> float:
        """δλ such that ``balance + δλ drive`` meets the linearised constraint."""


class NotConvergedError(NumericalError):
    """One attempt at an increment failed; the message says why."""


class System:
    """Residual, tangent and linear solves of one shell under one load.

    Parameters
    ----------
    model : ShellModel
        Mesh, section, supports.
    load : (6N,) float, dense or scipy.sparse
        Dead nodal forces (N) and moments (N mm, fixed axes) at λ = 1.

    Raises
    ------
    NumericalError
        If the load is not finite, has the wrong size, or is zero.
    """

    def __init__(self, model: ShellModel, load: Any) -> None:
        self.model = model
        self.shell = Corotational(model)
        size = model.fixed.size
        self.force = dense_vector(load, size)
        if not np.any(self.force):
            raise NumericalError("load-zero", f"the load is zero at all {size} DOFs; give a force")
        self._block = FreeBlock(model)
        self.free, self.scale = self._block.free, self._block.scale
        self._factor: Any = None

    def directions(self, K: Any, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Motion (6N,) that balances the residual, and motion per unit of λ."""
        from scipy.sparse.linalg import splu

        self._factor = None  # two factors at once would double the memory
        try:
            factor = self._factor = splu(self._block.scaled(K.data), **SUPERLU)
        except RuntimeError as error:
            raise NotConvergedError(
                "tangent-singular", f"the tangent is singular ({error})"
            ) from error
        right = np.stack([-residual[self.free], self.force[self.free]], axis=1)
        scale = self.scale[self.free, None]
        both = scale * factor.solve(scale * right)
        if not np.all(np.isfinite(both)):
            raise NotConvergedError(
                "tangent-singular", "the tangent is singular to working precision"
            )
        a, b = np.zeros_like(residual), np.zeros_like(residual)
        a[self.free], b[self.free] = both.T
        return a, b

    def drop_factor(self) -> None:
        """Drop the factor of the last tangent."""
        self._factor = None

    def negative_eigenvalues(self) -> int | None:
        """Negative eigenvalues of the last tangent factored; 0 (at rest) if there was none."""
        return 0 if self._factor is None else negative_pivots(self._factor, self._block.matrix)

    @cached_property
    def initial_rate(self) -> FloatArray:
        """Motion (6N,) per unit of λ from the unloaded state, by the model's own factorisation."""
        return self.model.solve(self.force).motion.ravel()

    def size(self, vector: FloatArray) -> float:
        """Norm of forces (6N,), scaled so that forces and moments compare."""
        return float(np.linalg.norm(self.scale * vector))

    def length(self, motion: FloatArray) -> float:
        """Norm of a motion (6N,) or (N, 6) in the same scale."""
        return float(np.linalg.norm(motion.ravel() / self.scale))


def dense_vector(value: Any, size: int) -> FloatArray:
    """Array (size,) of a dense or sparse vector; raises if not finite or of another size."""
    dense = np.asarray(value.toarray() if hasattr(value, "toarray") else value, dtype=np.float64)
    if dense.size != size or not np.all(np.isfinite(dense)):
        raise NumericalError(
            "load-vector-invalid",
            f"the force needs one finite value per DOF, {size} in all (got {dense.size}, "
            f"{int(np.sum(~np.isfinite(dense)))} of them not finite)",
        )
    return dense.ravel().copy()


def increment(
    system: System, start: Equilibrium, control: Control, *, quick: bool = False
) -> Equilibrium:
    """Converged state that meets ``control``, from the converged state ``start``.

    ``quick`` tries the first method alone, for ``max_iterations_quick`` iterations.

    Raises
    ------
    NotConvergedError
        If neither method converges; the message holds the reason of the last.
    """
    if quick:
        limit = min(SETTINGS.max_iterations_quick, SETTINGS.max_iterations)
        return _iterate(system, start, control, predict=True, limit=limit)
    try:
        return _iterate(system, start, control, predict=True)
    except NotConvergedError:
        return _iterate(system, start, control, predict=False)


def _iterate(
    system: System,
    start: Equilibrium,
    control: Control,
    *,
    predict: bool,
    limit: int | None = None,
) -> Equilibrium:
    limit = SETTINGS.max_iterations if limit is None else limit
    state, factor = start.state, start.load_factor
    moved = np.zeros(system.model.fixed.size)
    forces: FloatArray | None = None
    first = last_step = residual_size = np.inf
    b = moved
    system.drop_factor()
    for iteration in range(limit + 1):
        local = _local_elements(system, state)
        internal = local.nodal
        residual = internal - factor * system.force
        residual[system.model.fixed.ravel()] = 0.0
        nodal = max(system.size(internal), system.size(factor * system.force), 1e-300)
        residual_size = system.size(residual) / nodal
        if (
            iteration
            and residual_size <= SETTINGS.residual_tolerance
            and last_step <= SETTINGS.step_tolerance
        ):
            reactions = np.where(system.model.fixed.ravel(), internal - factor * system.force, 0.0)
            return Equilibrium(
                load_factor=factor,
                state=state,
                reactions=reactions.reshape(-1, 6),
                residual=residual_size,
                last_step=last_step,
                iterations=iteration,
                rate=b,
                negative_pivots=system.negative_eigenvalues(),
            )
        if iteration == 1:
            first = max(system.size(residual), 1e-300)
        if not system.size(residual) <= SETTINGS.divergence_factor * first:
            raise NotConvergedError(
                "newton-diverged", f"the iteration diverges (residual {residual_size:.2g})"
            )
        if iteration == limit:
            break
        if iteration == 0 and start.iterations == 0:
            a, b = np.zeros_like(moved), system.initial_rate
        else:
            K = system.shell.tangent(local, forces if predict else None)
            a, b = system.directions(K, residual)
        gained = factor - start.load_factor
        change = control.change(NewtonStep(moved=moved, gained=gained, balance=a, drive=b))
        step = a + change * b
        turn = float(np.abs(step.reshape(-1, 6)[:, 3:]).max())
        if turn > SETTINGS.max_rotation_rad:
            shorter = SETTINGS.max_rotation_rad / turn
            step, change = shorter * step, shorter * change
        elif not predict and iteration:
            step, change = _line_search(system, state, factor, residual, (step, change))
        if predict:
            forces = system.shell.predicted_forces(local, step)
        state, moved, factor = state.moved(step), moved + step, factor + change
        last_step = system.length(step) / max(system.length(state.motion), 1e-300)
    raise NotConvergedError(
        "newton-iterations-exhausted",
        f"no convergence in {limit} iterations (residual {residual_size:.2g}, last step "
        f"{last_step:.2g})",
    )


def _local_elements(system: System, state: Configuration) -> LocalElements:
    try:
        return system.shell.local(state)
    except NumericalError as error:
        raise NotConvergedError(error.code, str(error)) from error
    except np.linalg.LinAlgError as error:
        raise NotConvergedError("element-rotation-not-found", str(error)) from error


def _line_search(
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
    for _ in range(SETTINGS.line_search_steps):
        try:
            there = state.moved(share * step)
            after = _local_elements(system, there).nodal
            after = after - (factor + share * change) * system.force
            work = float(step[system.free] @ after[system.free])
        except NotConvergedError:
            share *= 0.5
            continue
        if abs(work) <= SETTINGS.line_search_target * abs(before) or before == 0.0:
            break
        # Secant of the work along the step, kept between a tenth and a half of the last share.
        secant = share * before / (before - work) if before != work else 0.5 * share
        share = min(max(secant, 0.1 * share), 0.5 * share)
    return share * step, share * change
