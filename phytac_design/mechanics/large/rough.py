"""Large displacements for tables: quick, and without a word on stability.

Of :mod:`modified` this keeps start and iteration. A motion that is found may be one that a shell
snaps to; what does not converge is left to the caller.
"""

import numpy as np

from phytac_design.mechanics.large.anderson import Anderson
from phytac_design.mechanics.large.modified import (
    ITERATIONS,
    NEAR,
    STALLED,
    TURNED,
    Expansion,
    Modified,
    damping_of,
    turn_of,
)
from phytac_design.mechanics.large.softest import Softest
from shapes.arrays import FloatArray
from shapes.errors import NumericalError

ROUGH, ROUGH_MOST = 1e-3, 5e-3
"""Residual that the iteration ends at (in the norm of K₀, over the linear motion), and what is
still taken where it stalls."""


class Rough(Modified):
    """Large displacements of one shell for tables; built once."""

    def gap(self, load: FloatArray, motion: FloatArray, linear: FloatArray) -> float:
        """How far a motion is from equilibrium, over linear motion, in the norm of K₀.

        About the relative error of the motion where the shell neither softens nor stiffens much.

        Parameters
        ----------
        load : (6N,) float
            Nodal forces (N) and moments (N mm).
        motion, linear : (6N,) float
            The motion that is judged, and that of linear theory.

        Raises
        ------
        NumericalError
            If an element is distorted beyond what it can describe.
        """
        residual = np.where(self._shell.held, 0.0, load) - self._shell.internal(motion)
        g = self._shell.solved(residual[:, None])[:, 0]
        return float(np.sqrt(max(float(g @ residual), 0.0) / float(linear @ load)))

    def rough(self, load: FloatArray, linear: FloatArray) -> FloatArray | None:
        """Motion (6N,) known to ``ROUGH``, for tables: nothing vouches for its stability.

        Parameters
        ----------
        load : (6N,) float
            Nodal forces (N) and moments (N mm, fixed axes).
        linear : (6N,) float
            Linear motion.

        Returns
        -------
        (6N,) float or None
            None where the iteration does not come within ``ROUGH_MOST``.
        """
        force = np.where(self._shell.held, 0.0, load)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                expansion = self._expanded(linear, force)
                away, motion = self._settled(expansion, force)
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError):
            return None
        return motion if away <= ROUGH_MOST else None

    def _settled(self, expansion: Expansion, force: FloatArray) -> tuple[float, FloatArray]:
        """Least residual (in the norm of K₀, over the linear motion) found, and the step from it.

        Raises
        ------
        NumericalError
            If an element is distorted beyond what it can describe.
        """
        shell, history = self._shell, Anderson()
        size = float(expansion.first @ force)
        x = self._start(expansion, force)
        soft: Softest | None = None
        damping, best, best_at, nearest = 1.0, np.inf, 0, x
        for iteration in range(ITERATIONS):
            internal = shell.internal(x)
            residual = force - internal
            if soft is None:
                g = shell.solved(residual[:, None])[:, 0]
            else:
                self._measure(soft, x, internal)
                damping = damping_of(soft)
                g = self._beside(soft, residual)
            away = float(np.sqrt(max(float(g @ residual), 0.0) / size))
            x = history.next(x, g, residual, damping)
            if away < best:
                best, best_at, nearest = away, iteration, x
            if best <= ROUGH or iteration - best_at > STALLED or turn_of(x) > TURNED:
                break
            if away > 2.0 * NEAR:
                soft = None
            elif soft is None and away < NEAR:
                soft = expansion.soft.afresh()
        return best, nearest
