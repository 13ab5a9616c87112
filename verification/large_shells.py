"""Published large-displacement shells (Sze, Liu and Lo 2004), and a point-loaded tube."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Equilibrium
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import BoolArray, FloatArray
from verification.path_tracing import trace_arc, trace_displacement
from verification.shells import (
    CLAMPED,
    SYMMETRY,
    Patch,
    at,
    hemisphere_patch,
    hold,
    no_support,
    patch,
)

END_FORCE = {0.25: (0.563, 3.015), 0.5: (1.604, 4.933), 1.0: (3.286, 6.698)}
"""Cantilever under an end force: λ to (−u, w) at the tip."""
END_MOMENT = {0.25: (4.361, 7.639), 0.5: (12.0, 7.639), 0.75: (14.546, 2.546), 1.0: (12.0, 0.0)}
"""Cantilever under an end moment: λ to (−u, w)."""
HEMISPHERE = {0.1: (1.499, 1.840), 0.3: (2.819, 4.339), 0.5: (3.406, 5.902), 1.0: (4.067, 8.178)}
"""Hemisphere with hole: λ to the inward and outward motion of the loaded points."""
ROOF = {
    12.7: {"limit": 0.7421, "limit at": 11.293, "minimum": 0.1729, "minimum at": 19.852},
    6.35: {
        "limit": 0.1953,
        "limit at": 12.892,
        "farthest": 17.008,
        "minimum": -0.1288,
        "minimum at": 15.778,
        "back to": 14.451,
    },
}
"""Hinged roof by thickness: λ = P/3000 and the sag of the middle, in the order of the path."""


def _model(
    mesh: Patch, fixed: BoolArray, *, thickness: float, modulus: float, poisson: float
) -> ShellModel:
    return ShellModel(
        mesh.nodes,
        mesh.quads,
        mesh.normals,
        thickness_mm=thickness,
        modulus_MPa=modulus,
        poisson=poisson,
        fixed=fixed,
    )


def cantilever(n: int, *, moment: bool) -> tuple[ShellModel, FloatArray, int]:
    """Strip 1 × 0.1, E 1.2e6, ν 0: length 10 with end force 4, or 12 with end moment 50π/3.

    Returns model, load (6N,) at λ = 1 and a node of the tip; n × 1 elements.
    """
    length = 12.0 if moment else 10.0
    mesh = patch(lambda a, b: np.column_stack([length * a, b, 0.0 * a]), n, 1)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, CLAMPED)
    load = np.zeros(fixed.shape)
    tip = mesh.ab[:, 0] == 1.0
    if moment:
        load[tip, 4] = -50.0 * np.pi / 3.0 / 2.0  # about −y: lifts the tip
    else:
        load[tip, 2] = 4.0 / 2.0
    model = _model(mesh, fixed, thickness=0.1, modulus=1.2e6, poisson=0.0)
    return model, load.ravel(), at(mesh, 1.0, 0.0)


def cantilever_tip(n: int, *, moment: bool) -> dict[float, tuple[float, float]]:
    """Motion (−u, w) of the tip at the load factors of the table."""
    model, load, tip = cantilever(n, moment=moment)
    factors = tuple(END_MOMENT if moment else END_FORCE)
    path = solve_large(model, load, factors=factors)
    moved = [state.state.displacement_mm[tip] for state in path]
    return {f: (float(-u[0]), float(u[2])) for f, u in zip(factors, moved, strict=True)}


def hemisphere_points(n: int) -> dict[float, tuple[float, float]]:
    """Inward and outward motion of the loaded points of the hemisphere with an 18° hole."""
    mesh = hemisphere_patch(n)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[0])
    load = np.zeros(fixed.shape)
    first, second = at(mesh, 0.0, 0.0), at(mesh, 1.0, 0.0)
    fixed[first, 2] = True
    load[first, 0], load[second, 1] = 200.0, -200.0
    model = _model(mesh, fixed, thickness=0.04, modulus=6.825e7, poisson=0.3)
    factors = tuple(HEMISPHERE)
    path = solve_large(model, load.ravel(), factors=factors)
    moved = [state.state.displacement_mm for state in path]
    # Sze, Liu and Lo list −v_B (inward) first: the point pulled outward moves less.
    return {
        f: (float(u[first, 0]), float(-u[second, 1])) for f, u in zip(factors, moved, strict=True)
    }


def hinged_roof(
    n: int, *, thickness: float, flatter: float = 1.0
) -> tuple[ShellModel, FloatArray, int]:
    """Quarter of the roof R 2540, half-length 254, half-angle 0.1; P = 3000 at the middle.

    ``flatter``: radius k times larger, half-angle k times smaller (:mod:`solid_roof`).
    """
    radius, angle = 2540.0 * flatter, 0.1 / flatter
    mesh = patch(
        lambda a, b: np.column_stack(
            [radius * np.sin(angle * a), 254.0 * b, radius * np.cos(angle * a)]
        ),
        n,
        n,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, (0, 1, 2))
    middle = at(mesh, 0.0, 0.0)
    load = np.zeros(fixed.shape)
    load[middle, 2] = -750.0
    model = _model(mesh, fixed, thickness=thickness, modulus=3102.75, poisson=0.3)
    return model, load.ravel(), middle


def open_cylinder(n_around: int, n_along: int) -> tuple[ShellModel, FloatArray, int]:
    """Octant of a cylinder with free ends that two forces of 40 000 pull apart (Sze, Liu and Lo).

    Its path bends sharply at about half the load, and dips there by a thousandth of it.
    """
    quarter, radius, half = np.pi / 2.0, 4.953, 10.35 / 2.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [radius * np.sin(quarter * a), half * b, radius * np.cos(quarter * a)]
        ),
        n_around,
        n_along,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[2])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    top = at(mesh, 0.0, 0.0)
    load = np.zeros(fixed.shape)
    load[top, 2] = 40_000.0 / 4.0
    model = _model(mesh, fixed, thickness=0.094, modulus=10.5e6, poisson=0.3125)
    return model, load.ravel(), top


def hinged_arch(n: int) -> tuple[ShellModel, FloatArray, int]:
    """Half of a shallow hinged arch: span 100, rise 2.5, section 1 × 1, a force at its crown."""
    mesh = patch(lambda a, b: np.column_stack([50.0 * a, b, 2.5 * (1.0 - a * a)]), n, 1)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 0] == 1.0, (0, 1, 2))
    fixed[:, [1, 3, 5]] = True  # it stays in its plane
    crown = mesh.ab[:, 0] == 0.0
    load = np.zeros(fixed.shape)
    load[crown, 2] = -1.0 / 2.0
    model = _model(mesh, fixed, thickness=1.0, modulus=1000.0, poisson=0.0)
    return model, load.ravel(), at(mesh, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class RoofPath:
    """Load factor and sag of the middle along the path, and its turning points by ``ROOF``."""

    factor: FloatArray
    sag_mm: FloatArray
    turns: dict[str, float]


def roof_path(n: int, *, thickness: float, longest_mm: float = 0.6) -> RoofPath:
    """Path of the roof to a sag of 25 past its snap, by arc-length."""
    model, load, middle = hinged_roof(n, thickness=thickness)

    def sag(state: Equilibrium) -> float:
        return float(-state.state.displacement_mm[middle, 2])

    path = trace_arc(
        model,
        load,
        first_mm=longest_mm / 2.0,
        longest_mm=longest_mm,
        stop=lambda state: sag(state) > 25.0 and state.load_factor > 0.1,
    )
    factor = np.array([0.0, *(state.load_factor for state in path)])
    down = np.array([0.0, *(sag(state) for state in path)])
    turns = dict(
        zip(("limit", "limit at"), _turn(factor, down, 1.0), strict=True),
        **dict(zip(("minimum", "minimum at"), _turn(factor, down, -1.0), strict=True)),
    )
    if np.any(np.diff(down) < 0.0):
        turns["farthest"], turns["back to"] = (
            _turn(down, factor, 1.0)[0],
            _turn(down, factor, -1.0)[0],
        )
    return RoofPath(factor=factor, sag_mm=down, turns=turns)


def _turn(value: FloatArray, other: FloatArray, sign: float) -> tuple[float, float]:
    """First maximum (sign 1) or minimum (−1) along a path, by a parabola; and ``other`` there."""
    v = sign * value
    k = int(np.flatnonzero((v[1:-1] > v[:-2]) & (v[1:-1] >= v[2:]))[0]) + 1
    s = np.cumsum([0.0, *np.hypot(*np.diff([value / np.ptp(value), other / np.ptp(other)]))])
    part = slice(k - 1, k + 2)
    curve = np.polyfit(s[part] - s[k], value[part], 2)
    peak = -curve[1] / (2.0 * curve[0])
    return float(np.polyval(curve, peak)), float(
        np.polyval(np.polyfit(s[part] - s[k], other[part], 2), peak)
    )


DESIGN_TUBE = {10.0: 0.368, 25.0: 1.209}
"""Design study: inward force (N) at one mid-height node to its displacement (mm)."""


def design_tube(n_around: int, n_along: int) -> dict[float, float]:
    """Tube R 30, L 120, t 0.8, E 2200, ν 0.38, rims clamped; a quarter, force at one node."""
    mesh = patch(
        lambda a, b: np.column_stack([30 * np.cos(np.pi * a), 30 * np.sin(np.pi * a), 60.0 * b]),
        n_around,
        n_along,
    )
    fixed = no_support(mesh)
    hold(fixed, (mesh.ab[:, 0] == 0.0) | (mesh.ab[:, 0] == 1.0), SYMMETRY[1])
    hold(fixed, mesh.ab[:, 1] == 0.0, CLAMPED)
    hold(fixed, mesh.ab[:, 1] == 1.0, SYMMETRY[2])
    node = at(mesh, 0.0, 1.0)
    load = np.zeros(fixed.shape)
    load[node, 0] = -0.25
    model = _model(mesh, fixed, thickness=0.8, modulus=2200.0, poisson=0.38)
    path = solve_large(model, load.ravel(), factors=tuple(DESIGN_TUBE))
    return {
        f: float(-s.state.displacement_mm[node, 0]) for f, s in zip(DESIGN_TUBE, path, strict=True)
    }


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One figure of ours beside a published one, in the units of the source."""

    name: str
    ours: float
    reference: float

    @property
    def error(self) -> float:
        """Relative error; absolute where the reference is 0."""
        return abs(self.ours - self.reference) / (abs(self.reference) or 1.0)


def comparisons(*, strip: int, hemisphere: int, roof: int, tube: int) -> Iterator[Comparison]:
    """All cases of this module at the given number of elements a side (``tube``: a quarter)."""
    curves = (
        (f"cantilever {strip} × 1, end force", END_FORCE, cantilever_tip(strip, moment=False)),
        (f"cantilever {strip} × 1, end moment", END_MOMENT, cantilever_tip(strip, moment=True)),
        (f"hemisphere, hole, {hemisphere} a side", HEMISPHERE, hemisphere_points(hemisphere)),
    )
    for name, reference, found in curves:
        for factor, pair in reference.items():
            for k, value in enumerate(pair):
                label = f"{name}, load factor {factor:g}, {('first', 'second')[k]} motion"
                yield Comparison(name=label, ours=found[factor][k], reference=value)
    for thickness, table in ROOF.items():
        name = f"hinged roof h {thickness:g}, {roof} a side"
        turns = roof_path(roof, thickness=thickness).turns
        for key in ("limit", "farthest", "minimum", "back to"):
            if key in table:
                at_mm = f" (at {turns[key + ' at']:.3f} mm)" if f"{key} at" in turns else ""
                yield Comparison(
                    name=f"{name}, {key} of the exact path{at_mm}",
                    ours=turns[key],
                    reference=table[key],
                )
    yield from _roof_at_tabled_sags(roof)
    for force, motion in design_tube(tube, round(0.73 * tube)).items():
        name = f"tube of the design study, {force:g} N at a node, quarter {tube} a side"
        yield Comparison(name=name, ours=motion, reference=DESIGN_TUBE[force])


def _roof_at_tabled_sags(n: int) -> Iterator[Comparison]:
    model, load, middle = hinged_roof(n, thickness=12.7)
    table = ROOF[12.7]
    for key in ("limit", "minimum"):
        sag = table[f"{key} at"]
        path = trace_displacement(model, load, dof=6 * middle + 2, stops_mm=[-0.5 * sag, -sag])
        yield Comparison(
            name=f"hinged roof h 12.7, {n} a side, load factor at the tabled {key}, {sag} mm",
            ours=path[-1].load_factor,
            reference=table[key],
        )
