"""Forces and tangent products of a shell, and solves with its stiffness at rest."""

from typing import Any

import numpy as np

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.corotational import Configuration
from phytac_design.mechanics.large.element_forces import ElementForces
from phytac_design.mechanics.shell.solve import SUPERLU, ShellModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SINGLE_PRECISION_ERROR = 1e-3
"""Error, in the norm of K₀, up to which a factor in single precision is used."""
DIFFERENCE_ROTATION_rad = 1e-5
"""Largest turn in the differences that stand for a product with the tangent, rad."""
TINY = 1e-300


class ReferenceShell:
    """Internal forces, products with the tangent and K₀⁻¹ of one shell; built once.

    Motion is (6N,): translations (mm) and rotation vectors (rad). Forces are zero where the shell
    is held.

    Parameters
    ----------
    model : ShellModel
        The shell.

    Attributes
    ----------
    held : (6N,) bool
        DOFs that are held.
    """

    def __init__(self, model: ShellModel) -> None:
        self.model = model
        self.held: BoolArray = model.fixed.ravel()
        self._free: IntArray = np.flatnonzero(~self.held)
        self._elastic = ElementForces(model)
        self._extent = float(np.ptp(model.nodes_mm, axis=0).max())
        self._random = np.zeros(model.fixed.size)
        self._random[self._free] = np.random.default_rng(0).normal(size=len(self._free))
        self._random[self._free] /= model.factor.scale
        self._single: Any = None
        self._single = self._single_precision_factor()

    def _single_precision_factor(self) -> Any:
        """Factor in single precision, read in half the time; None where it is too coarse.

        A coarse K₀⁻¹ slows an iteration, but does not shift where it ends.
        """
        from scipy.sparse.linalg import splu

        push, stirred = self._random, self.solve_reference(self._random[:, None])[:, 0]
        try:
            self._single = splu(self.model.factor.scaled.astype(np.float32), **SUPERLU)
        except RuntimeError:
            return None
        off = self.solve_reference(push[:, None])[:, 0] - stirred
        gap = float(np.sqrt(max(float(off @ self.reference_force(off)), 0.0)))
        return (
            self._single if gap <= SINGLE_PRECISION_ERROR * float(np.sqrt(stirred @ push)) else None
        )

    def random_force(self, motion: FloatArray) -> FloatArray:
        """Random forces (6N,), the same each time, where the shell moves and turns most.

        What softens is stressed, and what is stressed moves or turns.
        """
        parts = motion.reshape(-1, 2, 3)
        square = np.sum(parts * parts, axis=2)
        weight = np.sum(square / np.maximum(square.max(axis=0), TINY), axis=1)
        return np.asarray(self._random * np.repeat(weight, 6))

    def solve_reference(self, forces: FloatArray) -> FloatArray:
        """K₀⁻¹ times forces (6N, k), for iterations: in single precision where that suffices."""
        factor = self.model.factor
        right = factor.scale[:, None] * forces[self._free]
        if self._single is None:
            found = factor.backend.solve(right)
        else:
            size = np.maximum(np.abs(right).max(axis=0), TINY)
            found = size * self._single.solve((right / size).astype(np.float32))
        out = np.zeros_like(forces)
        out[self._free] = factor.scale[:, None] * found
        return out

    def reference_force(self, motion: FloatArray) -> FloatArray:
        """K₀x (6N,)."""
        out = np.asarray(self.model.stiffness @ motion)
        out[self.held] = 0.0
        return out

    def internal(self, motion: FloatArray) -> FloatArray:
        """Internal forces (6N,) on spins.

        Raises
        ------
        NumericalError
            If an element is distorted beyond what it can describe.
        """
        return self._forces(_state(motion))

    def _forces(self, state: Configuration) -> FloatArray:
        out = self._elastic.internal(state)
        out[self.held] = 0.0
        return out

    def tangent_product(
        self, motion: FloatArray, internal: FloatArray, along: FloatArray
    ) -> FloatArray:
        """Tangent at ``motion``, with the internal forces there, times spins ``along``."""
        step = DIFFERENCE_ROTATION_rad / self.motion_size(along)
        return (self._forces(_state(motion).moved(step * along)) - internal) / step

    def motion_size(self, motion: FloatArray) -> float:
        """Largest rotation (rad), or translation over the shell's size."""
        parts = np.abs(motion.reshape(-1, 6))
        return max(float(parts[:, 3:].max()), float(parts[:, :3].max()) / self._extent, TINY)

    def force_norm(self, force: FloatArray) -> float:
        """Norm of forces, scaled so that forces and moments compare."""
        return float(np.linalg.norm(self.model.factor.scale * force[self._free]))


def _state(motion: FloatArray) -> Configuration:
    parts = motion.reshape(-1, 6)
    return Configuration(
        displacement_mm=parts[:, :3].copy(), quaternion=rot.exponential(parts[:, 3:])
    )
