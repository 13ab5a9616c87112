"""Published shell problems with known answers, built on the solver as any user would build them.

Each ``NAME_case`` takes the number of elements along a side (some: or the lines of nodes along
both) and returns a :class:`Case`; the function ``NAME`` returns computed / reference.
Sources: MacNeal and Harder (1985) for the obstacle course, Knight (1997) for the Raasch hook,
Lee and Bathe (2004) and published values for the free hyperboloid.
"""

import numpy as np

from phytac_design.mechanics.shell.element import DRILLING
from phytac_design.mechanics.verification.case_parts import (
    SYMMETRY,
    Case,
    Lines,
    Patch,
    Sides,
    at,
    hold,
    line_weights,
    no_support,
    patch,
    sides,
    solve_case,
    surface_load,
    weights,
)
from phytac_shapes.arrays import FloatArray

__all__ = [
    "HYPERBOLOID",
    "SYMMETRY",
    "Case",
    "Patch",
    "at",
    "full_hemisphere",
    "full_hemisphere_case",
    "hemisphere_with_hole",
    "hemisphere_with_hole_case",
    "hold",
    "hyperboloid",
    "hyperboloid_case",
    "no_support",
    "patch",
    "pinched_cylinder",
    "pinched_cylinder_case",
    "raasch_hook",
    "raasch_hook_case",
    "scordelis_lo",
    "scordelis_lo_case",
    "solve_case",
    "surface_load",
    "twisted_beam",
    "twisted_beam_case",
    "weights",
]


def scordelis_lo_case(n: Sides, *, jitter: float = 0.0, drilling: float = DRILLING) -> Case:
    """Roof on end diaphragms under its weight; sag of the free edge's middle, 0.3024."""
    half = np.radians(40.0)
    mesh = patch(
        lambda a, b: np.column_stack([25 * np.sin(half * a), 25.0 * b, 25 * np.cos(half * a)]),
        *sides(n),
        jitter=jitter,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 1] == 1.0, (0, 2))
    loads = surface_load(mesh, np.tile([0.0, 0.0, -90.0], (len(mesh.nodes), 1)))
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (at(mesh, 1.0, 0.0), 2, -1.0)),
        reference=0.3024,
        modulus=4.32e8,
        poisson=0.0,
        thickness=0.25,
        drilling=drilling,
    )


def scordelis_lo(n: int, *, jitter: float = 0.0, drilling: float = DRILLING) -> float:
    """Computed / reference of :func:`scordelis_lo_case`."""
    return scordelis_lo_case(n, jitter=jitter, drilling=drilling).ratio()


def pinched_cylinder_case(n: Sides, *, jitter: float = 0.0, drilling: float = DRILLING) -> Case:
    """Cylinder on end diaphragms, two opposite forces; an octant; 1.82488e-5."""
    quarter = np.pi / 2.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [300.0 * np.sin(quarter * a), 300.0 * b, 300.0 * np.cos(quarter * a)]
        ),
        *sides(n),
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
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (top, 2, -1.0)),
        reference=1.82488e-5,
        modulus=3e6,
        poisson=0.3,
        thickness=3.0,
        drilling=drilling,
    )


def pinched_cylinder(n: int, *, jitter: float = 0.0, drilling: float = DRILLING) -> float:
    """Computed / reference of :func:`pinched_cylinder_case`."""
    return pinched_cylinder_case(n, jitter=jitter, drilling=drilling).ratio()


def hemisphere_with_hole_case(
    n: Sides, *, jitter: float = 0.0, drilling: float = DRILLING, thickness: float = 0.04
) -> Case:
    """Quarter of a hemisphere with an 18° hole, F = 1 at its two points; 0.093 at t = 0.04."""
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
        *sides(n),
        jitter=jitter,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[0])
    loads = np.zeros((len(mesh.nodes), 6))
    first, second = at(mesh, 0.0, 0.0), at(mesh, 1.0, 0.0)
    fixed[first, 2] = True
    loads[first, 0], loads[second, 1] = 1.0, -1.0
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (first, 0, 0.5), (second, 1, -0.5)),
        reference=0.093,
        modulus=6.825e7,
        poisson=0.3,
        thickness=thickness,
        drilling=drilling,
    )


def hemisphere_with_hole(n: int, *, jitter: float = 0.0, drilling: float = DRILLING) -> float:
    """Computed / reference of :func:`hemisphere_with_hole_case`."""
    return hemisphere_with_hole_case(n, jitter=jitter, drilling=drilling).ratio()


def full_hemisphere_case(n: int, *, drilling: float = DRILLING) -> Case:
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
    turn = np.column_stack([np.arctan2(nodes[:, 1], nodes[:, 0]), np.arcsin(nodes[:, 2] / 10.0)])
    mesh = Patch(
        ab=turn / (np.pi / 2.0), nodes=nodes, normals=nodes / 10.0, quads=place.ravel()[quads]
    )
    fixed = no_support(mesh)
    hold(fixed, np.abs(nodes[:, 0]) < 1e-9, SYMMETRY[0])
    hold(fixed, np.abs(nodes[:, 1]) < 1e-9, SYMMETRY[1])
    first, second = (int(np.argmax(nodes[:, axis])) for axis in (0, 1))
    fixed[first, 2] = True
    loads = np.zeros((len(nodes), 6))
    loads[first, 0], loads[second, 1] = 1.0, -1.0
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (first, 0, 0.5), (second, 1, -0.5)),
        reference=0.0924,
        modulus=6.825e7,
        poisson=0.3,
        thickness=0.04,
        drilling=drilling,
    )


def full_hemisphere(n: int, *, drilling: float = DRILLING) -> float:
    """Computed / reference of :func:`full_hemisphere_case`."""
    return full_hemisphere_case(n, drilling=drilling).ratio()


def twisted_beam_case(
    n: int,
    *,
    thickness: float = 0.32,
    in_plane: bool = True,
    drilling: float = DRILLING,
    across: int | None = None,
) -> Case:
    """Beam 12 × 1.1 twisted by 90°, tip force along or across its width; n × max(2, n/4)."""
    across = max(2, n // 4) if across is None else across
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
    loads = np.zeros((len(mesh.nodes), 6))
    loads[end, axis] = line_weights(mesh.ab[end, 1])
    thick = {True: 5.424535e-3, False: 1.753248e-3}
    thin = {True: 5.256e3, False: 1.294e3}  # per unit force at t = 0.0032
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (at(mesh, 1.0, 0.5), axis, 1.0)),
        reference=(thick if thickness > 0.1 else thin)[in_plane],
        modulus=29e6,
        poisson=0.22,
        thickness=thickness,
        drilling=drilling,
    )


def twisted_beam(
    n: int, *, thickness: float = 0.32, in_plane: bool = True, drilling: float = DRILLING
) -> float:
    """Computed / reference of :func:`twisted_beam_case`."""
    return twisted_beam_case(n, thickness=thickness, in_plane=in_plane, drilling=drilling).ratio()


def raasch_hook_case(n: int, *, across: Lines | None = None, drilling: float = DRILLING) -> Case:
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
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    end = mesh.ab[:, 0] == 1.0
    loads = np.zeros((len(mesh.nodes), 6))
    loads[end, 2] = line_weights(mesh.ab[end, 1])
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (at(mesh, 1.0, 0.5), 2, 1.0)),
        reference=5.022,
        modulus=3300.0,
        poisson=0.35,
        thickness=2.0,
        drilling=drilling,
    )


def raasch_hook(n: int, *, drilling: float = DRILLING) -> float:
    """Computed / reference of :func:`raasch_hook_case`."""
    return raasch_hook_case(n, drilling=drilling).ratio()


HYPERBOLOID = {1.0: 1.3577317, 0.1: 0.18954566, 0.01: 0.15046617, 0.001: 0.1498902}
"""Largest radial motion of the free hyperboloid by thickness."""


def hyperboloid_case(
    n: Sides, *, thickness: float, jitter: float = 0.0, drilling: float = DRILLING
) -> Case:
    """Free hyperboloid x² + y² = 1 + z², pressure t³·1e4·cos 2θ; an eighth.

    The reference is the table's; for other thicknesses that of its thinnest shell, whose motion
    has all but reached the limit of pure bending.
    """

    def surface(a: FloatArray, b: FloatArray) -> FloatArray:
        angle, z = a * np.pi / 2.0, b
        radius = np.sqrt(1.0 + z * z)
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])

    mesh = patch(surface, *sides(n), jitter=jitter)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[2])
    pressure = thickness**3 * 1e4 * np.cos(np.pi * mesh.ab[:, 0])
    loads = surface_load(mesh, pressure[:, None] * mesh.normals)
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (at(mesh, 0.0, 0.0), 0, 1.0)),
        reference=HYPERBOLOID.get(thickness, HYPERBOLOID[min(HYPERBOLOID)]),
        modulus=2.85e4,
        poisson=0.3,
        thickness=thickness,
        drilling=drilling,
    )


def hyperboloid(n: int, *, thickness: float, drilling: float = DRILLING) -> float:
    """Computed / reference of :func:`hyperboloid_case`."""
    return hyperboloid_case(n, thickness=thickness, drilling=drilling).ratio()
