"""Shell mechanics against closed and published solutions; balance, units, axes."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from phytac_design.mechanics.meshing.mesh_check import check_directors, check_quads
from phytac_design.mechanics.shell.shell_element import element_stiffness
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from verification import shells
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.shells import CLAMPED, SYMMETRY, Patch, ShellProblem, at, patch, problem, weights

Build = Callable[..., ShellProblem]
ROUNDING = 1e-10
"""Of balances, relative, beside what their own terms round to."""
EPS = 2.0**-52
"""Rounding of one term, twice over."""


def balances(
    model: ShellModel, loads: FloatArray, motion: FloatArray, reactions: FloatArray, found: Evidence
) -> None:
    """Forces, moments and energy of one load (N, 6)."""
    # Products of very large and very small loads must not overflow in these sums.
    scale = float(np.abs(loads).max()) or 1.0
    loads, motion, reactions = loads / scale, motion / scale, reactions / scale
    every = loads + reactions
    size = np.abs(loads[:, :3]).sum() or 1.0
    # Reactions are K·u: what its sums may round to is known from their terms alone.
    terms = (abs(model.stiffness) @ np.abs(motion.ravel())).reshape(-1, 6)
    slack = ROUNDING + EPS * float(terms[:, :3].sum()) / size
    found.add("sum of forces", every[:, :3].sum(axis=0) / size, slack, kind="balance")
    arm = model.nodes_mm - model.nodes_mm.mean(axis=0)
    moment = every[:, 3:].sum(axis=0) + np.cross(arm, every[:, :3]).sum(axis=0)
    lever = float(np.abs(arm).max())
    total = size * lever + np.abs(loads[:, 3:]).sum()
    turning = EPS * float(terms[:, 3:].sum() + lever * terms[:, :3].sum()) / total
    found.add("sum of moments", moment / total, ROUNDING + turning, kind="balance")
    work = float(np.sum(loads * motion))
    stored = float(motion.ravel() @ (model.stiffness @ motion.ravel()))
    spent = EPS * float(np.abs(motion.ravel()) @ terms.ravel()) / abs(work)
    found.add(
        "work of the load = energy stored", stored / work - 1.0, ROUNDING + spent, kind="balance"
    )
    found.facts["rounding_of_balances"] = float(slack)
    found.true("energy is positive", work > 0.0)


def check_case(values: Mapping[str, Any], found: Evidence) -> None:
    """A problem with a known answer; its balances; the same in other units and other axes."""
    case = values["build"]()
    model = case.model()
    solution = model.solve(case.loads.reshape(-1, 1))
    motion = solution.motion[:, :, 0]
    ratio = float(np.sum(case.read * motion) / case.reference)
    found.add(values["reference"], ratio - 1.0, values["tolerance"])
    balances(model, case.loads, motion, solution.reactions[:, :, 0], found)
    found.facts["rounding"] = solution.error
    # Rounding of a nearly singular stiffness shows in the digits that two solutions share.
    share = max(1e-9, 3.0 * solution.error)
    for name, factor in (("micrometres", 1e3), ("metres", 1e-3)):
        other = _in_units(case, factor)
        there = other.model().solve(other.loads.reshape(-1, 1)).motion[:, :, 0]
        there = there / np.repeat([factor, 1.0], 3)
        found.close(f"in {name}", _sized(there), _sized(motion), share, kind="units")
    turned = _turned(case)
    there = turned.model().solve(turned.loads.reshape(-1, 1)).motion[:, :, 0]
    back = there[:, [1, 2, 0, 4, 5, 3]]
    found.close("with x, y, z named y, z, x", _sized(back), _sized(motion), share, kind="symmetry")


def _sized(motion: FloatArray) -> FloatArray:
    """Translations; rotations have another unit."""
    return motion[:, :3]


def _in_units(case: ShellProblem, factor: float) -> ShellProblem:
    """The same shell with lengths in a unit 1/factor as long; forces stay."""
    loads = case.loads * np.repeat([1.0, factor], 3)
    mesh = replace(case.mesh, nodes=factor * case.mesh.nodes)
    return replace(
        case,
        mesh=mesh,
        loads=loads,
        thickness=factor * case.thickness,
        modulus=case.modulus / factor**2,
    )


def _turned(case: ShellProblem) -> ShellProblem:
    """The same shell with its axes renamed: x becomes y, y becomes z, z becomes x."""
    order = [2, 0, 1]
    both = [2, 0, 1, 5, 3, 4]
    mesh = replace(case.mesh, nodes=case.mesh.nodes[:, order], normals=case.mesh.normals[:, order])
    return replace(
        case,
        mesh=mesh,
        fixed=case.fixed[:, both],
        loads=case.loads[:, both],
        read=case.read[:, both],
    )


def cantilever_case(n: int, *, length: float, width: float, thickness: float) -> ShellProblem:
    """Strip under an end force 1, ν = 0: PL³/3EI + PL/(5/6 G A)."""
    mesh = patch(lambda a, b: np.column_stack([length * a, width * b, 0.0 * a]), n, 1)
    return _strip(mesh, length, width, thickness)


def distorted_case(n: int, *, skew: float) -> ShellProblem:
    """The same with its elements' sides leaning by ``skew`` of their length, both ways in turn."""
    length, width, thickness = 10.0, 1.0, 0.1

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        lean = np.where(np.rint(a * n).astype(int) % 2 == 1, skew / n, 0.0) * (2.0 * b - 1.0)
        inner = (a > 1e-4) & (a < 1.0 - 1e-4)
        return np.column_stack([length * (a + np.where(inner, lean, 0.0)), width * b, 0.0 * a])

    mesh = patch(surface, n, 1)
    flat = replace(mesh, normals=np.tile([0.0, 0.0, 1.0], (len(mesh.nodes), 1)))
    return _strip(flat, length, width, thickness)


def _strip(mesh: Patch, length: float, width: float, thickness: float) -> ShellProblem:
    loads = np.zeros((len(mesh.nodes), 6))
    tip = np.flatnonzero(mesh.ab[:, 0] == 1.0)
    loads[tip, 2] = 0.5
    modulus = 1000.0
    bend = length**3 / 3.0 / (modulus * width * thickness**3 / 12.0)
    shear = length / (5.0 / 6.0 * modulus / 2.0 * width * thickness)
    return problem(
        mesh,
        ((mesh.ab[:, 0] == 0.0, CLAMPED),),
        loads,
        weights(mesh, *((int(k), 2, 0.5) for k in tip)),
        reference=bend + shear,
        modulus=modulus,
        poisson=0.0,
        thickness=thickness,
    )


def clamped_square_case(n: int, *, thickness: float, poisson: float = 0.3) -> ShellProblem:
    """Quarter of a clamped square, side 2, force at its middle: 0.00560 P a²/D (Timoshenko)."""
    mesh = patch(lambda a, b: np.column_stack([a, b, 0.0 * a]), n, n)
    a, b = mesh.ab.T
    middle = at(mesh, 0.0, 0.0)
    bending = thickness**3 / 12.0 / (1.0 - poisson**2)
    # The figure of Timoshenko's table 37 has three digits; 0.005612 is Taylor and Govindjee's.
    return problem(
        mesh,
        ((a == 0.0, SYMMETRY[0]), (b == 0.0, SYMMETRY[1]), ((a == 1.0) | (b == 1.0), CLAMPED)),
        weights(mesh, (middle, 2, 0.25)),
        weights(mesh, (middle, 2, 1.0)),
        reference=0.005612 * 4.0 / bending,
        modulus=1.0,
        poisson=poisson,
        thickness=thickness,
    )


def stretched_case(n: int, *, poisson: float, jitter: float) -> ShellProblem:
    """A square pulled along x by 1 per length, free across: exactly stretched, on any mesh."""
    mesh = patch(lambda a, b: np.column_stack([a, b, 0.0 * a]), n, n, jitter=jitter)
    mesh = replace(mesh, normals=np.tile([0.0, 0.0, 1.0], (len(mesh.nodes), 1)))
    a, b = mesh.ab.T
    loads = np.zeros((len(mesh.nodes), 6))
    edge = np.flatnonzero(a == 1.0)
    share = np.full(len(edge), 1.0 / n)
    share[[0, -1]] /= 2.0
    loads[edge, 0] = share
    corner = at(mesh, 1.0, 1.0)
    return problem(
        mesh,
        ((a == 0.0, (0, 2, 4)), ((a == 0.0) & (b == 0.0), (1, 2, 3, 4, 5))),
        loads,
        weights(mesh, (corner, 0, 1.0), (corner, 1, -1.0)),
        reference=(1.0 + poisson) / 0.1,
        modulus=1.0,
        poisson=poisson,
        thickness=0.1,
    )


THIN = ("plate, t/a 1e-06", "arch, t 1e-05, 1 wide")
"""So thin, a shell may be rejected: its stiffness is singular to the last digit."""


def cases() -> Cases:  # noqa: C901, PLR0912, PLR0915 - a table
    """Thin, thick, tiny, huge, soft, stiff, nearly incompressible, distorted, flat, curved."""
    out = Cases()

    def add(name: str, build: Build, reference: str, tolerance: float, *n: Any, **kw: Any) -> None:
        expect: Expect = "either" if name in THIN else "right"
        numbers = {"build": partial(build, *n, **kw), "reference": reference}
        out.add(name, check_case, expect, tolerance=tolerance, **numbers)

    ring = "ring load on a cylinder: closed solution with shear"
    for t in (0.5, 0.3, 0.1, 0.03, 1e-2, 1e-3, 1e-4, 1e-5):
        name = f"ring load, t/R {t:g}"
        add(name, shells.ring_case, ring, 0.005, 48, thickness_over_radius=t)
    for v in (0.0, 0.2, 0.45, 0.49, 0.499, 0.4999, 0.499999):
        add(f"ring load, ν {v:g}", shells.ring_case, ring, 0.005, 48, poisson=v)
    for E, R in ((1e-3, 30.0), (1e6, 30.0), (2200.0, 1e-3), (2200.0, 1e6)):
        name = f"ring load, E {E:g} MPa, R {R:g} mm"
        add(name, shells.ring_case, ring, 0.01, 32, modulus=E, radius=R)
    for load in (1e-200, 1e-9, 1e200):
        add(f"ring load of {load:g} N/mm", shells.ring_case, ring, 0.01, 32, load=load)
    for t, around in ((0.1, 38), (0.01, 120)):
        numbers = {"around": around, "thickness_over_radius": t, "jitter": 0.25}
        name = f"ring load, t/R {t:g}, jittered mesh"
        add(name, shells.ring_case, ring, 0.02, 48, **numbers)
    navier = "Navier's plate with shear"
    for t in (0.5, 0.1, 1e-2, 1e-4, 1e-6):
        add(f"plate, t/a {t:g}", shells.plate_case, navier, 0.01, 16, thickness=t)
    jittered = {"thickness": 0.01, "jitter": 0.3}
    add("plate, jittered mesh", shells.plate_case, navier, 0.02, 16, **jittered)
    arches = ((1.0, 1.0), (0.1, 1.0), (1e-2, 1.0), (1e-3, 1.0), (1e-3, 65.0), (0.1, 0.05))
    for t, width in (*arches, (1e-5, 1.0)):
        name = f"arch, t {t:g}, {width:g} wide"
        add(name, shells.arch_case, "Castigliano", 0.005, 24, thickness=t, width=width)
    beam = "Timoshenko's beam"
    # As long as it is thick, half of a strip's sag is shear: its factor shows.
    strips = ((10, 1, 0.1), (1000, 1, 1), (10, 1e-2, 1e-2), (10, 1000, 0.1), (2, 1, 1), (1, 1, 1))
    for length, width, t in strips:
        name = f"strip {length:g} x {width:g} x {t:g}"
        numbers = {"length": length, "width": width, "thickness": t}
        add(name, cantilever_case, beam, 0.005, 32, **numbers)
    for skew in (0.1, 0.4, 0.8):
        name = f"strip, elements leaning by {skew:g}"
        add(name, distorted_case, beam, 0.02, 32, skew=skew)
    table = "Timoshenko, table 37; six digits by Taylor and Govindjee"
    for t in (1e-2, 1e-4):
        name = f"clamped square, t/a {t / 2:g}"
        add(name, clamped_square_case, table, 0.01, 24, thickness=t)
    for v in (0.0, 0.3, 0.4999):
        name = f"plain stretch, ν {v:g}, any mesh"
        add(name, stretched_case, "Hooke", 1e-9, 6, poisson=v, jitter=0.4)
    published: tuple[tuple[str, Build, str, float, int], ...] = (
        ("Scordelis-Lo roof", shells.scordelis_lo_case, "published 0.3024", 0.015, 16),
        ("pinched cylinder", shells.pinched_cylinder_case, "MacNeal and Harder", 0.03, 24),
        ("hemisphere with a hole", shells.hemisphere_with_hole_case, "MacNeal, Harder", 0.01, 16),
        ("Raasch hook", shells.raasch_hook_case, "Knight (1997)", 0.03, 20),
        ("twisted beam", shells.twisted_beam_case, "MacNeal and Harder", 0.01, 12),
    )
    for name, build, source, tolerance, n in published:
        add(name, build, source, tolerance, n)
    roof = "Scordelis-Lo roof, jittered"
    add(roof, shells.scordelis_lo_case, "published 0.3024", 0.03, 16, jitter=0.3)
    for t in (0.1, 1e-3):
        name = f"free hyperboloid, t/L {t:g}"
        add(name, shells.hyperboloid_case, "published", 0.02, 32, thickness=t)
    for t in (0.1, 0.01):
        name = f"free hyperboloid, t/L {t:g}, jittered"
        numbers = {"thickness": t, "jitter": 0.25}
        add(name, shells.hyperboloid_case, "published", 0.01, 32, **numbers)
    bad = {
        "ν of 0.5": {"poisson": 0.5},
        "ν below 0": {"poisson": -0.1},
        "ν not a number": {"poisson": float("nan")},
        "no modulus": {"modulus": 0.0},
        "modulus not a number": {"modulus": float("nan")},
        "no thickness": {"thickness": 0.0},
        "radius infinite": {"radius": float("inf")},
        "load not a number": {"load": float("nan")},
        "load infinite": {"load": float("inf")},
    }
    for name, change in bad.items():
        out.add(f"ring load, {name}", check_rejected, "refused", change=change)
    for name, mesh in BAD_MESHES.items():
        out.add(f"mesh: {name}", check_mesh, "refused", attempt=mesh)
    for name in shells.ELEMENTS:
        for t in (0.3, 0.01, 1e-3):
            title = f"six zero-energy modes, element {name}, t {t:g}"
            out.add(title, check_modes, element=name, thickness=t)
    for build in DRILLED:
        out.add(f"drilling factor, {build.__name__}", check_drilling, build=build)
    for build, n in ((shells.twisted_beam_case, 12), (shells.raasch_hook_case, 20)):
        out.add(f"turned and renumbered, {build.__name__}", check_turned, build=partial(build, n))
    for kind in ("membrane", "bending"):
        out.add(f"patch test, {kind}", check_patch, kind=kind)
    for name, shell in CORNER_LOADED.items():
        out.add(f"rounding: {name}", check_rounding_error, "either", shell=shell)
    out.add("thin limit of the ring load", check_thin_limit)
    out.add("a shell dominated by rounding", check_rounding, "refused")
    return out


def check_rejected(values: Mapping[str, Any], found: Evidence) -> None:
    """A sound case with one invalid number, solved as it is."""
    change = dict(values["change"])
    load, radius = change.pop("load", 1.0), change.pop("radius", 1.0)
    case = shells.ring_case(8)
    with np.errstate(invalid="ignore"):
        mesh = replace(case.mesh, nodes=case.mesh.nodes * radius)
        loads = case.loads * load
    replace(case, mesh=mesh, loads=loads, **change).motion()
    found.true("it is rejected", False)


def _bad_meshes() -> dict[str, Callable[[], object]]:
    good = shells.raasch_hook_case(4)
    mesh, count = good.mesh, len(good.mesh.nodes)
    infinite, flat = mesh.nodes.copy(), mesh.nodes.copy()
    infinite[3] = np.nan
    flat[mesh.quads[0, 1]] = flat[mesh.quads[0, 0]]
    third = np.append(mesh.quads, [[0, 1, count, count + 1], [1, 0, count + 2, count + 3]], axis=0)
    turned_back = mesh.quads.copy()
    turned_back[1] = turned_back[1, ::-1]
    return {
        "coordinate not finite": replace(good, mesh=replace(mesh, nodes=infinite)).model,
        "degenerate element": replace(good, mesh=replace(mesh, nodes=flat)).model,
        "unconstrained": replace(good, fixed=np.zeros_like(good.fixed)).model,
        "three walls at an edge": lambda: check_quads(third, count + 4),
        "neighbour facing the other way": lambda: check_quads(turned_back, count),
        "element twice": lambda: check_quads(np.repeat(mesh.quads, 2, axis=0), count),
        "directors reversed": lambda: check_directors(mesh.nodes, mesh.quads, -mesh.normals),
    }


BAD_MESHES = _bad_meshes()
DRILLED: tuple[Build, ...] = (
    shells.scordelis_lo_case,
    shells.hemisphere_with_hole_case,
    shells.full_hemisphere_case,
    shells.twisted_beam_case,
    shells.raasch_hook_case,
)


def check_mesh(values: Mapping[str, Any], found: Evidence) -> None:
    """A mesh that is none."""
    values["attempt"]()
    found.true("it is rejected", False)


def check_modes(values: Mapping[str, Any], found: Evidence) -> None:
    """An element has the six rigid motions of a body, and no other, at no energy."""
    nodes, directors = shells.element_shape(values["element"])
    element = element_stiffness(nodes, np.array([[0, 1, 2, 3]]), directors, poisson=0.3)
    K = element.combine(modulus_MPa=1.0, thickness_mm=values["thickness"])[0]
    rigid = K @ shells.rigid_modes(nodes).reshape(24, 6)
    found.add("no force under a rigid motion, of the stiffness", rigid / np.abs(K).max(), 1e-10)
    scale = 1.0 / np.sqrt(np.diag(K))
    modes = np.linalg.eigvalsh(scale[:, None] * K * scale)
    found.add("six eigenvalues of the scaled matrix are zero", modes[:6], 1e-13)
    found.true("the seventh is not", modes[6] > 1e-11)


def check_drilling(values: Mapping[str, Any], found: Evidence) -> None:
    """The factor of the drilling stiffness has no effect."""
    case = values["build"](16)
    for drilling in (1e-4, 1e-2):
        ratio = replace(case, drilling=drilling).ratio() / case.ratio()
        found.add(f"a factor of {drilling:g} against the default", ratio - 1.0, 1e-3)


def check_turned(values: Mapping[str, Any], found: Evidence) -> None:
    """The shell turned in space, its nodes renumbered; and under a billionth of its load."""
    case = values["build"]()
    there = shells.turned(case).ratio() / case.ratio()
    found.add("the shell in its own frame", there - 1.0, 1e-8, kind="symmetry")
    tiny = replace(case, loads=1e-9 * case.loads).motion()
    found.close("a billionth of the load", 1e9 * tiny, case.motion(), 1e-10, kind="units")


def check_patch(values: Mapping[str, Any], found: Evidence) -> None:
    """Constant strain or curvature and shear on a distorted plate under its boundary's motion."""
    plate = patch(lambda a, b: np.column_stack([2.0 * a, 1.5 * b, 0.0 * a]), 5, 4, jitter=0.3)
    x, y, o = plate.nodes[:, 0], plate.nodes[:, 1], np.zeros(len(plate.nodes))
    w = 0.5 * x * x - 0.3 * y * y + 0.45 * x * y
    fields = {
        "membrane": [x + 0.1 * y, 0.6 * x - 0.4 * y, o, o, o, o + 0.25],
        "bending": [o, o, w, 0.45 * x - 0.6 * y, -x - 0.45 * y, o],
    }
    exact = np.column_stack(fields[values["kind"]]).ravel()
    edge = np.any((plate.ab == 0.0) | (plate.ab == 1.0), axis=1)
    none = np.zeros((len(x), 6))
    numbers = {"reference": 1.0, "modulus": 7.0, "poisson": 0.3, "thickness": 0.1}
    model = problem(plate, ((edge, CLAMPED),), none, none, **numbers).model()
    held = np.where(np.repeat(edge, 6), exact, 0.0)
    moved = model.solve(-(model.stiffness @ held).reshape(-1, 1)).motion.ravel() + held
    found.close("the exact field", moved, exact, 1e-10)


def _panel(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cylindrical panel of radius and length 1; it bends without stretching."""
    return np.column_stack([np.sin(1.5 * a), b, np.cos(1.5 * a)])


def _hyperboloid(a: FloatArray, b: FloatArray) -> FloatArray:
    radius = np.sqrt(1.0 + b * b)
    return np.column_stack([radius * np.cos(1.5 * a), radius * np.sin(1.5 * a), b])


def _flat(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.column_stack([100.0 * a, b, 0.0 * a])


CORNER_LOADED: dict[str, tuple[Any, ...]] = {
    **{f"panel, t/R {t:g}": (_panel, 16, 16, t) for t in (0.3, 0.1, 0.01, 1e-3, 1e-4, 1e-5)},
    **{f"hyperboloid, t/R {t:g}": (_hyperboloid, 16, 16, t) for t in (0.1, 1e-3, 1e-5)},
    "panel, 64 × 64, t/R 1e-4": (_panel, 64, 64, 1e-4),
    **{f"row of 40, t {t:g}": (_flat, 40, 1, t) for t in (0.3, 0.01, 1e-4)},
    "elements of aspect 100": (_flat, 10, 10, 0.1),
    "ν 0": (_panel, 16, 16, 0.01, 0.0),
    "ν 0.4999": (_panel, 16, 16, 0.01, 0.4999),
    "10 m, E 1e-3 MPa": (_panel, 16, 16, 0.01, 0.3, 1e-3, 1e4),
    "1 mm, E 1e6 MPa": (_panel, 16, 16, 0.01, 0.3, 1e6),
}
"""Shells clamped along a side: surface, divisions, thickness, ν, E, size."""


def check_rounding_error(values: Mapping[str, Any], found: Evidence) -> None:
    """The rounding error that a solution reports, against solutions of the shell rotated."""
    surface, na, nb, t, *more = values["shell"]
    v, E, size = np.append(more, (0.3, 1000.0, 1.0)[len(more) :])

    def solve(turn: FloatArray) -> tuple[FloatArray, float]:
        part = patch(surface, na, nb)
        loads = np.zeros((len(part.nodes), 6))
        loads[-1, :3] = 1e-9 * (turn @ [0.3, 0.2, 1.0])
        mesh = replace(part, nodes=size * part.nodes @ turn.T, normals=part.normals @ turn.T)
        holds = ((part.ab[:, 0] == 0.0, CLAMPED),)
        numbers = {"thickness": size * t, "modulus": E, "poisson": v, "reference": 1.0}
        model = problem(mesh, holds, loads, loads, **numbers).model()
        solution = model.solve(loads.reshape(-1, 1))
        return solution.motion[:, :3, 0] @ turn, solution.error

    motion, reported = solve(np.eye(3))
    others = [solve(Rotation.random(random_state=seed).as_matrix())[0] for seed in (1, 2, 3)]
    true = max(np.abs(other - motion).max() for other in others) / np.abs(motion).max()
    found.add("true error / reported, three other orientations", true / reported, 2.0)


def check_thin_limit(_: Mapping[str, Any], found: Evidence) -> None:
    """The closed solution with shear tends to Kirchhoff-Love's: w = Q / (2 β³ D)."""
    t, v = 1e-6, 0.3
    beta, D = (3.0 * (1.0 - v * v)) ** 0.25 / np.sqrt(t), t**3 / 12.0 / (1.0 - v * v)
    exact = shells.ring_deflection(radius=1.0, thickness=t, modulus=1.0, poisson=v)
    found.add("Kirchhoff-Love", exact * 2.0 * beta**3 * D - 1.0, 1e-5)


def check_rounding(_: Mapping[str, Any], found: Evidence) -> None:
    """Free at the far end too, a shell has motions that cost next to no energy."""
    case = shells.ring_case(48, thickness_over_radius=1e-6)
    far = case.mesh.ab[:, 1] == 1.0
    case.fixed[far] = False
    case.fixed[far, 2] = True
    case.ratio()
    found.true("it is rejected", False)


CASES = cases()


@CASES.parametrize
def test_shell(case: Case, record_property: Recorder) -> None:
    """The linear shell against closed and published solutions."""
    verify(case, record_property)
