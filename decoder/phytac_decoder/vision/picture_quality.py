"""Focus, exposure, clipping and red light of a picture, measured at the markers."""

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

STRIP_ROWS = 3
"""Pixels across the strips in which the blur of edges is measured."""
MEAN_OF_NINE = np.tile(np.eye(3) / 9.0, (9, 1))
"""Mean of nine pixels of three channels: a product takes a tenth of the time of ``mean``."""


@dataclass(frozen=True, kw_only=True)
class PictureQuality:
    """What a picture is like at the markers.

    Attributes
    ----------
    blur_px : float
        Standard deviation of the Gaussian that blurs edges of luminance (colours of compressed
        pictures are coarser) along x or along y, whichever is larger; median of the markers; NaN if
        none shows an edge. Sharp edges give about 0.5; on discs that are smaller than their blur
        the value is too small.
    brightness : float
        Level of the brightest channel around markers, exceeded by one pixel in twenty: that of the
        wall, or of white dots.
    clipped : float
        Share of pixels around markers in which a channel is at its upper end.
    """

    blur_px: float
    brightness: float
    clipped: float


def picture_quality(image_bgr: ImageArray, place_px: FloatArray) -> PictureQuality:
    """Quality of a picture (h, w, 3) around markers at ``place_px`` (n, 2)."""
    clipped_level = 250
    crops = _crops(image_bgr, place_px)
    if not crops:
        return PictureQuality(blur_px=np.nan, brightness=np.nan, clipped=np.nan)
    blurs = np.array([_crop_blur_px(crop) for crop in crops])
    level = np.concatenate([crop.max(axis=2).ravel() for crop in crops])
    return PictureQuality(
        blur_px=_worse_median(blurs),
        brightness=float(np.percentile(level, 95.0)),
        clipped=float((level >= clipped_level).mean()),
    )


def _crops(image: ImageArray, place_px: FloatArray) -> list[ImageArray]:
    """Windows around markers, up to halfway to the nearest other one."""
    half_min, half_max = 4, 24
    place = place_px[np.isfinite(place_px).all(axis=1)]
    gap = np.linalg.norm(place[:, None] - place[None], axis=2)
    np.fill_diagonal(gap, np.inf)
    half = np.clip(0.5 * gap.min(axis=1, initial=np.inf), half_min, half_max).astype(int)
    out = []
    for (x, y), size in zip(np.rint(place).astype(int).tolist(), half.tolist(), strict=True):
        crop = image[max(y - size, 0) : y + size + 1, max(x - size, 0) : x + size + 1]
        if min(crop.shape[:2]) > half_min:
            out.append(crop)
    return out


def _crop_blur_px(crop: ImageArray) -> FloatArray:
    """Blur along x and along y in the middle of a window (h, w, 3)."""
    grey = _grey(crop)
    y, x = (size // 2 for size in grey.shape)
    half = STRIP_ROWS // 2
    strips = grey[y - half : y + half + 1], grey[:, x - half : x + half + 1].T
    return np.concatenate([_edge_blur_px(strip[None]) for strip in strips])


def _grey(pixels: ImageArray) -> ImageArray:
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_BGR2GRAY))


def _worse_median(blurs: FloatArray) -> float:
    """Medians of k blurs along x and along y (k, 2): the larger one; NaN if none is known."""
    # NaN comes last; numpy's median takes longer than all else.
    order = np.sort(blurs, axis=0)
    known = np.count_nonzero(np.isfinite(order), axis=0)
    middle = [row[count // 2] for row, count in zip(order.T, known, strict=True) if count]
    return float(max(middle, default=np.nan))


def _edge_blur_px(strips: ImageArray) -> FloatArray:
    """Blur (k,) of the edges across k strips (k, rows, length) of luminance; NaN if one shows none.

    The gradient across an edge of contrast C that is blurred by a Gaussian of standard deviation s
    is C times that Gaussian, so that C·∫g / ∫g² = 2·√π·s·C however many edges there are.
    """
    contrast_min, share_min = 20.0, 0.2
    # Of gradients below this share of the largest, which noise dominates, these are left out.
    left_out = 1.067
    # Variance of the central difference (over two pixels) and of the pixel itself.
    own_var = 1.0 / 3.0 + 1.0 / 12.0
    levels = np.sort(strips.reshape(len(strips), -1), axis=1).astype(np.float32)
    low, high = (round(part * (levels.shape[1] - 1)) for part in (0.02, 0.98))
    contrast = levels[:, high] - levels[:, low]
    grey = strips.astype(np.float32)
    slope = 0.5 * np.abs(grey[:, :, 2:] - grey[:, :, :-2]).reshape(len(strips), -1)
    slope[slope < share_min * slope.max(axis=1, keepdims=True)] = 0.0
    square = np.maximum(np.einsum("ij,ij->i", slope, slope), 1e-12)
    width = left_out * contrast * slope.sum(axis=1) / (2.0 * np.sqrt(np.pi) * square)
    blur = np.sqrt(np.maximum(width**2 - own_var, 0.0))
    return np.where(contrast < contrast_min, np.nan, blur)


@dataclass(frozen=True, kw_only=True)
class FocusCheck:
    """Markers of one camera at whose edges the focus of every frame is measured.

    Attributes
    ----------
    ids : (k,) int
        Markers of usual size, at most ``count_max``.
    half_px : int
        From a marker's centre to the end of the strip across it.
    limit_px : float
        Blur, as in :class:`PictureQuality`, above which frames are doubtful.
    """

    ids: IntArray
    half_px: int
    limit_px: float

    count_max: ClassVar[int] = 9
    sharp_px: ClassVar[float] = 0.5
    """Blur that is measured on sharp edges."""
    small_quantile: ClassVar[float] = 0.1
    blur_share: ClassVar[float] = 1.0 / 3.0
    """Blur that is added to sharp edges may be this share of the radius of a small marker (one in
    ten is smaller): its circle of confusion, four standard deviations wide, then covers two thirds
    of the marker's diameter."""
    most_px: ClassVar[float] = 2.5
    """Larger markers do not allow for more: more was not tried."""
    beyond_px: ClassVar[float] = 5.0
    """How far strips reach beyond the edges of markers."""

    @classmethod
    def at_rest(
        cls, frame: ImageArray, place_px: FloatArray, area_px: FloatArray
    ) -> "FocusCheck | None":
        """Choose markers by their places (n, 2) and areas (n,) in the rest frame, NaN if not seen.

        None if none of them shows an edge.
        """
        seen = np.flatnonzero(np.isfinite(area_px) & np.isfinite(place_px).all(axis=1))
        if not len(seen):
            return None
        radius = np.sqrt(area_px / np.pi)
        usual = float(np.median(radius[seen]))
        order = np.argsort(np.abs(radius[seen] - usual), kind="stable")
        small = float(np.quantile(radius[seen], cls.small_quantile))
        found = cls(
            ids=np.sort(seen[order[: cls.count_max]]),
            half_px=round(usual + cls.beyond_px),
            limit_px=min(float(np.hypot(cls.sharp_px, cls.blur_share * small)), cls.most_px),
        )
        return None if np.isnan(found.blur_px(frame, place_px)) else found

    def blur_px(self, frame: ImageArray, place_px: FloatArray) -> float:
        """Blur of a frame (h, w, 3) with markers at ``place_px`` (n, 2); NaN if none is seen."""
        height, width = frame.shape[:2]
        place = place_px[self.ids]
        edge = self.half_px + 1
        inside = ((place > edge) & (place < np.array([width, height]) - edge)).all(axis=1)
        if not inside.any():
            return np.nan
        corner = np.rint(place[inside]).astype(np.int64) @ [1, width]
        along = np.arange(-self.half_px, self.half_px + 1)
        across = np.arange(STRIP_ROWS)[:, None] - STRIP_ROWS // 2
        # Strips along x, then along y.
        offset = np.concatenate([across * width + along, along * width + across])
        pixels = corner[:, None] + offset.reshape(1, -1)
        # A pixel is one item, copied as a whole.
        items = frame.reshape(-1).view(np.dtype((np.void, 3)))
        grey = _grey(items[pixels].view(np.uint8).reshape(1, -1, 3))
        blurs = _edge_blur_px(grey.reshape(2 * len(corner), STRIP_ROWS, -1))
        return _worse_median(blurs.reshape(-1, 2))


@dataclass(frozen=True, kw_only=True)
class LightChange:
    """What :class:`LightCheck` finds in a frame.

    Attributes
    ----------
    red_share : float
        Share of markers that are redder than at rest, unlike the others.
    beyond_range : float
        Brightness that markers would have without clipping, over the highest level of a picture
        (median); 0 if not more than half of the markers are clipped.
    """

    red_share: float
    beyond_range: float


@dataclass(frozen=True, kw_only=True)
class LightCheck:
    """Levels of the markers of one camera at rest, by which red light and overexposure are seen.

    A change of exposure, white balance or stray light on the whole picture changes the red of all
    markers alike, by a factor and an offset. Red on some of them alone shifts their centroids.
    Channels that are dim at rest show by how much the exposure has grown when bright ones are
    clipped.

    Attributes
    ----------
    ids : (k,) int
        Markers that the rest frame shows.
    level : (k, 3) float
        Blue, green and red in the middle of each, there.
    brightest : float
        Level of the brightest channel there: median of the markers.
    """

    ids: IntArray
    level: FloatArray
    brightest: float

    markers_min: ClassVar[int] = 20
    """Of fewer, nothing is said."""
    markers_max: ClassVar[int] = 160
    """Of more, so many are chosen at even steps: the check takes 0.18 ms a frame."""
    level_share: ClassVar[float] = 0.06
    """Additional red of a marker, over the level of its brightest channel, that is a change."""
    share_max: ClassVar[float] = 0.1
    """Share of markers with more red above which frames are doubtful. In mild pictures of six
    designs it is 0.09 at most, but 0.12 with JPEG 90 on small markers; under a red glow on a fifth
    of the picture 0.107 at least."""
    usual_levels: ClassVar[float] = 5.0
    """Deviation up to which a marker counts fully for what all have in common."""
    iterations: ClassVar[int] = 6
    dim_levels: ClassVar[tuple[float, float]] = (15.0, 115.0)
    """Channels between these levels at rest show the exposure: twice as bright, they are neither
    lost in noise nor clipped."""
    clipped_level: ClassVar[int] = 254
    beyond_range_max: ClassVar[float] = 1.3
    """Frames are doubtful if markers would be brighter than the picture can show by this factor. On
    four designs it is 1.0 to 1.1 at 1.4 times the exposure, and 1.4 to 1.6 at twice."""

    @classmethod
    def at_rest(cls, frame: ImageArray, place_px: FloatArray) -> "LightCheck | None":
        """Measure markers at ``place_px`` (n, 2), NaN if not seen; None if they are too few."""
        seen, level, brightest = _middle_levels(frame, place_px)
        if len(level) < cls.markers_min:
            return None
        count = min(len(level), cls.markers_max)
        chosen = np.linspace(0, len(level) - 1, count).round().astype(np.int64)
        return cls(
            ids=np.flatnonzero(seen)[chosen],
            level=level[chosen],
            brightest=float(np.median(brightest[chosen])),
        )

    def change(
        self, frame: ImageArray, place_px: FloatArray, left_out: BoolArray
    ) -> LightChange | None:
        """Compare markers at ``place_px`` (n, 2) with those at rest; None if too few are seen.

        Markers that are left out (n,), because their tips are red, do not count.
        """
        place_px = np.where(left_out[self.ids, None], np.nan, place_px[self.ids])
        seen, level, brightest = _middle_levels(frame, place_px)
        if len(level) < self.markers_min:
            return None
        before = self.level[seen]
        return LightChange(
            red_share=self._red_share(before[:, 2], level[:, 2], brightest),
            beyond_range=self._beyond_range(before, level, brightest),
        )

    def _red_share(self, before: FloatArray, now: FloatArray, brightest: FloatArray) -> float:
        """Share of markers whose red (k,) is above the line, fitted robustly, of all of them."""
        weight, off = np.ones(len(now)), now
        for _ in range(self.iterations):
            total = weight.sum()
            mean, mean_now = weight @ before / total, weight @ now / total
            aside = before - mean
            slope = weight @ (aside * now) / max(float(weight @ aside**2), 1e-9)
            off = now - mean_now - slope * aside
            weight = 1.0 / (1.0 + (off / self.usual_levels) ** 2)
        changed = off > self.level_share * brightest
        return float(np.count_nonzero(changed) / len(changed))

    def _beyond_range(self, before: FloatArray, now: FloatArray, brightest: FloatArray) -> float:
        """See :class:`LightChange`, by levels (k, 3) at rest and in a frame."""
        if np.count_nonzero(brightest >= self.clipped_level) <= len(brightest) // 2:
            return 0.0
        dim = (before >= self.dim_levels[0]) & (before <= self.dim_levels[1])
        if not dim.any():
            return 0.0
        return float(np.median(now[dim] / before[dim])) * self.brightest / 255.0


def _middle_levels(
    image: ImageArray, place_px: FloatArray
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which of markers at places (n, 2) are seen (n,), and levels in the middle of these k.

    The levels are the mean blue, green and red (k, 3) of three by three pixels, and the brightest
    channel (k,) of the middle one.
    """
    height, width = image.shape[:2]
    # NaN is not inside.
    within = (place_px >= 1.0) & (place_px <= np.array([width, height]) - 2.0)
    inside = np.asarray(within.all(axis=1))
    middle = np.rint(place_px[inside]).astype(np.int64) @ [1, width]
    # Rows of three pixels, of three channels each.
    around = (3 * width * np.arange(-1, 2)[:, None] + np.arange(-3, 6)).reshape(-1)
    channels = image.reshape(-1)[3 * middle[:, None] + around]
    brightest = np.asarray(image.reshape(-1, 3)[middle].max(axis=1), dtype=np.float64)
    return inside, channels @ MEAN_OF_NINE, brightest
