"""What can be learnt from data: each trainer adds one estimator to a decoder's force model."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import Activation, CascadeNetwork
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle
from phytac_design.datasets.samples import THEORIES
from phytac_design.training.levenberg_marquardt import KeyNodeData, train_network
from phytac_design.training.locator_calibration import calibrate_locator
from phytac_design.training.training_data import Part
from phytac_shapes.errors import InputError

LINEAR = (THEORIES.index("rest"), THEORIES.index("linear"))


@dataclass(frozen=True, kw_only=True)
class TrainingTask:
    """What a trainer is given.

    Attributes
    ----------
    bundle : Bundle
        The decoder so far: its mechanics, and what the trainers before this one added.
    training, validation : Part
        To learn from, and to say when to stop.
    test : Part
        Held out: to be told of, never to learn from.
    seed : int
        Of everything random.
    start : Bundle or None
        Another sensor's decoder to start from.
    """

    bundle: Bundle
    training: Part
    validation: Part
    test: Part
    seed: int
    start: Bundle | None = None


Trainer = Callable[[TrainingTask], tuple[ForceModel, dict[str, Any]]]
"""From a lesson to the bundle's force model with one more estimator, and facts, plain JSON."""


def train_cascade(
    lesson: TrainingTask, *, name: str, activation: Activation
) -> tuple[ForceModel, dict[str, Any]]:
    """Train the paper's network.

    Raises
    ------
    InputError
        If there are too few key nodes, or the decoder to start from has no such network.
    """
    start = None
    if lesson.start is not None:
        start = lesson.start.model.networks.get(name)
        if start is None:
            known = ", ".join(sorted(lesson.start.model.networks)) or "none"
            raise InputError(
                f"the decoder to start from, of {lesson.start.design}, has no network {name} "
                f"(its networks: {known}); train that one first, or leave --start out"
            )
    fit = train_network(
        lesson.training.rows,
        lesson.validation.rows,
        activation=activation,
        seed=lesson.seed,
        start=start,
    )
    model = lesson.bundle.model
    facts = {
        "rounds": fit.rounds,
        "rmse_training_N": fit.rmse_train_N,
        "rmse_validation_N": fit.rmse_validation_N,
        "rmse_test_N": rmse_N(fit.network, lesson.test.rows),
    }
    return replace(model, networks={**model.networks, name: fit.network}), facts


def rmse_N(network: CascadeNetwork, rows: KeyNodeData) -> float:
    """Force error (root mean square, N) of a network on some key nodes; NaN for none."""
    error = rows.stiffness_force_N + network(rows.features) * rows.apparent_mm - rows.force_N
    return float(np.sqrt((error**2).mean())) if len(error) else float("nan")


def calibrate_auto(lesson: TrainingTask) -> tuple[ForceModel, dict[str, Any]]:
    """Let ``auto`` know its sensor: stiffness, markers' gains, noise, priors, correction, spread.

    Where all samples are of linear theory, its tables are cut to that too.

    Raises
    ------
    InputError
        If the samples hold no contact that is found again.
    """
    model, samples = lesson.bundle.model, lesson.training.samples
    if model.locator is None or samples is None:
        missing = "tables in the decoder" if model.locator is None else "points in the data"
        return model, {"left": f"as designed: no {missing}"}
    linear = bool(np.isin(samples.theory, LINEAR).all())
    locator, facts = calibrate_locator(
        model.locator.linear if linear else model.locator,
        samples,
        np.arange(samples.count),
        force_max_N=lesson.bundle.force_max_N,
        seed=lesson.seed,
    )
    return replace(model, locator=locator), facts | {"orders": locator.places.orders}


TRAINERS: tuple[tuple[str, Trainer], ...] = (
    ("fem_nn", partial(train_cascade, name="fem_nn", activation="rectified")),
    ("fem_nn_identity", partial(train_cascade, name="fem_nn_identity", activation="identity")),
    ("auto", calibrate_auto),
)
"""By estimator, in the order in which they run."""
