"""Focus, exposure and clipping of a picture, measured at the markers."""

from dataclasses import dataclass

import cv2
import numpy as np

from phytac_shapes.arrays import FloatArray, ImageArray


@dataclass(frozen=True, kw_only=True)
class PictureQuality:
    """What a picture is like at the markers.

    Attributes
    ----------
    blur_px : float
        Standard deviation of the Gaussian that blurs edges of luminance (colours of compressed
        pictures are coarser), median of the markers; NaN if none shows an edge. Sharp edges give
        about 0.5; on discs that are smaller than their blur the value is too small.
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
    blurs = np.array([_blur_px(crop) for crop in crops])
    level = np.concatenate([crop.max(axis=2).ravel() for crop in crops])
    known = blurs[np.isfinite(blurs)]
    return PictureQuality(
        blur_px=float(np.median(known)) if len(known) else np.nan,
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


def _blur_px(crop: ImageArray) -> float:
    """Blur of the edges in a window (h, w, 3); NaN if it shows none.

    The gradient across an edge of contrast C that is blurred by a Gaussian of standard deviation s
    is C times that Gaussian, so that C·∫g / ∫g² = 2·√π·s·C whatever the edge's length is.
    """
    contrast_min, share_min = 20.0, 0.2
    # Of gradients below this share of the largest, which noise dominates, these are left out.
    left_out = 1.067
    # Variance of the central difference (over two pixels) and of the pixel itself.
    own_var = 1.0 / 3.0 + 1.0 / 12.0
    grey = cv2.cvtColor(np.ascontiguousarray(crop), cv2.COLOR_BGR2GRAY).astype(np.float64)
    low, high = np.percentile(grey, (2.0, 98.0))
    contrast = float(high - low)
    if contrast < contrast_min:
        return np.nan
    down, across = np.gradient(grey)
    slope = np.hypot(down, across)[1:-1, 1:-1]
    slope = slope[slope >= share_min * slope.max()]
    width = left_out * contrast * slope.sum() / (2.0 * np.sqrt(np.pi) * (slope**2).sum())
    return float(np.sqrt(max(width**2 - own_var, 0.0)))
