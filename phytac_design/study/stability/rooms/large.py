"""Large displacements: Euler's elastica, a strip rolled up, published snaps; balance, units."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Equilibrium, Loading
from phytac_design.mechanics.large.path_tracing import trace_displacement
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.verification.case_parts import hold, no_support, patch
from phytac_design.mechanics.verification.large_cases import ROOF, hinged_roof
from phytac_design.study.stability.case import Case, Evidence, Room
from phytac_shapes.arrays import FloatArray

RESIDUAL = 1e-6
"""Of equilibrium, relative: the solver's own promise."""
TURN_STEPS = 8


def elastica(force: float) -> tuple[float, float]:
    """Tip's way back and aside, of the length, under an end force PL²/EI (Bisshopp and Drucker).

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
    hold(fixed, mesh.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
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
    found.add("unbalanced force, of the nodal ones", end.residual, RESIDUAL, kind="balance")
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
        Loading(force=force.ravel()),
        factors=tuple(np.linspace(0.0, 1.0, TURN_STEPS + 1)[1:]),
    )
    moved = ends[-1].state.displacement_mm[tip].mean(axis=0) / length
    back, aside = elastica(number)
    # Shear and stretch, which the elastica has not: of the order of (t/L)².
    soft = 4.0 * ratio**2
    found.add("elastica: way aside, of the length", moved[2] - aside, 0.003 + soft)
    found.add("elastica: way back, of the length", -moved[0] - back, 0.003 + soft)
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
        Loading(force=force.ravel()),
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
    path = trace_displacement(
        model, Loading(force=load), dof=6 * middle + 2, stops_mm=[-0.5 * sag, -sag]
    )
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
    end = solve_large(model, Loading(force=share * load))[0]
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
    again = solve_large(other, Loading(force=there.ravel()))[0].state.displacement_mm
    found.close(f"lengths times {factor:g}", again / factor, moved, 1e-6, kind="units")
    found.true("the middle goes down", moved[middle, 2] < 0.0)


def check_bad(values: Mapping[str, Any], found: Evidence) -> None:
    """A load that is none."""
    model, load, _ = hinged_roof(4, thickness=12.7)
    force = load.copy()
    force[7] = values["value"]
    if values["value"] == 0.0:
        force[:] = 0.0
    solve_large(model, Loading(force=force))
    found.true("it is refused", False)


def cases() -> list[Case]:
    """Strips of every slenderness and material; snaps; next to no load and other units."""
    out = []

    def add(name: str, check: str, expect: Any = "right", **values: Any) -> None:
        out.append(Case(room="large", name=name, check=check, expect=expect, values=values))

    for number in (1e-6, 0.1, 1.0, 4.0, 10.0, 30.0):
        add(
            f"end force PL²/EI {number:g}",
            "bent",
            n=24,
            length=10.0,
            ratio=0.01,
            modulus=1.2e6,
            number=number,
        )
    # No element is shorter than the strip is thick: that is no shell any more.
    for ratio, n in ((0.1, 8), (1e-3, 24), (1e-4, 24)):
        add(
            f"end force on a strip of t/L {ratio:g}",
            "bent",
            n=n,
            length=10.0,
            ratio=ratio,
            modulus=1.2e6,
            number=4.0,
        )
    for length, modulus in ((1e-3, 1e6), (1e4, 1e-3), (10.0, 1e-6)):
        add(
            f"end force on a strip {length:g} mm long, E {modulus:g} MPa",
            "bent",
            n=24,
            length=length,
            ratio=0.01,
            modulus=modulus,
            number=4.0,
        )
    for turns in (0.25, 0.5, 1.0):
        add(
            f"rolled up by {turns:g} turns",
            "rolled",
            n=24,
            length=12.0,
            ratio=1.0 / 120.0,
            modulus=1.2e6,
            turns=turns,
        )
    add("rolled up, t/L 0.001", "rolled", n=24, length=12.0, ratio=1e-3, modulus=1.2e6, turns=0.5)
    add("hinged roof at its limit", "roof", n=12)
    for thickness in (12.7, 50.0, 1.0):
        for factor in (1e-3, 1e3):
            add(
                f"roof of {thickness:g} mm, next to no load, lengths times {factor:g}",
                "small",
                thickness=thickness,
                share=1e-9,
                factor=factor,
                linear=True,
            )
    for share in (0.3, 0.6):
        add(
            f"roof at {share:g} of its load, in metres",
            "small",
            thickness=12.7,
            share=share,
            factor=1e-3,
            linear=False,
        )
    for value in (float("nan"), float("inf"), 0.0):
        add(f"a load of {value}", "bad", "refused", value=value)
    return out


ROOM = Room(
    name="large",
    about="large displacements against the elastica, a circle, published snaps",
    checks={
        "bent": check_bent,
        "rolled": check_rolled,
        "roof": check_roof,
        "small": check_small,
        "bad": check_bad,
    },
    cases=cases,
)
