r"""Displacement at measured places per newton, with its rates, extrapolated over two meshes.

Two meshes whose element counts are as 2 : 3 in both directions are solved and extrapolated
(Richardson; the error of the element is of order h²)::

    c = c_fine + (c_fine - c_coarse) / ((3/2)² - 1)

Between nodes the inward motion is interpolated with the nodal rotations too, which makes it exact
for a quadratic bulge: Σ h_i (u_i + ½ θ_i × (x - x_i)) (Zienkiewicz' linked interpolation).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phytac_design.mechanics.calibration.measurements import Measurements
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import ReceptorStiffness
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_design.mechanics.shell.stiffness_sensitivity import motion_rate, stiffness_rates
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

MESH_RATIO = 1.5
"""Element counts of the fine mesh over those of the coarse one."""


@dataclass(frozen=True, kw_only=True)
class ProbeMotion:
    """Inward displacement (n,) at each row's probe for 1 N on its patch and E = 1 MPa.

    Attributes
    ----------
    value : (n,) float
        mm/N at 1 MPa.
    thickness_rate, poisson_rate : (n,) float
        Its derivatives, per mm of wall (middle face held) and per unit of ν; ``poisson_rate`` is
        None where it was not requested.
    mesh_error : (n,) float
        ``value`` minus that of the finer mesh: an estimate of the finer mesh's error.
    """

    value: FloatArray
    thickness_rate: FloatArray
    poisson_rate: FloatArray | None
    mesh_error: FloatArray


ResponseModel = Callable[[float, float, bool], ProbeMotion]
"""Response for wall (mm), Poisson's ratio, and whether its rate with the latter is wanted."""


@dataclass(frozen=True, kw_only=True)
class ProbeResponse:
    """The response of a sensor shell with clamped rims, a :data:`ResponseModel`.

    Attributes
    ----------
    surface : Surface
        The outer face, which stays while the wall grows inward.
    rows : Measurements
        Places and patches; forces and displacements are not used.
    around : int
        Elements around of the coarser mesh; made even.
    factors : callable, optional
        Stiffness of receptors on a mesh (:func:`receptors.receptor_stiffness`), taken as fixed
        while the wall is searched; none for a plain wall.
    """

    surface: Surface
    rows: Measurements
    around: int
    factors: Callable[[ShellMesh], ReceptorStiffness] | None = None
    _kept: dict[int, tuple[Any, IntArray, FloatArray]] = field(default_factory=dict)

    def __call__(self, thickness_mm: float, poisson: float, with_poisson: bool, /) -> ProbeMotion:
        """Solve both meshes and extrapolate."""
        counts = mesh_counts(self.surface, self.around)
        coarse = self._on_mesh(counts, thickness_mm, poisson, with_poisson)
        finer = (round(counts[0] * MESH_RATIO), round(counts[1] * MESH_RATIO))
        fine = self._on_mesh(finer, thickness_mm, poisson, with_poisson)
        error = (fine - coarse) / (MESH_RATIO**2 - 1.0)
        best = fine + error
        return ProbeMotion(
            value=best[0],
            thickness_rate=best[1],
            poisson_rate=best[2] if with_poisson else None,
            mesh_error=error[0],
        )

    def _on_mesh(
        self, counts: tuple[int, int], thickness_mm: float, poisson: float, with_poisson: bool
    ) -> FloatArray:
        """Displacements and their rates, (2 or 3, n)."""
        mesh = chart_mesh(
            self.surface, thickness_mm=thickness_mm, n_along=counts[0], n_around=counts[1]
        )
        section: tuple[float | FloatArray, float | FloatArray] = (thickness_mm, 1.0)
        if self.factors is not None:
            section = self.factors(mesh).section(thickness_mm=thickness_mm, modulus_MPa=1.0)
        model = clamped_model(
            mesh, thickness_mm=section[0], modulus_MPa=section[1], poisson=poisson
        )
        rates = stiffness_rates(
            model, with_poisson=with_poisson, thickness_share=section[0] / thickness_mm
        )
        key = np.column_stack([self.rows.contact_uv, self.rows.radius_mm])
        distinct, load = np.unique(key, axis=0, return_inverse=True)
        if counts[1] not in self._kept:  # the mesh's chart, and so its loads, do not change
            loads = patch_loads(mesh, self.surface, distinct[:, :2], distinct[:, 2])
            self._kept[counts[1]] = loads, *locate(mesh, self.rows.probe_uv)
        loads, nodes, shape = self._kept[counts[1]]
        weights = _inward_weights(mesh, self.surface, self.rows.probe_uv, nodes, shape)
        out = np.zeros((3 if with_poisson else 2, len(load)))
        at_once = 64  # loads, to bound the memory
        for first in range(0, len(distinct), at_once):
            here = np.flatnonzero((load >= first) & (load < first + at_once))
            solved = model.solve(loads[:, first : first + at_once]).motion
            motions = [solved, motion_rate(model, rates.thickness, solved)]
            if with_poisson:
                motions.append(motion_rate(model, rates.poisson, solved))
            for k, motion in enumerate(motions):
                out[k, here] = _probe(nodes[here], weights[here], motion, load[here] - first)
        return out


def mesh_counts(surface: Surface, around: int) -> tuple[int, int]:
    """Elements (along, around) of the coarse mesh: even, and about square on average."""
    (u0, u1), (v0, v1) = surface.domain
    u = u0 + (u1 - u0) * (np.arange(33) + 0.5) / 33
    metric = surface.metric(np.column_stack([u, np.full_like(u, v0)]))
    length = (u1 - u0) * float(np.mean(np.sqrt(metric[:, 0, 0])))
    girth = (v1 - v0) * float(np.mean(np.sqrt(metric[:, 1, 1])))
    even = max(4, 2 * round(around / 2))
    return max(4, 2 * round(even * length / girth / 2)), even


def probe_weights(mesh: ShellMesh, surface: Surface, uv: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nodes (n, 4) and weights (n, 4, 6) of the inward displacement at chart positions (n, 2)."""
    nodes, shape = locate(mesh, uv)
    return nodes, _inward_weights(mesh, surface, uv, nodes, shape)


def _inward_weights(
    mesh: ShellMesh, surface: Surface, uv: FloatArray, nodes: IntArray, shape: FloatArray
) -> FloatArray:
    """Weights (n, 4, 6) of the nodes' translations and rotations."""
    inward = -surface.normal(uv)[:, None]
    arm = surface.point(uv, -mesh.thickness_mm / 2.0)[:, None] - mesh.nodes_mm[nodes]
    # inward · (θ × arm) = θ · (arm × inward)
    turn = 0.5 * np.cross(arm, np.broadcast_to(inward, arm.shape))
    shift = np.broadcast_to(inward, turn.shape)
    return np.asarray(shape[:, :, None] * np.concatenate([shift, turn], axis=2))


def _probe(nodes: IntArray, weights: FloatArray, motion: FloatArray, load: IntArray) -> FloatArray:
    """Inward displacement of some rows, each under its own load, (k,)."""
    return np.asarray(np.einsum("ncd,ncd->n", weights, motion[nodes, :, load[:, None]]))
