"""Paints read off a rest frame: white balance, exposure, aged paint, and frames that show none."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.pipeline.colour_calibration import (
    calibrate_rest,
    calibrated_colours,
    fit_colours,
)
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision.segmentation import ColourModel
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder.test_follow import BGR, COLOUR, COUNT, MODEL, REST, TIP_OFF, dent, draw
from tests.decoder.test_follow import make_bundle as drawn_bundle
from tests.refusals import refused

BITS = np.isin(np.arange(COUNT), (45, 58, 70))
PLACE = dent(np.array([140.0, 110.0]), np.array([5.0, 4.0]))
SAME_px = 0.15
"""How far shifts may be from those in the design's light: noise of two frames, 2 levels each."""
LIGHTS = {
    "warm": (0.8, 1.0, 1.2),
    "cold": (1.2, 1.0, 0.8),
    "green": (0.85, 1.0, 0.85),
    "magenta": (1.15, 1.0, 1.15),
    "a stop up": (1.37, 1.37, 1.37),
    "a stop down": (0.73, 0.73, 0.73),
    "two stops down": (0.53, 0.53, 0.53),
    "a stop down and warm": (0.6, 0.73, 0.85),
}
"""Gains of blue, green and red, on encoded light."""


def lit(frame: ImageArray, gains: tuple[float, float, float]) -> ImageArray:
    return np.clip(np.rint(frame * np.array(gains)), 0, 255).astype(np.uint8)


def plain_bundle() -> Bundle:
    return replace(drawn_bundle(), tip_bias_px=np.zeros((COUNT, 2)))


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


@pytest.mark.parametrize("light", LIGHTS)
def test_markers_bits_and_shifts_survive_the_light(light: str) -> None:
    gains = LIGHTS[light]
    usual = measure_frame(plain_bundle(), draw(PLACE, BITS, seed=1), rest_px=REST)
    bundle = calibrate_rest(plain_bundle(), lit(draw(REST), gains))
    seen = measure_frame(bundle, lit(draw(PLACE, BITS, seed=2), gains))
    assert seen.found.all()
    assert seen.koi.tolist() == usual.koi.tolist() == np.flatnonzero(BITS).tolist()
    assert rms(seen.shift_px - usual.shift_px) < SAME_px


def test_switches_survive_less_light_after_the_rest_frame() -> None:
    bundle = calibrate_rest(plain_bundle(), draw(REST))
    frame = lit(draw(PLACE, BITS, seed=2, tip_radius=2.4), (0.72, 0.72, 0.72))
    assert measure_frame(bundle, frame).koi.tolist() == [45, 58, 70]
    # By the wall's brightness as well as by the paint's.
    colours = replace(bundle.colours, usual_weight=None)
    for one in (replace(bundle, colours=colours), replace(bundle, white_balance=())):
        assert measure_frame(one, frame).koi.tolist() == [45, 58, 70]
    fixed = replace(bundle, colours=colours, white_balance=())
    assert len(measure_frame(fixed, frame).koi) < 3


def test_tips_that_show_at_rest_are_measured_there() -> None:
    """60 px of red are expected at rest, and the frame shows none: as little as is allowed."""
    plain = plain_bundle()
    tips = replace(plain.tips, red_rest_px=np.full(COUNT, 60.0), red_on_px=np.full(COUNT, 90.0))
    bundle = calibrate_rest(replace(plain, tips=tips), draw(REST))
    np.testing.assert_allclose(bundle.tips.red_rest_px, 48.0)
    np.testing.assert_allclose(bundle.tips.red_on_px, 72.0)


def test_what_that_is_worth() -> None:
    """By the design's colours alone: switches are missed in the dark."""
    gains = LIGHTS["two stops down"]
    bundle, rest = plain_bundle(), lit(draw(REST), gains)
    frame = lit(draw(PLACE, BITS, seed=2, tip_radius=2.8), gains)
    alone = measure_frame(bundle, frame, rest_px=rest_positions(bundle, rest))
    assert len(alone.koi) < BITS.sum()
    assert measure_frame(calibrate_rest(bundle, rest), frame).koi.tolist() == [45, 58, 70]


def test_hues_and_chroma_are_those_of_the_frame() -> None:
    gains = (0.75, 0.9, 1.1)
    true = ColourModel.from_rgb(
        {
            name: tuple(np.rint(paint * gains)[::-1].astype(int).tolist())
            for name, paint in zip(MODEL.names, np.minimum(BGR, 255 / np.array(gains)), strict=True)
        }
    )
    found = calibrated_colours(drawn_bundle(), [lit(draw(REST), gains)])
    for k in range(2):
        np.testing.assert_allclose(found.chroma[k], true.chroma[k], atol=3.0)
    # Red is not in a rest frame: its hue is kept, its chroma goes with that of the others.
    ratio = found.chroma[2] / MODEL.chroma[2]
    others = np.linalg.norm(found.chroma[:2], axis=1) / np.linalg.norm(MODEL.chroma[:2], axis=1)
    np.testing.assert_allclose(ratio, np.sqrt(others.prod()), rtol=1e-6)


def test_aged_paint_is_known_again() -> None:
    pale = tuple((0.55 * paint + 0.45 * np.array([200.0, 205.0, 210.0])) for paint in BGR)

    def aged(frame: ImageArray) -> ImageArray:
        out = frame.astype(np.float64)
        for fresh, old in zip(BGR, pale, strict=True):
            share = np.clip(1.0 - np.abs(out - fresh).max(axis=2) / 60.0, 0.0, 1.0)[:, :, None]
            out += share * (old - fresh)
        return np.clip(np.rint(out), 0, 255).astype(np.uint8)

    bundle = calibrate_rest(plain_bundle(), aged(draw(REST)))
    full = np.linalg.norm(bundle.colours.chroma[:2], axis=1)
    assert (full < 0.65 * np.linalg.norm(MODEL.chroma[:2], axis=1)).all()
    seen = measure_frame(bundle, aged(draw(PLACE, BITS, seed=3)))
    assert seen.found.all()
    assert seen.koi.tolist() == [45, 58, 70]


def test_a_tinted_wall_raises_the_floor() -> None:
    """Wall of the hue of red: below the usual floor it would be red all over."""
    gains = (0.72, 0.92, 1.1)
    frame = lit(draw(REST), gains)
    bundle = calibrate_rest(plain_bundle(), frame)
    assert bundle.colours.floor > 1.05 * calibrate_rest(plain_bundle(), draw(REST)).colours.floor
    low = replace(bundle, colours=replace(bundle.colours, floor=0.2))
    red, flooded = ((one.colours.classify(frame)[0] == 3).mean() for one in (bundle, low))
    assert red < 0.005
    assert flooded > 0.3


def test_rest_places_and_tips_move_with_the_frame() -> None:
    off = np.array([3.0, -2.0])
    bundle = calibrate_rest(plain_bundle(), draw(REST + off))
    assert rms(bundle.rest_px - REST - off) < 0.1
    assert rms(bundle.tips.on_px - REST - off - TIP_OFF) < 0.1
    seen = measure_frame(bundle, draw(PLACE + off, BITS, seed=1))
    assert rms(seen.shift_px - (PLACE - REST)) < 0.25
    assert seen.koi.tolist() == [45, 58, 70]
    # A marker that the rest frame hides stays where it was expected.
    hidden = calibrate_rest(plain_bundle(), draw(REST, hidden=(40,)))
    assert hidden.rest_px[40].tolist() == REST[40].tolist()


def test_a_follower_takes_the_calibrated_bundle() -> None:
    gains = LIGHTS["a stop down and warm"]
    rest = lit(draw(REST), gains)
    follower = Follower(calibrate_rest(plain_bundle(), rest), rest)
    for share in (0.3, 0.6, 1.0):
        place = REST + share * (PLACE - REST)
        seen = follower.follow(lit(draw(place, BITS, seed=int(10 * share)), gains))
    assert seen.found.all()
    assert seen.koi.tolist() == [45, 58, 70]
    assert rms(seen.shift_px - (PLACE - REST)) < 0.25


def test_two_cameras_are_calibrated_together() -> None:
    one = plain_bundle()
    far = REST[::-1] + np.array([1.0, 2.0])
    shown = tuple(
        CameraView(rest_px=rest, tips=replace(one.tips, on_px=rest + TIP_OFF))
        for rest in (REST, far)
    )
    read_by = (np.arange(COUNT) >= 60).astype(np.int64)
    own = read_by[:, None] == 1
    bundle = replace(one, cameras=one.cameras * 2, shown=shown, read_by=read_by,
                     rest_px=np.where(own, far, REST))  # fmt: skip
    gains, off = LIGHTS["cold"], np.array([1.0, 0.0])
    found = calibrate_rest(bundle, [lit(draw(REST), gains), lit(draw(far + off), gains)])
    assert len(found.shown) == 2
    assert rms(found.rest_px - np.where(own, far + off, REST)) < 0.1
    assert rms(found.shown[1].rest_px - far - off) < 0.1


def grey(frame: ImageArray) -> ImageArray:
    return np.asarray(frame.mean(axis=2, keepdims=True).repeat(3, axis=2), dtype=np.uint8)


def test_frames_without_colours_are_rejected() -> None:
    bundle = drawn_bundle()
    with refused("markers-without-colour"):
        calibrate_rest(bundle, grey(draw(REST)))
    with refused("markers-without-colour") as caught:
        calibrate_rest(bundle, np.zeros_like(draw(REST)))
    caught.match(r"0 of \d+ blue")
    with refused("frame-size"):
        calibrate_rest(bundle, draw(REST)[:100])


def test_indistinguishable_hues_are_rejected() -> None:
    # 28 degrees apart, half way between blue and green.
    angle = np.radians([145.0, 173.0])
    paints = 60.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    rng = np.random.default_rng(0)
    chroma = paints[COLOUR][:, None] + rng.normal(0.0, 0.5, (COUNT, 30, 2))
    with refused("colours-not-separable") as caught:
        fit_colours(MODEL, chroma, COLOUR)
    caught.match("blue and green")


def test_paint_without_contrast_is_rejected() -> None:
    """Paint of 20 levels of chroma beside a wall of as much, and noise."""
    rng = np.random.default_rng(0)
    wall = np.tile([14.0, -6.0], (COUNT, 60, 1))
    paint = 20.0 * (MODEL.chroma / np.linalg.norm(MODEL.chroma, axis=1)[:, None])[COLOUR]
    chroma = np.concatenate([np.repeat(paint[:, None], 20, axis=1), wall], axis=1)
    with refused("paint-contrast-low"):
        fit_colours(MODEL, chroma + rng.normal(0.0, 4.0, chroma.shape), COLOUR)
