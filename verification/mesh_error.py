"""Shells whose discretisation error is known, and what the estimate of it claims.

The truth is the same element on a fine mesh, graded towards layers, extrapolated over it and one of
half its elements a side; a third of their difference is its uncertainty. Sources: Bathe, Iosilevich
and Chapelle (2000) for the partly clamped hyperbolic paraboloid; Morley (1963), Cook (1974) and Lee
and Bathe (2004) for the last three; :mod:`verification.shells` for the others;
:mod:`verification.designs` for sensors.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import plain_mesh
from phytac_design.mechanics.shell.discretisation import ProbedShell, estimate_error
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError
from verification import shells
from verification.designs import SHAPES, design_of
from verification.shells import (
    CLAMPED,
    SYMMETRY,
    ShellProblem,
    Sides,
    at,
    edge_lines,
    patch,
    probed,
    problem,
    sides,
    surface_load,
    weights,
)
from verification.test_shell import clamped_square_case

Build = Callable[[Sides], ShellProblem]
FACTOR_MAX = 3.0
"""An estimate in the asymptotic range is within this factor of the true error."""


@dataclass(frozen=True, kw_only=True)
class ErrorCase:
    """A shell on meshes of any number of elements a side.

    Attributes
    ----------
    name : str
        What it is.
    make : callable
        ``make(sides)`` gives the probed shell.
    finest : (Sides, Sides)
        The meshes of the truth, and half as fine.
    elements : tuple of int
        Elements a side that are judged; multiples of 4.
    """

    name: str
    make: Callable[[Sides], ProbedShell]
    finest: tuple[Sides, Sides]
    elements: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What was claimed on one mesh and what is true, relative to the largest motion.

    Attributes
    ----------
    elements : int
        Elements a side.
    true, uncertainty : float
        True error of the motion on the finest mesh, and how well it is known.
    extrapolated : float
        True error of the extrapolated motion.
    claimed : float
        Claimed error of both.
    rate : float
        Measured rate.
    asymptotic : bool
        Whether the claim is an estimate.
    """

    elements: int
    true: float
    uncertainty: float
    extrapolated: float
    claimed: float
    rate: float
    asymptotic: bool

    @property
    def factor(self) -> float:
        """True over claimed error."""
        return self.true / self.claimed

    @property
    def known(self) -> bool:
        """Whether the true error is known to a third."""
        return self.true > FACTOR_MAX * self.uncertainty

    @property
    def honest(self) -> bool:
        """Whether an asymptotic claim is within ``FACTOR_MAX`` of the truth."""
        return not self.asymptotic or 1.0 / FACTOR_MAX <= self.factor <= FACTOR_MAX


def judge(case: ErrorCase) -> list[Judgement]:
    """Compare claims with the truth on each mesh of a case that is not refused as too irregular."""

    def corrected(mesh: Sides) -> FloatArray:
        part = case.make(mesh)
        motion = part.model.solve(part.loads).motion
        return part.read(motion) + part.correction(motion)

    def largest(field: FloatArray) -> float:
        return float(np.linalg.norm(field, axis=1).max())

    fine, half = (corrected(mesh) for mesh in case.finest)
    truth = fine + (fine - half) / 3.0
    size = largest(truth)
    out = []
    for n in case.elements:
        try:
            found = estimate_error(case.make, (n, n // 2, n // 4))
        except NumericalError as error:
            if error.code != "mesh-distorted":
                raise
            continue
        out.append(
            Judgement(
                elements=n,
                true=largest(truth - found.motion) / size,
                uncertainty=largest(fine - half) / 3.0 / size,
                extrapolated=largest(truth - found.extrapolated) / size,
                claimed=float(found.relative[0]),
                rate=float(found.rate[0]),
                asymptotic=bool(found.asymptotic[0]),
            )
        )
    return out


def partly_clamped_hypar(n: Sides, *, thickness: float) -> ShellProblem:
    """Half of z = x² − y² over the unit square, clamped at x = −½, under its weight."""
    mesh = patch(
        lambda a, b: np.column_stack([a - 0.5, 0.5 * b, (a - 0.5) ** 2 - 0.25 * b * b]), *sides(n)
    )
    a, b = mesh.ab.T
    return problem(
        mesh,
        ((a == 0.0, CLAMPED), (b == 0.0, SYMMETRY[1])),
        _weight(mesh, 8000.0 * thickness),
        weights(mesh, (at(mesh, 1.0, 0.0), 2, -1.0)),
        reference=PARTLY_CLAMPED_HYPAR[thickness],
        modulus=2e11,
        poisson=0.3,
        thickness=thickness,
    )


PARTLY_CLAMPED_HYPAR = {1e-2: 9.3355e-5, 1e-3: 6.3941e-3, 1e-4: 5.2988e-1}
"""Sag of the free end's middle by thickness (Bathe, Iosilevich and Chapelle 2000)."""


def clamped_hypar(
    n: Sides,
    *,
    thickness: float,
    rise: float,
    skew: bool,
    clamped: Callable[[FloatArray, FloatArray], BoolArray] | None = None,
) -> ShellProblem:
    """Surface z = r (x² − y²), or r x y if ``skew``, over the unit square under its weight.

    Clamped on all sides, or where ``clamped(a, b)`` is true.
    """

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        x, y = a - 0.5, b - 0.5
        return np.column_stack([x, y, rise * (x * y if skew else x * x - y * y)])

    mesh = patch(surface, *sides(n))
    a, b = mesh.ab.T
    held = (a == 0.0) | (a == 1.0) | (b == 0.0) | (b == 1.0) if clamped is None else clamped(a, b)
    return problem(
        mesh,
        ((held, CLAMPED),),
        _weight(mesh, 1e3 * thickness),
        weights(mesh, (at(mesh, 0.5, 0.5), 2, -1.0)),
        reference=1.0,
        modulus=2e11,
        poisson=0.3,
        thickness=thickness,
    )


def _weight(mesh: shells.Patch, load: float) -> FloatArray:
    return surface_load(mesh, np.tile([0.0, 0.0, -load], (len(mesh.nodes), 1)))


def _count(n: Sides) -> int:
    """The number of elements a side, where it is one for both."""
    if not isinstance(n, int):
        raise TypeError(f"a number of elements is needed (got {n!r}); give one for both sides")
    return n


@cache
def _sensor_face(shape: str) -> tuple[Design, Surface, FloatArray]:
    """Design of a family, its face, and probes (n, 2) all over it."""
    design = design_of({"shape": shape})
    surface, wall = design.surface(), design.wall.thickness_mm
    size = float(np.sqrt(surface.area_mm2() / 400.0))
    return design, surface, plain_mesh(surface, thickness_mm=wall, size_mm=size).uv


def _sensor(n: Sides, *, shape: str) -> ProbedShell:
    """A patch in the middle of a sensor's face, on a mesh of about (10 n)² elements."""
    design, surface, points = _sensor_face(shape)
    wall, material, area = design.wall.thickness_mm, design.material, surface.area_mm2()
    size = float(np.sqrt(area / 100.0)) / _count(n)
    mesh = plain_mesh(surface, thickness_mm=wall, size_mm=size)
    nodes, shares = locate(mesh, points)
    centre, radius = surface.domain.mean(axis=1), 0.12 * float(np.sqrt(area / np.pi))
    return ProbedShell(
        model=clamped_model(mesh, modulus_MPa=material.modulus_MPa, poisson=material.poisson),
        loads=patch_loads(mesh, surface, centre[None], radius),
        nodes=nodes,
        weights=shares,
    )


def _case(
    name: str,
    build: Callable[..., ShellProblem],
    elements: tuple[int, ...],
    finest: int,
    *,
    layer: float = 0.0,
    ends: tuple[tuple[bool, bool], tuple[bool, bool]] = ((True, True), (True, True)),
    coarsest: int = 4,
) -> ErrorCase:
    """A case probed at the nodes of a coarse mesh; ``layer``: its width, of a side."""
    points = build(coarsest).mesh.nodes

    def graded(n: int) -> Sides:
        if not layer:
            return n
        a, b = (edge_lines(n, layer, ends=end) if any(end) else n for end in ends)
        return a, b

    return ErrorCase(
        name=name,
        make=lambda n: probed(build(n), points),
        finest=(graded(finest), graded(finest // 2)),
        elements=elements,
    )


USUAL = (8, 16, 32)
"""Elements a side of most cases."""


def error_cases() -> Iterator[ErrorCase]:
    """All cases: hyperbolic paraboloids, published shells, plates, strips, sensors."""
    yield from _hypars()
    yield from _published()
    yield from _plates_and_strips()
    yield from later_cases()
    for shape in SHAPES:
        yield ErrorCase(
            name=f"sensor {shape} pressed by a patch",
            make=partial(_sensor, shape=shape),
            finest=(16, 8),
            elements=(8,),
        )


def later_cases() -> Iterator[ErrorCase]:
    """Three cases of the literature, taken up after the method and its settings were fixed."""
    yield _case("Morley's skew plate, 30°", skew_plate, USUAL, 96)
    yield _case("Cook's membrane", cooks_membrane, USUAL, 96)
    yield _case(
        "hyperboloid clamped at its ends, t/L 0.01",
        clamped_hyperboloid,
        USUAL,
        96,
        layer=0.1,
        ends=((False, False), (False, True)),
    )


def skew_plate(n: Sides) -> ShellProblem:
    """Rhombus of 30°, a/t 100, soft simple supports, uniform load; 0.000408 q a⁴/D.

    Morley (1963): moments are singular at the obtuse corners.
    """
    side, modulus, poisson = 100.0, 1e5, 0.3
    c, s = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    mesh = patch(lambda a, b: side * np.column_stack([a + c * b, s * b, 0.0 * a]), *sides(n))
    a, b = mesh.ab.T
    edge = (a == 0.0) | (a == 1.0) | (b == 0.0) | (b == 1.0)
    bending = modulus / 12.0 / (1.0 - poisson**2)
    return problem(
        mesh,
        ((a >= 0.0, (0, 1, 5)), (edge, (2,))),
        surface_load(mesh, np.tile([0.0, 0.0, 1.0], (len(mesh.nodes), 1))),
        weights(mesh, (at(mesh, 0.5, 0.5), 2, 1.0)),
        reference=4.08e-4 * side**4 / bending,
        modulus=modulus,
        poisson=poisson,
        thickness=1.0,
    )


def cooks_membrane(n: Sides) -> ShellProblem:
    """Tapered panel, clamped at one end, sheared at the other; 23.96 (Cook 1974)."""

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        low, high = 44.0 * a, 44.0 + 16.0 * a
        return np.column_stack([48.0 * a, low + b * (high - low), 0.0 * a])

    mesh = patch(surface, *sides(n))
    a, b = mesh.ab.T
    loads = np.zeros((len(mesh.nodes), 6))
    end = a == 1.0
    loads[end, 1] = shells.line_weights(b[end])
    return problem(
        mesh,
        ((a >= 0.0, (2, 3, 4)), (a == 0.0, CLAMPED)),
        loads,
        weights(mesh, (at(mesh, 1.0, 0.5), 1, 1.0)),
        reference=23.96,
        modulus=1.0,
        poisson=1.0 / 3.0,
        thickness=1.0,
    )


def clamped_hyperboloid(n: Sides) -> ShellProblem:
    """The free hyperboloid with its ends clamped, t/L 0.01 (Lee and Bathe 2004)."""
    case = shells.hyperboloid_case(n, thickness=0.01)
    shells.hold(case.fixed, case.mesh.ab[:, 1] == 1.0, CLAMPED)
    return case


def _hypars() -> Iterator[ErrorCase]:
    for t in PARTLY_CLAMPED_HYPAR:
        yield _case(
            f"hypar clamped at one side, t/L {t:g}",
            partial(partly_clamped_hypar, thickness=t),
            USUAL,
            80,
            layer=min(t**0.5, 0.3) / 2.0,
            ends=((True, True), (False, True)),
        )
    hypars = [(False, 1.0, t) for t in (1e-2, 1e-3, 1e-4)]
    hypars += [(True, 0.5, t) for t in (1e-2, 1e-3, 1e-4)] + [(True, 0.1, t) for t in (1e-3, 1e-4)]
    for skew, rise, t in hypars:
        yield _case(
            f"hypar {rise:g}·{'x y' if skew else '(x² − y²)'} clamped, t/L {t:g}",
            partial(clamped_hypar, thickness=t, rise=rise, skew=skew),
            (*USUAL, 64),
            128,
            layer=min(t**0.5, 0.2) / 2.0,
        )
    for t in (1e-2, 1e-3):
        yield _case(
            f"hypar x² − y² clamped at one side, not halved, t/L {t:g}",
            partial(
                clamped_hypar, thickness=t, rise=1.0, skew=False, clamped=lambda a, _: a == 0.0
            ),
            USUAL,
            80,
            layer=t**0.5 / 2.0,
        )


def _published() -> Iterator[ErrorCase]:
    yield _case(
        "Scordelis-Lo roof",
        shells.scordelis_lo_case,
        USUAL,
        80,
        layer=0.014,
        ends=((False, True), (False, True)),
    )
    yield _case(
        "pinched cylinder",
        shells.pinched_cylinder_case,
        (16, 32),
        96,
        layer=0.03,
        ends=((True, False), (True, True)),
    )
    yield _case(
        "hemisphere with a hole",
        shells.hemisphere_with_hole_case,
        USUAL,
        80,
        layer=0.0032,
        ends=((False, False), (True, True)),
    )
    for t in (0.1, 0.01, 0.001):
        yield _case(
            f"free hyperboloid, t/L {t:g}",
            partial(shells.hyperboloid_case, thickness=t),
            USUAL,
            80,
            layer=t,
            ends=((False, False), (False, True)),
        )


def _plates_and_strips() -> Iterator[ErrorCase]:
    for t in (0.1, 1e-4):
        yield _case(f"plate, t/a {t:g}", partial(shells.plate_case, thickness=t), (8, 16), 64)
        name = f"clamped square under a force, t/a {t / 20:g}"
        yield _case(name, partial(clamped_square_case, thickness=t / 10.0), USUAL, 96)
    for t in (0.1, 0.01, 0.001):

        def ring(n: Sides, t: float = t) -> ShellProblem:
            return shells.ring_case(_count(n), around=_count(n), thickness_over_radius=t)

        yield _case(f"ring load on a cylinder, t/R {t:g}", ring, USUAL, 96)
    for t in (0.32, 0.0032):
        for along in (True, False):

            def beam(n: Sides, t: float = t, along: bool = along) -> ShellProblem:
                count = _count(n)
                across = max(1, count // 4)
                return shells.twisted_beam_case(count, thickness=t, in_plane=along, across=across)

            name = f"twisted beam, t {t:g}, force {'along' if along else 'across'} the width"
            yield _case(name, beam, (16, 32), 128)
    yield _case("Raasch hook", shells.raasch_hook_case, (16, 32), 128, coarsest=8)
