"""Distances between receptors: segment distances, found with k-d trees."""

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.design.spec import Design
from phytac_design.layout.markers import Markers
from phytac_shapes.arrays import FloatArray, IntArray


def smallest_receptor_gap_mm(
    design: Design, markers: Markers
) -> tuple[float, tuple[int, int] | None]:
    """Smallest gap between two tubes and the ids of the two; (inf, None) for a single marker.

    Gaps above the sum of one diameter and the printer's gap are not searched: then the gap
    between the nearest ends is returned.
    """
    if markers.count < 2:
        return np.inf, None
    diameter = design.receptor.diameter_tube_mm
    best, pair = min(nearest_pair(markers.tip_mm), nearest_pair(markers.base_mm))
    required = diameter + design.print_rules.gap_min_mm
    if design.receptor.has_inserts:
        pairs, _ = near_axes(markers, required)
        if not len(pairs):
            return best - diameter, pair
        gap = pair_gaps_mm(design, markers, pairs)
        at = _least(gap)
        return float(gap[at]), (int(pairs[at, 0]), int(pairs[at, 1]))
    # Overlapping ends settle it; else tubes are apart at their ends and candidates are few.
    if best >= required:
        pairs, distance = near_axes(markers, required)
        if len(pairs):
            at = _least(distance)
            if distance[at] < best:
                best, pair = float(distance[at]), (int(pairs[at, 0]), int(pairs[at, 1]))
    return best - diameter, pair


def pair_gaps_mm(design: Design, markers: Markers, pairs: IntArray) -> FloatArray:
    """Gaps (k,) between receptors of pairs (k, 2); negative where they overlap.

    Around inserts tubes are wider than the markers, up to the coloured band.
    """
    receptor = design.receptor
    marker = receptor.diameter_outer_mm / 2.0
    parts = [(markers.tip_mm, np.full(markers.count, marker))]
    if receptor.has_inserts:
        length = np.maximum(markers.height_mm - receptor.band_marker_mm, 0.0)
        radius = np.where(length > 0.0, receptor.diameter_tube_mm / 2.0, marker)
        parts.append((markers.base_mm + length[:, None] * markers.direction, radius))
    first, second = pairs.T
    base = markers.base_mm
    gaps = [
        segment_distance_mm(base[first], a[first], base[second], b[second]) - r[first] - s[second]
        for a, r in parts
        for b, s in parts
    ]
    return np.asarray(np.min(gaps, axis=0))


def _least(values_mm: FloatArray) -> int:
    """Index of the least value; of values equal but for rounding, the first."""
    return int(np.argmin(np.round(values_mm, 9)))


def nearest_pair(points_mm: FloatArray) -> tuple[float, tuple[int, int]]:
    """Smallest distance between two of at least two points (n, 3), and their ids in order."""
    distance, other = cKDTree(points_mm).query(points_mm, k=min(len(points_mm), 8))
    first = _least(distance[:, 1])
    least = float(distance[first, 1])
    # Coincident points may list a point after its duplicate; the lowest of equal ids is used.
    equal = other[first][distance[first] <= least + 1e-9]
    second = int(equal[equal != first].min())
    return least, (min(first, second), max(first, second))


def near_axes(markers: Markers, reach_mm: float) -> tuple[IntArray, FloatArray]:
    """Pairs of tubes (k, 2) whose axes may come within ``reach_mm``, and their distances (k,) mm.

    Candidates are found by samples along the axes.
    """
    steps = int(np.ceil(markers.height_mm.max() / reach_mm)) + 1
    along = np.linspace(0.0, 1.0, steps)
    samples = (
        markers.base_mm[:, None] + along[:, None] * (markers.tip_mm - markers.base_mm)[:, None]
    )
    # The nearest points of two axes each lie within half a step (≤ reach) of a sample.
    step = markers.height_mm.max() / (steps - 1)
    tree = cKDTree(samples.reshape(-1, 3))
    pairs = tree.query_pairs(reach_mm + step, output_type="ndarray") // steps
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    keys = np.unique(pairs.min(axis=1) * markers.count + pairs.max(axis=1))
    first, second = np.divmod(keys, markers.count)
    ends = [axis[k] for k in (first, second) for axis in (markers.base_mm, markers.tip_mm)]
    return np.column_stack([first, second]), segment_distance_mm(*ends)


def segment_distance_mm(
    p0: FloatArray, p1: FloatArray, q0: FloatArray, q1: FloatArray
) -> FloatArray:
    """Distance between segments p0-p1 and q0-q1, (n, 3) each; (n,), any unit.

    Closed form for the inner minimum where it exists, else the least of the four end-to-segment
    distances (Eberly, *Robust computation of distance between line segments*, 2015).
    """
    d1, d2, r = p1 - p0, q1 - q0, p0 - q0
    a, e, b = _dot(d1, d1), _dot(d2, d2), _dot(d1, d2)
    c, f = _dot(d1, r), _dot(d2, r)
    det = a * e - b * b
    skew = det > 1e-12 * a * e
    safe = np.where(skew, det, 1.0)
    s, t = (b * f - c * e) / safe, (a * f - b * c) / safe
    inner = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    between = r + s[:, None] * d1 - t[:, None] * d2
    ends = np.min(
        [
            _point_segment(p0, q0, q1),
            _point_segment(p1, q0, q1),
            _point_segment(q0, p0, p1),
            _point_segment(q1, p0, p1),
        ],
        axis=0,
    )
    nearest = np.minimum(np.linalg.norm(between, axis=1), ends)
    return np.asarray(np.where(inner, nearest, ends))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", a, b))


def _point_segment(p: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    axis = b - a
    length2 = np.maximum(_dot(axis, axis), np.finfo(np.float64).tiny)
    along = np.clip(_dot(p - a, axis) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - a - along[:, None] * axis, axis=1))
