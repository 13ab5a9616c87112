"""Frames of a pressed sensor, damaged by dirt, broken switches, light and cables."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.vision.matching import nearest_same_colour_px
from phytac_design.optics.paint import PAINTS, RESIN
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray

SHADE = 0.75
"""Brightness of paint that is drawn, over the full."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A pressed frame and what is known of it; arrays run over n markers.

    Attributes
    ----------
    bundle : Bundle
        The sensor's decoder, calibrated by a rest frame.
    frame : (h, w, 3) uint8
        Of one camera.
    other : (h, w, 3) uint8
        Of another press.
    shoot : callable
        The frame with another draw of the noise; ``stops=`` of another exposure.
    place_px : (n, 2) float
        Where the markers are.
    bits : (n,) bool
        Switches that are on.
    rng : Generator
        Draws what is damaged.
    """

    bundle: Bundle
    frame: ImageArray
    other: ImageArray
    shoot: Callable[..., ImageArray]
    place_px: FloatArray
    bits: BoolArray
    rng: np.random.Generator

    @property
    def tip_px(self) -> FloatArray:
        """Where the tips are, (n, 2)."""
        bundle = self.bundle
        return np.asarray(bundle.tips.on_px + self.place_px - bundle.rest_px)

    def apart_px(self) -> FloatArray:
        """Distance of each marker to the next of its colour, (n,)."""
        return nearest_same_colour_px(self.bundle.rest_px, self.bundle.colour)

    def pressed(self) -> int:
        """One of the switches that are on."""
        return int(self.rng.choice(np.flatnonzero(self.bits)))

    def erased(self, markers: list[int], paint: str | None) -> ImageArray:
        """Frame with the paint of ``markers`` in the wall's colour; None: each one's own paint."""
        frame, bundle = self.frame.copy(), self.bundle
        height, width = frame.shape[:2]
        colours, apart = bundle.colours, self.apart_px()
        for marker in markers:
            half = int(0.5 * apart[marker]) + 2
            place = self.tip_px[marker] if paint else self.place_px[marker]
            if not np.isfinite(place).all():
                continue
            x, y = np.rint(place).astype(int)
            rows = slice(max(y - half, 0), min(y + half + 1, height))
            columns = slice(max(x - half, 0), min(x + half + 1, width))
            part = frame[rows, columns]
            classes, _ = colours.classify(np.ascontiguousarray(part))
            own = colours.names.index(paint) if paint else int(bundle.colour[marker])
            gone = cv2.dilate((classes == own + 1).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
            plain = part[(classes == 0) & ~gone]
            wall = np.median(plain, axis=0) if len(plain) else np.array(RESIN[::-1])
            part[gone] = wall.astype(np.uint8)
        return frame


def hidden(sample: Sample) -> ImageArray:
    """A fifth of the markers painted over."""
    count = len(sample.bits)
    chosen = sample.rng.choice(count, int(0.2 * count), replace=False)
    return sample.erased(chosen.tolist(), None)


def fused(sample: Sample) -> ImageArray:
    """A bridge of paint from a pressed marker to the next of its colour."""
    bundle, marker = sample.bundle, sample.pressed()
    gap = np.linalg.norm(bundle.rest_px - bundle.rest_px[marker], axis=1)
    gap[(bundle.colour != bundle.colour[marker]) | (gap == 0.0)] = np.inf
    other = int(np.argmin(gap))
    ends = np.rint(sample.place_px[[marker, other]]).astype(int)
    paint = SHADE * np.array(PAINTS[bundle.colours.names[bundle.colour[marker]]][::-1])
    thick = max(int(0.15 * gap[other]), 2)
    frame = sample.frame.copy()
    cv2.line(frame, ends[0].tolist(), ends[1].tolist(), paint.tolist(), thick, cv2.LINE_AA)
    return frame


def dead(sample: Sample) -> ImageArray:
    """The red of a switch that is on is gone."""
    return sample.erased([sample.pressed()], "red")


def stuck(sample: Sample) -> ImageArray:
    """Red where a switch is off."""
    off = np.flatnonzero(~sample.bits & sample.bundle.tips.readable)
    marker = int(sample.rng.choice(off))
    radius = float(np.sqrt(sample.bundle.tips.red_on_px[marker] / np.pi)) / np.sqrt(SHADE)
    centre = np.rint(sample.tip_px[marker]).astype(int).tolist()
    paint = SHADE * np.array(PAINTS["red"][::-1])
    frame = sample.frame.copy()
    cv2.circle(frame, centre, max(int(np.ceil(radius)), 1), paint.tolist(), -1, cv2.LINE_AA)
    return frame


def dark(sample: Sample) -> ImageArray:
    """Two stops less light than the rest frame had."""
    return sample.shoot(stops=-2.0)


def glare(sample: Sample) -> ImageArray:
    """A bright blob over pressed markers."""
    height, width = sample.frame.shape[:2]
    x, y = sample.place_px[sample.pressed()]
    size = 0.06 * width
    across = np.exp(-0.5 * ((np.arange(width) - x) / size) ** 2)
    down = np.exp(-0.5 * ((np.arange(height) - y) / size) ** 2)
    # Grey levels in the middle of the glare.
    light = (400.0 * down[:, None] * across).astype(np.float32)
    lit = np.clip(sample.frame + light[:, :, None], 0, 255)
    return np.asarray(lit, dtype=np.uint8)


def torn(sample: Sample) -> ImageArray:
    """The lower half is of another press."""
    frame = sample.frame.copy()
    frame[len(frame) // 2 :] = sample.other[len(frame) // 2 :]
    return frame


def black(sample: Sample) -> ImageArray:
    """Nothing."""
    return np.zeros_like(sample.frame)


def bumped(sample: Sample) -> ImageArray:
    """The camera has moved."""
    height, width = sample.frame.shape[:2]
    move = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 0.0]])
    return np.asarray(cv2.warpAffine(sample.frame, move, (width, height)), dtype=np.uint8)


FAULTS: dict[str, Callable[[Sample], ImageArray]] = {
    "20 % of the markers hidden": hidden,
    "two markers fused": fused,
    "a dead switch": dead,
    "a stuck switch": stuck,
    "exposure -2 stops": dark,
    "a finger's glare": glare,
    "a frame torn": torn,
    "a black frame": black,
    "camera bumped by 3 px": bumped,
}
