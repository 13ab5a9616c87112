"""From element matrices to one sparse matrix; the pattern is found once and used again."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """Sparsity of the stiffness of a mesh of N nodes with B pairs of neighbouring nodes.

    Attributes
    ----------
    scatter : scipy.sparse.csc_matrix, (6B, 96E)
        Adds every sixth of a row of the element matrices (one node's row and six columns of one
        neighbour) to its place among the compressed rows.
    indptr, indices : (6N + 1,), (36B,) int
        Compressed rows of the whole matrix.
    """

    scatter: Any
    indptr: IntArray
    indices: IntArray


def make_pattern(quads: IntArray, node_count: int) -> Pattern:
    """Sparsity pattern of quads (E, 4) over ``node_count`` nodes."""
    from scipy.sparse import csc_matrix

    row = np.repeat(quads, 4, axis=1).ravel()
    key = row * node_count + np.tile(quads, (1, 4)).ravel()
    distinct, slot = np.unique(key, return_inverse=True)
    pairs = np.bincount(distinct // node_count, minlength=node_count)  # neighbours of each node
    start = np.concatenate([[0], np.cumsum(pairs)])
    kind = np.int32 if 36 * len(distinct) < np.iinfo(np.int32).max else np.int64
    axis = np.arange(6)
    # The six rows of a node follow one another, each with all of its neighbours.
    sixth = (slot + 5 * start[row])[:, None] + pairs[row][:, None] * axis  # (16E, 6)
    sixth = sixth.reshape(-1, 4, 4, 6).transpose(0, 1, 3, 2).ravel().astype(kind)
    scatter = csc_matrix(
        (np.ones(len(sixth)), sixth, np.arange(len(sixth) + 1, dtype=kind)),
        shape=(6 * len(distinct), len(sixth)),
    )
    columns = 6 * (distinct % node_count)[:, None] + axis  # (B, 6)
    place = (np.arange(len(distinct)) + 5 * start[distinct // node_count])[:, None]
    place = place + pairs[distinct // node_count][:, None] * axis  # (B, 6): of each of six rows
    indices = np.zeros((6 * len(distinct), 6), dtype=kind)
    indices[place] = columns[:, None]
    lengths = np.repeat(6 * pairs, 6)
    indptr: IntArray = np.concatenate([[0], np.cumsum(lengths)]).astype(kind)
    return Pattern(scatter=scatter, indptr=indptr, indices=indices.ravel())


def assemble(pattern: Pattern, stiffness: FloatArray) -> Any:
    """Sum element matrices (E, 24, 24) into a symmetric (6N, 6N) ``scipy.sparse.csc_matrix``."""
    from scipy.sparse import csc_matrix

    data = (pattern.scatter @ stiffness.reshape(-1, 6)).ravel()
    size = len(pattern.indptr) - 1
    # Symmetric: the compressed rows are the compressed columns.
    matrix = csc_matrix((data, pattern.indices, pattern.indptr), shape=(size, size))
    matrix.has_sorted_indices = matrix.has_canonical_format = True
    return matrix
