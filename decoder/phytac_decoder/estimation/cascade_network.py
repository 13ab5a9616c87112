"""The paper's cascade-forward network, 10-10-10-1: 351 parameters, run in numpy."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray

Activation = Literal["rectified", "identity"]
Base = Literal["stiffness", "key_nodes"]
BASES: tuple[str, ...] = get_args(Base)
ACTIVATIONS: tuple[str, ...] = get_args(Activation)
INPUTS, HIDDEN = 10, 10
FADE = 1.0
"""A network's stiffness fades to 0 over this share of the range of an input beyond it."""
SHAPES: dict[str, tuple[int, ...]] = {
    "w1": (HIDDEN, INPUTS),
    "b1": (HIDDEN,),
    "w2": (HIDDEN, INPUTS + HIDDEN),
    "b2": (HIDDEN,),
    "w3": (1, INPUTS + 2 * HIDDEN),
    "b3": (1,),
}
"""Every layer sees all earlier ones (cascade-forward): 110 + 210 + 31 = 351 parameters."""


@dataclass(frozen=True, kw_only=True)
class CascadeNetwork:
    """Augmented local stiffness k = g(u of node and 8 neighbours, z) (paper, eq. 2).

    Attributes
    ----------
    parameters : (351,) float
        Flattened weights in the order of ``SHAPES``.
    activation : str
        ``rectified`` (the paper's "linear unit" read as rectified linear) or ``identity`` (the
        literal reading, which makes the network affine).
    scale_in : (10,) float
        Inputs are divided by this (mm).
    scale_out : float
        Output is multiplied by this (N/mm).
    base : str
        Force that k·u is added to: K·U over all nodes (``stiffness``, all networks up to schema
        1.15), or the forces on key nodes alone that explain the shifts of all markers best
        (``key_nodes``).
    low, high : (10,) float, optional
        Least and largest inputs that it learnt from, mm; k fades to 0 within ``FADE`` of that range
        beyond. None: everywhere.
    """

    parameters: FloatArray
    activation: Activation
    scale_in: FloatArray
    scale_out: float
    base: Base = "stiffness"
    low: FloatArray | None = None
    high: FloatArray | None = None

    def layers(self) -> Mapping[str, FloatArray]:
        """Return the weights by name."""
        return layers_of(self.parameters)

    def __call__(self, features: FloatArray) -> FloatArray:
        """Return the stiffness k (m,) in N/mm for features (m, 10) in mm."""
        rectified = self.activation == "rectified"
        k = forward(self.layers(), features / self.scale_in, rectified=rectified)[1]
        return np.asarray(self.learnt(features) * k * self.scale_out)

    def learnt(self, features: FloatArray) -> FloatArray:
        """Share (m,) of k that counts: 1 for features (m, 10) mm as learnt, 0 far beyond them."""
        if self.low is None or self.high is None:
            return np.ones(len(features))
        beyond = np.abs(features - np.clip(features, self.low, self.high)) / fade_mm(
            self.low, self.high
        )
        return np.asarray(1.0 - np.minimum(beyond.max(axis=1), 1.0))


def fade_mm(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return how far (10,) beyond the range of its inputs a network's stiffness is 0."""
    return np.asarray(np.maximum(FADE * (high - low), 1e-9))


def forward(
    w: Mapping[str, FloatArray], x: FloatArray, *, rectified: bool
) -> tuple[FloatArray, FloatArray]:
    """Return all inputs of the last layer (m, 30), x and both hidden layers, and the output (m,).

    Parameters
    ----------
    w : mapping
        Weights by name.
    x : (m, 10) float
        Scaled inputs.
    rectified : bool
        Whether the hidden layers are.
    """
    every = x
    for weight, bias in (("w1", "b1"), ("w2", "b2")):
        hidden = every @ w[weight].T + w[bias]
        every = np.concatenate([every, np.maximum(hidden, 0.0) if rectified else hidden], axis=1)
    return every, np.asarray(every @ w["w3"][0] + w["b3"][0])


def layers_of(parameters: FloatArray) -> dict[str, FloatArray]:
    """Return the weights by name, from all parameters (351,)."""
    out, start = {}, 0
    for name, shape in SHAPES.items():
        size = int(np.prod(shape))
        out[name] = parameters[start : start + size].reshape(shape)
        start += size
    return out


def parameter_count() -> int:
    """Return the number of parameters, 351 as in the paper."""
    return int(sum(np.prod(shape) for shape in SHAPES.values()))


def network_features(
    apparent_mm: FloatArray, neighbours: IntArray, height_z_mm: FloatArray, koi: IntArray
) -> FloatArray:
    """Return nn_i = [u_i, u of eight neighbours, z_i] of key nodes, (m, 10) mm (paper, eq. 2).

    A neighbour beyond a rim is on the clamped rim, as in the mechanics: its displacement is zero.
    At the seam of a closed surface neighbours wrap around.
    """
    padded = np.append(apparent_mm, 0.0)
    return np.column_stack([apparent_mm[koi], padded[neighbours[koi]], height_z_mm[koi]])
