"""Quadratic tetrahedra by Gmsh, which is imported in this module only."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import MissingPartError, NumericalError

GMSH_TET10, GMSH_TRIANGLE6 = 11, 9
"""Element type numbers of Gmsh."""
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
"""Corners that each mid-edge node of a tetrahedron lies between."""


@dataclass(frozen=True, kw_only=True)
class Tetrahedra:
    """A mesh of quadratic tetrahedra and the quadratic triangles of its boundary.

    Attributes
    ----------
    nodes_mm : (N, 3) float
        Node positions, mm; curved edges have their middle node on the CAD.
    tets : (E, 10) int
        Nodes in the order of Abaqus, CalculiX (C3D10) and VTK: 4 corners, then the edges 0-1,
        1-2, 2-0, 0-3, 1-3, 2-3.
    triangles : (F, 6) int
        Boundary faces: 3 corners, then the edges 0-1, 1-2, 2-0.
    """

    nodes_mm: FloatArray
    tets: IntArray
    triangles: IntArray


def _gmsh() -> Any:
    """Import Gmsh, whose library links X11 and OpenGL even where nothing is drawn."""
    try:
        import gmsh  # type: ignore[import-untyped]  # it ships no types
    except (ImportError, OSError) as error:
        raise MissingPartError(
            "missing-library",
            f"no solid meshes: gmsh cannot be imported ({error}); pip install gmsh, and on "
            "Debian/Ubuntu: sudo apt-get install libglu1-mesa libxcursor1 libxinerama1 libxft2",
        ) from error
    return gmsh


def tetrahedra(
    build: Callable[[Any], None], size: Callable[[Any], int], *, extend: bool = True
) -> Tetrahedra:
    """Mesh what ``build`` makes.

    Parameters
    ----------
    build : callable
        Makes the geometry with the Gmsh module handed in (``gmsh.model.occ``), without
        synchronising.
    size : callable
        Makes mesh-size fields with the Gmsh module handed in, and returns the tag of the one to
        use.
    extend : bool
        Whether the sizes of curves also bound those of the faces between them, however far.

    Raises
    ------
    MissingPartError
        If Gmsh is not installed.
    NumericalError
        If Gmsh cannot mesh the shape, or an element comes out folded.
    """
    gmsh = _gmsh()
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        for key, value in (
            ("General.Terminal", 0),
            ("General.NumThreads", 1),
            ("Mesh.MeshSizeFromPoints", 0),
            ("Mesh.MeshSizeExtendFromBoundary", int(extend)),
            ("Mesh.RandomSeed", 1),
            ("Mesh.ElementOrder", 2),
            ("Mesh.HighOrderOptimize", 0),
        ):
            gmsh.option.setNumber(key, value)
        build(gmsh)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.field.setAsBackgroundMesh(size(gmsh))
        gmsh.model.mesh.generate(3)
        return _read(gmsh)
    except NumericalError:
        raise
    except Exception as error:  # gmsh raises bare Exceptions
        raise NumericalError(
            "gmsh-failed",
            f"gmsh cannot mesh the solid ({error}); make the mesh sizes smaller than the "
            "smallest wall, or check the design with `phytac check`",
        ) from error
    finally:
        gmsh.finalize()


def _read(gmsh: Any) -> Tetrahedra:
    """Mesh of the current model, nodes renumbered without gaps."""
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    _, flat = gmsh.model.mesh.getElementsByType(GMSH_TET10)
    _, faces = gmsh.model.mesh.getElementsByType(GMSH_TRIANGLE6)
    # Gmsh numbers the last two mid-edge nodes of a tetrahedron the other way round than Abaqus.
    tets, triangles = flat.reshape(-1, 10)[:, [*range(8), 9, 8]], faces.reshape(-1, 6)
    used = np.unique(tets)
    order = np.argsort(tags)
    place = order[np.searchsorted(tags[order], used)]
    nodes = np.asarray(xyz, dtype=np.float64).reshape(-1, 3)[place]
    mesh = _straighten(
        Tetrahedra(
            nodes_mm=nodes,
            tets=np.searchsorted(used, tets).astype(np.int64),
            triangles=np.searchsorted(used, triangles).astype(np.int64),
        )
    )
    worst = float(jacobian_ratio(mesh).min(initial=np.inf))
    if not 1e-3 < worst < np.inf:
        raise NumericalError(
            "solid-element-folded",
            f"a solid element is folded (least Jacobian over largest {worst:.2g}, {len(tets)} "
            "elements); make the mesh sizes smaller where faces curve",
        )
    return mesh


def _straighten(mesh: Tetrahedra) -> Tetrahedra:
    """Pull the middle nodes of folded elements (flat ones on a curved face) onto straight edges."""
    nodes = mesh.nodes_mm.copy()
    i, j = np.array(EDGES).T
    steps, good_jacobian = 5, 0.1
    for _ in range(steps):
        now = replace(mesh, nodes_mm=nodes)
        bad = mesh.tets[jacobian_ratio(now) < good_jacobian]
        if not len(bad):
            break
        nodes[bad[:, 4:]] = (nodes[bad[:, i]] + nodes[bad[:, j]]) / 2.0
    return replace(mesh, nodes_mm=nodes)


def jacobian_ratio(mesh: Tetrahedra) -> FloatArray:
    """Least over largest Jacobian at the 10 nodes of each tetrahedron, (E,); 1 if straight."""
    corner = np.vstack([np.eye(4), [(np.eye(4)[i] + np.eye(4)[j]) / 2.0 for i, j in EDGES]])
    X = mesh.nodes_mm[mesh.tets]
    det = np.stack(
        [np.linalg.det(np.einsum("ai,eik->eak", shape_tet(L)[1], X)) for L in corner], axis=1
    )
    return np.asarray(det.min(axis=1) / np.abs(det).max(axis=1))


def shape_tet(L: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shape functions (10,) at barycentric ``L`` (4,), and their derivatives (3, 10) by L1…L3."""
    i, j = np.array(EDGES).T
    h = np.concatenate([L * (2.0 * L - 1.0), 4.0 * L[i] * L[j]])
    d = np.zeros((4, 10))
    d[np.arange(4), np.arange(4)] = 4.0 * L - 1.0
    d[i, 4 + np.arange(6)] = 4.0 * L[j]
    d[j, 4 + np.arange(6)] = 4.0 * L[i]
    return h, d[1:] - d[0]
