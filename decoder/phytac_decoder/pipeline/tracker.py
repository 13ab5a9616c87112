"""Following markers from frame to frame, at camera speed.

``measure_frame`` searches a whole frame. A ``Follower`` starts from a rest frame and then reads
only small windows around the positions where markers are expected: the last position plus the
mean velocity of the marker and its neighbours. A marker whose shift disagrees with its neighbours'
is not reported, and the whole frame is searched for where each marker went.
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import (
    FOUND_MIN,
    FrameMeasurement,
    Frames,
    blurs_px,
    corrected_shift,
    in_rest_light,
    light_changes,
    locate_in,
    prepared_frames,
    with_edges,
)
from phytac_decoder.vision.matching import nearest_same_colour_px, neighbour_median
from phytac_decoder.vision.segmentation import (
    LIGHT_MAX,
    LIGHT_MIN,
    Blobs,
    check_image,
    segment,
)
from phytac_decoder.vision.switch_detection import RED_AREA_MIN_px, TipModel
from phytac_decoder.vision.windows import Moments, PaintWindows, larger
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class FollowSettings:
    """Choice of windows, and when a marker counts as found; set on rendered grips.

    Attributes
    ----------
    rivals_max : int
        Spots of one paint that a window is cut against.
    blob_reach : float
        At rest a blob is a marker's if it is nearer than this share of the distance to the next
        marker of its colour.
    border_weight : float
        A marker is not separable if more than this share of its paint lies on the border to
        another one.
    extent_ratio, extent_min_px : float
        A blob that reaches this many times as far as its neighbours' holds several markers; and
        the least distance from a marker's centre to the edge of its paint.
    stride_area_px : float
        Smaller markers are read whole whatever the stride.
    tip_half, tip_samples : float
        From a tip's centre to the edge of its window, over the root of its area, which holds tips
        up to three times as long as wide; and samples across a tip.
    paint_share, paint_px : float
        A marker that shows less than this share of its paint at rest, or less than so much, is
        lost.
    retry_paint_px : float
        Markers with less paint at rest are not looked for a second time: they flicker.
    rim_excess : float
        A marker whose window's rim holds this share of its paint more than at rest has run out of
        its window.
    gate_share : float
        A marker may be this share of the distance to the next of its colour off its expected
        position, and off where its neighbours' shift puts it. Beyond the first it is looked for
        again beside its neighbours; beyond the second it is on another's paint.
    beside_min : int
        A marker with fewer neighbours that are found is not reported: nothing confirms which it is.
    wider_margins : float
        How much farther the second look reaches, in margins.
    damping : float
        Share of the last velocity that is expected to last.
    jump_px, jump_margins, jump_share : float
        A marker jumps if it is farther than this plus so many margins from where it was expected;
        a frame in which more than this share of the markers jump is rejected.
    search_frames : int
        At least so many frames are between searches of the whole frame, and between looks for a
        marker that is lost for longer.
    rejected_max : int
        After so many rejected frames in a row the whole frame is searched.
    hysteresis : float
        A switch turns on this share of the red between off and on above the threshold, and off
        below it.
    """

    rivals_max: int = 8
    blob_reach: float = 0.6
    border_weight: float = 0.1
    extent_ratio: float = 1.5
    extent_min_px: float = 2.0
    stride_area_px: float = 120.0
    tip_half: float = 0.85
    tip_samples: float = 5.0
    paint_share: float = 0.3
    paint_px: float = 1.5
    retry_paint_px: float = 5.0
    rim_excess: float = 0.05
    gate_share: float = 0.4
    beside_min: int = 2
    wider_margins: float = 4.0
    damping: float = 0.8
    jump_px: float = 1.0
    jump_margins: float = 2.0
    jump_share: float = 0.3
    search_frames: int = 5
    rejected_max: int = 3
    hysteresis: float = 0.1


SETTINGS = FollowSettings()


@dataclass(frozen=True, kw_only=True)
class Followed(FrameMeasurement):
    """What one frame (of each camera) shows; arrays over n markers.

    Attributes
    ----------
    position_px : (n, 2) float
        Centroid of each marker's paint; NaN where not found.
    paint : (n,) float
        Visible paint over that at rest.
    flags : tuple of str
        What was unusual about the frame, each as a sentence; empty for a sound one.
    """

    position_px: FloatArray
    paint: FloatArray
    flags: tuple[str, ...] = ()


class Follower:
    """Follows a sensor's markers over the frames of its cameras.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    rest : (h, w, 3) uint8, or a sequence of them
        Frame of the unloaded sensor; of several cameras one of each.
    stride : int
        1 reads every pixel of the windows; 2 every other in both directions: faster, and less
        exact. Switches are always read from every pixel.

    Raises
    ------
    InputError
        If the rest frame is none of this sensor, see :func:`locate_in`.
    """

    def __init__(self, bundle: Bundle, rest: Frames, *, stride: int = 1) -> None:
        if stride not in (1, 2):
            raise InputError(
                "stride-invalid", f"stride must be 1 or 2 (got {stride}); 1 reads every pixel"
            )
        self._bundle = bundle
        self._cameras = [
            CameraFollower(bundle, number, frame, stride)
            for number, frame in enumerate(prepared_frames(bundle, rest))
        ]
        measured = self._read([each.rest_px for each in self._cameras])
        self.rest_px = np.where(np.isfinite(measured), measured, bundle.spot_rest_px)

    @property
    def pixels(self) -> int:
        """Pixels that are read of a frame in which nothing is lost, of all cameras."""
        return sum(each.paint.pixels + each.red.pixels for each in self._cameras)

    def follow(self, frames: Frames, *, elapsed: float = 1.0) -> Followed:
        """Find markers and switches in the next frame, or the next one of each camera.

        Parameters
        ----------
        frames : (h, w, 3) uint8, or a sequence of them
            BGR, as for :func:`phytac_decoder.pipeline.decode.measure_frame`.
        elapsed : float
            Frame intervals since the last frame given; more than 1 if frames were dropped.

        Raises
        ------
        InputError
            If a frame has another size, shows less than half of the markers, or more than 30 % of
            them have jumped: it is black, torn or of something else. The state of the markers does
            not change; give the next frame. After three in a row the whole frame is searched.
        """
        bundle, given = self._bundle, prepared_frames(self._bundle, frames)
        images = in_rest_light(bundle, given)
        seen = [
            camera.follow(frame, elapsed)
            for camera, frame in zip(self._cameras, images, strict=True)
        ]
        position = self._read([item.position_px for item in seen])
        count = len(bundle.colour)
        switch_on = self._read([item.switch_on for item in seen])[:count]
        half_out = self._read([item.half_out for item in seen])[:count]
        moved = with_edges(bundle, images, position - self.rest_px, switch_on, half_out)
        koi, shift, marked = corrected_shift(bundle, switch_on, moved)
        return Followed(
            koi=koi,
            shift_px=shift,
            found=np.isfinite(position[:count, 0]),
            marked=marked,
            position_px=position[:count],
            paint=self._read([item.paint for item in seen])[:count],
            half_out=np.flatnonzero(half_out),
            blur_px=blurs_px(bundle, images, position[:count]),
            light=light_changes(bundle, given, position[:count], switch_on | half_out),
            flags=tuple(flag for item in seen for flag in item.flags),
        )

    def _read(self, each: list[NDArray[Any]]) -> NDArray[Any]:
        """Values of each marker and reference mark from the camera that reads it."""
        if len(each) == 1:
            return each[0]
        reader = self._bundle.spot_read_by
        return np.asarray(np.stack(each)[reader, np.arange(len(reader))])


class Observed(NamedTuple):
    """What one camera's frame shows of the bundle's n markers and r reference marks."""

    position_px: FloatArray
    switch_on: BoolArray
    half_out: BoolArray
    paint: FloatArray
    flags: tuple[str, ...] = ()


class CameraFollower:
    """Follows the m markers and marks that one camera of a bundle shows, from a rest frame on.

    Attributes
    ----------
    ids : (m,) int
        Markers of the bundle, then its reference marks, numbered on.
    place_px : (m, 2) float
        Where they are now.
    paint, red : PaintWindows
        Windows of the markers, and of the t tips that can show.
    """

    def __init__(self, bundle: Bundle, number: int, rest: ImageArray, stride: int) -> None:
        self._bundle, self._number, shown_px = bundle, number, bundle.spots_shown_by(number)
        camera, frame = bundle.cameras[number], np.ascontiguousarray(rest)
        self._size = (camera.width_px, camera.height_px)
        # How far windows reach beyond the paint at rest, for motion from one frame to the next:
        # 1 px in an image 640 px wide, 3 px in one of 2592 px.
        self._margin = 0.4 + 1e-3 * camera.width_px
        self.ids = ids = np.flatnonzero(np.isfinite(shown_px).all(axis=1))
        colour = bundle.spot_colour[ids]
        self._shown_px = shown_px[ids]
        self._spacing = nearest_same_colour_px(self._shown_px, colour)
        # Neighbours (m, 8) and rivals (m, r) are numbered as ``ids``; m for none.
        order = np.full(len(bundle.spot_colour) + 1, len(ids))
        order[ids] = np.arange(len(ids))
        self._neighbours = order[bundle.spot_neighbours[ids]]
        self._around = np.ascontiguousarray(self._neighbours.T)
        known = np.count_nonzero(self._neighbours < len(ids), axis=1)
        self._beside_min = np.minimum(known, SETTINGS.beside_min)
        place, seen = self._searched(frame, self._shown_px)
        self._rivals = nearest_rivals(place, colour)
        blobs = segment(frame, bundle.colours, with_labels=True)
        xy, owner = _owned_pixels(blobs, place, colour, self._spacing)
        tables = bundle.colours.coverage_tables
        large = np.bincount(owner, minlength=len(ids)) >= SETTINGS.stride_area_px
        self.paint = PaintWindows(
            half_px=_extent(xy, owner, place, self._neighbours) + self._margin,
            paint=colour,
            tables=tables,
            rivals=self._rivals,
            size_px=self._size,
            stride=np.where(large, stride, 1),
        )
        start = place
        for _ in range(4):  # until the centroids of touching markers have settled
            at_rest = self.paint.look(frame, place)
            moved = np.hypot(*(at_rest.centroid_px - start).T)
            sure = (at_rest.weight > 0.0) & (moved < 0.5 * np.minimum(self._spacing, 1e6))
            place = np.where(sure[:, None], at_rest.centroid_px, place)
        self.place_px, self._at_rest_px, self._velocity = place, place, np.zeros_like(place)
        self._set_limits(at_rest, seen, self.paint.border_weight(frame))
        found = at_rest.weight >= self._paint_min
        self._lost_for = np.where(found, 0, SETTINGS.search_frames + 1)
        self.rest_px = self._of_bundle(np.where(found[:, None], place, np.nan), np.nan)
        self._rejected, self._clock, self._search_from = 0, 0, 0
        self._set_up_tips(frame, tables[bundle.colours.names.index("red")])

    def _set_limits(self, at_rest: Moments, seen: BoolArray, border: FloatArray) -> None:
        """Set what a marker must show to be found, by its paint at rest.

        One that is no blob at rest is not looked for: its window may show others' blurred paint.
        """
        weight = at_rest.weight
        touching = border > SETTINGS.border_weight * weight
        separable = np.append(~touching, True)  # the last entry stands for "no rival"
        separable[self._rivals[touching, 0]] = False
        separable = separable[:-1] & seen
        # A marker that is hidden in the rest frame has as much paint as its neighbours.
        usual = np.nan_to_num(neighbour_median(weight[:, None], self._neighbours)[:, 0])
        self._full = np.where(weight > SETTINGS.paint_share * usual, weight, usual)
        self._rim_max = SETTINGS.rim_excess + at_rest.rim / np.maximum(weight, 1e-6)
        least = np.maximum(SETTINGS.paint_share * self._full, SETTINGS.paint_px)
        self._paint_min = np.where(separable, least, np.inf)
        self._retried = separable & (self._full >= SETTINGS.retry_paint_px)
        self._read_here = (self._bundle.spot_read_by[self.ids] == self._number) & separable

    def _set_up_tips(self, frame: ImageArray, table: FloatArray) -> None:
        """Choose the tips that can show, their windows and thresholds; read them at rest."""
        tips = self._bundle.shown_by(self._number).tips
        markers = self.ids[self.ids < len(self._bundle.colour)]  # they come first
        on_px, area = tips.on_px[markers], tips.red_on_px[markers]
        self._tips = own = np.flatnonzero(np.isfinite(on_px[:, 0]) & (area > RED_AREA_MIN_px))
        across, red = np.sqrt(area[own]), np.zeros(len(own), dtype=np.int64)
        self.red = PaintWindows(
            half_px=SETTINGS.tip_half * across + self._margin / 2.0,
            paint=red,
            tables=np.asarray(table[None], dtype=np.float32),
            rivals=nearest_rivals(on_px[own], red),
            size_px=self._size,
            stride=np.maximum((across / SETTINGS.tip_samples).astype(np.int64), 1),
        )
        self._tip_px = on_px[own] - self._shown_px[own]
        self._tip_model = TipModel(
            on_px=on_px[own],
            red_rest_px=tips.red_rest_px[self.ids[own]],
            red_on_px=area[own],
            gradual=None if tips.gradual is None else tips.gradual[self.ids[own]],
        )
        middle = self._tip_model.threshold_px
        contrast = np.maximum(area[own] - self._tip_model.red_rest_px, 0.0)
        band = SETTINGS.hysteresis * contrast
        self._on_above, self._off_below = middle + band, np.maximum(middle - band, 1.0)
        self._on = self.red.look(frame, self.place_px[own] + self._tip_px).weight > middle

    def follow(self, image: ImageArray, elapsed: float) -> Observed:
        """Find all markers in the next frame, ``elapsed`` frames after the last one given.

        Raises
        ------
        InputError
            If the frame has another size, shows too few markers, or they have jumped; the state
            of the markers does not change.
        """
        check_image(image, width_px=self._size[0], height_px=self._size[1])
        frame = np.ascontiguousarray(image)
        self._clock += 1
        since = elapsed + self._rejected
        expected = self.place_px + since * self._velocity
        found, got = self._find(frame, expected)
        reason = self._reason_to_reject(got, larger(found.centroid_px - expected), elapsed)
        if reason:
            self._rejected += 1
            if self._rejected < SETTINGS.rejected_max:
                raise InputError("frame-rejected", reason)
            return self.search(frame)
        stray = self._stray(found.centroid_px, got)
        gone = self._lost_for == SETTINGS.search_frames
        if (stray | gone).any() and self._clock >= self._search_from:
            with suppress(InputError):  # more is found in windows than in the whole frame
                return self.search(frame)
        return self._update(frame, found, got & ~stray, since)

    def _reason_to_reject(self, got: BoolArray, away: FloatArray, elapsed: float) -> str:
        """Why a frame is rejected; "" for a sound one."""
        where = self._bundle.of_camera(self._number)
        seen, own = np.count_nonzero(got & self._read_here), np.count_nonzero(self._read_here)
        if seen < FOUND_MIN * own:
            return (
                f"found {seen} of {own} markers{where} where they were followed; "
                f"is the frame black, torn or of another sensor than {self._bundle.design!r}? give "
                "the next one"
            )
        jump = SETTINGS.jump_margins * self._margin + SETTINGS.jump_px
        jumped = got & (away > jump * max(elapsed, 1.0))
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
        self._search_from = self._clock + SETTINGS.search_frames
        (self.place_px, _), self._velocity[:] = self._searched(frame, self.place_px), 0.0
        found, got = self._find(frame, self.place_px)
        out = self._update(frame, found, got & ~self._stray(found.centroid_px, got), 0.0)
        flag = f"the whole frame{self._bundle.of_camera(self._number)} was searched"
        return out._replace(flags=(*out.flags, flag))

    def _searched(self, frame: ImageArray, expected: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Positions (m, 2) px by a search of the whole frame, near the expected ones (m, 2).

        And which of the markers (m,) are blobs, alone or with others.

        Hidden markers, and touching ones, which are one blob, are expected where their neighbours'
        motion puts them.
        """
        matched, _ = locate_in(self._bundle, self._number, frame, self._of_bundle(expected, np.nan))
        alone = (matched.found & ~matched.merged)[self.ids]
        off = np.where(alone[:, None], matched.position_px[self.ids] - self._shown_px, 0.0)
        off[~alone] = self._neighbour_mean(off, alone)[~alone]
        return self._shown_px + off, (matched.found | matched.merged)[self.ids]

    def _stray(self, place: FloatArray, got: BoolArray) -> BoolArray:
        """Markers (m,) that are not where their neighbours' shift puts them: on another's paint."""
        off = np.where(got[:, None], place - self._at_rest_px, 0.0)
        apart = larger(off - self._neighbour_mean(off, got))
        return np.asarray(got & (apart > SETTINGS.gate_share * self._spacing))

    def _find(self, frame: ImageArray, expected: FloatArray) -> tuple[Moments, BoolArray]:
        """Paint of all markers near their expected positions, and which of them are found."""
        found = self.paint.look(frame, expected)
        away = larger(found.centroid_px - expected)
        got = found.weight >= self._paint_min
        got &= found.rim <= self._rim_max * found.weight
        got &= away <= SETTINGS.gate_share * self._spacing
        again = self._retried & ~got
        if self._clock % SETTINGS.search_frames:
            again &= self._lost_for <= SETTINGS.search_frames
        if again.any():
            self._look_again(frame, expected, found, got, np.flatnonzero(again))
        beside = np.append(got, False)[self._around].sum(axis=0)
        return found, got & (beside >= self._beside_min)

    def _look_again(
        self,
        frame: ImageArray,
        expected: FloatArray,
        found: Moments,
        got: BoolArray,
        again: IntArray,
    ) -> None:
        """Look in wider windows for markers ``again``, where their neighbours' motion puts them.

        Changes ``found`` and ``got``.
        """
        off = np.where(got[:, None], found.centroid_px - expected, 0.0)
        likely = expected + self._neighbour_mean(off, got)
        centre = np.where(got[:, None], found.centroid_px, likely)
        wider = SETTINGS.wider_margins * self._margin
        more = self.paint.look_wider(frame, again, centre, wider)
        away = np.hypot(*(more.centroid_px - centre[again]).T)
        others = np.append(centre, [[np.inf, np.inf]], axis=0)[self._rivals[again]]
        gap = np.linalg.norm(others - centre[again][:, None], axis=2).min(axis=1, initial=np.inf)
        sure = (more.weight >= self._paint_min[again]) & (away <= SETTINGS.gate_share * gap)
        sure &= more.rim <= (self._rim_max[again] + SETTINGS.rim_excess) * more.weight
        for values, new in zip((*found, got), (*more, sure), strict=True):
            values[again] = new

    def _neighbour_mean(self, step: FloatArray, got: BoolArray) -> FloatArray:
        """Mean step (m, 2) of each marker's neighbours that were found; 0 where none was.

        ``step`` is 0 for markers that were not found.
        """
        values = np.zeros((len(step) + 1, 3))
        values[:-1, :2], values[:-1, 2] = step, got
        total = values.take(self._around, axis=0).sum(axis=0)
        return np.asarray(total[:, :2] / np.maximum(total[:, 2:], 1.0))

    def _update(self, frame: ImageArray, found: Moments, got: BoolArray, since: float) -> Observed:
        """Take what was found as the new state."""
        step = np.where(got[:, None], found.centroid_px - self.place_px, 0.0)
        beside = self._neighbour_mean(step, got)
        step[~got] = beside[~got]
        self.place_px = self.place_px + step
        self._velocity = (0.5 * SETTINGS.damping / max(since, 1.0)) * (step + beside)
        self._lost_for = np.where(got, 0, self._lost_for + 1)
        self._rejected = 0
        share = found.weight / np.maximum(self._full, 1e-6)
        red = self.red.look(frame, self.place_px[self._tips] + self._tip_px).weight
        # Tips are in the same light as the markers.
        red = red / np.clip(np.median(share[got]) if got.any() else 1.0, LIGHT_MIN, LIGHT_MAX)
        red = red / self._tip_model.red_light(red)
        self._on = red > np.where(self._on, self._off_below, self._on_above)
        switch_on, half_out = np.zeros((2, len(got)), dtype=np.bool_)
        switch_on[self._tips] = self._on
        half_out[self._tips] = self._tip_model.half_out(red, self._on)
        return Observed(
            position_px=self._of_bundle(np.where(got[:, None], self.place_px, np.nan), np.nan),
            switch_on=self._of_bundle(switch_on, fill=False),
            half_out=self._of_bundle(half_out, fill=False),
            paint=self._of_bundle(share, 0.0),
        )

    def _of_bundle(self, values: NDArray[Any], fill: float) -> NDArray[Any]:
        """Values of all markers and marks of the bundle from those (m, …) that are shown here."""
        out = np.full((len(self._bundle.spot_colour), *values.shape[1:]), fill, dtype=values.dtype)
        out[self.ids] = values
        return out


def nearest_rivals(place_px: FloatArray, colour: IntArray) -> IntArray:
    """Nearest others (n, r) of the same colour, nearest first; n where there are no more."""
    square = np.sum((place_px[:, None] - place_px[None]) ** 2, axis=2)
    square[colour[:, None] != colour[None]] = np.inf
    np.fill_diagonal(square, np.inf)
    order = np.argsort(square, axis=1)[:, : SETTINGS.rivals_max]
    known = np.isfinite(np.take_along_axis(square, order, axis=1))
    return np.where(known, order, len(place_px))


def _owned_pixels(
    blobs: Blobs, place: FloatArray, colour: IntArray, spacing: FloatArray
) -> tuple[IntArray, IntArray]:
    """Painted pixels (p, 2) of blobs that belong to a marker, and the marker of each (p,)."""
    gap = np.linalg.norm(blobs.centroid_px[:, None] - place[None], axis=2)
    gap[blobs.colour[:, None] != colour[None]] = np.inf
    nearest = np.argmin(gap, axis=1)
    near = gap.min(axis=1) <= SETTINGS.blob_reach * np.minimum(spacing[nearest], 1e6)
    owner = np.append(-1, np.where(near, nearest, -1))
    labels = np.asarray(blobs.labels)
    y, x = np.nonzero(labels)
    owned = owner[labels[y, x]]
    return np.column_stack([x, y])[owned >= 0], owned[owned >= 0]


def _extent(xy: IntArray, owner: IntArray, place: FloatArray, neighbours: IntArray) -> FloatArray:
    """How far (m,) px each marker's paint reaches from its centre, in x or y."""
    reach = np.zeros(len(place))
    np.maximum.at(reach, owner, np.abs(xy - place[owner]).max(axis=1) + 0.5)
    known = np.where(reach > 0.0, reach, np.nan)
    usual = neighbour_median(known[:, None], neighbours)[:, 0]
    overall = np.nanmedian(known) if np.isfinite(known).any() else SETTINGS.extent_min_px
    usual = np.where(np.isfinite(usual), usual, overall)
    # fmin: an unknown extent is the neighbours'.
    out = np.fmin(known, SETTINGS.extent_ratio * usual)
    return np.maximum(np.where(np.isfinite(known), out, usual), SETTINGS.extent_min_px)
