"""Thresholds of switches that do not snap, learnt one by one from samples of their own sensor.

A sample says of each switch whether it read as on, and how much force its footprint carried. The
logarithm of a threshold has a normal prior about the design's, times a factor that all switches of
a casting share (their rubber's modulus). Switches that snap are left as designed: they stay on down
to their release, so a switch that is on need not have felt its threshold.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import Indentations
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.switch_law import SwitchLaw
from phytac_shapes.arrays import BoolArray, FloatArray

CARRIED_SD = 0.1
"""Standard deviation of the logarithm of the force on a footprint as samples give it: places are
known to some tenths of a millimetre, and tips are read with noise. Assumed."""
MISREAD = 0.01
"""Share of switches that are read wrongly, whatever the force."""
COMMON_SD = 0.2
"""Standard deviation of the logarithm of the factor that all switches share."""


def learn_thresholds(
    bundle: Bundle, sensor: Sensor, law: SwitchLaw, samples: Samples
) -> tuple[Bundle, dict[str, Any]]:
    """Learn the thresholds of gradual switches; return the decoder with them, and facts.

    Parameters
    ----------
    bundle : Bundle
        Decoder with the thresholds by design.
    sensor : Sensor
        The design, its surface and markers.
    law : SwitchLaw
        Its switches.
    samples : Samples
        With points.
    """
    own = np.flatnonzero(law.gradual & bundle.tips.readable)
    locator = bundle.model.locator
    if not len(own) or locator is None:
        missing = "tables in the decoder" if locator is None else "switch that can be read"
        return bundle, {"left": f"as designed: no {missing}"}
    carried, read = carried_forces(sensor, samples)
    factor, sd, common = posterior(
        carried[:, own] / law.on_N[own], read[:, own], np.asarray(law.spread[own])
    )
    threshold, spread = bundle.threshold_N.copy(), law.threshold_sd
    threshold[own] *= factor
    if spread is not None:
        # What the decoder finds of the force on a switch scatters as before.
        spread = spread.copy()
        spread[own] = np.sqrt(spread[own] ** 2 - law.spread[own] ** 2 + sd**2)
    learnt = replace(locator, threshold_N=threshold, threshold_sd=spread)
    facts = {
        "switches": len(own),
        "common_factor": common,
        "spread_before": float(np.median(law.spread[own])),
        "spread_after": float(np.median(sd)),
    }
    bundle = replace(bundle, threshold_N=threshold, model=replace(bundle.model, locator=learnt))
    return bundle, facts


def carried_forces(sensor: Sensor, samples: Samples) -> tuple[FloatArray, BoolArray]:
    """Force (s, n) N on each footprint, and switches (s, n) read as on, of samples that were read.

    Raises
    ------
    InputError
        If the samples have no points.
    """
    touches, _, _, bits = samples.points()
    contacts = Indentations(
        uv=touches.uv,
        radius_mm=touches.radius_mm,
        force_N=touches.force_N,
        indenter=touches.indenter,
        length_mm=touches.length_mm,
        turn_rad=touches.turn_rad,
        friction=touches.friction,
    )
    radius = sensor.design.switch.footprint_diameter_mm / 2.0
    share = footprint_shares(sensor.surface, contacts, sensor.markers.uv, radius)
    carried = np.zeros(bits.shape)
    np.add.at(carried, touches.sample, share * touches.force_N[:, None])
    seen = samples.status != FAILED
    return carried[seen], bits[seen]


def posterior(
    ratio: FloatArray, read: BoolArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Factors (n,) on thresholds, standard deviations (n,) of their logarithms, the common factor.

    Parameters
    ----------
    ratio : (s, n) float
        Force on each footprint over the threshold by design.
    read : (s, n) bool
        Switches that read as on.
    spread : (n,) float
        Standard deviation of the logarithm of thresholds from switch to switch.
    """
    reach, cells = 4.0, 161  # of the grid of logarithms, in standard deviations
    grid = reach * np.hypot(spread.max(), COMMON_SD) * np.linspace(-1.0, 1.0, cells)
    # Samples far from any threshold of the grid say nothing.
    force = np.log(np.maximum(ratio, 1e-9))
    total = np.zeros((cells, ratio.shape[1]))
    for row, on in zip(force, read, strict=True):
        near = np.flatnonzero(np.abs(row) < 2.0 * reach * COMMON_SD)
        share = 1.0 / (1.0 + np.exp(-1.702 * (row[near] - grid[:, None]) / CARRIED_SD))
        share = np.where(on[near], share, 1.0 - share)
        total[:, near] += np.log(np.maximum(share, MISREAD))
    likely = np.exp(total - total.max(axis=0))
    evidence = [
        float(np.sum(np.log((likely * _normal(grid, common, spread)).sum(axis=0))))
        - 0.5 * (common / COMMON_SD) ** 2
        for common in grid
    ]
    common = float(grid[int(np.argmax(evidence))])
    weight = likely * _normal(grid, common, spread)
    weight /= weight.sum(axis=0)
    mean = grid @ weight
    sd = np.sqrt(np.maximum((grid**2) @ weight - mean**2, 0.0))
    return np.exp(mean), np.maximum(sd, grid[1] - grid[0]), float(np.exp(common))


def _normal(grid: FloatArray, middle: float, spread: FloatArray) -> FloatArray:
    """Normal density (g, n) on a grid, up to a factor."""
    density = np.exp(-0.5 * ((grid[:, None] - middle) / spread) ** 2)
    return np.asarray(density / density.sum(axis=0))
