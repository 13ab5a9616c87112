"""Training of the FEM-NN with Levenberg-Marquardt."""

import time
from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.cascade_network import (
    HIDDEN,
    INPUTS,
    SHAPES,
    Activation,
    Base,
    CascadeNetwork,
    forward,
    layers_of,
)
from phytac_design.datasets.samples import KeyNodeData
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

ITERATIONS_MAX, PATIENCE, RESTARTS = 150, 12, 2
"""Levenberg-Marquardt iterations; those without a lower validation error; random starts."""


@dataclass(frozen=True, kw_only=True)
class TrainedNetwork:
    """A trained network, its training time, and its force errors (root mean square)."""

    network: CascadeNetwork
    seconds: float
    rounds: int
    rmse_train_N: float
    rmse_validation_N: float


def split_samples(count: int, *, seed: int) -> tuple[IntArray, IntArray, IntArray]:
    """Split sample indices at random: 85 % training, 5 % validation, 10 % test (paper)."""
    order = np.random.default_rng(seed).permutation(count)
    first, second = round(0.85 * count), round(0.90 * count)
    return order[:first], order[first:second], order[second:]


def train_network(
    training: KeyNodeData,
    validation: KeyNodeData,
    *,
    activation: Activation,
    seed: int,
    start: CascadeNetwork | None = None,
    base: Base = "stiffness",
) -> TrainedNetwork:
    """Fit k = g(nn) so that (K·U)_i + k_i·u_i matches the true force (paper, eq. 2 and 3).

    The label k_i = (F_i - (K·U)_i) / u_i is not used, as it is undefined for u → 0. The loss is the
    force error, in which k enters only as k_i·u_i, so that nodes that hardly move count little.
    Levenberg-Marquardt on all parameters; those of the lowest validation error are kept.

    Parameters
    ----------
    training, validation : KeyNodeData
        Rows to fit to, and rows that decide when to stop.
    activation : str
        As in :class:`phytac_decoder.estimation.cascade_network.CascadeNetwork`.
    seed : int
        Seed of the initial weights.
    start : CascadeNetwork, optional
        Another sensor's network to start from instead. Its 351 parameters are used; the scales are
        those of the new data, so that it adapts to the motion and stiffness of the new sensor.
    base : str
        What stands for (K·U)_i, see :class:`.CascadeNetwork`.

    Raises
    ------
    InputError
        If there are too few key nodes, or the start has another activation.
    """
    if len(training.force_N) < INPUTS + 1 or len(validation.force_N) < 1:
        raise InputError(
            "training-data-too-few",
            f"{len(training.force_N)} key nodes in the training data and "
            f"{len(validation.force_N)} in the validation data are too few; simulate more "
            "contacts (training.samples) or stronger ones",
        )
    if start is not None and start.activation != activation:
        raise InputError(
            "network-activation-differs",
            f"train_network: a network with activation {start.activation!r} cannot be the start "
            f"of one with {activation!r}; give one of the same kind",
        )
    begin = time.perf_counter()
    scale_in = np.full(INPUTS, max(float(np.abs(training.features[:, :9]).std()), 1e-9))
    scale_in[9] = max(float(np.abs(training.features[:, 9]).max()), 1e-9)
    u = np.abs(training.apparent_mm)
    scale_out = float(np.abs(training.force_N).mean() / max(float(u.mean()), 1e-9))
    fitted, held_out = (
        _Problem(data, scale_in, scale_out, activation) for data in (training, validation)
    )
    starts = (
        [_initial(seed + restart) for restart in range(RESTARTS)]
        if start is None
        else [start.parameters]
    )
    fits = [_levenberg_marquardt(fitted, held_out, first) for first in starts]
    rmse_validation, rmse_train, rounds, parameters = min(fits, key=lambda fit: fit[0])
    return TrainedNetwork(
        network=CascadeNetwork(
            parameters=parameters,
            activation=activation,
            scale_in=scale_in,
            scale_out=scale_out,
            base=base,
            low=training.features.min(axis=0),
            high=training.features.max(axis=0),
        ),
        seconds=time.perf_counter() - begin,
        rounds=rounds,
        rmse_train_N=rmse_train,
        rmse_validation_N=rmse_validation,
    )


def _initial(seed: int) -> FloatArray:
    """Return He-scaled normal weights, zero biases, and a small output layer."""
    rng = np.random.default_rng(seed)
    parts = []
    for name, shape in SHAPES.items():
        if name.startswith("b"):
            parts.append(np.zeros(shape))
            continue
        gain = (2.0 / shape[1]) ** 0.5 * (0.1 if shape[0] != HIDDEN else 1.0)
        parts.append(gain * rng.standard_normal(shape).ravel())
    return np.concatenate(parts)


class CascadeDerivatives:
    """The network of ``cascade_network`` at one vector of parameters, with its derivatives."""

    def __init__(self, flat: FloatArray, x: FloatArray, *, rectified: bool) -> None:
        self.w, self.rectified = layers_of(flat), rectified
        self.every, self.value = forward(self.w, x, rectified=rectified)

    def jacobian(self) -> FloatArray:
        """Return derivatives (m, 351) of the values by the parameters."""
        both = INPUTS + HIDDEN
        m, out = len(self.every), self.w["w3"][0]
        on = self.every > 0.0 if self.rectified else np.ones_like(self.every, dtype=np.bool_)
        second = np.where(on[:, both:], out[both:], 0.0)
        first = out[INPUTS:both] + second @ self.w["w2"][:, INPUTS:]
        first = np.where(on[:, INPUTS:both], first, 0.0)
        slopes = {
            "w1": first[:, :, None] * self.every[:, None, :INPUTS],
            "b1": first,
            "w2": second[:, :, None] * self.every[:, None, :both],
            "b2": second,
            "w3": self.every,
            "b3": np.ones((m, 1)),
        }
        return np.concatenate([slopes[name].reshape(m, -1) for name in SHAPES], axis=1)


class _Problem:
    """Force residuals k·u - (F - K·U) of some key nodes, (m,) N."""

    def __init__(
        self, data: KeyNodeData, scale_in: FloatArray, scale_out: float, activation: Activation
    ) -> None:
        self.x = data.features / scale_in
        self.u = data.apparent_mm * scale_out
        self.goal_N = data.force_N - data.stiffness_force_N
        self.rectified = activation == "rectified"

    def at(self, flat: FloatArray) -> tuple[CascadeDerivatives, FloatArray, float]:
        """Return the network, the residuals and their root mean square."""
        network = CascadeDerivatives(flat, self.x, rectified=self.rectified)
        residual = network.value * self.u - self.goal_N
        return network, residual, float(np.sqrt((residual**2).mean()))


def _levenberg_marquardt(
    training: _Problem, validation: _Problem, first: FloatArray
) -> tuple[float, float, int, FloatArray]:
    """Return validation and training error, iterations and parameters of the best iteration."""
    flat, damping = first, 1e-2
    network, residual, loss = training.at(flat)
    best = (validation.at(flat)[2], loss, 0, flat)
    unit = np.eye(len(flat))
    for step in range(1, ITERATIONS_MAX + 1):
        jacobian = network.jacobian() * training.u[:, None]
        gram, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        ridge = (np.trace(gram) / len(flat) + 1e-30) * unit
        improved = False
        for _ in range(8):
            trial = flat - np.linalg.solve(gram + damping * ridge, gradient)
            tried = training.at(trial)
            if tried[2] < loss:
                flat, (network, residual, loss), improved = trial, tried, True
                damping = max(damping / 5.0, 1e-9)
                break
            damping = min(damping * 4.0, 1e9)
        error = validation.at(flat)[2]
        if error < best[0]:
            best = (error, loss, step, flat)
        if not improved or step - best[2] > PATIENCE:
            break
    return best
