"""A clamped strip: plane strain against Timoshenko's beam, near the clamp. Rows of ``twin``.

A shell's edge is held as a line; a solid's end face also cannot thin or widen, so the solid is
stiffer than any shell within a few thicknesses. This says by how much, apart from all else.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from benchmarks.harness import Table
from phytac_shapes.arrays import FloatArray, IntArray

E_MPA, NU = 2200.0, 0.38
THICKNESS_MM, LENGTH_MM = 0.8, 8.0
ALONG, THROUGH = 400, 40
PLACES_MM = (1.1, 2.6, 4.1, 6.0)
"""The middle one is where the last receptor of cylinder60 stands, the others its foot's edges."""


def _grid() -> tuple[IntArray, IntArray]:
    """Nodes (ALONG + 1, THROUGH + 1) and degrees of freedom (e, 8) of the elements."""
    nodes = np.arange((ALONG + 1) * (THROUGH + 1)).reshape(ALONG + 1, THROUGH + 1)
    corners = [nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]]
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    return nodes, (2 * quads[:, :, None] + np.arange(2)).reshape(-1, 8)


def _element() -> FloatArray:
    """Stiffness (8, 8) of a rectangle in plane strain, bilinear, 2 by 2 points."""
    hx, hy = LENGTH_MM / ALONG, THICKNESS_MM / THROUGH
    law = np.array([[1.0 - NU, NU, 0.0], [NU, 1.0 - NU, 0.0], [0.0, 0.0, 0.5 - NU]])
    law *= E_MPA / ((1.0 + NU) * (1.0 - 2.0 * NU))
    r, s = np.array([-1, 1, 1, -1]), np.array([-1, -1, 1, 1])
    out = np.zeros((8, 8))
    for a in (-1.0, 1.0):
        for b in (-1.0, 1.0):
            g = np.sqrt(1.0 / 3.0)
            dx = r * (1.0 + s * b * g) / (2.0 * hx)
            dy = s * (1.0 + r * a * g) / (2.0 * hy)
            strain = np.zeros((3, 8))
            strain[0, ::2], strain[1, 1::2], strain[2, ::2], strain[2, 1::2] = dx, dy, dy, dx
            out += strain.T @ law @ strain * hx * hy / 4.0
    return out


def add_rows(table: Table) -> None:
    """Deflection and slope of the faces over Timoshenko's, under an end moment and a shear."""
    nodes, dof = _grid()
    size = 2 * nodes.size
    value = np.tile(_element().ravel(), len(dof))
    rows, columns = np.repeat(dof, 8, axis=1).ravel(), np.tile(dof, (1, 8)).ravel()
    stiffness = coo_matrix((value, (rows, columns)), shape=(size, size)).tocsc()
    free = np.arange(2 * (THROUGH + 1), size)
    factor = splu(stiffness[free][:, free])
    y = np.linspace(-0.5, 0.5, THROUGH + 1) * THICKNESS_MM
    bending = E_MPA * THICKNESS_MM**3 / 12.0 / (1.0 - NU**2)
    shear = 5.0 / 6.0 * E_MPA / (2.0 * (1.0 + NU)) * THICKNESS_MM
    for name in ("moment", "shear force"):
        load = np.zeros(size)
        if name == "moment":
            load[2 * nodes[-1]] = -y
        else:
            load[2 * nodes[-1] + 1] = 1.0 - (2.0 * y / THICKNESS_MM) ** 2
        moment, force = -load[2 * nodes[-1]] @ y, load[2 * nodes[-1] + 1].sum()
        moved = np.zeros(size)
        moved[free] = factor.solve(load[free])
        for x in PLACES_MM:
            k = round(x / LENGTH_MM * ALONG)
            step = 2.0 * LENGTH_MM / ALONG
            face = moved[2 * nodes[[k - 1, k + 1], -1] + 1]
            beam = (moment * x**2 / 2.0 + force * (LENGTH_MM * x**2 / 2.0 - x**3 / 6.0)) / bending
            lean = (moment * x + force * (LENGTH_MM * x - x**2 / 2.0)) / bending
            found = {
                "deflection": moved[2 * nodes[k, THROUGH // 2] + 1] / (beam + force * x / shear),
                "slope of the face": (face[1] - face[0]) / step / (lean + force / shear),
            }
            for what, ratio in found.items():
                table.add(
                    f"referee: clamped strip, {THICKNESS_MM:g} mm thick, {name}: {what} of a "
                    f"solid {x:g} mm from the clamp over that of a beam with shear, less 1",
                    100.0 * (float(ratio) - 1.0),
                    "%",
                    reference=0.0,
                    source="Timoshenko's beam, plane strain",
                )
