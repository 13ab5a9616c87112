"""Extremes of thickness, shape, material, size and mesh, against closed solutions; mesh error.

``add_rows`` adds to the table of ``mechanics``, with those of ``mechanics_error``.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import mechanics_error
from benchmarks.harness import Table, arguments, holds
from phytac_design.mechanics.meshing.mesh_check import check_directors, check_quads
from phytac_design.mechanics.shell.element import element_stiffness
from phytac_design.mechanics.shell.solve import rigid_modes
from phytac_design.mechanics.verification import cases
from phytac_design.mechanics.verification.case_parts import Case
from phytac_design.mechanics.verification.element_shapes import SHAPES, element_shape
from phytac_design.mechanics.verification.ring_case import ring_case
from phytac_design.mechanics.verification.single_row import arch_case
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

CLOSED = "closed solution with transverse shear"
JITTERED = "; locks: see the share of membrane energy; falls with refinement"


def off(table: Table, name: str, build: Callable[[], Case], target: str, **more: str) -> None:
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
    """Ring load on a long cylinder: thickness, Poisson's ratio, modulus, size, force, jitter."""
    for t in (0.3, 1e-5) if quick else (0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-5):
        off(
            table,
            f"ring load, t/R = {t:g}, 48 × 16 elements",
            partial(ring_case, 48, thickness_over_radius=t),
            "<= 1",
        )
    for v in (0.0, 0.45, 0.49, 0.4999):
        off(table, f"ring load, ν = {v}", partial(ring_case, 48, poisson=v), "<= 1")
    for E, R, Q in ((1e-3, 30.0, 1.0), (1e6, 30.0, 1.0), (2200.0, 0.5, 1e-9), (2200.0, 5e3, 1e-9)):
        off(
            table,
            f"ring load, E = {E:g} MPa, R = {R:g} mm, {Q:g} N/mm",
            partial(ring_case, 48, modulus=E, radius=R, load=Q),
            "<= 1",
        )
    for t, around in ((0.1, 38), (1e-2, 120), (1e-3, 382), (1e-4, 600))[: 1 if quick else None]:
        off(
            table,
            f"ring load, nodes jittered ±25 %, t/R = {t:g}, 48 × {around} elements",
            partial(ring_case, 48, around=around, thickness_over_radius=t, jitter=0.25),
            "<= 5",
            why=JITTERED,
        )
    lame = _lame(0.3)
    table.add(
        "tube under inner pressure, t/R = 0.3: what shell theory itself is off",
        abs(0.85 / 0.3 / lame - 1.0) * 100.0,
        "%",
        reference=lame,
        source="Lamé, middle face, plane stress, ν 0.3; shell p·a·R/(E t); no computation",
        note="thick walls are a limit of the model, not of the element",
    )


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
        table.add(
            f"free hyperboloid, t/L = 0.0001, {n} a side, jittered: membrane share of the energy",
            float(stretch / np.sum(case.loads * motion)) * 100.0,
            "%",
            reference=0.0,
            source="limit of pure bending",
        )
    if not quick:
        off(
            table,
            "free hyperboloid, t/L = 0.0001, 96 a side, nodes jittered ±25 %",
            partial(cases.hyperboloid_case, 96, thickness=1e-4, jitter=0.25),
            "<= 5",
            source="limit of pure bending",
            why=JITTERED,
        )


def shapes_and_rows(table: Table) -> None:
    """Zero-energy modes of every shape; single rows; aspect ratios; drilling; turning."""
    for name in SHAPES:
        nodes, directors = element_shape(name)
        element = element_stiffness(nodes, np.array([[0, 1, 2, 3]]), directors, poisson=0.3)
        K = element.combine(modulus_MPa=1.0, thickness_mm=0.01)[0]
        scale = 1.0 / np.sqrt(np.diag(K))
        values = np.linalg.eigvalsh(scale[:, None] * K * scale)
        rigid = float(np.abs(K @ rigid_modes(nodes).reshape(24, 6)).max() / np.abs(K).max())
        table.add(
            f"zero-energy modes, element {name}",
            int(np.sum(values < 1e-12)),
            "modes",
            reference=6,
            source="rigid motions of a body",
            target="== 6",
            note=f"seventh eigenvalue {values[6]:.2g} of the scaled matrix; force under rigid "
            f"motion / stiffness {rigid:.1g}",
        )
    for t, width in ((0.1, 1.0), (1e-3, 1.0), (1e-3, 65.0), (0.1, 0.05)):
        aspect = max(width / 0.65, 0.65 / width)
        off(
            table,
            f"arch of one row of 24 elements, t/R = {t / 10:g}, aspect {aspect:.3g}",
            partial(arch_case, 24, thickness=t, width=width),
            "<= 1",
        )
    for name in ("raasch_hook", "full_hemisphere", "twisted_beam"):
        case = getattr(cases, name)
        found = [case(16, drilling=d) for d in (1e-4, 1e-2, 1.0)]
        table.add(
            f"drilling factor 1e-4 … 1, {name.replace('_', ' ')}",
            float(np.ptp(found)) * 100.0,
            "%",
            reference=0.0,
            source="derived",
            target="<= 0.1",
        )
    case = cases.raasch_hook_case(20)
    table.add(
        "model turned in space, nodes renumbered: change of the Raasch hook",
        abs(turned(case).ratio() / case.ratio() - 1.0),
        "-",
        reference=0.0,
        source="the same model",
        target="<= 1e-8",
    )


def turned(case: Case) -> Case:
    """Case whose supports hold all DOFs of a node or none, turned and renumbered."""
    rng = np.random.default_rng(4)
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    q *= np.linalg.det(q)
    order = rng.permutation(len(case.mesh.nodes))
    both = np.kron(np.eye(2), q.T)
    mesh = cases.Patch(
        ab=case.mesh.ab[order],
        nodes=(case.mesh.nodes @ q.T)[order],
        normals=(case.mesh.normals @ q.T)[order],
        quads=np.roll(np.argsort(order)[case.mesh.quads], 1, axis=1),
    )
    return Case(
        mesh=mesh,
        fixed=case.fixed[order],
        loads=(case.loads @ both)[order],
        read=(case.read @ both)[order],
        reference=case.reference,
        modulus=case.modulus,
        poisson=case.poisson,
        thickness=case.thickness,
    )


def patch_tests(table: Table) -> None:
    """Constant strain, curvature and shear on a distorted plate under its boundary's motion."""
    plate = cases.patch(lambda a, b: np.column_stack([2.0 * a, 1.5 * b, 0.0 * a]), 5, 4, jitter=0.3)
    x, y = plate.nodes[:, 0], plate.nodes[:, 1]
    o, one = np.zeros_like(x), np.ones_like(x)
    fields = {
        "membrane": [x + 0.1 * y, 0.6 * x - 0.4 * y, o, o, o, 0.25 * one],
        "bending": [
            o,
            o,
            0.5 * x * x - 0.3 * y * y + 0.45 * x * y,
            0.45 * x - 0.6 * y,
            -x - 0.45 * y,
            o,
        ],
    }
    edge = np.any((plate.ab == 0.0) | (plate.ab == 1.0), axis=1)
    free = np.repeat(~edge, 6)
    model = Case(
        mesh=plate,
        fixed=np.repeat(edge[:, None], 6, axis=1),
        loads=np.zeros((len(x), 6)),
        read=np.zeros((len(x), 6)),
        reference=1.0,
        modulus=7.0,
        poisson=0.3,
        thickness=0.1,
    ).model()
    for name, columns in fields.items():
        exact = np.column_stack(columns).ravel()
        held = np.where(free, 0.0, exact)
        moved = model.solve(-(model.stiffness @ held).reshape(-1, 1)).motion.ravel() + held
        table.add(
            f"patch test, {name}, nodes of a plate moved by up to 0.3 elements",
            float(np.abs(moved - exact).max() / np.abs(exact).max()),
            "-",
            reference=0.0,
            source="exact",
            target="<= 1e-10",
        )


def refusals(table: Table) -> None:
    """Bad input: how many of the kinds are refused with a reason."""
    good = cases.raasch_hook_case(4)
    mesh, count = good.mesh, len(good.mesh.nodes)
    spoilt = mesh.nodes.copy()
    spoilt[3] = np.nan
    flat = mesh.nodes.copy()
    flat[mesh.quads[0, 1]] = flat[mesh.quads[0, 0]]
    third = np.append(mesh.quads, [[0, 1, count, count + 1], [1, 0, count + 2, count + 3]], axis=0)
    turned_back = mesh.quads.copy()
    turned_back[1] = turned_back[1, ::-1]

    def with_mesh(nodes: FloatArray) -> Callable[[], object]:
        return replace(good, mesh=replace(mesh, nodes=nodes)).model

    kinds: dict[str, Callable[[], object]] = {
        "coordinate not finite": with_mesh(spoilt),
        "degenerate element": with_mesh(flat),
        "unconstrained": replace(good, fixed=np.zeros_like(good.fixed)).model,
        "load not finite": replace(good, loads=good.loads * np.nan).ratio,
        "thickness zero": replace(good, thickness=0.0).model,
        "Poisson's ratio 0.5": replace(good, poisson=0.5).model,
        "three walls at an edge": lambda: check_quads(third, count + 4),
        "neighbour facing the other way": lambda: check_quads(turned_back, count),
        "element twice": lambda: check_quads(np.repeat(mesh.quads, 2, axis=0), count),
        "directors reversed": lambda: check_directors(mesh.nodes, mesh.quads, -mesh.normals),
    }
    missed = []
    for name, attempt in kinds.items():
        try:
            attempt()
        except NumericalError:
            continue
        missed.append(name)
    table.add(
        f"bad input refused, of {len(kinds)} kinds",
        len(kinds) - len(missed),
        "kinds",
        reference=len(kinds),
        source="derived",
        target=f">= {len(kinds)}",
        note="; ".join(kinds) if not missed else f"not refused: {'; '.join(missed)}",
    )


def twisted_beam(table: Table) -> None:
    """Where the twisted beam's error at 8 along comes from: ours, and CalculiX on the mesh."""
    for t in (0.32, 0.0032):
        for across in (1, 2, 4, 8):
            ratio = cases.twisted_beam_case(8, thickness=t, in_plane=False, across=across).ratio()
            table.add(
                f"twisted beam t = {t}, force across the width, 8 × {across}: error",
                abs(ratio - 1.0) * 100.0,
                "%",
                reference=1.0,
                source="published reference",
                note="the number across does not matter: the error is one of the 8 along",
            )
        if shutil.which("ccx") is None:
            continue
        for kind in ("S4", "S8R"):
            for n in (8, 12):
                case = cases.twisted_beam_case(n, thickness=t, in_plane=False, across=2)
                value = ccx(case, kind, n)
                table.add(
                    f"twisted beam t = {t}, force across, {n} × 2, CalculiX {kind}: error",
                    abs(value / case.reference - 1.0) * 100.0,
                    "%",
                    reference=case.reference,
                    source="published reference",
                    note=f"computed / reference = {value / case.reference:.5f}; ours on the mesh "
                    f"of 4-node elements {case.ratio():.5f}",
                )


def ccx(case: Case, kind: str, n: int) -> float:
    """Motion looked at, by CalculiX on the beam's mesh (S8R: mid-sides from the mesh halved)."""
    nodes, quads, fixed, loads, read = (
        case.mesh.nodes,
        case.mesh.quads,
        case.fixed,
        case.loads,
        case.read,
    )
    if kind == "S8R":
        fine = cases.twisted_beam_case(
            2 * n, thickness=case.thickness, in_plane=False, across=4
        ).mesh
        ids = np.arange(len(fine.nodes)).reshape(2 * n + 1, 5)
        around = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1))
        quads = np.array(
            [
                [ids[i + p, j + q] for p, q in around]
                for i in range(0, 2 * n, 2)
                for j in range(0, 4, 2)
            ]
        )
        nodes = fine.nodes
        root, tip, middle = ids[0], ids[-1], int(ids[-1, 2])
        fixed = np.zeros((len(nodes), 6), dtype=np.bool_)
        fixed[root] = True
        loads, read = np.zeros((len(nodes), 6)), np.zeros((len(nodes), 6))
        loads[tip, 1] = np.array([1.0, 4.0, 2.0, 4.0, 1.0]) / 12.0  # quadratic edges
        read[middle, 1] = 1.0
    used = np.unique(quads)
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{k + 1}, {', '.join(f'{x:.12e}' for x in nodes[k])}" for k in used.tolist()]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=SHELL"]
    lines += [
        f"{k}, {', '.join(map(str, row))}" for k, row in enumerate((quads + 1).tolist(), start=1)
    ]
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", f"{case.modulus:.9g}, {case.poisson:.9g}"]
    lines += ["*SHELL SECTION, ELSET=SHELL, MATERIAL=M", f"{case.thickness:.9g}", "*BOUNDARY"]
    lines += [f"{k + 1}, 1, 6" for k in used.tolist() if fixed[k].all()]
    lines += ["*STEP", "*STATIC", "*CLOAD"]
    lines += [f"{i + 1}, {j + 1}, {loads[i, j]:.12e}" for i, j in np.argwhere(loads).tolist()]
    lines += ["*NODE PRINT, NSET=ALL", "U", "*END STEP", ""]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "beam.inp").write_text("\n".join(lines), encoding="ascii")
        subprocess.run(["ccx", "beam"], cwd=folder, capture_output=True, check=True)
        rows = [line.split() for line in (Path(folder) / "beam.dat").read_text().splitlines()]
    node, axis = np.argwhere(read)[0]
    return next(float(r[1 + axis]) for r in rows if len(r) == 4 and r[0] == str(node + 1))


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows, those of the mesh error too."""
    ring(table, quick=quick)
    thin_and_jittered(table, quick=quick)
    shapes_and_rows(table)
    patch_tests(table)
    refusals(table)
    if not quick:
        twisted_beam(table)
    mechanics_error.add_rows(table, quick=quick)


if __name__ == "__main__":
    add_rows(Table("mechanics_extremes"), quick=arguments(__doc__ or "").quick)
