r"""A shell problem with a closed solution for every thickness, material and size: the ring load.

A long cylinder carries a radial line load Q (force per length) around its free end. With D the
bending stiffness, S = 5/6·G t and k = E t/R², the axisymmetric shell with transverse shear obeys
D w'''' − (D k/S) w'' + k w = 0, so w = Σ A_i exp(−λ_i x) with the two roots λ_i of positive real
part; A_i follow from no moment and the shear force Q at the end (e.g. Timoshenko and
Woinowsky-Krieger, §114, here with shear). Bending and hoop membrane share the load equally.
"""

import numpy as np

from phytac_design.mechanics.shell.element import SHEAR_FACTOR
from phytac_design.mechanics.verification.case_parts import (
    SYMMETRY,
    Case,
    hold,
    line_weights,
    no_support,
    patch,
    weights,
)

DECAYS = 8.0
"""Length of the cylinder in decay lengths √(R t)/(3(1−ν²))^¼; the far end is held."""


def ring_deflection(
    *, radius: float, thickness: float, modulus: float, poisson: float, load: float = 1.0
) -> float:
    """Radial deflection of the loaded end, exact for the shell with transverse shear."""
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
) -> Case:
    """Quarter of the cylinder, ``n`` elements along × ``around``.

    The motion looked at is that of the loaded end in the middle of the quarter; Q = ``load``.
    """
    thickness = thickness_over_radius * radius
    decay = np.sqrt(radius * thickness) / (3.0 * (1.0 - poisson**2)) ** 0.25
    length, quarter = DECAYS * decay, np.pi / 2.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [
                radius * np.cos(quarter * a),
                radius * np.sin(quarter * a),
                length * b,
            ]
        ),
        around,
        n,
        jitter=jitter,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 1.0, (0, 1, 2, 3, 4, 5))
    end = np.flatnonzero(mesh.ab[:, 1] == 0.0)
    loads = np.zeros((len(mesh.nodes), 6))
    share = line_weights(mesh.ab[end, 0]) * quarter * radius * load
    loads[end, :3] = share[:, None] * mesh.normals[end]
    middle = int(end[np.argmin(np.abs(mesh.ab[end, 0] - 0.5))])
    out = mesh.normals[middle]
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, *((middle, axis, float(out[axis])) for axis in range(3))),
        reference=ring_deflection(
            radius=radius, thickness=thickness, modulus=modulus, poisson=poisson, load=load
        ),
        modulus=modulus,
        poisson=poisson,
        thickness=thickness,
    )
