"""The free rows and columns of a shell's matrices."""

from typing import Any

import numpy as np

from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray, IntArray


class FreeBlock:
    """Free part of matrices with the entries of a shell's stiffness.

    Parameters
    ----------
    model : ShellModel
        The shell.

    Attributes
    ----------
    free : (n,) int
        DOFs that are not held.
    scale : (6N,) float
        Scale of each DOF, so that forces and moments compare.
    matrix : (n, n) scipy.sparse.csc_matrix
        The last one that :meth:`scaled` returned.
    """

    def __init__(self, model: ShellModel) -> None:
        self.free: IntArray = np.flatnonzero(~model.fixed.ravel())
        diagonal = model.stiffness.diagonal()
        self.scale: FloatArray = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        full = model.stiffness.copy()
        full.data = np.arange(full.nnz, dtype=np.float64)
        self.matrix: Any = full[self.free][:, self.free].tocsc()
        self._slots = self.matrix.data.astype(np.int64)
        column = np.repeat(np.arange(len(self.free)), np.diff(self.matrix.indptr))
        row = self.matrix.indices
        self._weights = self.scale[self.free[row]] * self.scale[self.free[column]]

    def scaled(self, entries: FloatArray) -> Any:
        """Free part, scaled, of a matrix with these entries (``nnz`` of the stiffness,).

        The same object each time: zeros stay among its entries, because without them the ordering
        of a factor no longer sees a node's six DOFs as one.
        """
        self.matrix.data = entries[self._slots] * self._weights
        return self.matrix
