"""Solid meshes for other programs: ``.inp``, ``.msh``, ``.vtu``."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from phytac_design.mechanics.shell.mesh_writers import (
    inp_loads,
    inp_material,
    inp_nodes,
    inp_set,
    write_gmsh,
    write_grid,
    write_lines,
)
from phytac_design.mechanics.solid.solid_mesh_tets import SolidMesh
from phytac_design.mechanics.solid.tetrahedra import Tetrahedra
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


def write_solid_inp(
    path: Path, mesh: SolidMesh, *, modulus_MPa: float, poisson: float, load: FloatArray, name: str
) -> Path:
    """Write a linear job that ``ccx`` (and Abaqus) runs as it is.

    C3D10 in element set SHELL, node sets ALL, TOP, BOTTOM, TIP_i and TIPS (their union), both
    rims held, one *STATIC step with the load as *CLOAD. Displacements of all nodes go to the
    result file, those of TIPS also to the printed file.

    Parameters
    ----------
    path : Path
        File to write.
    mesh : SolidMesh
        Solid mesh of the shell.
    modulus_MPa, poisson : float
        Material.
    load : (N, 3) float
        Nodal forces, N, e.g. a force times :func:`solid.load.solid_patch_load`.
    name : str
        Title for the heading.
    """
    check_load(mesh, load)
    lines = [*inp_solid(mesh, mesh.sets, name), *inp_material(modulus_MPa, poisson)]
    lines.append("*SOLID SECTION, ELSET=SHELL, MATERIAL=RESIN")
    lines += ["*BOUNDARY", "TOP, 1, 3", "BOTTOM, 1, 3", "*STEP", "*STATIC", *inp_loads(load)]
    lines += ["*NODE FILE", "U"]
    if mesh.tips:
        lines += ["*NODE PRINT, NSET=TIPS", "U"]
    return write_lines(path, [*lines, "*END STEP"])


def check_load(mesh: Tetrahedra, load: FloatArray) -> None:
    """Raise a NumericalError unless the load has three finite forces per node."""
    if np.shape(load) != mesh.nodes_mm.shape or not np.all(np.isfinite(load)):
        raise NumericalError(
            "load-vector-invalid",
            f"the load needs three finite forces per node, {mesh.nodes_mm.shape} "
            f"(got {np.shape(load)})",
        )


def inp_solid(mesh: Tetrahedra, sets: Mapping[str, IntArray], name: str) -> Iterator[str]:
    """Lines of heading, nodes, C3D10 elements, node sets and their union of TIP_i, TIPS."""
    yield "*HEADING"
    yield f"{name}: solid of quadratic tetrahedra; mm, N, MPa; z away from the camera"
    yield from inp_nodes(mesh.nodes_mm)
    yield "*ELEMENT, TYPE=C3D10, ELSET=SHELL"
    for label, nodes in enumerate((mesh.tets + 1).tolist(), start=1):
        yield f"{label}, {', '.join(map(str, nodes[:6]))},"
        yield ", ".join(map(str, nodes[6:]))
    for key, part in sets.items():
        yield from inp_set("NSET", key, part)
    tips = [key for key in sets if key.startswith("TIP_")]
    if tips:
        yield "*NSET, NSET=TIPS"
        yield from tips


def write_solid_msh(path: Path, mesh: SolidMesh) -> Path:
    """Write Gmsh 2.2 (text): physical groups SHELL, TOP, BOTTOM, OUTER, and TIP_i (triangles)."""
    faces = {
        key: np.flatnonzero(np.isin(mesh.triangles, mesh.sets[key]).all(axis=1))
        for key in ("TOP", "BOTTOM")
    }
    faces |= {"OUTER": mesh.outer} | {f"TIP_{i}": part for i, part in enumerate(mesh.tips)}
    groups = {"SHELL": (1, 3, "tetra10", mesh.tets)}
    for tag, (key, part) in enumerate(faces.items(), start=2):
        groups[key] = (tag, 2, "triangle6", mesh.triangles[part])
    return write_gmsh(path, mesh.nodes_mm, groups)


def write_solid_vtu(path: Path, mesh: SolidMesh, *, motion: FloatArray | None = None) -> Path:
    """Write a VTK unstructured grid with the receptor of each end-face node (-1 elsewhere).

    ``motion`` (N, 3), mm, adds point data ``displacement_mm``.
    """
    tip = np.full(len(mesh.nodes_mm), -1, dtype=np.int64)
    for i in range(len(mesh.tips)):
        tip[mesh.sets[f"TIP_{i}"]] = i
    data: dict[str, FloatArray | IntArray] = {"receptor": tip}
    if motion is not None:
        data["displacement_mm"] = motion
    return write_grid(path, mesh.nodes_mm, ("tetra10", mesh.tets), data)
