r"""Discretisation error of a linear solution: grid convergence index with a measured rate.

The motion on mesh h is u_h = u + c·h^p + … . Of three meshes, h₁ the finest, the differences of
the same probes give the rate p, and p the error (Roache 1994; Celik et al. 2008)::

    ‖u₂ − u₃‖ / ‖u₁ − u₂‖ = r₁₂^p (r₂₃^p − 1) / (r₁₂^p − 1)
    u − u₁ ≈ (u₁ − u₂) / (r₁₂^p − 1)

Layers that no mesh resolves, and locking, show in p: 0.05, or 4 where two meshes happen to agree.
The meshes converge as they should if p is near the element's rate 2 and both differences have the
same sign; the claimed error is then 1.25 times the above, with p ≤ 2. They are in the asymptotic
range if, besides, the first difference is small. Where they do not converge so, and with two
meshes, the factor is 3, with p from 1 to 2, and the figure is cautious and no estimate (Roache
1994 for two meshes; for three after Oberkampf and Roy 2010, section 8.6, whose least rate is 0.5).

The motion to use is u, extrapolated with the rate of theory: nearer to the truth than with the
measured one. The claimed error, made for u₁, is larger than that of u in 97 % of the cases of
``benchmarks.mechanics``.

The *field* is compared, the largest error of all probes over the largest motion. The error of a
single number passes through zero where a mesh happens to be right, and no estimate can follow
that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
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
    """Rates and safety factors.

    The limits were chosen on 91 thin shells with three triples of meshes each (four surfaces, two
    rises, three thicknesses, three supports, three loads): of 203 triples whose true error is
    known, 31 are asymptotic by them, with true errors of 0.38 to 2.6 times the claimed ones. Of the
    other 172, seven are above the claimed ones, one by more than three times (4.8).
    """

    min_size_ratio: float = 1.6
    """Least ratio of element sizes of one mesh to the next; nearer ones gave estimates 3 times
    off."""
    rate: float = 2.0
    """Order of the motion's error in the element size, by theory."""
    rate_min: float = 1.25
    rate_max: float = 3.25
    """Measured rates of meshes that converge as they should."""
    alignment_min: float = 0.5
    """Cosine of the two differences as vectors: they must have the same sign."""
    safety: float = 1.25
    """Factor on their error (Roache 1994)."""
    safety_outside: float = 3.0
    """The same for other meshes, with a rate from ``rate_least`` to that of theory."""
    rate_least: float = 1.0
    step_max: float = 0.1
    """Difference of the two finer meshes, of the peak, in the asymptotic range."""


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
        The same on elements of size 0, by the rate of theory, mm: what to use.
    error : (n, m) float
        Claimed error of each probe, mm, of ``motion`` and of ``extrapolated``. That of a single
        probe may be off by more than the largest of all, which is what the estimate is shown to be
        honest for.
    relative : (m,) float
        Largest claimed error of all probes over the largest extrapolated translation.
    rate : (m,) float
        Measured rate of convergence; NaN with two meshes.
    asymptotic : (m,) bool
        Whether ``error`` is an estimate; elsewhere it is a cautious bound: refine before the
        figure is relied on. False with two meshes.
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
    """Solve on three meshes, or two, and estimate the error of the finest.

    Parameters
    ----------
    make : callable
        ``make(refine)`` gives the shell on one mesh; elements get smaller with ``refine`` and
        are refined alike everywhere.
    refine : sequence of int
        Three, or two, from fine to coarse, e.g. ``(8, 4, 2)``: a mesh of half the elements along
        each side costs about a sixth of the other.

    Raises
    ------
    NumericalError
        If the meshes are not two or three, one is not coarser than the one before it, they differ
        in their probes, or a solution fails.
    """
    if len(refine) not in (2, 3):
        raise NumericalError(
            "mesh-error-one-mesh",
            f"an estimate of the mesh's error needs two or three meshes (got {len(refine)}); give "
            "e.g. refine = (8, 4, 2)",
        )
    plain, correction, elements = [], [], []
    for level in refine:
        part = make(level)
        motion = part.model.solve(part.loads).motion
        plain.append(part.read(motion))
        correction.append(part.correction(motion))
        elements.append(len(part.model.quads))
    ratios = np.sqrt(np.array(elements[:-1]) / np.array(elements[1:]))
    if ratios.min() < SETTINGS.min_size_ratio:
        raise NumericalError(
            "mesh-error-size-ratio",
            f"each mesh must be coarser than the one before it by {SETTINGS.min_size_ratio} or "
            f"more in element size (got {elements} elements); order refine from fine to coarse",
        )
    if len({part.shape for part in plain}) > 1:
        raise NumericalError(
            "mesh-error-results-differ",
            f"the meshes differ in probes or loads ({[part.shape for part in plain]}); make every "
            "mesh with the same points and loads",
        )
    values = [u + e for u, e in zip(plain, correction, strict=True)]
    steps = [fine - coarse for fine, coarse in pairwise(values)]
    size = _largest(steps[0]) / _over_zero(_largest(values[0]))
    rate, converging = np.full(len(size), np.nan), np.zeros(len(size), dtype=np.bool_)
    claimed_rate = np.full(len(size), SETTINGS.rate)
    if len(steps) == 2:
        rate = _measured_rate(_largest(steps[0]), _largest(steps[1]), ratios)
        converging = (
            (rate >= SETTINGS.rate_min)
            & (rate <= SETTINGS.rate_max)
            & (_alignment(*steps) >= SETTINGS.alignment_min)
        )
        claimed_rate = np.clip(rate, SETTINGS.rate_least, SETTINGS.rate)
    off = correction[0] + steps[0] / (ratios[0] ** SETTINGS.rate - 1.0)
    extrapolated = plain[0] + off
    safety = np.where(converging, SETTINGS.safety, SETTINGS.safety_outside)
    claimed = correction[0] + safety * steps[0] / (ratios[0] ** claimed_rate - 1.0)
    return DiscretisationError(
        motion=plain[0],
        extrapolated=extrapolated,
        error=np.linalg.norm(claimed, axis=1),
        relative=_largest(claimed) / _over_zero(_largest(extrapolated)),
        rate=rate,
        asymptotic=converging & (size <= SETTINGS.step_max),
        elements=tuple(elements),
    )


def force_ratio(fine: FloatArray, coarse: FloatArray) -> float:
    """Force on a coarse mesh over that on a fine one, under which they move most nearly alike.

    By least squares from the linear motions of one load on both, of any one shape.
    """
    return float(np.vdot(fine, coarse) / max(float(np.vdot(coarse, coarse)), 1e-300))


def correction_share(large: FloatArray, linear: FloatArray) -> float:
    """Share of a correction of linear motion that large displacements get, 0 … 1.

    The correction is scaled down where the shell moves less than linear theory predicts.

    Parameters
    ----------
    large, linear : (n, 3) float
        Translations by large displacements, and extrapolated by linear theory.
    """
    size = [float(np.linalg.norm(field, axis=1).max()) for field in (large, linear)]
    return min(1.0, size[0] / max(size[1], 1e-300))


def _measured_rate(fine: FloatArray, coarse: FloatArray, ratios: FloatArray) -> FloatArray:
    """Rate (m,) from the differences (m,) of three meshes, at least 0.02 and at most 8.

    Parameters
    ----------
    fine, coarse : (m,) float
        Differences of the first two, and of the last two, meshes.
    ratios : (2,) float
        Element sizes of the second over the first, and of the third over the second, mesh.
    """
    low, high = np.full(len(fine), 0.02), np.full(len(fine), 8.0)
    growth = np.log(np.maximum(coarse, 1e-300) / np.maximum(fine, 1e-300))
    first, second = np.log(ratios)
    for _ in range(50):  # bisection: the growth rises with the rate
        p = 0.5 * (low + high)
        over = p * first + np.log(np.expm1(p * second) / np.expm1(p * first)) > growth
        low, high = np.where(over, low, p), np.where(over, p, high)
    return np.asarray(0.5 * (low + high))


def _alignment(one: FloatArray, other: FloatArray) -> FloatArray:
    """Cosine (m,) of two fields (n, 3, m)."""
    lengths = np.linalg.norm(one, axis=(0, 1)) * np.linalg.norm(other, axis=(0, 1))
    return np.asarray(np.sum(one * other, axis=(0, 1)) / _over_zero(lengths))


def probed_sensor(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    centres_uv: FloatArray,
    radii_mm: FloatArray | float,
) -> ProbedShell:
    """Shell under 1 N on patches; probes are tips, the wall under them, and the patches' centres.

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
    arm = markers.tip_mm - markers.mid_mm
    return ProbedShell(
        model=model,
        loads=patch_loads(mesh, surface, centres_uv, radii_mm),
        nodes=np.concatenate([own, own, nodes]),
        weights=np.concatenate([np.full((2 * len(own), 4), 0.25), weights]),
        arm_mm=np.concatenate([arm, np.zeros((len(own) + len(nodes), 3))]),
    )


def _largest(field: FloatArray) -> FloatArray:
    """Largest length (m,) of vectors (n, 3, m)."""
    return np.asarray(np.linalg.norm(field, axis=1).max(axis=0))


def _over_zero(value: FloatArray) -> FloatArray:
    return np.where(value > 0.0, value, 1.0)
