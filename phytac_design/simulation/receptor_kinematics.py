"""How receptors move with the wall that they stand on.

A tube is one with the wall's inner face, so it turns as the face does, and the face leans by more
than the material normal (the director of the shell theory) turns: by the transverse shear, several
percent beside a patch or a rim. With tangent t, normal n and director turn θ along an edge from i
to j of length L the shear is

    γ = n·(u_j − u_i) / L + t·(θ × n),

at the middle of the edge, exact to second order (the same that the elements take, MITC4). The
edges of a node give its gradient g by least squares, nearer ones heavier; the face turns by θ and
then by g × n more. The tube takes the mean over a ring in its base.
"""

from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity, kron

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.simulation.linear_response import motion_probe
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray


class ReceptorKinematics:
    """Motion of the receptors of one mesh.

    Parameters
    ----------
    mesh : ShellMesh
        Mesh of the middle face, aligned with the receptors or not.
    surface : Surface
        The outer face.
    uv : (n, 2) float
        Where the receptors stand.
    radius_mm : float
        Outer radius of their tubes.
    """

    def __init__(self, mesh: ShellMesh, surface: Surface, uv: FloatArray, radius_mm: float) -> None:
        self._normals = mesh.normals
        first, second = _edges(mesh)
        self._first, self._second = first, second
        step = mesh.nodes_mm[second] - mesh.nodes_mm[first]
        self._length = np.linalg.norm(step, axis=1)
        self._along = step / self._length[:, None]
        self._lean = self._leaning()
        # The mean of a linear slope over the base lies nearer, that of a solid base's turn, which
        # resists bending, farther out.
        self._mean = _means(mesh, surface, uv, 0.5 * radius_mm)

    @cached_property
    def matrix(self) -> csr_matrix:
        """What makes linear motion (6n,) of the receptors from that (6N,) of the nodes."""
        size = 6 * len(self._normals)
        spread = np.arange(size).reshape(-1, 6)[:, 3:].ravel()
        put = csr_matrix((np.ones(len(spread)), (spread, np.arange(len(spread)))))
        beyond = put @ (self._lean @ self._shear())
        return csr_matrix(self._mean @ (identity(size, format="csr") + beyond))

    def linear(self, field: FloatArray) -> FloatArray:
        """Motion (n, 6) by a linear field (6N,): translations (mm), small rotations (rad)."""
        return np.asarray(self.matrix @ field.ravel()).reshape(-1, 6)

    def large(self, field: FloatArray) -> FloatArray:
        """Motion (n, 6) by a field (6N,) of translations (mm) and rotation vectors (rad)."""
        at = field.reshape(-1, 6)
        move, turn = at[:, :3], rot.exponential(at[:, 3:])
        i, j, n = self._first, self._second, self._normals
        tilt = (rot.deviation(turn) @ n[:, :, None])[:, :, 0]
        step = (move[j] - move[i]) / self._length[:, None]
        shear = (
            np.sum(step * (n[i] + tilt[i] + n[j] + tilt[j]), axis=1)
            + np.sum(self._along * (tilt[i] + tilt[j]), axis=1)
        ) / 2.0
        both = rot.product(turn, rot.exponential((self._lean @ shear).reshape(-1, 3)))
        motion = np.column_stack([move, rot.logarithm(both)])
        return np.asarray(self._mean @ motion.ravel()).reshape(-1, 6)

    def _shear(self) -> csr_matrix:
        """Shear of each edge, (m, 6N), by a linear field."""
        i, j, n = self._first, self._second, self._normals
        move = (n[i] + n[j]) / (2.0 * self._length[:, None])
        value = np.column_stack(
            [
                -move,
                rot.cross(n[i], self._along) / 2.0,
                move,
                rot.cross(n[j], self._along) / 2.0,
            ]
        )
        columns = np.concatenate(
            [6 * i[:, None] + np.arange(6), 6 * j[:, None] + np.arange(6)], axis=1
        )
        rows = np.broadcast_to(np.arange(len(i))[:, None], columns.shape)
        shape = (len(i), 6 * len(n))
        return csr_matrix((value.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    def _leaning(self) -> csr_matrix:
        """By how much each node's face turns, (3N, m), beyond its director, by edges' shear."""
        nodes = np.concatenate([self._first, self._second])
        along = np.concatenate([self._along, self._along])
        weight = 1.0 / np.concatenate([self._length, self._length])
        count = len(self._normals)
        square = np.zeros((count, 3, 3))
        np.add.at(square, nodes, weight[:, None, None] * along[:, :, None] * along[:, None])
        inverse = np.linalg.pinv(square, rcond=1e-6, hermitian=True)
        gradient = weight[:, None] * np.einsum("eij,ej->ei", inverse[nodes], along)
        value = rot.cross(gradient, self._normals[nodes])
        edge = np.tile(np.arange(len(self._length)), 2)
        rows = 3 * nodes[:, None] + np.arange(3)
        columns = np.broadcast_to(edge[:, None], rows.shape)
        shape = (3 * count, len(self._length))
        return csr_matrix((value.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _edges(mesh: ShellMesh) -> tuple[IntArray, IntArray]:
    """Nodes of every edge once, (m,) each; none of no length."""
    no_edge = 1e-9  # edges shorter than this share of the longest are the collapsed ones at a pole
    quads = mesh.quads
    pairs = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    length = np.linalg.norm(mesh.nodes_mm[pairs[:, 1]] - mesh.nodes_mm[pairs[:, 0]], axis=1)
    first, second = pairs[length > no_edge * length.max()].T
    return first, second


def _means(mesh: ShellMesh, surface: Surface, uv: FloatArray, radius_mm: float) -> csr_matrix:
    """Mean motion (6n, 6N) over rings about places; what lies beyond a rim counts at the rim."""
    count = 12  # places on the ring
    along, around = tangent_frame(surface, uv)
    angle = 2.0 * np.pi * np.arange(count) / count
    ring = along[:, None] * np.cos(angle)[:, None] + around[:, None] * np.sin(angle)[:, None]
    places = surface.chart((surface.point(uv)[:, None] + radius_mm * ring).reshape(-1, 3))
    for axis, (low, high) in enumerate(surface.domain):
        if not surface.periodic[axis]:
            places[:, axis] = np.clip(places[:, axis], low, high)
    mean = kron(
        kron(identity(len(uv)), np.full((1, count), 1.0 / count)),
        identity(6),
        format="csr",
    )
    return csr_matrix(mean @ motion_probe(mesh, places))
