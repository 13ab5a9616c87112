r"""How far a linear solution is off because of the mesh: a second mesh, and the free edges.

The motion on mesh h is u_h = u + c·h² + … . With the same probes on a coarser mesh H::

    u − u_h ≈ e_h + (v_h − v_H) / ((H/h)^p − 1),     v = u_h + e_h

e_h is what free edges lack (:mod:`free_edge`); rate p = 2, the element's. Where the two meshes
differ by more than a tenth of the peak the coarse one is not yet in that range, and p = 1.6 errs
on the safe side.

The *field* is compared, the largest error of all probes over the largest motion. The error of a
single number passes through zero where a mesh happens to be right, and no estimate can follow
that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.layout import Markers
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.compliance import point_motion
from phytac_design.mechanics.shell.free_edge import free_edge_force
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError

RATE = 2.0
"""Order of the motion's error in the element size."""
COARSE_RATE = 1.6
"""Rate assumed where the meshes differ by more than ``COARSE_STEP``."""
COARSE_STEP = 0.1
"""Difference of the meshes, of the peak, up to which the rate of theory is trusted."""
LEAST_RATIO = 1.6
"""Least ratio of element sizes of one mesh to the next; nearer ones gave estimates 3 times off."""


@dataclass(frozen=True, kw_only=True)
class ProbedShell:
    """A shell on one mesh, its loads, and the points looked at.

    Attributes
    ----------
    model : ShellModel
        The shell.
    loads : (6N, m) float
        Nodal forces and moments, dense or scipy.sparse.
    nodes, weights : (n, k) int, (n, k) float
        Every point as weighted nodes; the same n points on every mesh.
    arm_mm : (n, 3) float or None
        From the middle face to the point, carried along rigidly, as a marker's tip; None: 0.
    """

    model: ShellModel
    loads: Any
    nodes: IntArray
    weights: FloatArray
    arm_mm: FloatArray | None = None

    def read(self, motion: FloatArray) -> FloatArray:
        """Translation (n, 3, m) of the points from the motion (N, 6, m) of the nodes."""
        here = np.einsum("nk,nkdm->ndm", self.weights, motion[self.nodes])
        arm = np.zeros((len(here), 3)) if self.arm_mm is None else self.arm_mm
        return point_motion(here, arm)


@dataclass(frozen=True, kw_only=True)
class DiscretisationError:
    """Motion of the probes, and how far it is off because of the mesh.

    Attributes
    ----------
    motion : (n, 3, m) float
        Translation on the finest mesh, mm.
    extrapolated : (n, 3, m) float
        The same with the estimated error taken off, mm.
    error : (n, m) float
        Estimated error of each probe, mm. That of a single probe may be off by more than the
        largest of all, which is what the estimate is shown to be honest for.
    relative : (m,) float
        Largest estimated error of all probes over the largest extrapolated translation.
    rate : (m,) float
        Order of convergence seen on three meshes; NaN with two.
    asymptotic : (m,) bool
        False where the meshes differ too much for the rate of theory, or three meshes do not
        converge at order 1 at least: refine before the figure is relied on.
    elements : tuple of int
        Elements of each mesh, finest first.
    """

    motion: FloatArray
    extrapolated: FloatArray
    error: FloatArray
    relative: FloatArray
    rate: FloatArray
    asymptotic: BoolArray
    elements: tuple[int, ...]


def estimate_error(
    make: Callable[[int], ProbedShell], refine: Sequence[int]
) -> DiscretisationError:
    """Solve on two or three meshes and estimate the error of the finest.

    Parameters
    ----------
    make : callable
        ``make(refine)`` gives the shell on one mesh; elements get smaller with ``refine`` and
        are refined alike everywhere.
    refine : sequence of int
        Two or three, finest first, e.g. ``(4, 2)`` or ``(8, 4, 2)``: the second mesh of half the
        elements along each side costs about a sixth of the first; a third gives the rate.

    Raises
    ------
    NumericalError
        If the meshes are not two or three, not successively coarser, differ in their probes, or
        a solution fails.
    """
    if len(refine) not in (2, 3):
        raise NumericalError(
            f"an estimate of the mesh's error needs two or three meshes (got {len(refine)}); "
            "give e.g. refine = (4, 2)"
        )
    plain, edge, elements = [], [], []
    for level in refine:
        part = make(level)
        moved = part.model.solve(part.loads).motion
        force = free_edge_force(part.model, moved)
        plain.append(part.read(moved))
        edge.append(
            np.zeros_like(plain[-1])
            if force is None
            else part.read(part.model.solve(force.reshape(-1, moved.shape[2])).motion)
        )
        elements.append(len(part.model.quads))
    ratios = np.sqrt(np.array(elements[:-1]) / np.array(elements[1:]))
    if np.any(ratios < LEAST_RATIO):
        raise NumericalError(
            f"the meshes must get coarser by {LEAST_RATIO} or more in element size (got "
            f"{elements} elements, finest first); order refine from fine to coarse"
        )
    if len({part.shape for part in plain}) != 1:
        raise NumericalError(
            f"the meshes differ in probes or loads ({[part.shape for part in plain]}); make every "
            "mesh with the same points and loads"
        )
    values = [u + e for u, e in zip(plain, edge, strict=True)]
    step = values[0] - values[1]
    size = _largest(step) / _over_zero(_largest(values[0]))
    rate = np.where(size > COARSE_STEP, COARSE_RATE, RATE)
    off = edge[0] + step / (ratios[0] ** rate - 1.0)
    seen = np.full(len(size), np.nan)
    if len(values) == 3:
        steps = _largest(step), _largest(values[1] - values[2])
        seen = np.array([_rate(float(a), float(b), ratios) for a, b in zip(*steps, strict=True)])
    extrapolated = plain[0] + off
    return DiscretisationError(
        motion=plain[0],
        extrapolated=extrapolated,
        error=np.linalg.norm(off, axis=1),
        relative=_largest(off) / _over_zero(_largest(extrapolated)),
        rate=seen,
        asymptotic=(size <= COARSE_STEP) & ~(seen < 1.0),
        elements=tuple(elements),
    )


def sensor_shell(
    surface: Surface,
    markers: Markers,
    *,
    thickness_mm: float,
    modulus_MPa: float,
    poisson: float,
    centres_uv: FloatArray,
    radii_mm: FloatArray | float,
) -> Callable[[int], ProbedShell]:
    """``make`` of :func:`estimate_error` for a sensor shell pressed with 1 N on patches.

    Probes are the tips of all markers, then the centres of the patches on the middle face.
    A patch narrower than an element of the coarse mesh is not resolved by it.

    Parameters
    ----------
    surface, markers : Surface, Markers
        Outer face and receptors.
    thickness_mm, modulus_MPa, poisson : float
        Wall and material.
    centres_uv, radii_mm : (m, 2) float, float or (m,) float
        Patches (:func:`loads.patch_loads`).
    """
    centres = np.asarray(centres_uv, dtype=np.float64).reshape(-1, 2)
    arm = np.concatenate([markers.tip_mm - markers.mid_mm, np.zeros((len(centres), 3))])

    def make(refine: int) -> ProbedShell:
        mesh = marker_mesh(surface, markers, thickness_mm=thickness_mm, refine=refine)
        nodes, weights = locate(mesh, centres)
        own = np.repeat(mesh.marker_nodes[:, None], 4, axis=1)
        return ProbedShell(
            model=clamped_model(mesh, modulus_MPa=modulus_MPa, poisson=poisson),
            loads=patch_loads(mesh, surface, centres, radii_mm),
            nodes=np.concatenate([own, nodes]),
            weights=np.concatenate([np.full(own.shape, 0.25), weights]),
            arm_mm=arm,
        )

    return make


def _largest(field: FloatArray) -> FloatArray:
    """Largest length (m,) of vectors (n, 3, m)."""
    return np.asarray(np.linalg.norm(field, axis=1).max(axis=0))


def _over_zero(value: FloatArray) -> FloatArray:
    return np.where(value > 0.0, value, 1.0)


def _rate(fine: float, coarse: float, ratios: FloatArray) -> float:
    """Order p with coarse/fine = (r₁r₂)^p − r₁^p over r₁^p − 1, by bisection in 0.05 … 8."""
    if not fine > 0.0:
        return float("nan")
    low, high = 0.05, 8.0
    for _ in range(50):
        p = 0.5 * (low + high)
        first, both = ratios[0] ** p, (ratios[0] * ratios[1]) ** p
        low, high = (p, high) if (both - first) / (first - 1.0) < coarse / fine else (low, p)
    return low
