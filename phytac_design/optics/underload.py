"""What the camera sees of a *pressed* sensor: hidden, fused and disturbed markers, and from when.

Crosstalk is the part of a marker's image shift that is not its own motion: what a neighbour covers
or uncovers moves the centroid of the pixels that are left. With ``alone`` the marker's pixels if
its receptor were the only thing, in the same pose::

    offset = centroid(visible) - centroid(alone)      crosstalk = |offset(pressed) - offset(rest)|

Both centroids are of the same pixel samples, so a marker that nothing covers has none, exactly.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.camera import Camera
from phytac_design.optics.fill import View, fill
from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.kernels import in_bands, kernel
from phytac_design.optics.raster import (
    marker_windows,
    pieces_by_marker,
    project_scene,
    rasterise,
)
from phytac_design.optics.scene import FIRST_MARKER, Scene, paint_owner
from phytac_design.optics.visibility import FRACTION_MIN, PIXELS_MIN
from shapes.arrays import BoolArray, FloatArray, IntArray

FUSED_PX = 2.0
"""Markers of one colour this near (one free pixel or none) count as fused under load."""
STILL = 0.1
"""A marker that moves by less than this share of the greatest image shift counts as still."""
BISECTIONS = 6
"""Halvings of a force interval in which something happens."""


@dataclass(frozen=True, kw_only=True)
class Sight:
    """One state of the sensor as the camera sees it; arrays over n markers.

    Attributes
    ----------
    fraction : (n,) float
        Visible fraction.
    visible_px : (n,) int
        Visible pixels.
    gap_same_px, gap_other_px : (n,) float
        Distance to the nearest pixel of another marker of its own, and of another, colour.
    offset_px : (n, 2) float
        Centroid of the visible pixels less that of the marker alone; NaN if not visible.
    """

    fraction: FloatArray
    visible_px: IntArray
    gap_same_px: FloatArray
    gap_other_px: FloatArray
    offset_px: FloatArray

    @property
    def hidden(self) -> BoolArray:
        """Markers that count as occluded."""
        return np.asarray((self.fraction < FRACTION_MIN) | (self.visible_px < PIXELS_MIN))

    @property
    def fused(self) -> BoolArray:
        """Markers that nearly touch another one of their colour."""
        return np.asarray(self.gap_same_px <= FUSED_PX)

    def crosstalk_px(self, rest: "Sight") -> FloatArray:
        """Shift of each centroid that is not its marker's own motion, (n,); 0 if not visible."""
        return np.asarray(np.nan_to_num(np.linalg.norm(self.offset_px - rest.offset_px, axis=1)))


def sight(scene: Scene, camera: Camera) -> Sight:
    """Visibility, gaps and centroid offsets of a scene, at rest or moved."""
    owner = paint_owner(rasterise(scene, camera).part)
    own, other = marker_gaps(owner, scene.colour)
    y, x = np.nonzero(owner >= 0)
    marker = owner[y, x]
    seen = np.bincount(marker, minlength=scene.count).astype(np.int64)
    sums = [np.bincount(marker, weights=c, minlength=scene.count) for c in (x, y)]
    alone = _alone_sums(scene, camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = np.stack(sums, axis=1) / seen[:, None] - alone[:, 1:] / alone[:, :1]
        fraction = np.where(alone[:, 0] > 0.0, seen / alone[:, 0], 0.0)
    return Sight(
        fraction=fraction,
        visible_px=seen,
        gap_same_px=own,
        gap_other_px=other,
        offset_px=offset,
    )


def _alone_sums(scene: Scene, camera: Camera) -> FloatArray:
    """Pixels, sum of x and sum of y (n, 3) of each marker's paint with its receptor alone."""
    view = project_scene(scene, camera)
    chosen, starts = pieces_by_marker(scene, view)
    windows = marker_windows(view, chosen, starts, camera)
    # Pixels beyond the image show nothing that could be uncovered.
    size = np.array([camera.width_px, camera.height_px])
    low = np.maximum(windows[:, :2], 0)
    high = np.minimum(windows[:, :2] + windows[:, 2:], size)
    windows = np.concatenate([low, np.maximum(high - low, 0)], axis=1)
    windows[windows[:, 3] == 0, 2] = 0
    sums = np.zeros((scene.count, 3))

    def some(first: int, last: int) -> None:
        _sum_alone(
            view,
            chosen,
            starts[first : last + 1],
            windows[first:last],
            scene.part,
            sums[first:last],
        )

    in_bands(some, scene.count)
    return sums


@kernel
def _sum_alone(
    view: View,
    chosen: NDArray[np.int32],
    starts: IntArray,
    windows: IntArray,
    codes: NDArray[np.int32],
    sums: FloatArray,
) -> None:
    for i in range(len(starts) - 1):
        left, top, columns, rows = windows[i]
        if columns == 0:
            continue
        owner = np.full((rows, columns), -1, dtype=np.int32)
        own = chosen[starts[i] : starts[i + 1]]
        fill(view, own, (left, top, 1, 0.0, 0.0), owner, np.zeros(owner.shape))
        for row in range(rows):
            for column in range(columns):
                t = owner[row, column]
                if t >= 0 and codes[t] >= FIRST_MARKER and codes[t] % 2 == 0:
                    sums[i, 0] += 1.0
                    sums[i, 1] += column + left
                    sums[i, 2] += row + top


@dataclass(frozen=True, kw_only=True)
class UnderLoad:
    """Worst of many presses, each alone; arrays over p presses or n markers.

    Attributes
    ----------
    hidden, fused : (p,) int
        Markers hidden, and fused, at the full force.
    least_fraction, least_gap_same_px, least_gap_other_px : (n,) float
        Least over all presses.
    crosstalk_px, crosstalk_still_px : (n,) float
        Greatest over all presses; and over those that move the marker's own image by less than
        ``STILL`` of the greatest shift.
    first_force_N : (p,) float
        Force from which something hides or fuses; inf if nothing does up to the full force.
    shift_px : (p,) float
        Greatest image shift of a marker, for comparison.
    """

    hidden: IntArray
    fused: IntArray
    least_fraction: FloatArray
    least_gap_same_px: FloatArray
    least_gap_other_px: FloatArray
    crosstalk_px: FloatArray
    crosstalk_still_px: FloatArray
    first_force_N: FloatArray
    shift_px: FloatArray

    @property
    def worst(self) -> int:
        """Press at which something happens first; the one with the least gap if nothing does."""
        return int(np.argmin(self.first_force_N))


def press_all(
    scene: Scene,
    camera: Camera,
    *,
    pivots_mm: FloatArray,
    motions: FloatArray,
    forces_N: FloatArray,
    progress: Callable[[str], None] = lambda _: None,
) -> UnderLoad:
    """See the sensor under every press, and find from which force anything hides or fuses.

    Between the given forces motion is interpolated linearly.

    Parameters
    ----------
    scene, camera : Scene, Camera
        The sensor at rest.
    pivots_mm : (n, 3) float
        Points that ``motions`` are of: the middle face under each marker.
    motions : (p, k, n, 6) float
        Translation (mm) and rotation (rad) for p presses at k rising forces.
    forces_N : (k,) float
        Those forces; the last is the full one.
    """
    rest = sight(scene, camera)
    ladder = np.concatenate([[0.0], forces_N])
    zero = np.zeros_like(motions[:, :1])
    path = np.concatenate([zero, motions], axis=1)
    presses = len(motions)
    hidden, fused = np.zeros(presses, dtype=np.int64), np.zeros(presses, dtype=np.int64)
    first, shift = np.full(presses, np.inf), np.zeros(presses)
    fraction, crosstalk = rest.fraction.copy(), np.zeros((2, scene.count))
    same, other = rest.gap_same_px.copy(), rest.gap_other_px.copy()

    def at(press: int, force: float) -> tuple[Sight, FloatArray]:
        k = int(np.clip(np.searchsorted(ladder, force) - 1, 0, len(ladder) - 2))
        share = (force - ladder[k]) / (ladder[k + 1] - ladder[k])
        motion = (1.0 - share) * path[press, k] + share * path[press, k + 1]
        moved = scene.moved(motion[:, :3], motion[:, 3:], pivots_mm)
        return sight(moved, camera), motion

    def happens(seen: Sight) -> bool:
        return bool(((seen.hidden & ~rest.hidden) | (seen.fused & ~rest.fused)).any())

    for press in range(presses):
        seen, motion = at(press, float(ladder[-1]))
        hidden[press], fused[press] = int(seen.hidden.sum()), int(seen.fused.sum())
        fraction = np.minimum(fraction, seen.fraction)
        same, other = np.minimum(same, seen.gap_same_px), np.minimum(other, seen.gap_other_px)
        moved = camera.project(pivots_mm + motion[:, :3]) - camera.project(pivots_mm)
        moved = np.nan_to_num(np.linalg.norm(moved, axis=1))
        shift[press] = float(moved.max())
        stray = seen.crosstalk_px(rest)
        still = moved <= STILL * shift[press]
        crosstalk = np.maximum(crosstalk, np.stack([stray, np.where(still, stray, 0.0)]))
        if happens(seen):
            low, high = 0.0, float(ladder[-1])
            for _ in range(BISECTIONS):
                middle = (low + high) / 2.0
                low, high = (low, middle) if happens(at(press, middle)[0]) else (middle, high)
            first[press] = high
        progress(f"under load: {press + 1} of {presses} presses")
    return UnderLoad(
        hidden=hidden,
        fused=fused,
        least_fraction=fraction,
        least_gap_same_px=same,
        least_gap_other_px=other,
        crosstalk_px=crosstalk[0],
        crosstalk_still_px=crosstalk[1],
        first_force_N=first,
        shift_px=shift,
    )
