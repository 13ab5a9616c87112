"""Shell mechanics against closed and published solutions; balance, units, axes."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.verification import cases as published
from phytac_design.mechanics.verification.case_parts import (
    SYMMETRY,
    Patch,
    at,
    hold,
    no_support,
    patch,
    weights,
)
from phytac_design.mechanics.verification.case_parts import Case as Shell
from phytac_design.mechanics.verification.plate_case import plate_case
from phytac_design.mechanics.verification.ring_case import ring_case
from phytac_design.mechanics.verification.single_row import arch_case
from phytac_design.study.stability.case import Case, Evidence, Expect, Room
from phytac_shapes.arrays import FloatArray

ROUNDING = 1e-10
"""Of balances, relative, beside what their own terms round to."""
EPS = 2.0**-52
"""Rounding of one term, twice over."""


def balances(
    model: ShellModel, loads: FloatArray, motion: FloatArray, reactions: FloatArray, found: Evidence
) -> None:
    """Forces, moments and energy of one load (N, 6)."""
    found.facts["condition"] = model.condition()
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
    case = BUILD[values["build"]](**values.get("numbers", {}))
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
    """Translations: rotations have another unit."""
    return motion[:, :3]


def _in_units(case: Shell, factor: float) -> Shell:
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


def _turned(case: Shell) -> Shell:
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


def cantilever_case(n: int, *, length: float, width: float, thickness: float) -> Shell:
    """Strip under an end force 1, ν = 0: PL³/3EI + PL/(5/6 G A)."""
    mesh = patch(lambda a, b: np.column_stack([length * a, width * b, 0.0 * a]), n, 1)
    return _strip(mesh, length, width, thickness)


def distorted_case(n: int, *, skew: float) -> Shell:
    """The same with its elements' sides leaning by ``skew`` of their length, both ways in turn."""
    length, width, thickness = 10.0, 1.0, 0.1

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        lean = np.where(np.rint(a * n).astype(int) % 2 == 1, skew / n, 0.0) * (2.0 * b - 1.0)
        inner = (a > 1e-4) & (a < 1.0 - 1e-4)
        return np.column_stack([length * (a + np.where(inner, lean, 0.0)), width * b, 0.0 * a])

    mesh = patch(surface, n, 1)
    flat = replace(mesh, normals=np.tile([0.0, 0.0, 1.0], (len(mesh.nodes), 1)))
    return _strip(flat, length, width, thickness)


def _strip(mesh: Patch, length: float, width: float, thickness: float) -> Shell:
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(mesh.nodes), 6))
    tip = np.flatnonzero(mesh.ab[:, 0] == 1.0)
    loads[tip, 2] = 0.5
    modulus = 1000.0
    bend = length**3 / 3.0 / (modulus * width * thickness**3 / 12.0)
    shear = length / (5.0 / 6.0 * modulus / 2.0 * width * thickness)
    return Shell(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, *((int(k), 2, 0.5) for k in tip)),
        reference=bend + shear,
        modulus=modulus,
        poisson=0.0,
        thickness=thickness,
    )


def clamped_square_case(n: int, *, thickness: float, poisson: float = 0.3) -> Shell:
    """Quarter of a clamped square, side 2, force at its middle: 0.00560 P a²/D (Timoshenko)."""
    mesh = patch(lambda a, b: np.column_stack([a, b, 0.0 * a]), n, n)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    hold(fixed, (mesh.ab == 1.0).any(axis=1), (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(mesh.nodes), 6))
    middle = at(mesh, 0.0, 0.0)
    loads[middle, 2] = 0.25
    bending = thickness**3 / 12.0 / (1.0 - poisson**2)
    # The figure of Timoshenko's table 37 has three digits; 0.005612 is Taylor and Govindjee's.
    return Shell(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (middle, 2, 1.0)),
        reference=0.005612 * 4.0 / bending,
        modulus=1.0,
        poisson=poisson,
        thickness=thickness,
    )


def stretched_case(n: int, *, poisson: float, jitter: float) -> Shell:
    """A square pulled along x by 1 per length, free across: exactly stretched, on any mesh."""
    mesh = patch(lambda a, b: np.column_stack([a, b, 0.0 * a]), n, n, jitter=jitter)
    mesh = replace(mesh, normals=np.tile([0.0, 0.0, 1.0], (len(mesh.nodes), 1)))
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, (0,))
    hold(fixed, (mesh.ab == 0.0).all(axis=1), (1, 2, 3, 4, 5))
    hold(fixed, mesh.ab[:, 0] == 0.0, (2, 4))
    loads = np.zeros((len(mesh.nodes), 6))
    edge = np.flatnonzero(mesh.ab[:, 0] == 1.0)
    share = np.full(len(edge), 1.0 / n)
    share[[0, -1]] /= 2.0
    loads[edge, 0] = share
    corner = at(mesh, 1.0, 1.0)
    return Shell(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (corner, 0, 1.0), (corner, 1, -1.0)),
        reference=(1.0 + poisson) / 0.1,
        modulus=1.0,
        poisson=poisson,
        thickness=0.1,
    )


BUILD: dict[str, Callable[..., Shell]] = {
    "ring": ring_case,
    "plate": plate_case,
    "arch": arch_case,
    "cantilever": cantilever_case,
    "distorted": distorted_case,
    "square": clamped_square_case,
    "stretched": stretched_case,
    "roof": published.scordelis_lo_case,
    "pinched": published.pinched_cylinder_case,
    "hemisphere": published.hemisphere_with_hole_case,
    "hyperboloid": published.hyperboloid_case,
    "hook": published.raasch_hook_case,
    "beam": published.twisted_beam_case,
}


THIN = ("plate, t/a 1e-06", "arch, t 1e-05, 1 wide")


def _adder(out: list[Case]) -> Callable[..., None]:
    def add(name: str, build: str, reference: str, tolerance: float, **numbers: Any) -> None:
        # So thin, a shell may be refused: its stiffness is singular to the last digit.
        expect: Expect = "either" if name in THIN else "right"
        out.append(
            Case(
                room="shell",
                name=name,
                check="case",
                expect=expect,
                values={
                    "build": build,
                    "reference": reference,
                    "tolerance": tolerance,
                    "numbers": numbers,
                },
            )
        )

    return add


def cases() -> list[Case]:
    """Thin, thick, tiny, huge, soft, stiff, nearly incompressible, distorted, flat, curved."""
    out: list[Case] = []
    add = _adder(out)

    ring = "ring load on a cylinder: closed solution with shear"
    for t in (0.5, 0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-5):
        add(f"ring load, t/R {t:g}", "ring", ring, 0.005, n=48, thickness_over_radius=t)
    for v in (0.0, 0.45, 0.499, 0.4999, 0.499999):
        add(f"ring load, ν {v:g}", "ring", ring, 0.005, n=48, poisson=v)
    for E, R in ((1e-3, 30.0), (1e6, 30.0), (2200.0, 1e-3), (2200.0, 1e6)):
        add(f"ring load, E {E:g} MPa, R {R:g} mm", "ring", ring, 0.01, n=32, modulus=E, radius=R)
    for load in (1e-200, 1e200):
        add(f"ring load of {load:g} N/mm", "ring", ring, 0.01, n=32, load=load)
    add(
        "ring load, jittered mesh",
        "ring",
        ring,
        0.02,
        n=48,
        around=38,
        thickness_over_radius=0.1,
        jitter=0.25,
    )
    plate = "Navier's plate with shear"
    for t in (0.5, 0.1, 1e-2, 1e-4, 1e-6):
        add(f"plate, t/a {t:g}", "plate", plate, 0.01, n=16, thickness=t)
    add("plate, jittered mesh", "plate", plate, 0.02, n=16, thickness=0.01, jitter=0.3)
    for t, width in ((1.0, 1.0), (0.1, 1.0), (1e-3, 1.0), (1e-3, 65.0), (0.1, 0.05), (1e-5, 1.0)):
        add(
            f"arch, t {t:g}, {width:g} wide",
            "arch",
            "Castigliano",
            0.005,
            n=24,
            thickness=t,
            width=width,
        )
    return out + _strips() + _bad()


def _strips() -> list[Case]:
    """Strips, flat squares, and shells that were published."""
    out: list[Case] = []
    add = _adder(out)
    # As long as it is thick, half of a strip's sag is shear: its factor shows.
    strips = ((10, 1, 0.1), (1000, 1, 1), (10, 1e-2, 1e-2), (10, 1000, 0.1), (2, 1, 1), (1, 1, 1))
    for length, width, t in strips:
        add(
            f"strip {length:g} x {width:g} x {t:g}",
            "cantilever",
            "Timoshenko's beam",
            0.005,
            n=32,
            length=length,
            width=width,
            thickness=t,
        )
    for skew in (0.1, 0.4, 0.8):
        add(
            f"strip, elements leaning by {skew:g}",
            "distorted",
            "Timoshenko's beam",
            0.02,
            n=32,
            skew=skew,
        )
    for t in (1e-2, 1e-4):
        add(
            f"clamped square, t/a {t / 2:g}",
            "square",
            "Timoshenko, table 37; six digits by Taylor and Govindjee",
            0.01,
            n=24,
            thickness=t,
        )
    for v in (0.0, 0.3, 0.4999):
        add(
            f"plain stretch, ν {v:g}, any mesh",
            "stretched",
            "Hooke",
            1e-9,
            n=6,
            poisson=v,
            jitter=0.4,
        )
    add("Scordelis-Lo roof", "roof", "published 0.3024", 0.015, n=16)
    add("Scordelis-Lo roof, jittered", "roof", "published 0.3024", 0.03, n=16, jitter=0.3)
    add("pinched cylinder", "pinched", "MacNeal and Harder", 0.03, n=24)
    for t in (0.4, 0.04):
        if t == 0.04:
            add("hemisphere with a hole", "hemisphere", "MacNeal and Harder", 0.01, n=16)
    add("Raasch hook", "hook", "Knight (1997)", 0.03, n=20)
    add("twisted beam", "beam", "MacNeal and Harder", 0.01, n=12)
    for t in (0.1, 1e-3):
        add(f"free hyperboloid, t/L {t:g}", "hyperboloid", "published", 0.02, n=32, thickness=t)
    return out


def _bad() -> list[Case]:
    """What no shell is: refused."""
    bad: list[tuple[str, dict[str, Any]]] = [
        ("ν of 0.5", {"poisson": 0.5}),
        ("ν below 0", {"poisson": -0.1}),
        ("ν not a number", {"poisson": float("nan")}),
        ("no modulus", {"modulus": 0.0}),
        ("modulus not a number", {"modulus": float("nan")}),
        ("no thickness", {"thickness_over_radius": 0.0}),
        ("radius infinite", {"radius": float("inf")}),
        ("load not a number", {"load": float("nan")}),
        ("load infinite", {"load": float("inf")}),
    ]
    return [
        Case(
            room="shell",
            name=f"ring load, {name}",
            check="raw",
            expect="refused",
            values={"change": change},
        )
        for name, change in bad
    ]


def check_raw(values: Mapping[str, Any], found: Evidence) -> None:
    """A sound case with one number spoilt, handed to the solver as it is."""
    case = ring_case(8)
    change = dict(values["change"])
    load = change.pop("load", 1.0)
    radius = change.pop("radius", 1.0)
    thickness = change.pop("thickness_over_radius", case.thickness)
    with np.errstate(invalid="ignore"):
        mesh = replace(case.mesh, nodes=case.mesh.nodes * radius)
        loads = case.loads * load
    spoilt = replace(case, mesh=mesh, loads=loads, thickness=thickness, **change)
    spoilt.motion()
    found.true("it is refused", False)


ROOM = Room(
    name="shell",
    about="the linear shell against closed and published solutions",
    checks={"case": check_case, "raw": check_raw},
    cases=cases,
)
