"""Shifts of small markers by the luminance of their edges, together with their paint's centroid.

Cameras record colour more coarsely than luminance: Bayer mosaics, 4:2:2 and 4:2:0 share it among
pixels, and JPEG quantises it. The centroid of a marker of a few pixels, which is weighted by
colour, is then wrong by a tenth of a pixel. How far its edges have moved since the rest frame is
measured by aligning their luminance (Lucas-Kanade with a template's gradient: Baker and Matthews,
Int. J. Computer Vision 56, 2004), without the pixels on which a red tip lies.

Both are combined by their variances. The centroid's is measured in each frame, by the difference
of the two where markers hardly move. Edges do not move exactly as the centroid does, which the
tables of the decoder describe: where other receptors hide paint, or where a receptor turns.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.vision.matching import squared_distances
from phytac_decoder.vision.segmentation import Blobs, ColourModel, segment
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

Floats32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class EdgeSettings:
    """How edges are read; set on rendered presses of ``handle``, ``cylinder60``, ``hemisphere``.

    Attributes
    ----------
    area_min_px, area_max_px : float
        Markers with less paint than the first are read by their colour alone. A camera's markers
        are read by their edges if half of the others have less paint than the second: the centroids
        of larger ones suffer little from coarse colour.
    pixels : int
        Most pixels of a marker that are read, those with the strongest gradient.
    grow_px, around_px : int
        How far beyond its paint they lie, and the side of the square over which its gradient is
        averaged for their weights.
    blur_px, difference_px2 : float
        Standard deviation of the filter of luminance, and by how much the variance of that of its
        change with the motion is less. A central difference is the mean slope over two pixels, of
        variance 1/3; edges that are sharper than pixels would otherwise seem to move by a tenth
        more than they do (2 % now, for shifts of 0.05 to 1 px).
    contrast : float
        Weak edges count as strong ones do, down to this share of a marker's median gradient
        (squares), as they do for the centroid.
    rounds, step_max_px, step_far_px : int, float, float
        The pixels that are compared are chosen again after a step larger than this, so often; and
        the largest step.
    margin_px : int
        A pixel does not count within this distance of a red one.
    red_reach : float
        Tips within so many reaches of a marker may lie on it.
    seen_min, away_max_px, tip_away_max_px : float
        Edges count if this share of their weight is without red, and if they agree with the
        centroid within this distance, or where the own tip is out within the last.
    calm_px, calm_min : float, int
        The centroid's error is measured on markers that move by less, if there are so many.
    around : int
        Markers, itself among them, to whose changes of brightness a plane is fitted.
    brightness : (float, float)
        Least and largest change of brightness of some markers against the others.
    noise, noise_max_px : float
        Markers do not count whose shift would have more noise than the last with so many grey
        levels of noise in each pixel: paint as bright as the wall shows no edge.
    sd_px, share : float
        Standard deviation of shifts by edges, and its share of the motion, by which they differ
        from those of the centroid (2 to 4 % RMS).
    centroid_sd_px, tip_sd_px : float
        Least standard deviation of centroids, and that of those whose own tip is out.
    """

    area_min_px: float = 25.0
    area_max_px: float = 400.0
    pixels: int = 192
    grow_px: int = 1
    around_px: int = 5
    blur_px: float = 1.0
    difference_px2: float = 0.25
    contrast: float = 0.3
    rounds: int = 3
    step_max_px: float = 0.6
    step_far_px: float = 1.5
    margin_px: int = 2
    red_reach: float = 2.5
    seen_min: float = 0.3
    away_max_px: float = 0.8
    tip_away_max_px: float = 1.5
    calm_px: float = 0.3
    calm_min: int = 20
    around: int = 9
    brightness: tuple[float, float] = (0.5, 2.0)
    noise: float = 1.5
    noise_max_px: float = 0.03
    sd_px: float = 0.01
    share: float = 0.04
    centroid_sd_px: float = 0.005
    tip_sd_px: float = 0.17


SETTINGS = EdgeSettings()


@dataclass(frozen=True, kw_only=True)
class MarkerEdges:
    """Edges of a camera's markers in its rest frame: k pixels of each of m markers.

    Attributes
    ----------
    ids : (m,) int
        The markers.
    rest_px : (n, 2) float
        Centroids of the paint of all markers, NaN of those that the camera does not read.
    reach_px : (m,) float
        How far the pixels lie from there, in x or y.
    pixel : (2, m, k) int32
        Columns and rows.
    level, weight : (m, k) float32
        Filtered luminance, grey levels, and weights, 0 of pixels that only fill the row.
    slope, motion : (m, k, 2) float32
        Its gradient, by which pixels are weighted, and by which it changes as the marker moves,
        grey levels per px.
    blur : (m, k) float32
        Change of luminance per px² of a Gaussian blur, grey levels.
    cubic, blur_loss : float
        By how much the change of luminance is less than in proportion to the shift, per px² of the
        shift, and by how much less it is in a blurred picture, per px² of blur.
    colours : ColourModel
        Paints: a red tip's pixels do not count.
    """

    ids: IntArray
    rest_px: FloatArray
    reach_px: FloatArray
    pixel: NDArray[np.int32]
    level: Floats32
    weight: Floats32
    slope: Floats32
    motion: Floats32
    blur: Floats32
    cubic: float
    blur_loss: float
    colours: ColourModel

    @classmethod
    def at_rest(
        cls, frame: ImageArray, colours: ColourModel, place_px: FloatArray, area_px: FloatArray
    ) -> "MarkerEdges | None":
        """Edges of one camera's markers, some of them NaN: it does not read those.

        None where markers are large, or dots that are separated by luminance already.

        Parameters
        ----------
        frame : (h, w, 3) uint8
            Rest frame.
        colours : ColourModel
            Calibrated paints.
        place_px, area_px : (n, 2) float, (n,) float
            Centroids of the markers' paint, and its area.
        """
        shown = np.flatnonzero(np.isfinite(place_px[:, 0]) & (area_px >= SETTINGS.area_min_px))
        if colours.dots or not len(shown) or np.median(area_px[shown]) >= SETTINGS.area_max_px:
            return None
        blobs = segment(frame, colours, with_labels=True)
        if not len(blobs.colour):
            return None
        square = squared_distances(place_px[shown], blobs.centroid_px)
        nearest = np.argmin(square, axis=1)
        # A marker in several blobs has its centroid between them.
        alone = square[np.arange(len(shown)), nearest] < 1.0
        if not alone.any():
            return None
        grey = _luminance(frame)
        level = _filtered(grey)
        slope, motion = _gradient(level), _gradient(_filtered(grey, SETTINGS.difference_px2))
        usual = cv2.boxFilter(np.sum(slope**2, axis=2), -1, (SETTINGS.around_px,) * 2)
        chosen = [_edge_pixels(blobs, int(one), slope) for one in nearest[alone]]
        most = max(len(x) for x, _ in chosen)
        pixel = np.zeros((2, len(chosen), most), dtype=np.int32)
        weight = np.zeros((len(chosen), most), dtype=np.float32)
        for row, (x, y) in enumerate(chosen):
            pixel[:, row, : len(x)] = x, y
            around = usual[y, x]
            weight[row, : len(x)] = 1.0 / (
                around / max(float(np.median(around)), 1e-6) + SETTINGS.contrast
            )
        slopes, motions = slope[pixel[1], pixel[0]], motion[pixel[1], pixel[0]]
        weighted = slopes * weight[:, :, None]
        motion_per_change = _motion_per_change(weighted, motions)
        squares = np.einsum("mki,mkj->mij", weighted, weighted, dtype=np.float64)
        variance = np.einsum("mij,mjk,mik->m", motion_per_change, squares, motion_per_change)
        clear = SETTINGS.noise * np.sqrt(variance) <= SETTINGS.noise_max_px
        if not clear.any():
            return None
        second = [_gradient(np.ascontiguousarray(slope[:, :, k])) for k in (0, 1)]
        blur = 0.5 * (second[0][:, :, 0] + second[1][:, :, 1])
        total = max(float(np.sum(weighted * motions)), 1e-9)
        curved = sum(
            float(np.sum(weight[:, :, None] * each[pixel[1], pixel[0]] ** 2)) for each in second
        )
        weaker = float(np.sum(weighted * _gradient(blur)[pixel[1], pixel[0]]))
        ids = shown[alone]
        found = cls(
            ids=ids[clear],
            rest_px=place_px,
            reach_px=_reach_px(pixel, weight, place_px[ids])[clear],
            pixel=pixel[:, clear],
            level=level[pixel[1], pixel[0]][clear],
            weight=weight[clear],
            slope=slopes[clear],
            motion=motions[clear],
            blur=blur[pixel[1], pixel[0]][clear],
            # The third order of an edge's luminance; of a round marker 3/4 of it count.
            cubic=0.125 * curved / total,
            blur_loss=-weaker / total,
            colours=colours,
        )
        return replace(found, blur_loss=found._blur_loss_in(frame))

    def _blur_loss_in(self, frame: ImageArray) -> float:
        """``blur_loss`` by which edges of a rest frame that is moved and blurred move as they do.

        Theory is for little blur, of which a part is taken for a change of light: on ``handle`` it
        gives three quarters of that.
        """
        share_min, share_max = 0.5, 3.0  # of theory, however faint the edges
        moved_px, blur_px2 = np.array([0.3, 0.3]), 0.5
        still = np.zeros((len(self.ids), 2))
        to = np.column_stack([np.eye(2), moved_px])
        size = (frame.shape[1], frame.shape[0])
        moved = np.asarray(cv2.warpAffine(frame, to, size, flags=cv2.INTER_LANCZOS4))
        blurred = np.asarray(cv2.GaussianBlur(moved, (0, 0), np.sqrt(blur_px2)))

        def seen(edges: MarkerEdges, image: ImageArray) -> float:
            rows, bare = np.arange(len(still)), np.zeros(len(still), dtype=np.bool_)
            return float(np.median(edges._aligned(image, rows, still, bare)[0] @ moved_px))

        without, by_theory = seen(replace(self, blur_loss=0.0), blurred), seen(self, blurred)
        wanted, gained = seen(self, moved) - without, by_theory - without
        share = wanted / gained if gained > 1e-3 else 1.0
        return self.blur_loss * float(np.clip(share, share_min, share_max))

    def combined(
        self, frame: ImageArray, shift_px: FloatArray, red: BoolArray, on: BoolArray
    ) -> FloatArray:
        """Shifts (n, 2) px of all markers, of those with edges by centroids and edges together.

        Parameters
        ----------
        frame : (h, w, 3) uint8
            Frame of the same camera.
        shift_px : (n, 2) float
            Shifts of the centroids, without what tips cover; NaN for a marker that is not found.
        red, on : (n,) bool
            Markers whose tip shows red, and whose switch is on.
        """
        rows = np.flatnonzero(np.isfinite(shift_px[self.ids, 0]))
        ids = self.ids[rows]
        reddened = self._reddened(rows, shift_px, red)
        moved, seen = self._aligned(frame, rows, shift_px[ids], reddened)
        apart = moved - shift_px[ids]
        away_max = np.where(on[ids], SETTINGS.tip_away_max_px, SETTINGS.away_max_px)
        good = (seen >= SETTINGS.seen_min) & (np.hypot(*apart.T) <= away_max)
        motion = np.hypot(*moved.T)
        plain = good & ~reddened
        calm = plain & (motion < SETTINGS.calm_px)
        sample = calm if np.count_nonzero(calm) >= SETTINGS.calm_min else plain
        out = shift_px.copy()
        if sample.any():
            spread = 1.4826 * float(np.median(np.abs(apart[sample])))
            centroid = max(spread**2 - SETTINGS.sd_px**2, SETTINGS.centroid_sd_px**2) + np.where(
                on[ids], SETTINGS.tip_sd_px**2, 0.0
            )
            edges = SETTINGS.sd_px**2 + (SETTINGS.share * motion) ** 2
            share = np.where(good, centroid / (centroid + edges), 0.0)
            out[ids] += share[:, None] * np.where(good[:, None], apart, 0.0)
        return out

    def _reddened(self, rows: IntArray, shift_px: FloatArray, red: BoolArray) -> BoolArray:
        """Whether red of a tip, of those (n,) that show, may lie on markers ``rows`` (m,)."""
        place, own = self.rest_px + np.nan_to_num(shift_px), self.ids[rows]
        out = red[own].copy()
        for tip in np.flatnonzero(red):
            gap = np.hypot(*(place[own] - place[tip]).T)
            out |= gap < SETTINGS.red_reach * self.reach_px[rows]
        return out

    def _aligned(
        self, frame: ImageArray, rows: IntArray, start_px: FloatArray, reddened: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Shifts (m, 2) px of edges, near those at the start, and the share (m,) that is seen.

        The share is that of the pixels' weight that no red tip may cover.
        """
        level, moved = _filtered(_luminance(frame)), start_px.copy()
        seen, live = np.ones(len(rows)), np.arange(len(rows))
        for _ in range(SETTINGS.rounds):
            whole = np.rint(moved[live])
            step, seen[live] = self._step(frame, level, rows[live], whole, reddened[live])
            moved[live] = whole + step
            live = live[np.abs(step).max(axis=1) > SETTINGS.step_max_px]
            if not len(live):
                break
        return moved, seen

    def _step(
        self,
        frame: ImageArray,
        level: Floats32,
        rows: IntArray,
        whole_px: FloatArray,
        reddened: BoolArray,
    ) -> tuple[FloatArray, FloatArray]:
        """How far (m, 2) px edges are from shifts by whole pixels, and the share (m,) seen."""
        height, width = level.shape
        x, y = (self._taken(self.pixel, rows, axis=1) + whole_px.T[:, :, None]).astype(np.int64)
        x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
        weighted, flat, blur, motion_per_change = (
            self._taken(each, rows) for each in self._precomputed
        )
        seen = np.ones(len(rows))
        if reddened.any():
            some = np.flatnonzero(reddened)
            bare = (~self._red_near(frame, x[some], y[some])).astype(np.float32)
            weighted, flat, blur, motion_per_change = (
                each.copy() for each in (weighted, flat, blur, motion_per_change)
            )
            weighted[some] *= bare[:, :, None]
            flat[some] *= bare
            blur[some] *= bare
            motion_per_change[some] = _motion_per_change(weighted[some], self.motion[rows[some]])
            weight = self.weight[rows[some]]
            seen[some] = (weight * bare).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
        rest = self._taken(self.level, rows)
        now = level.ravel()[y * width + x]
        offset, factor = self._brightness(rows, rest, now, flat)
        now = (now - offset) * factor
        change = _in_the_light_of(rest, now, flat) - rest
        # Less focus than at rest, of all edges alike, is one unknown of the frame, px².
        added = float(np.vdot(change, blur)) / max(float(np.vdot(blur, blur)), 1e-9)
        change -= added * blur
        pull = np.einsum("mki,mk->mi", weighted, change)
        step = -np.einsum("mij,mj->mi", motion_per_change, pull.astype(np.float64))
        # Motion looks like blur to second order.
        added -= 0.5 * float(np.mean(np.sum(step**2, axis=1)))
        step *= 1.0 + self.blur_loss * max(added, 0.0)
        step = np.clip(step, -SETTINGS.step_far_px, SETTINGS.step_far_px)
        # The change of luminance is less than in proportion to the shift.
        step *= 1.0 + self.cubic * np.sum(step**2, axis=1, keepdims=True)
        return step, seen

    def _brightness(
        self, rows: IntArray, rest: Floats32, now: Floats32, flat: Floats32
    ) -> tuple[np.float32, Floats32]:
        """Offset of the picture's luminance, and the factor (m, k) by which it has darkened.

        It is the plane through those of the marker and of the ones around it: the luminance beside
        one alone changes as it moves.
        """
        own, total = np.full(len(self.ids), np.nan), flat.sum(axis=1)
        seen = total > 1e-6  # red may cover a marker altogether
        total = np.maximum(total, 1e-6)
        mean_rest, mean_now = (np.einsum("mk,mk->m", flat, each) / total for each in (rest, now))
        apart_rest, apart_now = rest - mean_rest[:, None], now - mean_now[:, None]
        spread_rest, spread_now = (
            np.einsum("mk,mk,mk->m", flat, each, each) for each in (apart_rest, apart_now)
        )
        contrast = np.sqrt(spread_now / np.maximum(spread_rest, 1e-9))
        offset = float(np.median((mean_now - contrast * mean_rest)[seen])) if seen.any() else 0.0
        own[rows[seen]] = (mean_rest / np.maximum(mean_now - offset, 1e-6))[seen]
        near, planes = self._around
        around, planes = own[near[rows]], planes[rows]
        known = np.isfinite(around)
        # As bright as at rest where none of them is seen.
        mean = np.where(known, around, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        mean[~known.any(axis=1)] = 1.0
        apart = np.where(known, around - mean[:, None], 0.0)
        level, along_x, along_y = np.einsum("mpa,ma->pm", planes, apart).astype(np.float32)
        out = (level + mean.astype(np.float32))[:, None]
        x, y = (self._taken(each, rows) for each in self._offset)
        out = out + along_x[:, None] * x + along_y[:, None] * y
        factor = np.asarray(np.clip(out, *SETTINGS.brightness), dtype=np.float32)
        return np.float32(offset), factor

    @cached_property
    def _around(self) -> tuple[IntArray, FloatArray]:
        """Each marker and its nearest ones (m, a), and what fits planes (m, 3, a) to their values.

        A plane has a level at the marker, and slopes along x and y per px.
        """
        place = self.rest_px[self.ids]
        count = min(SETTINGS.around, len(place))
        near = np.argsort(squared_distances(place, place), axis=1, kind="stable")[:, :count]
        apart = place[near] - place[:, None]
        design = np.concatenate([np.ones((*near.shape, 1)), apart], axis=2)
        return near, np.linalg.pinv(design, rcond=1e-6)

    @cached_property
    def _offset(self) -> tuple[Floats32, Floats32]:
        """Columns and rows (m, k) of all pixels from their markers' places, px."""
        x, y = self.pixel - self.rest_px[self.ids].T[:, :, None]
        return x.astype(np.float32), y.astype(np.float32)

    @cached_property
    def _precomputed(self) -> tuple[Floats32, Floats32, Floats32, FloatArray]:
        """What does not depend on the frame, of all markers.

        Weighted gradients, weights of levels that do not change with the motion and say how light
        has changed, change by blur, and motion per weighted change.
        """
        known = self.weight > 0.0
        weighted = self.slope * self.weight[:, :, None]
        flat = known / (np.float32(1.0) + np.sum(self.slope**2, axis=2))
        return weighted, flat, self.blur * known, _motion_per_change(weighted, self.motion)

    def _taken(self, values: Any, rows: IntArray, axis: int = 0) -> Any:
        """Values of some markers, without a copy of those of all."""
        return values if len(rows) == len(self.ids) else np.take(values, rows, axis=axis)

    def _red_near(self, frame: ImageArray, x: IntArray, y: IntArray) -> BoolArray:
        """Whether pixels (m, k) are red, or lie beside red ones."""
        out = np.zeros(x.shape, dtype=np.bool_)
        height, width = frame.shape[:2]
        number = self.colours.names.index("red") + 1
        for down in (-SETTINGS.margin_px, 0, SETTINGS.margin_px):
            for across in (-SETTINGS.margin_px, 0, SETTINGS.margin_px):
                rows = np.clip(y + down, 0, height - 1)
                columns = np.clip(x + across, 0, width - 1)
                out |= self.colours.classify(frame[rows, columns])[0] == number
        return out


def _reach_px(pixel: NDArray[np.int32], weight: Floats32, place_px: FloatArray) -> FloatArray:
    """How far the pixels (2, m, k) that count lie from places (m, 2), in x or y."""
    offset = np.where(weight > 0.0, np.abs(pixel - place_px.T[:, :, None]), 0.0)
    return np.asarray(offset.max(axis=(0, 2)))


def _luminance(frame: ImageArray) -> Floats32:
    return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), dtype=np.float32)


def _filtered(grey: Floats32, less_px2: float = 0.0) -> Floats32:
    """Luminance (h, w) after the filter, whose variance is less by so much."""
    sigma = float(np.sqrt(SETTINGS.blur_px**2 - less_px2))
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma))


def _in_the_light_of(rest: Floats32, now: Floats32, weight: Floats32) -> Floats32:
    """Luminance (m, k) as it would be in the light, and with the offset, of the rest frame."""
    total = max(float(weight.sum()), 1e-9)
    mean, mean_rest = (float(np.vdot(weight, each)) / total for each in (now, rest))
    apart, apart_rest = now - np.float32(mean), rest - np.float32(mean_rest)
    # A ratio of spreads: by regression, edges that have moved would seem to be fainter.
    spread = float(np.vdot(weight, apart**2))
    spread_rest = float(np.vdot(weight, apart_rest**2))
    return np.float32(mean_rest) + np.float32(np.sqrt(spread_rest / max(spread, 1e-9))) * apart


def _motion_per_change(weighted: Floats32, motion: Floats32) -> FloatArray:
    """Motion per weighted change of luminance, (m, 2, 2)."""
    moves = np.einsum("mki,mkj->mij", weighted, motion, dtype=np.float64)
    # Edges along one direction only say nothing of the other: no motion there.
    least = 1e-6 * np.trace(moves, axis1=1, axis2=2) + 1e-6
    return np.asarray(np.linalg.inv(moves + least[:, None, None] * np.eye(2)))


def _gradient(level: Floats32) -> Floats32:
    """Central differences (h, w, 2) along x and y; 0 at the image's edges."""
    out = np.zeros((*level.shape, 2), dtype=np.float32)
    out[:, 1:-1, 0] = 0.5 * (level[:, 2:] - level[:, :-2])
    out[1:-1, :, 1] = 0.5 * (level[2:] - level[:-2])
    return out


def _edge_pixels(blobs: Blobs, number: int, slope: Floats32) -> tuple[IntArray, IntArray]:
    """Columns and rows of a blob's pixels, and of those around it, with the strongest gradient."""
    grow = SETTINGS.grow_px
    left, top = np.maximum(blobs.box_px[number, :2] - grow, 0)
    right, bottom = blobs.box_px[number, 2:] + grow + 1
    labels = np.asarray(blobs.labels)[top:bottom, left:right]
    own = (labels == number + 1).astype(np.uint8)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * grow + 1,) * 2)
    strength = np.sum(slope[top:bottom, left:right] ** 2, axis=2) * cv2.dilate(own, around)
    strongest = np.argsort(-strength.ravel(), kind="stable")[: SETTINGS.pixels]
    strongest = strongest[strength.ravel()[strongest] > 0.0]
    y, x = np.divmod(strongest, strength.shape[1])
    return x + left, y + top
