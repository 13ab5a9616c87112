r"""How stiffness, motion and compliance change with Young's modulus, Poisson's ratio, thickness.

From K(p)·u = f, with f fixed::

    du/dp = -K⁻¹ (dK/dp · u)        one more solve on the factor that is there already

- modulus and thickness: exact, from K = E·(t·K_m + t³·K_b + t·K_s); so dK/dt is that of a wall
  that thickens on a middle face which stays where it is;
- Poisson's ratio: exact too, from element matrices at ν + ih, which are analytic in ν. (Enhanced
  strains are condensed out of the membrane part, which therefore is not a sum of a few functions
  of ν; the others are.)

(Derived here.)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.shell.shell_element import ElementStiffness, element_stiffness
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes.arrays import FloatArray


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
    step = 1e-30
    ahead = element_stiffness(
        model.nodes_mm,
        model.quads,
        model.directors,
        poisson=model.poisson + 1j * step,
        drilling=model.drilling,
    )
    return ElementStiffness(
        membrane=ahead.membrane.imag / step,
        bending=ahead.bending.imag / step,
        shear=ahead.shear.imag / step,
    )


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
