r"""What a mesh misses at free edges: the layer, as wide as the wall is thick, where twist fades.

Along a free edge no twisting moment can act, so the twist 2κ₀ that a shell has inside must be
taken over by transverse shear β over a length 1/λ = t/√10 (shear factor 5/6). Per length of edge
the shell thereby loses the twisting stiffness of a strip t/√10 wide; for a strip of width b under
torsion this is the known b t³/3 · (1 − 0.63 t/b). Elements much larger than t miss it, and no
comparison of two such meshes can show that.

The element's β is linear across the edge and carried by its mean along it, which is the linear
element for −β″ + λ²β = 0. On elements of width h that has the closed solution (x = λh)::

    captured share of the loss = 1/√(1 + x²/12)
    decay from node to node    ρ = (1 − x²/6) / (1 + x²/3 + x √(1 + x²/12))
    mean twist of the edge's element = 2κ₀ · (1 − (1 − ρ) / (x √(1 + x²/12)))

from which the missing share and the twist inside follow. Derived here; first order in t/b.
"""

import numpy as np

from phytac_design.mechanics.shell.discretisation import ProbedShell
from phytac_design.mechanics.shell.shell_element import shape
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


def free_edges(quads: IntArray, fixed: BoolArray) -> tuple[IntArray, IntArray]:
    """Element (k,) and side (k,), 0 … 3 from corner ``side`` on, of every free edge.

    An edge is free if it belongs to one element and no rotation is held at one of its ends at
    least; clamped edges and planes of symmetry have no layer.
    """
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1)
    _, slot, uses = np.unique(
        np.sort(ends, axis=2).reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    single = (uses[slot.ravel()] == 1).reshape(-1, 4)
    held = np.all(np.any(fixed[ends, 3:], axis=3), axis=2)
    element, side = np.nonzero(single & ~held)
    return element, side


def free_edge_force(model: ShellModel, motion: FloatArray) -> FloatArray | None:
    """Nodal forces whose motion is what ``motion`` lacks for want of the layer.

    Parameters
    ----------
    model : ShellModel
        The shell.
    motion : (N, 6, m) float
        Its motion under m loads, mm and rad.

    Returns
    -------
    (N, 6, m) float or None
        N and N mm; None where no edge is free.
    """
    element, side = free_edges(model.quads, model.fixed)
    if not len(element):
        return None
    quads = model.quads[element]
    directors = model.directors
    D = directors[quads] if directors.ndim == 2 else directors[element]
    rows, across, along = _twist_rows(model.nodes_mm[quads], D, side)
    count = len(model.quads)
    t = np.broadcast_to(model.thickness_mm, count)[element]
    G = np.broadcast_to(model.modulus_MPa, count)[element] / (2.0 * (1.0 + model.poisson))
    x = np.sqrt(10.0) * across / t
    root = np.sqrt(1.0 + x * x / 12.0)
    decay = (1.0 - x * x / 6.0) / (1.0 + x * x / 3.0 + x * root)
    mean = 1.0 - (1.0 - decay) / (x * root)
    loss = G * t**3 / 12.0 * t / np.sqrt(10.0) * along * (1.0 - 1.0 / root) / mean**2
    twist = np.einsum("ki,kim->km", rows, motion[quads].reshape(len(quads), 24, -1))
    force = np.zeros_like(motion)
    share = rows[:, :, None] * (loss[:, None] * twist)[:, None]
    np.add.at(force, quads, share.reshape(len(quads), 4, 6, -1))
    return force


def _twist_rows(
    X: FloatArray, D: FloatArray, side: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows (k, 24) of 2κ_ns at the element's middle; its width across the edge; edge length."""
    here = np.arange(len(X))
    opposite = X[here, (side + 2) % 4] - X[here, (side + 3) % 4]
    edge = X[here, (side + 1) % 4] - X[here, side]
    along = np.linalg.norm(edge, axis=1)
    area = np.linalg.norm(np.cross(X[:, 2] - X[:, 0], X[:, 3] - X[:, 1]), axis=1) / 2.0
    across = area / np.linalg.norm((edge + opposite) / 2.0, axis=1)
    dh = shape(0.0, 0.0)[1]
    g = np.einsum("ai,kix->kax", dh, X)
    turn = np.einsum("ai,kix->kax", dh, D)
    n = np.cross(g[:, 0], g[:, 1])
    n /= np.linalg.norm(n, axis=1)[:, None]
    tangent = edge - np.sum(edge * n, axis=1)[:, None] * n
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    frame = np.stack([tangent, np.cross(tangent, n)], axis=1)
    A = np.linalg.inv(np.einsum("kax,kix->kai", g, frame))

    def curvature(a: int, b: int) -> FloatArray:
        move = dh[b][:, None] * turn[:, a, None]
        spin = dh[b][:, None] * np.cross(D, g[:, a, None])
        return np.concatenate([move, spin], axis=2).reshape(len(X), 24)

    mixed = (curvature(0, 1) + curvature(1, 0)) / 2.0
    parts = ((curvature(0, 0), mixed), (mixed, curvature(1, 1)))
    rows = np.zeros((len(X), 24))
    for a in range(2):
        for b in range(2):
            rows += 2.0 * (A[:, 0, a] * A[:, 1, b])[:, None] * parts[a][b]
    return rows, across, along


class FreeEdgeShell(ProbedShell):
    """A shell on one mesh whose free edges are corrected for the layer that the mesh misses."""

    def correction(self, motion: FloatArray) -> FloatArray:
        """Motion (n, 3, m) of the points that the mesh misses at free edges."""
        force = free_edge_force(self.model, motion)
        if force is None:
            return super().correction(motion)
        return self.read(self.model.solve(force.reshape(-1, motion.shape[2])).motion)
