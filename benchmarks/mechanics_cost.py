"""Seconds and memory of a linear solution against its size, each size in a process of its own."""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table, median_of
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.factor import SUPERLU
from phytac_design.mechanics.shell.shell_element import element_stiffness
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes import Cylinder

SIZES = ((36, 48), (62, 84), (114, 150), (200, 260), (370, 450))
"""Elements along and around: 10⁴ to 10⁶ DOF."""
PARTS = ("elements", "assembly", "factorisation", "one solve")
MODULUS_MPa, POISSON = 2200.0, 0.38


def python(*arguments: str) -> str:
    """Run Python on code or on a module with arguments; what it prints."""
    how = ["-c"] if len(arguments) == 1 else ["-m"]
    run = subprocess.run(
        [sys.executable, *how, *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=1800.0,
        cwd=Path(__file__).parents[1],
    )
    return run.stdout


def _mesh(along: int, around: int) -> ShellMesh:
    surface = Cylinder(diameter_outer_mm=60.0, length_mm=120.0)
    return chart_mesh(surface, thickness_mm=0.8, n_along=along, n_around=around)


def solver(table: Table, *, quick: bool) -> None:
    """Assembly against factorisation; our solver settings against SciPy's."""
    from scipy.sparse.linalg import splu

    for size in ((24, 32),) if quick else ((48, 64), (70, 96)):
        mesh = _mesh(*size)
        model = clamped_model(mesh, modulus_MPa=MODULUS_MPa, poisson=POISSON)
        matrix = model.factor.scaled
        count = matrix.shape[0]
        build_s = median_of(
            partial(clamped_model, mesh, modulus_MPa=MODULUS_MPa, poisson=POISSON), 5
        )
        elements = partial(element_stiffness, mesh.nodes_mm, mesh.quads, mesh.normals)
        element_s = median_of(partial(elements, poisson=POISSON), 5)
        ours_s = median_of(partial(splu, matrix, **SUPERLU), 3)
        default_s = median_of(partial(splu, matrix), 1 if quick else 3)
        row = f"speed: elements, assembly and checks / factorisation, {count} DOF"
        source = "factorisation in the same run"
        note = f"{build_s:.3f} s, of which the elements {element_s:.3f} s"
        table.add(row, build_s / ours_s, "x", ours_s, source, "<= 0.5", note)
        row = f"speed: factorisation, {count} DOF: SciPy default seconds / ours"
        source = "scipy.sparse.linalg.splu, default settings"
        table.add(row, default_s / ours_s, "x", default_s, source, ">= 1", f"ours {ours_s:.3f} s")


def measure(along: int, around: int) -> dict[str, Any]:
    """Seconds of each part and peak memory of one size, in this process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    # The child gives up beyond 16 GiB of address space; it uses some three quarters of it.
    resource.setrlimit(resource.RLIMIT_AS, (int(16.0 * 2**30), hard))
    mesh = _mesh(along, around)
    seconds: dict[str, float] = {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        start = time.process_time()
        out = work()
        seconds[name] = time.process_time() - start
        return out

    model = clamped_model(mesh, modulus_MPa=MODULUS_MPa, poisson=POISSON)
    timed(
        "elements",
        lambda: element_stiffness(mesh.nodes_mm, mesh.quads, mesh.normals, poisson=POISSON),
    )
    timed(
        "assembly",
        lambda: assemble(
            make_pattern(mesh.quads, len(mesh.nodes_mm)),
            model.elements.combine(modulus_MPa=MODULUS_MPa, thickness_mm=mesh.thickness_mm),
        ),
    )
    factor = timed("factorisation", lambda: model.factor)
    timed("one solve", lambda: factor.backend.solve(np.ones(factor.scale.size)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    return {"dof": factor.scale.size, "seconds": seconds, "peak_GiB": peak}


def exponent(x: list[float], y: list[float]) -> float:
    """Slope of the line through the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def add_rows(table: Table, *, sizes: tuple[tuple[int, int], ...] = SIZES) -> None:
    """Seconds, memory and exponents over ``sizes``."""
    runs: list[dict[str, Any]] = []
    for along, around in sizes:
        try:
            text = python("benchmarks.mechanics_cost", str(along), str(around))
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            why = str(getattr(error, "stderr", "") or error).strip().splitlines()[-1:]
            print(f"superlu stops at {along} × {around}: {why}", flush=True)
            break
        runs.append(json.loads(text))
        run, seconds = runs[-1], runs[-1]["seconds"]
        row = f"cost: superlu, {run['dof']} DOF"
        source = "processor time, one thread, process of its own"
        each = "; ".join(f"{name} {seconds[name]:.3g} s" for name in PARTS)
        note = f"{each}; peak memory {run['peak_GiB']:.2f} GiB"
        table.add(row, sum(seconds.values()), "s", "-", source, note=note)
    if len(runs) < 2:
        return
    dof = [float(run["dof"]) for run in runs]
    columns = {name: [run["seconds"][name] for run in runs] for name in PARTS}
    columns["peak memory"] = [run["peak_GiB"] for run in runs]
    theory = {"elements": 1.0, "assembly": 1.0, "factorisation": 1.5}
    for name, values in columns.items():
        row = f"cost: superlu, exponent of {name} over {dof[0]:.0f} to {dof[-1]:.0f} DOF"
        source = "theory of nested dissection in the plane" if name in theory else "fit"
        table.add(row, exponent(dof, values), "-", theory.get(name, "-"), source)


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]), int(sys.argv[2]))))
