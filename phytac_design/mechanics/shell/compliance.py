"""How markers move under unit forces: everything the decoder needs of the shell."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.layout import Markers
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import ShellModel, Solution
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class MarkerCompliance:
    """Motion of every marker per unit inward force at every marker.

    Attributes
    ----------
    motion : (n, 6, m) float
        Translation (mm) and rotation (rad), global axes, of the middle face at each of n markers
        per 1 N pressed inward, spread over a disc at each of m = n markers.
    load_radius_mm : float
        Radius of that disc.
    solves : int
        Right-hand sides really solved; fewer than m where the shell repeats itself around.
    error : float
        Rounding error of the solution (:class:`solve.Solution`).
    """

    motion: FloatArray
    load_radius_mm: float
    solves: int
    error: float


def marker_compliance(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    *,
    load_radius_mm: float,
    use_symmetry: bool = True,
) -> MarkerCompliance:
    """Compliance of all markers by one factorisation.

    Where mesh and stiffness map onto themselves when turned by one column (checked, not assumed)
    only the loads of column 0 are solved and the others follow by rotation.

    Parameters
    ----------
    model, mesh : ShellModel, ShellMesh
        The shell and its mesh; the mesh must be aligned with the markers.
    surface, markers : Surface, Markers
        The outer face and the receptors on it.
    load_radius_mm : float
        Radius of the disc that the unit force is spread over; 0 for a point force (never
        converges with the mesh; compare patches).
    use_symmetry : bool
        False solves every load.

    Raises
    ------
    NumericalError
        If the mesh is not aligned with these markers, or the solve fails.
    """
    if len(mesh.marker_nodes) != markers.count:
        raise NumericalError(
            "mesh-marker-count",
            f"the mesh has {len(mesh.marker_nodes)} marker nodes for {markers.count} markers; "
            "make it with marker_mesh from the same markers",
        )
    columns = markers.lattice.columns if markers.lattice else 1
    turn = column_turn(model, mesh, columns) if use_symmetry else None
    wanted = np.arange(markers.count) if turn is None else np.flatnonzero(markers.column == 0)
    loads = patch_loads(mesh, surface, markers.uv[wanted], load_radius_mm)
    solution = model.solve(loads)
    motion = solution.motion[mesh.marker_nodes]
    if turn is not None:
        motion = _spread_around(motion, turn, columns)
    return MarkerCompliance(
        motion=motion, load_radius_mm=load_radius_mm, solves=len(wanted), error=solution.error
    )


def probe_motion(mesh: ShellMesh, solution: Solution, uv: FloatArray) -> FloatArray:
    """Translation and rotation (n, 6, m) at chart positions ``uv`` (n, 2), bilinear in the chart.

    For markers on a mesh that is not aligned with them.
    """
    nodes, weights = locate(mesh, uv)
    out = np.zeros((len(nodes), *solution.motion.shape[1:]))
    for corner in range(4):
        out += weights[:, corner, None, None] * solution.motion[nodes[:, corner]]
    return out


def probe_loads(
    model: ShellModel, mesh: ShellMesh, loads: Any, uv: FloatArray, *, batch: int = 256
) -> FloatArray:
    """Motion (n, 6, m) at chart positions ``uv`` (n, 2) under many loads (6N, m).

    The same as :meth:`ShellModel.solve` and :func:`probe_motion`, ``batch`` loads at a time, so
    that the memory does not grow with the whole mesh times all loads.
    """
    parts = [
        probe_motion(mesh, model.solve(loads[:, first : first + batch]), uv)
        for first in range(0, loads.shape[1], batch)
    ]
    return np.concatenate([np.zeros((len(uv), 6, 0)), *parts], axis=2)


def point_motion(motion: FloatArray, arm: FloatArray) -> FloatArray:
    """Translation of points that stand off the shell rigidly: u + θ × arm.

    Parameters
    ----------
    motion : (n, 6, m) float
        Motion of the middle face, mm and rad.
    arm : (n, 3) float
        From the middle face to the point, mm, e.g. ``markers.tip_mm - markers.mid_mm``.

    Returns
    -------
    (n, 3, m) float
        mm.
    """
    return np.asarray(motion[:, :3] + np.cross(motion[:, 3:], arm[:, :, None], axis=1))


def column_turn(model: ShellModel, mesh: ShellMesh, columns: int) -> FloatArray | None:
    """Rotation (3, 3) by one column if shell and supports repeat themselves under it, else None."""
    around = mesh.around
    if columns < 2 or around is None or around % columns:
        return None
    if len(mesh.nodes_mm) % around or len(mesh.quads) % around:
        return None
    angle = 2.0 * np.pi / columns
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    image = _shifted(len(mesh.nodes_mm), around, around // columns)
    landed = _shifted(len(mesh.quads), around, around // columns)
    # Largest misfit of mesh or section turned onto itself, as a fraction of its size.
    tolerance = 1e-9
    gap = np.abs(mesh.nodes_mm @ turn.T - mesh.nodes_mm[image]).max()
    lean = np.abs(mesh.normals @ turn.T - mesh.normals[image]).max()
    alike = (
        gap <= tolerance * np.abs(mesh.nodes_mm).max()
        and lean <= tolerance
        and np.array_equal(model.fixed, model.fixed[image])
        and np.array_equal(np.sort(image[mesh.quads]), np.sort(mesh.quads[landed]))
        and all(
            _repeats(part, landed, tolerance) for part in (model.thickness_mm, model.modulus_MPa)
        )
    )
    return turn if alike else None


def turns_of(model: ShellModel, mesh: ShellMesh, columns: int) -> tuple[int, FloatArray | None]:
    """Sectors that shell and supports repeat themselves in, and the turn (3, 3) to the next.

    The greatest divisor of ``columns`` that will do: all columns on a cylinder, four on a square
    box; 1 and None where none does.
    """
    for sectors in range(columns, 1, -1):
        if columns % sectors == 0:
            turn = column_turn(model, mesh, sectors)
            if turn is not None:
                return sectors, turn
    return 1, None


def _repeats(value: float | FloatArray, landed: IntArray, tolerance: float) -> bool:
    """Whether a section, one or one per element, is the same where each element lands."""
    section = np.broadcast_to(np.asarray(value, dtype=np.float64), len(landed))
    return bool(np.abs(section[landed] - section).max() <= tolerance * section.max())


def _shifted(count: int, around: int, step: int) -> IntArray:
    """Node (or element) that each lands on when its line of ``around`` turns by ``step``."""
    line, place = np.divmod(np.arange(count), around)
    return np.asarray(line * around + np.mod(place + step, around))


def _spread_around(motion: FloatArray, turn: FloatArray, columns: int) -> FloatArray:
    """Motion (n, 6, n) under all loads from that under the loads of column 0, (n, 6, rows)."""
    rows = motion.shape[2]
    base = motion.reshape(rows, columns, 2, 3, rows)
    out = np.zeros((rows, columns, 2, 3, rows, columns))
    for k in range(columns):
        power = np.linalg.matrix_power(turn, k)
        turned = np.einsum("xy,rcayl->rcaxl", power, base)
        out[..., k] = np.roll(turned, k, axis=1)
    return out.reshape(rows * columns, 6, rows * columns)
