"""One press on a sensor's shell: motion, the theory used, and estimated errors."""

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
from phytac_design.mechanics.shell.compliance import point_motion
from phytac_design.mechanics.shell.discretisation import (
    ProbedShell,
    estimate_error,
    probed_sensor,
)
from phytac_design.mechanics.shell.mesh_writers import write_vtu
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError, OutputError

Theory = Literal["auto", "linear", "large"]


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
        Translation (mm) and rotation (rad; a rotation vector if ``large``) of every node.
    tip_mm : (n, 3) float
        Motion of the middle of every receptor's end face, mm.
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
        Estimated error of tips and centre because of the mesh, of the largest motion, linear
        (:func:`discretisation.estimate_error`); None where no mesh is enough coarser.
    resolved : bool
        Whether that is an estimate; else it is a bound, a few times too large.
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
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=refine)
    progress(f"press: {6 * len(mesh.nodes_mm)} unknowns, linear")
    model = sensor_model(design, markers, mesh, receptors=receptors)
    probed = probed_sensor(model, mesh, surface, markers, place.uv[None], place.radius_mm)
    load = place.force_N * probed.loads
    check = QuasiNewtonSolver(model).expand(load)
    motion, residual, end = check.first.reshape(-1, 6), 0.0, None
    large = theory == "large" or (
        theory == "auto" and LINEAR_ERROR_SAFETY * check.error > tolerance
    )
    if large:
        progress(f"press: linear is about {100 * check.error:.2g} % off; large displacements")
        end = _large_motion(model, load, place)
        motion, residual = end.state.motion, end.residual
    rounding = model.solve(probed.loads).error
    progress("press: error of the mesh")
    mesh_error, resolved = _mesh_error(sensor, place, probed, refine, receptors=receptors)
    strain = bending_strain(mesh, motion)
    strain_limit = 0.1  # theory takes strains as small
    if large and strain > strain_limit:
        raise NumericalError(
            "strain-too-large", _beyond(place, f"the wall would strain by {100.0 * strain:.0f} %")
        )
    seconds = time.perf_counter() - start
    arm = markers.tip_mm - markers.mid_mm
    at = motion[mesh.marker_nodes]
    if large:
        turn = rot.deviation(rot.exponential(at[:, 3:]))
        tip = at[:, :3] + np.einsum("nij,nj->ni", turn, arm)
    else:
        tip = point_motion(at[:, :, None], arm)[:, :, 0]
    inward = -np.sum(motion[:, :3] * mesh.normals, axis=1)
    peak = int(np.argmax(inward))
    centre = (probed.nodes[-1], probed.weights[-1])
    away = np.linalg.norm(surface.point(markers.uv) - surface.point(place.uv[None]), axis=1)
    near = np.argsort(away, kind="stable")[:9]  # a receptor and its neighbours
    return Press(
        place=place,
        mesh=mesh,
        motion=motion,
        tip_mm=tip,
        tip_px=_pixels(design, surface, markers.tip_mm, tip),
        near=near,
        distance_mm=away[near],
        inward_mm=inward[mesh.marker_nodes],
        peak_mm=float(inward[peak]),
        centre_mm=float(inward[centre[0]] @ centre[1]),
        peak_at_mm=mesh.nodes_mm[peak],
        large=large,
        receptors=receptors,
        strain=strain,
        stable=end.stable if end else True,
        jumped=end.jumped if end else False,
        mesh_error=mesh_error,
        resolved=resolved,
        linear_error=check.error,
        rounding=rounding,
        residual=residual,
        seconds=seconds,
    )


def _large_motion(model: ShellModel, load: Any, place: ContactPatch) -> Equilibrium:
    try:
        return solve_large(model, load)[0]
    except NumericalError as error:
        raise NumericalError(
            "press-no-equilibrium", _beyond(place, f"no equilibrium is found ({error})")
        ) from error


def _mesh_error(
    sensor: Sensor, place: ContactPatch, fine: ProbedShell, refine: int, *, receptors: bool
) -> tuple[float | None, bool]:
    """Error by meshes of about a half and a quarter of the elements along each side.

    Returns the error, None where no mesh is enough coarser, and whether it is an estimate.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    wall = design.wall.thickness_mm
    parts, elements = {refine: fine}, len(fine.model.quads)
    for level in (refine // 2, refine // 4):
        try:
            mesh = marker_mesh(surface, markers, thickness_mm=wall, refine=level)
        except DesignError:  # no coarser mesh holds the markers
            break
        if elements < discretisation.SETTINGS.min_size_ratio**2 * len(mesh.quads):
            break
        model = sensor_model(design, markers, mesh, receptors=receptors)
        parts[level] = probed_sensor(model, mesh, surface, markers, place.uv[None], place.radius_mm)
        elements = len(mesh.quads)
    if len(parts) == 1:
        return None, False
    found = estimate_error(parts.__getitem__, tuple(parts))
    return float(found.relative[0]), bool(found.asymptotic[0])


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
