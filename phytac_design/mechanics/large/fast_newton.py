"""Large displacements for tables: quick, and without a word on stability.

Of :mod:`modified` this keeps start and iteration. A motion that is found may be one that a shell
snaps to; what does not converge is left to the caller.
"""

import numpy as np

from phytac_design.mechanics.large.newton import NotConvergedError
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

ROUGH, ROUGH_MOST = 1e-3, 5e-3
"""Residual that the iteration ends at (in the norm of K₀, over the linear motion), and what is
still taken where it stalls."""


class Rough(QuasiNewtonSolver):
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
        least, nearest = np.inf, None
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                for step in self.steps(self._expanded(linear, force), force):
                    if step.away < least:
                        least, nearest = step.away, step.motion
                    if least <= ROUGH:
                        break
        except NotConvergedError:
            pass  # what is nearest may do
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError):
            return None
        return nearest if least <= ROUGH_MOST else None
