"""Walls, posts, holes and gaps of any body, measured by rays from points on its faces.

From each point a ray goes into the body, square to the face, and another one out of it, to the
face across. Half-way, four lines parallel to the face tell what it is that is thin: material that
is as narrow another way too is a post, air that is so is a hole; else it is a wall, or a gap.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.free_walls import free_walls
from phytac_design.fabrication.printing.samples import Samples, frame, regions
from phytac_design.fabrication.printing.violations import Violation, place
from phytac_design.geometry.ray_tree import RayTree, START_mm
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

FACING = 0.85
"""Least cosine between a ray and the face across, for that face to be the other side."""
PARALLEL = 0.985
"""The same where walls and gaps are measured: wedges of more than 10° are edges and corners."""
TAPER = 2.0
"""A wall or gap that tapers to nothing within this many times the asked width is an edge."""
SHALLOW = 2.0
"""What is less high or deep than this many times its width is a detail, not a wall or a hole."""
NARROW = 1.6
"""Width across over thickness up to which a thin place is a post or a hole."""
SLENDER = 2.0
"""A post is at least this many times as high as thick."""
ROUND = 0.2
"""Least share of normals that look another way, for their common axis to be known."""
SPREAD = 0.25
"""Share of a post's height over which it must have been met: each side has two triangles."""
LINES = 4
Narrow = tuple[Samples, FloatArray]
"""Points and the widths (n,) mm there."""
Sizes = tuple[float, float]
"""Spacing of the samples and tolerance of the facets, mm."""


@dataclass(frozen=True, kw_only=True)
class Thickness:
    """What rays measured.

    Attributes
    ----------
    violations : list of Violation
        All, by region.
    wall_mm : float
        Thinnest wall that was met; inf if none is thinner than the rays' limit.
    """

    violations: list[Violation]
    wall_mm: float


def check_thickness(
    tree: RayTree,
    samples: Samples,
    rules: PrintSection,
    *,
    spacing_mm: float,
    tolerance_mm: float,
    known: BoolArray,
) -> Thickness:
    """Find thin walls, slender posts, small holes and narrow gaps.

    Parameters
    ----------
    tree : RayTree
        The body, closed.
    samples : Samples
        Points on its faces.
    spacing_mm : float
        About how far apart they are.
    tolerance_mm : float
        How far facets may stray from the true faces: what is below a rule by less is let be.
    known : (n,) bool
        Points on features whose walls, posts and holes are known from the design.
    """
    limit = max(rules.wall_min_mm, rules.wall_free_min_mm, rules.post_tall_mm[0])
    samples = samples.some(~known)
    sizes = (spacing_mm, tolerance_mm)
    posts, walls = _split(tree, samples, -1.0, limit, max(rules.wall_min_mm, sizes[1]))
    found = _posts(tree, *posts, rules, sizes) + _walls(tree, *walls, rules, sizes)
    limit = max(rules.hole_min_mm, rules.gap_min_mm)
    holes, gaps = _split(tree, samples, 1.0, limit, rules.gap_min_mm)
    found += _holes(tree, *holes, rules, sizes) + _gaps(tree, *gaps, rules, sizes)
    return Thickness(violations=found, wall_mm=float(walls[1].min(initial=np.inf)))


def _split(
    tree: RayTree, samples: Samples, side: float, limit_mm: float, asked_mm: float
) -> tuple[Narrow, Narrow]:
    """Thin places inward (side -1) or outward (1): narrow both ways, and only one way."""
    way = side * samples.normal
    hits = tree.cast(samples.point_mm + START_mm * way, way, limit_mm)
    # Inward, a ray leaves the body at the face across; outward it enters there.
    cosine = -side * np.einsum("ni,ni->n", tree.normal[hits.triangle], way)
    thin = (hits.triangle >= 0) & (cosine >= FACING)
    samples, width, cosine = samples.some(thin), hits.distance_mm[thin] + START_mm, cosine[thin]
    narrow = _narrow(tree, samples, side, width)
    slope = np.sqrt(np.clip(1.0 - cosine**2, 1e-18, 1.0)) / cosine
    flat = ~narrow & (cosine >= PARALLEL) & (width >= TAPER * asked_mm * slope)
    return (samples.some(narrow), width[narrow]), (samples.some(flat), width[flat])


def _narrow(tree: RayTree, samples: Samples, side: float, width_mm: FloatArray) -> BoolArray:
    """Whether a thin place is about as narrow along one of four lines parallel to the face."""
    count = len(width_mm)
    if count == 0:
        return np.zeros(0, dtype=np.bool_)
    middle = samples.point_mm + (side * width_mm / 2.0)[:, None] * samples.normal
    first, second = frame(samples.normal)
    widest = NARROW * width_mm
    narrow = np.zeros(count, dtype=np.bool_)
    for k in range(LINES):
        angle = np.pi * k / LINES
        way = np.cos(angle) * first + np.sin(angle) * second
        ahead = tree.cast(middle, way, widest).distance_mm
        near = np.flatnonzero(np.isfinite(ahead))
        back = tree.cast(middle[near], -way[near], widest[near]).distance_mm
        narrow[near] |= ahead[near] + back <= widest[near]
    return narrow


def _posts(
    tree: RayTree, samples: Samples, width_mm: FloatArray, rules: PrintSection, sizes: Sizes
) -> list[Violation]:
    found = []
    middle = samples.point_mm - (width_mm / 2.0)[:, None] * samples.normal
    label = _label(tree, samples, middle, width_mm, sizes)
    for k in range(label.max(initial=-1) + 1):
        own = label == k
        corners, axis = _run(tree, samples.some(own), longest=True)
        centre = corners.mean(axis=0)
        along = (corners - centre) @ axis
        height = float(np.ptp(along))
        width = float(np.median(width_mm[own]))
        asked = rules.post_diameter_mm(height)
        about = middle[own].mean(axis=0)
        arm = middle[own] - about
        off = np.linalg.norm(arm - np.outer(arm @ axis, axis), axis=1)
        straight = off.max() < width and height >= SLENDER * width
        straight &= float(np.ptp(arm @ axis)) >= SPREAD * height
        if not straight or width >= asked - sizes[1]:
            continue
        shift = (along.max() + along.min()) / 2.0 - (about - centre) @ axis
        found.append(
            Violation(
                rule="post",
                point_mm=place(about + shift * axis),
                measured=width,
                asked=asked,
                unit="mm",
                fix=f"a post {height:.1f} mm high; make it thicker or shorter",
            )
        )
    return found


def _walls(
    tree: RayTree, samples: Samples, width_mm: FloatArray, rules: PrintSection, sizes: Sizes
) -> list[Violation]:
    thin = width_mm < max(rules.wall_min_mm, rules.wall_free_min_mm) - sizes[1]
    samples, width_mm = samples.some(thin), width_mm[thin]
    middle = samples.point_mm - (width_mm / 2.0)[:, None] * samples.normal
    label = _label(tree, samples, middle, width_mm, sizes)
    count = int(label.max(initial=-1)) + 1
    # Each region speaks through the sample nearest to the middle of its thinnest part.
    least, spoken = np.zeros(count), np.zeros(count, dtype=np.int64)
    for k in range(count):
        own = np.flatnonzero(label == k)
        least[k] = width_mm[own].min()
        part = own[width_mm[own] < least[k] + sizes[1]]
        centre = np.average(middle[part], axis=0, weights=samples.area_mm2[part])
        spoken[k] = part[np.argmin(np.linalg.norm(middle[part] - centre, axis=1))]
    low = _shallow(tree, samples, middle, width_mm, label)
    least[low & (least >= rules.emboss_min_mm)] = np.inf
    free = (least >= rules.wall_min_mm - sizes[1]) & np.isfinite(least)
    free[free] = free_walls(
        tree, middle[spoken[free]], samples.normal[spoken[free]], width_mm[spoken[free]]
    )
    too_thin = least < rules.wall_min_mm - sizes[1]
    return [
        Violation(
            rule="wall" if too_thin[k] else "free wall",
            point_mm=place(middle[spoken[k]]),
            measured=float(least[k]),
            asked=rules.wall_min_mm if too_thin[k] else rules.wall_free_min_mm,
            unit="mm",
            fix="make the wall thicker" + ("" if too_thin[k] else ", or hold it at a second edge"),
        )
        for k in np.flatnonzero(too_thin | free)
    ]


def _holes(
    tree: RayTree, samples: Samples, width_mm: FloatArray, rules: PrintSection, sizes: Sizes
) -> list[Violation]:
    small = width_mm < rules.hole_min_mm - sizes[1]
    samples, width_mm = samples.some(small), width_mm[small]
    middle = samples.point_mm + (width_mm / 2.0)[:, None] * samples.normal
    label = _label(tree, samples, middle, width_mm, sizes)
    found = []
    for k in range(label.max(initial=-1) + 1):
        own = label == k
        corners, axis = _run(tree, samples.some(own), longest=False)
        width = float(np.median(width_mm[own]))
        if float(np.ptp(corners @ axis)) < SHALLOW * width and width >= rules.emboss_min_mm:
            continue
        found.append(
            Violation(
                rule="hole",
                point_mm=place(np.average(middle[own], axis=0, weights=samples.area_mm2[own])),
                measured=width,
                asked=rules.hole_min_mm,
                unit="mm",
                fix="widen the hole",
            )
        )
    return found


def _gaps(
    tree: RayTree, samples: Samples, width_mm: FloatArray, rules: PrintSection, sizes: Sizes
) -> list[Violation]:
    close = width_mm < rules.gap_min_mm - sizes[1]
    samples, width_mm = samples.some(close), width_mm[close]
    middle = samples.point_mm + (width_mm / 2.0)[:, None] * samples.normal
    label = _label(tree, samples, middle, width_mm, sizes)
    low = _shallow(tree, samples, middle, width_mm, label)
    found = []
    for k in range(len(low)):
        own = label == k
        least = float(width_mm[own].min())
        if low[k] and least >= rules.emboss_min_mm:
            continue
        found.append(
            Violation(
                rule="gap",
                point_mm=place(np.average(middle[own], axis=0, weights=samples.area_mm2[own])),
                measured=least,
                asked=rules.gap_min_mm,
                unit="mm",
                fix="move the features apart, or join them",
            )
        )
    return found


def _label(
    tree: RayTree, samples: Samples, middle: FloatArray, width_mm: FloatArray, sizes: Sizes
) -> IntArray:
    """Region of each thin place; triangles join them only where they are as thin themselves."""
    corners = tree.corners[samples.triangle]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    breadth = 2.0 * tree.area_mm2[samples.triangle] / np.maximum(longest, 1e-300)
    ids = tree.triangles[samples.triangle].copy()
    wide = np.flatnonzero(breadth > width_mm)
    ids[wide] = -1 - wide[:, None]
    return regions(middle, width_mm, ids, 2.0 * sizes[0])


def _run(tree: RayTree, samples: Samples, *, longest: bool) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 3) of the sides of a post or hole, and its axis: square to all their normals.

    Where all normals are alike, the corners' longest or shortest way across them is the axis.
    """
    corners = tree.corners[samples.triangle].reshape(-1, 3)
    _, size, rows = np.linalg.svd(samples.normal, full_matrices=True)
    if len(size) > 1 and size[1] > ROUND * size[0]:
        return corners, rows[2]
    flat = (corners - corners.mean(axis=0)) @ rows[1:].T
    across = np.linalg.svd(flat, full_matrices=True)[2] @ rows[1:]
    return corners, across[0 if longest else 1]


def _shallow(
    tree: RayTree, samples: Samples, middle: FloatArray, width_mm: FloatArray, label: IntArray
) -> BoolArray:
    """Whether each region (k,) is a low ridge or a shallow groove: its foot is always near."""
    near = np.full(len(label), np.inf)
    first, second = frame(samples.normal)
    for k in range(2 * LINES):
        angle = np.pi * k / LINES
        way = np.cos(angle) * first + np.sin(angle) * second
        near = np.minimum(near, tree.cast(middle, way, SHALLOW * width_mm).distance_mm)
    low = np.ones(int(label.max(initial=-1)) + 1, dtype=np.bool_)
    np.logical_and.at(low, label, np.isfinite(near))
    return low
