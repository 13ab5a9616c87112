"""From element matrices to one sparse matrix; the pattern is found once and used again."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Sparsity of the stiffness of a mesh in blocks of 6×6 (node by node).

    Attributes
    ----------
    order : (16·E,) int
        Permutation that sorts the node pairs of all elements by (row node, column node).
    first : (B,) int
        Where each distinct pair begins in that order.
    indptr, indices : (N+1,), (B,) int
        Block-compressed rows.
    """

    order: IntArray
    first: IntArray
    indptr: IntArray
    indices: IntArray


def make_pattern(quads: IntArray, node_count: int) -> Pattern:
    """Sparsity pattern of quads (E, 4) over ``node_count`` nodes."""
    row = np.repeat(quads, 4, axis=1).ravel()
    column = np.tile(quads, (1, 4)).ravel()
    key = row * node_count + column
    order = np.argsort(key, kind="stable")
    distinct, first = np.unique(key[order], return_index=True)
    counts = np.bincount(distinct // node_count, minlength=node_count)
    indptr = np.concatenate([[0], np.cumsum(counts)])
    return Pattern(order=order, first=first, indptr=indptr, indices=distinct % node_count)


def assemble(pattern: Pattern, stiffness: FloatArray) -> Any:
    """Sum element matrices (E, 24, 24) into a symmetric (6N, 6N) ``scipy.sparse.csc_matrix``."""
    from scipy.sparse import bsr_matrix, csc_matrix

    count = len(stiffness)
    blocks = stiffness.reshape(count, 4, 6, 4, 6).transpose(0, 1, 3, 2, 4).reshape(-1, 36)
    summed = np.add.reduceat(blocks[pattern.order], pattern.first, axis=0).reshape(-1, 6, 6)
    size = 6 * (len(pattern.indptr) - 1)
    rows = bsr_matrix((summed, pattern.indices, pattern.indptr), shape=(size, size)).tocsr()
    # Symmetric: the compressed rows are the compressed columns.
    return csc_matrix((rows.data, rows.indices, rows.indptr), shape=(size, size))
