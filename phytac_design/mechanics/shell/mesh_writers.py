"""Meshes for other programs: Abaqus/CalculiX ``.inp``, Gmsh ``.msh``, VTK ``.vtu``.

Files are the same, byte for byte, for the same input. Numbering starts at 1: node k of the mesh
is node k + 1 of the file.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError

RIMS = ("TOP", "BOTTOM", "LEFT", "RIGHT")
"""Node sets of the open edges, in the order of the files."""


def inp_nodes(nodes_mm: FloatArray) -> Iterator[str]:
    """Lines of all nodes (N, 3), in node set ALL."""
    yield "*NODE, NSET=ALL"
    for label, (x, y, z) in enumerate(nodes_mm.tolist(), start=1):
        yield f"{label}, {x:.12e}, {y:.12e}, {z:.12e}"


def inp_set(kind: str, name: str, members: IntArray) -> Iterator[str]:
    """Lines of a set; ``kind`` is NSET or ELSET, members count from 0."""
    yield f"*{kind}, {kind}={name}"
    labels = (np.sort(members) + 1).tolist()
    per_line = 10  # Abaqus allows 16, lines of 80 characters fewer
    for first in range(0, len(labels), per_line):
        yield ", ".join(map(str, labels[first : first + per_line]))


def inp_material(modulus_MPa: float, poisson: float, *, name: str = "RESIN") -> Iterator[str]:
    """Lines of an isotropic elastic material."""
    yield from (f"*MATERIAL, NAME={name}", "*ELASTIC", f"{modulus_MPa:.9g}, {poisson:.9g}")


def inp_loads(load: FloatArray) -> Iterator[str]:
    """Lines of nodal forces (N, 3) or forces and moments (N, 6)."""
    yield "*CLOAD"
    for node, dof in zip(*np.nonzero(load), strict=True):
        yield f"{node + 1}, {dof + 1}, {load[node, dof]:.12e}"


def write_lines(path: Path, lines: Iterable[str]) -> Path:
    """Write lines as ASCII with Unix ends."""
    path.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace", newline="\n")
    return path


def write_gmsh(
    path: Path, nodes_mm: FloatArray, groups: Mapping[str, tuple[int, int, str, IntArray]]
) -> Path:
    """Write Gmsh 2.2 (text); a physical group is (tag, dimension, meshio cell type, cells)."""
    import meshio

    label = [np.full(len(cells), tag) for tag, _, _, cells in groups.values()]
    out = meshio.Mesh(
        nodes_mm,
        [(kind, cells) for _, _, kind, cells in groups.values()],
        cell_data={"gmsh:physical": label, "gmsh:geometrical": label},
        field_data={name: np.array([tag, size]) for name, (tag, size, _, _) in groups.items()},
    )
    meshio.write(path, out, file_format="gmsh22", binary=False)
    return path


def write_grid(
    path: Path, nodes_mm: FloatArray, cells: tuple[str, IntArray], data: Mapping[str, Any]
) -> Path:
    """Write a VTK unstructured grid of one cell type with point data."""
    import meshio

    meshio.write(path, meshio.Mesh(nodes_mm, [cells], point_data=dict(data)), file_format="vtu")
    return path


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
            "load-vector-invalid",
            f"the load needs one finite value per DOF, {6 * len(mesh.nodes_mm)} in all "
            f"(got {dense.size})",
        )
    return write_lines(path, _inp_lines(mesh, modulus_MPa, poisson, dense.reshape(-1, 6), name))


def _inp_lines(
    mesh: ShellMesh, modulus_MPa: float, poisson: float, load: FloatArray, name: str
) -> Iterator[str]:
    yield "*HEADING"
    yield f"{name}: middle face of the shell; mm, N, MPa; z away from the camera"
    yield from inp_nodes(mesh.nodes_mm)
    yield "*ELEMENT, TYPE=S4, ELSET=SHELL"
    for label, corners in enumerate((mesh.quads + 1).tolist(), start=1):
        yield f"{label}, {', '.join(map(str, corners))}"
    for key, nodes in (*_filled(mesh).items(), ("CLAMPED", mesh.clamped)):
        yield from inp_set("NSET", key, nodes)
    yield from inp_material(modulus_MPa, poisson)
    yield from ("*SHELL SECTION, ELSET=SHELL, MATERIAL=RESIN", f"{mesh.thickness_mm:.9g}")
    yield from ("*BOUNDARY", "CLAMPED, 1, 6", "*STEP", "*STATIC")
    yield from inp_loads(load)
    yield from ("*NODE FILE", "U, RF", "*EL FILE", "S")
    if len(mesh.sets["MARKERS"]):
        yield from ("*NODE PRINT, NSET=MARKERS", "U")
    yield "*END STEP"


def _filled(mesh: ShellMesh) -> dict[str, IntArray]:
    """Node sets that have nodes: open edges and markers."""
    sets = {key: mesh.sets[key] for key in (*RIMS, "MARKERS") if key in mesh.sets}
    return {key: nodes for key, nodes in sets.items() if len(nodes)}


def write_msh(path: Path, mesh: ShellMesh) -> Path:
    """Write Gmsh 2.2 (text): physical groups SHELL, one of lines per open edge, MARKERS."""
    # Tag and dimension of each group.
    physical = {"TOP": (2, 1), "BOTTOM": (3, 1), "MARKERS": (4, 0), "LEFT": (5, 1), "RIGHT": (6, 1)}
    groups = {"SHELL": (1, 2, "quad", mesh.quads)}
    for key, nodes in _filled(mesh).items():
        cells = ("line", _edges(mesh, nodes)) if key in RIMS else ("vertex", nodes[:, None])
        groups[key] = (*physical[key], *cells)
    return write_gmsh(path, mesh.nodes_mm, groups)


def write_vtu(path: Path, mesh: ShellMesh, *, motion: FloatArray | None = None) -> Path:
    """Write a VTK unstructured grid with normals, chart coordinates, set flags, marker ids.

    ``motion`` (N, 6), mm and rad, adds point data ``displacement_mm`` and ``rotation_rad``.
    """
    count = len(mesh.nodes_mm)
    marker = np.full(count, -1, dtype=np.int64)
    marker[mesh.marker_nodes] = np.arange(len(mesh.marker_nodes))
    data: dict[str, Any] = {"normal": mesh.normals, "uv": mesh.uv, "marker": marker}
    for key, nodes in mesh.sets.items():
        data[key] = np.isin(np.arange(count), nodes).astype(np.int64)
    if motion is not None:
        data |= {"displacement_mm": motion[:, :3], "rotation_rad": motion[:, 3:]}
    return write_grid(path, mesh.nodes_mm, ("quad", mesh.quads), data)


def _edges(mesh: ShellMesh, nodes: IntArray) -> IntArray:
    """Element edges (k, 2) with both ends in ``nodes``, each once."""
    edges = np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    inside = np.isin(edges, nodes).all(axis=1)
    return np.asarray(np.unique(np.sort(edges[inside], axis=1), axis=0))
