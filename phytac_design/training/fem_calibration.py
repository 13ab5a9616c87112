"""Calibration of the finite-element model by known contacts, before any network (paper, eq. 4).

Three parameters of the whole shell: the modulus; how far the force of a contact spreads, between
the footprint of its switch and the cell of a marker; and how little a key node's own shift counts,
as its tip covers paint. They minimise the sum of absolute force errors on the key nodes. Then the
columns of the compliance, which a print has otherwise than its design, are measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.estimation.estimators import (
    ForceModel,
    MeasuredColumns,
    NOISE_LEAST_px,
    TIP_SD_px,
)
from phytac_design.datasets.samples import FAILED, Samples, pressed_nodes
from phytac_design.training.join_datasets import select_samples
from phytac_shapes.arrays import FloatArray

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
MODEL_ERROR = 0.03
"""Share of a motion that no column explains, independently from contact to contact."""
PRESSES_MIN = 2
"""Contacts on a marker that measure its column, at least."""
NOISE_SHARE_MIN = 0.2
"""Changes of an entry that move a marker by less than this share of its noise are not sought."""
NODES_MIN = 10
"""Key nodes under force that a calibration needs."""


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
    columns : int
        Columns of the compliance that were measured.
    error_N : float
        Mean absolute error of the forces on key nodes, before columns are measured.
    """

    model: ForceModel
    modulus: float
    spread: float
    tip_sd_px: float
    columns: int
    error_N: float


def fit_mechanics(
    model: ForceModel, footprint_px: FloatArray, samples: Samples, validation: Samples
) -> CalibratedMechanics:
    """Fit modulus, spread, weight of key nodes' own shifts, and columns to samples of known forces.

    Parameters
    ----------
    model : ForceModel
        By design: forces act on cells.
    footprint_px : (2n, n) float
        Shifts per newton on the switches' footprints.
    samples, validation : Samples
        With points: to fit to, and to decide whether measured columns are better.
    """
    few = select_samples(samples, np.arange(min(samples.count, SAMPLES_MAX)))

    if len(pressed_nodes(few).sample) < NODES_MIN:
        return CalibratedMechanics(
            model=model,
            modulus=1.0,
            spread=1.0,
            tip_sd_px=model.tip_sd_px,
            columns=0,
            error_N=float("nan"),
        )

    def score(spread: float, tip_sd_px: float) -> tuple[float, float]:
        """Mean absolute error, and modulus."""
        tried = replace(_spread_model(model, footprint_px, spread), tip_sd_px=tip_sd_px)
        found, truth = _forces(tried, few)
        modulus = _modulus(found, truth)
        return float(np.abs(modulus * found - truth).mean()), modulus

    best: list[tuple[float, float, float, float]] = []
    for tip_sd_px in TIP_SDS_px:
        spread = _lowest(SPREADS, [score(spread, tip_sd_px)[0] for spread in SPREADS])
        best.append((*score(spread, tip_sd_px), spread, tip_sd_px))
    error_N, modulus, spread, tip_sd_px = min(best)
    fitted = _spread_model(model, footprint_px, spread)
    stiff = replace(
        fitted,
        compliance_px=fitted.compliance_px / modulus,
        stiffness=fitted.stiffness * modulus,
        modulus=modulus,
        tip_sd_px=tip_sd_px,
    )
    tries = [stiff, *(replace(stiff, measured=measure(stiff, samples, sd)) for sd in COLUMN_SDS)]
    errors = [_error_N(tried, validation) for tried in tries]
    model = tries[int(np.argmin(errors))]
    return CalibratedMechanics(
        model=model,
        modulus=modulus,
        spread=spread,
        tip_sd_px=tip_sd_px,
        columns=0 if model.measured is None else len(model.measured.marker),
        error_N=error_N,
    )


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

    Each entry has the model's as prior mean, and as prior standard deviation ``column_sd`` times
    the marker's shift by design (Bayesian linear regression, a marker at a time).
    """
    if samples.truth is None or samples.shift_px is None:
        return None
    count = len(model.height_z_mm)
    usable = samples.status != FAILED
    force = np.zeros((samples.count, count))
    np.add.at(force, (samples.truth.sample, samples.truth.marker), samples.truth.force_N)
    force, shift = force[usable], samples.shift_px[usable]
    marker = np.flatnonzero(np.count_nonzero(force, axis=0) >= PRESSES_MIN)
    if not len(marker):
        return None
    design = model.compliance_px.reshape(count, 2, count)
    size = np.hypot(design[:, 0], design[:, 1])
    residual = shift - np.einsum("sk,nik->sni", force, design)
    if model.large_displacements:
        for sample, each in enumerate(force):
            own = np.flatnonzero(each)
            more_px, _ = model.large_displacements.shifts(own, each[own])
            residual[sample] -= more_px.reshape(count, 2)
    moved = force**2 @ size.T**2
    noise_px = max(model.noise_px, NOISE_LEAST_px)
    largest = force.max(axis=0)
    out = design[:, :, marker].copy()
    for row in range(count):
        known = np.isfinite(residual[:, row, 0])
        sd = column_sd * size[row, marker]
        sought = np.flatnonzero(sd * largest[marker] > NOISE_SHARE_MIN * noise_px)
        if not len(sought) or not known.any():
            continue
        weight = 1.0 / (noise_px**2 + MODEL_ERROR**2 * moved[known, row])
        scaled = force[np.ix_(known, marker[sought])] * sd[sought]
        normal = scaled.T @ (weight[:, None] * scaled) + np.eye(len(sought))
        right = scaled.T @ (weight[:, None] * residual[known, row])
        out[row][:, sought] += (sd[sought, None] * np.linalg.solve(normal, right)).T
    return MeasuredColumns(marker=marker, shift_px=out.reshape(2 * count, -1))


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
