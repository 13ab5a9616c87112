"""CalculiX as an independent solver: reference jobs, their runs and results; for verification."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_design.mechanics.shell.mesh_writers import inp_loads, inp_material, inp_set, write_lines
from phytac_design.mechanics.solid.solid_mesh_tets import SolidMesh
from phytac_design.mechanics.solid.solid_writers import check_load, inp_solid
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import MissingPartError, NumericalError

LIMIT_S = 4.0 * 3600.0
"""Longest run of CalculiX."""
NO_CCX = "CalculiX (ccx) is not on PATH; apt-get install calculix-ccx"
TIGHT = (1e-4, 1e-3)
"""Limits on residual and correction of large-displacement jobs; CalculiX takes 0.005 and 0.01."""
BAND = 0.005
"""Moduli of elements are rounded to this fraction of the largest."""


def write_reference_inp(
    path: Path,
    mesh: SolidMesh,
    *,
    modulus_MPa: FloatArray,
    poisson: float,
    load: FloatArray,
    name: str,
    large: bool = False,
    first: float = 0.25,
) -> Path:
    """Write a job that prints the displacements of all nodes after every increment.

    Parameters
    ----------
    path : Path
        File to write.
    mesh : SolidMesh
        Solid mesh of the shell.
    modulus_MPa : (E,) float
        Modulus of each element, rounded to ``BAND`` of the largest.
    poisson : float
        Poisson's ratio.
    load : (N, 3) float
        Nodal forces, N.
    name : str
        Title for the heading.
    large : bool
        Large displacements (NLGEOM), to the limits ``TIGHT``, in automatic increments, the first
        of ``first`` of the load.
    """
    check_load(mesh, load)
    lines = [*inp_solid(mesh, mesh.sets, name), *_materials(modulus_MPa, poisson)]
    lines += ["*BOUNDARY", "TOP, 1, 3", "BOTTOM, 1, 3"]
    if large:
        lines += ["*STEP, NLGEOM, INC=200", "*STATIC", f"{first:g}, 1."]
        lines += ["*CONTROLS, PARAMETERS=FIELD", ", ".join(f"{limit:g}" for limit in TIGHT)]
    else:
        lines += ["*STEP", "*STATIC"]
    lines += inp_loads(load)
    lines += ["*NODE PRINT, NSET=ALL, FREQUENCY=1", "U", "*END STEP"]
    return write_lines(path, lines)


def _materials(modulus_MPa: FloatArray, poisson: float) -> Iterator[str]:
    """Lines of one material for each band of the elements' moduli."""
    step = BAND * float(modulus_MPa.max())
    band = np.rint(modulus_MPa / step).astype(np.int64)
    for k in np.unique(band).tolist():
        yield from inp_set("ELSET", f"BAND_{k}", np.flatnonzero(band == k))
        yield from inp_material(k * step, poisson, name=f"RESIN_{k}")
        yield f"*SOLID SECTION, ELSET=BAND_{k}, MATERIAL=RESIN_{k}"


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
        raise MissingPartError("missing-library", NO_CCX)
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
        raise NumericalError(
            "calculix-failed", f"ccx failed on {path.name} (code {run.returncode}): {text.strip()}"
        )
    return read_dat(table.read_text())


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
        raise NumericalError(
            "calculix-no-increments",
            f"ccx wrote no increments of {path.name}; was it an NLGEOM job?",
        )
    return Convergence(
        factor=float(done[-1][4]),
        increments=len(done),
        iterations=len(tried),
        residual=float(tried[-1][5]) / 100.0,
        correction=float(tried[-1][6]) / 100.0,
    )


def read_dat(text: str) -> list[dict[tuple[str, str], tuple[IntArray, FloatArray]]]:
    """Tables of the text of a ``.dat`` file, by time as :func:`run_ccx` returns them."""
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
        raise MissingPartError("missing-library", NO_CCX)
    run = subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False)
    found = re.search(r"Version +(\S+)", run.stdout)
    return found.group(1) if found else "unknown"
