"""Connectivity and directors that are no shell are refused with the reason."""

import numpy as np
import pytest

from phytac_design.mechanics.meshing.mesh_check import (
    check_directors,
    check_distortion,
    check_quads,
)
from phytac_shapes.arrays import IntArray
from tests.mechanics.conftest import Prototype
from tests.refusals import refused
from verification import shells as cases

GRID = cases.patch(lambda a, b: np.column_stack([a, b, 0.2 * a * b]), 3, 2)
COUNT = len(GRID.nodes)


def changed(element: int, *corners: int) -> IntArray:
    quads = GRID.quads.copy()
    quads[element] = corners
    return quads


def test_good_meshes_pass(cylinder60: Prototype) -> None:
    mesh = cylinder60.mesh
    for nodes, quads, normals in (
        (GRID.nodes, GRID.quads, GRID.normals),
        (mesh.nodes_mm, mesh.quads, mesh.normals),
        (mesh.nodes_mm, mesh.quads, mesh.normals[mesh.quads]),
    ):
        check_quads(quads, len(nodes))
        check_directors(nodes, quads, normals)


@pytest.mark.parametrize(
    ("quads", "code"),
    [
        (
            np.concatenate([GRID.quads, [[0, 3, COUNT, COUNT + 1], [3, 0, 11, 10]]]),
            "mesh-edge-overused",
        ),
        (changed(1, *GRID.quads[1][::-1]), "mesh-orientation-mixed"),
        (np.concatenate([GRID.quads, GRID.quads[2:3, [1, 2, 3, 0]]]), "mesh-edge-overused"),
        (changed(4, 6, 9, 10, COUNT + 2), "mesh-node-unknown"),
        (changed(4, 6, 9, 10, -1), "mesh-node-unknown"),
        (GRID.quads[:, :3], "mesh-shape-invalid"),
        (GRID.quads[:0], "mesh-shape-invalid"),
    ],
)
def test_bad_connectivity_is_refused(quads: IntArray, code: str) -> None:
    with refused(code):
        check_quads(quads, COUNT + 2)


def test_bad_directors_are_refused() -> None:
    with refused("mesh-director-not-unit"):
        check_directors(GRID.nodes, GRID.quads, 2.0 * GRID.normals)
    flipped = GRID.normals.copy()
    flipped[4] *= -1.0
    with refused("mesh-orientation-reversed"):
        check_directors(GRID.nodes, GRID.quads, flipped)


def test_a_tube_of_three_walls_at_an_edge_is_refused_and_a_crease_is_not() -> None:
    two = np.array([[0, 1, 2, 3], [1, 4, 5, 2]])
    check_quads(two, 8)
    with refused("mesh-edge-overused") as caught:
        check_quads(np.concatenate([two, [[1, 6, 7, 2]]]), 8)
    caught.match("edge 1-2")


@pytest.mark.parametrize(
    ("sides", "thickness", "jitter", "sound"),
    [(32, 1e-4, 0.25, False), (32, 1e-4, 0.0, True), (32, 1e-3, 0.25, True), (64, 1e-4, 0.1, True)],
)
def test_distorted_elements_of_a_thin_wall_are_refused(
    sides: int, thickness: float, jitter: float, *, sound: bool
) -> None:
    """Free hyperboloids, whose bending locks on them: by 41, 0.1, 1.6 and less than 1 %."""
    case = cases.hyperboloid_case(sides, thickness=thickness, jitter=jitter)
    if sound:
        assert abs(case.ratio() - 1.0) < 0.05
        return
    with refused("mesh-distorted"):
        case.model()
    # Flat walls do not lock, however thin.
    flat = np.column_stack([case.mesh.ab, np.zeros(len(case.mesh.ab))])
    up = np.broadcast_to([0.0, 0.0, 1.0], flat.shape)
    check_distortion(flat, case.mesh.quads, up, thickness)


def test_distortion_does_not_depend_on_the_numbering() -> None:
    mesh = cases.hyperboloid_case(12, thickness=1e-4).mesh
    quads = mesh.quads.copy()
    for start in (1, 2, 3):
        quads[start::4] = np.roll(quads[start::4], start, axis=1)
    check_distortion(mesh.nodes, quads, mesh.normals, 1e-4)
