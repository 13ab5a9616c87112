r"""Discretisation error of a linear solution, by Richardson extrapolation over two meshes.

The motion on mesh h is u_h = u + c·h² + … . With the same probes on a coarser mesh H::

    u − u_h ≈ (u_h − u_H) / ((H/h)^p − 1)

with the element's rate p = 2. Where the two meshes differ by more than a tenth of the peak the
coarse one is not yet in that range, and p = 1.6 errs on the safe side.

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
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.compliance import point_motion
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class ErrorSettings:
    """Rates of convergence."""

    min_size_ratio: float = 1.6
    """Least ratio of element sizes of one mesh to the next; nearer ones gave estimates 3 times
    off."""

    rate: float = 2.0
    """Order of the motion's error in the element size."""
    coarse_rate: float = 1.6
    """Rate assumed where the meshes differ by more than ``coarse_step``."""
    coarse_step: float = 0.1
    """Difference of the meshes, of the peak, up to which the rate of theory is trusted."""


SETTINGS = ErrorSettings()


@dataclass(frozen=True, kw_only=True)
class ProbedShell:
    """A shell on one mesh, its loads, and the probed points.

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

    def correction(self, motion: FloatArray) -> FloatArray:
        """Motion (n, 3, m) of the points that this mesh lacks by theory: none for a sensor."""
        return np.zeros_like(self.read(motion))


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
    asymptotic : (m,) bool
        False where the meshes differ too much for the rate of theory: refine before the figure
        is relied on.
    elements : tuple of int
        Elements of each mesh, finest first.
    """

    motion: FloatArray
    extrapolated: FloatArray
    error: FloatArray
    relative: FloatArray
    asymptotic: BoolArray
    elements: tuple[int, ...]


def estimate_error(
    make: Callable[[int], ProbedShell], refine: Sequence[int]
) -> DiscretisationError:
    """Solve on two meshes and estimate the error of the finer one.

    Parameters
    ----------
    make : callable
        ``make(refine)`` gives the shell on one mesh; elements get smaller with ``refine`` and
        are refined alike everywhere.
    refine : sequence of int
        Two, the finer first, e.g. ``(4, 2)``: a mesh of half the elements along each side costs
        about a sixth of the other.

    Raises
    ------
    NumericalError
        If the meshes are not two, the second is not coarser, they differ in their probes, or a
        solution fails.
    """
    if len(refine) != 2:
        raise NumericalError(
            "mesh-error-one-mesh",
            f"an estimate of the mesh's error needs two meshes (got {len(refine)}); give e.g. "
            "refine = (4, 2)",
        )
    plain, correction, elements = [], [], []
    for level in refine:
        part = make(level)
        motion = part.model.solve(part.loads).motion
        plain.append(part.read(motion))
        correction.append(part.correction(motion))
        elements.append(len(part.model.quads))
    ratio = float(np.sqrt(elements[0] / elements[1]))
    if ratio < SETTINGS.min_size_ratio:
        raise NumericalError(
            "mesh-error-size-ratio",
            f"the second mesh must be coarser by {SETTINGS.min_size_ratio} or more in element size "
            f"(got {elements} elements); order refine from fine to coarse",
        )
    if plain[0].shape != plain[1].shape:
        raise NumericalError(
            "mesh-error-results-differ",
            f"the meshes differ in probes or loads ({[part.shape for part in plain]}); make every "
            "mesh with the same points and loads",
        )
    values = [u + e for u, e in zip(plain, correction, strict=True)]
    step = values[0] - values[1]
    size = _largest(step) / _over_zero(_largest(values[0]))
    rate = np.where(size > SETTINGS.coarse_step, SETTINGS.coarse_rate, SETTINGS.rate)
    off = correction[0] + step / (ratio**rate - 1.0)
    extrapolated = plain[0] + off
    return DiscretisationError(
        motion=plain[0],
        extrapolated=extrapolated,
        error=np.linalg.norm(off, axis=1),
        relative=_largest(off) / _over_zero(_largest(extrapolated)),
        asymptotic=size <= SETTINGS.coarse_step,
        elements=tuple(elements),
    )


def probed_sensor(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    centres_uv: FloatArray,
    radii_mm: FloatArray | float,
) -> ProbedShell:
    """Shell under 1 N on patches; probes are the tips of all markers, then the patches' centres.

    A patch narrower than an element of the coarse mesh is not resolved by it.

    Parameters
    ----------
    model, mesh : ShellModel, ShellMesh
        The shell, its mesh aligned with the markers.
    surface, markers : Surface, Markers
        Outer face and receptors.
    centres_uv, radii_mm : (m, 2) float, float or (m,) float
        Patches (:func:`loads.patch_loads`).
    """
    nodes, weights = locate(mesh, centres_uv)
    own = np.repeat(mesh.marker_nodes[:, None], 4, axis=1)
    return ProbedShell(
        model=model,
        loads=patch_loads(mesh, surface, centres_uv, radii_mm),
        nodes=np.concatenate([own, nodes]),
        weights=np.concatenate([np.full(own.shape, 0.25), weights]),
        arm_mm=np.concatenate([markers.tip_mm - markers.mid_mm, np.zeros((len(nodes), 3))]),
    )


def _largest(field: FloatArray) -> FloatArray:
    """Largest length (m,) of vectors (n, 3, m)."""
    return np.asarray(np.linalg.norm(field, axis=1).max(axis=0))


def _over_zero(value: FloatArray) -> FloatArray:
    return np.where(value > 0.0, value, 1.0)
