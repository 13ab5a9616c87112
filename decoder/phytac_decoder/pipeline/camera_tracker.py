"""Markers of one camera, followed from frame to frame."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FOUND_MIN, locate_in
from phytac_decoder.pipeline.tracker_setup import measure_rest
from phytac_decoder.vision.matching import neighbour_median
from phytac_decoder.vision.segmentation import check_image
from phytac_decoder.vision.windows import Moments, larger
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class FollowSettings:
    """When a marker counts as found; set on rendered grips of the catalogue's designs.

    Attributes
    ----------
    paint_share, paint_px : float
        A marker that shows less than this share of its paint at rest, or less than so much, is
        lost.
    retry_paint_px : float
        Markers with less paint at rest are not looked for a second time: they flicker.
    rim_excess : float
        A marker whose window's rim holds this share of its paint more than at rest has run out of
        its window.
    step_share : float
        A marker found farther from its expected position than this share of the distance to the
        next of its colour is looked for again, beside the motion of its neighbours.
    gate_share : float
        There it must be nearer than this share of the distance to any other's position.
    wider_margins : float
        How much farther the second look reaches, in margins.
    damping : float
        Share of the last velocity that is expected to last.
    jump_px, jump_margins : float
        A marker jumps if it is farther than this plus so many margins from where it was expected.
    jump_share : float
        A frame in which more than this share of the markers jump is rejected.
    retry_frames : int
        A marker that is lost for longer is looked for in every ``retry_frames``-th frame only.
    rejected_max : int
        After so many rejected frames in a row the whole frame is searched.
    hysteresis : float
        A switch turns on this share of the red between off and on above the threshold, and off
        below it.
    agree_px : float
        A full search that finds a marker within this of where it is followed agrees.
    """

    paint_share: float = 0.3
    paint_px: float = 1.5
    retry_paint_px: float = 5.0
    rim_excess: float = 0.05
    step_share: float = 0.3
    gate_share: float = 0.42
    wider_margins: float = 4.0
    damping: float = 0.8
    jump_px: float = 1.0
    jump_margins: float = 2.0
    jump_share: float = 0.3
    retry_frames: int = 10
    rejected_max: int = 3
    hysteresis: float = 0.1
    agree_px: float = 1.0


SETTINGS = FollowSettings()


class Observed(NamedTuple):
    """What one camera's frame shows of all n markers of the bundle.

    ``position_px`` (n, 2) is NaN where not found, ``switch_on`` (n,) bool, ``paint`` (n,) the
    paint over that at rest, ``flags`` what was unusual about the frame.
    """

    position_px: FloatArray
    switch_on: BoolArray
    paint: FloatArray
    flags: tuple[str, ...] = ()


class CameraFollower:
    """Follows what one camera of a bundle shows; parameters as of ``Follower``."""

    def __init__(
        self, bundle: Bundle, number: int, rest: ImageArray, *, stride: int, margin_px: float
    ) -> None:
        self._bundle, self._number, self._margin = bundle, number, margin_px
        frame = np.ascontiguousarray(rest)
        known = measure_rest(bundle, number, frame, margin_px=margin_px, stride=stride)
        self._known = known
        weight, rim = known.at_rest.weight, known.at_rest.rim
        # A marker that is hidden in the rest frame has as much paint as its neighbours.
        usual = np.nan_to_num(neighbour_median(weight[:, None], known.neighbours)[:, 0])
        self._full = np.where(weight > SETTINGS.paint_share * usual, weight, usual)
        self._rim_max = SETTINGS.rim_excess + rim / np.maximum(weight, 1e-6)
        least = np.maximum(SETTINGS.paint_share * self._full, SETTINGS.paint_px)
        self._paint_min = np.where(known.separable, least, np.inf)
        self._retried = known.separable & (self._full >= SETTINGS.retry_paint_px)
        self._read_here = (bundle.read_by[known.ids] == number) & known.separable
        # Neighbour by neighbour; the last entries are of none.
        self._neighbours = np.ascontiguousarray(known.neighbours.T)
        self._place, self._velocity = known.rest_px.copy(), np.zeros_like(known.rest_px)
        self._lost_for = np.where(weight >= self._paint_min, 0, 1)
        self._rejected, self._clock = 0, 0
        tips = bundle.shown_by(number).tips
        ids = known.ids[known.tips]
        middle = tips.threshold_px[ids]
        contrast = np.maximum(tips.red_on_px[ids] - tips.red_rest_px[ids], 0.0)
        band = SETTINGS.hysteresis * contrast
        self._on_above, self._off_below = middle + band, np.maximum(middle - band, 1.0)
        self._on = known.red.look(frame, known.rest_px[known.tips] + known.tip_px).weight > middle

    @property
    def rest_px(self) -> FloatArray:
        """Rest positions (n, 2) of all markers of the bundle; NaN where not found."""
        found = self._known.at_rest.weight >= self._paint_min
        return self._of_bundle(np.where(found[:, None], self._known.rest_px, np.nan), np.nan)

    @property
    def pixels(self) -> int:
        """Pixels read of a frame in which nothing is lost."""
        return self._known.paint.pixels + self._known.red.pixels

    def follow(self, image: ImageArray, elapsed: float) -> Observed:
        """Find all markers in the next frame, ``elapsed`` frames after the last one given.

        Raises
        ------
        InputError
            If the frame has another size, shows too few markers, or they have jumped; the state
            of the markers does not change.
        """
        camera = self._bundle.cameras[self._number]
        check_image(image, width_px=camera.width_px, height_px=camera.height_px)
        frame = np.ascontiguousarray(image)
        self._clock += 1
        since = elapsed + self._rejected
        expected = self._place + since * self._velocity
        found, got = self._find(frame, expected)
        away = larger(found.centroid_px - expected)
        jump = SETTINGS.jump_margins * self._margin + SETTINGS.jump_px
        jumped = got & (away > jump * max(elapsed, 1.0))
        reason = self._reason_to_reject(got, jumped, away)
        if not reason:
            return self._update(frame, found, got, since)
        self._rejected += 1
        if self._rejected >= SETTINGS.rejected_max:
            return self.search(frame)
        raise InputError(reason)

    def _reason_to_reject(self, got: BoolArray, jumped: BoolArray, away: FloatArray) -> str:
        """Why a frame is rejected; "" for a sound one."""
        where = self._bundle.of_camera(self._number)
        own = self._read_here
        seen = np.count_nonzero(got & own)
        if seen < FOUND_MIN * np.count_nonzero(own):
            return (
                f"found {seen} of {np.count_nonzero(own)} markers{where} where they were followed; "
                f"is the frame black, torn or of another sensor than {self._bundle.design!r}? give "
                "the next one"
            )
        if np.count_nonzero(jumped) > SETTINGS.jump_share * len(jumped):
            return (
                f"{np.count_nonzero(jumped)} of {len(got)} markers{where} jumped by "
                f"{np.median(away[jumped]):.1f} px from one frame to the next: "
                "it is torn, the camera was knocked or many frames were dropped; give the next one"
            )
        return ""

    def search(self, frame: ImageArray) -> Observed:
        """Find all markers in the whole frame, lost ones too.

        Raises
        ------
        InputError
            See :func:`phytac_decoder.pipeline.decode.locate_in`.
        """
        known = self._known
        matched, _ = locate_in(self._bundle, self._number, frame)
        frame = np.ascontiguousarray(frame)
        searched = matched.position_px[known.ids]
        followed, got = self._find(frame, self._place)
        shift = np.where(got[:, None], followed.centroid_px - known.rest_px, np.nan)
        wide = searched - known.rest_px
        # Of two positions that whose motion is more like that of the neighbours.
        usual = neighbour_median(np.where(np.isfinite(wide), wide, shift), known.neighbours)
        off = np.nan_to_num([np.hypot(*(each - usual).T) for each in (shift, wide)], nan=np.inf)
        differ = ~(np.hypot(*(shift - wide).T) <= SETTINGS.agree_px)
        better = differ & (off[1] < off[0])
        start = known.rest_px + np.nan_to_num(usual)
        start[got] = followed.centroid_px[got]
        start[better] = searched[better]
        self._place, self._velocity[:] = start, 0.0
        out = self._update(frame, *self._find(frame, start), 0.0)
        flag = f"the whole frame{self._bundle.of_camera(self._number)} was searched"
        return out._replace(flags=(*out.flags, flag))

    def _find(self, frame: ImageArray, expected: FloatArray) -> tuple[Moments, BoolArray]:
        """Paint of all markers near their expected positions, and which of them are found."""
        found = self._known.paint.look(frame, expected)
        away = larger(found.centroid_px - expected)
        got = found.weight >= self._paint_min
        got &= found.rim <= self._rim_max * found.weight
        got &= away <= SETTINGS.step_share * self._known.spacing_px
        again = self._retried & ~got
        if self._clock % SETTINGS.retry_frames:
            again &= self._lost_for <= SETTINGS.retry_frames
        if not again.any():
            return found, got
        return self._look_again(frame, expected, found, got, np.flatnonzero(again))

    def _look_again(
        self,
        frame: ImageArray,
        expected: FloatArray,
        found: Moments,
        got: BoolArray,
        again: IntArray,
    ) -> tuple[Moments, BoolArray]:
        """Look in wider windows for markers ``again``, where their neighbours' motion puts them."""
        known = self._known
        off = np.where(got[:, None], found.centroid_px - expected, 0.0)
        likely = expected + self._neighbour_mean(off, got)
        centre = np.where(got[:, None], found.centroid_px, likely)
        wider = SETTINGS.wider_margins * self._margin
        more = known.paint.look_wider(frame, again, centre, wider)
        away = np.hypot(*(more.centroid_px - centre[again]).T)
        others = np.append(centre, [[np.inf, np.inf]], axis=0)[known.rivals[again]]
        gap = np.linalg.norm(others - centre[again][:, None], axis=2).min(axis=1, initial=np.inf)
        sure = (more.weight >= self._paint_min[again]) & (away <= SETTINGS.gate_share * gap)
        sure &= more.rim <= (self._rim_max[again] + SETTINGS.rim_excess) * more.weight
        for values, new in zip((*found, got), (*more, sure), strict=True):
            values[again] = new
        return found, got

    def _neighbour_mean(self, step: FloatArray, got: BoolArray) -> FloatArray:
        """Mean step (m, 2) of each marker's neighbours that were found; 0 where none was.

        ``step`` is 0 for markers that were not found.
        """
        values = np.zeros((len(step) + 1, 3))
        values[:-1, :2], values[:-1, 2] = step, got
        total = values.take(self._neighbours, axis=0).sum(axis=0)
        return np.asarray(total[:, :2] / np.maximum(total[:, 2:], 1.0))

    def _update(self, frame: ImageArray, found: Moments, got: BoolArray, since: float) -> Observed:
        """Take what was found as the new state."""
        known = self._known
        step = np.where(got[:, None], found.centroid_px - self._place, 0.0)
        beside = self._neighbour_mean(step, got)
        step[~got] = beside[~got]
        self._place = self._place + step
        self._velocity = (0.5 * SETTINGS.damping / max(since, 1.0)) * (step + beside)
        self._lost_for = np.where(got, 0, self._lost_for + 1)
        self._rejected = 0
        red = known.red.look(frame, self._place[known.tips] + known.tip_px).weight
        self._on = red > np.where(self._on, self._off_below, self._on_above)
        switch_on = np.zeros(len(got), dtype=np.bool_)
        switch_on[known.tips] = self._on
        return Observed(
            position_px=self._of_bundle(np.where(got[:, None], self._place, np.nan), np.nan),
            switch_on=self._of_bundle(switch_on, fill=False),
            paint=self._of_bundle(found.weight / np.maximum(self._full, 1e-6), 0.0),
        )

    def _of_bundle(self, values: NDArray[Any], fill: float) -> NDArray[Any]:
        """Values of all markers of the bundle from those (m, …) of the ones shown here."""
        out = np.full((len(self._bundle.colour), *values.shape[1:]), fill, dtype=values.dtype)
        out[self._known.ids] = values
        return out
