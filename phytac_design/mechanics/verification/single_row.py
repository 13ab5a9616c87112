"""A curved strip one element wide, with a closed solution for any thickness and width."""

import numpy as np

from phytac_design.mechanics.shell.element import SHEAR_FACTOR
from phytac_design.mechanics.verification.case_parts import (
    Case,
    at,
    hold,
    no_support,
    patch,
    weights,
)

RADIUS = 10.0
MODULUS = 1000.0


def arch_case(n: int, *, thickness: float, width: float = 1.0) -> Case:
    """Quarter of a circular arch of ``n`` elements, clamped, radial force 1 at its end, ν = 0.

    Deflection under the force π/4 · P (R³/EI + R/EA + R/GA_s), by Castigliano.
    """
    quarter = np.pi / 2.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [RADIUS * np.sin(quarter * a), width * b, RADIUS * np.cos(quarter * a)]
        ),
        n,
        1,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(mesh.nodes), 6))
    loads[mesh.ab[:, 0] == 1.0, 0] = 0.5
    area = width * thickness
    soft = RADIUS**3 / (area * thickness**2 / 12.0) + RADIUS / area
    soft += 2.0 * RADIUS / (SHEAR_FACTOR * area)
    return Case(
        mesh=mesh,
        fixed=fixed,
        loads=loads,
        read=weights(mesh, (at(mesh, 1.0, 0.0), 0, 1.0)),
        reference=np.pi / 4.0 * soft / MODULUS,
        modulus=MODULUS,
        poisson=0.0,
        thickness=thickness,
    )
