"""Parts that published shell problems are built of: structured meshes, supports, loads, a case."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.shell.discretisation import ProbedShell
from phytac_design.mechanics.shell.element import DRILLING, GAUSS, shape
from phytac_design.mechanics.shell.free_edge import FreeEdgeShell
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

Lines = int | FloatArray
"""Number of elements along a side, or the lines of nodes themselves, 0 … 1."""
Sides = int | tuple[Lines, Lines]
"""The same number along both sides, or one for each."""
SYMMETRY = {0: (0, 4, 5), 1: (1, 3, 5), 2: (2, 3, 4)}
"""DOFs held on a plane of symmetry with normal x, y or z."""


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A structured patch of quads over the unit square (a, b).

    Attributes
    ----------
    ab : (N, 2) float
        Parameters of the nodes in [0, 1].
    nodes : (N, 3) float
        Positions.
    normals : (N, 3) float
        Unit normals of the true surface.
    quads : (E, 4) int
        Corners.
    """

    ab: FloatArray
    nodes: FloatArray
    normals: FloatArray
    quads: IntArray


def patch(
    surface: Callable[[FloatArray, FloatArray], FloatArray],
    n_a: Lines,
    n_b: Lines,
    *,
    jitter: float = 0.0,
) -> Patch:
    """Mesh ``surface(a, b)`` -> (N, 3) with n_a × n_b elements, or with the lines given.

    ``jitter`` moves inner nodes by that share of a (mean) element. Normals are taken by central
    differences of the surface.
    """
    steps_a, steps_b = (
        np.linspace(0.0, 1.0, n + 1) if isinstance(n, int) else n for n in (n_a, n_b)
    )
    n_a, n_b = len(steps_a) - 1, len(steps_b) - 1
    ab = np.column_stack([np.repeat(steps_a, n_b + 1), np.tile(steps_b, n_a + 1)])
    inner = np.all((ab > 1e-9) & (ab < 1.0 - 1e-9), axis=1)
    move = np.random.default_rng(0).uniform(-jitter, jitter, ab.shape) / np.array([n_a, n_b])
    ab = ab + np.where(inner[:, None], move, 0.0)
    ids = np.arange(len(ab)).reshape(n_a + 1, n_b + 1)
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], -1).reshape(-1, 4)
    step = 1e-6
    along = surface(ab[:, 0] + step, ab[:, 1]) - surface(ab[:, 0] - step, ab[:, 1])
    across = surface(ab[:, 0], ab[:, 1] + step) - surface(ab[:, 0], ab[:, 1] - step)
    normals = np.cross(along, across)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return Patch(ab=ab, nodes=surface(ab[:, 0], ab[:, 1]), normals=normals, quads=quads)


def sides(n: Sides) -> tuple[Lines, Lines]:
    """Divisions along a and b."""
    return (n, n) if isinstance(n, int) else n


def line_weights(at_b: FloatArray) -> FloatArray:
    """Shares of a unit line load on nodes at ``at_b`` in 0 … 1, ascending."""
    half = np.diff(at_b) / 2.0
    return np.asarray(np.append(half, 0.0) + np.append(0.0, half))


def edge_lines(n: int, width: float, *, ends: tuple[bool, bool]) -> FloatArray:
    """Lines of ``n`` equal elements, refined towards the marked ends.

    A layer of ``width`` (as a share of the side) is resolved there.
    """
    near = np.concatenate([[0.0], np.geomspace(width / 6.0, 8.0 * width, 16)])
    near = near[near < 1.5 / n]
    extra = [near] * ends[0] + [1.0 - near] * ends[1]
    return np.unique(np.concatenate([np.linspace(0.0, 1.0, n + 1), *extra]))


def no_support(mesh: Patch) -> BoolArray:
    """All DOFs free, (N, 6)."""
    return np.zeros((len(mesh.nodes), 6), dtype=np.bool_)


def hold(fixed: BoolArray, where: BoolArray, dofs: tuple[int, ...]) -> None:
    """Hold ``dofs`` of the nodes ``where`` (N,) in place."""
    for dof in dofs:
        fixed[where, dof] = True


def surface_load(mesh: Patch, traction: FloatArray) -> FloatArray:
    """Consistent nodal forces (N, 6) of a traction (N, 3) given at the nodes (2×2 points)."""
    corner, carried = mesh.nodes[mesh.quads], traction[mesh.quads]
    forces = np.zeros((len(mesh.nodes), 6))
    for r in (-GAUSS, GAUSS):
        for s in (-GAUSS, GAUSS):
            h, dh = shape(r, s)
            g = np.einsum("ai,eik->aek", dh, corner)
            area = np.linalg.norm(np.cross(g[0], g[1]), axis=1)
            value = np.einsum("i,eik->ek", h, carried) * area[:, None]
            np.add.at(forces[:, :3], mesh.quads, h[None, :, None] * value[:, None])
    return forces


def solve_case(
    mesh: Patch,
    fixed: BoolArray,
    loads: FloatArray,
    *,
    modulus: float,
    poisson: float,
    thickness: float,
    drilling: float = DRILLING,
) -> FloatArray:
    """Motion (N, 6) under one load case (N, 6)."""
    model = ShellModel(
        mesh.nodes,
        mesh.quads,
        mesh.normals,
        thickness_mm=thickness,
        modulus_MPa=modulus,
        poisson=poisson,
        fixed=fixed,
        drilling=drilling,
    )
    return model.solve(loads.reshape(-1, 1)).motion[:, :, 0]


@dataclass(frozen=True, kw_only=True)
class Case:
    """A shell under one load, and where to read the motion that a reference is known for.

    Attributes
    ----------
    mesh : Patch
        The mesh.
    fixed : (N, 6) bool
        DOFs held at zero.
    loads : (N, 6) float
        Nodal forces and moments.
    read : (N, 6) float
        Weights of the DOFs that make up the motion looked at.
    reference : float
        Published value of that motion.
    modulus, poisson, thickness, drilling : float
        Material, wall and drilling factor.
    """

    mesh: Patch
    fixed: BoolArray
    loads: FloatArray
    read: FloatArray
    reference: float
    modulus: float
    poisson: float
    thickness: float
    drilling: float = DRILLING

    def model(self) -> ShellModel:
        """The shell, assembled."""
        return ShellModel(
            self.mesh.nodes,
            self.mesh.quads,
            self.mesh.normals,
            thickness_mm=self.thickness,
            modulus_MPa=self.modulus,
            poisson=self.poisson,
            fixed=self.fixed,
            drilling=self.drilling,
        )

    def motion(self) -> FloatArray:
        """Motion (N, 6) of all nodes."""
        return self.model().solve(self.loads.reshape(-1, 1)).motion[:, :, 0]

    def ratio(self) -> float:
        """Computed / reference."""
        return float(np.sum(self.read * self.motion()) / self.reference)


def probed(case: Case, points: FloatArray) -> ProbedShell:
    """Case looked at in its nodes nearest ``points`` (n, 3)."""
    from scipy.spatial import cKDTree

    nodes = cKDTree(case.mesh.nodes).query(points)[1][:, None]
    return FreeEdgeShell(
        model=case.model(),
        loads=case.loads.reshape(-1, 1),
        nodes=nodes,
        weights=np.ones(nodes.shape),
    )


def weights(mesh: Patch, *terms: tuple[int, int, float]) -> FloatArray:
    """Weights (N, 6) of (node, DOF, weight) for ``Case.read``."""
    out = np.zeros((len(mesh.nodes), 6))
    for node, dof, weight in terms:
        out[node, dof] = weight
    return out


def at(mesh: Patch, a: float, b: float) -> int:
    """Node nearest the parameters (a, b)."""
    return int(np.argmin(np.sum((mesh.ab - [a, b]) ** 2, axis=1)))
