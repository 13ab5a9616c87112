"""The linear shell model: constraints, one factorisation, many loads, and a check of the result."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.meshing.mesh_check import (
    check_directors,
    check_distortion,
    check_quads,
)
from phytac_design.mechanics.shell.factor import SUPERLU, Factor
from phytac_design.mechanics.shell.shell_element import DRILLING, element_stiffness
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError

__all__ = ["SUPERLU", "ShellModel", "Solution", "clamped_model"]


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
        (:mod:`meshing.mesh_check`), or fewer than six DOFs are held. Another rigid motion that is
        left free is found at the first solution: its rounding error is too large.
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
        if not 0.0 <= poisson < 0.5:
            raise NumericalError(
                "poisson-out-of-range", f"poisson must lie in [0, 0.5) (got {poisson!r})"
            )
        for label, value, low in (
            ("node coordinates", nodes_mm, -np.inf),
            ("thickness_mm", thickness_mm, 0.0),
            ("modulus_MPa", modulus_MPa, 0.0),
        ):
            sound = np.isfinite(value) & (np.asarray(value) > low)
            if not np.all(sound):
                raise NumericalError(
                    "material-value-invalid",
                    f"{label} must be finite{'' if low else ' and positive'}: "
                    f"{np.sum(~sound)} of {np.size(value)} are not; correct the model's input",
                )
        self.nodes_mm = nodes_mm
        self.quads = quads
        self.directors = directors
        self.thickness_mm, self.modulus_MPa = thickness_mm, modulus_MPa
        self.poisson, self.drilling = poisson, drilling
        self.uniform = np.ndim(thickness_mm) == 0 and np.ndim(modulus_MPa) == 0
        self.fixed = np.asarray(fixed, dtype=np.bool_)
        check_quads(quads, len(nodes_mm))
        if np.count_nonzero(self.fixed) < 6:
            raise NumericalError(
                "shell-not-held",
                f"the shell is not held: {np.count_nonzero(self.fixed)} of its DOFs are fixed, "
                "where 6 motions must be blocked; fix a rim or add supports",
            )
        check_directors(nodes_mm, quads, directors)
        check_distortion(nodes_mm, quads, directors, thickness_mm)
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
        error, max_error = 0.0, 5e-3  # estimated, on the safe side
        # Right-hand sides at once: enough to amortise reading the factor, and they stay in cache.
        at_once = 64
        for first in range(0, dense.shape[1], at_once):
            batch = slice(first, first + at_once)
            motion[self._free, batch], part = self.factor.solve(dense[self._free, batch])
            error = float(np.maximum(error, part))  # keeps NaN
        if not error <= max_error:
            raise NumericalError(
                "stiffness-ill-conditioned",
                f"rounding errors are too large (relative error about {error:.2g}, limit "
                f"{max_error:g}): the stiffness is close to singular; check that the shell is "
                "held and that thickness over element size is not far below 1e-4",
            )
        reactions = self.stiffness @ motion - dense
        reactions[self._free] = 0.0
        shape = (len(self.nodes_mm), 6, dense.shape[1])
        return Solution(
            motion=motion.reshape(shape), reactions=reactions.reshape(shape), error=error
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
