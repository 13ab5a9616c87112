r"""One press on a sensor's shell: motion, the theory used, and estimated errors.

Linear motion is extrapolated from the mesh and one of half its element size; one of twice its size
shows how they converge (:mod:`~phytac_design.mechanics.shell.discretisation`). A mesh is stiffer:
with ρ the ratio of the extrapolated to its own linear motion, by least squares, it is solved under
ρ times the force, and the difference of the linear motions is added::

    u(F) = u_h(ρ F) + F (u_lin − ρ u_lin,h)

The last term is scaled down where the shell moves less than linear theory predicts. Large
displacements are solved like this on the mesh and on the coarser one, and extrapolated from both.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Equilibrium
from phytac_design.mechanics.large.quasi_newton import LINEAR_ERROR_SAFETY, QuasiNewtonSolver
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.pressing.contact_patch import ContactPatch
from phytac_design.mechanics.shell import discretisation
from phytac_design.mechanics.shell.discretisation import (
    DiscretisationError,
    ProbedShell,
    correction_share,
    estimate_error,
    force_ratio,
    probed_sensor,
)
from phytac_design.mechanics.shell.mesh_writers import write_vtu
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError, OutputError

Theory = Literal["auto", "linear", "large"]
ProbedMeshes = dict[int, tuple[ShellMesh, ProbedShell]]
"""Meshes of one shell by elements per marker pitch, the finest first."""


@dataclass(frozen=True, kw_only=True)
class Press:
    """What one press moves.

    Attributes
    ----------
    place : Place
        The contact patch.
    mesh : ShellMesh
        Mesh of the middle face.
    motion : (N, 6) float
        Translation (mm) and rotation (rad; a rotation vector if ``large``) of every node, on the
        mesh under the scaled force.
    tip_mm, wall_mm : (n, 3) float
        Motion of the middle of every receptor's end face, and of the middle face under it, mm.
    tip_px : (n, 2) float or None
        The same in the camera's pixels; None where the design's camera cannot be placed.
    near : (k,) int
        Markers nearest the contact, nearest first, and
    distance_mm : (k,) float
        their distance from it on the outer face (chord).
    inward_mm : (n,) float
        Motion of the wall under every marker along its own inward normal.
    peak_mm, centre_mm : float
        Largest inward motion of the wall under receptors and the contact's centre, and the latter.
    peak_at_mm : (3,) float
        Where the largest is, on the middle face.
    large, receptors : bool
        Whether large displacements and the receptors' stiffness were used.
    strain : float
        Largest bending strain of the wall's faces (:func:`bending_strain`).
    stable : bool or None
        Whether the shell stays there under the load; None if that is unknown.
    jumped : bool
        Whether the shell snapped, or may have, under the load (:class:`newton.Equilibrium`).
    mesh_error : float or None
        Claimed error of tips, wall and centre because of the meshes, of the largest motion
        (:func:`discretisation.estimate_error`); None where it is not known, because no other mesh
        holds the markers, or a large displacement is not found on a coarser one.
    linear_error : float
        How far linear theory is off, estimated (:class:`estimate.LinearCheck`).
    rounding : float
        Rounding error of the linear solution (:class:`solve.Solution`).
    residual : float
        Unbalanced over nodal forces of the large-displacement solution; 0 for a linear one.
    seconds : float
        Wall time of mesh and solution.
    """

    place: ContactPatch
    mesh: ShellMesh
    motion: FloatArray
    tip_mm: FloatArray
    wall_mm: FloatArray
    tip_px: FloatArray | None
    near: Any
    distance_mm: FloatArray
    inward_mm: FloatArray
    peak_mm: float
    centre_mm: float
    peak_at_mm: FloatArray
    large: bool
    receptors: bool
    strain: float
    stable: bool | None
    jumped: bool
    mesh_error: float | None
    linear_error: float
    rounding: float
    residual: float
    seconds: float


def press(
    sensor: Sensor,
    place: ContactPatch,
    *,
    theory: Theory = "auto",
    tolerance: float = 0.05,
    refine: int = 4,
    receptors: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Press:
    """Press on a sensor's shell with clamped rims.

    Parameters
    ----------
    sensor : Sensor
        The design with its surface and markers.
    place : ContactPatch
        Where, how wide, how hard.
    theory : str
        ``linear``, ``large``, or ``auto``: large displacements where linear theory is estimated to
        be off by more than ``tolerance``.
    tolerance : float
        Accepted error of linear theory, as a fraction.
    refine : int
        Elements per marker pitch around.
    receptors : bool
        Whether the wall has the stiffness of its receptor tubes and holes.
    progress : callable
        Called with a line about what is being done.

    Raises
    ------
    DesignError
        If an option is unknown or out of range, or the receptors' stiffness is not known.
    NumericalError
        If there is no equilibrium under this force, or the solution is not to be trusted.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    if theory not in get_args(Theory):
        raise DesignError(
            "theory-unknown", f"theory is one of {', '.join(get_args(Theory))} (got {theory!r})"
        )
    if not 0.0 < tolerance < np.inf:
        raise DesignError("tolerance-invalid", f"the tolerance must be positive (got {tolerance})")
    start = time.perf_counter()
    progress("press: making meshes")
    meshes = probed_meshes(
        sensor, place.uv[None], place.radius_mm, refine=refine, receptors=receptors
    )
    counts = ", ".join(f"{level}" for level in meshes)
    progress(f"press: linear, on meshes of {counts} elements a marker pitch")
    mesh, probed = meshes[refine]
    limit = linear_limit(meshes)
    linear = limit.extrapolated if limit else probed.read(probed.model.solve(probed.loads).motion)
    scaled = _ScaledPress(probed, place.force_N, linear)
    check = QuasiNewtonSolver(probed.model).expand(scaled.load)
    motion, residual, end = check.first.reshape(-1, 6), 0.0, None
    large = theory == "large" or (
        theory == "auto" and LINEAR_ERROR_SAFETY * check.error > tolerance
    )
    if large:
        progress(f"press: linear is about {100 * check.error:.2g} % off; large displacements")
        end = _large_motion(probed.model, scaled.load, place)
        motion, residual = end.state.motion, end.residual
    moved = scaled.moved(motion, large=large)
    mesh_error = float(limit.relative[0]) if limit else None
    if end and mesh_error is not None:
        moved, beyond = _extrapolated_large(meshes, refine, scaled, end, moved)
        mesh_error = None if beyond is None else mesh_error + beyond
    strain = bending_strain(mesh, motion)
    strain_limit = 0.1  # theory takes strains as small
    if large and strain > strain_limit:
        raise NumericalError(
            "strain-too-large", _beyond(place, f"the wall would strain by {100.0 * strain:.0f} %")
        )
    seconds = time.perf_counter() - start
    count = markers.count
    tip, wall = moved[:count], moved[count:-1]
    if large:  # What is added to rotated arms makes them longer.
        arm = markers.tip_mm - markers.mid_mm
        turned = arm + tip - wall
        length = np.linalg.norm(arm, axis=1) / np.linalg.norm(turned, axis=1)
        tip = wall + length[:, None] * turned - arm
    at, shares = probed.nodes[-1], probed.weights[-1]
    middle = shares @ mesh.normals[at]
    normal = np.vstack([mesh.normals[mesh.marker_nodes], middle / np.linalg.norm(middle)])
    points = np.vstack([markers.mid_mm, shares @ mesh.nodes_mm[at]])
    inward = -np.sum(moved[count:] * normal, axis=1)
    peak = int(np.argmax(inward))
    away = np.linalg.norm(surface.point(markers.uv) - surface.point(place.uv[None]), axis=1)
    near = np.argsort(away, kind="stable")[:9]  # a receptor and its neighbours
    return Press(
        place=place,
        mesh=mesh,
        motion=motion,
        tip_mm=tip,
        wall_mm=wall,
        tip_px=_pixels(design, surface, markers.tip_mm, tip),
        near=near,
        distance_mm=away[near],
        inward_mm=inward[:-1],
        peak_mm=float(inward[peak]),
        centre_mm=float(inward[-1]),
        peak_at_mm=points[peak],
        large=large,
        receptors=receptors,
        strain=strain,
        stable=end.stable if end else True,
        jumped=end.jumped if end else False,
        mesh_error=mesh_error,
        linear_error=check.error,
        rounding=scaled.rounding,
        residual=residual,
        seconds=seconds,
    )


class _ScaledPress:
    """A press on one mesh, under a force scaled to it.

    Parameters
    ----------
    part : ProbedShell
        The shell on this mesh, under 1 N.
    force_N : float
        The force.
    linear : (n, 3, 1) float
        Extrapolated linear motion of the probes under 1 N, mm.

    Attributes
    ----------
    load : (6N, 1) float
        Under which this mesh moves as far by linear theory, dense or scipy.sparse.
    rounding : float
        Rounding error of its linear solution.
    """

    def __init__(self, part: ProbedShell, force_N: float, linear: FloatArray) -> None:
        solution = part.model.solve(part.loads)
        own = part.read(solution.motion)
        ratio = force_ratio(linear, own)
        self.part, self.force_N, self.linear = part, force_N, linear
        self.load: Any = force_N * ratio * part.loads
        self.rounding = solution.error
        self._rest_mm = force_N * (linear - ratio * own)[:, :, 0]

    def moved(self, motion: FloatArray, *, large: bool) -> FloatArray:
        """Translation (n, 3) of the probes by the motion (N, 6) under ``load``.

        The difference of the extrapolated linear motion to this mesh's is added, scaled down where
        the shell moves less than linear theory predicts.
        """
        found = read_motion(self.part, motion, large=large)
        share = correction_share(found, self.force_N * self.linear[:, :, 0])
        return found + share * self._rest_mm


def read_motion(probed: ProbedShell, motion: FloatArray, *, large: bool) -> FloatArray:
    """Translation (n, 3) of probes; arms turn with the wall, by finite rotations if ``large``."""
    if not large:
        return probed.read(motion[:, :, None])[:, :, 0]
    here = np.einsum("nk,nkd->nd", probed.weights, motion[probed.nodes])
    arm = np.zeros((len(here), 3)) if probed.arm_mm is None else probed.arm_mm
    turn = rot.deviation(rot.exponential(here[:, 3:]))
    return np.asarray(here[:, :3] + np.einsum("nij,nj->ni", turn, arm))


def _extrapolated_large(
    meshes: ProbedMeshes, refine: int, own: _ScaledPress, end: Equilibrium, moved: FloatArray
) -> tuple[FloatArray, float | None]:
    """Large displacements (n, 3) of probes, extrapolated with the coarser mesh, and their error.

    The error is claimed besides that of linear motion, of the largest motion; None where there is
    no coarser mesh, or no equilibrium on it. Nothing is added where the meshes differ much, or one
    of them snaps and the other does not: they do not converge to one limit yet.
    """
    coarser = [part for other, (_, part) in meshes.items() if other < refine]
    if not coarser:
        return moved, None
    other = _ScaledPress(coarser[0], own.force_N, own.linear)
    try:
        found = solve_large(other.part.model, other.load)[0]
    except NumericalError:
        return moved, None
    ratio = len(own.part.model.quads) / len(other.part.model.quads)
    step = (moved - other.moved(found.state.motion, large=True)) / (ratio - 1.0)
    settings = discretisation.SETTINGS
    alike = (found.jumped, found.stable) == (end.jumped, end.stable)
    if alike and _largest(step) <= settings.step_max * _largest(moved):
        moved = moved + step
    return moved, settings.safety_outside * _largest(step) / _largest(moved)


def _largest(field: FloatArray) -> float:
    return float(np.linalg.norm(field, axis=1).max())


def _large_motion(model: ShellModel, load: Any, place: ContactPatch) -> Equilibrium:
    try:
        return solve_large(model, load)[0]
    except NumericalError as error:
        raise NumericalError(
            "press-no-equilibrium", _beyond(place, f"no equilibrium is found ({error})")
        ) from error


def probed_meshes(
    sensor: Sensor,
    centres_uv: FloatArray,
    radii_mm: FloatArray | float,
    *,
    refine: int,
    receptors: bool,
) -> ProbedMeshes:
    """Shell under 1 N on patches on a mesh, and on its finer and coarser one where they can be.

    Parameters
    ----------
    sensor : Sensor
        The design with its surface and markers.
    centres_uv, radii_mm : (m, 2) float, float or (m,) float
        Patches.
    refine : int
        Elements per marker pitch of the mesh; the finer one has twice, the coarser half as many.
    receptors : bool
        Whether the wall has the stiffness of its receptor tubes and holes.

    Returns
    -------
    dict
        Mesh and shell by elements per pitch, the finest first; probes are the tips, the wall under
        them and the patches' centres (:func:`discretisation.probed_sensor`).

    Raises
    ------
    DesignError
        If no mesh of ``refine`` holds the markers, or the receptors' stiffness is not known.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers

    def made(level: int) -> tuple[ShellMesh, ProbedShell]:
        mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=level)
        model = sensor_model(design, markers, mesh, receptors=receptors)
        return mesh, probed_sensor(model, mesh, surface, markers, centres_uv, radii_mm)

    out = {refine: made(refine)}
    count = len(out[refine][0].quads)
    least = discretisation.SETTINGS.min_size_ratio**2
    for levels, finer in (((2 * refine,), True), (range(refine // 2, 0, -1), False)):
        for level in levels:
            try:
                other = made(level)
            except (DesignError, NumericalError):  # it holds no markers, or is too irregular
                continue
            quads = len(other[0].quads)
            if max(quads, count) >= least * min(quads, count) and (quads > count) == finer:
                out[level] = other
                break
    return dict(sorted(out.items(), reverse=True))


def linear_limit(meshes: ProbedMeshes) -> DiscretisationError | None:
    """Linear motion on elements of size 0, extrapolated from meshes.

    None where there is a single mesh, or one of them cannot be solved to the accuracy of rounding.
    """
    if len(meshes) == 1:
        return None
    try:
        return estimate_error(lambda level: meshes[level][1], tuple(meshes))
    except NumericalError:
        return None


def _beyond(place: ContactPatch, what: str) -> str:
    return (
        f"{place.force_N:g} N on a disc of {place.radius_mm:g} mm is more than this shell carries: "
        f"{what}; press with less force, on a wider disc, or make the wall thicker"
    )


def bending_strain(mesh: ShellMesh, motion: FloatArray) -> float:
    """Largest strain of the wall's faces by bending, t/2 times the turn per length of an edge.

    Turns about the normal do not bend. Of the order of the true peak, which a mesh smooths.
    """
    edge = np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    turn = rot.exponential(motion[:, 3:])
    bent = rot.logarithm(rot.product(turn[edge[:, 1]], rot.inverse(turn[edge[:, 0]])))
    normal = mesh.normals[edge[:, 0]]
    bent = bent - np.sum(bent * normal, axis=1, keepdims=True) * normal
    length = np.linalg.norm(np.diff(mesh.nodes_mm[edge], axis=1)[:, 0], axis=1)
    return float((np.linalg.norm(bent, axis=1) / length).max() * mesh.thickness_mm / 2.0)


def write_press(path: Path, result: Press) -> Path:
    """Write the moved mesh as a VTK file.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    try:
        return write_vtu(path, result.mesh, motion=result.motion)
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {path}: {error.strerror}; choose another file"
        ) from None


def _pixels(
    design: Design, surface: Surface, tip_mm: FloatArray, moved_mm: FloatArray
) -> FloatArray | None:
    """Motion of tips (n, 3) in the camera's image, (n, 2) px."""
    from phytac_design.layout.cameras import camera_of

    try:
        camera = camera_of(design, surface)
    except DesignError:  # `phytac check` reports why; the mechanics do not need a camera
        return None
    return np.asarray(camera.project(tip_mm + moved_mm) - camera.project(tip_mm))
