"""Linear jobs of eight-node shells (S8R) in CalculiX: many loads, one step each; its times."""

import os
import resource
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_design.mechanics.shell.mesh_writers import inp_loads, write_lines
from phytac_shapes.arrays import FloatArray
from verification.calculix import read_dat
from verification.quadratic_shell import QuadraticMesh, model_lines


@dataclass(frozen=True, kw_only=True)
class CcxRun:
    """Results of CalculiX and its time.

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
    lines = model_lines(mesh, modulus_MPa, poisson)
    for load in loads:
        lines += ["*STEP", "*STATIC" if analysis else "*NO ANALYSIS"]
        lines += ["*CLOAD, OP=NEW", *list(inp_loads(load))[1:]]
        lines += ["*NODE PRINT, NSET=ALL", "U"] if analysis else []
        lines.append("*END STEP")
    write_lines(folder / "job.inp", lines)
    names = ("OMP_NUM_THREADS", "CCX_NPROC_EQUATION_SOLVER", "CCX_NPROC_STIFFNESS")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = subprocess.run(
        ["ccx", "job"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **dict.fromkeys(names, "1")},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    # CalculiX exits with 201 after *NO ANALYSIS.
    assert run.returncode == (0 if analysis else 201), run.stdout[-400:]
    if not analysis:
        return CcxRun(displacement_mm=np.zeros((0, 0, 3)), seconds=seconds, equations=0)
    tail = run.stdout.split("number of equations", 1)[1].split()
    tables = read_dat((folder / "job.dat").read_text())
    found = np.stack([table["displacements", "ALL"][1] for table in tables])
    assert len(found) == len(loads), run.stdout[-400:]
    return CcxRun(displacement_mm=found, seconds=seconds, equations=int(tail[0]))
