"""Training of the FEM-NN with Levenberg-Marquardt."""

import time
from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.cascade_network import (
    HIDDEN,
    INPUTS,
    SHAPES,
    Activation,
    CascadeNetwork,
    parameter_count,
)
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

ROUNDS_MAX = 150
PATIENCE = 12
RESTARTS = 2


@dataclass(frozen=True, kw_only=True)
class KeyNodeData:
    """One row per key node of interest (a marker whose switch is on).

    Attributes
    ----------
    features : (m, 10) float
        u of the node and its eight neighbours (mm), z (mm); see ``network_features``.
    apparent_mm : (m,) float
        u of the node itself.
    stiffness_force_N : (m,) float
        (K·U) at the node.
    force_N : (m,) float
        True force carried by the node.
    sample : (m,) int
        Sample the row belongs to.
    """

    features: FloatArray
    apparent_mm: FloatArray
    stiffness_force_N: FloatArray
    force_N: FloatArray
    sample: IntArray

    def take(self, samples: IntArray) -> "KeyNodeData":
        """Rows of some samples only."""
        keep = np.isin(self.sample, samples)
        return KeyNodeData(
            features=self.features[keep],
            apparent_mm=self.apparent_mm[keep],
            stiffness_force_N=self.stiffness_force_N[keep],
            force_N=self.force_N[keep],
            sample=self.sample[keep],
        )


@dataclass(frozen=True, kw_only=True)
class TrainedNetwork:
    """A trained network, how long it took, and its errors in newtons (root mean square)."""

    network: CascadeNetwork
    seconds: float
    rounds: int
    rmse_train_N: float
    rmse_validation_N: float


def split_samples(count: int, *, seed: int) -> tuple[IntArray, IntArray, IntArray]:
    """Shuffle sample indices into 85 % training, 5 % validation and 10 % test (the paper's)."""
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
) -> TrainedNetwork:
    """Fit k = g(nn) so that (K·U)_i + k_i·u_i matches the true force (paper, eq. 2 and 3).

    The label k_i = (F_i - (K·U)_i) / u_i is never formed: it is undefined as u → 0. The loss is
    the force error itself, in which k enters only as k_i·u_i, so that a node that hardly moves
    has hardly a say. Levenberg-Marquardt on all parameters; the parameters of the round with the
    least validation error are kept.

    Parameters
    ----------
    training, validation : KeyNodeData
        Rows to learn from, and rows that say when to stop.
    activation : str
        As in :class:`phytac_decoder.estimation.cascade_network.CascadeNetwork`.
    seed : int
        Of the random starts.
    start : CascadeNetwork, optional
        Another sensor's network to start from instead. Its 351 numbers are taken as they are,
        its scales are not: inputs and output are scaled as those of the new data, so that what
        it knows carries over in proportion to the new sensor's own motion and stiffness.

    Raises
    ------
    InputError
        If there are too few key nodes to learn from, or the start is a network of another kind.
    """
    if len(training.force_N) < INPUTS + 1 or len(validation.force_N) < 1:
        raise InputError(
            f"{len(training.force_N)} key nodes in the training data and "
            f"{len(validation.force_N)} in the validation data are too few; simulate more "
            "contacts (training.samples) or stronger ones"
        )
    if start is not None and start.activation != activation:
        raise InputError(
            f"train_network: a network with activation {start.activation!r} cannot be the start "
            f"of one with {activation!r}; give one of the same kind"
        )
    begin = time.perf_counter()
    scale_in = np.full(INPUTS, max(float(np.abs(training.features[:, :9]).std()), 1e-9))
    scale_in[9] = max(float(np.abs(training.features[:, 9]).max()), 1e-9)
    u = np.abs(training.apparent_mm)
    scale_out = float(np.abs(training.force_N).mean() / max(float(u.mean()), 1e-9))
    rows = [_Rows.of(data, scale_in, scale_out) for data in (training, validation)]
    starts = (
        [_initial(seed + restart) for restart in range(RESTARTS)]
        if start is None
        else [start.parameters]
    )
    fits = [_fit(rows[0], rows[1], first, rectified=activation == "rectified") for first in starts]
    best = min(fits, key=lambda fit: fit.rmse_validation)
    return TrainedNetwork(
        network=CascadeNetwork(
            parameters=best.parameters,
            activation=activation,
            scale_in=scale_in,
            scale_out=scale_out,
        ),
        seconds=time.perf_counter() - begin,
        rounds=best.rounds,
        rmse_train_N=best.rmse_train,
        rmse_validation_N=best.rmse_validation,
    )


@dataclass(frozen=True, kw_only=True)
class _Rows:
    """Scaled inputs (m, 10), u times the output scale (m,), and what k·u should be (m,) N."""

    x: FloatArray
    u: FloatArray
    goal_N: FloatArray

    @classmethod
    def of(cls, data: KeyNodeData, scale_in: FloatArray, scale_out: float) -> "_Rows":
        return cls(
            x=data.features / scale_in,
            u=data.apparent_mm * scale_out,
            goal_N=data.force_N - data.stiffness_force_N,
        )


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Result of one start."""

    rmse_validation: float
    rmse_train: float
    rounds: int
    parameters: FloatArray


def _initial(seed: int) -> FloatArray:
    """He-scaled normal weights, zero biases, a small output layer."""
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
    """The network of ``phytac_decoder.estimation.cascade_network`` at one vector of parameters, with its derivatives."""

    def __init__(self, flat: FloatArray, x: FloatArray, *, rectified: bool) -> None:
        w, start = {}, 0
        for name, shape in SHAPES.items():
            size = int(np.prod(shape))
            w[name] = flat[start : start + size].reshape(shape)
            start += size
        self.w, self.x, self.rectified = w, x, rectified
        self.first = self._activate(x @ w["w1"].T + w["b1"])
        self.both = np.concatenate([x, self.first], axis=1)
        self.second = self._activate(self.both @ w["w2"].T + w["b2"])
        self.every = np.concatenate([self.both, self.second], axis=1)
        self.value = self.every @ w["w3"][0] + w["b3"][0]

    def _activate(self, values: FloatArray) -> FloatArray:
        return np.maximum(values, 0.0) if self.rectified else values

    def jacobian(self) -> FloatArray:
        """Derivatives (m, 351) of the values by the parameters, by the chain rule."""
        m, out = len(self.x), self.w["w3"][0]
        second = np.broadcast_to(out[INPUTS + HIDDEN :], (m, HIDDEN))
        second = np.where(self.second > 0.0, second, 0.0) if self.rectified else second
        first = out[INPUTS : INPUTS + HIDDEN] + second @ self.w["w2"][:, INPUTS:]
        first = np.where(self.first > 0.0, first, 0.0) if self.rectified else first
        slopes = {
            "w1": first[:, :, None] * self.x[:, None, :],
            "b1": first,
            "w2": second[:, :, None] * self.both[:, None, :],
            "b2": second,
            "w3": self.every,
            "b3": np.ones((m, 1)),
        }
        return np.concatenate([slopes[name].reshape(m, -1) for name in SHAPES], axis=1)


def _fit(training: _Rows, validation: _Rows, first: FloatArray, *, rectified: bool) -> _Fit:
    """One Levenberg-Marquardt run from one start."""

    def residual_N(net: CascadeDerivatives, rows: _Rows) -> FloatArray:
        return np.asarray(net.value * rows.u - rows.goal_N)

    def rms(error: FloatArray) -> float:
        return float(np.sqrt((error**2).mean()))

    def at(flat: FloatArray, rows: _Rows) -> CascadeDerivatives:
        return CascadeDerivatives(flat, rows.x, rectified=rectified)

    flat = first
    net = at(flat, training)
    residual = residual_N(net, training)
    damping, loss = 1e-2, rms(residual)
    best = (rms(residual_N(at(flat, validation), validation)), loss, 0, flat)
    unit = np.eye(parameter_count())
    for step in range(1, ROUNDS_MAX + 1):
        jacobian = net.jacobian() * training.u[:, None]
        gram, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        ridge = (np.trace(gram) / len(flat) + 1e-30) * unit
        improved = False
        for _ in range(8):
            trial = flat - np.linalg.solve(gram + damping * ridge, gradient)
            tried = at(trial, training)
            trial_residual = residual_N(tried, training)
            if rms(trial_residual) < loss:
                flat, net, residual, improved = trial, tried, trial_residual, True
                loss = rms(residual)
                damping = max(damping / 5.0, 1e-9)
                break
            damping = min(damping * 4.0, 1e9)
        error = rms(residual_N(at(flat, validation), validation))
        if error < best[0]:
            best = (error, loss, step, flat)
        if not improved or step - best[2] > PATIENCE:
            break
    return _Fit(
        rmse_validation=best[0],
        rmse_train=best[1],
        rounds=best[2],
        parameters=best[3].copy(),
    )
