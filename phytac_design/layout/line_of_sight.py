r"""Line-of-sight heights: the least at which no receptor hides another from the camera.

What the camera should see of a receptor is its painted part: the end face and the band below it.
What hides it is the whole tube of a nearer one. Both are the hull of two discs, and stay convex in
the picture; two convex outlines are apart by the greatest gap between them along any direction::

       wall ______________________________________        gap: measured in the picture, given in
             | |      | |       |#|  <- painted band      mm at the depth of the receptor that
             |_|      | |       |#|                       is looked at
                      |_|    .-´               (from the camera, at the left)
       camera ◁  . - ´  ^ gap

Heights are settled from near to far: a receptor is hidden by nearer ones only. The wall itself
is not considered here; the visibility check renders it.

Of several cameras each has to see the receptors that are nearer to it than to the others. Going
by the distance to the own camera, whatever can hide a receptor from it is then settled before:
what is nearer to that camera is no farther from its own. Where the halves meet, a receptor also
keeps clear of those of the other half that are settled, as their own camera sees them: just
behind them, and no taller, its paint would merge with theirs.

Under load receptors move and lean. Given their motions for a set of presses, heights are settled
again with more room at rest where a press takes some away, until all of it stays clear in every
one. (By less than ``LOAD_TOL_mm``; the heights are then near to the least, not the least.)
"""

from dataclasses import replace

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.markers import Markers
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

DIRECTIONS = 64
"""Directions in the picture along which outlines are kept apart; few make gaps too small."""
CIRCLE = 24
LEVELS = 33
HALVINGS = 8
"""Heights are searched on ``LEVELS`` steps, then the first that clears is halved this often."""
DEPTH_MIN_mm = 1e-3
STATIONARY_SHARE = 0.02
LOAD_TOL_mm = 0.005
LOAD_ROUNDS = 12


class _Outlines:
    """Outlines of tubes in the picture of a camera that looks along the axis at the sensor.

    An outline is its support: how far it reaches along each of ``DIRECTIONS`` directions, in
    units of the distance from the camera (tangents of the angle from the axis).
    """

    def __init__(self, design: Design, markers: Markers, camera_mm: FloatArray) -> None:
        self.radius = design.receptor.diameter_outer_mm / 2.0
        self.band = design.receptor.band_marker_mm
        self.markers = markers
        self.camera = np.asarray(camera_mm, dtype=np.float64)
        # A camera beyond the far end looks back.
        back = float(np.median(markers.foot_mm[:, 2])) < float(self.camera[2])
        self.sign = -1.0 if back else 1.0
        turn = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        self.along = np.stack([np.cos(turn), np.sin(turn)])
        axis = markers.direction
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(axis, first)
        around = 2.0 * np.pi * np.arange(CIRCLE) / CIRCLE
        # The polygon lies around the circle: outlines are never too small.
        size = self.radius / np.cos(np.pi / CIRCLE)
        self.ring = size * (
            np.cos(around)[:, None] * first[:, None] + np.sin(around)[:, None] * second[:, None]
        )

    def _disc(self, ids: IntArray, depth: FloatArray) -> FloatArray:
        """Support (m, h, D) of discs at depths (m, h) along the axes from the feet."""
        axis = self.markers.direction[ids]
        centre = self.markers.foot_mm[ids][:, None] + depth[..., None] * axis[:, None]
        points = centre[:, :, None] + self.ring[ids][:, None] - self.camera
        ahead = self.sign * points[..., 2:]
        if float(ahead.min()) <= DEPTH_MIN_mm:
            raise DesignError(
                "line-of-sight heights need all receptors in front of the camera (one reaches "
                f"{-ahead.min():.2f} mm behind its plane); raise camera.stand_off_mm or set "
                "layout.heights to 'linear'"
            )
        return np.asarray((points[..., :2] / ahead @ self.along).max(axis=2))

    def tubes(self, ids: IntArray, height: FloatArray) -> FloatArray:
        """Support (m, D) of whole tubes of heights (m,)."""
        ends = np.stack([np.zeros_like(height), height], axis=1)
        return np.asarray(self._disc(ids, ends).max(axis=1))

    def paints(self, ids: IntArray, height: FloatArray) -> FloatArray:
        """Support (m, h, D) of painted parts at heights (m, h)."""
        return np.maximum(
            self._disc(ids, height), self._disc(ids, np.maximum(height - self.band, 0.0))
        )

    def depth(self, ids: IntArray) -> FloatArray:
        """Distance of feet from the camera's plane, (m,) mm."""
        return np.asarray(self.sign * (self.markers.foot_mm[ids, 2] - self.camera[2]))


def _gaps(paint: FloatArray, tubes: FloatArray) -> FloatArray:
    """Gap (h, j) between painted parts (h, D) and tubes (j, D), in the picture."""
    half = DIRECTIONS // 2
    # min over the paint of n·x is minus its support along -n.
    least = -np.roll(paint, half, axis=-1)
    return np.asarray((least[:, None] - tubes[None]).max(axis=2))


def _box(support: FloatArray) -> FloatArray:
    """[-x0, -y0, x1, y1] of outlines (..., D): bounds, lower ones with their sign turned."""
    quarter = DIRECTIONS // 4
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


def _away(markers: Markers, groups: list[IntArray], eyes_mm: FloatArray) -> FloatArray:
    """Mean distance (c, g) of groups from cameras (c, 3)."""
    away = np.linalg.norm(markers.foot_mm - eyes_mm[:, None], axis=2)
    return np.array([[float(own[ids].mean()) for ids in groups] for own in away])


def nearest_eye(markers: Markers, eyes_mm: FloatArray) -> IntArray:
    """Number (n,) of the camera that has to see each marker: of (c, 3) the one nearest its row."""
    groups = _groups(markers)
    nearest = _away(markers, groups, np.atleast_2d(eyes_mm)).argmin(axis=0)
    out = np.zeros(markers.count, dtype=np.int64)
    for ids, eye in zip(groups, nearest, strict=True):
        out[ids] = eye
    return out


def sight_heights_mm(
    design: Design,
    markers: Markers,
    camera_mm: FloatArray,
    *,
    motions: FloatArray | None = None,
) -> FloatArray:
    """Least heights (n,) at which each painted part is seen past all nearer receptors.

    From near to far, each row (each marker, where there are no rows) takes the least height from
    ``height_near_mm`` on at which ``sight_margin_mm`` stays clear beside its painted part.

    Parameters
    ----------
    design : Design
        Its layout's heights bound the search.
    markers : Markers
        Their heights are not used.
    camera_mm : (3,) float or (c, 3) float
        Centre of the camera, which looks along the sensor axis at it; of several, each sees what
        is nearest to it (:func:`nearest_eye`).
    motions : (p, n, 6) float, optional
        Translation (mm) and rotation (rad) of the middle face under each marker for p presses:
        the margin is kept under each of these too.

    Raises
    ------
    DesignError
        If a row would have to be taller than ``height_far_mm``.
    """
    margin = design.layout.sight_margin_mm
    needed = np.full(markers.count, margin)
    heights = _settled(design, markers, camera_mm, needed)
    if motions is None:
        return heights
    for _ in range(LOAD_ROUNDS):
        trial = replace(markers, height_mm=heights)
        short = margin - clearance_under_load_mm(design, trial, camera_mm, motions)
        if float(short.max()) <= LOAD_TOL_mm:
            return heights
        needed += np.maximum(short, 0.0)
        try:
            heights = _settled(design, markers, camera_mm, needed)
        except DesignError as error:
            text = f"with the wall pressed in {error}, or layout.sight_dent_mm"
            raise DesignError(text) from None
    worst = int(short.argmax())
    raise DesignError(
        f"no heights keep {margin:g} mm clear under load ({markers.place(worst)} is left with "
        f"{margin - short[worst]:.2f} mm); lower layout.sight_margin_mm or layout.sight_dent_mm, "
        "or use fewer markers"
    )


class _Settling:
    """Groups of receptors whose heights are settled one after the other, in every picture."""

    def __init__(self, design: Design, markers: Markers, eyes_mm: FloatArray) -> None:
        self.groups = _groups(markers)
        self.pictures = [_Outlines(design, markers, eye) for eye in eyes_mm]
        self.away = _away(markers, self.groups, eyes_mm)
        # The place of each group, and of each marker's, in the order of nearness to a camera.
        self.order = np.argsort(np.argsort(self.away, axis=1, kind="stable"), axis=1)
        self.place = np.zeros((len(eyes_mm), markers.count), dtype=np.int64)
        for number, ids in enumerate(self.groups):
            self.place[:, ids] = self.order[:, [number]]
        self.tubes = np.zeros((len(eyes_mm), markers.count, DIRECTIONS))
        self.done = np.zeros(markers.count, dtype=bool)

    def slack(self, eye: int, number: int, height: FloatArray) -> FloatArray:
        """Least gap (m, h) of a group's painted parts to nearer tubes, as one camera sees it."""
        nearer = self.done & (self.place[eye] < self.order[eye, number])
        ids = self.groups[number]
        return _slack(self.pictures[eye], ids, height, self.tubes[eye, nearer])

    def settle(self, number: int, height: FloatArray) -> None:
        """Let a group's tubes have heights (m,)."""
        ids = self.groups[number]
        self.done[ids] = True
        for tubes, picture in zip(self.tubes, self.pictures, strict=True):
            tubes[ids] = picture.tubes(ids, height)


def _settled(
    design: Design, markers: Markers, camera_mm: FloatArray, margin_mm: FloatArray
) -> FloatArray:
    """Least heights (n,) that leave each marker its margin (n,) at rest."""
    layout = design.layout
    settling = _Settling(design, markers, np.atleast_2d(camera_mm))
    away = settling.away
    heights = np.full(markers.count, layout.height_near_mm)
    levels = np.linspace(
        layout.height_near_mm, max(layout.height_far_mm, layout.height_near_mm), LEVELS
    )
    for number in np.argsort(away.min(axis=0), kind="stable"):
        group, own = settling.groups[number], int(away[:, number].argmin())
        margin = margin_mm[group, None]
        grid = np.tile(levels, (len(group), 1))
        watching, slack = [own], settling.slack(own, number, grid) - margin
        for eye in (k for k in range(len(away)) if k != own):
            both = np.minimum(slack, settling.slack(eye, number, grid) - margin)
            # What another camera asks beyond the own one's need is left if no height gives it.
            if (both >= 0.0).all(axis=0).any():
                watching, slack = [*watching, eye], both
        clear = np.flatnonzero((slack >= 0.0).all(axis=0))
        if clear.size == 0:
            level = int(slack.min(axis=0).argmax())
            marker = int(slack[:, level].argmin())
            best, wanted = float(slack[marker, level]), float(margin[marker, 0])
            raise DesignError(
                f"receptors of {markers.place(int(group[0]))} are hidden by nearer ones at every "
                f"height up to {levels[-1]:g} mm (best clearance {best + wanted:.2f} mm, wanted "
                f"{wanted:.3g} mm); raise layout.height_far_mm, or lower "
                "layout.sight_margin_mm, receptor.band_marker_mm or the number of markers"
            )
        high = levels[clear[0]]
        if clear[0] > 0:
            low = levels[clear[0] - 1]
            for _ in range(HALVINGS):
                middle = (low + high) / 2.0
                trial = np.full((len(group), 1), middle)
                if all((settling.slack(eye, number, trial) >= margin).all() for eye in watching):
                    high = middle
                else:
                    low = middle
        heights[group] = high
        settling.settle(number, heights[group])
    return heights


def pressed_markers(markers: Markers, motion: FloatArray) -> Markers:
    """Bases and axes of markers moved by translations (mm) and small rotations (rad), (n, 6)."""
    shift, turn = motion[:, :3], motion[:, 3:]
    direction = markers.direction + np.cross(turn, markers.direction)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    below = np.linalg.norm(markers.foot_mm - markers.mid_mm, axis=1, keepdims=True)
    foot = markers.mid_mm + shift + below * direction
    tip = foot + markers.height_mm[:, None] * direction
    return replace(markers, foot_mm=foot, direction=direction, tip_mm=tip)


def clearance_under_load_mm(
    design: Design, markers: Markers, camera_mm: FloatArray, motions: FloatArray
) -> FloatArray:
    """Least :func:`clearance_mm` (n,) at rest and under each of the motions (p, n, 6).

    Receptors that move by less than ``STATIONARY_SHARE`` of the most are taken as still.
    """
    eyes = np.atleast_2d(camera_mm)
    nearest = nearest_eye(markers, eyes)
    least = np.full(markers.count, np.inf)
    for number, eye in enumerate(eyes):
        own = nearest == number
        least[own] = _under_load(design, markers, eye, motions, own)[own]
    return least


def _under_load(
    design: Design, markers: Markers, eye_mm: FloatArray, motions: FloatArray, own: BoolArray
) -> FloatArray:
    """The same for the markers (n,) that one camera has to see."""
    least = clearance_mm(design, markers, eye_mm, chosen=own)
    rest = _Outlines(design, markers, eye_mm)
    every = np.arange(markers.count)
    boxes = _box(rest.tubes(every, markers.height_mm))
    for motion in motions:
        size = np.linalg.norm(motion[:, :3], axis=1)
        moves = size > STATIONARY_SHARE * size.max()
        now = pressed_markers(markers, np.where(moves[:, None], motion, 0.0))
        after = _box(_Outlines(design, now, eye_mm).tubes(every, markers.height_mm))
        reach = np.maximum(boxes, after)
        # Only what moves, or has something that moves before or beside it in the picture.
        room = reach[moves].max(axis=0, initial=-np.inf)
        near = -np.roll(reach, 2, axis=1) - room
        touched = (near < 2.0 * rest.radius / rest.depth(every)[:, None]).all(axis=1)
        chosen = own & (moves | touched)
        seen = clearance_mm(design, now, eye_mm, chosen=chosen)
        least[chosen] = np.minimum(least, seen)[chosen]
    return least


def _slack(
    outlines: _Outlines, group: IntArray, height: FloatArray, settled: FloatArray
) -> FloatArray:
    """Least gap (m, h) in mm between painted parts at heights (m, h) and the settled tubes."""
    out = np.full(height.shape, np.inf)
    if len(settled) == 0 or len(group) == 0:
        return out
    paint, depth = outlines.paints(group, height), outlines.depth(group)
    for k in range(len(group)):
        # Beyond one diameter a gap need not be known.
        close = _near(paint[k], settled, 2.0 * outlines.radius / depth[k])
        if close.size:
            out[k] = _gaps(paint[k], settled[close]).min(axis=1) * depth[k]
    return out


def clearance_mm(
    design: Design,
    markers: Markers,
    camera_mm: FloatArray,
    *,
    chosen: BoolArray | None = None,
) -> FloatArray:
    """Gap (n,) that the camera sees between each painted part and the nearer receptors, mm.

    Negative where it is hidden in part; inf where nothing nearer comes within a diameter, and for
    those that are not ``chosen`` (n,). Of several cameras (c, 3) each marker's nearest counts.
    """
    wanted = np.ones(markers.count, dtype=bool) if chosen is None else chosen
    eyes, groups = np.atleast_2d(camera_mm), _groups(markers)
    away, nearest = _away(markers, groups, eyes), nearest_eye(markers, eyes)
    out = np.full(markers.count, np.inf)
    for number, eye in enumerate(eyes):
        outlines = _Outlines(design, markers, eye)
        own = wanted & (nearest == number)
        settled = np.zeros((0, DIRECTIONS))
        for place in np.argsort(away[number], kind="stable"):
            group = groups[place]
            some = group[own[group]]
            out[some] = _slack(outlines, some, markers.height_mm[some, None], settled)[:, 0]
            settled = np.concatenate([settled, outlines.tubes(group, markers.height_mm[group])])
    return out
