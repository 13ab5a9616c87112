"""Dots of one colour, separated from the wall by brightness, and irregular layouts of them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision.matching import match_markers
from phytac_decoder.vision.segmentation import ColourModel, segment
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from tests.decoder.toy_sensor import toy_bundle

WIDTH, HEIGHT, SCALE = 160, 120, 8


def irregular(seed: int) -> tuple[FloatArray, IntArray]:
    """Thirty places (n, 2) px on a grid that is jittered by up to a third of its pitch.

    With the nearest other in each of eight sectors around (n, 8), -1 where there is none: rows and
    columns play no part.
    """
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(18.0 + 24.0 * np.arange(6), 14.0 + 22.0 * np.arange(5))
    place = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-7.0, 7.0, (30, 2))
    arm = place[None] - place[:, None]
    gap = np.hypot(arm[:, :, 0], arm[:, :, 1])
    sector = ((np.arctan2(arm[:, :, 1], arm[:, :, 0]) + np.pi) / (np.pi / 4.0)).astype(int) % 8
    near = np.full((30, 8), -1)
    for k in range(8):
        away = np.where((sector == k) & (gap > 0.0), gap, np.inf)
        near[:, k] = np.where(np.isfinite(away.min(axis=1)), away.argmin(axis=1), -1)
    return place, near


def drawn(place: FloatArray, dot: int, wall: int, radius: float = 4.0) -> ImageArray:
    """Grey dots on a wall that is a fifth darker on its left, with noise of two grey levels."""
    fine = np.full((HEIGHT * SCALE, WIDTH * SCALE), float(wall), dtype=np.float32)
    for x, y in np.round((place + 0.5) * SCALE - 0.5).astype(int).tolist():
        cv2.circle(fine, (x, y), round(radius * SCALE), float(dot), -1)
    image = cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    image *= np.linspace(0.8, 1.0, WIDTH)
    image += np.random.default_rng(1).normal(0.0, 2.0, image.shape)
    return np.repeat(np.clip(image, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


KINDS = pytest.mark.parametrize(("paint", "dot", "wall"), [("white", 220, 40), ("black", 30, 180)])


def model_of(paint: str) -> ColourModel:
    grey, wall = {"white": (220, 40), "black": (30, 180)}[paint]
    paints = {paint: (grey, grey, grey), "red": (214, 30, 34)}
    return ColourModel.from_rgb(paints, wall=(wall, wall, wall))


@KINDS
def test_dots_are_found_where_they_are_drawn(paint: str, dot: int, wall: int) -> None:
    place, near = irregular(0)
    model = model_of(paint)
    blobs = segment(model.prepared(drawn(place, dot, wall)), model)
    assert len(blobs.colour) == 30
    colour = np.zeros(30, dtype=np.int64)
    found = match_markers(blobs, rest_px=place, colour=colour, neighbours=near)
    assert found.found.all()
    assert np.abs(found.position_px - place).max() < 0.25


def test_frames_of_colours_are_left_as_they_are() -> None:
    model = ColourModel.from_rgb({"blue": (28, 72, 214), "red": (214, 30, 34)})
    frame = drawn(irregular(0)[0], 220, 40)
    assert model.prepared(frame) is frame
    # What is no 8-bit colour image is refused later, with its reason.
    grey = frame[:, :, 0]
    assert model_of("white").prepared(grey) is grey


@KINDS
@pytest.mark.parametrize("seed", range(4))
def test_irregular_dots_keep_their_identity_under_a_press(
    paint: str, dot: int, wall: int, seed: int
) -> None:
    """The whole frame is searched, and followed; neither needs rows, columns or a second colour.

    A press moves each dot by up to a third of the mean pitch, smoothly over its neighbours.
    """
    place, near = irregular(seed)
    base = toy_bundle()
    tips = TipModel(
        on_px=np.full((30, 2), np.nan), red_rest_px=np.zeros(30), red_on_px=np.zeros(30)
    )
    bundle = replace(
        base,
        colours=model_of(paint),
        colour=np.zeros(30, dtype=np.int64),
        rest_px=place,
        tips=tips,
        model=replace(base.model, neighbours=near),
    )
    shown = place + np.array([0.8, -0.6])
    rest = drawn(shown, dot, wall)
    lit = calibrate_rest(bundle, rest)
    np.testing.assert_allclose(lit.rest_px, shown, atol=0.25)
    middle = place[12]
    near_press = np.exp(-(np.linalg.norm(place - middle, axis=1) ** 2) / (2.0 * 30.0**2))
    push = near_press[:, None] * [5.0, 4.0]
    rest_px = rest_positions(lit, rest)
    pressed = measure_frame(lit, drawn(shown + push, dot, wall), rest_px=rest_px)
    assert pressed.found.all()
    assert not len(pressed.koi)
    np.testing.assert_allclose(pressed.shift_px, push, atol=0.35)
    follower = Follower(lit, rest)
    for share in np.linspace(0.1, 1.0, 10):
        followed = follower.follow(drawn(shown + share * push, dot, wall))
    assert followed.found.all()
    np.testing.assert_allclose(followed.shift_px, push, atol=0.35)


@KINDS
def test_brightness_of_the_light_moves_no_dot(paint: str, dot: int, wall: int) -> None:
    place, _ = irregular(2)
    model = model_of(paint)

    def found(gain: float) -> FloatArray:
        frame = drawn(place, int(gain * dot), int(gain * wall))
        seen = segment(model.prepared(frame), model).centroid_px
        return seen[np.linalg.norm(place[:, None] - seen, axis=2).argmin(axis=1)]

    np.testing.assert_allclose(found(0.8), found(1.0), atol=0.15)
