r"""Cell model: how one receptor tube and its hole change the wall's membrane and bending stiffness.

A quarter of a flat cell of the wall, mirrored in x = 0 and y = 0, repeated by its other two sides.
The middle face of the plate is z = 0, the tube hangs below::

      z    +----------------+  z = t/2
      |    | hole |  wall   |                normal cases:  x = a: u_x = (ε_x - κ_x z) a, ...
      |    |      |---------+  z = -t/2      shear cases:   x = a: u_y = (γ/2 - κ_xy z) a,
           |   |__|                                                u_z = κ_xy a y, ...
      axis |   tube, height h below the wall
           +---------------------> x, y      N, M: resultants of the sides' reactions

Solved by CalculiX on quadratic tetrahedra; cells without receptors have N = A·ε, M = D·κ with the
plane-stress A ~ E t and D ~ E t³/12, which the ratios are taken against.
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from phytac_design.mechanics.shell.mesh_writers import inp_material, write_lines
from phytac_design.mechanics.solid.solid_writers import inp_solid
from phytac_design.mechanics.solid.tetrahedra import Tetrahedra, tetrahedra
from phytac_shapes.arrays import FloatArray, IntArray
from verification.calculix import run_ccx

CASES = ("ex", "ey", "kx", "ky", "gxy", "kxy")
"""Unit membrane strains and curvatures (1/mm) of the six solves."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell of the wall; lengths in mm.

    Attributes
    ----------
    pitch_x_mm, pitch_y_mm : float
        Sides of the whole cell.
    thickness_mm : float
        Wall.
    height_mm : float
        Receptor height below the wall; 0 with ``diameter_hole_mm`` 0 is the plain wall.
    diameter_outer_mm, diameter_hole_mm : float
        Tube and its through-hole; 0 for none.
    poisson : float
        Poisson's ratio.
    """

    pitch_x_mm: float
    pitch_y_mm: float
    thickness_mm: float
    height_mm: float
    diameter_outer_mm: float
    diameter_hole_mm: float
    poisson: float


@dataclass(frozen=True, kw_only=True)
class CellStiffness:
    """Stiffness of a cell over that of the plain wall.

    Attributes
    ----------
    membrane, bending : (3, 3) float
        A and D (xx, yy, xy in Mandel's scaling) in units of E t and E t³/12; the middle face is
        held flat in A and unstretched in D.
    coupling : (2, 2) float
        Moments M_x, M_y per strain ε_x, ε_y in units of E t²: the tube sits on one side.
    """

    membrane: FloatArray
    bending: FloatArray
    coupling: FloatArray


def plain(poisson: float) -> FloatArray:
    """Plane-stress matrix for E = 1 in Mandel's scaling, (3, 3)."""
    v = poisson
    return np.array([[1.0, v, 0.0], [v, 1.0, 0.0], [0.0, 0.0, 1.0 - v]]) / (1.0 - v * v)


def ratio(stiffness: FloatArray, poisson: float) -> float:
    """Factor that brings the plain wall's matrix closest to ``stiffness`` (Frobenius)."""
    base = plain(poisson)
    return float(np.sum(stiffness * base) / np.sum(base * base))


def cell_mesh(cell: Cell, size_mm: float) -> Tetrahedra:
    """Mesh of the quarter cell; ``size_mm`` around the receptor, up to 3 times it away from it."""
    a, b, t = cell.pitch_x_mm / 2.0, cell.pitch_y_mm / 2.0, cell.thickness_mm
    outer, hole = cell.diameter_outer_mm / 2.0, cell.diameter_hole_mm / 2.0

    def build(gmsh: Any) -> None:
        occ = gmsh.model.occ
        body = [(3, occ.addBox(0.0, 0.0, -t / 2.0, a, b, t))]
        bottom = -t / 2.0 - cell.height_mm
        if cell.height_mm > 0.0:
            tube = occ.addCylinder(
                0, 0, bottom, 0, 0, cell.height_mm + t / 2.0, outer, angle=np.pi / 2.0
            )
            body = occ.fuse(body, [(3, tube)])[0]
        if hole > 0.0:
            length = cell.height_mm + t
            occ.cut(body, [(3, occ.addCylinder(0, 0, bottom - t, 0, 0, length + 2.0 * t, hole))])

    def size(gmsh: Any) -> int:
        field = gmsh.model.mesh.field
        tag = field.add("Cylinder")
        reach = max(1.3 * outer, hole, size_mm)
        for name, number in (
            ("VIn", size_mm),
            ("VOut", 3.0 * size_mm),
            ("Radius", reach),
            ("ZAxis", 100.0 * (cell.height_mm + t)),
        ):
            field.setNumber(tag, name, number)
        return int(tag)

    return tetrahedra(build, size)


def cell_stiffness(cell: Cell, *, size_mm: float | None = None) -> CellStiffness:
    """Solve the six cases of a cell.

    Parameters
    ----------
    cell : Cell
        The cell.
    size_mm : float, optional
        Element size at the receptor; 0.6 of the wall's thickness if left out.

    Raises
    ------
    MissingPartError
        If Gmsh or CalculiX is not installed.
    NumericalError
        If meshing or solving fails.
    """
    mesh = cell_mesh(cell, 0.6 * cell.thickness_mm if size_mm is None else size_mm)
    a, b = cell.pitch_x_mm / 2.0, cell.pitch_y_mm / 2.0
    x, y, z = mesh.nodes_mm.T
    near = 1e-6 * cell.thickness_mm
    sides = {
        "X0": np.flatnonzero(x < near),
        "Y0": np.flatnonzero(y < near),
        "XA": np.flatnonzero(x > a - near),
        "YB": np.flatnonzero(y > b - near),
    }
    corner = int(np.argmin((x - a) ** 2 + (y - b) ** 2 + z**2))
    lines = [*inp_solid(mesh, sides, "cell"), *inp_material(1.0, cell.poisson)]
    lines.append("*SOLID SECTION, ELSET=SHELL, MATERIAL=RESIN")
    for k, case in enumerate(CASES):
        lines += ["*STEP", "*STATIC", "1., 1.", "*BOUNDARY, OP=NEW"]
        lines += _supports(case, mesh.nodes_mm, sides, corner)
        for key in ("XA", "YB"):
            lines += [f"*NODE PRINT, NSET={key}", "RF"]
        lines += [f"** case {k}", "*END STEP"]
    with TemporaryDirectory() as folder:
        results = run_ccx(write_lines(Path(folder) / "cell.inp", lines))
    force = {
        case: {
            key: dict(zip(*(v.tolist() for v in table[("forces", key)]), strict=True))
            for key in ("XA", "YB")
        }
        for case, table in zip(CASES, results, strict=True)
    }
    return _resultants(cell, mesh.nodes_mm, sides, force)


def _held(node: int, dof: int, value: float = 0.0) -> str:
    return f"{node + 1}, {dof}, {dof}, {value:.12e}"


def _supports(case: str, nodes: FloatArray, sides: dict[str, IntArray], corner: int) -> list[str]:
    """Displacement boundary conditions of a case."""
    if case in ("gxy", "kxy"):
        out = ["X0, 2, 3", "Y0, 1, 1", "Y0, 3, 3"]
        for key, dof in (("XA", 2), ("YB", 1)):
            for i in sides[key].tolist():
                x, y, z = nodes[i].tolist()
                slope = 0.5 if case == "gxy" else -z
                out.append(_held(i, dof, slope * (x if dof == 2 else y)))
                out.append(_held(i, 3, x * y if case == "kxy" else 0.0))
        return out
    out = ["X0, 1, 1", "Y0, 2, 2", _held(corner, 3)]
    for key, dof, axis in (("XA", 1, "x"), ("YB", 2, "y")):
        for i in sides[key].tolist():
            slope = {"e" + axis: 1.0, "k" + axis: -float(nodes[i, 2])}.get(case, 0.0)
            out.append(_held(i, dof, slope * float(nodes[i, dof - 1])))
    return out


def _resultants(
    cell: Cell,
    nodes: FloatArray,
    sides: dict[str, IntArray],
    force: dict[str, dict[str, dict[int, list[float]]]],
) -> CellStiffness:
    """N, M per unit strain and curvature; shear by its energy."""
    a, b, t = cell.pitch_x_mm / 2.0, cell.pitch_y_mm / 2.0, cell.thickness_mm
    A, D, B = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((2, 2))
    for k, (key, width) in enumerate((("XA", b), ("YB", a))):
        z = nodes[sides[key], 2]
        for j, axis in enumerate("xy"):
            for case, straight, bent in (("e" + axis, A, B), ("k" + axis, None, D)):
                table = force[case][key]
                F = np.array([table[i][k] for i in sides[key].tolist()])
                if straight is not None:
                    straight[k, j] = F.sum() / width
                bent[k, j] = -(F * z).sum() / width
    for case, out in (("gxy", A), ("kxy", D)):
        work = 0.0
        done: set[tuple[int, int]] = set()
        for line in _supports(case, nodes, sides, 0)[3:]:
            label, dof, _, value = line.split(",")
            at = (int(label) - 1, int(dof))
            if at in done:  # the corner's deflection belongs to both sides
                continue
            done.add(at)
            key = "XA" if at[0] in force[case]["XA"] else "YB"
            work += force[case][key][at[0]][at[1] - 1] * float(value)
        # Energy density: γ² G t / 2 = A_66 γ² / 4 with Mandel's A_66 = 2 G t; likewise (2 κ_xy)².
        out[2, 2] = work / (a * b) / (0.5 if case == "gxy" else 2.0)
    return CellStiffness(membrane=A / t, bending=D / (t**3 / 12.0), coupling=B / t**2)
