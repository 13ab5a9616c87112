"""The table ``[paints]`` of a design from a photograph of its markers."""

from itertools import combinations

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from phytac_decoder.pipeline.colour_calibration import SETTINGS as CALIBRATION
from phytac_decoder.vision.brightness import dots_as_paint
from phytac_design.design.paints_table import PaintsSection, Rgb
from phytac_design.design.spec import Design
from phytac_design.optics.paint import PAINTS
from phytac_design.optics.separability import Separability, check_paints
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

PIXELS_MIN = 50
"""A paint must show in at least so many pixels of the photo."""


def measure_paints(
    photo_bgr: ImageArray, design: Design, names: tuple[str, ...]
) -> tuple[PaintsSection, Separability]:
    """Paints and resin as a photo shows them, and how well the decoder can separate them.

    Pixels stand out from the most frequent chroma, the wall's, by the triangle threshold (Zack
    1977). Those that are not clipped are divided by hue with k-means, one cluster a paint; each
    cluster has the name that is nearest in hue, all in all. Its colour is the median of the pixels
    with much of its chroma: full light, without edges and shade.

    Parameters
    ----------
    photo_bgr : (h, w, 3) uint8
        Any photo that the sensor's camera took of the paints, in the sensor's light.
    design : Design
        For the nominal paints and the camera's noise.
    names : tuple of str
        Paints that the photo shows; ``red`` for tips that are out.

    Raises
    ------
    InputError
        If a name is unknown, the photo shows too little of a paint or other colours as well, hues
        are too near to each other, or a hue is far from all names.
    DesignError
        If the decoder could not separate them in the noise of the design's camera.
    """
    pixels = photo_bgr.reshape(-1, 3)
    unknown = sorted(set(names) - set(PAINTS))
    if unknown:
        raise InputError(
            "paint-unknown",
            f"there is no paint {', '.join(unknown)}; known: {', '.join(PAINTS)}",
        )
    if design.dots and names != tuple(dict.fromkeys(design.layout.colours)):
        raise InputError(
            "paint-not-of-design",
            f"the markers of {design.name} are {design.dots} dots of one colour; leave --colours "
            "out",
        )
    if design.dots:
        found, painted = _dots(photo_bgr, design.dots)
        wall_name = "resin_dark" if design.dots == "white" else "resin"
    else:
        found, painted = _hues(photo_bgr, design, names)
        wall_name = "resin"
    wall = pixels[~painted]
    found[wall_name] = _median_rgb(wall if wall_name == "resin_dark" else _lit(wall))
    paints = design.paints.model_copy(update=found)
    return paints, check_paints(design.model_copy(update={"paints": paints}))


def _lit(wall: ImageArray) -> ImageArray:
    """Brighter half of pixels (n, 3) that are neither black nor clipped; all if none is."""
    luma = wall.mean(axis=1)
    shown = (luma > 16.0) & (luma < 250.0)
    return wall[shown & (luma >= np.median(luma[shown]))] if shown.any() else wall


def _median_rgb(pixels_bgr: ImageArray | FloatArray) -> Rgb:
    blue, green, red = np.rint(np.median(pixels_bgr, axis=0)).astype(int).tolist()
    return red, green, blue


def _dots(photo: ImageArray, paint: str) -> tuple[dict[str, Rgb], BoolArray]:
    """Colour of dots that stand out by brightness, and which pixels they cover, with edges.

    Each spot counts once, so that a large bright or dark place is one of many.
    """
    contrast = dots_as_paint(photo, paint)[:, :, 0]
    level, _ = cv2.threshold(contrast, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    strong = contrast > max(level, CALIBRATION.chroma_min)
    _check_pixels(paint, strong)
    count, label = cv2.connectedComponents(cv2.erode(strong.astype(np.uint8), np.ones((3, 3))))
    spots = [np.median(photo[label == k], axis=0) for k in range(1, count)]
    dots = np.array(spots) if spots else photo[strong]
    return {paint: _median_rgb(dots)}, (contrast > level / 2.0).ravel()


def _check_pixels(paint: str, shown: BoolArray) -> None:
    if shown.sum() < PIXELS_MIN:
        raise InputError(
            "photo-without-paint",
            f"the photo shows {paint} in {int(shown.sum())} pixels (needed: {PIXELS_MIN}); is it "
            "lit, in focus and in colour? come nearer, or leave the paint out (--colours)",
        )


def _hues(
    photo: ImageArray, design: Design, names: tuple[str, ...]
) -> tuple[dict[str, Rgb], BoolArray]:
    """Colour of each named paint, and which pixels show some paint, (h w,)."""
    pixels = photo.reshape(-1, 3)
    chroma = _chroma(pixels)
    middle = np.median(chroma, axis=0)
    # Beside the wall there may be black, which is grey whatever the wall's tint.
    distance = np.minimum(*(np.linalg.norm(chroma - grey, axis=1) for grey in (middle, 0.0)))
    away = np.clip(distance, 0.0, 255.0).astype(np.uint8)
    level, _ = cv2.threshold(away, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_TRIANGLE)
    painted = away > max(level, CALIBRATION.chroma_min)
    usable = np.flatnonzero(painted & (pixels.max(axis=1) < 250))
    _check_pixels(" or ".join(names), np.isin(np.arange(len(pixels)), usable))
    own = chroma[usable]
    size = np.linalg.norm(own, axis=1)
    label, hue_rad = _clusters(own / np.maximum(size, 1e-9)[:, None], len(names))
    for first, second in combinations(range(len(names)), 2):
        apart = np.degrees(abs(_turned(hue_rad[first] - hue_rad[second])))
        if apart < CALIBRATION.separation_min_deg:
            raise InputError(
                "colours-not-separable",
                f"{len(names)} paints cannot be distinguished in the photo: two hues are "
                f"{apart:.0f} degrees apart (needed: {CALIBRATION.separation_min_deg:g}); set the "
                "camera's white balance, use other paints, or name those that the photo shows "
                "(--colours)",
            )
    nominal = _chroma(np.array([getattr(design.paints, k)[::-1] for k in names], dtype=np.uint8))
    expected = np.arctan2(nominal[:, 1], nominal[:, 0])
    off = np.abs(_turned(expected[:, None] - hue_rad[None]))
    _, cluster = linear_sum_assignment(off)
    found = {}
    for k, name in enumerate(names):
        if off[k, cluster[k]] > np.arccos(CALIBRATION.hue_cosine_min):
            raise InputError(
                "paint-not-recognised",
                f"no paint of the photo is {name}: the nearest hue is "
                f"{np.degrees(off[k, cluster[k]]):.0f} degrees from it; set the camera's white "
                "balance, or name the paints that the photo shows (--colours)",
            )
        mine = label == cluster[k]
        _check_pixels(name, mine)
        # On edges, and where a camera records colour coarsely, paint is mixed with the wall.
        pure = mine & (size >= np.median(size[mine]))
        turned = np.abs(_turned(np.arctan2(own[pure, 1], own[pure, 0]) - hue_rad[cluster[k]]))
        spread = float(np.degrees(np.percentile(turned, 90.0)))
        if spread > CALIBRATION.separation_min_deg / 2.0:
            raise InputError(
                "photo-with-other-colours",
                f"pixels taken for {name} differ by up to {spread:.0f} degrees of hue (at most "
                f"{CALIBRATION.separation_min_deg / 2.0:g}): the photo shows other colours as "
                "well; name all paints in it (--colours, red for tips), or cut the photo to them",
            )
        full = size >= np.percentile(size[mine], 70.0)
        found[name] = _median_rgb(pixels[usable[mine & full]])
    return found, painted


def _chroma(pixels_bgr: ImageArray) -> FloatArray:
    """(Cr, Cb) - 128 of pixels (n, 3)."""
    ycc = cv2.cvtColor(np.ascontiguousarray(pixels_bgr)[None], cv2.COLOR_BGR2YCrCb)[0]
    return np.asarray(ycc[:, 1:].astype(np.float64) - 128.0)


def _clusters(unit: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
    """Cluster (n,) of unit vectors (n, 2), and the direction of each cluster (k,), rad."""
    cv2.setRNGSeed(0)  # the same photo gives the same clusters
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    some = unit.astype(np.float32)
    best: IntArray = np.zeros((len(unit), 1), dtype=np.int32)
    _, label, centre = cv2.kmeans(some, count, best, until, 10, cv2.KMEANS_PP_CENTERS)
    return np.asarray(label[:, 0]), np.arctan2(centre[:, 1], centre[:, 0]).astype(np.float64)


def _turned(angle_rad: FloatArray) -> FloatArray:
    """Angles between -π and π."""
    return np.asarray((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)
