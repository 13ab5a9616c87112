"""Large displacements: Euler's elastica, a strip rolled up, published snaps; balance, units."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.corotational import Configuration, Corotational
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Equilibrium
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from verification.case import Case, Cases, Evidence, Recorder, verify
from verification.large_shells import ROOF, hinged_roof
from verification.path_tracing import trace_displacement
from verification.shells import CLAMPED, SYMMETRY, at, hold, no_support, patch, problem, weights

TURN_STEPS = 8


def elastica(force: float) -> tuple[float, float]:
    """Axial and lateral tip displacement / length, end force PL²/EI (Bisshopp and Drucker).

    θ'' = −F cos θ along s in 0 … 1, θ(0) = 0, θ'(1) = 0.
    """
    from scipy.integrate import solve_bvp

    def slope(_: FloatArray, y: FloatArray, p: float) -> FloatArray:
        return np.stack([y[1], -p * np.cos(y[0])])

    s = np.linspace(0.0, 1.0, 101)
    start = np.stack([s * (2.0 - s) * min(force, 2.5) / 2.0, (1.0 - s) * min(force, 2.5)])
    done = solve_bvp(
        lambda t, y: slope(t, y, force),
        lambda a, b: np.array([a[0], b[1]]),
        s,
        start,
        tol=1e-9,
        max_nodes=100_000,
    )
    t = np.linspace(0.0, 1.0, 20_001)
    theta = done.sol(t)[0]
    return float(1.0 - np.trapezoid(np.cos(theta), t)), float(np.trapezoid(np.sin(theta), t))


def strip(n: int, *, length: float, thickness: float, modulus: float) -> tuple[ShellModel, Any]:
    """Clamped strip a tenth as wide as long, ν = 0; and its tip's nodes."""
    width = 0.1 * length
    mesh = patch(lambda a, b: np.column_stack([length * a, width * b, 0.0 * a]), n, 1)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, CLAMPED)
    model = ShellModel(
        mesh.nodes,
        mesh.quads,
        mesh.normals,
        thickness_mm=thickness,
        modulus_MPa=modulus,
        poisson=0.0,
        fixed=fixed,
    )
    return model, np.flatnonzero(mesh.ab[:, 0] == 1.0)


def settled(end: Equilibrium, force: FloatArray, found: Evidence) -> None:
    """What every equilibrium must keep."""
    found.add("unbalanced force, of the nodal ones", end.residual, 1e-6, kind="balance")
    total = (force.reshape(-1, 6)[:, :3] * end.load_factor + end.reactions[:, :3]).sum(axis=0)
    size = np.abs(force.reshape(-1, 6)[:, :3]).sum() * abs(end.load_factor)
    stiff = float(np.abs(end.reactions[:, :3]).sum())
    if size > 0.0:
        found.add("sum of forces", total / max(size, stiff), 1e-5, kind="balance")
    found.true("every number is finite", np.isfinite(end.state.displacement_mm))
    found.true("the path was followed", not end.jumped)
    found.facts["iterations"] = float(end.iterations)


def check_bent(values: Mapping[str, Any], found: Evidence) -> None:
    """A strip under an end force, by the elastica."""
    length, ratio, modulus = values["length"], values["ratio"], values["modulus"]
    thickness = ratio * length
    model, tip = strip(values["n"], length=length, thickness=thickness, modulus=modulus)
    bending = modulus * 0.1 * length * thickness**3 / 12.0
    number = values["number"]
    force = np.zeros((len(model.nodes_mm), 6))
    force[tip, 2] = number * bending / length**2 / 2.0
    ends = solve_large(
        model,
        force.ravel(),
        factors=tuple(np.linspace(0.0, 1.0, TURN_STEPS + 1)[1:]),
    )
    moved = ends[-1].state.displacement_mm[tip].mean(axis=0) / length
    back, aside = elastica(number)
    # Shear and stretch, which the elastica has not: of the order of (t/L)².
    soft = 4.0 * ratio**2
    found.add("elastica: lateral, of the length", moved[2] - aside, 0.003 + soft)
    found.add("elastica: axial, of the length", -moved[0] - back, 0.003 + soft)
    settled(ends[-1], force.ravel(), found)


def check_rolled(values: Mapping[str, Any], found: Evidence) -> None:
    """A strip rolled up by an end moment: a circle."""
    length, ratio, turns = values["length"], values["ratio"], values["turns"]
    thickness, modulus = ratio * length, values["modulus"]
    model, tip = strip(values["n"], length=length, thickness=thickness, modulus=modulus)
    bending = modulus * 0.1 * length * thickness**3 / 12.0
    force = np.zeros((len(model.nodes_mm), 6))
    angle = 2.0 * np.pi * turns
    force[tip, 4] = -bending * angle / length / 2.0
    ends = solve_large(
        model,
        force.ravel(),
        factors=tuple(np.linspace(0.0, 1.0, 2 * TURN_STEPS + 1)[1:]),
    )
    moved = ends[-1].state.displacement_mm[tip].mean(axis=0) / length
    exact = np.array([np.sin(angle) / angle - 1.0, (1.0 - np.cos(angle)) / angle])
    found.add("circle: tip, of the length", moved[[0, 2]] - exact, 0.01)
    settled(ends[-1], force.ravel(), found)


def check_roof(values: Mapping[str, Any], found: Evidence) -> None:
    """Hinged roof at its published limit (Sze, Liu and Lo)."""
    model, load, middle = hinged_roof(values["n"], thickness=12.7)
    sag = ROOF[12.7]["limit at"]
    path = trace_displacement(model, load, dof=6 * middle + 2, stops_mm=[-0.5 * sag, -sag])
    found.add(
        "Sze, Liu and Lo: load at the tabled limit",
        path[-1].load_factor / ROOF[12.7]["limit"] - 1.0,
        0.03,
    )
    settled(path[-1], load, found)


def check_small(values: Mapping[str, Any], found: Evidence) -> None:
    """Under next to no load large displacements are linear; in other units they are the same."""
    model, load, middle = hinged_roof(8, thickness=values["thickness"])
    share = values["share"]
    end = solve_large(model, share * load)[0]
    moved = end.state.displacement_mm
    linear = model.solve(load).motion[:, :3, 0] * share
    if values["linear"]:
        found.close("the linear solution", moved, linear, 1e-5)
    settled(end, share * load, found)
    factor = values["factor"]
    turned = np.repeat([1.0, factor], 3)
    other = ShellModel(
        factor * model.nodes_mm,
        model.quads,
        model.directors,
        thickness_mm=factor * values["thickness"],
        modulus_MPa=model.modulus_MPa / factor**2,
        poisson=model.poisson,
        fixed=model.fixed,
    )
    there = (share * load).reshape(-1, 6) * turned
    again = solve_large(other, there.ravel())[0].state.displacement_mm
    found.close(f"lengths times {factor:g}", again / factor, moved, 1e-6, kind="units")
    found.true("the middle goes down", moved[middle, 2] < 0.0)


def check_bad(values: Mapping[str, Any], found: Evidence) -> None:
    """A load that is none."""
    model, load, _ = hinged_roof(4, thickness=12.7)
    force = load.copy()
    force[7] = values["value"]
    if values["value"] == 0.0:
        force[:] = 0.0
    solve_large(model, force)
    found.true("it is rejected", False)


ROTATED = {
    "square": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    "skewed": [[0, 0, 0], [1, 0.2, 0], [1.7, 1.1, 0], [0.4, 0.9, 0]],
    "trapezoid": [[0, 0, 0], [1, 0, 0], [0.6, 1, 0], [0.4, 1, 0]],
    "needle 1 : 100": [[0, 0, 0], [100, 0, 0], [100, 1, 0], [0, 1, 0]],
    "warped": [[0, 0, 0.2], [1, 0, -0.2], [1, 1, 0.2], [0, 1, -0.2]],
    "almost a triangle": [[0, 0, 0], [1, 0, 0], [0.51, 1, 0], [0.49, 1, 0]],
}


def check_rigid(values: Mapping[str, Any], found: Evidence) -> None:
    """A rigid rotation stresses no element; a stretch of 1 % does."""
    nodes = np.array(ROTATED[values["element"]], dtype=float)
    fixed = np.zeros((4, 6), dtype=bool)
    fixed[0] = True
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    numbers: dict[str, Any] = {"thickness_mm": 0.1, "modulus_MPa": 2200.0, "poisson": 0.38}
    model = ShellModel(nodes, np.array([[0, 1, 2, 3]]), normals, fixed=fixed, **numbers)
    shell = Corotational(model)
    q = rot.exponential(values["angle"] * np.array([0.6, -0.48, 0.64]))
    move = nodes @ rot.deviation(q).T + [3.0, -1.0, 2.0]
    state = Configuration(displacement_mm=move, quaternion=np.tile(q, (4, 1)))
    stiff = np.ptp(nodes, axis=0).max() * abs(model.stiffness).max()
    force = shell.internal(state)
    found.add("no force under a rigid rotation, of the stiffness", force / stiff, 1e-12)
    state.displacement_mm[2] += 0.01 * rot.matrix(q) @ (nodes[2] - nodes[0])
    force = shell.internal(state)
    found.true("a stretch is felt", np.abs(force).max() > 1e-5 * abs(model.stiffness).max())


def check_rotated(_: Mapping[str, Any], found: Evidence) -> None:
    """A roof in another frame and with other numbers of its nodes."""
    model, load, middle = hinged_roof(8, thickness=12.7)
    Q = rot.matrix(rot.exponential(np.array([2.0, -1.0, 0.5])))
    new = np.random.default_rng(3).permutation(len(model.nodes_mm))
    old = np.argsort(new)
    # Supports along the old axes have no counterpart in new ones: clamp the supported nodes.
    clamped = np.repeat(model.fixed.any(axis=1, keepdims=True), 6, axis=1)
    clamped[middle] = False
    section: dict[str, Any] = {"thickness_mm": 12.7, "modulus_MPa": 3102.75, "poisson": 0.3}
    plain = ShellModel(model.nodes_mm, model.quads, model.directors, fixed=clamped, **section)
    other = ShellModel(
        (model.nodes_mm @ Q.T)[old],
        np.roll(new[model.quads], 2, axis=1),
        (model.directors @ Q.T)[old],
        fixed=clamped[old],
        **section,
    )
    force = 20.0 * load
    there = (force.reshape(-1, 2, 3) @ Q.T)[old]
    a = solve_large(plain, force)[0].state.displacement_mm
    b = solve_large(other, there.ravel())[0].state.displacement_mm
    found.close("the same roof in its own frame", b[new] @ Q, a, 1e-6, kind="symmetry")
    found.true("the displacement is large", np.abs(a).max() > 3.0)


def check_tube(values: Mapping[str, Any], found: Evidence) -> None:
    """A quarter of a clamped tube pressed at a node by about twice its wall."""
    radius, ratio = 30.0, values["ratio"]

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.column_stack([radius * np.cos(np.pi * a), radius * np.sin(np.pi * a), 60.0 * b])

    mesh = patch(surface, 16, 12)
    a, b = mesh.ab.T
    node = at(mesh, 0.0, 1.0)
    case = problem(
        mesh,
        ((b == 0.0, CLAMPED), ((a == 0.0) | (a == 1.0), SYMMETRY[1]), (b == 1.0, SYMMETRY[2])),
        weights(mesh, (node, 0, -1.0)),
        weights(mesh, (node, 0, -1.0)),
        reference=2.0 * min(ratio, 0.05) * radius,
        thickness=ratio * radius,
        modulus=2200.0,
        poisson=0.38,
    )
    # ratio() is the displacement by the linear solution over the wanted one.
    force = case.loads.ravel() / case.ratio()
    end = solve_large(case.model(), force)[0]
    settled(end, force, found)
    share = -end.state.displacement_mm[node, 0] / case.reference
    found.true("moved by a third to three times the linear solution", 0.3 < share < 3.0)
    found.true("the equilibrium is stable", end.stable)


ROLL = {"n": 24, "length": 12.0, "modulus": 1.2e6}


def cases() -> Cases:  # noqa: C901 - a table
    """Strips of every slenderness and material; snaps; next to no load and other units."""
    out = Cases()
    bent = {"n": 24, "length": 10.0, "ratio": 0.01, "modulus": 1.2e6, "number": 4.0}
    for number in (1e-6, 0.1, 1.0, 4.0, 10.0, 30.0):
        out.add(f"end force PL²/EI {number:g}", check_bent, **bent | {"number": number})
    # Elements shorter than the strip is thick would be no shell.
    for ratio, n in ((0.1, 8), (1e-3, 24), (1e-4, 24)):
        name = f"end force on a strip of t/L {ratio:g}"
        out.add(name, check_bent, **bent | {"ratio": ratio, "n": n})
    for length, modulus in ((1e-3, 1e6), (1e4, 1e-3), (10.0, 1e-6)):
        name = f"end force on a strip {length:g} mm long, E {modulus:g} MPa"
        out.add(name, check_bent, **bent | {"length": length, "modulus": modulus})
    for turns in (0.25, 0.5, 1.0):
        out.add(f"rolled up by {turns:g} turns", check_rolled, ratio=1 / 120, turns=turns, **ROLL)
    out.add("rolled up, t/L 0.001", check_rolled, ratio=1e-3, turns=0.5, **ROLL)
    out.add("hinged roof at its limit", check_roof, n=12)
    for thickness in (12.7, 50.0, 1.0):
        for factor in (1e-3, 1e3):
            name = f"roof of {thickness:g} mm, next to no load, lengths times {factor:g}"
            numbers = {"thickness": thickness, "share": 1e-9, "factor": factor}
            out.add(name, check_small, linear=True, **numbers)
    for share in (0.3, 0.6):
        numbers = {"thickness": 12.7, "share": share, "factor": 1e-3}
        out.add(f"roof at {share:g} of its load, in metres", check_small, linear=False, **numbers)
    for value in (float("nan"), float("inf"), -float("inf"), 0.0):
        out.add(f"a load of {value}", check_bad, "refused", value=value)
    for name in ROTATED:
        for degrees in (170.0, -170.0, 180.0):
            title = f"rigid rotation by {degrees:g}°, element {name}"
            out.add(title, check_rigid, element=name, angle=np.radians(degrees))
    out.add("roof rotated in space, nodes renumbered", check_rotated)
    for ratio in (0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-6):
        out.add(f"tube of t/R {ratio:g} pressed by twice its wall", check_tube, ratio=ratio)
    return out


CASES = cases()


@CASES.parametrize
def test_large_displacements(case: Case, record_property: Recorder) -> None:
    """Large displacements against the elastica, a circle, published snaps."""
    verify(case, record_property)
