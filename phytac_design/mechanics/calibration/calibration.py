r"""Calibration of a shell on force-displacement data (paper, eq. 4).

The paper minimises Σ‖F - K(p)·U‖ over the parameters p. Here the same data are compared where
they were measured, as displacements, each weighted by its own noise::

    min over p of ‖V^(-1/2)·(d - F·c(t, ν)/E)‖²        p = (ln E, ln t, ν)

by Gauss-Newton with exact sensitivities. The Fisher information JᵀV⁻¹J gives the intervals
(Student's t with as many degrees of freedom as there are presses beyond the parameters, widened
by a share of what the extrapolation over two meshes changed) and shows what the data do not
determine: a displacement goes with E·tⁿ, n from 1 (membrane) to 3 (bending), so that E and t part
only where n differs from row to row.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.calibration.calibration_noise import (
    MeasurementNoise,
    estimate_noise,
    whiten,
)
from phytac_design.mechanics.calibration.calibration_result import (
    CONFIDENCE,
    NAMES,
    Calibration,
    Name,
    ShellParameters,
)
from phytac_design.mechanics.calibration.probe_response import ProbeMotion, ResponseModel
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError, NumericalError

LIMIT = 0.10
"""Widest half-interval of modulus and thickness, as a fraction, that is returned."""
MAX_DISPLACEMENT_OVER_WALL = 0.1
"""Largest displacement over wall thickness: beyond, linear theory is off by more than about 3 %."""


@dataclass(frozen=True, kw_only=True)
class ShellCalibrationSettings:
    """Limits of a fit."""

    poisson_limit: float = 0.05
    """Widest half-interval of Poisson's ratio for it to be fitted; else it is held."""
    rows_per_parameter: int = 5
    """Fewest rows for each fitted parameter."""
    max_unit_factor: float = 30.0
    """Data this many times softer or stiffer than the design are in other units, not in error."""
    max_unexplained: float = 0.5
    """Largest share of the data's rms that may stay unexplained."""
    max_log_step: float = 0.3
    max_poisson_step: float = 0.05
    """Longest Gauss-Newton step, in ln E and ln t, and in ν."""
    max_poisson: float = 0.495
    max_wall_factor: float = 4.0
    """A wall this many times thicker or thinner than the design's is not searched."""
    max_iterations: int = 25
    hopeless_after_iterations: int = 3
    hopeless_deviation: float = 0.5
    """Rounds after which a standard deviation this large (ln E, ln t) ends the search: hopeless."""
    mesh_error_share: float = 0.25
    """Share of what extrapolation over two meshes changed that is added to every half-interval.

    Chosen on one synthetic sensor (without it, intervals of t held in 84 of 100), then confirmed on
    another, with other parameters, mesh and noise (97; without it 75).
    """
    step_tolerance: float = 0.05
    """Largest last step, in standard deviations of the parameter."""
    rounding_step: float = 1e-7
    """A step below this is rounding, however small the standard deviation."""


SETTINGS = ShellCalibrationSettings()


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Where a search ended: point, whitened Jacobian (n, 3) and mesh error (n,), noise."""

    at: FloatArray
    jacobian: FloatArray
    free: list[int]
    noise: MeasurementNoise
    mesh: FloatArray
    settled: bool

    def half_widths(self, quantile: float, free: list[int] | None = None) -> FloatArray:
        """Half-intervals of some parameters: of the noise, and of what the meshes leave."""
        free = self.free if free is None else free
        cov = _covariance(self.jacobian[:, free])
        pull = np.abs(self.mesh_pull(free))
        return np.asarray(quantile * np.sqrt(np.diag(cov)) + SETTINGS.mesh_error_share * pull)

    def mesh_pull(self, free: list[int]) -> FloatArray:
        """Change of the parameters that the extrapolation over two meshes made."""
        return np.asarray(np.linalg.lstsq(self.jacobian[:, free], -self.mesh, rcond=1e-10)[0])


def calibrate(
    response: ResponseModel,
    *,
    force_N: FloatArray,
    displacement_mm: FloatArray,
    press: IntArray,
    start: ShellParameters,
    fixed: Collection[Name] = (),
    limit: float = LIMIT,
    progress: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Fit modulus, thickness and, where the data determine it, Poisson's ratio.

    Parameters
    ----------
    response : callable
        Displacement of each row per newton at 1 MPa, with its rates.
    force_N, displacement_mm : (n,) float
        Force of each row's press and displacement at its probe, both positive inward.
    press : (n,) int
        Number of the press that a row belongs to: rows that share one force reading.
    start : ShellParameters
        The design's values: where the search begins, and what fixed parameters stay at.
    fixed : collection of str
        Parameters that are known: any of ``modulus``, ``thickness``, ``poisson``.
    limit : float
        Widest half-interval of modulus and thickness, as a fraction, that is returned.
    progress : callable
        Called with a line about each round.

    Raises
    ------
    InputError
        If there are too few rows or presses, or signs, units or sizes cannot be right.
    NumericalError
        If the data do not determine the parameters to ``limit``, or the model does not fit.
    """
    free = [k for k in (0, 1) if NAMES[k] not in fixed]
    if not free:
        raise InputError(
            "calibration-nothing-free", "nothing is left to fit; release modulus or thickness"
        )
    press = np.unique(press, return_inverse=True)[1].reshape(-1).astype(np.int64)
    presses = int(press.max(initial=-1)) + 1
    _refuse_few(len(press), presses, len(free))
    data = _Data(response, force_N, displacement_mm, press)
    at = np.array([np.log(start.modulus), np.log(start.thickness), start.poisson])
    first = response(start.thickness, start.poisson, False)
    _refuse_absurd(data, first.value, start)
    fit = _gauss_newton(data, at, free, progress=progress)
    if fit.settled and "poisson" not in fixed:
        joint = [*free, 2]
        widths = fit.half_widths(_quantile(presses, len(joint)), joint)
        if len(press) >= SETTINGS.rows_per_parameter * len(joint) and _good(widths, joint, limit):
            fit = _gauss_newton(data, fit.at, joint, progress=progress)
    quantile = _quantile(presses, len(fit.free))
    widths = fit.half_widths(quantile)
    summary = _combination(fit, quantile)
    if not (fit.settled and _good(widths, fit.free, limit)):
        raise NumericalError(
            "calibration-undetermined", _undetermined(fit, widths, summary, limit, presses)
        )
    return _result(fit, widths, summary, len(press), presses)


@dataclass(frozen=True)
class _Data:
    response: ResponseModel
    force: FloatArray
    measured: FloatArray
    press: IntArray

    def model(
        self, at: FloatArray, with_poisson: bool
    ) -> tuple[FloatArray, FloatArray, ProbeMotion]:
        """Expected displacement (n,), its Jacobian in (ln E, ln t, ν) (n, 3), the response."""
        thickness, per_E = float(np.exp(at[1])), self.force / np.exp(at[0])
        found = self.response(thickness, float(at[2]), with_poisson)
        expected = per_E * found.value
        turn = np.zeros_like(expected) if found.poisson_rate is None else found.poisson_rate
        rates = [-expected, per_E * thickness * found.thickness_rate, per_E * turn]
        return expected, np.stack(rates, axis=1), found


def _gauss_newton(
    data: _Data,
    at: FloatArray,
    free: list[int],
    *,
    progress: Callable[[str], None],
) -> _Fit:
    begin, noise = at, None
    longest = np.array([SETTINGS.max_log_step, SETTINGS.max_log_step, SETTINGS.max_poisson_step])[
        free
    ]
    done, turn = False, 0
    while True:
        turn += 1
        # The last round is at the solution; only there is the rate with a held ν of interest.
        expected, jacobian, found = data.model(at, done or 2 in free)
        if noise is None and 0 in free:  # E scales every displacement: set it before the rest
            shift = _scale(expected, data.measured)
            at = at - np.array([np.log(shift), 0.0, 0.0])
            expected, jacobian = expected * shift, jacobian * shift
        residual = data.measured - expected
        noise = estimate_noise(expected, residual, data.press, fitted=len(free), start=noise)
        columns = np.column_stack([jacobian, residual, data.force * found.mesh_error])
        white = whiten(noise, expected, data.press, columns)
        A, r = white[:, free], white[:, 3]
        step = np.linalg.lstsq(A, r, rcond=1e-10)[0]
        spread = np.sqrt(np.diag(_covariance(A)))
        lost = turn >= SETTINGS.hopeless_after_iterations and bool(
            np.any(spread > SETTINGS.hopeless_deviation)
        )
        lost |= turn == SETTINGS.max_iterations or bool(
            np.abs(at[1] - begin[1]) > np.log(SETTINGS.max_wall_factor)
        )
        if done or lost:
            _refuse_misfit(residual, data.measured)
            mesh = white[:, 4] / np.exp(at[0])
            return _Fit(
                at=at, jacobian=white[:, :3], free=free, noise=noise, mesh=mesh, settled=done
            )
        done = bool(
            np.all(
                np.abs(step) <= np.maximum(SETTINGS.step_tolerance * spread, SETTINGS.rounding_step)
            )
        )
        at = at.copy()
        at[free] += step * min(1.0, float(np.min(longest / np.maximum(np.abs(step), 1e-300))))
        at[2] = np.clip(at[2], 0.0, SETTINGS.max_poisson)
        progress(
            f"round {turn}: E {np.exp(at[0]):.5g} MPa, t {np.exp(at[1]):.5g} mm, ν {at[2]:.4g}"
        )


def _refuse_misfit(residual: FloatArray, measured: FloatArray) -> None:
    unexplained = float(np.sqrt(np.mean(residual**2) / np.mean(measured**2)))
    if unexplained > SETTINGS.max_unexplained:
        raise NumericalError(
            "calibration-poor-fit",
            f"calibration: the best fit leaves {unexplained:.0%} of the displacements "
            "unexplained; check contact and probe positions, clamping and units",
        )


def _scale(expected: FloatArray, measured: FloatArray) -> float:
    """Factor between measured and expected displacements, by least squares."""
    return float(expected @ measured / (expected @ expected))


def _covariance(A: FloatArray) -> FloatArray:
    """(AᵀA)⁻¹, huge but finite where singular."""
    _, s, Vt = np.linalg.svd(A, full_matrices=False)
    s = np.maximum(s, 1e-12 * s.max(initial=1e-300))
    return np.asarray((Vt.T / s**2) @ Vt)


def _quantile(presses: int, fitted: int) -> float:
    from scipy.stats import t

    return float(t.ppf(0.5 + CONFIDENCE / 2.0, max(1, presses - fitted)))


def _good(widths: FloatArray, free: list[int], limit: float) -> bool:
    """Whether all half-widths (ln E, ln t, ν) are within their limits."""
    limits = np.array([np.log1p(limit), np.log1p(limit), SETTINGS.poisson_limit])[free]
    return bool(np.all(widths <= limits))


def _combination(fit: _Fit, quantile: float) -> tuple[float, float, float]:
    """Condition number; exponent n of the best determined E·tⁿ, and its half-interval."""
    cov = _covariance(fit.jacobian[:, fit.free])
    values = np.linalg.eigvalsh(cov)
    condition = float(np.sqrt(values[-1] / values[0]))
    if 0 not in fit.free or 1 not in fit.free:
        return condition, 0.0, float(quantile * np.sqrt(cov[0, 0]))
    # Least variance of ln E + n·ln t over n.
    n = -cov[0, 1] / cov[1, 1]
    return condition, float(n), float(quantile * np.sqrt(cov[0, 0] + n * cov[0, 1]))


def _refuse_few(rows: int, presses: int, fitted: int) -> None:
    if rows < SETTINGS.rows_per_parameter * fitted or presses < fitted + 2:
        raise InputError(
            "calibration-too-few-rows",
            f"calibration: {rows} rows of {presses} presses are too few to fit {fitted} "
            f"parameters (at least {SETTINGS.rows_per_parameter * fitted} rows and {fitted + 2} "
            "presses of "
            "different place, patch or force); measure more, or fix a parameter",
        )


def _refuse_absurd(data: _Data, value: FloatArray, start: ShellParameters) -> None:
    """Reject signs, units and sizes that no calibration can correct."""
    for name, array in (("force_N", data.force), ("displacement_mm", data.measured)):
        if not np.all(np.isfinite(array)):
            raise InputError(
                "calibration-not-finite",
                f"calibration: {name} of row {int(np.argmin(np.isfinite(array)))} "
                "is not finite (NaN or inf); correct or remove the row",
            )
    expected = data.force * value / start.modulus
    factor = _scale(expected, data.measured)
    if factor <= 0.0:
        raise InputError(
            "calibration-sign-reversed",
            "calibration: the displacements point the other way than the forces; forces and "
            "displacements are both positive inward",
        )
    if not 1.0 / SETTINGS.max_unit_factor < factor < SETTINGS.max_unit_factor:
        raise InputError(
            "calibration-unit-mismatch",
            f"calibration: the displacements are {factor:.3g} times those of the design "
            f"(E {start.modulus:g} MPa, t {start.thickness:g} mm); displacements are in mm and "
            "forces in N: check units, or put a modulus nearer the truth into the design",
        )
    largest = float(np.abs(data.measured).max())
    if largest > MAX_DISPLACEMENT_OVER_WALL * start.thickness:
        over = int(np.sum(np.abs(data.measured) > MAX_DISPLACEMENT_OVER_WALL * start.thickness))
        raise InputError(
            "calibration-displacement-large",
            f"calibration: {over} rows move by more than {MAX_DISPLACEMENT_OVER_WALL:g} of the "
            "wall (up to "
            f"{largest:.3g} mm of {start.thickness:g} mm), where linear theory is off by more than "
            "about 3 %; press more gently, or remove the presses they belong to",
        )


def _undetermined(
    fit: _Fit,
    widths: FloatArray,
    summary: tuple[float, float, float],
    limit: float,
    presses: int,
) -> str:
    parts = [f"{NAMES[k]} ± {_percent(w, 0)}" for k, w in zip(fit.free, widths, strict=True)]
    text = f"the data do not determine: {', '.join(parts)} at {CONFIDENCE:.0%} (limit {limit:.0%})"
    more = (float(np.max(widths)) / np.log1p(limit)) ** 2
    if len(fit.free) == 1:
        return f"{text}; about {more:.1f} times as many presses would do"
    _, exponent, width = summary
    text += (
        f"; what they determine is E·t^{exponent:.2f}, to ± {_percent(width, 1)}. Fix "
        "one that is known (--fix thickness), or add what bends and stretches the wall "
        "differently: probes away from the contacts, presses near a rim, patches of 3 and of 8 mm"
    )
    return text + (f"; or {more:.1f} times the {presses} presses" if more < 100 else "")


def _percent(width: float, digits: int) -> str:
    """Half-interval of a logarithm as a percentage."""
    return f"{np.expm1(width):.{digits}%}" if width < 1.0 else "more than 100%"


def _result(
    fit: _Fit,
    widths: FloatArray,
    summary: tuple[float, float, float],
    rows: int,
    presses: int,
) -> Calibration:
    half = np.zeros(3)
    half[fit.free] = widths
    condition, exponent, combination = summary
    names = tuple(NAMES[k] for k in fit.free)
    A = fit.jacobian[:, fit.free]
    turned = np.linalg.lstsq(A, -0.01 * fit.jacobian[:, 2], rcond=None)[0]
    mesh = fit.mesh_pull(fit.free)
    pull = {} if 2 in fit.free else dict(zip(names, turned.tolist(), strict=True))
    return Calibration(
        value=_parameters(fit.at),
        low=_parameters(fit.at - half),
        high=_parameters(fit.at + half),
        fitted=names,
        noise=fit.noise,
        rows=rows,
        presses=presses,
        condition=condition,
        exponent=exponent,
        combination=combination,
        poisson_pull=pull,
        mesh_pull=dict(zip(names, mesh.tolist(), strict=True)),
    )


def _parameters(at: FloatArray) -> ShellParameters:
    return ShellParameters(
        modulus=float(np.exp(at[0])), thickness=float(np.exp(at[1])), poisson=float(at[2])
    )
