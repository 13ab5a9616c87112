"""Published shell problems with known answers, built on the solver as any user would build them.

Each function takes the number of elements along a side and returns computed / reference.
Sources: MacNeal and Harder (1985) for the obstacle course, Knight (1997) for the Raasch hook,
Lee and Bathe (2004) and published values for the free hyperboloid.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.element import DRILLING
from phytac_design.mechanics.solve import ShellModel
from shapes.arrays import BoolArray, FloatArray, IntArray

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
    n_a: int,
    n_b: int,
    *,
    jitter: float = 0.0,
) -> Patch:
    """Mesh ``surface(a, b)`` -> (N, 3); ``jitter`` moves inner nodes by that share of an element.

    Normals are taken by central differences of the surface.
    """
    steps_a, steps_b = np.linspace(0.0, 1.0, n_a + 1), np.linspace(0.0, 1.0, n_b + 1)
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


def no_support(mesh: Patch) -> BoolArray:
    """All DOFs free, (N, 6)."""
    return np.zeros((len(mesh.nodes), 6), dtype=np.bool_)


def hold(fixed: BoolArray, where: BoolArray, dofs: tuple[int, ...]) -> None:
    """Hold ``dofs`` of the nodes ``where`` (N,) in place."""
    for dof in dofs:
        fixed[where, dof] = True


def surface_load(mesh: Patch, traction: FloatArray) -> FloatArray:
    """Consistent nodal forces (N, 6) of a traction (N, 3) given at the nodes (2×2 points)."""
    from phytac_design.mechanics.element import GAUSS, shape

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
    drilling: float = DRILLING,
) -> FloatArray:
    """Motion (N, 6) under one load case (N, 6)."""
    model = ShellModel(
        mesh.nodes,
        mesh.quads,
        mesh.normals,
        thickness_mm=thickness,
        modulus_MPa=modulus,
        poisson=poisson,
        fixed=fixed,
        drilling=drilling,
    )
    return model.solve(loads.reshape(-1, 1)).motion[:, :, 0]


def at(mesh: Patch, a: float, b: float) -> int:
    """Node nearest the parameters (a, b)."""
    return int(np.argmin(np.sum((mesh.ab - [a, b]) ** 2, axis=1)))


def scordelis_lo(n: int, *, jitter: float = 0.0, drilling: float = DRILLING) -> float:
    """Roof on end diaphragms under its weight; sag of the free edge's middle over 0.3024."""
    half = np.radians(40.0)
    mesh = patch(
        lambda a, b: np.column_stack([25 * np.sin(half * a), 25.0 * b, 25 * np.cos(half * a)]),
        n,
        n,
        jitter=jitter,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 1] == 1.0, (0, 2))
    loads = surface_load(mesh, np.tile([0.0, 0.0, -90.0], (len(mesh.nodes), 1)))
    motion = solve_case(
        mesh, fixed, loads, modulus=4.32e8, poisson=0.0, thickness=0.25, drilling=drilling
    )
    return float(-motion[at(mesh, 1.0, 0.0), 2] / 0.3024)


def pinched_cylinder(n: int, *, jitter: float = 0.0, drilling: float = DRILLING) -> float:
    """Cylinder on end diaphragms, two opposite forces; an octant; over 1.82488e-5."""
    quarter = np.pi / 2.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [300.0 * np.sin(quarter * a), 300.0 * b, 300.0 * np.cos(quarter * a)]
        ),
        n,
        n,
        jitter=jitter,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[2])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 1] == 1.0, (0, 2))
    loads = np.zeros((len(mesh.nodes), 6))
    top = at(mesh, 0.0, 0.0)
    loads[top, 2] = -0.25
    motion = solve_case(
        mesh, fixed, loads, modulus=3e6, poisson=0.3, thickness=3.0, drilling=drilling
    )
    return float(-motion[top, 2] / 1.82488e-5)


def hemisphere_with_hole(n: int, *, jitter: float = 0.0, drilling: float = DRILLING) -> float:
    """Quarter of a hemisphere with an 18° hole, F = 1 at its two points; over 0.093."""
    quarter, top = np.pi / 2.0, np.radians(72.0)
    mesh = patch(
        lambda a, b: (
            10.0
            * np.column_stack(
                [
                    np.cos(top * b) * np.cos(quarter * a),
                    np.cos(top * b) * np.sin(quarter * a),
                    np.sin(top * b),
                ]
            )
        ),
        n,
        n,
        jitter=jitter,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[0])
    loads = np.zeros((len(mesh.nodes), 6))
    first, second = at(mesh, 0.0, 0.0), at(mesh, 1.0, 0.0)
    fixed[first, 2] = True
    loads[first, 0], loads[second, 1] = 1.0, -1.0
    motion = solve_case(
        mesh, fixed, loads, modulus=6.825e7, poisson=0.3, thickness=0.04, drilling=drilling
    )
    return float((motion[first, 0] - motion[second, 1]) / 2.0 / 0.093)


def twisted_beam(
    n: int, *, thickness: float = 0.32, in_plane: bool = True, drilling: float = DRILLING
) -> float:
    """Beam 12 × 1.1 twisted by 90°, tip force along or across its width; n × max(2, n/4)."""
    across = max(2, n // 4)
    mesh = patch(
        lambda a, b: np.column_stack(
            [
                12.0 * a,
                1.1 * (b - 0.5) * np.cos(np.pi / 2.0 * a),
                1.1 * (b - 0.5) * np.sin(np.pi / 2.0 * a),
            ]
        ),
        n,
        across,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    axis = 2 if in_plane else 1  # at the tip the width runs along z
    end = mesh.ab[:, 0] == 1.0
    share = np.where(np.isin(mesh.ab[:, 1], (0.0, 1.0)), 0.5, 1.0)[end] / across
    loads = np.zeros((len(mesh.nodes), 6))
    loads[end, axis] = share
    motion = solve_case(
        mesh, fixed, loads, modulus=29e6, poisson=0.22, thickness=thickness, drilling=drilling
    )
    thick = {True: 5.424535e-3, False: 1.753248e-3}
    thin = {True: 5.256e3, False: 1.294e3}  # per unit force at t = 0.0032
    reference = (thick if thickness > 0.1 else thin)[in_plane]
    return float(motion[at(mesh, 1.0, 0.5), axis] / reference)


def raasch_hook(n: int, *, drilling: float = DRILLING) -> float:
    """Strip curved 60° at radius 14, then 150° at 46, tip force 1 across it; over 5.022.

    ``n`` elements along, n/2 across the width of 20.
    """
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

    mesh = patch(lambda a, b: np.column_stack([line(a), 20.0 * b]), n, max(1, n // 2))
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    end = mesh.ab[:, 0] == 1.0
    loads = np.zeros((len(mesh.nodes), 6))
    loads[end, 2] = np.where(np.isin(mesh.ab[:, 1], (0.0, 1.0)), 0.5, 1.0)[end] / max(1, n // 2)
    motion = solve_case(
        mesh, fixed, loads, modulus=3300.0, poisson=0.35, thickness=2.0, drilling=drilling
    )
    return float(motion[at(mesh, 1.0, 0.5), 2] / 5.022)


HYPERBOLOID = {1.0: 1.3577317, 0.1: 0.18954566, 0.01: 0.15046617, 0.001: 0.1498902}
"""Largest radial motion of the free hyperboloid by thickness."""


def hyperboloid(n: int, *, thickness: float, drilling: float = DRILLING) -> float:
    """Free hyperboloid x² + y² = 1 + z², pressure t³·1e4·cos 2θ; one sixteenth; over the table."""

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        angle, z = a * np.pi / 2.0, b
        radius = np.sqrt(1.0 + z * z)
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])

    mesh = patch(surface, n, n)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[2])
    pressure = thickness**3 * 1e4 * np.cos(np.pi * mesh.ab[:, 0])
    loads = surface_load(mesh, pressure[:, None] * mesh.normals)
    motion = solve_case(
        mesh, fixed, loads, modulus=2.85e4, poisson=0.3, thickness=thickness, drilling=drilling
    )
    return float(motion[at(mesh, 0.0, 0.0), 0] / HYPERBOLOID[thickness])
