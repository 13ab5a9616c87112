r"""How stiffness, motion and compliance change with Young's modulus, Poisson's ratio, thickness.

From K(p)·u = f, with f fixed::

    du/dp = -K⁻¹ (dK/dp · u)        one more solve on the factor that is there already

- modulus and thickness: exact, from K = E·(t·K_m + t³·K_b + t·K_s); so dK/dt is that of a wall
  that thickens on a middle face which stays where it is;
- Poisson's ratio: central difference of eighth order of the element matrices. They are rational
  in ν with no pole nearer than 0.5 to [0, 0.5), so that the truncation, 576·(h/0.5)⁸ < 1e-13,
  lies below rounding: exact to the digits that there are. (Enhanced strains are condensed out of
  the membrane part, which therefore is not a sum of a few functions of ν; the others are.)

(Derived here.)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.shell.shell_element import ElementStiffness, element_stiffness
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes.arrays import FloatArray

STENCIL = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
"""Weights of f(+kh) - f(-kh), k = 1 … 4, in the central difference of eighth order."""
POISSON_STEP = 0.005
"""Its step h: truncation and rounding are both below 1e-12 of the largest entry."""


@dataclass(frozen=True, kw_only=True)
class StiffnessRates:
    """Derivatives of the stiffness of a whole model, unconstrained, DOF order as in the solver.

    Attributes
    ----------
    modulus, poisson, thickness : scipy.sparse.csc_matrix, (6N, 6N)
        dK/dE (N/mm per MPa), dK/dν (N/mm), dK/dt (N/mm per mm, middle face held); for parameters
        given per element, of a change that is the same everywhere.
    """

    modulus: Any
    poisson: Any
    thickness: Any


def element_poisson_rate(model: ShellModel) -> ElementStiffness:
    """Derivative of a model's three element matrices (E = 1, t = 1) with respect to ν."""
    total = {
        name: np.zeros((len(model.quads), 24, 24)) for name in ("membrane", "bending", "shear")
    }
    for k, weight in enumerate(STENCIL, start=1):
        for sign in (1.0, -1.0):
            part = element_stiffness(
                model.nodes_mm,
                model.quads,
                model.directors,
                poisson=model.poisson + sign * k * POISSON_STEP,
                drilling=model.drilling,
            )
            for name in total:
                total[name] += (sign * weight / POISSON_STEP) * getattr(part, name)
    return ElementStiffness(**total)


def stiffness_rates(
    model: ShellModel, *, with_poisson: bool = True, thickness_share: FloatArray | float = 1.0
) -> StiffnessRates:
    """Derivatives of a model's stiffness; ``with_poisson=False`` leaves out the dearest of them.

    Parameters
    ----------
    model : ShellModel
        The shell; thickness and modulus may differ from element to element.
    with_poisson : bool
        False leaves ``poisson`` None.
    thickness_share : float or (E,) float
        By how much each element's thickness changes per mm of wall.
    """
    pattern = make_pattern(model.quads, len(model.nodes_mm))
    parts = model.elements
    E = np.asarray(model.modulus_MPa, dtype=np.float64)
    t = np.asarray(model.thickness_mm, dtype=np.float64)
    slope = ElementStiffness(
        membrane=parts.membrane,
        bending=3.0 * np.square(t)[..., None, None] * parts.bending,
        shear=parts.shear,
    )
    turned = None
    if with_poisson:
        rate = element_poisson_rate(model)
        turned = assemble(pattern, rate.combine(modulus_MPa=E, thickness_mm=t))
    return StiffnessRates(
        modulus=assemble(pattern, parts.combine(modulus_MPa=np.ones_like(E), thickness_mm=t)),
        poisson=turned,
        thickness=assemble(
            pattern, slope.combine(modulus_MPa=E * thickness_share, thickness_mm=np.ones_like(t))
        ),
    )


def motion_rate(model: ShellModel, rate: Any, motion: FloatArray) -> FloatArray:
    """du/dp of motions that the model solved for, under loads that do not depend on p.

    Parameters
    ----------
    model : ShellModel
        The shell; its factor is used again.
    rate : scipy.sparse matrix, (6N, 6N)
        dK/dp, one of :class:`StiffnessRates`.
    motion : (N, 6, m) float
        Motion (mm, rad) under m loads.

    Returns
    -------
    (N, 6, m) float
        mm and rad per unit of the parameter.
    """
    return model.solve(-(rate @ motion.reshape(model.fixed.size, -1))).motion
