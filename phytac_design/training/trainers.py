"""Trainers: each adds one estimator to a decoder's force model."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import Activation, Base
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle
from phytac_design.datasets.samples import THEORIES, KeyNodeData, Samples, key_nodes
from phytac_design.training.fem_calibration import MODULI, ReceptorSolver, fit_mechanics
from phytac_design.training.levenberg_marquardt import train_network
from phytac_design.training.locator_calibration import calibrate_locator, error_of_first_order
from phytac_design.training.training_data import SplitPart, data_of
from phytac_design.training.uneven_wall import WallSolver
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class TrainingTask:
    """Inputs of a trainer.

    Attributes
    ----------
    bundle : Bundle
        The decoder so far: its mechanics, and the results of earlier trainers.
    training, validation, test : Part
        Parts to fit to, to decide when to stop, and to report errors on.
    seed : int
        Seed of everything random.
    start : Bundle or None
        Another sensor's decoder to start from.
    receptors : ReceptorSolver or None
        Solves large displacements by forces on receptors, by the design.
    wall : WallSolver or None
        The design's shell, for a print's own thickness.
    """

    bundle: Bundle
    training: SplitPart
    validation: SplitPart
    test: SplitPart
    seed: int
    start: Bundle | None = None
    receptors: ReceptorSolver | None = None
    wall: WallSolver | None = None

    @property
    def points(self) -> list[Samples]:
        """The three parts with points; none if a sample of any of them has none."""
        parts = (self.training, self.validation, self.test)
        points = [part.samples for part in parts if part.samples is not None and part.has_points]
        return points if len(points) == len(parts) else []


Trainer = Callable[[TrainingTask], tuple[ForceModel, dict[str, Any]]]
"""Returns the bundle's force model with one more estimator, and facts, plain JSON."""


def train_cascade(
    task: TrainingTask, *, name: str, activation: Activation
) -> tuple[ForceModel, dict[str, Any]]:
    """Train the paper's network.

    Raises
    ------
    InputError
        If there are too few key nodes, or the decoder to start from has no such network.
    """
    start = None
    if task.start is not None:
        start = task.start.model.networks.get(name)
        if start is None:
            known = ", ".join(sorted(task.start.model.networks)) or "none"
            raise InputError(
                "network-unknown",
                f"the decoder to start from, of {task.start.design}, has no network {name} "
                f"(its networks: {known}); train that one first, or leave --start out",
            )
    model = task.bundle.model
    base: Base = "stiffness"
    rows = [part.rows for part in (task.training, task.validation, task.test)]
    if task.points:
        theory = _of_theory(model, task.points[0])
        rows, base = [_key_node_rows(theory, samples) for samples in task.points], "key_nodes"
    fit = train_network(
        rows[0], rows[1], activation=activation, seed=task.seed, start=start, base=base
    )
    facts = {
        "rounds": fit.rounds,
        "rmse_training_N": fit.rmse_train_N,
        "rmse_validation_N": fit.rmse_validation_N,
        "rmse_test_N": rows[2].rmse_N(fit.network),
        "base": base,
    }
    return replace(model, networks={**model.networks, name: fit.network}), facts


def _key_node_rows(model: ForceModel, samples: Samples) -> KeyNodeData:
    """Return the networks' rows of samples with points, by a model with calibrated mechanics."""
    return data_of(key_nodes(model, samples, noise_px=model.noise_px, base="key_nodes"))


def calibrate_fem(task: TrainingTask) -> tuple[ForceModel, dict[str, Any]]:
    """Calibrate the modulus, and how far forces spread, of the finite-element model (eq. 4)."""
    model = task.bundle.model
    # Stored inputs of networks are of the mechanics by design.
    if not task.points or model.footprint_px is None:
        return model, {"left": "as designed: data without points"}
    theory = _of_theory(model, task.points[0])
    training, validation, _ = task.points
    fit = fit_mechanics(theory, model.footprint_px, training, validation, task.receptors)
    names = ("modulus", "spread", "tip_sd_px", "receptors", "columns", "error_N")
    facts = {name: getattr(fit, name) for name in names}
    if fit.modulus in MODULI:
        facts["warning"] = (
            f"the data show a modulus beyond {MODULI[0]:g} to {MODULI[1]:g} times the design's "
            f"(it stays at {fit.modulus:g} times): forces of fem, koi_inverse and networks are "
            "scaled wrongly; check material, thickness, and the unit of the forces: "
            "auto has learnt the unit of the data, and says nothing of it when it decodes"
        )
    return replace(fit.model, locator=model.locator), facts


def _of_theory(model: ForceModel, samples: Samples) -> ForceModel:
    """Model without large displacements if no sample has any."""
    return model.linear if _all_linear(samples) else model


def _all_linear(samples: Samples) -> bool:
    theories = [THEORIES.index(name) for name in ("rest", "linear")]
    return bool(np.isin(samples.theory, theories).all())


def calibrate_auto(task: TrainingTask) -> tuple[ForceModel, dict[str, Any]]:
    """Calibrate ``auto``: stiffness, marker gains, noise, priors, correction, spread.

    If all samples are of linear theory, its tables are reduced to the first order, and the error of
    linear theory is kept: it widens intervals and is a limit of the decoder.

    Raises
    ------
    InputError
        If no contact of the samples is located again.
    """
    model, samples = task.bundle.model, task.training.samples
    if model.locator is None or samples is None:
        missing = "tables in the decoder" if model.locator is None else "points in the data"
        return model, {"left": f"as designed: no {missing}"}
    linear = _all_linear(samples)
    locator, facts = calibrate_locator(
        model.locator.linear if linear else model.locator,
        samples,
        np.arange(samples.count),
        force_max_N=task.bundle.force_max_N,
        seed=task.seed,
        wall=task.wall,
    )
    if linear and locator.correction is not None:
        locator = replace(
            locator,
            correction=replace(locator.correction, linear=True),
            linear_error=model.locator.linear_error or error_of_first_order(model.locator),
        )
    return replace(model, locator=locator), facts | {"orders": locator.places.orders}


TRAINERS: tuple[tuple[str, Trainer], ...] = (
    ("mechanics", calibrate_fem),
    ("fem_nn", partial(train_cascade, name="fem_nn", activation="rectified")),
    ("fem_nn_identity", partial(train_cascade, name="fem_nn_identity", activation="identity")),
    ("auto", calibrate_auto),
)
"""By estimator, in the order of execution."""
