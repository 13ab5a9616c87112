"""The linear shell model: constraints, one factorisation, many loads, and a check of the result."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.meshing.mesh_check import check_directors, check_quads
from phytac_design.mechanics.shell.factor import SUPERLU, Factor
from phytac_design.mechanics.shell.shell_element import DRILLING, element_stiffness
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError

__all__ = ["SUPERLU", "ShellModel", "Solution", "clamped_model", "rigid_modes"]
ERROR_TOL = 5e-3
"""Largest rounding error of a solution (estimated, on the safe side) that is returned at all."""
BATCH = 64
"""Right-hand sides per call: enough to amortise reading the factor, few enough to stay in cache."""


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Motion under each load.

    Attributes
    ----------
    motion : (N, 6, m) float
        Translation (mm) and rotation (rad) of every node for each of m loads, global axes.
    reactions : (N, 6, m) float
        Forces (N) and moments (N mm) of the supports on the shell; zero at free DOFs.
    error : float
        Estimated rounding error of the motion, relative, largest over all loads (see
        :class:`factor.Factor`). Discretisation is not part of it.
    """

    motion: FloatArray
    reactions: FloatArray
    error: float


class ShellModel:
    """A clamped or otherwise constrained linear shell.

    Parameters
    ----------
    nodes_mm : (N, 3) float
        Node positions, mm.
    quads : (E, 4) int
        Corners.
    directors : (N, 3) or (E, 4, 3) float
        Unit normals per node, or per element and corner.
    thickness_mm, modulus_MPa : float or (E,) float
        Wall thickness and Young's modulus, one or one per element.
    poisson : float
        Poisson's ratio.
    fixed : (N, 6) bool
        True where a DOF (u_x, u_y, u_z, θ_x, θ_y, θ_z) is held at zero.
    drilling : float
        Stiffness of the drilling tie in shear moduli.

    Raises
    ------
    NumericalError
        If inputs are not finite, an element is degenerate, elements do not form a surface
        (:mod:`meshing.check`), a node belongs to no element, or a rigid motion is left free.
    """

    def __init__(
        self,
        nodes_mm: FloatArray,
        quads: IntArray,
        directors: FloatArray,
        *,
        thickness_mm: float | FloatArray,
        modulus_MPa: float | FloatArray,
        poisson: float,
        fixed: BoolArray,
        drilling: float = DRILLING,
    ) -> None:
        _refuse_bad_numbers(nodes_mm, directors, thickness_mm, modulus_MPa, poisson)
        self.nodes_mm = nodes_mm
        self.quads = quads
        self.directors = directors
        self.thickness_mm, self.modulus_MPa = thickness_mm, modulus_MPa
        self.poisson, self.drilling = poisson, drilling
        self.uniform = np.ndim(thickness_mm) == 0 and np.ndim(modulus_MPa) == 0
        self.fixed = np.asarray(fixed, dtype=np.bool_)
        check_quads(quads, len(nodes_mm))
        self._refuse_loose()
        check_directors(nodes_mm, quads, directors)
        self._pattern = make_pattern(quads, len(nodes_mm))
        self.elements = element_stiffness(
            nodes_mm, quads, directors, poisson=poisson, drilling=drilling
        )
        self.stiffness: Any = assemble(
            self._pattern,
            self.elements.combine(modulus_MPa=modulus_MPa, thickness_mm=thickness_mm),
        )
        """(6N, 6N) scipy.sparse.csc_matrix, N/mm, without constraints."""
        self._free = np.flatnonzero(~self.fixed.ravel())

    @cached_property
    def factor(self) -> Factor:
        """Factor of the free stiffness, made at first use."""
        return Factor(self.stiffness[self._free][:, self._free])

    def condition(self) -> float:
        """Condition number (1-norm, estimated) of the free stiffness scaled to a unit diagonal."""
        return self.factor.condition

    def solve(self, loads: Any) -> Solution:
        """Motion under loads (6N, m), dense or scipy.sparse: forces (N) and moments (N mm).

        Raises
        ------
        NumericalError
            If a load is not finite, or the solution is not in balance with its load.
        """
        dense = np.asarray(loads.toarray() if hasattr(loads, "toarray") else loads, dtype=float)
        dense = dense.reshape(self.fixed.size, -1)
        if not np.all(np.isfinite(dense)):
            row, column = np.argwhere(~np.isfinite(dense))[0]
            raise NumericalError(
                "load-not-finite",
                f"a load is not finite: load {column} has {dense[row, column]:g} at node "
                f"{row // 6}; check the forces handed in",
            )
        motion = np.zeros_like(dense)
        error = 0.0
        for first in range(0, dense.shape[1], BATCH):
            batch = slice(first, first + BATCH)
            motion[self._free, batch], part = self.factor.solve(dense[self._free, batch])
            error = float(np.maximum(error, part))  # keeps NaN
        if not error <= ERROR_TOL:
            raise NumericalError(
                "stiffness-ill-conditioned",
                f"rounding errors are too large (relative error about {error:.2g}, limit "
                f"{ERROR_TOL:g}): the stiffness is close to singular; check that the shell is "
                "held and that thickness over element size is not far below 1e-4",
            )
        reactions = self.stiffness @ motion - dense
        reactions[self._free] = 0.0
        shape = (len(self.nodes_mm), 6, dense.shape[1])
        return Solution(
            motion=motion.reshape(shape), reactions=reactions.reshape(shape), error=error
        )

    def _refuse_loose(self) -> None:
        """Refuse nodes without elements, and bodies that can move rigidly."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        count = len(self.nodes_mm)
        if self.fixed.shape != (count, 6):
            raise NumericalError(
                "fixed-flags-shape",
                f"fixed must have one flag per DOF, ({count}, 6) (got {self.fixed.shape})",
            )
        used = np.zeros(count, dtype=np.bool_)
        used[self.quads] = True
        lonely = ~used & ~self.fixed.all(axis=1)
        if np.any(lonely):
            raise NumericalError(
                "node-without-element",
                f"node {int(np.argmax(lonely))} belongs to no element ({int(lonely.sum())} in "
                "all) and is free; remove it from the mesh or hold it",
            )
        ring = np.roll(self.quads, -1, axis=1)
        links = coo_matrix(
            (np.ones(self.quads.size), (self.quads.ravel(), ring.ravel())), shape=(count, count)
        )
        bodies, label = connected_components(links, directed=False)
        for body in range(bodies):
            mine = label == body
            if used[mine].any() and _rigid_rank(self.nodes_mm[mine], self.fixed[mine]) < 6:
                raise NumericalError(
                    "shell-not-held",
                    f"the shell is not held: a body of {int(mine.sum())} nodes can move rigidly "
                    f"(constraints block {_rigid_rank(self.nodes_mm[mine], self.fixed[mine])} of "
                    "6 motions); fix a rim or add supports",
                )


def clamped_model(
    mesh: ShellMesh,
    *,
    modulus_MPa: float | FloatArray,
    poisson: float,
    thickness_mm: float | FloatArray | None = None,
) -> ShellModel:
    """Model of a sensor shell: every open edge clamped in all six DOFs.

    ``thickness_mm`` (scalar or (E,)) replaces the mesh's own thickness, e.g. for a unit whose
    wall varies.
    """
    fixed = np.zeros((len(mesh.nodes_mm), 6), dtype=np.bool_)
    fixed[mesh.clamped] = True
    return ShellModel(
        mesh.nodes_mm,
        mesh.quads,
        mesh.normals,
        thickness_mm=mesh.thickness_mm if thickness_mm is None else thickness_mm,
        modulus_MPa=modulus_MPa,
        poisson=poisson,
        fixed=fixed,
    )


def rigid_modes(nodes_mm: FloatArray) -> FloatArray:
    """Six rigid motions of a body, (N, 6, 6): [node, DOF, mode]; turns are of 1/size rad."""
    arm = nodes_mm - nodes_mm.mean(axis=0)
    size = float(np.abs(arm).max()) or 1.0
    modes = np.zeros((len(nodes_mm), 6, 6))
    modes[:, :3, :3] = np.eye(3)
    for axis in range(3):
        modes[:, :3, 3 + axis] = np.cross(np.eye(3)[axis], arm / size)
        modes[:, 3 + axis, 3 + axis] = 1.0 / size
    return modes


def _rigid_rank(nodes_mm: FloatArray, fixed: BoolArray) -> int:
    modes = rigid_modes(nodes_mm)
    modes[:, 3:] /= np.abs(modes[:, 3:]).max()  # the scale of a rotation does not matter here
    held = modes[fixed]
    return int(np.linalg.matrix_rank(held.T @ held, tol=1e-12)) if len(held) else 0


def _refuse_bad_numbers(
    nodes_mm: FloatArray,
    directors: FloatArray,
    thickness_mm: float | FloatArray,
    modulus_MPa: float | FloatArray,
    poisson: float,
) -> None:
    for label, value, low in (
        ("node coordinates", nodes_mm, -np.inf),
        ("directors", directors, -np.inf),
        ("thickness_mm", thickness_mm, 0.0),
        ("modulus_MPa", modulus_MPa, 0.0),
    ):
        array = np.asarray(value)
        if not (np.all(np.isfinite(array)) and np.all(array > low)):
            raise NumericalError(
                "material-value-invalid",
                f"{label} must be finite{'' if low else ' and positive'} "
                f"(least value {np.min(array):g}, {int((~np.isfinite(array)).sum())} not finite); "
                "correct the model's input",
            )
    if not 0.0 <= poisson < 0.5:
        raise NumericalError(
            "poisson-out-of-range", f"poisson must lie in [0, 0.5) (got {poisson!r})"
        )
