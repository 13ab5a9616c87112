"""Linear jobs of eight-node shells (S8R) in CalculiX: many loads, one step each; its times."""

import os
import resource
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_shapes.arrays import FloatArray
from verification.quadratic_shell import QuadraticMesh

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "CCX_NPROC_EQUATION_SOLVER", "CCX_NPROC_STIFFNESS"), "1"
)
STOPPED = 201
"""Exit status of CalculiX after ``*NO ANALYSIS``."""


@dataclass(frozen=True, kw_only=True)
class CcxRun:
    """What CalculiX found and how long it took.

    Attributes
    ----------
    displacement_mm : (m, N, 3) float
        Displacement of every node under each load; empty without analysis.
    seconds : float
        Processor time of the whole process (one thread; other work on the machine does not count).
    equations : int
        Unknowns after its expansion of shells into bricks.
    """

    displacement_mm: FloatArray
    seconds: float
    equations: int


def run_linear(
    folder: Path,
    mesh: QuadraticMesh,
    loads: FloatArray,
    *,
    modulus_MPa: float,
    poisson: float,
    analysis: bool = True,
) -> CcxRun:
    """Run loads (m, N, 3) as m linear steps of one file, on one thread.

    ``analysis=False`` reads the file, expands the shells and stops (``*NO ANALYSIS``).
    """
    lines = [*_model(mesh, modulus_MPa, poisson)]
    for load in loads:
        lines += _step(load, analysis)
    (folder / "job.inp").write_text("\n".join(lines) + "\n", encoding="ascii")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = subprocess.run(
        ["ccx", "job"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **ONE_THREAD},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert run.returncode == (0 if analysis else STOPPED), run.stdout[-400:]
    if not analysis:
        return CcxRun(displacement_mm=np.zeros((0, 0, 3)), seconds=seconds, equations=0)
    tail = run.stdout.split("number of equations", 1)[1].split()
    found = _read(folder / "job.dat", len(mesh.nodes_mm))
    assert len(found) == len(loads), run.stdout[-400:]
    return CcxRun(displacement_mm=found, seconds=seconds, equations=int(tail[0]))


def _model(mesh: QuadraticMesh, modulus_MPa: float, poisson: float) -> Iterator[str]:
    yield "*NODE, NSET=ALL"
    for k, (x, y, z) in enumerate(mesh.nodes_mm.tolist(), start=1):
        yield f"{k}, {x:.12e}, {y:.12e}, {z:.12e}"
    yield "*ELEMENT, TYPE=S8R, ELSET=SHELL"
    for k, octet in enumerate((mesh.octets + 1).tolist(), start=1):
        yield f"{k}, {', '.join(map(str, octet))}"
    yield from ("*MATERIAL, NAME=RESIN", "*ELASTIC", f"{modulus_MPa:.9g}, {poisson:.9g}")
    yield from ("*SHELL SECTION, ELSET=SHELL, MATERIAL=RESIN", f"{mesh.linear.thickness_mm:.9g}")
    yield "*BOUNDARY"
    yield from (f"{k}, 1, 6" for k in (mesh.held + 1).tolist())


def _step(load: FloatArray, analysis: bool) -> Iterator[str]:
    yield from ("*STEP", "*STATIC" if analysis else "*NO ANALYSIS", "*CLOAD, OP=NEW")
    for node, axis in zip(*(k.tolist() for k in np.nonzero(load)), strict=True):
        yield f"{node + 1}, {axis + 1}, {load[node, axis]:.12e}"
    yield from ("*NODE PRINT, NSET=ALL", "U") if analysis else ()
    yield "*END STEP"


def _read(path: Path, count: int) -> FloatArray:
    steps: list[FloatArray] = []
    with path.open() as lines:
        for line in lines:
            row = line.split()
            if "displacements" in line:
                steps.append(np.full((count, 3), np.nan))
            elif len(row) == 4 and row[0].isdigit():
                steps[-1][int(row[0]) - 1] = [float(x) for x in row[1:]]
    return np.stack(steps)
