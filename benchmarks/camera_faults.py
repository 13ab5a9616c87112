"""Disturbances of a camera's picture, for :mod:`benchmarks.camera`.

Noise is EMVA 1288's (shot noise by the gain of electrons per grey level, and a dark part); JPEG,
Bayer mosaics, chroma subsampling, blur and warps are OpenCV's.
"""
# All disturbances have one signature.
# ruff: noqa: ARG001, ARG005

from collections.abc import Callable

import cv2
import numpy as np

from phytac_shapes.arrays import FloatArray, ImageArray

LEVELS: FloatArray = np.arange(256.0)
Picture = Callable[[ImageArray, np.random.Generator], ImageArray]


def clipped(image: FloatArray) -> ImageArray:
    """Values as a camera delivers them."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def gain(blue: float, green: float, red: float) -> Picture:
    """Exposure or white balance."""
    return lambda image, rng: clipped(image * np.array([blue, green, red]))


def levels(curve: FloatArray) -> Picture:
    """A tone curve (256,) of all channels."""
    return lambda image, rng: np.asarray(cv2.LUT(image, clipped(curve)))


def gamma(exponent: float) -> Picture:
    """A gamma curve."""
    return levels(255.0 * (LEVELS / 255.0) ** exponent)


def jpeg(quality: int) -> Picture:
    """JPEG and back, with 4:2:0 as OpenCV writes it."""
    words = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return lambda image, rng: np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, words)[1], 1))


def kernel(weights: FloatArray) -> Picture:
    """A convolution with weights that are scaled to a sum of 1."""
    unit = weights / weights.sum()
    return lambda image, rng: np.asarray(cv2.filter2D(image, -1, unit))


def defocus(diameter_px: float) -> Picture:
    """A disc of confusion."""
    half = int(np.ceil(diameter_px / 2.0))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    return kernel(np.clip(diameter_px / 2.0 + 0.5 - np.hypot(x, y), 0.0, 1.0))


def noise(sd: float) -> Picture:
    """Noise of the same size everywhere."""
    return lambda image, rng: clipped(image + rng.normal(0.0, sd, image.shape))


def emva(electrons: float, dark_sd: float) -> Picture:
    """EMVA 1288: variance dark² + level / (electrons per grey level), grey levels."""

    def apply(image: ImageArray, rng: np.random.Generator) -> ImageArray:
        sd = np.sqrt(dark_sd**2 + image / electrons)
        return clipped(image + sd * rng.normal(size=image.shape))

    return apply


def bayer(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """A Bayer mosaic, interpolated bilinearly."""
    mosaic = image[:, :, 1].copy()
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = image[0::2, 0::2, 2], image[1::2, 1::2, 0]
    return np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2BGR))


def chroma(width: int, height: int) -> Picture:
    """Chroma that is shared by cells of so many pixels: (2, 2) is 4:2:0, (2, 1) is 4:2:2."""

    def apply(image: ImageArray, rng: np.random.Generator) -> ImageArray:
        ycc = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
        size = (image.shape[1], image.shape[0])
        small = cv2.resize(ycc, (size[0] // width, size[1] // height), interpolation=cv2.INTER_AREA)
        ycc[:, :, 1:] = cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)[:, :, 1:]
        return np.asarray(cv2.cvtColor(ycc, cv2.COLOR_YCrCb2BGR))

    return apply


def field(light: Callable[[FloatArray, FloatArray], FloatArray]) -> Picture:
    """Light that depends on the place: x and y from -1 to 1, a factor or (…, 3) factors."""

    def apply(image: ImageArray, rng: np.random.Generator) -> ImageArray:
        height, width = image.shape[:2]
        y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
        factor = light(x, y)
        return clipped(image * (factor if factor.ndim == 3 else factor[:, :, None]))

    return apply


def red_glow(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Red light through the wall at one side."""
    height, width = image.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    glow = 40.0 * np.exp(-((x - 0.4) ** 2 + (y - 0.2) ** 2) / 0.1)
    return clipped(image + glow[:, :, None] * np.array([0.1, 0.1, 1.0]))


def dust(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Twelve dark specks that stay where they are."""
    out, places = image.copy(), np.random.default_rng(3)
    height, width = image.shape[:2]
    for _ in range(12):
        at = (int(places.uniform(0, width)), int(places.uniform(0, height)))
        cv2.circle(out, at, max(width // 320, 1), (40, 40, 40), -1, cv2.LINE_AA)
    return out


def sharpened(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """The edge enhancement of a cheap camera."""
    soft = cv2.GaussianBlur(image, (0, 0), 1.5)
    return np.asarray(cv2.addWeighted(image, 2.0, soft, -1.0, 0.0))


def binned(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Pixels in cells of two by two, scaled back."""
    height, width = image.shape[:2]
    small = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR))


def rows_moved(shift: Callable[[FloatArray], FloatArray]) -> Picture:
    """A rolling shutter: rows at y from 0 to 1 moved sideways, px.

    By Lanczos' filter: a cubic blurs rows that move by half a pixel, and a shutter does not.
    """

    def apply(image: ImageArray, rng: np.random.Generator) -> ImageArray:
        height, width = image.shape[:2]
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        x += shift(np.linspace(0.0, 1.0, height))[:, None].astype(np.float32)
        return np.asarray(
            cv2.remap(image, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
        )

    return apply


def drawn(change: Callable[[ImageArray], ImageArray]) -> Picture:
    """A change of the picture's layout."""
    return lambda image, rng: np.ascontiguousarray(change(image))


def together(*parts: Picture) -> Picture:
    """One disturbance after the other."""

    def apply(image: ImageArray, rng: np.random.Generator) -> ImageArray:
        for part in parts:
            image = part(image, rng)
        return image

    return apply


def finger(x: FloatArray, y: FloatArray) -> FloatArray:
    """Shade of a hand over one side."""
    return np.asarray(1.0 - 0.4 / (1.0 + np.exp(-8.0 * (x + 0.5 * y))))


def half(strength: float) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Paint that has faded by this share on one side."""
    return lambda x, y: np.where(x > 0.0, 1.0 - strength, 1.0)


MILD: dict[str, Picture] = {
    "none": lambda image, rng: image,
    "exposure x0.7": gain(0.7, 0.7, 0.7),
    "exposure x0.85": gain(0.85, 0.85, 0.85),
    "exposure x1.15": gain(1.15, 1.15, 1.15),
    "exposure x1.4": gain(1.4, 1.4, 1.4),
    "red +10 %": gain(1.0, 1.0, 1.1),
    "red -10 %": gain(1.0, 1.0, 0.9),
    "blue +10 %": gain(1.1, 1.0, 1.0),
    "blue -10 %": gain(0.9, 1.0, 1.0),
    "JPEG 90": jpeg(90),
    "defocus 1 px": defocus(1.0),
    "defocus 2 px": defocus(2.0),
    "noise 2": noise(2.0),
    "noise 4": noise(4.0),
}
"""Conditions that the issue calls mild: at most a tenth of them may be refused or warned of."""
HARD: dict[str, Picture] = {
    "exposure x0.25": gain(0.25, 0.25, 0.25),
    "exposure x0.5": gain(0.5, 0.5, 0.5),
    "exposure x2": gain(2.0, 2.0, 2.0),
    "gamma 0.7": gamma(0.7),
    "gamma 0.85": gamma(0.85),
    "gamma 1.2": gamma(1.2),
    "gamma 1.4": gamma(1.4),
    "red and blue +15 %, -15 %": gain(0.85, 1.0, 1.15),
    "red and blue -15 %, +15 %": gain(1.15, 1.0, 0.85),
    "tungsten": gain(0.6, 0.9, 1.25),
    "daylight": gain(1.25, 1.0, 0.8),
    "JPEG 60": jpeg(60),
    "JPEG 30": jpeg(30),
    "JPEG 15": jpeg(15),
    "motion blur 5 px": kernel(np.ones((1, 5))),
    "motion blur 9 px": kernel(np.ones((1, 9))),
    "defocus 3 px": defocus(3.0),
    "defocus 4 px": defocus(4.0),
    "defocus 6 px": defocus(6.0),
    "noise 8": noise(8.0),
    "EMVA 1288, bright": emva(40.0, 1.0),
    "EMVA 1288, dark": emva(4.0, 3.0),
    "Bayer": bayer,
    "4:2:0": chroma(2, 2),
    "4:2:2": chroma(2, 1),
    "limited range read as full": levels(16.0 + LEVELS * 219.0 / 255.0),
    "full range read as limited": levels((LEVELS - 16.0) * 255.0 / 219.0),
    "vignetting": field(lambda x, y: 1.0 / (1.0 + 0.35 * (x**2 + y**2)) ** 2),
    "veil": levels(30.0 + LEVELS * 0.88),
    "finger shade": field(finger),
    "shade gradient": field(lambda x, y: 1.0 + 0.2 * x),
    "red glow": red_glow,
    "dust": dust,
    "paint faded on one side": field(half(0.2)),
    "sharpened": sharpened,
    "mains banding": field(lambda x, y: 1.0 + 0.06 * np.sin(20.0 * y)),
    "binned": binned,
    "rolling shutter, skew 2 px": rows_moved(lambda y: 2.0 * (y - 0.5)),
    "rolling shutter, wobble 0.5 px": rows_moved(lambda y: 0.5 * np.sin(12.0 * y)),
    "moved by 1 px": rows_moved(np.ones_like),
    "red and blue exchanged": drawn(lambda image: image[:, :, ::-1]),
    "grey": drawn(lambda image: np.repeat(image.mean(axis=2, keepdims=True), 3, 2).astype("u1")),
    "mirrored": drawn(lambda image: image[:, ::-1]),
    "black": gain(0.0, 0.0, 0.0),
    "webcam": together(kernel(np.ones((2, 2))), gain(0.9, 1.0, 1.1), noise(6.0), jpeg(60)),
    "dim and noisy": together(gain(0.6, 0.6, 0.6), emva(8.0, 2.0), jpeg(75)),
    "cheap lens": together(
        field(lambda x, y: 1.0 / (1.0 + 0.2 * (x**2 + y**2)) ** 2), defocus(3.0), sharpened
    ),
    "bright day": together(gain(1.4, 1.3, 1.2), levels(15.0 + LEVELS * 0.94)),
    "YUV webcam": together(chroma(2, 2), noise(3.0), jpeg(80)),
    "hand and mains": together(field(finger), field(lambda x, y: 1.0 + 0.04 * np.sin(20.0 * y))),
}
"""All others; shells that sit turned are in :mod:`benchmarks.reference_marks`."""
