"""Calibration of the finite-element model by known contacts, before any network (paper, eq. 4).

Three parameters of the whole shell: the modulus; how far the force of a contact spreads, between
the footprint of its switch and the cell of a marker; and how little a key node's own shift counts,
as its tip covers paint. They minimise the sum of absolute force errors on the key nodes. If forces
act on the footprints of few receptors, large displacements are solved for these themselves. Then
the columns of the compliance, which a print has otherwise than its design, are measured.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from phytac_decoder.estimation.estimators import (
    MODEL_SHARE,
    ForceModel,
    NOISE_LEAST_px,
    TIP_SD_px,
)
from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_design.datasets.samples import FAILED, Samples, pressed_nodes
from phytac_design.training.join_datasets import select_samples
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SAMPLES_MAX = 120
"""Samples that are used: three parameters need no more."""
TIP_SDS_px = (0.0, 0.06, TIP_SD_px, 0.5)
"""Standard deviations of key nodes' own shifts that are tried."""
SPREADS = tuple(np.linspace(-0.25, 1.25, 7).tolist())
"""Spreads that are tried, before a parabola through the best three: 0 on the footprint, 1 on the
cell; beyond, for patches that are smaller or larger."""
MODULI = (0.5, 2.0)
"""Range of the modulus over the design's."""
COLUMN_SDS = (0.1, 0.3)
"""Standard deviations of the columns' entries over their size by design that are tried, beside none
at all; the least validation error decides."""
PRESSES_MIN = 2
"""Contacts on a marker that measure its column, and of a pair its interaction, at least."""
PAIR_SD = 1.0
"""Standard deviation of interactions over their size by the model, which is of second order. With
0.3 the validation error of the paper's protocol is 14 % more."""
PAIRS_MAX = 400
"""Pairs whose interactions are measured, at most: those that were pressed most often."""
NOISE_SHARE_MIN = 0.2
"""Changes of an entry that move a marker by less than this share of its noise are not sought."""
NODES_MIN = 10
"""Key nodes under force that a calibration needs."""
RECEPTORS_MAX, RECEPTOR_SPREAD_MAX = 128, 0.5
"""Receptors that large displacements are solved for, at most, and spread of their forces up to
which they are: fifty with 240 pairs take 8 seconds. Of wider contacts the tables know as much."""

ReceptorSolver = Callable[[IntArray, IntArray, float], ReceptorTable | None]
"""(receptors (m,), pairs (2, q) of them, spread of the forces) -> their large displacements."""


@dataclass(frozen=True, kw_only=True)
class CalibratedMechanics:
    """A calibrated model.

    Attributes
    ----------
    model : ForceModel
        With K and C of the calibrated shell.
    modulus : float
        Modulus over that of the design.
    spread : float
        0: forces act on the switches' footprints; 1: on the markers' cells.
    tip_sd_px : float
        Standard deviation of key nodes' own shifts.
    receptors : int
        Receptors that large displacements were solved for.
    columns : int
        Columns of the compliance that were measured.
    error_N : float
        Mean absolute error of the forces on key nodes, before columns are measured.
    """

    model: ForceModel
    modulus: float
    spread: float
    tip_sd_px: float
    receptors: int
    columns: int
    error_N: float


def fit_mechanics(
    model: ForceModel,
    footprint_px: FloatArray,
    samples: Samples,
    validation: Samples,
    receptors: ReceptorSolver | None = None,
) -> CalibratedMechanics:
    """Fit modulus, spread, weight of key nodes' own shifts, and columns to samples of known forces.

    Parameters
    ----------
    model : ForceModel
        By design: forces act on cells.
    footprint_px : (2n, n) float
        Shifts per newton on the switches' footprints.
    samples, validation : Samples
        With points: to fit to, and to decide whether measured columns are better, and how key nodes
        count then.
    receptors : ReceptorSolver, optional
        Solves large displacements by the design.
    """
    few = select_samples(samples, np.arange(min(samples.count, SAMPLES_MAX)))

    if len(pressed_nodes(few).sample) < NODES_MIN:
        return CalibratedMechanics(
            model=model,
            modulus=1.0,
            spread=1.0,
            tip_sd_px=model.tip_sd_px,
            receptors=0,
            columns=0,
            error_N=float("nan"),
        )
    fit = _fit(model, footprint_px, few)
    table = receptors and _receptors(receptors, model, samples, fit.spread)
    if table:
        model = replace(model, receptors=table)
        fit = _fit(model, footprint_px, few)
    fitted = _spread_model(model, footprint_px, fit.spread)
    stiff = replace(
        fitted,
        compliance_px=fitted.compliance_px / fit.modulus,
        stiffness=fitted.stiffness * fit.modulus,
        modulus=fit.modulus,
        tip_sd_px=fit.tip_sd_px,
    )
    tries = [stiff]
    for column_sd in COLUMN_SDS:
        # Measured columns hold what a tip usually covers: key nodes may count for more.
        better = replace(stiff, measured=measure(stiff, samples, column_sd))
        tries += [replace(better, tip_sd_px=tip_sd_px) for tip_sd_px in TIP_SDS_px]
    errors = [_error_N(tried, validation) for tried in tries]
    model = tries[int(np.argmin(errors))]
    return CalibratedMechanics(
        model=model,
        modulus=fit.modulus,
        spread=fit.spread,
        tip_sd_px=model.tip_sd_px,
        receptors=len(table.marker) if table else 0,
        columns=0 if model.measured is None else len(model.measured.marker),
        error_N=fit.error_N,
    )


class _Fit(NamedTuple):
    """Parameters of the whole shell, the best of several by their mean absolute error."""

    error_N: float
    modulus: float
    spread: float
    tip_sd_px: float


def _fit(model: ForceModel, footprint_px: FloatArray, samples: Samples) -> _Fit:
    """Fit the parameters of the whole shell."""

    def score(spread: float, tip_sd_px: float) -> _Fit:
        tried = replace(_spread_model(model, footprint_px, spread), tip_sd_px=tip_sd_px)
        found, truth = _forces(tried, samples)
        modulus = _modulus(found, truth)
        return _Fit(float(np.abs(modulus * found - truth).mean()), modulus, spread, tip_sd_px)

    best = []
    for tip_sd_px in TIP_SDS_px:
        errors = [score(spread, tip_sd_px).error_N for spread in SPREADS]
        best.append(score(_lowest(SPREADS, errors), tip_sd_px))
    return min(best)


def _receptors(
    solver: ReceptorSolver, model: ForceModel, samples: Samples, spread: float
) -> ReceptorTable | None:
    """Large displacements of the receptors that samples press; None if the tables serve as well."""
    force = _key_node_forces(samples, len(model.height_z_mm))
    if model.large_displacements is None or force is None or spread > RECEPTOR_SPREAD_MAX:
        return None
    marker = np.flatnonzero(np.count_nonzero(force, axis=0) >= PRESSES_MIN)
    if not 0 < len(marker) <= RECEPTORS_MAX:
        return None
    pair = _pairs(force > 0.0, 1)
    return solver(marker, pair[:, np.isin(pair, marker).all(axis=0)], spread)


def _key_node_forces(samples: Samples, count: int) -> FloatArray | None:
    """Return forces (s, n) on markers in samples that were solved; None if they are not known."""
    if samples.truth is None or samples.shift_px is None:
        return None
    force = np.zeros((samples.count, count))
    np.add.at(force, (samples.truth.sample, samples.truth.marker), samples.truth.force_N)
    return np.asarray(force[samples.status != FAILED])


def _error_N(model: ForceModel, samples: Samples) -> float:
    """Mean absolute error of the forces on key nodes; infinite without any."""
    found, truth = _forces(model, samples)
    return float(np.abs(found - truth).mean()) if len(found) else np.inf


def _forces(model: ForceModel, samples: Samples) -> tuple[FloatArray, FloatArray]:
    """Forces N (k,) on key nodes by a model, and the true ones."""
    nodes = pressed_nodes(samples)
    found = np.zeros(len(nodes.sample))
    for rows, shift_px, koi in nodes.by_sample():
        found[rows] = model.key_node_forces(shift_px, koi)
    return found, nodes.force_N


def measure(model: ForceModel, samples: Samples, column_sd: float) -> MeasuredColumns | None:
    """Measure columns of the compliance by known forces; None if no marker was pressed often.

    With large displacements, terms by the square of each force and by the forces of each two are
    measured as well. Each entry has the model's as prior mean, and as prior standard deviation
    ``column_sd`` times the marker's shift by design, for squares at the largest force of the data
    and of the tables, or ``PAIR_SD`` times an interaction (Bayesian linear regression, a marker at
    a time).
    """
    count = len(model.height_z_mm)
    force = _key_node_forces(samples, count)
    if force is None or samples.shift_px is None:
        return None
    shift = samples.shift_px[samples.status != FAILED]
    pressed = force > 0.0
    marker = np.flatnonzero(np.count_nonzero(pressed, axis=0) >= PRESSES_MIN)
    if not len(marker):
        return None
    design = model.compliance_px.reshape(count, 2, count)
    size = np.hypot(design[:, 0], design[:, 1])
    residual = shift - np.einsum("sk,nik->sni", force, design)
    columns = _Terms(inputs=force[:, marker], sd_px=column_sd * size[:, marker])
    for sample, each in enumerate(force):
        own = np.flatnonzero(each)
        residual[sample] -= model.beyond_linear_px(each[own], own).reshape(count, 2)
        residual[sample, model.misread(shift[sample], own, each[own])] = np.nan
    terms, pair = [columns], np.zeros((2, 0), dtype=np.int64)
    large = model.large_displacements
    if large:
        # Weak presses alone do not say how far off a strong one would be.
        most_N = max(float(force.max()), large.largest_N)
        if large.places.pairs:
            pair = _pairs(pressed, PRESSES_MIN)
        squares, products = large.second_order(pair, force)
        terms.append(_Terms(inputs=squares[:, marker], sd_px=columns.sd_px / most_N))
        sizes = np.linalg.norm(large.interaction_px(pair).reshape(-1, count, 2), axis=2)
        terms.append(_Terms(inputs=products, sd_px=PAIR_SD * sizes.T))
    moved = force**2 @ size.T**2
    noise_px = max(model.noise_px, NOISE_LEAST_px)
    inputs = np.concatenate([each.inputs for each in terms], axis=1)
    sd_px = np.concatenate([each.sd_px for each in terms], axis=1)
    largest_px = sd_px * inputs.max(axis=0)
    out = np.zeros((count, 2, len(inputs.T)))
    for row in range(count):
        known = np.isfinite(residual[:, row, 0])
        sought = np.flatnonzero(largest_px[row] > NOISE_SHARE_MIN * noise_px)
        if not len(sought) or not known.any():
            continue
        sd = sd_px[row, sought]
        weight = 1.0 / (noise_px**2 + MODEL_SHARE**2 * moved[known, row])
        scaled = inputs[np.ix_(known, sought)] * sd
        normal = scaled.T @ (weight[:, None] * scaled) + np.eye(len(sought))
        right = scaled.T @ (weight[:, None] * residual[known, row])
        out[row][:, sought] = (sd[:, None] * np.linalg.solve(normal, right)).T
    found = np.split(out.reshape(2 * count, -1), [len(marker), 2 * len(marker)], axis=1)
    return MeasuredColumns(
        marker=marker,
        shift_px=model.compliance_px[:, marker] + found[0],
        square_px=found[1],
        pair=pair,
        pair_px=found[2],
    )


@dataclass(frozen=True, kw_only=True)
class _Terms:
    """Terms of the shifts of n markers in s samples.

    Attributes
    ----------
    inputs : (s, k) float
        What each is in proportion to: powers of forces.
    sd_px : (n, k) float
        Prior standard deviation of the shift of each marker by one of it.
    """

    inputs: FloatArray
    sd_px: FloatArray


def _pairs(pressed: BoolArray, least: int) -> IntArray:
    """Pairs (2, k) of markers that samples (s, n) have pressed together so often, or more."""
    together = pressed.astype(np.float64).T @ pressed
    one, other = np.nonzero(np.tril(together, -1) >= least)
    most = np.sort(np.argsort(-together[one, other], kind="stable")[:PAIRS_MAX])
    return np.stack([one[most], other[most]])


def _modulus(found: FloatArray, truth: FloatArray) -> float:
    """Factor on forces (k,) with the least sum of absolute errors: a weighted median."""
    positive = found > 0.0
    ratio, weight = truth[positive] / found[positive], found[positive]
    order = np.argsort(ratio)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(np.clip(ratio[order][half], *MODULI)) if len(ratio) else 1.0


def _lowest(places: Sequence[float], values: Sequence[float]) -> float:
    """Place of the minimum of a parabola through the least of values and its neighbours."""
    best = int(np.argmin(values))
    if best in {0, len(places) - 1}:
        return places[best]
    left, middle, right = values[best - 1 : best + 2]
    step, bend = places[best] - places[best - 1], left - 2.0 * middle + right
    return places[best] + (0.5 * step * (left - right) / bend if bend > 0.0 else 0.0)


def _spread_model(model: ForceModel, footprint_px: FloatArray, spread: float) -> ForceModel:
    """Model whose forces act between footprint (0) and cell (1)."""
    compliance = footprint_px + spread * (model.compliance_px - footprint_px)
    count = len(model.height_z_mm)
    apparent = np.einsum("ni,nim->nm", model.shift_to_mm, compliance.reshape(count, 2, count))
    seen = np.flatnonzero(model.stiffness.any(axis=1))
    stiffness = np.zeros((count, count))
    stiffness[np.ix_(seen, seen)] = np.linalg.inv(apparent[np.ix_(seen, seen)])
    return replace(model, compliance_px=compliance, stiffness=stiffness)
