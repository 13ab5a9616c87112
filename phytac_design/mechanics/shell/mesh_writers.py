"""The shell mesh for other programs: Abaqus/CalculiX ``.inp``, Gmsh ``.msh``, VTK ``.vtu``.

Files are the same, byte for byte, for the same input. Numbering starts at 1: node k of the mesh
is node k + 1 of the file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError

PER_LINE = 12
"""Labels per line of a set (Abaqus allows 16)."""
RIMS = ("TOP", "BOTTOM", "LEFT", "RIGHT")
"""Node sets of the open edges, in the order of the files."""
PHYSICAL = {
    "SHELL": (1, 2),
    "TOP": (2, 1),
    "BOTTOM": (3, 1),
    "MARKERS": (4, 0),
    "LEFT": (5, 1),
    "RIGHT": (6, 1),
}
"""Gmsh physical groups: tag and dimension; a file has those that its mesh fills."""


def write_inp(
    path: Path, mesh: ShellMesh, *, modulus_MPa: float, poisson: float, load: Any, name: str
) -> Path:
    """Write a job that ``ccx`` (and Abaqus) runs as it is.

    S4 shells in element set SHELL; node sets MARKERS, one for each open edge of the shape (TOP,
    BOTTOM, LEFT, RIGHT) and CLAMPED, all of these edges, fixed in all DOFs; one linear *STATIC
    step with the load as *CLOAD. Displacements of all nodes go to the result file, those of the
    markers also to the printed file.

    Parameters
    ----------
    path : Path
        File to write.
    mesh : ShellMesh
        The shell.
    modulus_MPa, poisson : float
        Material.
    load : (6N,) or (6N, 1) float, dense or scipy.sparse
        Nodal forces (N) and moments (N mm), e.g. one column of :func:`loads.patch_loads` times a
        force.
    name : str
        Title for the heading.
    """
    dense = np.asarray(load.toarray() if hasattr(load, "toarray") else load, dtype=np.float64)
    if dense.size != 6 * len(mesh.nodes_mm) or not np.all(np.isfinite(dense)):
        raise NumericalError(
            f"the load needs one finite value per DOF, {6 * len(mesh.nodes_mm)} in all "
            f"(got {dense.size})"
        )
    lines = [*_inp_mesh(mesh, name), *_inp_model(mesh, modulus_MPa, poisson)]
    lines += _inp_step(mesh, dense.reshape(-1, 6))
    path.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace", newline="\n")
    return path


def _inp_mesh(mesh: ShellMesh, name: str) -> Iterator[str]:
    yield "*HEADING"
    yield f"{name}: middle face of the shell; mm, N, MPa; z away from the camera"
    yield "*NODE, NSET=ALL"
    for label, (x, y, z) in enumerate(mesh.nodes_mm.tolist(), start=1):
        yield f"{label}, {x:.12e}, {y:.12e}, {z:.12e}"
    yield "*ELEMENT, TYPE=S4, ELSET=SHELL"
    for label, corners in enumerate((mesh.quads + 1).tolist(), start=1):
        yield f"{label}, {', '.join(map(str, corners))}"
    for key, nodes in (*_filled(mesh).items(), ("CLAMPED", mesh.clamped)):
        yield f"*NSET, NSET={key}"
        yield from _wrapped(nodes)


def _filled(mesh: ShellMesh) -> dict[str, IntArray]:
    """Node sets that have nodes: open edges and markers."""
    sets = {key: mesh.sets[key] for key in (*RIMS, "MARKERS") if key in mesh.sets}
    return {key: nodes for key, nodes in sets.items() if len(nodes)}


def _wrapped(nodes: IntArray) -> Iterator[str]:
    labels = (np.sort(nodes) + 1).tolist()
    for first in range(0, len(labels), PER_LINE):
        yield ", ".join(map(str, labels[first : first + PER_LINE]))


def _inp_model(mesh: ShellMesh, modulus_MPa: float, poisson: float) -> Iterator[str]:
    yield "*MATERIAL, NAME=RESIN"
    yield "*ELASTIC"
    yield f"{modulus_MPa:.9g}, {poisson:.9g}"
    yield "*SHELL SECTION, ELSET=SHELL, MATERIAL=RESIN"
    yield f"{mesh.thickness_mm:.9g}"
    yield "*BOUNDARY"
    yield "CLAMPED, 1, 6"


def _inp_step(mesh: ShellMesh, load: FloatArray) -> Iterator[str]:
    yield "*STEP"
    yield "*STATIC"
    yield "*CLOAD"
    for node, dof in zip(*np.nonzero(load), strict=True):
        yield f"{node + 1}, {dof + 1}, {load[node, dof]:.12e}"
    yield "*NODE FILE"
    yield "U, RF"
    yield "*EL FILE"
    yield "S"
    if len(mesh.sets["MARKERS"]):
        yield "*NODE PRINT, NSET=MARKERS"
        yield "U"
    yield "*END STEP"


def write_msh(path: Path, mesh: ShellMesh) -> Path:
    """Write Gmsh 2.2 (text): physical groups SHELL, one of lines per open edge, MARKERS."""
    import meshio

    cells: list[tuple[str, IntArray]] = [("quad", mesh.quads)]
    tags = [PHYSICAL["SHELL"][0]]
    filled = _filled(mesh)
    for key, nodes in filled.items():
        rim = key in RIMS
        cells.append(("line", _edges(mesh, nodes)) if rim else ("vertex", nodes[:, None]))
        tags.append(PHYSICAL[key][0])
    label = [np.full(len(part), tag) for (_, part), tag in zip(cells, tags, strict=True)]
    out = meshio.Mesh(
        mesh.nodes_mm,
        cells,
        cell_data={"gmsh:physical": label, "gmsh:geometrical": label},
        field_data={key: np.array(PHYSICAL[key]) for key in ("SHELL", *filled)},
    )
    meshio.write(path, out, file_format="gmsh22", binary=False)
    return path


def write_vtu(path: Path, mesh: ShellMesh, *, motion: FloatArray | None = None) -> Path:
    """Write a VTK unstructured grid with normals, chart coordinates, set flags, marker ids.

    ``motion`` (N, 6), mm and rad, adds point data ``displacement_mm`` and ``rotation_rad``.
    """
    import meshio

    count = len(mesh.nodes_mm)
    marker = np.full(count, -1, dtype=np.int64)
    marker[mesh.marker_nodes] = np.arange(len(mesh.marker_nodes))
    data: dict[str, Any] = {"normal": mesh.normals, "uv": mesh.uv, "marker": marker}
    for key, nodes in mesh.sets.items():
        data[key] = np.isin(np.arange(count), nodes).astype(np.int64)
    if motion is not None:
        data |= {"displacement_mm": motion[:, :3], "rotation_rad": motion[:, 3:]}
    out = meshio.Mesh(mesh.nodes_mm, [("quad", mesh.quads)], point_data=data)
    meshio.write(path, out, file_format="vtu")
    return path


def _edges(mesh: ShellMesh, nodes: IntArray) -> IntArray:
    """Element edges (k, 2) with both ends in ``nodes``, each once."""
    edges = np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    inside = np.isin(edges, nodes).all(axis=1)
    return np.asarray(np.unique(np.sort(edges[inside], axis=1), axis=0))
