"""Markers of one camera, followed from frame to frame."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FOUND_MIN, locate_in
from phytac_decoder.pipeline.tracker_setup import learn
from phytac_decoder.vision.segmentation import check_image
from phytac_decoder.vision.windows import Moments
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

PAINT_LEAST = 0.3
"""A marker that shows less than this share of its paint at rest is lost."""
PAINT_LEAST_px = 1.5
FAINT_px = 5.0
"""Markers that show less paint at rest are not looked for again: they flicker."""
RIM_MORE = 0.05
"""A marker with this share of its paint more in its window's rim than at rest has run out of it."""
WHOLE = 0.97
"""A window that shows this share of the paint in a wider one shows the whole marker."""
STEP_MOST = 0.3
"""A marker that is found farther from where it was expected than this share of the way to the next
of its colour is looked for again, beside the motion of its neighbours."""
GATE = 0.42
"""There it must be nearer than this share of the way to any other's place: never half way."""
WIDER = 4.0
"""How much farther the second look reaches, in margins."""
DAMPING = 0.8
"""Share of the last velocity that is expected to last."""
JUMP_px, JUMP_MARGINS = 1.0, 2.0
"""A marker jumps that is farther than this and so many margins from where it was expected."""
JUMP_SHARE = 0.3
"""A frame in which more than this share of the markers jump is refused."""
PATIENCE = 10
"""Frames after which a lost marker is looked for in every ``PATIENCE``-th frame only."""
LOST_STEP = 3
"""A frame in which a marker is lost counts as so many in which it is found: flickering is lost."""
REFUSED_MAX = 3
"""After as many refused frames in a row the whole frame is searched."""
HYSTERESIS = 0.1
"""A switch turns on this share of the red between off and on above the threshold, off below it."""
AGREE_px = 1.0
"""A full search that finds a marker within this of where it is followed agrees."""


@dataclass(frozen=True, kw_only=True)
class SeenBy:
    """What one camera's frame shows of all n markers of the bundle.

    Attributes
    ----------
    position_px : (n, 2) float
        NaN where not found.
    bits : (n,) bool
        Switches that are on.
    paint : (n,) float
        Paint over that at rest.
    flags : tuple of str
        What was unusual about the frame.
    """

    position_px: FloatArray
    bits: BoolArray
    paint: FloatArray
    flags: tuple[str, ...] = ()


class CameraFollower:
    """Follows what one camera of a bundle shows; parameters as of ``Follower``."""

    def __init__(
        self, bundle: Bundle, number: int, rest: ImageArray, *, stride: int, margin_px: float
    ) -> None:
        self._bundle, self._number, self._margin = bundle, number, margin_px
        frame = np.ascontiguousarray(rest)
        known = learn(bundle, number, frame, margin_px=margin_px, stride=stride)
        self._known = known
        count = len(known.ids)
        self._own = (bundle.read_by[known.ids] == number) & known.parted
        self._enough = FOUND_MIN * np.count_nonzero(self._own)
        weight = known.at_rest.weight
        # Of a marker that is hidden in the rest frame: as its neighbours have.
        usual = np.nan_to_num(_around(np.column_stack([weight, weight]), known.neighbours)[:, 0])
        self._full = np.where(weight > PAINT_LEAST * usual, weight, usual)
        self._rim = RIM_MORE + known.at_rest.rim / np.maximum(weight, 1e-6)
        least = np.maximum(PAINT_LEAST * self._full, PAINT_LEAST_px)
        self._least = np.where(known.parted, least, np.inf)
        self._worth = known.parted & (self._full >= FAINT_px)
        self._jump = JUMP_MARGINS * margin_px + JUMP_px
        self._alert = STEP_MOST * known.apart_px
        tips = bundle.shown_by(number).tips
        ids = known.ids[known.tips]
        middle = tips.threshold_px[ids]
        band = HYSTERESIS * np.maximum(tips.red_on_px[ids] - tips.red_rest_px[ids], 0.0)
        self._on_above, self._off_below = middle + band, np.maximum(middle - band, 1.0)
        self._place, self._velocity = known.rest_px.copy(), np.zeros((count, 2))
        self._lost_for = np.where(weight >= self._least, 0, 1)
        self._missed, self._clock = 0, 0
        # What is handed out, and where each of the bundle's markers stands in it; last: not shown.
        self._back = np.full(len(bundle.colour), count)
        self._back[known.ids] = np.arange(count)
        self._seen_px, self._paint = np.full((count + 1, 2), np.nan), np.zeros(count + 1)
        self._bits = np.zeros(count + 1, dtype=np.bool_)
        self._per_full = 1.0 / np.maximum(self._full, 1e-6)
        # Neighbour by neighbour; the last entries are of none.
        self._near = np.ascontiguousarray(known.neighbours.T)
        self._steps = np.zeros(count + 1, dtype=np.complex128)
        self._counted, self._per_count = np.zeros(count, dtype=np.bool_), np.ones(count)
        red = known.red.look(self._place[known.tips] + known.tip_px).weight
        self._on = red > middle

    @property
    def rest_px(self) -> FloatArray:
        """Rest positions (n, 2) of all markers of the bundle; NaN where not found."""
        out = np.full((len(self._bundle.colour), 2), np.nan)
        out[self._known.ids] = np.where(
            (self._known.at_rest.weight >= self._least)[:, None], self._known.rest_px, np.nan
        )
        return out

    @property
    def pixels(self) -> int:
        """Pixels looked at in a frame in which nothing is lost."""
        return self._known.paint.pixels + self._known.red.pixels

    def follow(self, image: ImageArray, elapsed: float) -> SeenBy:
        """Find all markers in the next frame, ``elapsed`` frames after the last one given.

        Raises
        ------
        InputError
            If the frame has another size, shows too few markers, or they have jumped; what is
            known of the markers stays as it was.
        """
        camera, bundle = self._bundle.cameras[self._number], self._bundle
        frame = np.ascontiguousarray(
            check_image(image, width_px=camera.width_px, height_px=camera.height_px)
        )
        self._clock += 1
        since = elapsed + self._missed
        expected = self._place + since * self._velocity
        self._known.picture.read(frame)
        found, got = self._find(expected)
        away = _larger(found.centroid_px - expected)
        jumped = got & (away > self._jump * max(elapsed, 1.0))
        own = self._own
        some = np.count_nonzero(got & own) >= self._enough
        if not some or np.count_nonzero(jumped) > JUMP_SHARE * len(jumped):
            self._missed += 1
            if self._missed >= REFUSED_MAX:
                return self.search(frame)
            where = bundle.of_camera(self._number)
            if not some:
                raise InputError(
                    f"found {int(got[own].sum())} of {int(own.sum())} markers{where} where they "
                    f"were followed; is the frame black, torn or of another sensor than "
                    f"{bundle.design!r}? give the next one"
                )
            raise InputError(
                f"{int(jumped.sum())} of {len(got)} markers{where} jumped by "
                f"{np.median(away[jumped]):.1f} px from one frame to the next: "
                "it is torn, the camera was knocked or many frames were dropped; give the next one"
            )
        return self._keep(found, got, since)

    def search(self, frame: ImageArray) -> SeenBy:
        """Find all markers in the whole frame; lost ones are regained, doubtful ones settled.

        Raises
        ------
        InputError
            See :func:`phytac_decoder.pipeline.decode.locate_in`.
        """
        known = self._known
        matched, _ = locate_in(self._bundle, self._number, frame)
        place = matched.position_px[known.ids]
        known.picture.read(frame)
        seen, got = self._find(self._place)
        shift = np.where(got[:, None], seen.centroid_px - known.rest_px, np.nan)
        wide = place - known.rest_px
        # Of two places that of the motion more like that of the neighbours.
        both = np.stack([shift, wide])
        usual = _around(np.where(np.isfinite(wide), wide, shift), known.neighbours)
        off = np.nan_to_num(np.hypot(*np.moveaxis(both - usual, 2, 0)), nan=np.inf)
        far = ~(np.hypot(*(shift - wide).T) <= AGREE_px)
        better = far & (off[1] < off[0])
        start = np.where(
            better[:, None], place, np.where(got[:, None], seen.centroid_px, self._place)
        )
        unknown = ~got & ~better
        start[unknown] = (known.rest_px + np.nan_to_num(usual))[unknown]
        self._place, self._velocity[:] = start, 0.0
        found, got = self._find(start)
        out = self._keep(found, got, 0.0)
        return SeenBy(
            position_px=out.position_px,
            bits=out.bits,
            paint=out.paint,
            flags=(
                *out.flags,
                f"the whole frame{self._bundle.of_camera(self._number)} was searched",
            ),
        )

    def _find(self, expected: FloatArray) -> tuple[Moments, BoolArray]:
        """Paint of all markers near their expected places, and which of them it is sure of."""
        found = self._known.paint.look(expected)
        got = found.weight >= self._least
        got &= found.rim <= self._rim * found.weight
        got &= _larger(found.centroid_px - expected) <= self._alert
        again = self._worth > got
        if again.any() and self._clock % PATIENCE:
            again &= self._lost_for <= LOST_STEP * PATIENCE
        if not again.any():
            return found, got
        return self._look_again(expected, found, got, np.flatnonzero(again))

    def _look_again(
        self, expected: FloatArray, found: Moments, got: BoolArray, again: IntArray
    ) -> tuple[Moments, BoolArray]:
        """Look in wider windows for markers ``again``, where their neighbours' motion puts them."""
        known = self._known
        off = np.where(got[:, None], found.centroid_px - expected, 0.0)
        likely = expected + self._beside(off, got)
        centre = np.where(got[:, None], found.centroid_px, likely)
        more = known.paint.look_at(again, centre, WIDER * self._margin)
        away = np.hypot(*(more.centroid_px - centre[again]).T)
        others = np.concatenate([centre, np.full((1, 2), np.inf)])[known.rivals[again]]
        gap = np.hypot(*np.moveaxis(others - centre[again][:, None], 2, 0)).min(
            axis=1, initial=np.inf
        )
        sure = (more.weight >= self._least[again]) & (away <= GATE * gap)
        sure &= more.rim <= (self._rim[again] + RIM_MORE) * more.weight
        # A rim that holds paint of others: nothing of the marker's own lies beyond it.
        whole = sure & (found.weight[again] > WHOLE * more.weight)
        share = found.rim[again] / np.maximum(found.weight[again], 1e-6) + RIM_MORE
        self._rim[again] = np.where(whole, np.maximum(self._rim[again], share), self._rim[again])
        weight, centroid, rim = found.weight.copy(), found.centroid_px.copy(), found.rim.copy()
        weight[again], centroid[again], rim[again] = more
        got = got.copy()
        got[again] = sure
        return Moments(weight, centroid, rim), got

    def _beside(self, step: FloatArray, got: BoolArray) -> FloatArray:
        """Mean step (m, 2) of each marker's neighbours that were found; 0 where none was.

        ``step`` is 0 for markers that were not found.
        """
        # Complex numbers: one sum for both coordinates.
        self._steps[:-1] = step.view(np.complex128)[:, 0]
        total = self._steps.take(self._near).sum(axis=0)
        # Mostly those that were found in the last frame.
        if not np.array_equal(got, self._counted):
            seen = np.append(got, False)[self._near]
            self._counted, self._per_count = got, 1.0 / np.maximum(seen.sum(axis=0), 1)
        total *= self._per_count
        return np.asarray(total.view(np.float64).reshape(-1, 2))

    def _keep(self, found: Moments, got: BoolArray, since: float) -> SeenBy:
        """Take what was found as the new state."""
        known = self._known
        lost = np.flatnonzero(~got)
        step = found.centroid_px - self._place
        step[lost] = 0.0
        beside = self._beside(step, got)
        step[lost] = beside[lost]
        self._place = self._place + step
        self._velocity = (0.5 * DAMPING / max(since, 1.0)) * (step + beside)
        self._lost_for -= 1
        self._lost_for[lost] += LOST_STEP + 1
        np.maximum(self._lost_for, 0, out=self._lost_for)
        np.minimum(self._lost_for, LOST_STEP * PATIENCE + 1, out=self._lost_for)
        self._missed = 0
        tips = self._place.take(known.tips, axis=0)
        tips += known.tip_px
        red = known.red.look(tips).weight
        self._on = red > np.where(self._on, self._off_below, self._on_above)
        self._seen_px[:-1] = self._place
        self._seen_px[lost] = np.nan
        np.multiply(found.weight, self._per_full, out=self._paint[:-1])
        self._bits[known.tips] = self._on
        back = self._back
        return SeenBy(
            position_px=self._seen_px.take(back, axis=0),
            bits=self._bits.take(back),
            paint=self._paint.take(back),
        )


def _larger(away: FloatArray) -> FloatArray:
    """Distance (m,) along x or y, whichever is larger."""
    distance = np.abs(away)
    return np.maximum(distance[:, 0], distance[:, 1])


def _around(off: FloatArray, neighbours: IntArray) -> FloatArray:
    """Median (m, 2) over each marker's neighbours; NaN where none is known."""
    around = np.concatenate([off, np.full((1, 2), np.nan)])[neighbours]
    out = np.full_like(off, np.nan)
    seen = np.isfinite(around[:, :, 0]).any(axis=1)
    out[seen] = np.nanmedian(around[seen], axis=1)
    return out
