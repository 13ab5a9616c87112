"""A plate with an exact solution that is smooth: for rates of convergence."""

import numpy as np

from phytac_design.mechanics.shell.element import SHEAR_FACTOR
from phytac_design.mechanics.verification.case_parts import (
    SYMMETRY,
    Case,
    at,
    hold,
    no_support,
    patch,
    surface_load,
    weights,
)


def plate_case(n: int, *, thickness: float = 0.05, jitter: float = 0.0) -> Case:
    """Quarter of a unit square plate, hard simple supports, load cos πx cos πy; its middle.

    With m = 2π² (Navier, with transverse shear): w = 1/(D m²) + 1/(5/6 G t m).
    """
    mesh = patch(lambda a, b: np.column_stack([0.5 * a, 0.5 * b, 0.0 * a]), n, n, jitter=jitter)
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, SYMMETRY[0])
    hold(fixed, mesh.ab[:, 1] == 0.0, SYMMETRY[1])
    hold(fixed, mesh.ab[:, 0] == 1.0, (2, 3))
    hold(fixed, mesh.ab[:, 1] == 1.0, (2, 4))
    x, y = mesh.nodes[:, 0], mesh.nodes[:, 1]
    pressure = np.cos(np.pi * x) * np.cos(np.pi * y)
    loads = surface_load(mesh, pressure[:, None] * np.array([0.0, 0.0, 1.0]))
    modulus, poisson = 1.0, 0.3
    bending = modulus * thickness**3 / 12.0 / (1.0 - poisson**2)
    shear = SHEAR_FACTOR * modulus / (2.0 * (1.0 + poisson)) * thickness
    m = 2.0 * np.pi**2
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (at(mesh, 0.0, 0.0), 2, 1.0)),
        reference=1.0 / (bending * m * m) + 1.0 / (shear * m),
        modulus=modulus,
        poisson=poisson,
        thickness=thickness,
    )
