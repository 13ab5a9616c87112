r"""One press on a sensor's shell: motion, the theory used, and estimated errors.

Linear motion is extrapolated from the mesh, one of half its element size and one of twice that
(:mod:`~phytac_design.mechanics.shell.discretisation`). The mesh itself is stiffer: with ρ the ratio
of the extrapolated to its own linear motion, by least squares, it is solved under ρ times the
force, and what the extrapolated linear motion differs from ρ times its own is added::

    u(F) = u_h(ρ F) + F (u_lin − ρ u_lin,h)
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

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
        Largest inward motion of the wall, and that at the contact's centre.
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
        Claimed error of the linear motion of tips, wall and centre because of the meshes, of the
        largest motion (:func:`discretisation.estimate_error`); None where nothing could be
        extrapolated because no other mesh holds the markers.
    resolved : bool
        Whether the meshes converge as theory has it; else the claim is several times too large.
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
    resolved: bool
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
    progress(f"press: meshes of {2 * refine}, {refine} and {refine // 2} elements a marker pitch")
    meshes = probed_meshes(
        sensor, place.uv[None], place.radius_mm, refine=refine, receptors=receptors
    )
    mesh, probed = meshes[refine]
    solution = probed.model.solve(probed.loads)
    limit = linear_limit(meshes)
    wanted = limit.extrapolated if limit else probed.read(solution.motion)
    scaled = _scaled(probed, solution.motion, wanted, place.force_N)
    check = QuasiNewtonSolver(probed.model).expand(scaled.load)
    motion, residual, end = check.first.reshape(-1, 6), 0.0, None
    large = theory == "large" or (
        theory == "auto" and LINEAR_ERROR_SAFETY * check.error > tolerance
    )
    if large:
        progress(f"press: linear is about {100 * check.error:.2g} % off; large displacements")
        end = _large_motion(probed.model, scaled.load, place)
        motion, residual = end.state.motion, end.residual
    moved = read_motion(probed, motion, large=large) + scaled.rest_mm
    mesh_error = float(limit.relative[0]) if limit else None
    if large and mesh_error is not None:
        step = _coarser_step(meshes, refine, wanted, place.force_N, moved)
        moved = moved if step is None else moved + step
        mesh_error = None if step is None else mesh_error + _claimed(step, moved)
    strain = bending_strain(mesh, motion)
    strain_limit = 0.1  # theory takes strains as small
    if large and strain > strain_limit:
        raise NumericalError(
            "strain-too-large", _beyond(place, f"the wall would strain by {100.0 * strain:.0f} %")
        )
    seconds = time.perf_counter() - start
    count = markers.count
    wall = moved[count:-1]
    tip = moved[:count]
    if large:  # A linear part that is added makes arms longer.
        arm = markers.tip_mm - markers.mid_mm
        turned = arm + tip - wall
        length = np.linalg.norm(arm, axis=1) / np.linalg.norm(turned, axis=1)
        tip = wall + length[:, None] * turned - arm
    at, shares = probed.nodes[-1], probed.weights[-1]
    middle = shares @ mesh.normals[at]
    normal = np.concatenate(
        [mesh.normals, mesh.normals[mesh.marker_nodes], middle[None] / np.linalg.norm(middle)]
    )
    points = np.concatenate([mesh.nodes_mm, markers.mid_mm, shares[None] @ mesh.nodes_mm[at]])
    inward = -np.sum(np.concatenate([motion[:, :3], moved[count:]]) * normal, axis=1)
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
        inward_mm=inward[-count - 1 : -1],
        peak_mm=float(inward[peak]),
        centre_mm=float(inward[-1]),
        peak_at_mm=points[peak],
        large=large,
        receptors=receptors,
        strain=strain,
        stable=end.stable if end else True,
        jumped=end.jumped if end else False,
        mesh_error=mesh_error,
        resolved=bool(limit.asymptotic[0]) if limit else False,
        linear_error=check.error,
        rounding=solution.error,
        residual=residual,
        seconds=seconds,
    )


class _Scaled(NamedTuple):
    """A load as a mesh needs it to move as far as the extrapolated linear motion, and the rest.

    Attributes
    ----------
    load : (6N, 1) float
        Nodal forces and moments, dense or scipy.sparse.
    rest_mm : (n, 3) float
        What the extrapolated linear motion of probes differs by then.
    """

    load: Any
    rest_mm: FloatArray


def _scaled(part: ProbedShell, motion: FloatArray, wanted: FloatArray, force_N: float) -> _Scaled:
    """Scale a force to a mesh with linear ``motion`` (N, 6, 1), by ``wanted`` of its probes."""
    own = part.read(motion)
    ratio = force_ratio(wanted, own)
    return _Scaled(
        load=force_N * ratio * part.loads,
        rest_mm=force_N * (wanted - ratio * own)[:, :, 0],
    )


def read_motion(probed: ProbedShell, motion: FloatArray, *, large: bool) -> FloatArray:
    """Translation (n, 3) of probes; arms turn with the wall, by finite rotations if ``large``."""
    if not large:
        return probed.read(motion[:, :, None])[:, :, 0]
    here = np.einsum("nk,nkd->nd", probed.weights, motion[probed.nodes])
    arm = np.zeros((len(here), 3)) if probed.arm_mm is None else probed.arm_mm
    turn = rot.deviation(rot.exponential(here[:, 3:]))
    return np.asarray(here[:, :3] + np.einsum("nij,nj->ni", turn, arm))


def _coarser_step(
    meshes: ProbedMeshes, refine: int, wanted: FloatArray, force_N: float, moved: FloatArray
) -> FloatArray | None:
    """What to add to large displacements (n, 3) of probes: extrapolated with the coarser mesh.

    None where there is no coarser mesh, or no equilibrium on it.
    """
    if refine // 2 not in meshes:
        return None
    (_, fine), (_, coarse) = meshes[refine], meshes[refine // 2]
    scaled = _scaled(coarse, coarse.model.solve(coarse.loads).motion, wanted, force_N)
    try:
        motion = solve_large(coarse.model, scaled.load)[0].state.motion
    except NumericalError:
        return None
    step = moved - read_motion(coarse, motion, large=True) - scaled.rest_mm
    return step / (len(fine.model.quads) / len(coarse.model.quads) - 1.0)


def _claimed(step: FloatArray, moved: FloatArray) -> float:
    """Claimed error of large displacements besides the linear ones, by two meshes."""
    largest = np.linalg.norm(moved, axis=1).max()
    safety = discretisation.SETTINGS.safety_outside
    return safety * float(np.linalg.norm(step, axis=1).max() / largest)


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
    out: ProbedMeshes = {}
    elements = np.inf
    for level in (2 * refine, refine, refine // 2):
        try:
            mesh = marker_mesh(
                surface, markers, thickness_mm=design.wall.thickness_mm, refine=level
            )
        except DesignError:  # no such mesh holds the markers
            if level == refine:
                raise
            continue
        if elements < discretisation.SETTINGS.min_size_ratio**2 * len(mesh.quads):
            if level == refine:
                out.clear()
            else:
                continue
        model = sensor_model(design, markers, mesh, receptors=receptors)
        part = probed_sensor(model, mesh, surface, markers, centres_uv, radii_mm)
        out[level], elements = (mesh, part), len(mesh.quads)
    return out


def linear_limit(meshes: ProbedMeshes) -> DiscretisationError | None:
    """Linear motion on elements of size 0, extrapolated from meshes; None of a single one."""
    if len(meshes) == 1:
        return None
    return estimate_error(lambda level: meshes[level][1], tuple(meshes))


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
