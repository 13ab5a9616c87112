"""Training of the FEM-NN with Levenberg-Marquardt. The only module here that imports torch."""

import time
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch.func import jacrev, vmap

from decoder.network import HIDDEN, INPUTS, SHAPES, Activation, CascadeNetwork
from shapes.arrays import FloatArray, IntArray
from shapes.errors import InputError

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
class Trained:
    """A trained network, how long it took, and its errors in newtons (root mean square)."""

    network: CascadeNetwork
    seconds: float
    rounds: int
    rmse_train_N: float
    rmse_validation_N: float


def _cascade(flat: torch.Tensor, x: torch.Tensor, *, rectified: bool) -> torch.Tensor:
    """The network of ``decoder.network`` on one flat vector, so that its Jacobian is a matrix."""
    w, start = {}, 0
    for name, shape in SHAPES.items():
        size = int(np.prod(shape))
        w[name] = flat[start : start + size].reshape(shape)
        start += size
    first = w["w1"] @ x + w["b1"]
    first = torch.relu(first) if rectified else first
    both = torch.cat([x, first])
    second = w["w2"] @ both + w["b2"]
    second = torch.relu(second) if rectified else second
    return (w["w3"] @ torch.cat([both, second]) + w["b3"])[0]


def split_samples(count: int, *, seed: int) -> tuple[IntArray, IntArray, IntArray]:
    """Shuffle sample indices into 85 % training, 5 % validation and 10 % test (the paper's)."""
    order = np.random.default_rng(seed).permutation(count)
    first, second = round(0.85 * count), round(0.90 * count)
    return order[:first], order[first:second], order[second:]


def train_network(
    training: KeyNodeData, validation: KeyNodeData, *, activation: Activation, seed: int
) -> Trained:
    """Fit k = g(nn) so that (K·U)_i + k_i·u_i matches the true force (paper, eq. 2 and 3).

    The label k_i = (F_i - (K·U)_i) / u_i is never formed: it is undefined as u → 0. The loss is
    the force error itself, in which k enters only as k_i·u_i, so that a node that hardly moves
    has hardly a say. Levenberg-Marquardt on all parameters; the parameters of the round with the
    least validation error are kept.

    Raises
    ------
    InputError
        If there are too few key nodes to learn from.
    """
    if len(training.force_N) < INPUTS + 1 or len(validation.force_N) < 1:
        raise InputError(
            f"{len(training.force_N)} key nodes in the training data and "
            f"{len(validation.force_N)} in the validation data are too few; simulate more "
            "contacts (training.samples) or stronger ones"
        )
    # Matrices are small: a second thread costs more than it gives, most of all on a busy machine.
    torch.set_num_threads(1)
    begin = time.perf_counter()
    scale_in = np.full(INPUTS, max(float(np.abs(training.features[:, :9]).std()), 1e-9))
    scale_in[9] = max(float(np.abs(training.features[:, 9]).max()), 1e-9)
    u = np.abs(training.apparent_mm)
    scale_out = float(np.abs(training.force_N).mean() / max(float(u.mean()), 1e-9))
    scaled = _Scaled(training, validation, scale_in, scale_out)
    fits = [_fit(scaled, activation, seed + restart) for restart in range(RESTARTS)]
    best = min(fits, key=lambda fit: fit.rmse_validation)
    return Trained(
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


class _Scaled:
    """Training and validation rows as tensors: inputs, u times the output scale, goal in N."""

    def __init__(
        self, training: KeyNodeData, validation: KeyNodeData, scale: FloatArray, out: float
    ) -> None:
        def tensors(data: KeyNodeData) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
            return (
                torch.from_numpy(data.features / scale),
                torch.from_numpy(data.apparent_mm * out),
                torch.from_numpy(data.force_N - data.stiffness_force_N),
            )

        self.training = tensors(training)
        self.validation = tensors(validation)


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Result of one start."""

    rmse_validation: float
    rmse_train: float
    rounds: int
    parameters: FloatArray


def _initial(seed: int) -> torch.Tensor:
    """He-scaled normal weights, zero biases, a small output layer."""
    generator = torch.Generator().manual_seed(seed)
    parts = []
    for name, shape in SHAPES.items():
        if name.startswith("b"):
            parts.append(torch.zeros(shape, dtype=torch.float64).flatten())
            continue
        gain = (2.0 / shape[1]) ** 0.5 * (0.1 if shape[0] != HIDDEN else 1.0)
        noise = torch.randn(shape, generator=generator, dtype=torch.float64)
        parts.append((gain * noise).flatten())
    return torch.cat(parts)


def _fit(data: _Scaled, activation: Activation, seed: int) -> _Fit:
    """One Levenberg-Marquardt run from one start."""
    single = partial(_cascade, rectified=activation == "rectified")
    values = vmap(single, in_dims=(None, 0))
    slopes = vmap(jacrev(single), in_dims=(None, 0))

    def rms(flat: torch.Tensor, rows: tuple[torch.Tensor, torch.Tensor, torch.Tensor]) -> float:
        x, u, goal = rows
        return float(((values(flat, x) * u - goal) ** 2).mean().sqrt())

    x, u, goal = data.training
    flat = _initial(seed)
    damping, loss = 1e-2, rms(flat, data.training)
    best = (rms(flat, data.validation), loss, 0, flat)
    for step in range(1, ROUNDS_MAX + 1):
        residual = values(flat, x) * u - goal
        jacobian = slopes(flat, x) * u[:, None]
        gram, gradient = jacobian.T @ jacobian, jacobian.T @ residual
        ridge = (gram.diagonal().mean() + 1e-30) * torch.eye(len(flat), dtype=flat.dtype)
        improved = False
        for _ in range(8):
            trial = flat - torch.linalg.solve(gram + damping * ridge, gradient)
            trial_loss = rms(trial, data.training)
            if trial_loss < loss:
                flat, loss, improved = trial, trial_loss, True
                damping = max(damping / 5.0, 1e-9)
                break
            damping = min(damping * 4.0, 1e9)
        error = rms(flat, data.validation)
        if error < best[0]:
            best = (error, loss, step, flat)
        if not improved or step - best[2] > PATIENCE:
            break
    return _Fit(
        rmse_validation=best[0],
        rmse_train=best[1],
        rounds=best[2],
        parameters=best[3].numpy().copy(),
    )
