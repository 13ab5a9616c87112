"""Volume and pieces of the printed shell, estimated without a solid."""

import numpy as np

from phytac_design.fabrication.printing.cuts import plan_cuts
from phytac_design.fabrication.printing.overhang import directions, on_bed
from phytac_design.fabrication.printing.parting import key_sizes
from phytac_design.geometry.envelope import boundary_mm, edge_mm
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


def shell_volume_mm3(sensor: Sensor) -> float:
    """Volume of wall, rims and tubes, less the holes: areas and sections times lengths."""
    design, surface = sensor.design, sensor.surface
    wall, receptor, height_mm = design.wall, design.receptor, sensor.markers.height_mm
    volume = surface.area_mm2(-wall.thickness_mm / 2.0) * wall.thickness_mm
    outer, hole = receptor.diameter_tube_mm / 2.0, receptor.diameter_bore_mm / 2.0
    if receptor.has_inserts:
        height_mm = np.maximum(height_mm - receptor.band_marker_mm, 0.0)
        # What a seat's cone takes beside the bore.
        seat, depth = receptor.diameter_seat_mm / 2.0, receptor.depth_seat_mm
        cone = depth * ((seat**2 + seat * hole + hole**2) / 3.0 - hole**2)
        volume -= np.pi * cone * len(height_mm)
    volume += np.pi * float(((outer**2 - hole**2) * height_mm).sum())
    volume -= np.pi * hole**2 * wall.thickness_mm * len(height_mm)
    return float(
        volume + _rims_mm3(surface, wall.thickness_mm, wall.rim_flange_mm, wall.rim_length_mm)
    )


def _rims_mm3(surface: Surface, thickness_mm: float, flange_mm: float, length_mm: float) -> float:
    """Volume of all rims: the length of their section's middle times its area."""
    around = 0.0
    for axis, end in surface.edges():
        edge = edge_mm(surface, end, 0.5 * (flange_mm - thickness_mm), axis=axis)
        if surface.periodic[1 - axis]:
            edge = np.concatenate([edge, edge[:1]])
        around += float(np.linalg.norm(np.diff(edge, axis=0), axis=1).sum())
    # Rims of a sheet meet in four mitres, each a square more of their length.
    corners = 0 if surface.periodic[1] else 4
    return (around + corners * length_mm) * length_mm * (thickness_mm + flange_mm)


def shell_pieces(sensor: Sensor) -> int:
    """Pieces in which the shell is printed; 1 too where a larger one cannot be parted."""
    rules, corners = sensor.design.print_rules, _corners_mm(sensor)
    if any(on_bed(corners, up, rules)[2] for up in directions()):
        return 1
    try:
        cuts = plan_cuts(sensor, corners, key_sizes(rules)[0].length)
    except DesignError:
        return 1
    axes = [cut.axis for cut in cuts]
    return int(np.prod([1 + axes.count(axis) for axis in set(axes)]))


def _corners_mm(sensor: Sensor) -> FloatArray:
    """Points (n, 3) that reach as far as the shell does."""
    surface, wall = sensor.surface, sensor.design.wall
    steps = [np.linspace(low, high, 48) for low, high in surface.domain]
    uv = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    tolerance_mm = 0.1
    flange = wall.rim_flange_mm if wall.rim_length_mm > 0.0 else 0.0
    return np.concatenate(
        [
            surface.point(uv),
            boundary_mm(surface, flange),
            sensor.envelope(tolerance_mm).vertices_mm,
        ]
    )
