r"""How far linear theory is off, from the linear factorisation alone; and the choice it allows.

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
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Loading, dense_vector
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

PROBE_RAD = 0.01
"""Largest rotation (or translation over the shell's size) in the differences."""
FAR_RAD = 1e6
"""Rotation by linear theory from which on no equilibrium is looked for."""
LINEAR_ERROR_SAFETY = 1.5
"""``solve_auto`` trusts linear theory where this times the estimate is within the tolerance."""


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


def refuse_absurd(turned_rad: float) -> None:
    """Refuse a load by the largest rotation that linear theory has it cause.

    Raises
    ------
    NumericalError
        If no shell carries as much.
    """
    if not turned_rad <= FAR_RAD:
        raise NumericalError(
            f"the load is absurd: linear theory turns the shell by {turned_rad:.2g} rad; check "
            "its unit"
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
    e = PROBE_RAD / reach
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


@dataclass(frozen=True, kw_only=True)
class AutoSolution:
    """Motion by the cheaper theory that suffices.

    Attributes
    ----------
    motion : (N, 6) float
        Translations (mm) and rotations (rotation vectors, rad).
    large : bool
        Whether large displacements were used.
    linear_error : float
        The estimate that decided (:class:`LinearCheck`).
    stable, jumped : bool or None, bool
        As in :class:`newton.Equilibrium`; linear theory is taken only far from any instability.
    """

    motion: FloatArray
    large: bool
    linear_error: float
    stable: bool | None = True
    jumped: bool = False


def solve_auto(model: ShellModel, load: Any, *, tolerance: float) -> AutoSolution:
    """Linear where the estimate says that is within ``tolerance``, else large displacements.

    Raises
    ------
    NumericalError
        If the tolerance is not positive, or a solution is not found.
    """
    if not tolerance > 0.0:
        raise NumericalError(f"the tolerance must be positive (got {tolerance})")
    check = check_linear(model, load)
    if LINEAR_ERROR_SAFETY * check.error <= tolerance:
        return AutoSolution(motion=check.motion, large=False, linear_error=check.error)
    force = dense_vector(load, model.fixed.size, "force")
    end = solve_large(model, Loading(force=force))[0]
    return AutoSolution(
        motion=end.state.motion,
        large=True,
        linear_error=check.error,
        stable=end.stable,
        jumped=end.jumped,
    )
