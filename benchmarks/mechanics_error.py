"""The estimate of the mesh's error against the truth, what it costs, and rates of convergence."""

import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.mechanics.meshing.mesh import chart_mesh
from phytac_design.mechanics.shell.discretisation import (
    DiscretisationError,
    ProbedShell,
    estimate_error,
    sensor_shell,
)
from phytac_shapes.arrays import FloatArray
from verification import shells as cases
from verification.quadratic_shell import quadratic_mesh, quadratic_patch, run_ccx
from verification.shells import ShellProblem, edge_lines, plate_case, probed

BOTH, END = (True, True), (False, True)
ROOF_EDGE = 0.25 / (25.0 * np.radians(40.0))
RESOLVED = "64 and 32 a side with the free edges' layers resolved, extrapolated"
FINEST = "128 and 64 a side, extrapolated, with our term for free edges"
HONEST = "<= 2"
S8R_FORCE_N = 0.01
"""So small that NLGEOM is linear."""


@dataclass(frozen=True)
class Trial:
    """A published shell: its mesh of n, the mesh for the truth, and the sizes tried."""

    name: str
    build: Callable[[int], ShellProblem]
    resolved: Callable[[int], ShellProblem]
    sizes: tuple[int, ...] = (8, 16, 32)
    fine: int = 64
    source: str = RESOLVED


def trials() -> list[Trial]:
    """All of them."""
    out = [
        Trial(
            "Scordelis-Lo roof",
            cases.scordelis_lo_case,
            lambda n: cases.scordelis_lo_case(
                (edge_lines(n, ROOF_EDGE, ends=END), edge_lines(n, 0.01, ends=END))
            ),
        ),
        Trial(
            "hemisphere, 18° hole",
            cases.hemisphere_with_hole_case,
            lambda n: cases.hemisphere_with_hole_case((n, edge_lines(n, 0.04 / 12.57, ends=BOTH))),
        ),
        Trial(
            "full hemisphere",
            cases.full_hemisphere_case,
            cases.full_hemisphere_case,
            fine=128,
            source=FINEST,
        ),
        Trial(  # nine along: the joint of the two arcs stays in place
            "Raasch hook, n × n/2",
            cases.raasch_hook_case,
            lambda n: cases.raasch_hook_case(n, across=edge_lines(n // 2, 0.1, ends=BOTH)),
            sizes=(18, 36),
            fine=72,
        ),
    ]
    out += [
        Trial(
            f"free hyperboloid t = {t}",
            partial(cases.hyperboloid_case, thickness=t),
            partial(_hyperboloid, t),
        )
        for t in cases.HYPERBOLOID
    ]
    out += [
        Trial(
            f"twisted beam, force {'along' if along else 'across'} the width, n × n/4",
            partial(_beam, along),
            partial(_beam, along),
            fine=128,
            source="128 and 64 along, which resolve the free edges' layers, extrapolated",
        )
        for along in (True, False)
    ]
    return out


def _hyperboloid(t: float, n: int) -> ShellProblem:
    return cases.hyperboloid_case((n, edge_lines(n, t / 1.3, ends=END)), thickness=t)


def _beam(along: bool, n: int) -> ShellProblem:
    return cases.twisted_beam_case(n, in_plane=along, across=n // 4)


def true_motion(trial: Trial, points: FloatArray, fine: int) -> FloatArray:
    """Motion (n, 3, 1) at ``points`` extrapolated from meshes of ``fine`` and half of it."""
    if trial.source == FINEST:
        return estimate_error(
            lambda n: probed(trial.resolved(n), points), (fine, fine // 2)
        ).extrapolated
    parts = [probed(trial.resolved(n), points) for n in (fine, fine // 2)]
    one, two = (part.read(part.model.solve(part.loads).motion) for part in parts)
    return np.asarray(one + (one - two) / 3.0)


def largest(field: FloatArray) -> float:
    """Largest length of vectors (n, 3, ...)."""
    return float(np.linalg.norm(field, axis=1).max())


def honesty_row(
    table: Table, name: str, found: DiscretisationError, truth: FloatArray, source: str
) -> None:
    """Row: by what factor the estimate is off."""
    true = largest(truth - found.motion)
    ratio = float(found.error.max()) / true
    rest = largest(truth - found.extrapolated) / largest(truth) * 100.0
    row = f"mesh error: {name}: estimate off by a factor"
    note = (
        f"estimate / truth = {ratio:.2f}; the reference is the true error over the peak; "
        f"{rest:.2g} % of it left by extrapolation"
        + ("" if found.asymptotic.all() else "; flagged as not asymptotic")
    )
    table.add(row, max(ratio, 1.0 / ratio), "x", true / largest(truth), source, HONEST, note)


def published(table: Table, *, quick: bool) -> None:
    """Published shells: the largest error of all nodes of a coarse mesh."""
    for trial in trials()[:2] if quick else trials():
        points = {n: trial.build(n // 2).mesh.nodes for n in trial.sizes}
        ends = np.cumsum([0, *(len(part) for part in points.values())])
        everywhere = np.concatenate(list(points.values()))
        truth = true_motion(trial, everywhere, 32 if quick else trial.fine)
        for k, n in enumerate(trial.sizes[:1] if quick else trial.sizes):
            found = estimate_error(
                lambda m, t=trial, p=points[n]: probed(t.build(m), p),  # type: ignore[misc]  # defaults bind the loop's values
                (n, n // 2),
            )
            part = truth[ends[k] : ends[k + 1]]
            honesty_row(table, f"{trial.name}, {n} a side", found, part, trial.source)
    top = cases.pinched_cylinder_case(4).mesh.nodes[[0]]
    for n in (8,) if quick else (8, 16, 32):
        found = estimate_error(lambda m: probed(cases.pinched_cylinder_case(m), top), (n, n // 2))
        truth = np.array([[[0.0], [0.0], [-1.82488e-5]]])
        honesty_row(table, f"pinched cylinder, {n} a side", found, truth, "published reference")


def sensor(table: Table, *, quick: bool) -> None:
    """cylinder60 under fingertips of two sizes anywhere, markers' tips and contacts."""
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    wall, material = design.wall.thickness_mm, design.material
    kind = {"modulus_MPa": material.modulus_MPa, "poisson": material.poisson}
    centres = np.array([[60.0, np.pi], [33.0, 1.234], [17.3, 4.4], [97.1, 2.7]])
    for radius in (6.0,) if quick else (6.0, 3.0):
        make = sensor_shell(
            surface, markers, thickness_mm=wall, centres_uv=centres, radii_mm=radius, **kind
        )
        truth = estimate_error(make, (8, 4) if quick else (16, 8)).extrapolated
        for refine in ((4, 2),) if quick else ((4, 2), (6, 3), (8, 4)):
            found = estimate_error(make, refine)
            for k in range(len(centres)):
                one = DiscretisationError(
                    motion=found.motion[..., k],
                    extrapolated=found.extrapolated[..., k],
                    error=found.error[:, k],
                    relative=found.relative[[k]],
                    asymptotic=found.asymptotic[[k]],
                    elements=found.elements,
                )
                honesty_row(
                    table,
                    f"cylinder60, radius {radius:g} mm, contact {k}, refine {refine[0]}",
                    one,
                    truth[..., k],
                    "refine 16 and 8, extrapolated",
                )
            if radius == 6.0:
                _each_marker(table, refine[0], found, truth)
        if radius == 6.0:
            _cost(table, make, ((4, 2),) if quick else ((6, 3),))
    if quick or shutil.which("ccx") is None:
        return
    even = chart_mesh(surface, thickness_mm=wall, n_along=42, n_around=48)
    mesh8 = quadratic_mesh(even, surface)
    load8 = S8R_FORCE_N * quadratic_patch(mesh8, surface, centres[0], 6.0)
    with tempfile.TemporaryDirectory() as folder:
        moved = run_ccx(Path(folder), mesh8, load8, **kind)
    theirs = float(np.linalg.norm(moved, axis=1).max()) / S8R_FORCE_N
    make = sensor_shell(
        surface, markers, thickness_mm=wall, centres_uv=centres[:1], radii_mm=6.0, **kind
    )
    found = estimate_error(make, (4, 2))
    ours, better = (float(np.linalg.norm(m[-1])) for m in (found.motion, found.extrapolated))
    ratio = float(found.error[-1, 0]) / abs(theirs - ours)
    row = "mesh error: cylinder60, refine 4, motion under the contact: estimate off by a factor"
    source = "CalculiX S8R 42 × 48, other element and mesh; reference is the true error"
    note = (
        f"estimate / truth = {ratio:.2f}; ours {ours:.5f}, extrapolated {better:.5f}, "
        f"CalculiX {theirs:.5f} mm"
    )
    table.add(row, max(ratio, 1.0 / ratio), "x", abs(theirs - ours) / theirs, source, HONEST, note)


def _each_marker(table: Table, refine: int, found: DiscretisationError, truth: FloatArray) -> None:
    true = np.linalg.norm(truth - found.motion, axis=1)
    counts = true > 0.1 * true.max(axis=0)
    ratio = found.error[counts] / true[counts]
    row = f"mesh error: cylinder60, refine {refine}: markers whose own estimate is within 0.5 … 2"
    source = "refine 16 and 8, extrapolated; markers off by a tenth of the largest error or more"
    note = f"factor of a single marker: {ratio.min():.2g} to {ratio.max():.2g}"
    value = float(np.mean((ratio > 0.5) & (ratio < 2.0))) * 100.0
    table.add(row, value, "%", 100.0, source, note=note)


def _cost(
    table: Table, make: Callable[[int], ProbedShell], meshes: tuple[tuple[int, ...], ...]
) -> None:
    def spent(work: Callable[[], object]) -> float:
        work()
        times = []
        for _ in range(3):
            start = time.process_time()
            work()
            times.append(time.process_time() - start)
        return min(times)

    def plain() -> None:
        part = make(meshes[0][0])
        part.model.solve(part.loads)

    alone = spent(plain)
    for levels in meshes:
        row = (
            f"mesh error: processor time with the estimate on {len(levels)} meshes / without, "
            f"refine {levels[0]}"
        )
        source = "seconds of one mesh, from elements to displacements"
        value = spent(partial(estimate_error, make, levels)) / alone
        table.add(row, value, "x", alone, source, "<= 1.5")


def rates(table: Table) -> None:
    """Fitted orders of convergence of displacement and energy where the solution is smooth."""
    sizes = (8, 16, 32)
    hyperboloid: Callable[[int], ShellProblem] = partial(cases.hyperboloid_case, thickness=1.0)
    points = hyperboloid(8).mesh.nodes
    meshes = {n: probed(hyperboloid(n), points) for n in (8, 16, 32, 64, 128)}
    motions = {n: part.model.solve(part.loads).motion for n, part in meshes.items()}
    seen = {n: part.read(motions[n]) for n, part in meshes.items()}
    energy = {n: float(np.sum(motions[n].ravel() * meshes[n].loads.ravel())) for n in meshes}
    truth = seen[128] + (seen[128] - seen[64]) / 3.0
    limit = energy[128] + (energy[128] - energy[64]) / 3.0
    moved = [largest(truth - seen[n]) for n in sizes]
    stored = [abs(limit - energy[n]) for n in sizes]
    plates = [plate_case(n, jitter=0.25) for n in sizes]
    off = [abs(plate.ratio() - 1.0) for plate in plates]
    for name, errors, source in (
        ("free hyperboloid t = 1, largest displacement", moved, "128 and 64 a side, extrapolated"),
        ("free hyperboloid t = 1, energy", stored, "128 and 64 a side, extrapolated"),
        ("jittered plate, middle", off, "exact (Navier, with shear)"),
    ):
        slope = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
        row = f"rate of convergence: {name}"
        note = f"errors at 8, 16, 32 a side: {', '.join(f'{e:.3g}' for e in errors)}"
        table.add(row, float(slope), "-", 2.0, source, ">= 1.8", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows."""
    published(table, quick=quick)
    sensor(table, quick=quick)
    if not quick:
        rates(table)
