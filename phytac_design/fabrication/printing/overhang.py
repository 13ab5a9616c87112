"""Overhangs and supports of a body in a build direction, and the search for a good one."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.surface_samples import patches
from phytac_design.fabrication.printing.voids import cups, upright
from phytac_design.geometry.ray_tree import RayTree, START_mm
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError

TURNS_deg = np.arange(0.0, 90.0, 5.0)
"""Turns on the bed."""


@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Figures of a body printed in one direction.

    Attributes
    ----------
    up : (3,) tuple of float
        Build direction in the body's frame.
    height_mm : float
        Height of the print.
    footprint_mm : (2,) tuple of float
        Its sides on the bed, turned for the best fit.
    fits : bool
        Whether it fits the bed.
    overhang_area_mm2 : float
        Area of the faces that need supports.
    support_volume_mm3 : float
        Space between them and what lies below.
    cup_count : int
        Hollows that hold resin as it stands.
    cost : float
        Overhang, supports and height, each over its median of all directions.
    """

    up: tuple[float, float, float]
    height_mm: float
    footprint_mm: tuple[float, float]
    fits: bool
    overhang_area_mm2: float
    support_volume_mm3: float
    cup_count: int
    cost: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the report."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Overhang:
    """A connected part of the surface that needs supports: middle (mm), area, least slope."""

    point_mm: tuple[float, float, float]
    area_mm2: float
    slope_deg: float


def directions() -> FloatArray:
    """Build directions (n, 3), evenly over the sphere (Fibonacci), the axes first."""
    directions = 150  # build directions of the coarse search, besides those along the axes
    number = np.arange(directions)
    z = 1.0 - (2.0 * number + 1.0) / directions
    angle = np.pi * (3.0 - np.sqrt(5.0)) * number
    around = np.sqrt(1.0 - z**2)
    ball = np.column_stack([around * np.cos(angle), around * np.sin(angle), z])
    axes = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return np.concatenate([axes.astype(np.float64), ball])


def overhanging(tree: RayTree, up: FloatArray, rules: PrintSection) -> IntArray:
    """Triangles (k,) that look down and lie flatter than the rule, but for those on the bed."""
    on_bed_mm = 0.02  # faces so near to the bed stand on it
    chosen = np.flatnonzero(tree.normal @ -up > np.cos(np.radians(rules.overhang_deg)) + 1e-9)
    if chosen.size == 0:
        return chosen
    height = (tree.corners[chosen] @ up).max(axis=1)
    return np.asarray(chosen[height >= tree.lowest_mm(up) + on_bed_mm])


def overhangs(
    mesh: TriangleMesh, tree: RayTree, up: FloatArray, rules: PrintSection
) -> list[Overhang]:
    """Connected overhanging parts of a welded mesh, largest first."""
    own = overhanging(tree, up, rules)
    label = np.full(len(mesh.triangles), -1)
    label[own] = patches(mesh, own)
    count = int(label.max(initial=-1)) + 1
    area = np.bincount(label[own], tree.area_mm2[own], count)
    middle = _moments(tree, own, label[own], count) / np.maximum(area, 1e-300)[:, None]
    slope = np.degrees(np.arccos(np.clip(-(tree.normal[own] @ up), -1.0, 1.0)))
    least = np.full(count, 90.0)
    np.minimum.at(least, label[own], slope)
    return [
        Overhang(point_mm=middle[k].tolist(), area_mm2=float(area[k]), slope_deg=float(least[k]))
        for k in np.argsort(-area, kind="stable")
    ]


def support_volume_mm3(tree: RayTree, up: FloatArray, rules: PrintSection) -> float:
    """Space under overhangs, down to the body itself or the bed."""
    chosen = overhanging(tree, up, rules)
    chosen = chosen[tree.area_mm2[chosen] > 1e-9]
    if chosen.size == 0:
        return 0.0
    middle = tree.corners[chosen].mean(axis=1)
    down = np.tile(-up, (len(chosen), 1))
    bed = middle @ up - tree.lowest_mm(up)
    drop = np.minimum(tree.cast(middle + START_mm * down, down).distance_mm, bed)
    return float(np.sum(drop * tree.area_mm2[chosen] * -(tree.normal[chosen] @ up)))


def stand(
    mesh: TriangleMesh, tree: RayTree, up: FloatArray, rules: PrintSection, *, cost: float = 0.0
) -> Orientation:
    """Figures of one direction."""
    hull = mesh.vertices_mm[ConvexHull(mesh.vertices_mm).vertices]
    height, sides, fits = on_bed(hull, up, rules)
    return Orientation(
        up=(float(up[0]), float(up[1]), float(up[2])),
        height_mm=height,
        footprint_mm=sides,
        fits=fits,
        overhang_area_mm2=float(tree.area_mm2[overhanging(tree, up, rules)].sum()),
        support_volume_mm3=support_volume_mm3(tree, up, rules),
        cup_count=len(cups(mesh, up, rules)) if rules.process == "sla" else 0,
        cost=cost,
    )


def _moments(tree: RayTree, triangle: IntArray, label: IntArray, count: int) -> FloatArray:
    """Area times middle of triangles (k,), summed by their label, (count, 3)."""
    middle = tree.area_mm2[triangle, None] * tree.corners[triangle].mean(axis=1)
    return np.stack([np.bincount(label, middle[:, k], count) for k in range(3)], axis=1)


def on_bed(
    hull_mm: FloatArray, up: FloatArray, rules: PrintSection
) -> tuple[float, tuple[float, float], bool]:
    """Height, sides on the bed in the turn that fits best, and whether they fit."""
    local = hull_mm @ upright(up).T
    angle = np.radians(TURNS_deg)
    x = local[:, :1] * np.cos(angle) - local[:, 1:2] * np.sin(angle)
    y = local[:, :1] * np.sin(angle) + local[:, 1:2] * np.cos(angle)
    sides = np.stack([np.ptp(x, axis=0), np.ptp(y, axis=0)], axis=1)
    bed = np.array(rules.bed_mm)
    height = float(np.ptp(local[:, 2]))
    both = np.concatenate([sides, sides[:, ::-1]])
    over = (both / bed[:2]).max(axis=1)
    k = int(np.argmin(over))
    fits = over[k] <= 1.0 + 1e-9 and height <= bed[2] * (1.0 + 1e-9)
    return height, (float(both[k, 0]), float(both[k, 1])), bool(fits)


def suggest(mesh: TriangleMesh, tree: RayTree, rules: PrintSection) -> tuple[Orientation, int]:
    """Return the direction with least overhang, supports and height, and how many were tried.

    Directions in which the body fits the bed come first, then those without cups, then the cost.
    """
    finalists = 40  # cheapest directions that are searched for one without cups
    ups = directions()
    if len(mesh.vertices_mm) < 4:
        raise NumericalError(
            "body-without-volume",
            f"a body without volume cannot be printed (got {len(mesh.vertices_mm)} corners); "
            "check the mesh",
        )
    hull = mesh.vertices_mm[ConvexHull(mesh.vertices_mm).vertices]
    figures = np.zeros((len(ups), 3))
    # In a ball that is no wider than the bed's shortest side the body fits in any direction.
    small = 2.0 * np.linalg.norm(hull - hull.mean(axis=0), axis=1).max() <= min(rules.bed_mm)
    fits = np.array([small or on_bed(hull, up, rules)[2] for up in ups])
    middles = tree.corners.mean(axis=1)
    for k, up in enumerate(ups):
        own, heights = overhanging(tree, up, rules), hull @ up
        # Supports as if all stood on the bed: a bound, and a fair measure between directions.
        support = -(tree.normal[own] @ up) * (middles[own] @ up - heights.min())
        area = tree.area_mm2[own]
        figures[k] = area.sum(), (area * support).sum(), np.ptp(heights)
    typical = np.median(figures, axis=0)
    cost = (figures / np.where(typical > 0.0, typical, 1.0)).sum(axis=1)
    pool = np.flatnonzero(fits) if fits.any() else np.arange(len(ups))
    best = pool[np.argsort(cost[pool], kind="stable")]
    chosen = best[0]
    if rules.process == "sla":
        chosen = next((k for k in best[:finalists] if not cups(mesh, ups[k], rules)), chosen)
    return stand(mesh, tree, ups[chosen], rules, cost=float(cost[chosen])), len(ups)
