r"""Large displacements without a new factorisation: the stiffness at rest, accelerated.

Koiter's expansion (:mod:`estimate`) gives the start, x₁ + x₂ + x₃; then ::

    g_k = K₀⁻¹ (f − f_int(x_k))        x_{k+1} = x_k + β g_k − Σ a_j (Δx_j + β Δg_j)

where a minimises ‖g_k − Σ a_j Δg_j‖ in the norm of K₀ (:mod:`anderson`). With g = K₀⁻¹r that norm
is √(g·r), and needs no product with K₀.

No step is taken on trust. Beside the iteration the least eigenvalue of K₀⁻¹K_t is closed in on
(:mod:`lowest_eigenvalue`), and the end is held against the tangents at rest and there, as every increment of
:mod:`path` is. What does not converge, turns far, is soft or strays goes to
:func:`path.solve_large`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from phytac_design.mechanics.large.anderson import Anderson
from phytac_design.mechanics.large.batch import Sample, solve_sample
from phytac_design.mechanics.large.linear_error import LINEAR_ERROR_SAFETY, PROBE_RAD, refuse_absurd
from phytac_design.mechanics.large.lowest_eigenvalue import Softest
from phytac_design.mechanics.large.newton import NotConvergedError, dense_vector
from phytac_design.mechanics.large.reference_configuration import Resting
from phytac_design.mechanics.large.stability import STRAY, stray
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

CONVERGED = 1e-4
"""Error of the motion, over its peak, that the iteration ends at."""
LAST_GAIN = 4.0
"""Least factor that the last step, which is not looked at again, gains; 5 … 50 are common."""
ITERATIONS = 40
"""Iterations before the guarded Newton method takes over; 1 … 9 are common, 30 on flat faces."""
STALLED = 12
"""Iterations without a smaller residual that end the attempt."""
TURNED = 1.0
"""Largest rotation of a node, rad; the steps add rotation vectors."""
MILD = 0.25
"""Error of linear theory up to which Koiter's expansion is the start, without a look at others."""
SERIES = 0.9
"""Ratio of the expansion's terms from which on their geometric series says nothing."""
NEAR = 0.05
"""Residual (in the norm of K₀, over the linear motion) from which on stability is looked at."""
FIRM, FIRM_STEPS = 0.3, 3
"""Least Ritz value, less its residual, that is trusted after so many steps towards it."""
SOFT, SOFT_STEPS = 0.05, 8
"""The same after more steps; what is softer is not trusted at all."""
LOOKS = 30
"""Further steps at the end at most; all of them take less than one new factor."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """A load case solved.

    Attributes
    ----------
    sample : Sample
        Motion, its status and theory.
    error : float
        Estimated error of the translations over the greatest one, of theory (linear) and
        iteration; that of the mesh is not part of it. NaN without a motion.
    linear_error : float
        What :func:`estimate.check_linear` gives; inf where it gives nothing.
    softest : float
        Least Ritz value of K₀⁻¹K_t found; NaN where the guarded method took over.
    iterations : int
        Of the accelerated method.
    guarded : str
        Why :func:`path.solve_large` was asked instead; "" where it was not.
    """

    sample: Sample
    error: float
    linear_error: float = 0.0
    lowest_eigenvalue: float = float("nan")
    iterations: int = 0
    guarded: str = ""


@dataclass(frozen=True, kw_only=True)
class Expansion:
    """Motion (6N,) to third order, the second part's image, and how soft the shell gets."""

    first: FloatArray
    second: FloatArray
    third: FloatArray
    bent: FloatArray
    error: float
    soft: Softest


class Step(NamedTuple):
    """An iteration: the motion (6N,) after it, and what was found before it."""

    number: int
    motion: FloatArray
    away: float  # residual, in the norm of K₀, over the linear motion
    least: float  # Ritz value of K₀⁻¹K_t
    soft: Softest | None


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
    def _shell(self) -> Resting:
        """Made when first needed: linear motion does without."""
        return Resting(self.model)

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
            expansion = self._expanded(first, force)
        return expansion.second, expansion.third

    def solve(
        self,
        load: Any,
        *,
        tolerance: float | None = None,
        linear: FloatArray | None = None,
    ) -> Found:
        """Motion under a dead load, whatever becomes of it; never an exception.

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
                return Found(sample=_ok(still, large=False), error=0.0, lowest_eigenvalue=1.0)
            first = self.linear(force) if linear is None else linear
            refuse_absurd(turn_of(first))
        except (ArithmeticError, MemoryError, NumericalError, np.linalg.LinAlgError) as error:
            return _failed(error)
        linear_error = float("inf")
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                expansion = self._expanded(first, force)
                linear_error = expansion.error
                if self._linear_will_do(expansion, tolerance):
                    return Found(
                        sample=_ok(first, large=False),
                        error=linear_error,
                        linear_error=linear_error,
                        lowest_eigenvalue=expansion.soft.least,
                    )
                return self._iterated(expansion, force)
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError) as error:
            return self._guarded(force, linear_error, str(error) or type(error).__name__)
        except MemoryError as error:
            return _failed(error)

    def _linear_will_do(self, expansion: Expansion, tolerance: float | None) -> bool:
        if tolerance is None or not LINEAR_ERROR_SAFETY * expansion.error <= tolerance:
            return False
        return expansion.soft.sure >= FIRM

    def _guarded(self, force: FloatArray, linear_error: float, reason: str) -> Found:
        rows = np.flatnonzero(force)
        sample = solve_sample(self.model, (rows, force[rows]), None)
        return Found(
            sample=sample,
            error=CONVERGED if sample.motion is not None else float("nan"),
            linear_error=linear_error,
            guarded=reason,
        )

    def _expanded(self, first: FloatArray, force: FloatArray) -> Expansion:
        """Koiter's expansion, with the least eigenvalue of K₀ + K_σ(x₁) on the way."""
        shell = self._shell
        e = PROBE_RAD / shell.reach(first)
        up, down = shell.internal(e * first), shell.internal(-e * first)
        bent, push = -(up + down) / (2.0 * e * e), shell.stirring(first)
        second, stirred = shell.solved(np.stack([bent, push], axis=1)).T.copy()
        soft = Softest(stirred, push)

        def product(vector: FloatArray, image: FloatArray) -> FloatArray:
            # The tangent at e·x₁ differs from K₀ by e times what x₁ makes of it.
            return image + (shell.product(e * first, up, vector) - image) / e

        soft.measure(product)
        aside = e * e * second
        odd = (shell.internal(aside + e * first) - shell.internal(aside - e * first)) / 2.0
        third = self._beside(soft, -(odd - e * force) / e**3)
        soft.measure(product)
        off = float(_lengths(second + third).max())
        return Expansion(
            first=first,
            second=second,
            third=third,
            bent=bent,
            error=off / float(_lengths(first).max()),
            soft=soft,
        )

    def _beside(self, soft: Softest, right: FloatArray) -> FloatArray:
        """K₀⁻¹ ``right``; the same pass through the factor brings the softest pair on."""
        residual = soft.residual()
        both = self._shell.solved(np.stack([right, residual], axis=1))
        soft.close_in(both[:, 1].copy(), residual)
        return both[:, 0].copy()

    def _start(self, expansion: Expansion, force: FloatArray) -> FloatArray:
        """Of a few extrapolations the one with the least residual."""
        first, second, third = expansion.first, expansion.second, expansion.third
        found = [first + second + third]
        if expansion.error > MILD:
            found.append(first)
            bent = float(second @ expansion.bent)
            ratio = float(third @ expansion.bent) / bent if bent > 0.0 else 1.0
            if ratio < SERIES:
                found.append(first + second / (1.0 - ratio))
            grown = float((second + third) @ force) / float(first @ force)
            if grown < 0.0:
                found.append(first / (1.0 - grown))
        found = [one for one in found if turn_of(one) <= TURNED]
        if not found:
            raise NotConvergedError("the motion is too far from linear")
        if len(found) == 1:
            return found[0]
        gaps = [self._shell.weighted(force - self._shell.internal(one)) for one in found]
        return found[int(np.argmin(gaps))]

    def steps(self, expansion: Expansion, force: FloatArray) -> Iterator[Step]:
        """Iterations from the expansion, one after the other, until they gain nothing.

        Raises
        ------
        NumericalError
            If there is nothing to start from, the shell turns far, or an element is distorted
            beyond what it can describe.
        """
        shell, history = self._shell, Anderson()
        size = float(expansion.first @ force)
        x = self._start(expansion, force)
        soft: Softest | None = None
        least, damping = expansion.soft.least, 1.0
        best, best_at = np.inf, 0
        for number in range(1, ITERATIONS + 1):
            if turn_of(x) > TURNED:
                raise NotConvergedError("the shell turns far")
            internal = shell.internal(x)
            residual = force - internal
            if soft is None:
                g = shell.solved(residual[:, None])[:, 0]
            else:
                self._measure(soft, x, internal)
                least, damping = soft.least, damping_of(soft)
                g = self._beside(soft, residual)
            away = float(np.sqrt(max(float(g @ residual), 0.0) / size))
            x = history.next(x, g, residual, damping)
            if away < best:
                best, best_at = away, number
            elif number - best_at > STALLED:
                break
            if soft is None and away < NEAR:
                soft = expansion.soft.afresh()
            elif soft is not None and away > 2.0 * NEAR:
                soft = None
            yield Step(number, x, away, least, soft)

    def _iterated(self, expansion: Expansion, force: FloatArray) -> Found:
        """Large displacements from the expansion.

        Raises
        ------
        NumericalError
            If the end is not reached, or cannot be vouched for.
        """
        best = np.inf
        for step in self.steps(expansion, force):
            best = min(best, step.away)
            gap = step.away / max(step.least, SOFT)
            if step.soft is not None and gap <= LAST_GAIN * CONVERGED:
                return Found(
                    sample=_ok(step.motion, large=True),
                    error=gap / LAST_GAIN,
                    linear_error=expansion.error,
                    lowest_eigenvalue=self._vouched(step.motion, expansion, force, step.soft),
                    iterations=step.number,
                )
        raise NotConvergedError(f"the iteration with the stiffness at rest stops at {best:.2g}")

    def _measure(self, soft: Softest, x: FloatArray, internal: FloatArray) -> None:
        soft.measure(lambda vector, _: self._shell.product(x, internal, vector))

    def _vouched(
        self, x: FloatArray, expansion: Expansion, force: FloatArray, soft: Softest
    ) -> float:
        """Least Ritz value at the end.

        Raises
        ------
        NotConvergedError
            If the shell is soft there, or the end is off the path from rest.
        """
        shell, first = self._shell, expansion.first
        internal = shell.internal(x)
        along = Softest(first, force)
        along.add(expansion.second, expansion.bent)
        along.add(x, shell.image(x))
        self._measure(along, x, internal)
        if not along.least >= SOFT:
            raise NotConvergedError(f"the shell is soft here (Ritz value {along.least:.2g})")
        ends = [_translations(one) for one in (x, first, along.rate(force))]
        if stray(ends[0], ends[1], ends[2]) > STRAY:
            raise NotConvergedError("the end is off the tangents at rest and there")
        self._measure(soft, x, internal)
        for _ in range(LOOKS):
            if soft.least < SOFT:
                break
            firm = soft.sure >= FIRM and soft.steps >= FIRM_STEPS
            if firm or (soft.sure >= SOFT and soft.steps >= SOFT_STEPS):
                return min(soft.least, along.least)
            residual = soft.residual()
            soft.close_in(shell.solved(residual[:, None])[:, 0], residual)
            self._measure(soft, x, internal)
        raise NotConvergedError(f"the shell is soft here (least Ritz value {soft.least:.2g})")


def damping_of(soft: Softest) -> float:
    """Share of a step that suits the middle of the tangent's range, where that is wide."""
    largest = soft.largest
    return 1.0 if largest < 2.0 else 2.0 / (max(soft.least, 0.0) + largest)


def turn_of(motion: FloatArray) -> float:
    """Largest rotation of a node, rad."""
    return float(np.abs(motion.reshape(-1, 6)[:, 3:]).max())


def _translations(motion: FloatArray) -> FloatArray:
    return motion.reshape(-1, 6)[:, :3]


def _lengths(motion: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(_translations(motion), axis=1))


def _ok(motion: FloatArray, *, large: bool) -> Sample:
    return Sample(status="ok", reason="", motion=motion.reshape(-1, 6), large=large)


def _failed(error: Exception) -> Found:
    reason = str(error) or type(error).__name__
    sample = Sample(status="failed", reason=reason, motion=None, large=False)
    return Found(sample=sample, error=float("nan"), linear_error=float("nan"))
