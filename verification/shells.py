"""Published shell problems with known answers, built on the solver as any user would build them.

Each ``NAME_case`` takes the number of elements along a side (some: or the lines of nodes along
both) and returns a :class:`ShellProblem`; its ``ratio()`` is computed / reference. Sources:
MacNeal and Harder (1985) for the obstacle course, Knight (1997) for the Raasch hook, Lee and Bathe
(2004) and published values for the free hyperboloid, Navier for the plate, Timoshenko and
Woinowsky-Krieger (with transverse shear) for the ring load, Castigliano for the arch.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from phytac_design.layout import Markers
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.discretisation import ProbedShell, probed_sensor
from phytac_design.mechanics.shell.shell_element import DRILLING, GAUSS, SHEAR_FACTOR, shape
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from verification.free_edge import FreeEdgeShell

Lines = int | FloatArray
"""Number of elements along a side, or the lines of nodes themselves, 0 … 1."""
Sides = int | tuple[Lines, Lines]
"""The same number along both sides, or one for each."""
SYMMETRY = {0: (0, 4, 5), 1: (1, 3, 5), 2: (2, 3, 4)}
"""DOFs held on a plane of symmetry with normal x, y or z."""


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A structured patch of quads over the unit square (a, b).

    Attributes
    ----------
    ab : (N, 2) float
        Parameters of the nodes in [0, 1].
    nodes : (N, 3) float
        Positions.
    normals : (N, 3) float
        Unit normals of the true surface.
    quads : (E, 4) int
        Corners.
    """

    ab: FloatArray
    nodes: FloatArray
    normals: FloatArray
    quads: IntArray


def patch(
    surface: Callable[[FloatArray, FloatArray], FloatArray],
    n_a: Lines,
    n_b: Lines,
    *,
    jitter: float = 0.0,
) -> Patch:
    """Mesh ``surface(a, b)`` -> (N, 3) with n_a × n_b elements, or with the lines given.

    ``jitter`` moves inner nodes by that share of a (mean) element. Normals are taken by central
    differences of the surface.
    """
    steps_a, steps_b = (
        np.linspace(0.0, 1.0, n + 1) if isinstance(n, int) else n for n in (n_a, n_b)
    )
    n_a, n_b = len(steps_a) - 1, len(steps_b) - 1
    ab = np.column_stack([np.repeat(steps_a, n_b + 1), np.tile(steps_b, n_a + 1)])
    inner = np.all((ab > 1e-9) & (ab < 1.0 - 1e-9), axis=1)
    move = np.random.default_rng(0).uniform(-jitter, jitter, ab.shape) / np.array([n_a, n_b])
    ab = ab + np.where(inner[:, None], move, 0.0)
    ids = np.arange(len(ab)).reshape(n_a + 1, n_b + 1)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], -1).reshape(-1, 4)
    step = 1e-6
    along = surface(ab[:, 0] + step, ab[:, 1]) - surface(ab[:, 0] - step, ab[:, 1])
    across = surface(ab[:, 0], ab[:, 1] + step) - surface(ab[:, 0], ab[:, 1] - step)
    normals = np.cross(along, across)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return Patch(ab=ab, nodes=surface(ab[:, 0], ab[:, 1]), normals=normals, quads=quads)


def sides(n: Sides) -> tuple[Lines, Lines]:
    """Divisions along a and b."""
    return (n, n) if isinstance(n, int) else n


def line_weights(at_b: FloatArray) -> FloatArray:
    """Shares of a unit line load on nodes at ``at_b`` in 0 … 1, ascending."""
    half = np.diff(at_b) / 2.0
    return np.asarray(np.append(half, 0.0) + np.append(0.0, half))


def edge_lines(n: int, width: float, *, ends: tuple[bool, bool]) -> FloatArray:
    """Lines of ``n`` equal elements, refined towards the marked ends.

    A layer of ``width`` (as a share of the side) is resolved there.
    """
    near = np.concatenate([[0.0], np.geomspace(width / 6.0, 8.0 * width, 16)])
    near = near[near < 1.5 / n]
    extra = [near] * ends[0] + [1.0 - near] * ends[1]
    return np.unique(np.concatenate([np.linspace(0.0, 1.0, n + 1), *extra]))


def no_support(mesh: Patch) -> BoolArray:
    """All DOFs free, (N, 6)."""
    return np.zeros((len(mesh.nodes), 6), dtype=np.bool_)


def hold(fixed: BoolArray, where: BoolArray, dofs: tuple[int, ...]) -> None:
    """Hold ``dofs`` of the nodes ``where`` (N,) in place."""
    for dof in dofs:
        fixed[where, dof] = True


def surface_load(mesh: Patch, traction: FloatArray) -> FloatArray:
    """Consistent nodal forces (N, 6) of a traction (N, 3) given at the nodes (2×2 points)."""
    corner, carried = mesh.nodes[mesh.quads], traction[mesh.quads]
    forces = np.zeros((len(mesh.nodes), 6))
    for r in (-GAUSS, GAUSS):
        for s in (-GAUSS, GAUSS):
            h, dh = shape(r, s)
            g = np.einsum("ai,eik->aek", dh, corner)
            area = np.linalg.norm(np.cross(g[0], g[1]), axis=1)
            value = np.einsum("i,eik->ek", h, carried) * area[:, None]
            np.add.at(forces[:, :3], mesh.quads, h[None, :, None] * value[:, None])
    return forces


def solve_case(
    mesh: Patch,
    fixed: BoolArray,
    loads: FloatArray,
    *,
    modulus: float,
    poisson: float,
    thickness: float,
) -> FloatArray:
    """Motion (N, 6) under one load case (N, 6)."""
    return ShellProblem(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=loads,
        reference=1.0,
        modulus=modulus,
        poisson=poisson,
        thickness=thickness,
    ).motion()


@dataclass(frozen=True, kw_only=True)
class ShellProblem:
    """A shell under one load, and where to read the motion that a reference is known for.

    Attributes
    ----------
    mesh : Patch
        The mesh.
    fixed : (N, 6) bool
        DOFs held at zero.
    loads : (N, 6) float
        Nodal forces and moments.
    read : (N, 6) float
        Weights of the DOFs whose sum is the motion that is compared.
    reference : float
        Published value of that motion.
    modulus, poisson, thickness, drilling : float
        Material, wall and drilling factor.
    """

    mesh: Patch
    fixed: BoolArray
    loads: FloatArray
    read: FloatArray
    reference: float
    modulus: float
    poisson: float
    thickness: float
    drilling: float = DRILLING

    def model(self) -> ShellModel:
        """The shell, assembled."""
        return ShellModel(
            self.mesh.nodes,
            self.mesh.quads,
            self.mesh.normals,
            thickness_mm=self.thickness,
            modulus_MPa=self.modulus,
            poisson=self.poisson,
            fixed=self.fixed,
            drilling=self.drilling,
        )

    def motion(self) -> FloatArray:
        """Motion (N, 6) of all nodes."""
        return self.model().solve(self.loads.reshape(-1, 1)).motion[:, :, 0]

    def ratio(self) -> float:
        """Computed / reference."""
        return float(np.sum(self.read * self.motion()) / self.reference)


def probed(case: ShellProblem, points: FloatArray) -> ProbedShell:
    """Shell whose motion is read at its nodes nearest ``points`` (n, 3)."""
    from scipy.spatial import cKDTree

    nodes = cKDTree(case.mesh.nodes).query(points)[1][:, None]
    return FreeEdgeShell(
        model=case.model(),
        loads=case.loads.reshape(-1, 1),
        nodes=nodes,
        weights=np.ones(nodes.shape),
    )


def weights(mesh: Patch, *terms: tuple[int, int, float]) -> FloatArray:
    """Weights or nodal loads (N, 6) of (node, DOF, value)."""
    out = np.zeros((len(mesh.nodes), 6))
    for node, dof, value in terms:
        out[node, dof] = value
    return out


def at(mesh: Patch, a: float, b: float) -> int:
    """Node nearest the parameters (a, b)."""
    return int(np.argmin(np.sum((mesh.ab - [a, b]) ** 2, axis=1)))


CLAMPED = (0, 1, 2, 3, 4, 5)
"""All DOFs of a node."""
Holds = Sequence[tuple[BoolArray, tuple[int, ...]]]


def problem(
    mesh: Patch, holds: Holds, loads: FloatArray, read: FloatArray, **numbers: float
) -> ShellProblem:
    """A problem whose supports are given as (nodes, DOFs held there)."""
    fixed = no_support(mesh)
    for where, dofs in holds:
        hold(fixed, where, dofs)
    return ShellProblem(mesh=mesh, fixed=fixed, loads=loads, read=read, **numbers)


def scordelis_lo_case(n: Sides, *, jitter: float = 0.0) -> ShellProblem:
    """Roof on end diaphragms under its weight; sag of the free edge's middle, 0.3024."""
    half = np.radians(40.0)
    mesh = patch(
        lambda a, b: np.column_stack([25 * np.sin(half * a), 25.0 * b, 25 * np.cos(half * a)]),
        *sides(n),
        jitter=jitter,
    )
    a, b = mesh.ab.T
    holds = ((a == 0.0, SYMMETRY[0]), (b == 0.0, SYMMETRY[1]), (b == 1.0, (0, 2)))
    loads = surface_load(mesh, np.tile([0.0, 0.0, -90.0], (len(mesh.nodes), 1)))
    read = weights(mesh, (at(mesh, 1.0, 0.0), 2, -1.0))
    return problem(
        mesh, holds, loads, read, reference=0.3024, modulus=4.32e8, poisson=0.0, thickness=0.25
    )


def pinched_cylinder_case(n: Sides) -> ShellProblem:
    """Cylinder on end diaphragms, two opposite forces; an octant; 1.82488e-5."""
    quarter = np.pi / 2.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [300.0 * np.sin(quarter * a), 300.0 * b, 300.0 * np.cos(quarter * a)]
        ),
        *sides(n),
    )
    a, b = mesh.ab.T
    holds = (
        (a == 0.0, SYMMETRY[0]),
        (a == 1.0, SYMMETRY[2]),
        (b == 0.0, SYMMETRY[1]),
        (b == 1.0, (0, 2)),
    )
    top = at(mesh, 0.0, 0.0)
    loads, read = weights(mesh, (top, 2, -0.25)), weights(mesh, (top, 2, -1.0))
    return problem(
        mesh, holds, loads, read, reference=1.82488e-5, modulus=3e6, poisson=0.3, thickness=3.0
    )


def hemisphere_patch(n: Sides, *, jitter: float = 0.0) -> Patch:
    """Quarter of a hemisphere of radius 10 with an 18° hole."""
    quarter, top = np.pi / 2.0, np.radians(72.0)

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        level, turn = top * b, quarter * a
        unit = [np.cos(level) * np.cos(turn), np.cos(level) * np.sin(turn), np.sin(level)]
        return 10.0 * np.column_stack(unit)

    return patch(surface, *sides(n), jitter=jitter)


def hemisphere_with_hole_case(n: Sides, *, jitter: float = 0.0) -> ShellProblem:
    """Quarter of a hemisphere with an 18° hole, F = 1 at its two points; 0.093."""
    mesh = hemisphere_patch(n, jitter=jitter)
    return _pulled_apart(mesh, mesh.ab[:, 0], at(mesh, 1.0, 0.0), at(mesh, 0.0, 0.0), 0.093)


def _pulled_apart(
    mesh: Patch, a: FloatArray, second: int, first: int, reference: float
) -> ShellProblem:
    """Quarter sphere, t 0.04, pulled by 1 at ``first`` along x, pushed at ``second`` along y."""
    holds = ((a == 0.0, SYMMETRY[1]), (a == 1.0, SYMMETRY[0]))
    case = problem(
        mesh,
        holds,
        weights(mesh, (first, 0, 1.0), (second, 1, -1.0)),
        weights(mesh, (first, 0, 0.5), (second, 1, -0.5)),
        reference=reference,
        modulus=6.825e7,
        poisson=0.3,
        thickness=0.04,
    )
    case.fixed[first, 2] = True
    return case


def full_hemisphere_case(n: int) -> ShellProblem:
    """Quarter of a hemisphere without a hole, F = 1 at its two points; 0.0924.

    An octant of the sphere as three patches of quads, so that the pole needs no triangle; ``n``
    (even) elements along each of its sides.
    """
    axes, half = np.eye(3), n // 2

    def third(k: int) -> Patch:
        first, after, before = np.roll(axes, -k, axis=0)

        def surface(a: FloatArray, b: FloatArray) -> FloatArray:
            one, two = np.sqrt(0.5) * (first + after), np.sqrt(0.5) * (first + before)
            middle = np.sqrt(1.0 / 3.0) * np.ones(3)
            corners = ((1 - a) * (1 - b), first), (a * (1 - b), one), (a * b, middle)
            flat = sum(np.outer(h, c) for h, c in (*corners, ((1 - a) * b, two)))
            return 10.0 * np.asarray(flat / np.linalg.norm(flat, axis=1)[:, None])

        return patch(surface, half, half)

    thirds = [third(k) for k in range(3)]
    count = len(thirds[0].nodes)
    everything = np.concatenate([part.nodes for part in thirds])
    _, keep, place = np.unique(
        np.round(everything, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    quads = np.concatenate([part.quads + k * count for k, part in enumerate(thirds)])
    nodes = everything[keep]
    side = np.where(np.abs(nodes[:, 1]) < 1e-9, 0.0, np.where(np.abs(nodes[:, 0]) < 1e-9, 1.0, 0.5))
    mesh = Patch(
        ab=np.column_stack([side, nodes[:, 2] / 10.0]),
        nodes=nodes,
        normals=nodes / 10.0,
        quads=place.ravel()[quads],
    )
    first, second = (int(np.argmax(nodes[:, axis])) for axis in (0, 1))
    case = _pulled_apart(mesh, side, second, first, 0.0924)
    hold(case.fixed, np.hypot(nodes[:, 0], nodes[:, 1]) < 1e-9, (*SYMMETRY[0], *SYMMETRY[1]))
    return case


def twisted_beam_case(
    n: int, *, thickness: float = 0.32, in_plane: bool = True, across: int | None = None
) -> ShellProblem:
    """Beam 12 × 1.1 twisted by 90°, tip force along or across its width; n × max(2, n/4)."""
    across = max(2, n // 4) if across is None else across

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        turn, arm = np.pi / 2.0 * a, 1.1 * (b - 0.5)
        return np.column_stack([12.0 * a, arm * np.cos(turn), arm * np.sin(turn)])

    mesh = patch(surface, n, across)
    axis = 2 if in_plane else 1  # at the tip the width runs along z
    end = mesh.ab[:, 0] == 1.0
    loads = np.zeros((len(mesh.nodes), 6))
    loads[end, axis] = line_weights(mesh.ab[end, 1])
    thick = {True: 5.424535e-3, False: 1.753248e-3}
    thin = {True: 5.256e3, False: 1.294e3}  # per unit force at t = 0.0032
    return problem(
        mesh,
        ((mesh.ab[:, 0] == 0.0, CLAMPED),),
        loads,
        weights(mesh, (at(mesh, 1.0, 0.5), axis, 1.0)),
        reference=(thick if thickness > 0.1 else thin)[in_plane],
        modulus=29e6,
        poisson=0.22,
        thickness=thickness,
    )


def raasch_hook_case(n: int, *, across: Lines | None = None) -> ShellProblem:
    """Strip curved 60° at radius 14, then 150° at 46, tip force 1 across it; 5.022.

    ``n`` elements along, n/2 across the width of 20 unless given.
    """
    across = max(1, n // 2) if across is None else across
    first, second = np.radians(60.0), np.radians(150.0)
    split = 14.0 * first / (14.0 * first + 46.0 * second)
    n_first = max(1, round(n * split))

    def line(a: FloatArray) -> FloatArray:
        # Elements of each arc are equally long; the joint is a line of nodes.
        joint = n_first / n
        t1 = np.minimum(a / joint, 1.0) * first
        t2 = np.maximum((a - joint) / (1.0 - joint), 0.0) * second
        one = np.column_stack([14.0 * np.sin(t1), 14.0 * (1.0 - np.cos(t1))])
        end = 14.0 * np.array([np.sin(first), 1.0 - np.cos(first)])
        centre = end + 46.0 * np.array([np.sin(first), -np.cos(first)])
        heading = first - t2
        two = centre + 46.0 * np.column_stack([-np.sin(heading), np.cos(heading)])
        return np.where((a <= joint)[:, None], one, two)

    mesh = patch(lambda a, b: np.column_stack([line(a), 20.0 * b]), n, across)
    end = mesh.ab[:, 0] == 1.0
    loads = np.zeros((len(mesh.nodes), 6))
    loads[end, 2] = line_weights(mesh.ab[end, 1])
    return problem(
        mesh,
        ((mesh.ab[:, 0] == 0.0, CLAMPED),),
        loads,
        weights(mesh, (at(mesh, 1.0, 0.5), 2, 1.0)),
        reference=5.022,
        modulus=3300.0,
        poisson=0.35,
        thickness=2.0,
    )


HYPERBOLOID = {1.0: 1.3577317, 0.1: 0.18954566, 0.01: 0.15046617, 0.001: 0.1498902}
"""Largest radial motion of the free hyperboloid by thickness."""


def hyperboloid_case(n: Sides, *, thickness: float, jitter: float = 0.0) -> ShellProblem:
    """Free hyperboloid x² + y² = 1 + z², pressure t³·1e4·cos 2θ; an eighth.

    The reference is the table's; for other thicknesses that of its thinnest shell, whose motion
    has all but reached the limit of pure bending.
    """

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        angle, radius = a * np.pi / 2.0, np.sqrt(1.0 + b * b)
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), b])

    mesh = patch(surface, *sides(n), jitter=jitter)
    a, b = mesh.ab.T
    pressure = thickness**3 * 1e4 * np.cos(np.pi * a)
    return problem(
        mesh,
        ((a == 0.0, SYMMETRY[1]), (a == 1.0, SYMMETRY[0]), (b == 0.0, SYMMETRY[2])),
        surface_load(mesh, pressure[:, None] * mesh.normals),
        weights(mesh, (at(mesh, 0.0, 0.0), 0, 1.0)),
        reference=HYPERBOLOID.get(thickness, HYPERBOLOID[min(HYPERBOLOID)]),
        modulus=2.85e4,
        poisson=0.3,
        thickness=thickness,
    )


def plate_case(n: int, *, thickness: float = 0.05, jitter: float = 0.0) -> ShellProblem:
    """Quarter of a unit square plate, hard simple supports, load cos πx cos πy; its middle.

    With m = 2π² (Navier, with transverse shear): w = 1/(D m²) + 1/(5/6 G t m). The solution is
    smooth: it serves for rates of convergence.
    """
    mesh = patch(lambda a, b: np.column_stack([0.5 * a, 0.5 * b, 0.0 * a]), n, n, jitter=jitter)
    a, b = mesh.ab.T
    holds = (
        (a == 0.0, SYMMETRY[0]),
        (b == 0.0, SYMMETRY[1]),
        (a == 1.0, (2, 3)),
        (b == 1.0, (2, 4)),
    )
    x, y = mesh.nodes[:, 0], mesh.nodes[:, 1]
    pressure = np.cos(np.pi * x) * np.cos(np.pi * y)
    modulus, poisson = 1.0, 0.3
    bending = modulus * thickness**3 / 12.0 / (1.0 - poisson**2)
    shear = SHEAR_FACTOR * modulus / (2.0 * (1.0 + poisson)) * thickness
    m = 2.0 * np.pi**2
    return problem(
        mesh,
        holds,
        surface_load(mesh, pressure[:, None] * np.array([0.0, 0.0, 1.0])),
        weights(mesh, (at(mesh, 0.0, 0.0), 2, 1.0)),
        reference=1.0 / (bending * m * m) + 1.0 / (shear * m),
        modulus=modulus,
        poisson=poisson,
        thickness=thickness,
    )


DECAYS = 8.0
"""Length of the ring-loaded cylinder in decay lengths √(R t)/(3(1−ν²))^¼; its far end is held."""


def ring_deflection(
    *, radius: float, thickness: float, modulus: float, poisson: float, load: float = 1.0
) -> float:
    """Radial deflection of the loaded end, exact for the shell with transverse shear.

    With D the bending stiffness, S = 5/6·G t and k = E t/R²: D w⁗ − (D k/S) w″ + k w = 0, so
    w = Σ A_i exp(−λ_i x) with the two roots λ_i of positive real part; A_i follow from no moment
    and the shear force Q at the end. Bending and hoop membrane share the load equally.
    """
    D = modulus * thickness**3 / 12.0 / (1.0 - poisson**2)
    S = SHEAR_FACTOR * modulus / (2.0 * (1.0 + poisson)) * thickness
    k = modulus * thickness / radius**2
    squares = np.roots([D, -D * k / S, k]).astype(complex)
    root = np.sqrt(squares)  # positive real parts
    system = np.array([k / S - squares, k / root])
    amplitude = np.linalg.solve(system, np.array([0.0, load]))
    return float(amplitude.sum().real)


def ring_case(
    n: int,
    *,
    around: int = 16,
    thickness_over_radius: float = 0.01,
    radius: float = 1.0,
    modulus: float = 1.0,
    poisson: float = 0.3,
    load: float = 1.0,
    jitter: float = 0.0,
) -> ShellProblem:
    """Quarter of a long cylinder under a radial line load ``load`` around its free end.

    ``n`` elements along × ``around``; the motion is that of the loaded end in the middle of the
    quarter.
    """
    thickness = thickness_over_radius * radius
    decay = np.sqrt(radius * thickness) / (3.0 * (1.0 - poisson**2)) ** 0.25
    length, quarter = DECAYS * decay, np.pi / 2.0

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        turn = quarter * a
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), length * b])

    mesh = patch(surface, around, n, jitter=jitter)
    a, b = mesh.ab.T
    end = np.flatnonzero(b == 0.0)
    loads = np.zeros((len(mesh.nodes), 6))
    share = line_weights(mesh.ab[end, 0]) * quarter * radius * load
    loads[end, :3] = share[:, None] * mesh.normals[end]
    middle = int(end[np.argmin(np.abs(mesh.ab[end, 0] - 0.5))])
    out = mesh.normals[middle]
    return problem(
        mesh,
        ((a == 0.0, SYMMETRY[1]), (a == 1.0, SYMMETRY[0]), (b == 1.0, CLAMPED)),
        loads,
        weights(mesh, *((middle, axis, float(out[axis])) for axis in range(3))),
        reference=ring_deflection(
            radius=radius, thickness=thickness, modulus=modulus, poisson=poisson, load=load
        ),
        modulus=modulus,
        poisson=poisson,
        thickness=thickness,
    )


def arch_case(n: int, *, thickness: float, width: float = 1.0) -> ShellProblem:
    """Quarter of a circular arch R 10 of one row of ``n`` elements, clamped, force 1 at its end.

    ν = 0. Deflection under the force π/4 · P (R³/EI + R/EA + R/GA_s), by Castigliano.
    """
    quarter, radius, modulus = np.pi / 2.0, 10.0, 1000.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [radius * np.sin(quarter * a), width * b, radius * np.cos(quarter * a)]
        ),
        n,
        1,
    )
    loads = np.zeros((len(mesh.nodes), 6))
    loads[mesh.ab[:, 0] == 1.0, 0] = 0.5
    area = width * thickness
    soft = radius**3 / (area * thickness**2 / 12.0) + radius / area
    soft += 2.0 * radius / (SHEAR_FACTOR * area)
    return problem(
        mesh,
        ((mesh.ab[:, 0] == 0.0, CLAMPED),),
        loads,
        weights(mesh, (at(mesh, 1.0, 0.0), 0, 1.0)),
        reference=np.pi / 4.0 * soft / modulus,
        modulus=modulus,
        poisson=0.0,
        thickness=thickness,
    )


ELEMENTS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "square": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
    "skewed": ((0, 0, 0), (1, 0, 0), (1.8, 0.6, 0), (0.8, 0.6, 0)),
    "tapered": ((0, 0, 0), (1, 0, 0), (0.6, 1, 0), (0.4, 1, 0)),
    "warped": ((0, 0, 0), (1.3, 0.1, 0.2), (1.1, 1.2, -0.3), (-0.1, 0.9, 0.4)),
    "twisted by 90°": ((0, -0.5, 0), (1, -0.5, 0), (1, 0, 0.5), (0, 0.5, 0)),
    "aspect 100": ((0, 0, 0), (100, 0, 0), (100, 1, 0), (0, 1, 0)),
    "nearly a triangle": ((0, 0, 0), (1, 0, 0), (0.505, 0.5, 0), (0, 1, 0)),
}
"""Corners of single elements of every awkward shape, for tests of their rigid motions."""


def element_shape(name: str) -> tuple[FloatArray, FloatArray]:
    """Nodes (4, 3) and unit directors (4, 3), the normals of the bilinear face at its corners."""
    nodes = np.array(ELEMENTS[name], dtype=np.float64)
    after = np.roll(nodes, -1, axis=0) - nodes
    normals = np.cross(after, -np.roll(after, 1, axis=0))
    return nodes, normals / np.linalg.norm(normals, axis=1)[:, None]


def turned(case: ShellProblem, seed: int = 4) -> ShellProblem:
    """Problem whose supports hold all DOFs of a node or none, turned in space and renumbered."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    q *= np.linalg.det(q)
    order = rng.permutation(len(case.mesh.nodes))
    both = np.kron(np.eye(2), q.T)
    mesh = Patch(
        ab=case.mesh.ab[order],
        nodes=(case.mesh.nodes @ q.T)[order],
        normals=(case.mesh.normals @ q.T)[order],
        quads=np.roll(np.argsort(order)[case.mesh.quads], 1, axis=1),
    )
    return replace(
        case,
        mesh=mesh,
        fixed=case.fixed[order],
        loads=(case.loads @ both)[order],
        read=(case.read @ both)[order],
    )


def sensor_shell(
    surface: Surface,
    markers: Markers,
    *,
    thickness_mm: float,
    modulus_MPa: float,
    poisson: float,
    centres_uv: FloatArray,
    radii_mm: FloatArray | float,
) -> Callable[[int], ProbedShell]:
    """``make`` of :func:`estimate_error` for the plain wall, probed as :func:`probed_sensor`."""
    centres = np.asarray(centres_uv, dtype=np.float64).reshape(-1, 2)

    def make(refine: int) -> ProbedShell:
        mesh = marker_mesh(surface, markers, thickness_mm=thickness_mm, refine=refine)
        model = clamped_model(mesh, modulus_MPa=modulus_MPa, poisson=poisson)
        return probed_sensor(model, mesh, surface, markers, centres, radii_mm)

    return make


def rigid_modes(nodes_mm: FloatArray) -> FloatArray:
    """Six rigid motions of a body, (N, 6, 6): [node, DOF, mode]; turns are of 1/size rad."""
    arm = nodes_mm - nodes_mm.mean(axis=0)
    size = float(np.abs(arm).max()) or 1.0
    modes = np.zeros((len(nodes_mm), 6, 6))
    modes[:, :3, :3] = np.eye(3)
    for axis in range(3):
        modes[:, :3, 3 + axis] = np.cross(np.eye(3)[axis], arm / size)
        modes[:, 3 + axis, 3 + axis] = 1.0 / size
    return modes
