"""Buckling out of the axisymmetric shape: the tangent against waves cos nθ around the axis.

On an axisymmetric path the second variation splits exactly into the waves n = 0, 1, 2, …; a
negative eigenvalue at n ≥ 1 means that the body leaves the axisymmetric path there, with n waves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phytac_design.mechanics.large.stability import negative_pivots
from phytac_design.mechanics.shell.factor import SUPERLU
from phytac_design.mechanics.switch import axisymmetric_element
from phytac_design.mechanics.switch.model import HELD, AxiModel, AxiPattern
from phytac_design.mechanics.switch.switch_path import PathPoint
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class CircumferentialModes:
    """Tangents of one body for waves around the axis.

    Attributes
    ----------
    model : AxiModel
        The axisymmetric body.
    """

    model: AxiModel
    _patterns: dict[int, AxiPattern] = field(default_factory=dict, init=False, repr=False)

    def equations(self, mode: int) -> tuple[IntArray, FloatArray]:
        """Equation and sign of u_r, u_z, u_θ of all nodes, (N, 3) each.

        On the axis only n = 1 moves: all of it sideways, u_r = −u_θ.
        """
        nodes = self.model.mesh.nodes_mm
        held = np.zeros((len(nodes), 3), dtype=bool)
        held[:, :2] = self.model.held
        # A node held in the plane of the section is held around too: clamped edges are.
        held[:, 2] = self.model.held.all(axis=1)
        # The pad keeps its height all around: the finger on it does not tilt.
        held[self.model.tied, 1] = True
        axis = self.model.mesh.where(nodes[:, 0])
        held[axis, 1] = True
        if mode > 1:
            held[axis] = True
        number, sign = np.full(held.shape, HELD), np.ones(held.shape)
        free = ~held
        if mode == 1:
            free[axis, 2] = False
        number[free] = np.arange(free.sum())
        if mode == 1:
            number[axis, 2] = number[axis, 0]
            sign[axis, 2] = -1.0
        return number, sign

    def tangent(self, point: PathPoint, mode: int) -> Any:
        """Sparse tangent for ``mode`` ≥ 1 waves at an equilibrium (over π instead of 2 π)."""
        shape = self.model.geometry
        response = point.state.response
        blocks = axisymmetric_element.tangent(
            shape, self.model.material, axisymmetric_element.strain_operator(shape, mode), response
        ) + axisymmetric_element.shear_tangent(
            shape, axisymmetric_element.shear_operator(shape, mode), response
        )
        return self._pattern(mode).matrix(0.5 * blocks)

    def _pattern(self, mode: int) -> AxiPattern:
        """Where the entries of ``mode`` go: the same at all points."""
        if mode not in self._patterns:
            number, sign = self.equations(mode)
            quads = self.model.mesh.quads
            where = np.concatenate([number[quads, axis] for axis in range(3)], axis=1)
            signs = np.concatenate([sign[quads, axis] for axis in range(3)], axis=1)
            self._patterns[mode] = AxiPattern(where, int(number.max()) + 1, signs)
        return self._patterns[mode]

    def negatives(self, point: PathPoint, mode: int) -> int:
        """Negative eigenvalues for ``mode`` waves at an equilibrium."""
        from scipy.sparse.linalg import splu

        matrix = self.tangent(point, mode)
        try:
            found = negative_pivots(splu(matrix, **SUPERLU), matrix)
        except RuntimeError:
            found = None
        if found is None:
            dense = matrix.toarray()
            found = int(np.sum(np.linalg.eigvalsh(0.5 * (dense + dense.T)) < 0.0))
        return found


def first_buckling(
    model: AxiModel,
    points: Sequence[PathPoint],
    *,
    modes: Sequence[int] = (1, 2, 3, 4, 5, 6),
) -> dict[int, int]:
    """First point of a path at which each wave number is unstable; only those that are."""
    waves = CircumferentialModes(model=model)
    found: dict[int, int] = {}
    for mode in modes:
        for index, point in enumerate(points):
            if waves.negatives(point, mode):
                found[mode] = index
                break
    return found
