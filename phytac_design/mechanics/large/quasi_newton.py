r"""Large displacements by a quasi-Newton iteration with Anderson acceleration.

It starts from Koiter's expansion (:mod:`estimate`), x₁ + x₂ + x₃; then ::

    g_k = K₀⁻¹ (f − f_int(x_k))        x_{k+1} = x_k + β g_k − Σ a_j (Δx_j + β Δg_j)

where a minimises ‖g_k − Σ a_j Δg_j‖ in the norm of K₀ (:mod:`anderson`). With g = K₀⁻¹r that norm
is √(g·r), and needs no product with K₀.

The lowest eigenvalue of K₀⁻¹K_t is estimated along with the iteration (:mod:`stability`), and the
result is compared with the tangents at rest and at the result, as for every increment of
:mod:`path`. :func:`path.solve_large` takes over where the iteration does not converge, the
rotations are large, the lowest eigenvalue is small or the result deviates from the path.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from phytac_design.mechanics.large.anderson import AndersonAcceleration
from phytac_design.mechanics.large.linear_error import (
    LINEAR_ERROR_SAFETY,
    DIFFERENCE_STEP_rad,
    check_load_size,
)
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Loading, NotConvergedError, dense_vector
from phytac_design.mechanics.large.reference_configuration import ReferenceShell
from phytac_design.mechanics.large.stability import (
    PATH_DEVIATION_MAX,
    LowestEigenvalue,
    path_deviation,
)
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class QuasiNewtonSettings:
    """Tolerances and limits of the accelerated iteration."""

    tolerance: float = 1e-4
    """Error of the motion, over its peak, at which the iteration ends."""
    last_step_gain: float = 4.0
    """Factor by which the last step reduces the error at lowest; measured: 5 … 50."""
    max_iterations: int = 40
    """Iterations before path following takes over; 1 … 9 are common, 30 on flat faces."""
    max_stalled_iterations: int = 12
    """Iterations without a smaller residual that end the attempt."""
    max_rotation_rad: float = 1.0
    """Largest rotation of a node, rad; the steps add rotation vectors."""
    mild_error: float = 0.25
    """Error of linear theory up to which Koiter's expansion is the only start that is tried."""
    max_series_ratio: float = 0.9
    """Ratio of the expansion's terms above which their geometric series is not used."""
    stability_residual: float = 0.05
    """Residual (in the norm of K₀, over the linear motion) below which stability is monitored."""
    firm_eigenvalue: float = 0.3
    firm_products: int = 3
    """Lower bound of the lowest eigenvalue that is accepted after so many tangent products."""
    soft_eigenvalue: float = 0.05
    soft_products: int = 8
    """The same after more products; a softer shell is left to path following."""
    max_final_products: int = 30
    """Products at the end at most; together they cost less than one factorisation."""
    approximate_residual: float = 1e-3
    max_approximate_residual: float = 5e-3
    """Residual (in the norm of K₀, over the linear motion) at which
    :meth:`QuasiNewtonSolver.approximate` ends, and the largest that it accepts where the iteration
    stalls."""


SETTINGS = QuasiNewtonSettings()


@dataclass(frozen=True, kw_only=True)
class LoadCaseResult:
    """One load case.

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
    """

    status: Literal["ok", "flagged", "failed"]
    reason: str
    motion: FloatArray | None
    large: bool


@dataclass(frozen=True, kw_only=True)
class LoadCaseSolution:
    """A load case solved.

    Attributes
    ----------
    sample : LoadCaseResult
        Motion, its status and theory.
    error : float
        Estimated error of the translations over the greatest one, of theory (linear) and
        iteration; that of the mesh is not part of it. NaN without a motion.
    linear_error : float
        What :func:`estimate.check_linear` gives; inf where it gives nothing.
    softest : float
        Lowest Ritz value of K₀⁻¹K_t; NaN where path following took over.
    iterations : int
        Of the accelerated method.
    guarded : str
        Why :func:`path.solve_large` took over; "" where it did not.
    """

    sample: LoadCaseResult
    error: float
    linear_error: float = 0.0
    lowest_eigenvalue: float = float("nan")
    iterations: int = 0
    guarded: str = ""


@dataclass(frozen=True, kw_only=True)
class Expansion:
    """Motion (6N,) to third order, the force of the second term, and the lowest eigenvalue."""

    first: FloatArray
    second: FloatArray
    third: FloatArray
    second_force: FloatArray
    error: float
    stability: LowestEigenvalue


class Iteration(NamedTuple):
    """An iteration: the motion (6N,) after it, and the residual and stability before it."""

    number: int
    motion: FloatArray
    distance: float  # residual, in the norm of K₀, over the linear motion
    lowest: float  # Ritz value of K₀⁻¹K_t
    stability: LowestEigenvalue | None


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

    def series(self, load: FloatArray, first: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Second and third term (6N,) of Koiter's expansion: f·x₁ + f²·x₂ + f³·x₃ under f loads.

        Parameters
        ----------
        load : (6N,) float
            Nodal forces (N) and moments (N mm).
        first : (6N,) float
            x₁, of :meth:`linear`.

        Raises
        ------
        NumericalError, ArithmeticError
            If they cannot be found.
        """
        force = np.where(self._shell.held, 0.0, load)
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            expansion = self._expand(first, force)
        return expansion.second, expansion.third

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
            force = dense_vector(load, self.model.fixed.size, "force")
            force[self._shell.held] = 0.0
            if not np.any(force):
                still = np.zeros(force.size)
                return LoadCaseSolution(
                    sample=_ok(still, large=False), error=0.0, lowest_eigenvalue=1.0
                )
            first = self.linear(force) if linear is None else linear
            check_load_size(largest_rotation(first))
        except (ArithmeticError, MemoryError, NumericalError, np.linalg.LinAlgError) as error:
            return _failed(error)
        linear_error = float("inf")
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                expansion = self._expand(first, force)
                linear_error = expansion.error
                if self._linear_suffices(expansion, tolerance):
                    return LoadCaseSolution(
                        sample=_ok(first, large=False),
                        error=linear_error,
                        linear_error=linear_error,
                        lowest_eigenvalue=expansion.stability.lowest,
                    )
                return self._iterate(expansion, force)
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError) as error:
            return self._by_fallback(force, linear_error, str(error) or type(error).__name__)
        except MemoryError as error:
            return _failed(error)

    def _linear_suffices(self, expansion: Expansion, tolerance: float | None) -> bool:
        if tolerance is None or not LINEAR_ERROR_SAFETY * expansion.error <= tolerance:
            return False
        return expansion.stability.lower_bound >= SETTINGS.firm_eigenvalue

    def _by_fallback(self, force: FloatArray, linear_error: float, reason: str) -> LoadCaseSolution:
        sample = _by_path(self.model, force)
        return LoadCaseSolution(
            sample=sample,
            error=SETTINGS.tolerance if sample.motion is not None else float("nan"),
            linear_error=linear_error,
            guarded=reason,
        )

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
        g = self._shell.solve_reference(residual[:, None])[:, 0]
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
                for step in self.steps(self._expand(linear, force), force):
                    if step.distance < lowest:
                        lowest, nearest = step.distance, step.motion
                    if lowest <= SETTINGS.approximate_residual:
                        break
        except NotConvergedError:
            pass  # the nearest motion may be good enough
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError):
            return None
        return nearest if lowest <= SETTINGS.max_approximate_residual else None

    def _expand(self, first: FloatArray, force: FloatArray) -> Expansion:
        """Koiter's expansion, and the lowest eigenvalue of K₀ + K_σ(x₁)."""
        shell = self._shell
        e = DIFFERENCE_STEP_rad / shell.motion_size(first)
        up, down = shell.internal(e * first), shell.internal(-e * first)
        second_force, random = -(up + down) / (2.0 * e * e), shell.random_force(first)
        second, softened = shell.solve_reference(np.stack([second_force, random], axis=1)).T.copy()
        stability = LowestEigenvalue(softened, random)

        def product(vector: FloatArray, image: FloatArray) -> FloatArray:
            # The tangent at e·x₁ differs from K₀ by e times its derivative along x₁.
            return image + (shell.tangent_product(e * first, up, vector) - image) / e

        stability.measure(product)
        aside = e * e * second
        odd = (shell.internal(aside + e * first) - shell.internal(aside - e * first)) / 2.0
        third = self._solve_and_refine(stability, -(odd - e * force) / e**3)
        stability.measure(product)
        off = float(_lengths(second + third).max())
        return Expansion(
            first=first,
            second=second,
            third=third,
            second_force=second_force,
            error=off / float(_lengths(first).max()),
            stability=stability,
        )

    def _solve_and_refine(self, stability: LowestEigenvalue, right: FloatArray) -> FloatArray:
        """K₀⁻¹ ``right``; the same solve refines the lowest eigenvalue."""
        residual = stability.residual()
        both = self._shell.solve_reference(np.stack([right, residual], axis=1))
        stability.refine(both[:, 1].copy(), residual)
        return both[:, 0].copy()

    def _start(self, expansion: Expansion, force: FloatArray) -> FloatArray:
        """The extrapolation with the smallest residual."""
        first, second, third = expansion.first, expansion.second, expansion.third
        found = [first + second + third]
        if expansion.error > SETTINGS.mild_error:
            found.append(first)
            bent = float(second @ expansion.second_force)
            ratio = float(third @ expansion.second_force) / bent if bent > 0.0 else 1.0
            if ratio < SETTINGS.max_series_ratio:
                found.append(first + second / (1.0 - ratio))
            grown = float((second + third) @ force) / float(first @ force)
            if grown < 0.0:
                found.append(first / (1.0 - grown))
        found = [one for one in found if largest_rotation(one) <= SETTINGS.max_rotation_rad]
        if not found:
            raise NotConvergedError("quasi-newton-nonlinear", "the motion is too far from linear")
        if len(found) == 1:
            return found[0]
        gaps = [self._shell.force_norm(force - self._shell.internal(one)) for one in found]
        return found[int(np.argmin(gaps))]

    def steps(self, expansion: Expansion, force: FloatArray) -> Iterator[Iteration]:
        """Iterations from the expansion until the residual stalls.

        Raises
        ------
        NumericalError
            If no start is usable, rotations are too large, or an element is too distorted.
        """
        shell, history = self._shell, AndersonAcceleration()
        size = float(expansion.first @ force)
        x = self._start(expansion, force)
        stability: LowestEigenvalue | None = None
        lowest, damping = expansion.stability.lowest, 1.0
        best, best_at = np.inf, 0
        for number in range(1, SETTINGS.max_iterations + 1):
            if largest_rotation(x) > SETTINGS.max_rotation_rad:
                raise NotConvergedError(
                    "quasi-newton-rotations-large", "the rotations are too large"
                )
            internal = shell.internal(x)
            residual = force - internal
            if stability is None:
                g = shell.solve_reference(residual[:, None])[:, 0]
            else:
                self._measure(stability, x, internal)
                lowest, damping = stability.lowest, damping_of(stability)
                g = self._solve_and_refine(stability, residual)
            distance = float(np.sqrt(max(float(g @ residual), 0.0) / size))
            x = history.next(x, g, residual, damping)
            if distance < best:
                best, best_at = distance, number
            elif number - best_at > SETTINGS.max_stalled_iterations:
                break
            if stability is None and distance < SETTINGS.stability_residual:
                stability = expansion.stability.restarted()
            elif stability is not None and distance > 2.0 * SETTINGS.stability_residual:
                stability = None
            yield Iteration(number, x, distance, lowest, stability)

    def _iterate(self, expansion: Expansion, force: FloatArray) -> LoadCaseSolution:
        """Large displacements from the expansion.

        Raises
        ------
        NumericalError
            If the iteration does not converge, or its result may be unstable or off the path.
        """
        best = np.inf
        for step in self.steps(expansion, force):
            best = min(best, step.distance)
            gap = step.distance / max(step.lowest, SETTINGS.soft_eigenvalue)
            if step.stability is not None and gap <= SETTINGS.last_step_gain * SETTINGS.tolerance:
                return LoadCaseSolution(
                    sample=_ok(step.motion, large=True),
                    error=gap / SETTINGS.last_step_gain,
                    linear_error=expansion.error,
                    lowest_eigenvalue=self._check_stability(
                        step.motion, expansion, force, step.stability
                    ),
                    iterations=step.number,
                )
        raise NotConvergedError(
            "quasi-newton-stalled", f"the quasi-Newton iteration stalls at a residual of {best:.2g}"
        )

    def _measure(self, stability: LowestEigenvalue, x: FloatArray, internal: FloatArray) -> None:
        stability.measure(lambda vector, _: self._shell.tangent_product(x, internal, vector))

    def _check_stability(
        self, x: FloatArray, expansion: Expansion, force: FloatArray, stability: LowestEigenvalue
    ) -> float:
        """Lowest Ritz value at the result.

        Raises
        ------
        NotConvergedError
            If the shell is soft there, or the result is off the path from rest.
        """
        shell, first = self._shell, expansion.first
        internal = shell.internal(x)
        along = LowestEigenvalue(first, force)
        along.extend(expansion.second, expansion.second_force)
        along.extend(x, shell.reference_force(x))
        self._measure(along, x, internal)
        if not along.lowest >= SETTINGS.soft_eigenvalue:
            raise NotConvergedError(
                "quasi-newton-soft-mode", f"the shell is soft here (Ritz value {along.lowest:.2g})"
            )
        ends = [_translations(one) for one in (x, first, along.rate(force))]
        if path_deviation(ends[0], ends[1], ends[2]) > PATH_DEVIATION_MAX:
            raise NotConvergedError(
                "quasi-newton-inconsistent",
                "the result deviates from the tangents at rest and at the result",
            )
        self._measure(stability, x, internal)
        for _ in range(SETTINGS.max_final_products):
            if stability.lowest < SETTINGS.soft_eigenvalue:
                break
            firm = (
                stability.lower_bound >= SETTINGS.firm_eigenvalue
                and stability.products >= SETTINGS.firm_products
            )
            if firm or (
                stability.lower_bound >= SETTINGS.soft_eigenvalue
                and stability.products >= SETTINGS.soft_products
            ):
                return min(stability.lowest, along.lowest)
            residual = stability.residual()
            stability.refine(shell.solve_reference(residual[:, None])[:, 0], residual)
            self._measure(stability, x, internal)
        raise NotConvergedError(
            "quasi-newton-soft-mode",
            f"the shell is soft here (lowest Ritz value {stability.lowest:.2g})",
        )


def _by_path(model: ShellModel, force: FloatArray) -> LoadCaseResult:
    """Load case by the path-following Newton method; a failure is a sample with its reason."""
    try:
        end = solve_large(model, Loading(force=force))[0]
    except (NumericalError, ArithmeticError, MemoryError, np.linalg.LinAlgError) as error:
        reason = str(error) or type(error).__name__
        return LoadCaseResult(status="failed", reason=reason, motion=None, large=True)
    reasons = []
    if end.jumped:
        reasons.append("the solution left the path from rest: the shell may have snapped")
    if end.stable is None:
        reasons.append("its stability is unknown")
    elif not end.stable:
        reasons.append("unstable: the shell does not stay here under this load")
    return LoadCaseResult(
        status="flagged" if reasons else "ok",
        reason="; ".join(reasons),
        motion=end.state.motion,
        large=True,
    )


def damping_of(stability: LowestEigenvalue) -> float:
    """Step length that suits the middle of the tangent's eigenvalues, where they spread widely."""
    largest = stability.highest
    return 1.0 if largest < 2.0 else 2.0 / (max(stability.lowest, 0.0) + largest)


def largest_rotation(motion: FloatArray) -> float:
    """Largest rotation of a node, rad."""
    return float(np.abs(motion.reshape(-1, 6)[:, 3:]).max())


def _translations(motion: FloatArray) -> FloatArray:
    return motion.reshape(-1, 6)[:, :3]


def _lengths(motion: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(_translations(motion), axis=1))


def _ok(motion: FloatArray, *, large: bool) -> LoadCaseResult:
    return LoadCaseResult(status="ok", reason="", motion=motion.reshape(-1, 6), large=large)


def _failed(error: Exception) -> LoadCaseSolution:
    reason = str(error) or type(error).__name__
    sample = LoadCaseResult(status="failed", reason=reason, motion=None, large=False)
    return LoadCaseSolution(sample=sample, error=float("nan"), linear_error=float("nan"))
