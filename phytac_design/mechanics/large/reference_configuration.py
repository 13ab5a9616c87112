"""A shell from its state at rest: forces, tangent products, solves, Koiter's expansion."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.corotational import Configuration, Corotational
from phytac_design.mechanics.large.free_block import FreeBlock
from phytac_design.mechanics.large.shared_solves import shared, side_by_side
from phytac_design.mechanics.large.stability import negative_pivots
from phytac_design.mechanics.shell.solve import SUPERLU, ShellModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

T = TypeVar("T")
_FACTORING = threading.Lock()
"""Load cases that are solved together factor their tangents one after the other: for memory, and
because the matrix is one."""


@dataclass(frozen=True, kw_only=True)
class Expansion:
    """Terms (6N,) of the motion f·x₁ + f²·x₂ + f³·x₃ under f loads, and the relative error of x₁.

    Attributes
    ----------
    first, second, third : (6N,) float
        x₁, x₂, x₃: mm and rotation vectors.
    error : float
        Largest translation of x₂ + x₃ over that of x₁: how far linear theory is off. Shown within
        a factor of 2 of the truth up to errors of 0.5 (``benchmarks/mechanics``); beyond, large
        displacement is certain but the figure is not.
    """

    first: FloatArray
    second: FloatArray
    third: FloatArray

    @property
    def error(self) -> float:
        """See the class."""
        off = largest_translation(self.second + self.third)
        return off / max(largest_translation(self.first), 1e-300)


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
        self._elastic = Corotational(model)
        self._extent = float(np.ptp(model.nodes_mm, axis=0).max())
        self._random = np.zeros(model.fixed.size)
        self._random[self._free] = np.random.default_rng(0).normal(size=len(self._free))
        self._random[self._free] /= model.factor.scale

    def random_force(self, motion: FloatArray) -> FloatArray:
        """Random forces (6N,), the same each time, where the shell moves and turns most.

        What softens is stressed, and what is stressed moves or turns.
        """
        parts = motion.reshape(-1, 2, 3)
        square = np.sum(parts * parts, axis=2)
        weight = np.sum(square / np.maximum(square.max(axis=0), 1e-300), axis=1)
        return np.asarray(self._random * np.repeat(weight, 6))

    def solve_reference(self, forces: FloatArray) -> FloatArray:
        """K₀⁻¹ times forces (6N,); in :meth:`together` with those of others."""
        return shared(self._solve, forces)

    def together(self, tasks: Sequence[Callable[[], T]]) -> list[T]:
        """Return the results of tasks, whose solves with the factor at rest are done together."""
        return side_by_side(self._solve, tasks)

    def _solve(self, forces: FloatArray) -> FloatArray:
        """K₀⁻¹ times forces (6N,) or (6N, c)."""
        factor = self.model.factor
        scale = factor.scale if forces.ndim == 1 else factor.scale[:, None]
        out = np.zeros_like(forces)
        out[self._free] = scale * factor.backend.solve(scale * forces[self._free])
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
        # Largest turn in the differences, rad: error and rounding both below 1e-5.
        step = 1e-5 / self.motion_size(along)
        return (self._forces(_state(motion).moved(step * along)) - internal) / step

    @cached_property
    def _block(self) -> FreeBlock:
        return FreeBlock(self.model)

    def is_firmer(self, motion: FloatArray, share: float) -> bool:
        """Whether all eigenvalues of K₀⁻¹K_t at a motion (6N,) are above ``share``.

        By Sylvester's law, from the pivots of K_t − share · K₀: tangent and factor take as long as
        some 40 products with the tangent.
        """
        from scipy.sparse.linalg import splu

        with _FACTORING:
            tangent = self._elastic.tangent(self._elastic.local(_state(motion)))
            entries = 0.5 * (tangent.data + tangent.T.tocsc().data)
            matrix = self._block.scaled(entries - share * self.model.stiffness.data)
            try:
                return negative_pivots(splu(matrix, **SUPERLU), matrix) == 0
            except RuntimeError:
                return False

    def expand(self, first: FloatArray, force: FloatArray) -> Expansion:
        r"""Koiter's expansion, with the load factor as parameter, from linear motion and its load.

        With the internal forces f_int(x) = K x + Q(x) + C(x) + …, quadratic and cubic parts taken
        by central differences along x₁::

            x₂ = −K⁻¹ Q(x₁)      x₃ = −K⁻¹ [cubic part of f_int(ε x₁ + ε² x₂)]
        """
        step, grown = self._difference_step(first)
        aside = self.solve_reference(-(self.internal(step) + self.internal(-step)) / 2.0)
        odd = (self.internal(aside + step) - self.internal(aside - step)) / 2.0
        third = self.solve_reference(force / grown - odd)
        return Expansion(first=first, second=grown**2 * aside, third=grown**3 * third)

    def softened(self, first: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Product with K₀ + K_σ(x₁), the tangent of linear buckling theory."""
        step, grown = self._difference_step(first)
        internal = self.internal(step)

        def product(along: FloatArray) -> FloatArray:
            image = self.reference_force(along)
            change = self.tangent_product(step, internal, along) - image
            return np.asarray(image + grown * change)

        return product

    def _difference_step(self, first: FloatArray) -> tuple[FloatArray, float]:
        """A short motion along x₁, and x₁ over it."""
        # Its largest rotation, or translation over the shell's size, is 0.01.
        grown = self.motion_size(first) / 0.01
        return first / grown, grown

    def motion_size(self, motion: FloatArray) -> float:
        """Largest rotation (rad), or translation over the shell's size."""
        parts = np.abs(motion.reshape(-1, 6))
        return max(float(parts[:, 3:].max()), float(parts[:, :3].max()) / self._extent, 1e-300)

    def force_norm(self, force: FloatArray) -> float:
        """Norm of forces, scaled so that forces and moments compare."""
        return float(np.linalg.norm(self.model.factor.scale * force[self._free]))


def _state(motion: FloatArray) -> Configuration:
    parts = motion.reshape(-1, 6)
    return Configuration(
        displacement_mm=parts[:, :3].copy(), quaternion=rot.exponential(parts[:, 3:])
    )


def largest_translation(motion: FloatArray) -> float:
    """Largest translation of a node, mm."""
    return float(np.linalg.norm(motion.reshape(-1, 6)[:, :3], axis=1).max())
