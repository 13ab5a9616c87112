"""Calibration of the finite-element model by known contacts, before any network (paper, eq. 4).

Three parameters: the modulus; how far the force of a contact spreads, between the footprint of its
switch and the cell of a marker; and how little a key node's own shift counts, as its tip covers
paint. They minimise the sum of absolute force errors on the key nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.estimation.estimators import ForceModel, TIP_SD_px
from phytac_design.datasets.samples import Samples, key_nodes
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
    error_N : float
        Mean absolute error of the forces on key nodes.
    """

    model: ForceModel
    modulus: float
    spread: float
    tip_sd_px: float
    error_N: float


def fit_mechanics(
    model: ForceModel, footprint_px: FloatArray, samples: Samples
) -> CalibratedMechanics:
    """Fit modulus, spread and the weight of key nodes' own shifts to samples of known forces.

    Parameters
    ----------
    model : ForceModel
        By design: forces act on cells.
    footprint_px : (2n, n) float
        Shifts per newton on the switches' footprints.
    samples : Samples
        With points.
    """
    few = select_samples(samples, np.arange(min(samples.count, SAMPLES_MAX)))

    if len(key_nodes(model, few, noise_px=model.noise_px).force_N) < NODES_MIN:
        return CalibratedMechanics(
            model=model, modulus=1.0, spread=1.0, tip_sd_px=model.tip_sd_px, error_N=float("nan")
        )

    def score(spread: float, tip_sd_px: float) -> tuple[float, float]:
        """Mean absolute error, and modulus."""
        tried = replace(_spread_model(model, footprint_px, spread), tip_sd_px=tip_sd_px)
        rows = key_nodes(tried, few, noise_px=model.noise_px, base="key_nodes")
        modulus = _modulus(rows.stiffness_force_N, rows.force_N)
        return float(np.abs(modulus * rows.stiffness_force_N - rows.force_N).mean()), modulus

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
        tip_sd_px=tip_sd_px,
    )
    return CalibratedMechanics(
        model=stiff, modulus=modulus, spread=spread, tip_sd_px=tip_sd_px, error_N=error_N
    )


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
