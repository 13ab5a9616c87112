"""Linear response of the markers' paint to patches of force, by the adjoint of each marker.

One solve for each marker and direction gives the response to *any* contact as an inner product,
so the cost is that of the markers, not of the contacts. Fewer contacts than that are solved one
by one.
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from phytac_design.layout import Markers
from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.compliance import column_turn, marker_compliance, probe_loads
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.condense import Condensed, condense
from phytac_design.simulation.contacts import Contacts
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray


def motion_probe(mesh: ShellMesh, uv: FloatArray) -> csr_matrix:
    """Rows of (u, θ) at chart positions ``uv`` (n, 2), bilinear in the chart, (6n, 6N)."""
    nodes, weights = locate(mesh, uv)
    dof = np.arange(6)
    row = 6 * np.arange(len(nodes))[:, None, None] + dof
    column = 6 * nodes[:, :, None] + dof
    value = np.broadcast_to(weights[:, :, None], column.shape)
    row = np.broadcast_to(row, column.shape)
    shape = (6 * len(nodes), 6 * len(mesh.nodes_mm))
    return csr_matrix((value.ravel(), (row.ravel(), column.ravel())), shape=shape)


def motion_responses(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    *,
    uv: FloatArray,
    radius_mm: FloatArray,
    batch: int = 96,
    progress: Callable[[str], None] = lambda _: None,
) -> FloatArray:
    """Motion of every marker per newton of each patch, (c, n, 6): translation mm, rotation rad.

    Where the shell repeats itself around (checked), only the adjoints of column 0 are solved and
    turned: d_k(f) = R^k d_0(R^-k f). Contacts that are fewer than the adjoints are solved instead.

    Parameters
    ----------
    model, mesh : ShellModel, ShellMesh
        The shell.
    uv : (c, 2) float
        Patch centres.
    radius_mm : (c,) float
        Patch radii.
    batch : int
        Right-hand sides solved together: bounds the memory.
    """
    columns = markers.lattice.columns if markers.lattice else 1
    turn = column_turn(model, mesh, columns)
    base = np.arange(markers.count) if turn is None else np.flatnonzero(markers.column == 0)
    loads = patch_loads(mesh, surface, uv, radius_mm)
    if len(uv) < 6 * len(base):
        return np.moveaxis(probe_loads(model, mesh, loads, markers.uv, batch=batch), 2, 0)
    adjoints = _adjoints(model, motion_probe(mesh, markers.uv[base]), batch, progress)
    patches = loads.T.tocsr()
    if turn is None:
        # All adjoints at once would fill the memory: 11 GB for 2000 markers.
        parts = [np.asarray(patches @ adjoint) for adjoint in adjoints]
        return np.concatenate(parts, axis=1).reshape(len(uv), markers.count, 6)
    adjoint = np.concatenate(list(adjoints), axis=1)
    around = mesh.around or 1
    # The few loads of a patch are turned, not the adjoints: vectors, node after node around.
    vectors = patches.tobsr((1, 3))
    place = np.arange(adjoint.shape[0] // 3).reshape(-1, around, 2)
    out = np.empty((len(uv), markers.count // columns, columns, 2, 3))
    for k in range(columns):
        power = np.linalg.matrix_power(turn, k)
        back = np.roll(place, k * around // columns, axis=1).ravel()[vectors.indices]
        turned = bsr_matrix((vectors.data @ power, back, vectors.indptr), shape=vectors.shape)
        response = np.asarray(turned.tocsr() @ adjoint)
        out[:, :, k] = response.reshape(len(uv), -1, 2, 3) @ power.T
    return out.reshape(len(uv), markers.count, 6)


def _adjoints(
    model: ShellModel, probe: csr_matrix, batch: int, progress: Callable[[str], None]
) -> Iterator[FloatArray]:
    """Shell motion (6N, r) under the unit load of each of r probe rows, ``batch`` at a time."""
    for first in range(0, probe.shape[0], batch):
        last = min(first + batch, probe.shape[0])
        yield model.solve(probe[first:last].T).motion.reshape(probe.shape[1], -1)
        progress(f"response: {last} of {probe.shape[0]} adjoint loads")


def point_motions(motion: FloatArray, arm_mm: FloatArray) -> FloatArray:
    """Translation u + θ x arm of body-fixed points, (…, n, 3) mm, for motion (…, n, 6)."""
    return np.asarray(motion[..., :3] + np.cross(motion[..., 3:], arm_mm))


def turned_points(motion: FloatArray, arm_mm: FloatArray) -> FloatArray:
    """Translation u + (R − 1)·arm of body-fixed points, (…, n, 3) mm, for motion (…, n, 6).

    Motion holds translations (mm) and rotation vectors (rad) of any size. Linear motion, whose
    rotations are infinitesimal, goes with :func:`point_motions`.
    """
    turn = rot.deviation(rot.exponential(motion[..., 3:]))
    return np.asarray(motion[..., :3] + (turn @ arm_mm[..., None])[..., 0])


def rigid_slope(slope: FloatArray, arm_mm: FloatArray) -> FloatArray:
    """Derivative (n, 2, 6) of body-fixed points' images by (u, θ), of that by the points (n, 2, 3).

    The linear part of :func:`point_motions`: θ moves a point by θ x arm.
    """
    turn = np.cross(arm_mm[:, None], slope)
    return np.concatenate([slope, turn], axis=2)


def superpose(responses: FloatArray, contacts: Contacts) -> FloatArray:
    """Linear sum over the contacts of each sample, (samples, n, 6), of (c, n, 6) per newton."""
    out = np.zeros((contacts.samples, *responses.shape[1:]))
    np.add.at(out, contacts.sample, contacts.force_N[:, None, None] * responses)
    return out


def pressed_motion(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    *,
    pressed: IntArray,
    radius_mm: float,
) -> FloatArray:
    """Motion (n, 6, k) of every marker per newton on each of k ``pressed`` markers' cells.

    As :func:`mechanics.compliance.marker_compliance`, of some markers: no more loads are solved
    than those, nor than one column's where the shell repeats itself around.
    """
    columns = markers.lattice.columns if markers.lattice else 1
    if len(pressed) == markers.count or column_turn(model, mesh, columns) is not None:
        whole = marker_compliance(model, mesh, surface, markers, load_radius_mm=radius_mm)
        return whole.motion if len(pressed) == markers.count else whole.motion[:, :, pressed]
    loads = patch_loads(mesh, surface, markers.uv[pressed], radius_mm)
    return np.asarray(model.solve(loads).motion[mesh.marker_nodes])


def condense_pressed(
    slope: FloatArray, *, normal: FloatArray, motion: FloatArray, pressed: IntArray
) -> Condensed:
    """Condense motion (n, 6, k) under forces on k markers; what says nothing of the others is 0.

    K then counts the others as load-free, which they are; see :func:`condense.condense`.

    Raises
    ------
    NumericalError
        As :func:`condense.condense`.
    """
    count = len(slope)
    part = condense(slope[pressed], normal=normal[pressed], motion=motion[pressed])
    if len(pressed) == count:
        return part
    compliance = np.zeros((count, 2, count))
    compliance[:, :, pressed] = np.einsum("nij,njm->nim", slope, motion)
    shift_to_mm, sensitivity = np.zeros((count, 2)), np.zeros(count)
    shift_to_mm[pressed], sensitivity[pressed] = part.shift_to_mm, part.sensitivity_px_mm
    stiffness = np.zeros((count, count))
    stiffness[np.ix_(pressed, pressed)] = part.stiffness
    return Condensed(
        shift_to_mm=shift_to_mm,
        compliance_px=compliance.reshape(2 * count, count),
        stiffness=stiffness,
        condition=part.condition,
        sensitivity_px_mm=sensitivity,
    )
