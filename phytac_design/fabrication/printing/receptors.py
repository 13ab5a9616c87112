"""Receptors against the print rules, from the design's own numbers."""

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.design.spec import Design
from phytac_design.fabrication.printing.violations import Violation, place
from phytac_design.layout import Markers
from phytac_design.layout.receptor_distances import segment_distance_mm
from phytac_design.solids.receptor_tubes import receptor_axes
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

SLACK_mm = 1e-6
NEAR = 1.04
"""Polygons that stand for tubes reach this much farther out than the tubes."""
NEAR_mm = 0.02
"""How far beyond its end a point may be to count as on a tube."""


def check_receptors(design: Design, markers: Markers) -> list[Violation]:
    """Tubes that are too slender, too thin or too near to each other, and holes too small."""
    receptor, rules = design.receptor, design.print_rules
    outer, hole = receptor.diameter_outer_mm, receptor.diameter_hole_mm
    middle = (markers.foot_mm + markers.tip_mm) / 2.0
    found = []
    for k in range(markers.count):
        height = float(markers.height_mm[k])
        asked = {
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
            "hole": (hole, rules.hole_min_mm, "raise receptor.diameter_hole_mm"),
        }
        found += [
            Violation(
                rule=rule,
                point_mm=place(middle[k]),
                measured=measured,
                asked=least,
                unit="mm",
                fix=fix,
                marker=k,
            )
            for rule, (measured, least, fix) in asked.items()
            if measured < least - SLACK_mm
        ]
    return found + _gaps(design, markers)


def _gaps(design: Design, markers: Markers) -> list[Violation]:
    diameter, least = design.receptor.diameter_outer_mm, design.print_rules.gap_min_mm
    pairs = _near_pairs(markers, diameter + least)
    if len(pairs) == 0:
        return []
    first, second = pairs.T
    gap = -diameter + segment_distance_mm(
        markers.foot_mm[first], markers.tip_mm[first], markers.foot_mm[second],
        markers.tip_mm[second],
    )  # fmt: skip
    middle = (markers.tip_mm[first] + markers.tip_mm[second]) / 2.0
    return [
        Violation(
            rule="gap",
            point_mm=place(middle[k]),
            measured=float(gap[k]),
            asked=least,
            unit="mm",
            fix=f"to marker {second[k]}: lower receptor.diameter_outer_mm or the number of "
            "markers, or shorten them",
            marker=int(first[k]),
        )
        for k in np.flatnonzero(gap < least - SLACK_mm)
    ]


def _near_pairs(markers: Markers, reach_mm: float) -> IntArray:
    """Pairs (k, 2) of receptors whose axes may come within ``reach_mm``."""
    longest = float(markers.height_mm.max(initial=0.0))
    steps = int(np.ceil(longest / reach_mm)) + 1
    share = np.linspace(0.0, 1.0, steps + 1)[:, None]
    points = markers.foot_mm[:, None] + share * (markers.tip_mm - markers.foot_mm)[:, None]
    tree = cKDTree(points.reshape(-1, 3))
    pairs = tree.query_pairs(reach_mm + longest / steps, output_type="ndarray") // (steps + 1)
    pairs = np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1)
    return np.asarray(np.unique(pairs, axis=0))


def owners(design: Design, surface: Surface, markers: Markers, points_mm: FloatArray) -> IntArray:
    """Receptor (n,) whose tube or hole a point is on or in; -1 for none.

    Parameters
    ----------
    points_mm : (n, 3) float
        Points on or in the shell.
    """
    owner = np.full(len(points_mm), -1, dtype=np.int64)
    if markers.count == 0 or len(points_mm) == 0:
        return owner
    radius = design.receptor.diameter_outer_mm / 2.0
    try:
        start = receptor_axes(design, surface, markers).hole_start_mm
    except DesignError:
        start = markers.foot_mm
    length = np.linalg.norm(markers.tip_mm - start, axis=1)
    # The nearest axis is one of those with the nearest points along them.
    steps = int(np.ceil(length.max() / radius)) + 1
    share = np.linspace(0.0, 1.0, steps)[:, None]
    along = start[:, None] + share * (markers.tip_mm - start)[:, None]
    near = cKDTree(along.reshape(-1, 3)).query(points_mm)[1] // steps
    arm = points_mm - start[near]
    way = np.einsum("ni,ni->n", arm, markers.direction[near])
    off = np.linalg.norm(arm - way[:, None] * markers.direction[near], axis=1)
    on = (off <= NEAR * radius) & (way <= length[near] + NEAR_mm)
    owner[on] = near[on]
    return owner
