"""The digital channel: which switches are on, by the red tips in the image."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from phytac_decoder.vision.segmentation import Blobs
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

RED_AREA_MIN_px = 4.0
"""Least red area that counts as a tip."""
RED_RATIO_MIN = 1.3
"""A switch can be read if its tip, when out, shows this many times its red at rest or more: the
threshold is half way between, and printed and pressed tips show an eighth more or less."""
RED_SEEN_px = 50.0
"""A tip that shows so much red at rest is measured in the rest frame."""
RED_SEEN_RANGE = (0.8, 1.25)
"""Less and more than these times what is expected at rest is no tip of this design at rest."""
HALF_OUT_MIN_px, HALF_OUT_SHARE = 10.0, 0.15
"""A tip that is off, and shows so much red at rest, is half out if it shows more than any tip at
rest, and its red has grown by this share of what a switch adds (measured: none in 20 pressed frames
of 216 tips with noise of 8 grey levels, 4 px of defocus or JPEG 60; 3 to 6 with red light through
the wall)."""
SMALL_HALF_OUT_SHARE = 0.25
"""The same share of tips that show less red at rest. In frames of ``handle``, ``cylinder60``,
``hemisphere`` and ``grip`` with mild disturbances tips that are in add 0.1 at most, at rest in
scattered prints 0.03, and tips that are out show 0.67 or more. In frames of a cheap webcam, or
blurred by 6 px, small ones that are out show 0.3 to 0.6, so that some read as off."""
HALF_OUT_ON_SHARE = 0.8
"""A switch that reads as on shows less than this share of its red when out if its tip is half out,
and that red is enough to be measured. Sound tips of ``cylinder60`` show 0.85 or more in the shade
of a finger and 0.9 at JPEG 60; tips at rest that red light turns on, 0.63 to 0.82."""
HALF_OUT_REPORTED = 2
"""So many tips that are half out are reported, and each one that reads as off: none in 30 pressed
frames of ``handle`` under each of 14 mild disturbances, 2 to 5 in all of them with red light
through the wall."""
TIPS_FOR_LIGHT = 3
"""Light on red paint is followed by so many tips that show at rest, or more."""


@dataclass(frozen=True, kw_only=True)
class TipModel:
    """What the camera sees of each switch's red tip; arrays run over n markers.

    Attributes
    ----------
    on_px : (n, 2) float
        Centroid of the visible red when the switch is on and nothing is deformed.
    red_rest_px, red_on_px : (n,) float
        Visible red area with the switch off (the tip rests in its hole) and on.
    gradual : (n,) bool, optional
        Tips that come out as the force grows: half out, they are no fault. None do if not given.
    """

    on_px: FloatArray
    red_rest_px: FloatArray
    red_on_px: FloatArray
    gradual: BoolArray | None = None

    @cached_property
    def readable(self) -> BoolArray:
        """Switches (n,) whose red differs enough between on and off.

        A camera that looks straight into a hole sees the resting tip too.
        """
        return np.asarray(self.red_on_px > RED_RATIO_MIN * self.red_rest_px + RED_AREA_MIN_px)

    def blind(self, played: BoolArray) -> IntArray:
        """Unreadable switches (b,) among those in play (n,)."""
        return np.flatnonzero(~self.readable & played)

    @cached_property
    def seen_at_rest(self) -> BoolArray:
        """Tips (n,) that show enough red at rest to be measured."""
        return np.asarray(self.red_rest_px >= RED_SEEN_px)

    def as_at_rest(self, red_px: FloatArray) -> "TipModel":
        """Tips that show ``red_px`` (n,) in the rest frame, and in proportion when they are out."""
        scale = np.clip(red_px / np.maximum(self.red_rest_px, 1.0), *RED_SEEN_RANGE)
        scale = np.where(self.seen_at_rest, scale, 1.0)
        return replace(self, red_rest_px=self.red_rest_px * scale, red_on_px=self.red_on_px * scale)

    def red_light(self, red_px: FloatArray) -> float:
        """Red of an image (n,) over that of the rest frame; 1 with few tips that show at rest."""
        seen = self.seen_at_rest
        if seen.sum() < TIPS_FOR_LIGHT:
            return 1.0
        # Most tips are at rest.
        change = float(np.median(red_px[seen] / self.red_rest_px[seen]))
        return float(np.clip(change, *RED_SEEN_RANGE))

    def half_out(self, red_px: FloatArray, switch_on: BoolArray) -> BoolArray:
        """Tips (n,) of those that snap that show neither their red (n,) at rest nor that when out.

        Red is that of a followed light. Red light turns tips at rest on, or nearly so.
        """
        rest_px, on_px = self.red_rest_px, self.red_on_px
        share = np.where(rest_px >= HALF_OUT_MIN_px, HALF_OUT_SHARE, SMALL_HALF_OUT_SHARE)
        least_px = np.maximum(rest_px + share * (on_px - rest_px), RED_SEEN_RANGE[1] * rest_px)
        off = ~switch_on & (red_px > least_px)
        on = switch_on & (on_px >= RED_SEEN_px) & (red_px < HALF_OUT_ON_SHARE * on_px)
        snap = self.readable if self.gradual is None else self.readable & ~self.gradual
        return np.asarray(snap & (off | on))

    @property
    def threshold_px(self) -> FloatArray:
        """Red area (n,) above which a switch is on: half way between off and on."""
        return np.maximum(0.5 * (self.red_rest_px + self.red_on_px), RED_AREA_MIN_px)


def _none() -> IntArray:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, kw_only=True)
class TipCovers:
    """Red tips that, when they are out, cover paint of another marker, which lies behind them.

    Attributes
    ----------
    marker, tip : (k,) int
        The marker, and the receptor whose tip covers it.
    shift_px : (k, 2) float
        Shift of the marker's centroid.
    """

    marker: IntArray = field(default_factory=_none)
    tip: IntArray = field(default_factory=_none)
    shift_px: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))

    def shift(self, switch_on: BoolArray) -> FloatArray:
        """Return the shift (n, 2) px of every marker by the tips (n,) that are out."""
        out = np.zeros((len(switch_on), 2))
        on = switch_on[self.tip]
        np.add.at(out, self.marker[on], self.shift_px[on])
        return out

    def seen_in(self, order: IntArray) -> "TipCovers":
        """Return the covers of markers that look as those at ``order`` (n,) did."""
        place = np.argsort(order)
        return TipCovers(marker=place[self.marker], tip=place[self.tip], shift_px=self.shift_px)


def red_areas(blobs: Blobs, tips: TipModel, *, red_index: int, shift_px: FloatArray) -> FloatArray:
    """Red area (n,) px of each tip: each red blob counts for the tip expected nearest to it.

    Parameters
    ----------
    blobs : Blobs
        Of the image.
    tips : TipModel
        Expected tips.
    red_index : int
        Class of the red paint.
    shift_px : (n, 2) float
        Shift of each marker in this frame, with which the tip moves; NaN counts as none.
    """
    area = np.zeros(len(tips.on_px))
    pick = np.flatnonzero(blobs.colour == red_index)
    if len(pick):
        expected = tips.on_px + np.nan_to_num(shift_px)
        visible = np.isfinite(expected[:, 0])
        expected = np.where(visible[:, None], expected, np.inf)
        with np.errstate(invalid="ignore"):
            distance = np.linalg.norm(blobs.centroid_px[pick, None] - expected[None], axis=2)
        distance = np.nan_to_num(distance, nan=np.inf)
        nearest = np.argmin(distance, axis=1)
        # A tip is no farther from its expected place than about its own size.
        reach = 2.0 * np.sqrt(np.maximum(tips.red_on_px[nearest], 1.0)) + 2.0
        near = distance[np.arange(len(pick)), nearest] <= reach
        np.add.at(area, nearest[near], blobs.weight[pick[near]])
    return area


def read_switches(
    blobs: Blobs, tips: TipModel, *, red_index: int, shift_px: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Which switches (n,) are on, and which tips (n,) are half out, by :func:`red_areas`."""
    area = red_areas(blobs, tips, red_index=red_index, shift_px=shift_px)
    area = area / tips.red_light(area)
    switch_on = np.asarray(area > tips.threshold_px)
    return switch_on, tips.half_out(area, switch_on)
