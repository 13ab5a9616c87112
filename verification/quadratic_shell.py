"""The shell as eight-node quadratic shells (S8R) with NLGEOM, for CalculiX or Abaqus.

An independent model of the same shell: mid-side nodes lie on the true middle face, and a contact
patch is spread consistently with the quadratic shape functions.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_design.mechanics.meshing.mesh import R, S, ShellMesh
from phytac_design.mechanics.shell.loads import _cell_area
from phytac_design.mechanics.shell.mesh_writers import (
    inp_loads,
    inp_material,
    inp_nodes,
    write_lines,
)
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError
from verification import calculix

CELLS = 16
"""Cells along each side of an element in the integration of a patch."""


@dataclass(frozen=True, kw_only=True)
class QuadraticMesh:
    """Eight-node quads of the middle face.

    Attributes
    ----------
    nodes_mm : (N, 3) float
        Corner nodes as in the linear mesh, then mid-side nodes, mm.
    uv : (N, 2) float
        Their chart coordinates (of mid-sides: within one period of a corner).
    octets : (E, 8) int
        Corners, then mid-sides of the edges 1-2, 2-3, 3-4, 4-1.
    held : (k,) int
        Nodes of both rims.
    linear : ShellMesh
        The mesh it was made from.
    """

    nodes_mm: FloatArray
    uv: FloatArray
    octets: IntArray
    held: IntArray
    linear: ShellMesh


def quadratic_mesh(mesh: ShellMesh, surface: Surface) -> QuadraticMesh:
    """Add mid-side nodes on the true face to a linear mesh."""
    corners = element_uv(mesh)
    middle = 0.5 * (corners + np.roll(corners, -1, axis=1)).reshape(-1, 2)
    ends = np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], -1), axis=2)
    edges, first, slot = np.unique(
        ends.reshape(-1, 2), axis=0, return_index=True, return_inverse=True
    )
    uv = np.concatenate([mesh.uv, middle[first]])
    octets = np.concatenate([mesh.quads, len(mesh.uv) + slot.reshape(-1, 4)], axis=1)
    rims = [mesh.sets[name] for name in ("TOP", "BOTTOM")]
    sides = [len(mesh.uv) + np.flatnonzero(np.isin(edges, rim).all(axis=1)) for rim in rims]
    return QuadraticMesh(
        nodes_mm=surface.point(uv, -mesh.thickness_mm / 2.0),
        uv=uv,
        octets=octets,
        held=np.unique(np.concatenate(rims + sides)),
        linear=mesh,
    )


def quadratic_patch(
    mesh: QuadraticMesh, surface: Surface, centre_uv: FloatArray, radius_mm: float
) -> FloatArray:
    """Nodal forces (N, 3) of 1 N pressed inward on a disc, as in :func:`loads.patch_loads`."""
    corners = element_uv(mesh.linear)
    outer = surface.point(mesh.linear.uv)[mesh.linear.quads]
    at = surface.point(centre_uv.reshape(1, 2))[0]
    reach = np.linalg.norm(outer - outer.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    near = np.linalg.norm(outer.mean(axis=1) - at, axis=1) <= 1.1 * (radius_mm + reach)
    side = (np.arange(CELLS) + 0.5) * 2.0 / CELLS - 1.0
    r, s = (grid.ravel() for grid in np.meshgrid(side, side))
    bilinear = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))
    spots = (bilinear @ corners[near]).reshape(-1, 2)
    points = surface.point(spots).reshape(-1, len(r), 3)
    area = _cell_area(outer[near], r, s)
    cell = np.sqrt(area.sum(axis=1, keepdims=True) / np.abs(area).sum()) * reach[near][:, None]
    cell = np.minimum(cell, 2.0 * reach[near][:, None] / CELLS)
    inside = (radius_mm - np.linalg.norm(points - at, axis=2)) / cell + 0.5
    push = -surface.normal(spots).reshape(points.shape)
    push *= (np.clip(inside, 0.0, 1.0) * area)[:, :, None]
    forces = np.zeros_like(mesh.nodes_mm)
    np.add.at(forces, mesh.octets[near], np.einsum("qi,eqx->eix", _serendipity(r, s), push))
    total = float(np.sum(forces @ -surface.normal(centre_uv.reshape(1, 2))[0]))
    if not total > 0.0:
        raise NumericalError(
            "patch-without-element", "the patch touches no element; check its centre and radius"
        )
    return forces / total


def _serendipity(r: FloatArray, s: FloatArray) -> FloatArray:
    """Eight shape functions at points (q,), (q, 8)."""
    rr, ss = np.multiply.outer(r, R), np.multiply.outer(s, S)
    corner = 0.25 * (1.0 + rr) * (1.0 + ss) * (rr + ss - 1.0)
    side = [
        0.5 * (1 - r * r) * (1 - s),
        0.5 * (1 + r) * (1 - s * s),
        0.5 * (1 - r * r) * (1 + s),
        0.5 * (1 - r) * (1 - s * s),
    ]
    return np.column_stack([corner, *side])


def run_ccx(
    folder: Path,
    mesh: QuadraticMesh,
    forces: FloatArray,
    *,
    modulus_MPa: float,
    poisson: float,
) -> FloatArray:
    """Displacements (N, 3), mm, of all nodes by CalculiX with NLGEOM; ``ccx`` must be on PATH.

    Raises
    ------
    NumericalError
        If CalculiX does not finish the step.
    """
    step = ("*STEP, NLGEOM, INC=200", "*STATIC", "0.5, 1.0", *inp_loads(forces))
    lines = [*model_lines(mesh, modulus_MPa, poisson), *step]
    path = write_lines(folder / "s8r.inp", [*lines, "*NODE PRINT, NSET=ALL", "U", "*END STEP"])
    return calculix.run_ccx(path)[-1]["displacements", "ALL"][1]


def model_lines(mesh: QuadraticMesh, modulus_MPa: float, poisson: float) -> list[str]:
    """Nodes, elements, section and clamped rims of an ``.inp`` file."""
    octets = [
        f"{k}, {', '.join(map(str, row))}"
        for k, row in enumerate((mesh.octets + 1).tolist(), start=1)
    ]
    return [
        *inp_nodes(mesh.nodes_mm),
        *("*ELEMENT, TYPE=S8R, ELSET=SHELL", *octets),
        *inp_material(modulus_MPa, poisson),
        *("*SHELL SECTION, ELSET=SHELL, MATERIAL=RESIN", f"{mesh.linear.thickness_mm:.9g}"),
        *("*BOUNDARY", *(f"{k}, 1, 6" for k in (mesh.held + 1).tolist())),
    ]


def element_uv(mesh: ShellMesh) -> FloatArray:
    """Chart corners of every element, (E, 4, 2), unwrapped: no element jumps over the seam.

    Of use on tubes and sheets; next to a pole chart coordinates are no measure of place.
    """
    uv = mesh.uv[mesh.quads]
    if np.isfinite(mesh.period_v):
        turn = (uv[:, :, 1] - uv[:, :1, 1]) / mesh.period_v
        uv[:, :, 1] -= mesh.period_v * np.rint(turn)
    return np.asarray(uv)
