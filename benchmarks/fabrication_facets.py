"""Facets of the shell: how far from the true faces, how many against the fewest, time to slice."""

import numpy as np

from benchmarks.harness import Table
from phytac_design.fabrication.printing.receptors import owners
from phytac_design.fabrication.printing.surface_samples import sample_faces
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import TOLERANCE_mm, shell_manifold, to_triangles
from phytac_shapes.arrays import FloatArray
from phytac_shapes.cylinder import Cylinder

SPACING_mm = 0.35
"""Between the points at which the chordal error is measured."""


def sides(radius_mm: float, tolerance_mm: float) -> int:
    """Fewest sides of a polygon within a tolerance of a circle, on both sides of it.

    Its corners stand out as much as its sides fall short: R·(1 − cos(π/n)) is two tolerances.
    """
    return int(np.ceil(np.pi / np.arccos(1.0 - 2.0 * tolerance_mm / radius_mm)))


def fewest(case: Sensor, tolerance_mm: float) -> int:
    """Triangles of the best tessellation of a cylindrical shell, counted without the crossings.

    A plane region with V corners on its rims and h holes takes V + 2·h − 2 triangles, a strip of n
    quadrilaterals 2·n. Edges of the wall's facets that cross holes would add more: left out, so
    that no tessellation can have fewer than this.
    """
    design, surface, markers = case.design, case.surface, case.markers
    assert isinstance(surface, Cylinder)
    receptor, wall = design.receptor, design.wall
    outer = surface.diameter_outer_mm / 2.0
    radii = [outer, outer - wall.thickness_mm, outer + wall.rim_flange_mm]
    out, inner, flange = (sides(radius, tolerance_mm) for radius in radii)
    # Outer and inner face; at each end the flange's side, its shoulder, and the end face.
    walls = 2 * out + 2 * inner + 2 * (2 * flange + (flange + out) + (flange + inner))
    tube = sides(receptor.diameter_outer_mm / 2.0, tolerance_mm)
    hole = sides(receptor.diameter_hole_mm / 2.0, tolerance_mm)
    # Tube's side, hole's side, end face, and the two openings that they make in the wall's faces.
    each = 2 * tube + 2 * hole + (tube + hole) + (hole + 2) + (tube + 2)
    return walls + markers.count * each


def chordal_errors(case: Sensor) -> FloatArray:
    """Distance from the true faces (n,) of points all over the mesh of a cylindrical shell, mm."""
    design, surface, markers = case.design, case.surface, case.markers
    assert isinstance(surface, Cylinder)
    receptor, wall = design.receptor, design.wall
    mesh = to_triangles(shell_manifold(case))
    points = sample_faces(RayTree(mesh), SPACING_mm).point_mm
    points = np.concatenate([points, mesh.vertices_mm])
    radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    outer, rim, length = surface.diameter_outer_mm / 2.0, wall.rim_length_mm, surface.length_mm
    near = np.min(
        [np.abs(radius - r) for r in (outer, outer - wall.thickness_mm, outer + wall.rim_flange_mm)]
        + [np.abs(z - end) for end in (-rim, 0.0, length, length + rim)],
        axis=0,
    )
    owner = owners(case, points)
    own = np.flatnonzero(owner >= 0)
    arm, axis = points[own] - markers.tip_mm[owner[own]], markers.direction[owner[own]]
    along = np.einsum("ni,ni->n", arm, axis)
    off = np.linalg.norm(arm - along[:, None] * axis, axis=1)
    for diameter in (receptor.diameter_outer_mm, receptor.diameter_hole_mm):
        near[own] = np.minimum(near[own], np.abs(off - diameter / 2.0))
    near[own] = np.minimum(near[own], np.abs(along))
    return np.asarray(near)


def facet_rows(table: Table, case: Sensor) -> None:
    """Chordal error and facet count of a cylinder's shell."""
    name = case.design.name
    count = int(shell_manifold(case).num_tri())
    best = fewest(case, TOLERANCE_mm)
    row = f"{name}: facets over the fewest possible"
    source = f"counted for wall, rims, tubes, holes at {TOLERANCE_mm} mm both ways"
    table.add(row, count / best, "ratio", best, source, "<= 2")
    row = f"{name}: chordal error"
    source = f"corners, and points every {SPACING_mm} mm, against cylinders and planes"
    note = "corners stand out by two thirds of the sag, to fourth order"
    value = float(chordal_errors(case).max())
    table.add(row, value, "mm", TOLERANCE_mm, source, f"<= {1.05 * TOLERANCE_mm:g}", note)
