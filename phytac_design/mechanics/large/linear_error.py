r"""Estimated error of linear theory, from the linear factorisation alone.

With the internal forces f_int(x) = K x + Q(x) + C(x) + …, quadratic and cubic parts taken by
central differences along the linear solution x₁ = K⁻¹f (Koiter's expansion, with the load factor
as parameter), the motion is::

    x(λ) = λ x₁ + λ² x₂ + λ³ x₃ + …      x₂ = −K⁻¹ Q(x₁)
                                         x₃ = −K⁻¹ [cubic part of f_int(ε x₁ + ε² x₂)]

The estimate is the greatest translation of x₂ + x₃ over that of x₁.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.large.corotational import Corotational
from phytac_design.mechanics.large.newton import dense_vector
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

DIFFERENCE_STEP_rad = 0.01
"""Largest rotation (or translation over the shell's size) in the differences."""
ABSURD_ROTATION_rad = 1e6
"""Rotation by linear theory above which a load is rejected."""
LINEAR_ERROR_SAFETY = 1.5
"""Linear theory is used where this times the estimate is within the tolerance."""


@dataclass(frozen=True, kw_only=True)
class LinearCheck:
    """Linear motion and how far it is off.

    Attributes
    ----------
    motion : (N, 6) float
        Linear translations (mm) and rotations (rad).
    error : float
        Estimated greatest error of a translation over the greatest translation. Shown within a
        factor of 2 of the truth up to errors of 0.5 (``benchmarks/mechanics``); beyond, large
        displacement is certain but the figure is not.
    """

    motion: FloatArray
    error: float


def check_load_size(turned_rad: float) -> None:
    """Reject a load by the largest rotation of linear theory.

    Raises
    ------
    NumericalError
        If the rotation is beyond ``ABSURD_ROTATION_rad``.
    """
    if not turned_rad <= ABSURD_ROTATION_rad:
        raise NumericalError(
            "load-too-large",
            f"the load is absurd: linear theory turns the shell by {turned_rad:.2g} rad; check "
            "its unit",
        )


def check_linear(model: ShellModel, load: Any) -> LinearCheck:
    """Solve linearly and estimate how far linear theory is off.

    Costs two more solves with the same factorisation and four evaluations of internal forces.

    Parameters
    ----------
    model : ShellModel
        The shell.
    load : (6N,) or (6N, 1) float, dense or scipy.sparse
        Dead nodal forces (N) and moments (N mm).
    """
    force = dense_vector(load, model.fixed.size, "force")
    first = _solved(model, force)
    nodes = model.nodes_mm
    extent = float(np.ptp(nodes, axis=0).max())
    parts = first.reshape(-1, 6)
    reach = max(float(np.abs(parts[:, 3:]).max()), float(np.abs(parts[:, :3]).max()) / extent)
    if reach == 0.0:
        return LinearCheck(motion=parts, error=0.0)
    e = DIFFERENCE_STEP_rad / reach
    shell = Corotational(model)

    def internal(step: FloatArray) -> FloatArray:
        return shell.internal(shell.local(shell.rest().moved(step)))

    second = -_solved(model, (internal(e * first) + internal(-e * first)) / (2.0 * e * e))
    bent = e * e * second
    odd = (internal(e * first + bent) - internal(bent - e * first)) / 2.0
    third = -_solved(model, (odd - e * (model.stiffness @ first)) / e**3)
    off = (second + third).reshape(-1, 6)[:, :3]
    error = np.linalg.norm(off, axis=1).max() / np.linalg.norm(parts[:, :3], axis=1).max()
    return LinearCheck(motion=parts, error=float(error))


def _solved(model: ShellModel, force: FloatArray) -> FloatArray:
    return model.solve(force).motion[:, :, 0].ravel()
