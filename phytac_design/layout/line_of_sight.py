r"""Line-of-sight heights: the smallest at which no receptor hides another from the camera.

The camera should see the painted part of a receptor: the end face and the band below it. A nearer
receptor hides it with its whole tube. Both are convex hulls of two discs, and stay convex in the
picture; the gap between two convex outlines is the largest one along any direction::

       wall ______________________________________        gap: measured in the picture, given in
             | |      | |       |#|  <- painted band      mm at the depth of the receptor that
             |_|      | |       |#|                       is looked at
                      |_|    .-´               (from the camera, at the left)
       camera ◁  . - ´  ^ gap

Heights are assigned from near to far: a receptor is hidden by nearer ones only. The wall is not
considered here; the visibility check renders it.

With two cameras, each has to see the receptors that are nearest to it. In the order of distance to
the own camera, every possible occluder has its height already. Where the two halves meet, a
receptor also keeps clear of the assigned receptors of the other half in their camera's picture:
just behind them, and no taller, its paint would merge with theirs.

Under load receptors move and lean. Given their motions under a set of presses, heights are assigned
again with a larger margin at rest where a press reduces the gap, until the margin holds in every
press within ``load_tolerance_mm``. These heights are near the smallest ones, not exactly equal.
"""

from dataclasses import dataclass, replace

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.markers import Markers
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class LineOfSightSettings:
    """Numbers of the search, chosen so that heights are converged to about 0.01 mm."""

    directions: int = 64
    """Directions in the picture along which outlines are separated; few make gaps too small."""
    circle_sides: int = 24
    height_steps: int = 33
    """Equal steps on which heights are searched."""
    bisections: int = 8
    """Halvings of the step below the first height that is clear."""
    depth_min_mm: float = 1e-3
    load_tolerance_mm: float = 0.005
    load_iterations: int = 12


SETTINGS = LineOfSightSettings()


class _Outlines:
    """Outlines of tubes in the picture of a camera that looks along the axis at the sensor.

    An outline is given by its support along ``SETTINGS.directions`` directions (D), in units
    of the distance from the camera (tangents of the angle from the axis).
    """

    def __init__(self, design: Design, markers: Markers, camera_mm: FloatArray) -> None:
        self.radius = design.receptor.diameter_outer_mm / 2.0
        self.tube = design.receptor.diameter_tube_mm / 2.0
        self.band = design.receptor.band_marker_mm
        self.markers = markers
        self.camera = np.asarray(camera_mm, dtype=np.float64)
        # A camera beyond the far end looks back.
        back = float(np.median(markers.base_mm[:, 2])) < float(self.camera[2])
        self.sign = -1.0 if back else 1.0
        turn = 2.0 * np.pi * np.arange(SETTINGS.directions) / SETTINGS.directions
        self.along = np.stack([np.cos(turn), np.sin(turn)])
        axis = markers.direction
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(axis, first)
        around = 2.0 * np.pi * np.arange(SETTINGS.circle_sides) / SETTINGS.circle_sides
        # The polygon lies around the circle: outlines are never too small.
        size = self.radius / np.cos(np.pi / SETTINGS.circle_sides)
        self.ring = size * (
            np.cos(around)[:, None] * first[:, None] + np.sin(around)[:, None] * second[:, None]
        )

    def _disc(self, ids: IntArray, depth: FloatArray, wider: float = 1.0) -> FloatArray:
        """Support (m, h, D) of discs at depths (m, h) along the axes from the bases.

        They are ``wider`` times as wide as the markers.
        """
        axis = self.markers.direction[ids]
        centre = self.markers.base_mm[ids][:, None] + depth[..., None] * axis[:, None]
        points = centre[:, :, None] + wider * self.ring[ids][:, None] - self.camera
        ahead = self.sign * points[..., 2:]
        if float(ahead.min()) <= SETTINGS.depth_min_mm:
            raise DesignError(
                "receptor-behind-camera",
                "line-of-sight heights need all receptors in front of the camera (one reaches "
                f"{-ahead.min():.2f} mm behind its plane); raise camera.stand_off_mm or set "
                "layout.heights to 'linear'",
            )
        return np.asarray((points[..., :2] / ahead @ self.along).max(axis=2))

    def tubes(self, ids: IntArray, height: FloatArray) -> FloatArray:
        """Support (m, D) of whole tubes of heights (m,)."""
        ends = np.stack([np.zeros_like(height), height], axis=1)
        support = self._disc(ids, ends).max(axis=1)
        if self.tube > self.radius:
            # Around inserts, all but the coloured band is wider.
            ends[:, 1] = np.maximum(height - self.band, 0.0)
            wide = self._disc(ids, ends, self.tube / self.radius).max(axis=1)
            support = np.maximum(support, wide)
        return np.asarray(support)

    def paints(self, ids: IntArray, height: FloatArray) -> FloatArray:
        """Support (m, h, D) of painted parts at heights (m, h)."""
        return np.maximum(
            self._disc(ids, height), self._disc(ids, np.maximum(height - self.band, 0.0))
        )

    def depth(self, ids: IntArray) -> FloatArray:
        """Distance of bases from the camera's plane, (m,) mm."""
        return np.asarray(self.sign * (self.markers.base_mm[ids, 2] - self.camera[2]))


def _gaps(paint: FloatArray, tubes: FloatArray) -> FloatArray:
    """Gap (h, j) between painted parts (h, D) and tubes (j, D), in the picture."""
    half = SETTINGS.directions // 2
    # min over the paint of n·x is minus its support along -n.
    least = -np.roll(paint, half, axis=-1)
    return np.asarray((least[:, None] - tubes[None]).max(axis=2))


def _box(support: FloatArray) -> FloatArray:
    """[-x0, -y0, x1, y1] of outlines (..., D): bounds, lower ones with their sign turned."""
    quarter = SETTINGS.directions // 4
    return support[..., [2 * quarter, 3 * quarter, 0, quarter]]


def _near(paint: FloatArray, tubes: FloatArray, margin: float) -> IntArray:
    """Tubes whose box comes within ``margin`` of the box of any of the painted parts."""
    own, other = _box(paint).max(axis=0), _box(tubes)
    apart = -np.roll(own, 2) - other  # own low end against the other's high end, and so on
    return np.flatnonzero((apart < margin).all(axis=1))


def _groups(markers: Markers) -> list[IntArray]:
    """Markers that share one height: a row of the lattice, else each its own."""
    if not markers.in_rows:
        return [np.array([marker]) for marker in range(markers.count)]
    return [np.flatnonzero(markers.row == row) for row in np.unique(markers.row)]


def _away(markers: Markers, groups: list[IntArray], cameras_mm: FloatArray) -> FloatArray:
    """Mean distance (c, g) of groups from cameras (c, 3)."""
    away = np.linalg.norm(markers.base_mm - cameras_mm[:, None], axis=2)
    return np.array([[float(own[ids].mean()) for ids in groups] for own in away])


def nearest_camera(markers: Markers, cameras_mm: FloatArray) -> IntArray:
    """Number (n,) of the camera, of (c, 3), that is nearest to each marker's row."""
    groups = _groups(markers)
    nearest = _away(markers, groups, np.atleast_2d(cameras_mm)).argmin(axis=0)
    out = np.zeros(markers.count, dtype=np.int64)
    for ids, camera in zip(groups, nearest, strict=True):
        out[ids] = camera
    return out


def sight_heights_mm(
    design: Design,
    markers: Markers,
    camera_mm: FloatArray,
    *,
    motions: FloatArray | None = None,
) -> FloatArray:
    """Smallest heights (n,) at which all nearer receptors leave each painted part visible.

    From near to far, each row (each marker, where there are no rows) takes the smallest height from
    ``height_near_mm`` up at which ``sight_margin_mm`` stays clear beside its painted part.

    Parameters
    ----------
    design : Design
        Its layout's heights bound the search.
    markers : Markers
        Their heights are not used.
    camera_mm : (3,) float or (c, 3) float
        Centre of the camera, which looks along the sensor axis at it; of several, each sees the
        receptors nearest to it (:func:`nearest_camera`).
    motions : (p, n, 6) float, optional
        Translation (mm) and rotation (rad) of the middle face under each marker for p presses:
        the margin also holds under each of these.

    Raises
    ------
    DesignError
        If a row would have to be taller than ``height_far_mm``.
    """
    margin = design.layout.sight_margin_mm
    needed = np.full(markers.count, margin)
    heights = _least_heights(design, markers, camera_mm, needed)
    if motions is None:
        return heights
    for _ in range(SETTINGS.load_iterations):
        trial = replace(markers, height_mm=heights)
        short = margin - clearance_under_load_mm(design, trial, camera_mm, motions)
        if float(short.max()) <= SETTINGS.load_tolerance_mm:
            return heights
        needed += np.maximum(short, 0.0)
        try:
            heights = _least_heights(design, markers, camera_mm, needed)
        except DesignError as error:
            text = f"with the wall pressed in {error}, or layout.sight_dent_mm"
            raise DesignError(error.code, text) from None
    worst = int(short.argmax())
    raise DesignError(
        "no-heights-under-load",
        f"no heights keep {margin:g} mm clear under load ({markers.place(worst)} keeps "
        f"{margin - short[worst]:.2f} mm); lower layout.sight_margin_mm or layout.sight_dent_mm, "
        "or use fewer markers",
    )


class _HeightSearch:
    """Groups of receptors whose heights are assigned one after the other, in every picture."""

    def __init__(self, design: Design, markers: Markers, cameras_mm: FloatArray) -> None:
        self.groups = _groups(markers)
        self.pictures = [_Outlines(design, markers, camera) for camera in cameras_mm]
        self.away = _away(markers, self.groups, cameras_mm)
        # Rank of each group, and of each marker, by distance from a camera.
        self.order = np.argsort(np.argsort(self.away, axis=1, kind="stable"), axis=1)
        self.place = np.zeros((len(cameras_mm), markers.count), dtype=np.int64)
        for number, ids in enumerate(self.groups):
            self.place[:, ids] = self.order[:, [number]]
        self.tubes = np.zeros((len(cameras_mm), markers.count, SETTINGS.directions))
        self.done = np.zeros(markers.count, dtype=bool)

    def slack(self, camera: int, number: int, height: FloatArray) -> FloatArray:
        """Least gap (m, h) of a group's painted parts to nearer tubes, as one camera sees it."""
        nearer = self.done & (self.place[camera] < self.order[camera, number])
        ids = self.groups[number]
        return _slack(self.pictures[camera], ids, height, self.tubes[camera, nearer])

    def assign(self, number: int, height: FloatArray) -> None:
        """Assign heights (m,) to a group's tubes."""
        ids = self.groups[number]
        self.done[ids] = True
        for tubes, picture in zip(self.tubes, self.pictures, strict=True):
            tubes[ids] = picture.tubes(ids, height)


def _least_heights(
    design: Design, markers: Markers, camera_mm: FloatArray, margin_mm: FloatArray
) -> FloatArray:
    """Smallest heights (n,) that keep each marker's margin (n,) at rest."""
    layout = design.layout
    search = _HeightSearch(design, markers, np.atleast_2d(camera_mm))
    away = search.away
    heights = np.full(markers.count, layout.height_near_mm)
    levels = np.linspace(
        layout.height_near_mm,
        max(layout.height_far_mm, layout.height_near_mm),
        SETTINGS.height_steps,
    )
    for number in np.argsort(away.min(axis=0), kind="stable"):
        group, own = search.groups[number], int(away[:, number].argmin())
        margin = margin_mm[group, None]
        grid = np.tile(levels, (len(group), 1))
        cameras_used, slack = [own], search.slack(own, number, grid) - margin
        for camera in (k for k in range(len(away)) if k != own):
            both = np.minimum(slack, search.slack(camera, number, grid) - margin)
            # The demand of the other camera is dropped if no height meets both.
            if (both >= 0.0).all(axis=0).any():
                cameras_used, slack = [*cameras_used, camera], both
        clear = np.flatnonzero((slack >= 0.0).all(axis=0))
        if clear.size == 0:
            level = int(slack.min(axis=0).argmax())
            marker = int(slack[:, level].argmin())
            best, wanted = float(slack[marker, level]), float(margin[marker, 0])
            raise DesignError(
                "receptors-always-hidden",
                f"receptors of {markers.place(int(group[0]))} are hidden by nearer ones at every "
                f"height up to {levels[-1]:g} mm (best clearance {best + wanted:.2f} mm, wanted "
                f"{wanted:.3g} mm); raise layout.height_far_mm, or lower "
                "layout.sight_margin_mm, receptor.band_marker_mm or the number of markers",
            )
        high = levels[clear[0]]
        if clear[0] > 0:
            low = levels[clear[0] - 1]
            for _ in range(SETTINGS.bisections):
                middle = (low + high) / 2.0
                trial = np.full((len(group), 1), middle)
                if all(
                    (search.slack(camera, number, trial) >= margin).all() for camera in cameras_used
                ):
                    high = middle
                else:
                    low = middle
        heights[group] = high
        search.assign(number, heights[group])
    return heights


def pressed_markers(markers: Markers, motion: FloatArray) -> Markers:
    """Bases and axes of markers moved by translations (mm) and small rotations (rad), (n, 6)."""
    shift, turn = motion[:, :3], motion[:, 3:]
    direction = markers.direction + np.cross(turn, markers.direction)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    below = np.linalg.norm(markers.base_mm - markers.mid_mm, axis=1, keepdims=True)
    base = markers.mid_mm + shift + below * direction
    tip = base + markers.height_mm[:, None] * direction
    return replace(markers, base_mm=base, direction=direction, tip_mm=tip)


def clearance_under_load_mm(
    design: Design, markers: Markers, camera_mm: FloatArray, motions: FloatArray
) -> FloatArray:
    """Least :func:`clearance_mm` (n,) at rest and under each of the motions (p, n, 6).

    Each marker is evaluated with the camera that is nearest to it at rest.
    """
    nearest = nearest_camera(markers, np.atleast_2d(camera_mm))
    least = clearance_mm(design, markers, camera_mm, nearest=nearest)
    for motion in motions:
        now = pressed_markers(markers, motion)
        least = np.minimum(least, clearance_mm(design, now, camera_mm, nearest=nearest))
    return least


def _slack(
    outlines: _Outlines, group: IntArray, height: FloatArray, tubes: FloatArray
) -> FloatArray:
    """Least gap (m, h) in mm between painted parts at heights (m, h) and assigned tubes."""
    out = np.full(height.shape, np.inf)
    if len(tubes) == 0 or len(group) == 0:
        return out
    paint, depth = outlines.paints(group, height), outlines.depth(group)
    for k in range(len(group)):
        # Gaps beyond one diameter are not needed.
        close = _near(paint[k], tubes, 2.0 * outlines.radius / depth[k])
        if close.size:
            out[k] = _gaps(paint[k], tubes[close]).min(axis=1) * depth[k]
    return out


def clearance_mm(
    design: Design,
    markers: Markers,
    camera_mm: FloatArray,
    *,
    nearest: IntArray | None = None,
) -> FloatArray:
    """Gap (n,) that the camera sees between each painted part and the nearer receptors, mm.

    Negative where it is hidden in part; inf where nothing nearer comes within a diameter. Of
    several cameras (c, 3) each marker's ``nearest`` (n,) counts.
    """
    cameras, groups = np.atleast_2d(camera_mm), _groups(markers)
    away = _away(markers, groups, cameras)
    seen_by = nearest_camera(markers, cameras) if nearest is None else nearest
    out = np.full(markers.count, np.inf)
    for number, camera in enumerate(cameras):
        outlines = _Outlines(design, markers, camera)
        tubes = np.zeros((0, SETTINGS.directions))
        for place in np.argsort(away[number], kind="stable"):
            group = groups[place]
            some = group[seen_by[group] == number]
            out[some] = _slack(outlines, some, markers.height_mm[some, None], tubes)[:, 0]
            tubes = np.concatenate([tubes, outlines.tubes(group, markers.height_mm[group])])
    return out
