"""The printable shell as a mesh, by manifold3d (imported here only, at first use).

Solids of the shell, all in one frame::

    shell  = (wall ∪ tubes) − holes
    resin  = (wall ∪ tubes without their painted bands) − holes
    paint  = (bands − wall) − holes, one body for each colour

so that resin and paints tile the shell: the volumes add up, and nothing overlaps. Inserts are
printed apart: there the shell has wider and shorter tubes, and seats in its outer face::

    shell  = (wall ∪ tubes up to the bands) − bores − seats
    glued  = (wall ∪ tubes up to the bands ∪ inserts) − holes
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.geometry.triangles import (
    TriangleMesh,
    copies,
    distinct_points,
    frames_along,
    prisms,
    proper_triangles,
    sides_for,
    widening,
)
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.receptor_tubes import ReceptorAxes, receptor_axes
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

SLIVER_mm = 1e-6
"""Triangles thinner than this are merged: single precision (STL) cannot represent their normal."""
TOLERANCE_mm = 0.01
"""Default distance between the mesh and the true faces; a tenth of what a printer resolves."""


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """Manifolds that every solid is made of, and the sizes for more."""

    wall: Any
    holes: Any
    axes: ReceptorAxes
    radius_mm: float
    tolerance_mm: float

    def rods(self, start_mm: FloatArray, end_mm: FloatArray, radius_mm: float | None = None) -> Any:
        """Rods of the tube's outer diameter, or of another."""
        radius = self.radius_mm if radius_mm is None else radius_mm
        return to_manifold(prisms(start_mm, end_mm, radius, sides_for(radius, self.tolerance_mm)))


def to_manifold(mesh: TriangleMesh) -> Any:
    """Return a ``manifold3d.Manifold`` of a closed mesh.

    Raises
    ------
    NumericalError
        If manifold3d does not accept the mesh as a solid.
    """
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.ascontiguousarray(mesh.vertices_mm, dtype=np.float64),
            tri_verts=np.ascontiguousarray(mesh.triangles, dtype=np.uint64),
        )
    )
    if solid.status() != manifold3d.Error.NoError:
        raise NumericalError(
            "mesh-not-closed",
            f"a mesh of {len(mesh.triangles)} triangles is not a closed solid "
            f"({solid.status()}); check the design with `phytac check`",
        )
    return solid


def to_triangles(solid: Any) -> TriangleMesh:
    """Triangles of a ``manifold3d.Manifold``, double precision."""
    mesh = solid.to_mesh64()
    return TriangleMesh(
        vertices_mm=np.array(mesh.vert_properties, dtype=np.float64)[:, :3],
        triangles=np.array(mesh.tri_verts, dtype=np.int64),
    )


def stl_triangles(mesh: TriangleMesh, *, step_mm: float = 1e-5) -> TriangleMesh:
    """Triangles of a closed mesh that survive the single precision of an STL file.

    Corners are rounded to ``step_mm`` and those that become equal are merged; triangles lower than
    the step, whose direction single precision cannot hold, are removed.
    """
    rounded = (step_mm * np.round(mesh.vertices_mm / step_mm)).astype(np.float32) + np.float32(0.0)
    points, ids = distinct_points(rounded)
    triangles = proper_triangles(ids[mesh.triangles])
    rounded_mesh = TriangleMesh(vertices_mm=points.astype(np.float64), triangles=triangles)
    return to_triangles(to_manifold(rounded_mesh).simplify(step_mm))


def _parts(sensor: Sensor, tolerance_mm: float) -> _Parts:
    design, surface = sensor.design, sensor.surface
    receptor = design.receptor
    axes = receptor_axes(sensor)
    radius, hole = receptor.diameter_tube_mm / 2.0, receptor.diameter_hole_mm / 2.0
    cutters = TriangleMesh(vertices_mm=np.zeros((0, 3)), triangles=np.zeros((0, 3), dtype=np.int64))
    if design.has_switches:
        sides = sides_for(hole, tolerance_mm)
        cutters = prisms(axes.hole_start_mm, axes.hole_end_mm, hole, sides)
    return _Parts(
        wall=to_manifold(wall_mesh(surface, design.wall, tolerance_mm=tolerance_mm)),
        holes=to_manifold(cutters),
        axes=axes,
        radius_mm=radius,
        tolerance_mm=tolerance_mm,
    )


def shell_manifold(
    sensor: Sensor, *, tolerance_mm: float = TOLERANCE_mm, glued: bool = False
) -> Any:
    """Wall, rims, tubes and holes as one ``manifold3d.Manifold``, mm.

    Receptors must not meet each other (``phytac_design.rules.check_design`` sees to it): all
    tubes are handed over as one mesh of separate components, which is what makes this fast.

    Parameters
    ----------
    tolerance_mm : float
        Largest distance between the mesh and the true faces.
    glued : bool
        With the inserts in place, one piece with the shell; without inserts this changes nothing.
    """
    parts, receptor = _parts(sensor, tolerance_mm), sensor.design.receptor
    axes = parts.axes
    if not receptor.has_inserts:
        tubes = parts.rods(axes.root_mm, axes.tip_mm)
        return ((parts.wall + tubes) - parts.holes).simplify(SLIVER_mm)
    body, tall = parts.wall, ~axes.painted
    if tall.any():
        body = body + parts.rods(axes.root_mm[tall], axes.band_mm[tall])
    if glued:
        inserts = parts.rods(axes.root_mm, axes.tip_mm, receptor.diameter_outer_mm / 2.0)
        return ((body + inserts) - parts.holes).simplify(SLIVER_mm)
    bores = parts.rods(axes.hole_start_mm, axes.hole_end_mm, receptor.diameter_bore_mm / 2.0)
    return (body - bores - _seats(sensor, axes, tolerance_mm)).simplify(SLIVER_mm)


def _seats(sensor: Sensor, axes: ReceptorAxes, tolerance_mm: float) -> Any:
    """What the heads of inserts sit in: cones of 45 degrees, straight beyond the outer face."""
    import manifold3d

    receptor = sensor.design.receptor
    wide, low = receptor.diameter_seat_mm / 2.0, receptor.diameter_bore_mm / 2.0
    sides = sides_for(wide, tolerance_mm)
    wide, low = wide * widening(sides), low * widening(sides)
    cone = manifold3d.Manifold.cylinder(receptor.depth_seat_mm, wide, low, sides)
    above = manifold3d.Manifold.cylinder(wide, wide, wide, sides).translate((0.0, 0.0, -wide))
    seats = copies(
        to_triangles(cone + above), axes.outer_mm, frames_along(sensor.markers.direction)
    )
    return to_manifold(seats)


def painted_manifolds(sensor: Sensor, *, tolerance_mm: float = TOLERANCE_mm) -> dict[str, Any]:
    """Bodies that tile the shell, by name: ``resin`` first, then each paint in use.

    A paint body is the last ``band_marker_mm`` of each tube of that colour, full tube wall and
    end face; a receptor not taller than the band is painted down to the wall. Without a band
    (shorter than ``band_min_mm``), and where inserts hold the colours, there is only resin.
    """
    design, markers = sensor.design, sensor.markers
    band_min_mm = 1e-3  # a shorter painted band is no solid; its paint is left out
    if design.receptor.has_inserts or design.receptor.band_marker_mm < band_min_mm:
        return {"resin": shell_manifold(sensor, tolerance_mm=tolerance_mm)}
    parts = _parts(sensor, tolerance_mm)
    axes = parts.axes
    bare = ~axes.painted
    body = parts.wall
    if bare.any():
        body = body + parts.rods(axes.root_mm[bare], axes.band_mm[bare])
    bodies = {"resin": body - parts.holes}
    names = design.layout.colours
    for colour in dict.fromkeys(names):
        own = np.array([name == colour for name in names])[markers.colour]
        if own.any():
            bands = parts.rods(axes.band_mm[own], axes.tip_mm[own])
            bodies[colour] = (bands - parts.wall) - parts.holes
    return bodies


def united(solids: "list[Any]") -> Any:
    """Union of ``manifold3d.Manifold`` solids, in one operation."""
    import manifold3d

    return manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)


def hull(points_mm: FloatArray) -> Any:
    """Convex hull of points (n, 3) as a ``manifold3d.Manifold``."""
    import manifold3d

    return manifold3d.Manifold.hull_points(np.ascontiguousarray(points_mm, dtype=np.float64))


def box(low_mm: FloatArray, high_mm: FloatArray) -> Any:
    """Box between two corners (3,) as a ``manifold3d.Manifold``."""
    import manifold3d

    return manifold3d.Manifold.cube(tuple(high_mm - low_mm)).translate(tuple(low_mm))


def extruded_manifold(points_mm: FloatArray, low_mm: float, high_mm: float) -> Any:
    """Prism over a simple polygon (n, 2), anticlockwise, from ``low_mm`` to ``high_mm`` along z.

    Raises
    ------
    NumericalError
        If nothing is left of it.
    """
    import manifold3d

    section = manifold3d.CrossSection([np.asarray(points_mm, dtype=np.float64)])
    solid = manifold3d.Manifold.extrude(section, high_mm - low_mm).translate((0.0, 0.0, low_mm))
    if solid.is_empty():
        raise NumericalError(
            "prism-empty",
            f"a prism of {len(points_mm)} corners from {low_mm:g} to {high_mm:g} mm is empty; "
            "please report this design",
        )
    return solid
