"""Receptors against the print rules, from the design's own numbers."""

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.design.spec import Design
from phytac_design.fabrication.printing.violations import Violation, violation
from phytac_design.layout import Markers
from phytac_design.layout.receptor_distances import near_axes, pair_gaps_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.receptor_tubes import receptor_axes
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

SLACK_mm = 1e-6


def check_receptors(design: Design, markers: Markers) -> list[Violation]:
    """Tubes that are too slender, too thin or too near to each other, and holes too small."""
    receptor, rules = design.receptor, design.print_rules
    outer, hole = receptor.diameter_tube_mm, receptor.diameter_bore_mm
    tall = markers.height_mm - (receptor.band_marker_mm if receptor.has_inserts else 0.0)
    middle = (markers.base_mm + markers.tip_mm) / 2.0
    found = []
    for k in np.flatnonzero(tall > 0.0).tolist():
        height = float(tall[k])
        checks = {
            "post": (
                outer,
                rules.post_diameter_mm(height),
                f"a tube {height:.1f} mm high; raise receptor.diameter_outer_mm or shorten it",
            ),
            "wall": (
                (outer - hole) / 2.0,
                rules.wall_min_mm,
                "raise receptor.diameter_outer_mm or lower receptor.diameter_hole_mm",
            ),
        }
        if hole > 0.0:
            checks["hole"] = (hole, rules.hole_min_mm, "raise receptor.diameter_hole_mm")
        found += [
            violation(rule, middle[k], measured, least, fix, marker=k)
            for rule, (measured, least, fix) in checks.items()
            if measured < least - SLACK_mm
        ]
    return found + _gaps(design, markers)


def _gaps(design: Design, markers: Markers) -> list[Violation]:
    diameter, least = design.receptor.diameter_tube_mm, design.print_rules.gap_min_mm
    if markers.count < 2:
        return []
    pairs, _ = near_axes(markers, diameter + least)
    first, second = pairs.T
    gap = pair_gaps_mm(design, markers, pairs)
    middle = (markers.tip_mm[first] + markers.tip_mm[second]) / 2.0
    fix = "to marker {}: lower receptor.diameter_outer_mm or the number of markers, or shorten them"
    return [
        violation("gap", middle[k], gap[k], least, fix.format(second[k]), marker=int(first[k]))
        for k in np.flatnonzero(gap < least - SLACK_mm)
    ]


def owners(sensor: Sensor, points_mm: FloatArray) -> IntArray:
    """Receptor (n,) whose tube or hole a point is on or in; -1 for none.

    Parameters
    ----------
    points_mm : (n, 3) float
        Points on or in the shell.
    """
    design, markers = sensor.design, sensor.markers
    widened = 1.04  # polygons that stand for tubes reach so much farther out than the tubes
    near_mm = 0.02  # how far beyond its end a point may be to count as on a tube
    owner = np.full(len(points_mm), -1, dtype=np.int64)
    if markers.count == 0 or len(points_mm) == 0:
        return owner
    radius = design.receptor.diameter_tube_mm / 2.0
    try:
        start = receptor_axes(sensor).hole_start_mm
    except DesignError:
        start = markers.base_mm
    length = np.linalg.norm(markers.tip_mm - start, axis=1)
    # The nearest axis is one of those with the nearest points along them.
    steps = int(np.ceil(length.max() / radius)) + 1
    share = np.linspace(0.0, 1.0, steps)[:, None]
    along = start[:, None] + share * (markers.tip_mm - start)[:, None]
    near = cKDTree(along.reshape(-1, 3)).query(points_mm)[1] // steps
    arm = points_mm - start[near]
    way = np.einsum("ni,ni->n", arm, markers.direction[near])
    off = np.linalg.norm(arm - way[:, None] * markers.direction[near], axis=1)
    on = (off <= widened * radius) & (way <= length[near] + near_mm)
    owner[on] = near[on]
    return owner
