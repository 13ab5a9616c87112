"""Two meshes of one shell, and motion extrapolated from both to elements of size 0.

The error of linear motion falls with the square of the elements' size
(:mod:`phytac_design.mechanics.shell.discretisation`).
"""

from collections.abc import Callable
from dataclasses import dataclass

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError

ELEMENTS_RATIO_MIN = 1.5
"""Least ratio of the elements of the two meshes; shipped designs have 1.9 or more. Nearer meshes
multiply their difference by more than it is known to."""


@dataclass(frozen=True, kw_only=True)
class MeshPair:
    """Two meshes of one shell that are refined alike everywhere.

    Attributes
    ----------
    finer, coarser : (ShellMesh, ShellModel)
        Mesh and model.
    ratio : float
        Squared size of the coarser elements over that of the finer ones.
    """

    finer: tuple[ShellMesh, ShellModel]
    coarser: tuple[ShellMesh, ShellModel]
    ratio: float

    @property
    def each(self) -> list[tuple[ShellMesh, ShellModel]]:
        """Both, the finer first."""
        return [self.finer, self.coarser]

    def correction(self, fine: FloatArray, coarse: FloatArray) -> FloatArray:
        """What to add to linear motion on the finer mesh; both motions are of the same points."""
        return (fine - coarse) / (self.ratio - 1.0)


def paired(
    finer: tuple[ShellMesh, ShellModel], coarser: tuple[ShellMesh, ShellModel], ratio: float
) -> MeshPair | None:
    """Return the pair of two meshes; None where they are too alike (``ELEMENTS_RATIO_MIN``)."""
    if ratio < ELEMENTS_RATIO_MIN:
        return None
    return MeshPair(finer=finer, coarser=coarser, ratio=ratio)


def mesh_pair(
    shell: Callable[[int], tuple[ShellMesh, ShellModel]], levels: tuple[int, int] | None
) -> MeshPair | None:
    """Two meshes of a shell that linear motion is extrapolated from; None without.

    Parameters
    ----------
    shell : callable
        Elements per marker pitch -> mesh and model.
    levels : (int, int) or None
        Elements per marker pitch of both, the finer first.
    """
    if levels is None:
        return None
    try:
        finer, coarser = (shell(level) for level in levels)
    except (DesignError, NumericalError):  # it holds no markers, or is too irregular
        return None
    return paired(finer, coarser, len(finer[1].quads) / len(coarser[1].quads))
