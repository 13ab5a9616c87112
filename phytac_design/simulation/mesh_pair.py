"""Two meshes of one shell, and motion extrapolated from both to elements of size 0.

The error of linear motion falls with the square of the elements' size
(:mod:`phytac_design.mechanics.shell.discretisation`).
"""

from collections.abc import Callable

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError

MeshPair = tuple[tuple[ShellMesh, ShellModel], tuple[ShellMesh, ShellModel]]
"""Meshes with models of one shell, the finer first."""
ELEMENTS_RATIO_MIN = 1.5
"""Least ratio of the elements of the two meshes; shipped designs have 1.9 or more. Nearer meshes
multiply their difference by more than it is known to."""


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
    far_enough = len(finer[1].quads) >= ELEMENTS_RATIO_MIN * len(coarser[1].quads)
    return (finer, coarser) if far_enough else None


def change_to_limit(pair: MeshPair, fine: FloatArray, coarse: FloatArray) -> FloatArray:
    """What to add to linear motion on the finer mesh; both motions are of the same points."""
    # Squared size of the coarser elements over that of the finer ones.
    ratio = len(pair[0][1].quads) / len(pair[1][1].quads)
    return (fine - coarse) / (ratio - 1.0)
