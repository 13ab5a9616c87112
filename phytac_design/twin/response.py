"""Linear response of the markers' paint to patches of force, by the adjoint of each marker.

One solve for each marker and direction gives the response to *any* contact as an inner product,
so the cost is that of the markers, not of the contacts.
"""

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix

from phytac_design.layout import Markers
from phytac_design.mechanics.loads import patch_loads
from phytac_design.mechanics.locate import locate
from phytac_design.mechanics.mesh import ShellMesh
from phytac_design.mechanics.solve import ShellModel
from phytac_design.twin.contacts import Contacts
from shapes import Surface
from shapes.arrays import FloatArray

CHUNK = 96
"""Right-hand sides solved together: bounds the memory."""


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


def point_probe(motion_probe: csr_matrix, arm_mm: FloatArray) -> csr_matrix:
    """Rows of the translation u + θ x arm of body-fixed points, (3n, 6N).

    Parameters
    ----------
    motion_probe : (6n, 6N) sparse
        Rows of (u, θ) at each marker.
    arm_mm : (n, 3) float
        From the marker's place on the middle face to the point.
    """
    count = len(arm_mm)
    x, y, z = arm_mm.T
    zero, one = np.zeros(count), np.ones(count)
    # θ × r = (θy·rz − θz·ry, θz·rx − θx·rz, θx·ry − θy·rx)
    blocks = np.stack(
        [
            np.stack([one, zero, zero, zero, z, -y], axis=1),
            np.stack([zero, one, zero, -z, zero, x], axis=1),
            np.stack([zero, zero, one, y, -x, zero], axis=1),
        ],
        axis=1,
    )
    row = np.repeat(np.arange(3 * count), 6)
    column = np.broadcast_to(6 * np.arange(count)[:, None, None] + np.arange(6), blocks.shape)
    combine = csr_matrix((blocks.ravel(), (row, column.ravel())), shape=(3 * count, 6 * count))
    return combine @ motion_probe


def point_responses(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    *,
    arm_mm: FloatArray,
    uv: FloatArray,
    radius_mm: FloatArray,
    progress: Callable[[str], None] = lambda _: None,
) -> FloatArray:
    """Translation of each marker's point per newton of each patch, (c, n, 3) mm/N.

    Parameters
    ----------
    model, mesh : ShellModel, ShellMesh
        The shell.
    arm_mm : (n, 3) float
        From ``markers.mid_mm`` to the point of the receptor that is watched.
    uv : (c, 2) float
        Patch centres.
    radius_mm : (c,) float
        Patch radii.
    """
    probe = point_probe(motion_probe(mesh, markers.uv), arm_mm)
    patches = patch_loads(mesh, surface, uv, radius_mm).T.tocsr()
    out = np.empty((len(uv), probe.shape[0]))
    for first in range(0, probe.shape[0], CHUNK):
        rows = slice(first, first + CHUNK)
        motion = model.solve(probe[rows].T).motion
        out[:, rows] = patches @ motion.reshape(patches.shape[1], -1)
        done = min(first + CHUNK, probe.shape[0])
        progress(f"response: {done} of {probe.shape[0]} adjoint loads")
    return out.reshape(len(uv), markers.count, 3)


def superpose(responses: FloatArray, contacts: Contacts) -> FloatArray:
    """Translation of every marker's point in every sample, (samples, n, 3) mm: linear sum."""
    out = np.zeros((contacts.samples, *responses.shape[1:]))
    np.add.at(out, contacts.sample, contacts.force_N[:, None, None] * responses)
    return out


def marker_motions(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Markers,
    contacts: Contacts,
) -> FloatArray:
    """Translation (mm) and rotation (rad) of every marker in every sample, (samples, n, 6)."""
    patches = patch_loads(mesh, surface, contacts.uv, contacts.radius_mm)
    count = len(contacts.force_N)
    gather = csr_matrix(
        (contacts.force_N, (np.arange(count), contacts.sample)), shape=(count, contacts.samples)
    )
    probe = motion_probe(mesh, markers.uv)
    loads = (patches @ gather).tocsc()
    out = np.empty((contacts.samples, markers.count, 6))
    for first in range(0, contacts.samples, CHUNK):
        motion = model.solve(loads[:, first : first + CHUNK]).motion
        flat = probe @ motion.reshape(probe.shape[1], -1)
        out[first : first + CHUNK] = flat.T.reshape(-1, markers.count, 6)
    return out
