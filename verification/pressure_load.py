"""Nodal forces of a pressure along the element normals."""

import numpy as np

from phytac_design.mechanics.large.rotations import cross
from phytac_design.mechanics.shell.shell_element import GAUSS, shape
from phytac_shapes.arrays import FloatArray, IntArray


def pressure_forces(nodes_mm: FloatArray, quads: IntArray) -> FloatArray:
    """Nodal forces and moments (6N,) of 1 MPa along the normals of the faces as they stand.

    F_a = ∫ h_a x_r × x_s dr ds on the bilinear face; positive pressure pushes along the element's
    normal (outward on a :class:`mesh.ShellMesh`; a finger presses with a negative one).

    Parameters
    ----------
    nodes_mm : (N, 3) float
        Deformed positions, mm.
    quads : (E, 4) int
        Corners.
    """
    corner = nodes_mm[quads]
    out = np.zeros((len(nodes_mm), 6))
    for r in (-GAUSS, GAUSS):
        for s in (-GAUSS, GAUSS):
            h, dh = shape(r, s)
            g_r, g_s = np.einsum("ai,eik->aek", dh, corner)
            np.add.at(out[:, :3], quads, h[None, :, None] * cross(g_r, g_s)[:, None])
    return out.ravel()
