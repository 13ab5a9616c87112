"""Extremes of thickness, shape, material, size and mesh, against closed solutions; mesh error.

``add_rows`` adds to the table of ``mechanics``, with those of ``mechanics_error``.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks import mechanics_error
from benchmarks.harness import Table, holds
from phytac_design.mechanics.shell.shell_element import element_stiffness
from phytac_shapes.errors import NumericalError
from verification import shells as cases
from verification.shells import ShellProblem, ring_case

CLOSED = "closed solution with transverse shear"
JITTERED = "; locks: see the share of membrane energy; falls with refinement"


def off(
    table: Table, name: str, build: Callable[[], ShellProblem], target: str, **more: str
) -> None:
    """Row: error of a case in percent, or the reason it is refused."""
    source, why = more.get("source", CLOSED), more.get("why", "")
    try:
        ratio = build().ratio()
    except NumericalError as refused:
        table.add(name, 100.0, "%", reference=0.0, source=source, target=target, note=str(refused))
        return
    error = abs(ratio - 1.0) * 100.0
    note = f"computed / reference = {ratio:.5f}" + ("" if holds(error, target) else why)
    table.add(name, error, "%", reference=0.0, source=source, target=target, note=note)


def ring(table: Table, *, quick: bool) -> None:
    """Ring load on a long cylinder with jittered nodes; the limit of shell theory itself."""
    for t, around in ((0.1, 38), (1e-2, 120), (1e-3, 382), (1e-4, 600))[: 1 if quick else None]:
        off(
            table,
            f"ring load, nodes jittered ±25 %, t/R = {t:g}, 48 × {around} elements",
            partial(ring_case, 48, around=around, thickness_over_radius=t, jitter=0.25),
            "<= 5",
            why=JITTERED,
        )
    lame = _lame(0.3)
    row = "tube under inner pressure, t/R = 0.3: what shell theory itself is off"
    source = "Lamé, middle face, plane stress, ν 0.3; shell p·a·R/(E t); no computation"
    note = "thick walls are a limit of the model, not of the element"
    table.add(row, abs(0.85 / 0.3 / lame - 1.0) * 100.0, "%", lame, source, note=note)


def _lame(ratio: float, v: float = 0.3) -> float:
    """Radial motion of the middle face for R = E = p = 1."""
    a, b = 1.0 - ratio / 2.0, 1.0 + ratio / 2.0
    return a * a / (b * b - a * a) * ((1.0 - v) + (1.0 + v) * b * b)


def thin_and_jittered(table: Table, *, quick: bool) -> None:
    """Pure bending of the free hyperboloid, the hardest on a thin element, on jittered meshes."""
    for n in (32,) if quick else (32, 64):
        for t in (0.1, 0.01, 0.001, 1e-4):
            for jitter in (0.0, 0.25):
                nodes = "jittered ±25 %" if jitter else "regular"
                off(
                    table,
                    f"free hyperboloid, t/L = {t:g}, {n} a side, nodes {nodes}",
                    partial(cases.hyperboloid_case, n, thickness=t, jitter=jitter),
                    "<= 5",
                    source="published reference; below t = 0.001 its limit of pure bending",
                    why=JITTERED,
                )
    for n in (32,) if quick else (32, 64):
        case = cases.hyperboloid_case(n, thickness=1e-4, jitter=0.25)
        model = case.model()
        motion = model.solve(case.loads.reshape(-1, 1)).motion[:, :, 0]
        part = element_stiffness(
            model.nodes_mm, model.quads, model.directors, poisson=case.poisson
        ).membrane
        local = motion[model.quads].reshape(len(model.quads), 24)
        stretch = case.modulus * case.thickness * np.einsum("ei,eij,ej->", local, part, local)
        row = f"free hyperboloid, t/L = 0.0001, {n} a side, jittered: membrane share of the energy"
        source = "limit of pure bending"
        table.add(row, float(stretch / np.sum(case.loads * motion)) * 100.0, "%", 0.0, source)
    if not quick:
        off(
            table,
            "free hyperboloid, t/L = 0.0001, 96 a side, nodes jittered ±25 %",
            partial(cases.hyperboloid_case, 96, thickness=1e-4, jitter=0.25),
            "<= 5",
            source="limit of pure bending",
            why=JITTERED,
        )


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows, those of the mesh error too."""
    ring(table, quick=quick)
    thin_and_jittered(table, quick=quick)
    mechanics_error.add_rows(table, quick=quick)
