"""A solid of revolution with supports and ties: its forces and tangent in the free unknowns."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from phytac_design.mechanics.switch import axisymmetric_element
from phytac_design.mechanics.switch.bowl_mesh import AxiMesh
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError

HELD = -1
"""Equation number of a DOF that does not move."""


class AxiPattern:
    """Where the entries of element matrices go in a sparse one; summed again and again.

    Parameters
    ----------
    equations : (E, k) int
        Equation of each element DOF, ``HELD`` for none.
    count : int
        Number of equations.
    sign : (E, k) float, optional
        Factor of the unknown in each DOF.
    """

    def __init__(self, equations: IntArray, count: int, sign: FloatArray | None = None) -> None:
        rows = np.repeat(equations[:, :, None], equations.shape[1], axis=2)
        columns = np.swapaxes(rows, 1, 2)
        self.free = (rows != HELD) & (columns != HELD)
        key = columns[self.free] * count + rows[self.free]
        kept, self.place = np.unique(key, return_inverse=True)
        self.indices = (kept % count).astype(np.int32)
        self.indptr = np.searchsorted(kept, np.arange(count + 1) * count).astype(np.int32)
        self.count = count
        self.sign = sign

    def matrix(self, blocks: FloatArray) -> Any:
        """Sum of element matrices (E, k, k) as a scipy.sparse.csc_matrix."""
        from scipy.sparse import csc_matrix

        if self.sign is not None:
            blocks = self.sign[:, :, None] * blocks * self.sign[:, None, :]
        data = np.bincount(self.place, weights=blocks[self.free], minlength=len(self.indices))
        return csc_matrix((data, self.indices, self.indptr), shape=(self.count, self.count))


def summed(where: IntArray, values: FloatArray, size: int) -> FloatArray:
    """Sums (size,) of values (n,) that share a place (n,)."""
    return np.asarray(np.bincount(where, weights=values, minlength=size), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class AxiModel:
    """A body, its material, what is held and what moves as one.

    Attributes
    ----------
    mesh : AxiMesh
        The undeformed section.
    material : Material
        Of all elements.
    held : (N, 2) bool
        DOFs (u_r, u_z) that do not move; on the axis u_r is held in any case.
    tied : (m,) int
        Nodes whose u_z is one unknown (a rigid flat footprint without friction); may be empty.
    """

    mesh: AxiMesh
    material: Material
    held: BoolArray
    tied: IntArray

    @cached_property
    def geometry(self) -> axisymmetric_element.Geometry:
        """Of all elements."""
        return axisymmetric_element.geometry(self.mesh.nodes_mm, self.mesh.quads)

    @cached_property
    def equation(self) -> IntArray:
        """Equation number of u_r, u_z of all nodes, (2N,)."""
        held = self.held.copy()
        held[self.mesh.where(self.mesh.nodes_mm[:, 0]), 0] = True
        number = np.full(held.size, HELD)
        free = ~held.ravel()
        if len(self.tied):
            free[2 * self.tied[1:] + 1] = False
        number[free] = np.arange(free.sum())
        if len(self.tied):
            number[2 * self.tied + 1] = number[2 * self.tied[0] + 1]
        return number

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return int(self.equation.max()) + 1

    @cached_property
    def element_dofs(self) -> IntArray:
        """DOFs 2·node + axis of all elements, u_r of nine nodes before u_z, (E, 18)."""
        quads = self.mesh.quads
        return np.concatenate([2 * quads, 2 * quads + 1], axis=1)

    @cached_property
    def _pattern(self) -> AxiPattern:
        return AxiPattern(self.equation[self.element_dofs], self.count)

    @cached_property
    def _operator(self) -> FloatArray:
        return axisymmetric_element.strain_operator(self.geometry)

    def full(self, unknowns: FloatArray) -> FloatArray:
        """Displacements (N, 2), mm, of unknowns (n,)."""
        padded = np.append(unknowns, 0.0)
        return padded[self.equation].reshape(-1, 2)

    def reduced(self, nodal: FloatArray) -> FloatArray:
        """Sum of nodal forces (N, 2) on each unknown, (n,)."""
        free = self.equation != HELD
        return summed(self.equation[free], nodal.ravel()[free], self.count)

    def state(self, unknowns: FloatArray) -> "State | None":
        """Forces and tangent at unknowns (n,); None where an element turns inside out."""
        moved = self.full(unknowns).ravel()[self.element_dofs]
        found = axisymmetric_element.force_and_stiffness(
            self.geometry, self.material, self._operator, moved
        )
        if found is None:
            return None
        force, stiffness, response = found
        where, size = self.element_dofs.ravel(), len(self.equation)
        nodal = summed(where, force.ravel(), size)
        gross = summed(where, np.abs(force).ravel(), size)
        return State(
            force=self.reduced(nodal.reshape(-1, 2)),
            gross_N=float(np.linalg.norm(gross)),
            reaction_N=nodal.reshape(-1, 2),
            tangent=self._pattern.matrix(stiffness),
            response=response,
        )

    def node_unknown(self, node: int, axis: int) -> int:
        """Unknown of a node's u_r (0) or u_z (1).

        Raises
        ------
        NumericalError
            If it is held.
        """
        number = int(self.equation[2 * node + axis])
        if number == HELD:
            raise NumericalError(
                "switch-node-held",
                f"node {node} of the switch's mesh is held in axis {axis}; load or follow a node "
                "that moves",
            )
        return number


@dataclass(frozen=True, kw_only=True)
class State:
    """Inner forces and tangent at one shape of the body.

    Attributes
    ----------
    force : (n,) float
        Inner forces on the unknowns, N.
    gross_N : float
        Norm of the sums of absolute element forces: the scale of rounding.
    reaction_N : (N, 2) float
        Inner forces on all nodes.
    tangent : scipy.sparse.csc_matrix, (n, n)
        Slope of ``force``.
    response : element.Response
        Stretches, stresses and stiffness at the Gauss points.
    """

    force: FloatArray
    gross_N: float
    reaction_N: FloatArray
    tangent: Any
    response: axisymmetric_element.ElementResponse
