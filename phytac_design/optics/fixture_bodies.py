"""Bodies of a design's fixtures as triangles."""

import numpy as np

from phytac_design.design.fixture_table import AnyFixture, BoxFixture, CylinderFixture
from phytac_design.geometry.triangles import TriangleMesh, cylinder_mesh
from phytac_shapes.arrays import FloatArray

FACES = np.array(
    [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
)
"""Corners of a box's faces; corner 4 i + 2 j + k lies at its low (0) or high (1) x, y, z."""


def fixture_mesh(fixture: AnyFixture, *, tolerance_mm: float) -> TriangleMesh:
    """Triangles of one fixture; polygons stay within ``tolerance_mm`` of their circles."""
    if isinstance(fixture, CylinderFixture):
        return cylinder_mesh(
            np.array(fixture.from_mm),
            np.array(fixture.to_mm),
            fixture.radius_mm,
            tolerance_mm=tolerance_mm,
        )
    if isinstance(fixture, BoxFixture):
        triangles = np.concatenate([FACES[:, [0, 1, 2]], FACES[:, [0, 2, 3]]])
        return TriangleMesh(vertices_mm=_corners(fixture), triangles=triangles)
    return TriangleMesh(
        vertices_mm=np.array(fixture.vertices_mm, dtype=np.float64),
        triangles=np.array(fixture.triangles, dtype=np.int64),
    )


def _corners(box: BoxFixture) -> FloatArray:
    """Corners (8, 3) of a box."""
    sign = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    half = sign * np.array(box.size_mm) / 2.0
    c, s = np.cos(np.radians(box.turn_deg)), np.sin(np.radians(box.turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(np.array(box.centre_mm) + half @ turn.T)
