"""Large-displacement rows of ``mechanics``: published cases, CalculiX, one sample's time."""

import os

# One BLAS thread: SuperLU's many small products run slower on several, most of all when shared.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design_file import load_design
from phytac_design.mechanics.large import large_cases
from phytac_design.mechanics.large.estimate import check_linear
from phytac_design.mechanics.large.graded import contact_mesh
from phytac_design.mechanics.large.newton import Loading
from phytac_design.mechanics.large.path import solve_large
from phytac_design.mechanics.large.quadratic import quadratic_mesh, quadratic_patch, run_ccx
from phytac_design.mechanics.loads import patch_loads
from phytac_design.mechanics.mesh import chart_mesh
from phytac_design.mechanics.solve import ShellModel, clamped_model
from shapes.arrays import FloatArray

FINGERTIP_MM = 6.0
CCX = ((28, 32), (42, 48), (64, 74))
GRADED = ((1.8, 0.15), (1.5, 0.1), (1.0, 0.1), (0.7, 0.07))
MISSED = "; at the tabled sag 0.1741, 0.1714, 0.1694 at 8, 12, 32 a side: falls with refinement"


def published(table: Table, *, quick: bool) -> None:
    """Published large displacements: error in percent of the tabled value."""
    hemisphere, roof, tube = (16, 12, 32) if quick else (40, 24, 96)
    for case in large_cases.comparisons(strip=24, hemisphere=hemisphere, roof=roof, tube=tube):
        ours_only = case.reference == 0.0
        table.add(
            f"large: {case.name}",
            case.error * (1.0 if ours_only else 100.0),
            "length" if ours_only else "%",
            reference=case.reference,
            source="design study" if "tube" in case.name else "Sze, Liu and Lo 2004",
            target="<= 1e-6" if ours_only else "<= 1",
            note=f"ours {case.ours:.5g}" + (MISSED if case.error > 0.01 else ""),
        )


def fingertip(table: Table, *, quick: bool) -> None:
    """25 N on a fingertip: ccx NLGEOM at converged meshes, seconds a sample, honest estimate."""
    design, force, centre = load_design("cylinder60"), 25.0, np.array([60.0, np.pi])
    surface = design.surface()
    wall, material = design.wall.thickness_mm, design.material
    kind = {"modulus_MPa": material.modulus_MPa, "poisson": material.poisson}
    theirs: float | None = None
    for along, around in () if shutil.which("ccx") is None else ((20, 24),) if quick else CCX:
        even = chart_mesh(surface, thickness_mm=wall, n_along=along, n_around=around)
        mesh8 = quadratic_mesh(even, surface)
        load8 = force * quadratic_patch(mesh8, surface, centre, FINGERTIP_MM)
        with tempfile.TemporaryDirectory() as folder:
            moved = run_ccx(Path(folder), mesh8, load8, **kind)
        theirs = float(np.linalg.norm(moved, axis=1).max())
        table.add(
            f"large: {force:g} N on a fingertip, ccx NLGEOM S8R {along} × {around}, peak",
            theirs,
            "mm",
            reference="-",
            source="CalculiX",
        )
    for size, growth in ((2.0, 0.15),) if quick else GRADED:
        fine = {"core_mm": 12.0, "size_mm": size, "growth": growth, "thickness_mm": wall}
        mesh = contact_mesh(surface, centre_uv=centre, **fine)
        model = clamped_model(mesh, modulus_MPa=material.modulus_MPa, poisson=material.poisson)
        unit = patch_loads(mesh, surface, centre[None], FINGERTIP_MM)
        peak = float(np.linalg.norm(_large(model, force * unit), axis=1).max())
        name = f"{force:g} N on a fingertip, {np.sum(~model.fixed)} DOF graded to {size} mm"
        if theirs is not None:
            table.add(
                f"large: {name}: peak against ccx NLGEOM S8R at its finest",
                abs(peak / theirs - 1.0) * 100.0,
                "%",
                reference=theirs,
                source="CalculiX, NLGEOM, S8R",
                target="<= 1" if (size, growth) == GRADED[-1] else None,
                note=f"ours {peak:.4f} mm",
            )
        start, spent = time.perf_counter(), time.process_time()
        _large(model, force * unit)
        spans = time.perf_counter() - start, time.process_time() - spent
        for seconds, clock in zip(spans, ("wall clock", "processor time"), strict=True):
            table.add(
                f"large: {name}: one sample, shell factored at rest, {clock}",
                seconds,
                "s",
                reference=1.0,
                source="project target, at >= 8000 DOF",
                target="<= 1" if (size, growth) == GRADED[0] else None,
                note=f"one thread; load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
            )
        if (size, growth) == GRADED[0]:
            _honesty(table, model, unit)


def _large(model: ShellModel, load: Any) -> FloatArray:
    return solve_large(model, Loading(force=load))[0].state.displacement_mm


def _honesty(table: Table, model: ShellModel, unit: Any) -> None:
    """Estimated against true error of linear theory, over forces."""
    for force in (1.0, 3.0, 10.0, 25.0, 50.0, -25.0):
        linear = model.solve(force * unit).motion[:, :3, 0]
        large = _large(model, force * unit)
        off = np.linalg.norm(large - linear, axis=1).max() / np.linalg.norm(linear, axis=1).max()
        ratio = check_linear(model, force * unit).error / off
        table.add(
            f"large: linear theory's error, {force:g} N on a fingertip, estimate off by a factor",
            max(ratio, 1.0 / ratio),
            "x",
            reference=float(off),
            source="large-displacement solution on the same mesh",
            target="<= 2",
            note=f"estimate / truth = {ratio:.3f}; the reference is the true relative error",
        )
