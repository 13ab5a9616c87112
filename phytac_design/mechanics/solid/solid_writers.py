"""Solid meshes for other programs (``.inp``, ``.msh``, ``.vtu``), and CalculiX run on them.

Numbering starts at 1: node k of the mesh is node k + 1 of the file.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_design.mechanics.solid.solid_mesh_tets import SolidMesh
from phytac_design.mechanics.solid.tetrahedra import Tetrahedra
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import MissingPartError, NumericalError

PER_LINE = 10
"""Labels per line of a set (Abaqus allows 16, lines of 80 characters fewer)."""
LIMIT_S = 4.0 * 3600.0
"""Longest run of CalculiX."""
NO_CCX = "CalculiX (ccx) is not on PATH; apt-get install calculix-ccx"
TIGHT = (1e-4, 1e-3)
"""Limits on residual and correction of jobs that are to be a reference."""
BAND = 0.005
"""Moduli of elements are rounded to this fraction of the largest."""


def write_solid_inp(
    path: Path,
    mesh: SolidMesh,
    *,
    modulus_MPa: float | FloatArray,
    poisson: float,
    load: FloatArray,
    name: str,
    large: bool = False,
    first: float = 0.25,
    tight: bool = False,
    everywhere: bool = False,
) -> Path:
    """Write a job that ``ccx`` (and Abaqus) runs as it is.

    C3D10 in element set SHELL, node sets ALL, TOP, BOTTOM, TIP_i and TIPS (their union), both
    rims held, one *STATIC step with the load as *CLOAD. Displacements of all nodes go to the
    result file, those of TIPS also to the printed file, after the last increment.

    Parameters
    ----------
    path : Path
        File to write.
    mesh : SolidMesh
        Solid mesh of the shell.
    modulus_MPa : float or (E,) float
        Modulus; of each element, it is rounded to ``BAND`` of the largest.
    poisson : float
        Poisson's ratio.
    load : (N, 3) float
        Nodal forces, N, e.g. a force times :func:`solid_load.solid_patch_load`.
    name : str
        Title for the heading.
    large : bool
        Large displacements (NLGEOM), in automatic increments, the first of ``first`` of the load.
    tight : bool
        Iterate until residual forces are below ``TIGHT[0]`` of the mean force and the correction
        below ``TIGHT[1]`` of the increment; CalculiX takes 0.005 and 0.01.
    everywhere : bool
        Print displacements of all nodes after every increment instead.
    """
    if np.shape(load) != mesh.nodes_mm.shape or not np.all(np.isfinite(load)):
        raise NumericalError(
            f"the load needs three finite forces per node, {mesh.nodes_mm.shape} "
            f"(got {np.shape(load)})"
        )
    lines = [*inp_mesh(mesh, mesh.sets, name), *_materials(modulus_MPa, poisson)]
    lines += ["*BOUNDARY", "TOP, 1, 3", "BOTTOM, 1, 3"]
    lines += (
        ["*STEP, NLGEOM, INC=200", "*STATIC", f"{first:g}, 1."] if large else ["*STEP", "*STATIC"]
    )
    if tight:
        lines += ["*CONTROLS, PARAMETERS=FIELD", ", ".join(f"{limit:g}" for limit in TIGHT)]
    lines.append("*CLOAD")
    lines += [
        f"{node + 1}, {dof + 1}, {load[node, dof]:.12e}"
        for node, dof in zip(*np.nonzero(load), strict=True)
    ]
    if everywhere:
        lines += ["*NODE PRINT, NSET=ALL, FREQUENCY=1", "U"]
        return write_lines(path, [*lines, "*END STEP"])
    lines += ["*NODE FILE", "U"]
    if mesh.tips:
        lines += [f"*NODE PRINT, NSET=TIPS{', FREQUENCY=200' if large else ''}", "U"]
    return write_lines(path, [*lines, "*END STEP"])


def inp_mesh(mesh: Tetrahedra, sets: Mapping[str, IntArray], name: str) -> Iterator[str]:
    """Lines of heading, nodes, C3D10 elements, node sets and their union of TIP_i, TIPS."""
    yield "*HEADING"
    yield f"{name}: solid of quadratic tetrahedra; mm, N, MPa; z away from the camera"
    yield "*NODE, NSET=ALL"
    for label, (x, y, z) in enumerate(mesh.nodes_mm.tolist(), start=1):
        yield f"{label}, {x:.12e}, {y:.12e}, {z:.12e}"
    yield "*ELEMENT, TYPE=C3D10, ELSET=SHELL"
    for label, nodes in enumerate((mesh.tets + 1).tolist(), start=1):
        yield f"{label}, {', '.join(map(str, nodes[:6]))},"
        yield ", ".join(map(str, nodes[6:]))
    for key, part in sets.items():
        yield f"*NSET, NSET={key}"
        yield from _labels(part)
    tips = [key for key in sets if key.startswith("TIP_")]
    if tips:
        yield "*NSET, NSET=TIPS"
        yield from tips


def _materials(modulus_MPa: float | FloatArray, poisson: float) -> Iterator[str]:
    """Lines of one material, or of one for each band of the elements' moduli."""
    if np.ndim(modulus_MPa) == 0:
        yield from inp_material(float(modulus_MPa), poisson)
        return
    values = np.asarray(modulus_MPa, dtype=np.float64)
    step = BAND * float(values.max())
    band = np.rint(values / step).astype(np.int64)
    for k in np.unique(band).tolist():
        yield f"*ELSET, ELSET=BAND_{k}"
        yield from _labels(np.flatnonzero(band == k))
        yield f"*MATERIAL, NAME=RESIN_{k}"
        yield "*ELASTIC"
        yield f"{k * step:.9g}, {poisson:.9g}"
        yield f"*SOLID SECTION, ELSET=BAND_{k}, MATERIAL=RESIN_{k}"


def _labels(members: IntArray) -> Iterator[str]:
    """Lines of a set."""
    labels = (np.sort(members) + 1).tolist()
    for first in range(0, len(labels), PER_LINE):
        yield ", ".join(map(str, labels[first : first + PER_LINE]))


def inp_material(modulus_MPa: float, poisson: float) -> Iterator[str]:
    """Lines of an isotropic material for all elements."""
    yield "*MATERIAL, NAME=RESIN"
    yield "*ELASTIC"
    yield f"{modulus_MPa:.9g}, {poisson:.9g}"
    yield "*SOLID SECTION, ELSET=SHELL, MATERIAL=RESIN"


def write_lines(path: Path, lines: Iterable[str]) -> Path:
    """Write lines as ASCII with Unix ends."""
    path.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace", newline="\n")
    return path


def write_solid_msh(path: Path, mesh: SolidMesh) -> Path:
    """Write Gmsh 2.2 (text): physical groups SHELL, TOP, BOTTOM, OUTER, and TIP_i (triangles)."""
    import meshio

    ends = [
        (key, np.flatnonzero(np.isin(mesh.triangles, mesh.sets[key]).all(axis=1)))
        for key in ("TOP", "BOTTOM")
    ]
    tips = [(f"TIP_{i}", part) for i, part in enumerate(mesh.tips)]
    faces = [*ends, ("OUTER", mesh.outer), *tips]
    cells = [("tetra10", mesh.tets), *(("triangle6", mesh.triangles[part]) for _, part in faces)]
    label = [np.full(len(part), tag) for tag, (_, part) in enumerate(cells, start=1)]
    names = {"SHELL": np.array([1, 3])}
    names |= {key: np.array([tag, 2]) for tag, (key, _) in enumerate(faces, start=2)}
    out = meshio.Mesh(
        mesh.nodes_mm,
        cells,
        cell_data={"gmsh:physical": label, "gmsh:geometrical": label},
        field_data=names,
    )
    meshio.write(path, out, file_format="gmsh22", binary=False)
    return path


def write_solid_vtu(path: Path, mesh: SolidMesh, *, motion: FloatArray | None = None) -> Path:
    """Write a VTK unstructured grid with the receptor of each end-face node (-1 elsewhere).

    ``motion`` (N, 3), mm, adds point data ``displacement_mm``.
    """
    import meshio

    tip = np.full(len(mesh.nodes_mm), -1, dtype=np.int64)
    for i in range(len(mesh.tips)):
        tip[mesh.sets[f"TIP_{i}"]] = i
    data: dict[str, FloatArray | IntArray] = {"receptor": tip}
    if motion is not None:
        data["displacement_mm"] = motion
    meshio.write(
        path,
        meshio.Mesh(mesh.nodes_mm, [("tetra10", mesh.tets)], point_data=data),
        file_format="vtu",
    )
    return path


def run_ccx(path: Path) -> list[dict[tuple[str, str], tuple[IntArray, FloatArray]]]:
    """Run CalculiX on a job, one thread, and read its printed tables.

    Parameters
    ----------
    path : Path
        The ``.inp`` file; results are written beside it.

    Returns
    -------
    list of dict
        One per printed time: (quantity, set) as printed, e.g. ``("displacements", "TIPS")`` or
        ``("forces", "TOP")``, to node indices (k,), from 0, and values (k, 3).

    Raises
    ------
    MissingPartError
        If ``ccx`` is not on PATH.
    NumericalError
        If it reports an error or does not converge.
    """
    if shutil.which("ccx") is None:
        raise MissingPartError(NO_CCX)
    run = subprocess.run(
        ["ccx", path.stem],
        cwd=path.parent,
        env={**os.environ, "OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT_S,
    )
    table = path.with_suffix(".dat")
    bad = re.search(r"\*ERROR.*(?:\n.*)?", run.stdout)
    if run.returncode or bad or not table.exists():
        text = bad.group(0) if bad else run.stdout[-300:] + run.stderr[-300:]
        raise NumericalError(f"ccx failed on {path.name} (code {run.returncode}): {text.strip()}")
    return _read_dat(table.read_text())


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """How a job with increments went.

    Attributes
    ----------
    factor : float
        Share of the load that was reached.
    increments, iterations : int
        Converged increments, and iterations of all attempts.
    residual, correction : float
        Of the last iteration: largest residual force over the mean force, and largest correction
        over the increment's largest displacement.
    """

    factor: float
    increments: int
    iterations: int
    residual: float
    correction: float


def read_convergence(path: Path) -> Convergence:
    """Read what CalculiX wrote beside a finished job about its increments.

    Raises
    ------
    NumericalError
        If it wrote nothing.
    """
    tables = []
    for suffix, columns in ((".sta", 7), (".cvg", 9)):
        text = path.with_suffix(suffix).read_text() if path.with_suffix(suffix).exists() else ""
        rows = [row.split() for row in text.splitlines()]
        tables.append([row for row in rows if len(row) == columns and row[0].isdigit()])
    done, tried = tables
    if not (done and tried):
        raise NumericalError(f"ccx wrote no increments of {path.name}; was it an NLGEOM job?")
    return Convergence(
        factor=float(done[-1][4]),
        increments=len(done),
        iterations=len(tried),
        residual=float(tried[-1][5]) / 100.0,
        correction=float(tried[-1][6]) / 100.0,
    )


def _read_dat(text: str) -> list[dict[tuple[str, str], tuple[IntArray, FloatArray]]]:
    """Tables of a ``.dat`` file by time."""
    head = re.compile(r"^ *(\w+) \([^)]*\) for set (\S+) and time +(\S+)$", re.MULTILINE)
    marks = list(head.finditer(text))
    times: dict[float, dict[tuple[str, str], tuple[IntArray, FloatArray]]] = {}
    for k, mark in enumerate(marks):
        stop = marks[k + 1].start() if k + 1 < len(marks) else len(text)
        rows = [row.split() for row in text[mark.end() : stop].splitlines()]
        table = np.array([row for row in rows if len(row) == 4], dtype=np.float64).reshape(-1, 4)
        key = (mark.group(1), mark.group(2))
        times.setdefault(float(mark.group(3)), {})[key] = (
            table[:, 0].astype(np.int64) - 1,
            table[:, 1:],
        )
    return list(times.values())


def ccx_version() -> str:
    """Version of the CalculiX on PATH.

    Raises
    ------
    MissingPartError
        If there is none.
    """
    if shutil.which("ccx") is None:
        raise MissingPartError(NO_CCX)
    run = subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False)
    found = re.search(r"Version +(\S+)", run.stdout)
    return found.group(1) if found else "unknown"
