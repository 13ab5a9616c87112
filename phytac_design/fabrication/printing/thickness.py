"""Walls, posts, holes and gaps of any body, measured by rays from points on its faces.

From each point a ray goes into the body, square to the face, and another one out of it, to the
face across. Half-way, four lines parallel to the face classify the place: material that is also
narrow along one of them is a post, such air is a hole; the rest is a wall, or a gap.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.surface_samples import SurfaceSamples, regions
from phytac_design.fabrication.printing.violations import Violation, violation
from phytac_design.geometry.ray_tree import RayTree, START_mm
from phytac_design.geometry.triangles import frames_along
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SHALLOW = 2.0
"""What is less high or deep than this many times its width is a detail, not a wall or a hole."""
LINES = 4


@dataclass(frozen=True, kw_only=True)
class ThinPlaces:
    """Places (n,) where material (``side`` -1) or air (1) is thin.

    Attributes
    ----------
    samples : Samples
        Points on the face, one for each place.
    width_mm : (n,) float
        Thickness there.
    middle_mm : (n, 3) float
        Points half-way across.
    """

    tree: RayTree
    samples: SurfaceSamples
    width_mm: FloatArray
    side: float

    @property
    def middle_mm(self) -> FloatArray:
        """Points half-way across, (n, 3)."""
        half = self.side * self.width_mm / 2.0
        return self.samples.point_mm + half[:, None] * self.samples.normal

    def some(self, which: BoolArray) -> "ThinPlaces":
        """Places of an index."""
        return replace(self, samples=self.samples.some(which), width_mm=self.width_mm[which])

    def centre_mm(self) -> FloatArray:
        """Mean of the middles, weighted by area, (3,)."""
        return np.asarray(np.average(self.middle_mm, axis=0, weights=self.samples.area_mm2))

    def regions(self, spacing_mm: float) -> IntArray:
        """Region of each place; triangles join them only where they are as thin themselves."""
        tree, triangle = self.tree, self.samples.triangle
        corners = tree.corners[triangle]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        breadth = 2.0 * tree.area_mm2[triangle] / np.maximum(sides.max(axis=1, initial=0.0), 1e-300)
        ids = tree.triangles[triangle].copy()
        wide = np.flatnonzero(breadth > self.width_mm)
        ids[wide] = -1 - wide[:, None]
        return regions(self.middle_mm, self.width_mm, ids, 2.0 * spacing_mm)

    def split(self, spacing_mm: float) -> "list[ThinPlaces]":
        """Places of each region."""
        label = self.regions(spacing_mm)
        return [self.some(label == k) for k in range(label.max(initial=-1) + 1)]

    def shallow(self) -> bool:
        """Whether this is a low ridge or a shallow groove: its foot is near everywhere."""
        middle, near = self.middle_mm, np.full(len(self.width_mm), np.inf)
        for way in _around(self.samples.normal, 2 * LINES, 2.0 * np.pi):
            reach = SHALLOW * self.width_mm
            near = np.minimum(near, self.tree.cast(middle, way, reach).distance_mm)
        return bool(np.isfinite(near).all())

    def axis(self, *, longest: bool) -> tuple[FloatArray, FloatArray]:
        """Corners (k, 3) of the sides of a post or hole, and its axis: square to all normals.

        Where all normals are alike, the corners' longest or shortest extent across them is the
        axis.
        """
        # Least share of normals that look another way, for their common axis to be known.
        round_share = 0.2
        corners = self.tree.corners[self.samples.triangle].reshape(-1, 3)
        _, size, rows = np.linalg.svd(self.samples.normal, full_matrices=True)
        if len(size) > 1 and size[1] > round_share * size[0]:
            return corners, rows[2]
        flat = (corners - corners.mean(axis=0)) @ rows[1:].T
        across = np.linalg.svd(flat, full_matrices=True)[2] @ rows[1:]
        return corners, across[0 if longest else 1]


def check_thickness(
    tree: RayTree,
    samples: SurfaceSamples,
    rules: PrintSection,
    *,
    spacing_mm: float,
    tolerance_mm: float,
    known: BoolArray,
) -> tuple[list[Violation], float]:
    """Find thin walls, slender posts, small holes and narrow gaps.

    Parameters
    ----------
    tree : RayTree
        The body, closed.
    samples : Samples
        Points on its faces.
    spacing_mm : float
        Approximate distance between them.
    tolerance_mm : float
        Distance of the facets from the true faces: a smaller shortfall is no violation.
    known : (n,) bool
        Points on features whose walls, posts and holes are known from the design.

    Returns
    -------
    violations : list of Violation
        One for each region.
    wall_mm : float
        Thinnest wall that was met; inf if none is thinner than the rays' limit.
    """
    limit = max(rules.wall_min_mm, rules.wall_free_min_mm, rules.post_tall_mm[0])
    samples, tol = samples.some(~known), tolerance_mm
    posts, walls = _thin_places(tree, samples, -1.0, limit, max(rules.wall_min_mm, tol))
    found = _posts(posts.split(spacing_mm), rules, tol)
    thin = walls.width_mm < max(rules.wall_min_mm, rules.wall_free_min_mm) - tol
    found += _walls(walls.some(thin).split(spacing_mm), rules, tol)
    limit = max(rules.hole_min_mm, rules.gap_min_mm)
    holes, gaps = _thin_places(tree, samples, 1.0, limit, rules.gap_min_mm)
    small, close = (
        item.some(item.width_mm < least - tol).split(spacing_mm)
        for item, least in ((holes, rules.hole_min_mm), (gaps, rules.gap_min_mm))
    )
    found += _holes(small, rules) + _gaps(close, rules)
    return found, float(walls.width_mm.min(initial=np.inf))


def _around(normal: FloatArray, count: int, angle: float = np.pi) -> Iterator[FloatArray]:
    """Directions (n, 3) square to normals, ``count`` of them over an angle."""
    first, second, _ = np.moveaxis(frames_along(normal), 2, 0)
    for turn in angle * np.arange(count) / count:
        yield np.cos(turn) * first + np.sin(turn) * second


def _thin_places(
    tree: RayTree, samples: SurfaceSamples, side: float, limit_mm: float, required_mm: float
) -> tuple[ThinPlaces, ThinPlaces]:
    """Thin places inward (side -1) or outward (1): narrow both ways, and only one way."""
    # Minimum cosine between ray and face across for walls and gaps: wider wedges are edges.
    parallel = 0.985
    # A wall or gap that tapers to nothing within this many times the required width is an edge.
    taper = 2.0
    # Least cosine between a ray and the face across, for that face to be the other side.
    facing = 0.85
    way = side * samples.normal
    hits = tree.cast(samples.point_mm + START_mm * way, way, limit_mm)
    # Inward, a ray leaves the body at the face across; outward it enters there.
    cosine = -side * np.einsum("ni,ni->n", tree.normal[hits.triangle], way)
    thin = (hits.triangle >= 0) & (cosine >= facing)
    width, cosine = hits.distance_mm[thin] + START_mm, cosine[thin]
    places = ThinPlaces(tree=tree, samples=samples.some(thin), width_mm=width, side=side)
    narrow = _narrow(places)
    slope = np.sqrt(np.clip(1.0 - cosine**2, 1e-18, 1.0)) / cosine
    flat = ~narrow & (cosine >= parallel) & (width >= taper * required_mm * slope)
    return places.some(narrow), places.some(flat)


def _narrow(places: ThinPlaces) -> BoolArray:
    """Whether a thin place is about as narrow along one of four lines parallel to the face."""
    # Width across over thickness up to which a thin place is a post or a hole.
    ratio = 1.6
    tree, middle, widest = places.tree, places.middle_mm, ratio * places.width_mm
    narrow = np.zeros(len(widest), dtype=np.bool_)
    for way in _around(places.samples.normal, LINES):
        ahead = tree.cast(middle, way, widest).distance_mm
        near = np.flatnonzero(np.isfinite(ahead))
        back = tree.cast(middle[near], -way[near], widest[near]).distance_mm
        narrow[near] |= ahead[near] + back <= widest[near]
    return narrow


def _posts(posts: list[ThinPlaces], rules: PrintSection, tol: float) -> list[Violation]:
    # Share of a post's height over which it must have been met: each side has two triangles.
    spread = 0.25
    slender = 2.0  # a post is at least this many times as high as thick
    found = []
    for post in posts:
        middle = post.middle_mm
        corners, axis = post.axis(longest=True)
        centre = corners.mean(axis=0)
        along = (corners - centre) @ axis
        height = float(np.ptp(along))
        width = float(np.median(post.width_mm))
        required = rules.post_diameter_mm(height)
        about = middle.mean(axis=0)
        arm = middle - about
        off = np.linalg.norm(arm - np.outer(arm @ axis, axis), axis=1)
        straight = off.max() < width and height >= slender * width
        straight &= float(np.ptp(arm @ axis)) >= spread * height
        if not straight or width >= required - tol:
            continue
        shift = (along.max() + along.min()) / 2.0 - (about - centre) @ axis
        fix = f"a post {height:.1f} mm high; make it thicker or shorter"
        found.append(violation("post", about + shift * axis, width, required, fix))
    return found


def _walls(walls: list[ThinPlaces], rules: PrintSection, tol: float) -> list[Violation]:
    found = []
    for wall in walls:
        least = float(wall.width_mm.min())
        if least >= rules.emboss_min_mm and wall.shallow():
            continue
        # The sample nearest to the middle of the thinnest part stands for the region.
        thinnest = wall.some(wall.width_mm < least + tol)
        away = np.linalg.norm(thinnest.middle_mm - thinnest.centre_mm(), axis=1)
        place = thinnest.some(np.arange(len(away)) == away.argmin())
        middle, normal = place.middle_mm, place.samples.normal
        rule, required, fix = "wall", rules.wall_min_mm, "make the wall thicker"
        if least >= rules.wall_min_mm - tol:
            if not free_walls(wall.tree, middle, normal, place.width_mm)[0]:
                continue
            rule, required = "free wall", rules.wall_free_min_mm
            fix += ", or hold it at a second edge"
        found.append(violation(rule, middle[0], least, required, fix))
    return found


def _holes(holes: list[ThinPlaces], rules: PrintSection) -> list[Violation]:
    found = []
    for hole in holes:
        corners, axis = hole.axis(longest=False)
        width = float(np.median(hole.width_mm))
        if float(np.ptp(corners @ axis)) >= SHALLOW * width or width < rules.emboss_min_mm:
            middle = hole.centre_mm()
            found.append(violation("hole", middle, width, rules.hole_min_mm, "widen the hole"))
    return found


def _gaps(gaps: list[ThinPlaces], rules: PrintSection) -> list[Violation]:
    fix = "move the features apart, or join them"
    return [
        violation("gap", gap.centre_mm(), gap.width_mm.min(), rules.gap_min_mm, fix)
        for gap in gaps
        if gap.width_mm.min() < rules.emboss_min_mm or not gap.shallow()
    ]


def free_walls(
    tree: RayTree, middle_mm: FloatArray, normal: FloatArray, width_mm: FloatArray
) -> BoolArray:
    """Whether walls (n,) are held at fewer than two of the edges that four walks along them meet.

    Parameters
    ----------
    middle_mm, normal : (n, 3) float
        A point half-way through each wall, and the direction across it.
    width_mm : (n,) float
        Thickness there.
    """
    edges = 2  # edges at which a wall must be held to count as supported
    held = 2.0  # where the body is this many times thicker than the wall, the wall is held
    # A wall longer than so many steps (around a tube, for example) counts as held there.
    steps = 300
    step = 0.5  # steps of a walk over the wall's thickness: it follows bends of that radius
    count = len(middle_mm)
    if count == 0:
        return np.zeros(0, dtype=np.bool_)
    first, second, _ = np.moveaxis(frames_along(normal), 2, 0)
    way = np.concatenate([first, second, -first, -second])
    point, across = np.tile(middle_mm, (4, 1)), np.tile(normal, (4, 1))
    width = np.tile(width_mm, 4)
    ended = np.zeros(4 * count, dtype=np.bool_)
    going = np.arange(4 * count)
    for _ in range(steps):
        ahead = point[going] + step * width[going, None] * way[going]
        up, down = tree.cast(ahead, across[going]), tree.cast(ahead, -across[going])
        inside = up.triangle >= 0
        inside &= np.einsum("ni,ni->n", tree.normal[up.triangle], across[going]) > 0.0
        ended[going[~inside]] = True
        thick = up.distance_mm + down.distance_mm
        on = inside & (thick < held * width[going])
        shift = (up.distance_mm[on] - down.distance_mm[on]) / 2.0
        kept = going[on]
        point[kept] = ahead[on] + shift[:, None] * across[kept]
        turned = tree.normal[up.triangle[on]]
        across[kept] = turned
        flat = way[kept] - np.einsum("ni,ni->n", way[kept], turned)[:, None] * turned
        way[kept] = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)
        going = kept
        if going.size == 0:
            break
    return np.asarray((~ended).reshape(4, count).sum(axis=0) < edges)
