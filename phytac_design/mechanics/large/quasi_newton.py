r"""Large displacements by a quasi-Newton iteration with Anderson acceleration.

It starts from Koiter's expansion, x₁ + x₂ + x₃ (:mod:`reference_configuration`); then ::

    g_k = K₀⁻¹ (f − f_int(x_k))        x_{k+1} = x_k + β g_k − Σ a_j (Δx_j + β Δg_j)

where a minimises ‖g_k − Σ a_j Δg_j‖ in the norm of K₀ (Walker and Ni 2011). With g = K₀⁻¹r that
norm is √(g·r), and needs no product with K₀.

At the end the lowest eigenvalue of K₀⁻¹K_t is estimated (:mod:`stability`), and the result is
compared with the tangents at rest and at the result, as for every increment of :mod:`load_path`.
:func:`load_path.solve_large` takes over where the iteration does not converge, the rotations are
large, the lowest eigenvalue is small or the result deviates from the path: it takes ten times as
long.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np

from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import NotConvergedError, dense_vector
from phytac_design.mechanics.large.reference_configuration import Expansion, ReferenceShell
from phytac_design.mechanics.large.stability import (
    PATH_DEVIATION_MAX,
    path_deviation,
    ritz_values,
)
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

T = TypeVar("T")
LINEAR_ERROR_SAFETY = 1.5
"""Linear theory is used where this times its estimated error is within the tolerance."""


@dataclass(frozen=True, kw_only=True)
class QuasiNewtonSettings:
    """Tolerances and limits of the accelerated iteration."""

    tolerance: float = 1e-4
    """Error of the motion, over its peak, at which the iteration ends."""
    last_step_gain: float = 4.0
    """Factor by which the last step reduces the error at lowest; measured: 5 … 50."""
    memory: int = 12
    """Differences that the acceleration remembers."""
    damping: float = 0.7
    """β of all steps but the first: of 0.5 … 1 and rules that follow the stiffening, the one that
    needed fewest steps on tubes, boxes and flat faces."""
    max_iterations: int = 40
    """Iterations before path following takes over; 1 … 9 are common, 30 on flat faces."""
    max_stalled_iterations: int = 12
    """Iterations without a smaller residual that end the attempt."""
    max_rotation_rad: float = 1.0
    """Largest rotation of a node, rad; the steps add rotation vectors."""
    absurd_rotation_rad: float = 1e6
    """Rotation by linear theory above which a load is rejected."""
    mild_error: float = 0.25
    """Error of linear theory up to which Koiter's expansion is the only start that is tried."""
    firm_eigenvalue: float = 0.3
    firm_products: int = 3
    """Lower bound of the lowest eigenvalue that is accepted after so many tangent products."""
    soft_eigenvalue: float = 0.05
    soft_products: int = 8
    """The same after more products."""
    max_products: int = 40
    """Products at most; together they cost about as much as one tangent and its factor."""
    factored_eigenvalue: float = 0.02
    """The same by a factor of the tangent, where products do not tell; a softer shell is left to
    path following, which factors it three times and more."""
    approximate_residual: float = 1e-3
    max_approximate_residual: float = 5e-3
    """Residual (in the norm of K₀, over the linear motion) at which
    :meth:`QuasiNewtonSolver.approximate` ends, and the largest that it accepts where the iteration
    stalls."""


SETTINGS = QuasiNewtonSettings()


class UndecidedError(NotConvergedError):
    """Products with the tangent do not tell whether a shell is soft."""


@dataclass(frozen=True, kw_only=True)
class LoadCaseSolution:
    """A load case solved.

    Attributes
    ----------
    status : str
        ``ok``; ``flagged``: an equilibrium that is unstable, not known to be stable, or reached
        by a jump; ``failed``: no motion.
    reason : str
        Why it is not ``ok``; else empty.
    motion : (N, 6) float or None
        Translations (mm) and rotation vectors (rad).
    large : bool
        Whether large displacements were used.
    error : float
        Estimated error of the translations over the greatest one, of theory (linear) and
        iteration; that of the mesh is not part of it. NaN without a motion.
    lowest_eigenvalue : float
        Lowest Ritz value of K₀⁻¹K_t, or a lower bound where a factor of the tangent gave one; NaN
        where path following took over.
    iterations : int
        Of the accelerated method.
    guarded : str
        Why :func:`load_path.solve_large` took over; "" where it did not.
    """

    status: Literal["ok", "flagged", "failed"] = "ok"
    reason: str = ""
    motion: FloatArray | None
    large: bool
    error: float
    lowest_eigenvalue: float = float("nan")
    iterations: int = 0
    guarded: str = ""


class AndersonAcceleration:
    """Differences of the last steps, and the next step from them."""

    def __init__(self) -> None:
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self._steps: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def next(self, x: FloatArray, g: FloatArray, residual: FloatArray) -> FloatArray:
        """Return the next motion.

        Parameters
        ----------
        x, g, residual : (n,) float
            The motion, K₀⁻¹r and the residual r there.
        """
        if self._last is not None:
            step = tuple(new - old for new, old in zip((x, g, residual), self._last, strict=True))
            self._steps = [*self._steps[1 - SETTINGS.memory :], step]  # type: ignore[list-item]
        self._last = x, g, residual
        if not self._steps:
            return x + g
        moves, changes, forces = (np.stack(part) for part in zip(*self._steps, strict=True))
        table = changes @ forces.T
        scale = 1.0 / np.sqrt(np.maximum(np.diag(table), 1e-300))
        # Directions of the memory that are the same to rounding are dropped.
        scaled = scale[:, None] * table * scale
        share = scale * np.linalg.lstsq(scaled, scale * (changes @ residual), rcond=1e-12)[0]
        damping = SETTINGS.damping
        return np.asarray(x + damping * g - share @ (moves + damping * changes))


class QuasiNewtonSolver:
    """Large displacements of one shell under many loads; built once.

    Parameters
    ----------
    model : ShellModel
        The shell.
    """

    def __init__(self, model: ShellModel) -> None:
        self.model = model

    @cached_property
    def _shell(self) -> ReferenceShell:
        """Made when first needed; linear motion does not need it."""
        return ReferenceShell(self.model)

    def together(self, tasks: Sequence[Callable[[], T]]) -> list[T]:
        """Return the results of tasks that call other methods, whose solves are done together."""
        return self._shell.together(tasks)

    def linear(self, load: Any) -> FloatArray:
        """Linear motion (6N,) under a load (6N,).

        Raises
        ------
        NumericalError
            As :meth:`solve.ShellModel.solve`.
        FloatingPointError
            If numbers overflow.
        """
        with np.errstate(over="raise"):
            return np.asarray(self.model.solve(load).motion[:, :, 0].ravel())

    def expand(self, load: Any, first: FloatArray | None = None) -> Expansion:
        """Koiter's expansion for a load (6N,), with its linear motion (6N,) if that is known.

        Costs two more solves with the factor at rest and four evaluations of internal forces.

        Raises
        ------
        NumericalError, ArithmeticError
            If the terms cannot be found.
        """
        force = dense_vector(load, self.model.fixed.size)
        force[self._shell.held] = 0.0
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            return self._shell.expand(self.linear(force) if first is None else first, force)

    def solve(
        self,
        load: Any,
        *,
        tolerance: float | None = None,
        linear: FloatArray | None = None,
    ) -> LoadCaseSolution:
        """Motion under a dead load; a failure is a result with its reason, not an exception.

        Parameters
        ----------
        load : (6N,) float, dense or scipy.sparse
            Nodal forces (N) and moments (N mm, fixed axes).
        tolerance : float, optional
            Linear theory where its estimated error, with its safety, is within this. None:
            always large displacements.
        linear : (6N,) float, optional
            Linear motion, where it is known already.
        """
        try:
            force = dense_vector(load, self.model.fixed.size)
            force[self._shell.held] = 0.0
            if not np.any(force):
                still = np.zeros((force.size // 6, 6))
                return LoadCaseSolution(motion=still, large=False, error=0.0, lowest_eigenvalue=1.0)
            first = self.linear(force) if linear is None else linear
            _refuse_absurd(first)
        except (ArithmeticError, MemoryError, NumericalError, np.linalg.LinAlgError) as error:
            return _failed(error, large=False)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                expansion = self._shell.expand(first, force)
                if tolerance is not None and LINEAR_ERROR_SAFETY * expansion.error <= tolerance:
                    found = self._linear_if_stable(expansion)
                    if found is not None:
                        return found
                return self._iterate(expansion, force)
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError) as error:
            return _by_path(self.model, force, _reason(error))
        except MemoryError as error:
            return _failed(error, large=False)

    def gap(self, load: FloatArray, motion: FloatArray, linear: FloatArray) -> float:
        """Distance of a motion from equilibrium, over the linear motion, in the norm of K₀.

        About the relative error of the motion where the shell neither softens nor stiffens much.

        Parameters
        ----------
        load : (6N,) float
            Nodal forces (N) and moments (N mm).
        motion, linear : (6N,) float
            The motion to evaluate, and that of linear theory.

        Raises
        ------
        NumericalError
            If an element is distorted beyond what it can describe.
        """
        residual = np.where(self._shell.held, 0.0, load) - self._shell.internal(motion)
        g = self._shell.solve_reference(residual)
        return float(np.sqrt(max(float(g @ residual), 0.0) / float(linear @ load)))

    def approximate(self, load: FloatArray, linear: FloatArray) -> FloatArray | None:
        """Approximate motion (6N,) without a check of its stability; for tables.

        Parameters
        ----------
        load : (6N,) float
            Nodal forces (N) and moments (N mm, fixed axes).
        linear : (6N,) float
            Linear motion.

        Returns
        -------
        (6N,) float or None
            None where the iteration does not come within ``SETTINGS.max_approximate_residual``.
        """
        force = np.where(self._shell.held, 0.0, load)
        lowest, nearest = np.inf, None
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                for motion, distance in self._steps(self._shell.expand(linear, force), force):
                    if distance < lowest:
                        lowest, nearest = distance, motion
                    if lowest <= SETTINGS.approximate_residual:
                        break
        except NotConvergedError:
            pass  # the nearest motion may be good enough
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError):
            return None
        return nearest if lowest <= SETTINGS.max_approximate_residual else None

    def _linear_if_stable(self, expansion: Expansion) -> LoadCaseSolution | None:
        """Linear motion, unless buckling that its error does not show is near."""
        product = self._shell.softened(expansion.first)
        try:
            lowest = self._lowest_eigenvalue(product, expansion, SETTINGS.firm_eigenvalue)
        except NotConvergedError:
            return None
        return LoadCaseSolution(
            motion=expansion.first.reshape(-1, 6),
            large=False,
            error=expansion.error,
            lowest_eigenvalue=lowest,
        )

    def _start(self, expansion: Expansion, force: FloatArray) -> FloatArray:
        """The extrapolation with the smallest residual."""
        first, more = expansion.first, expansion.second + expansion.third
        found = [first + more]
        if expansion.error > SETTINGS.mild_error:
            found.append(first)
            grown = float(more @ force) / float(first @ force)
            if grown < 0.0:
                found.append(first / (1.0 - grown))
        found = [one for one in found if largest_rotation(one) <= SETTINGS.max_rotation_rad]
        if not found:
            raise NotConvergedError("quasi-newton-nonlinear", "the motion is too far from linear")
        if len(found) == 1:
            return found[0]
        gaps = [self._shell.force_norm(force - self._shell.internal(one)) for one in found]
        return found[int(np.argmin(gaps))]

    def _steps(self, expansion: Expansion, force: FloatArray) -> Iterator[tuple[FloatArray, float]]:
        """Motions (6N,) from the expansion on, until the residual stalls.

        With each comes the residual before its step, in the norm of K₀, over the linear motion.

        Raises
        ------
        NumericalError
            If no start is usable, rotations are too large, or an element is too distorted.
        """
        shell, history = self._shell, AndersonAcceleration()
        size = float(expansion.first @ force)
        x = self._start(expansion, force)
        best, best_at = np.inf, 0
        for number in range(1, SETTINGS.max_iterations + 1):
            if largest_rotation(x) > SETTINGS.max_rotation_rad:
                raise NotConvergedError(
                    "quasi-newton-rotations-large", "the rotations are too large"
                )
            residual = force - shell.internal(x)
            g = shell.solve_reference(residual)
            distance = float(np.sqrt(max(float(g @ residual), 0.0) / size))
            x = history.next(x, g, residual)
            if distance < best:
                best, best_at = distance, number
            yield x, distance
            if number - best_at > SETTINGS.max_stalled_iterations:
                break
        raise NotConvergedError(
            "quasi-newton-stalled", f"the quasi-Newton iteration stalls at a residual of {best:.2g}"
        )

    def _iterate(self, expansion: Expansion, force: FloatArray) -> LoadCaseSolution:
        """Large displacements from the expansion.

        Raises
        ------
        NumericalError
            If the iteration does not converge, or its result may be unstable or off the path.
        """
        lowest, error, undecided = SETTINGS.firm_eigenvalue, np.inf, False
        for number, (motion, distance) in enumerate(self._steps(expansion, force), start=1):
            # The residual is that of the motion times the eigenvalue along it.
            if distance > lowest * SETTINGS.last_step_gain * SETTINGS.tolerance:
                continue
            if not undecided:
                found = self._check_stability(motion, expansion, force)
                undecided, lowest = found is None, found or SETTINGS.factored_eigenvalue
            error = distance / (lowest * SETTINGS.last_step_gain)
            if error <= SETTINGS.tolerance:
                if undecided and not self._shell.is_firmer(motion, lowest):
                    raise NotConvergedError("quasi-newton-soft-mode", "the shell is soft here")
                return LoadCaseSolution(
                    motion=motion.reshape(-1, 6),
                    large=True,
                    error=error,
                    lowest_eigenvalue=lowest,
                    iterations=number,
                )
        raise AssertionError("the steps end with an error")

    def _check_stability(
        self, x: FloatArray, expansion: Expansion, force: FloatArray
    ) -> float | None:
        """Lowest Ritz value at the result; None if products do not tell whether it is soft.

        Raises
        ------
        NotConvergedError
            If the shell is soft there, or the result is off the path from rest.
        """
        shell, first = self._shell, expansion.first
        internal = shell.internal(x)

        def product(along: FloatArray) -> FloatArray:
            return shell.tangent_product(x, internal, along)

        # Motion per unit of load within the space of the expansion and the result.
        basis = np.stack([first, expansion.second, x])
        basis = np.linalg.svd(basis, full_matrices=False)[2]
        table = basis @ np.stack([product(one) for one in basis]).T
        rate = np.linalg.lstsq(0.5 * (table + table.T), basis @ force, rcond=1e-12)[0] @ basis
        along = float(rate @ force) / float(rate @ shell.reference_force(rate))
        if not along >= SETTINGS.soft_eigenvalue:
            raise NotConvergedError(
                "quasi-newton-soft-mode", f"the shell is soft here (Ritz value {along:.2g})"
            )
        ends = [one.reshape(-1, 6)[:, :3] for one in (x, first, rate)]
        if path_deviation(ends[0], ends[1], ends[2]) > PATH_DEVIATION_MAX:
            raise NotConvergedError(
                "quasi-newton-inconsistent",
                "the result deviates from the tangents at rest and at the result",
            )
        try:
            lowest = self._lowest_eigenvalue(product, expansion, SETTINGS.soft_eigenvalue)
        except UndecidedError:
            return None
        return min(along, lowest)

    def _lowest_eigenvalue(
        self, product: Callable[[FloatArray], FloatArray], expansion: Expansion, minimum: float
    ) -> float:
        """Lowest Ritz value of K₀⁻¹K_t, if its lower bound is at least ``minimum``.

        Raises
        ------
        NotConvergedError
            If it is lower; an UndecidedError if the most products do not tell.
        """
        force = self._shell.random_force(expansion.first)
        value = np.inf
        found = ritz_values(product, self._shell.solve_reference, force)
        for count, (value, gap) in enumerate(found, start=1):
            firm = count >= SETTINGS.firm_products and value - gap >= SETTINGS.firm_eigenvalue
            if firm or (count >= SETTINGS.soft_products and value - gap >= minimum):
                return value
            if value < minimum or count >= SETTINGS.max_products:
                break
        if value >= minimum:
            raise UndecidedError("quasi-newton-undecided", "products do not tell how soft it is")
        raise NotConvergedError(
            "quasi-newton-soft-mode", f"the shell is soft here (lowest Ritz value {value:.2g})"
        )


def _by_path(model: ShellModel, force: FloatArray, guarded: str) -> LoadCaseSolution:
    """Load case by the path-following Newton method; a failure is a result with its reason."""
    try:
        end = solve_large(model, force)[0]
    except (NumericalError, ArithmeticError, MemoryError, np.linalg.LinAlgError) as error:
        return _failed(error, large=True, guarded=guarded)
    reasons = []
    if end.jumped:
        reasons.append("the solution left the path from rest: the shell may have snapped")
    if end.stable is None:
        reasons.append("its stability is unknown")
    elif not end.stable:
        reasons.append("unstable: the shell does not stay here under this load")
    return LoadCaseSolution(
        status="flagged" if reasons else "ok",
        reason="; ".join(reasons),
        motion=end.state.motion,
        large=True,
        error=SETTINGS.tolerance,
        guarded=guarded,
    )


def _refuse_absurd(linear: FloatArray) -> None:
    turned = largest_rotation(linear)
    if not turned <= SETTINGS.absurd_rotation_rad:
        raise NumericalError(
            "load-too-large",
            f"the load is absurd: linear theory turns the shell by {turned:.2g} rad; "
            "check its unit",
        )


def largest_rotation(motion: FloatArray) -> float:
    """Largest rotation of a node, rad."""
    return float(np.abs(motion.reshape(-1, 6)[:, 3:]).max())


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__


def _failed(error: Exception, *, large: bool, guarded: str = "") -> LoadCaseSolution:
    return LoadCaseSolution(
        status="failed",
        reason=_reason(error),
        motion=None,
        large=large,
        error=float("nan"),
        guarded=guarded,
    )
