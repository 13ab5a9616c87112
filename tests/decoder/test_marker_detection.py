"""Segmentation, matching and the digital channel on images with a known answer."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.vision.matching import match_markers, nearest_same_colour_px
from phytac_decoder.vision.segmentation import (
    Blobs,
    ColourModel,
    check_image,
    segment,
    segment_in_its_light,
)
from phytac_decoder.vision.switch_detection import TipModel, read_switches
from phytac_shapes.arrays import FloatArray
from tests.refusals import refused

PAINTS = {"blue": (28, 72, 214), "green": (24, 168, 62), "red": (214, 30, 34)}
MODEL = ColourModel.from_rgb(PAINTS)
GREY = (160, 170, 176)


def discs(
    centres: list[tuple[float, float]], names: list[str], *, radius: float = 5.0, scale: int = 8
) -> np.ndarray:
    """Anti-aliased discs on grey, drawn large and averaged down."""
    image = np.full((120 * scale, 160 * scale, 3), GREY, dtype=np.uint8)
    # Pixel centres of the small image are integers: big pixel b is at (b + 0.5)/scale - 0.5.
    y, x = ((np.arange(count * scale) + 0.5) / scale - 0.5 for count in (120, 160))
    for (cx, cy), name in zip(centres, names, strict=True):
        rows, columns = (np.flatnonzero(np.abs(k - c) < radius) for k, c in ((y, cy), (x, cx)))
        part = np.ix_(rows, columns)
        inside = np.hypot(x[columns] - cx, y[rows, None] - cy) < radius
        image[part] = np.where(inside[:, :, None], PAINTS[name][::-1], image[part])
    return cv2.resize(image, (160, 120), interpolation=cv2.INTER_AREA)


def test_centroids_are_sub_pixel() -> None:
    rng = np.random.default_rng(5)
    centres = [
        (20 + 30 * i + rng.uniform(), 30 + 40 * j + rng.uniform())
        for i in range(4)
        for j in range(2)
    ]
    names = ["blue", "green"] * 4
    image = discs(centres, names)
    noisy = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    blobs = segment(noisy, MODEL)
    assert len(blobs.colour) == 8
    error = np.linalg.norm(blobs.centroid_px[:, None] - np.array(centres)[None], axis=2).min(axis=1)
    assert np.sqrt((error**2).mean()) < 0.04


def scattered(radius: float = 3.0) -> tuple[FloatArray, FloatArray]:
    """Small blurred discs at many places on the pixels, before noise; and their centres (35, 2)."""
    rng = np.random.default_rng(8)
    centres = [
        (10.0 + 20 * i + rng.uniform(), 10 + 20 * j + rng.uniform())
        for i in range(7)
        for j in range(5)
    ]
    image = discs(centres, ["blue", "green", "red", "blue", "green"] * 7, radius=radius)
    return cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float64), np.array(centres)


def centroid_error(image: FloatArray, centres: FloatArray, model: ColourModel) -> float:
    """Root mean square of the distances of all discs' centroids from their centres."""
    blobs = segment(np.clip(image, 0, 255).astype(np.uint8), model)
    gap = np.linalg.norm(blobs.centroid_px[:, None] - centres[None], axis=2).min(axis=0)
    return float(np.sqrt(np.mean(gap**2)))


def test_edges_of_markers_count_in_part() -> None:
    image, centres = scattered()
    hard = ColourModel(names=MODEL.names, chroma=MODEL.chroma, edge=MODEL.floor)
    rng = np.random.default_rng(9)
    error = []
    for model in (MODEL, hard):
        noisy = [image + rng.normal(0, 2, image.shape) for _ in range(4)]
        error.append(np.mean([centroid_error(one, centres, model) for one in noisy]))
    assert error[0] < 0.7 * error[1]


@pytest.mark.parametrize("centre", [(3.0, 2.5), (80.3, 60.2), (157.6, 117.1), (0.4, 119.0)])
def test_blobs_are_the_same_wherever_they_lie_in_the_image(centre: tuple[float, float]) -> None:
    """Only the part of the image around a paint is searched for it."""
    image = discs([centre, (30.0, 90.0)], ["blue", "green"])
    middle = discs([(80.0, 60.0), centre], ["red", "blue"])  # paints in other parts
    for picture in (image, middle):
        around = cv2.copyMakeBorder(picture, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=GREY)
        found = segment(picture, MODEL, with_labels=True)
        apart = segment(around, MODEL, with_labels=True)
        assert found.centroid_px == pytest.approx(apart.centroid_px - 40.0, abs=1e-9)
        assert (found.box_px == apart.box_px - 40).all()
        assert (found.area_px == apart.area_px).all()
        inside = apart.labels[40:-40, 40:-40] if apart.labels is not None else None
        assert np.array_equal(found.labels, inside)


def test_gain_does_not_move_centroids() -> None:
    """A disc whose one half is in shade, as the side of a receptor is."""
    image, centres = scattered(radius=6.0)
    shade = np.where((np.arange(image.shape[1]) - 10.0) % 20.0 < 10.0, 1.0, 0.75)
    image *= 0.8 * shade[None, :, None]
    blue_green = [k for k in range(len(centres)) if k % 5 != 2]
    found = []
    for gain in (0.75, 1.0, 1.25):
        blobs = segment((gain * image).astype(np.uint8), MODEL)
        gap = np.linalg.norm(blobs.centroid_px[:, None] - centres[None], axis=2)
        found.append(blobs.centroid_px[gap.argmin(axis=0)][blue_green])
    assert np.abs(found[0] - found[1]).max() < 0.08
    assert np.abs(found[2] - found[1]).max() < 0.05


@pytest.mark.parametrize("gain", [0.35, 0.6, 1.0])
def test_colour_survives_shade(gain: float) -> None:
    image = discs([(30, 30), (60, 30), (90, 30)], ["blue", "green", "red"])
    dark = (image * gain).astype(np.uint8)
    blobs = segment(dark, MODEL)
    assert sorted(blobs.colour.tolist()) == [0, 1, 2]
    order = np.argsort(blobs.centroid_px[:, 0])
    assert blobs.colour[order].tolist() == [0, 1, 2]


def test_grey_holds_no_blob() -> None:
    rng = np.random.default_rng(0)
    noise = np.clip(rng.normal(GREY, 4, (120, 160, 3)), 0, 255).astype(np.uint8)
    assert len(segment(noise, MODEL).colour) == 0


def test_other_colours_are_no_paint() -> None:
    image = np.full((60, 60, 3), GREY, dtype=np.uint8)
    image[20:40, 20:40] = (200, 30, 200)  # magenta, between red and blue
    assert len(segment(image, MODEL).colour) == 0


def test_touching_colours_stay_apart() -> None:
    blobs = segment(discs([(50, 50), (59.0, 50)], ["blue", "green"]), MODEL)
    assert sorted(blobs.colour.tolist()) == [0, 1]


def test_more_blobs_than_16_bit_labels() -> None:
    """A lattice of 75 000 single pixels: more labels than 16 bits hold."""
    image = np.full((600, 1000, 3), GREY, dtype=np.uint8)
    image[::2, ::4] = PAINTS["blue"][::-1]
    blobs = segment(image, MODEL, area_min_px=1)
    assert len(blobs.colour) == 300 * 250


def test_wrong_images_are_rejected() -> None:
    with refused("frame-size"):
        check_image(np.zeros((120, 160, 3), np.uint8), width_px=640, height_px=480)
    with refused("frame-type"):
        check_image(np.zeros((120, 160), np.uint8), width_px=160, height_px=120)


def lattice() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """5 × 6 markers 24 px apart, colours by column, with their neighbours."""
    row, column = np.divmod(np.arange(30), 6)
    rest = np.column_stack([20.0 + 24 * column, 10.0 + 24 * row])
    steps = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    near = np.full((30, 8), -1)
    for slot, (a, b) in enumerate(steps):
        ok = (row + a >= 0) & (row + a < 5) & (column + b >= 0) & (column + b < 6)
        near[ok, slot] = ((row + a) * 6 + column + b)[ok]
    return rest, column % 2, near


def test_matching_names_every_marker_under_motion() -> None:
    rest, colour, near = lattice()
    rng = np.random.default_rng(2)
    centre = np.array([80.0, 58.0])
    arm = rest - centre
    push = 9.0 * np.exp(-np.sum(arm**2, axis=1) / 900.0)[:, None] * np.array([0.6, 0.8])
    moved = rest + push + rng.normal(0, 0.1, rest.shape)
    names = [("blue", "green")[c] for c in colour]
    blobs = segment(discs([tuple(p) for p in moved], names, radius=3.5), MODEL)
    found = match_markers(blobs, rest_px=rest, colour=colour, neighbours=near)
    assert found.found.all()
    assert np.abs(found.position_px - moved).max() < 0.2


def test_a_hidden_marker_is_reported_not_invented() -> None:
    rest, colour, near = lattice()
    keep = np.arange(30) != 14
    names = [("blue", "green")[c] for c in colour[keep]]
    blobs = segment(discs([tuple(p) for p in rest[keep]], names, radius=3.5), MODEL)
    found = match_markers(blobs, rest_px=rest, colour=colour, neighbours=near)
    assert not found.found[14]
    assert np.isnan(found.position_px[14]).all()
    assert found.found[keep].all()


def test_split_marker_is_one_marker() -> None:
    rest, colour, near = lattice()
    names = [("blue", "green")[c] for c in colour]
    image = discs([tuple(p) for p in rest], names, radius=5.0)
    x, y = rest[8].astype(int)
    image[y, x - 8 : x + 9] = GREY  # a scratch across one marker
    found = match_markers(segment(image, MODEL), rest_px=rest, colour=colour, neighbours=near)
    assert found.found.all()
    assert np.abs(found.position_px[8] - rest[8]).max() < 0.2


def test_nearest_same_colour() -> None:
    rest, colour, _ = lattice()
    assert np.allclose(nearest_same_colour_px(rest, colour), 24.0)


def test_switch_bits_follow_the_red() -> None:
    tips = TipModel(
        on_px=np.array([[40.0, 40.0], [100.0, 40.0], [70.0, 90.0]]),
        red_rest_px=np.array([0.0, 30.0, 0.0]),
        red_on_px=np.array([78.0, 78.0, 78.0]),
    )
    image = discs([(41.0, 40.0), (100.0, 40.0)], ["red", "red"], radius=5.0)
    image[36:45, 100:112] = GREY  # half of the second tip is still in its hole
    bits, _ = read_switches(segment(image, MODEL), tips, red_index=2, shift_px=np.zeros((3, 2)))
    assert bits.tolist() == [True, False, False]


def test_less_light_is_followed() -> None:
    """A tip that is a little above its threshold stays above it in less light."""
    places = [(30.0 + 24.0 * k, 40.0) for k in range(4)]
    tips = TipModel(
        on_px=np.array([(x, 80.0) for x, _ in places]),
        red_rest_px=np.zeros(4),
        red_on_px=np.full(4, 130.0),
    )
    paints = ["blue", "green", "blue", "green"]
    rest = segment(discs(places, paints), MODEL)
    model = replace(MODEL, usual_weight=rest.usual_weight(3)[None])
    bright = discs([*places, *tips.on_px[:2].tolist()], [*paints, "red", "red"])
    dim = np.rint(0.72 * bright).astype(np.uint8)

    def bits(blobs: Blobs) -> list[bool]:
        return read_switches(blobs, tips, red_index=2, shift_px=np.zeros((4, 2)))[0].tolist()

    assert model.light(segment(dim, model)) == pytest.approx(0.72, abs=0.06)
    for image in (bright, dim):
        assert bits(segment_in_its_light(image, model)) == [True, True, False, False]
    assert not any(bits(segment(dim, model)))


def test_light_is_that_of_paint_without_tips() -> None:
    image = discs([(30.0, 40.0), (60.0, 40.0)], ["blue", "red"], radius=5.0)
    rest = segment(discs([(30.0, 40.0)], ["blue"], radius=5.0), MODEL).usual_weight(3)
    assert np.isnan(rest[2])
    # Tips that showed a little at rest, and are out now, are no light.
    model = replace(MODEL, usual_weight=np.where(np.isnan(rest), 10.0, rest)[None])
    assert model.light(segment(image, model)) == pytest.approx(1.0, abs=0.01)
    assert model.in_light(1.01) is model
    assert MODEL.light(segment(image, MODEL)) == 1.0
    # The markers of another camera are larger.
    two = replace(MODEL, usual_weight=np.stack([2.0 * rest, rest]))
    seen = segment(image, MODEL)
    assert two.light(seen, 1) == pytest.approx(1.0, abs=0.01)
    assert two.light(seen, 0) < 0.5


def test_red_that_shows_at_rest_is_measured_there() -> None:
    tips = TipModel(
        on_px=np.zeros((4, 2)),
        red_rest_px=np.array([500.0, 400.0, 300.0, 2.0]),
        red_on_px=np.array([600.0, 460.0, 350.0, 40.0]),
    )
    measured = tips.as_at_rest(np.array([550.0, 360.0, 900.0, 20.0]))
    assert measured.red_rest_px.tolist() == [550.0, 360.0, 375.0, 2.0]
    assert measured.red_on_px == pytest.approx([660.0, 414.0, 437.5, 40.0])
    # One tip of three is out, in 10 % more light on red paint.
    light = measured.red_light(1.1 * np.array([660.0, 360.0, 375.0, 0.0]))
    assert light == pytest.approx(1.1)
    assert replace(tips, red_rest_px=np.zeros(4)).red_light(np.zeros(4)) == 1.0


def test_tips_with_more_red_than_at_rest_are_half_out() -> None:
    tips = TipModel(
        on_px=np.zeros((10, 2)),
        red_rest_px=np.array([20.0, 20.0, 20.0, 40.0, 0.0, 4.0, 0.0, 40.0, 20.0, 4.0]),
        red_on_px=np.array([80.0, 80.0, 80.0, 60.0, 14.0, 80.0, 80.0, 50.0, 80.0, 40.0]),
    )
    red = np.array([32.0, 28.0, 65.0, 49.0, 6.0, 30.0, 15.0, 60.0, 60.0, 25.0])
    on = np.array([0, 0, 1, 0, 0, 0, 0, 0, 1, 1]) > 0
    # A fifth of the way; within the scatter of printed tips; on; too little of it; two that hardly
    # show at rest, a third of the way; the same, a fifth of the way; not readable; on by two thirds
    # of the way; too small to be measured.
    named = [True, False, False, False, True, True, False, False, True, False]
    assert tips.half_out(red, on).tolist() == named
    # A tip that comes out as the force grows is half out without a fault.
    gradual = replace(tips, gradual=np.array([1, 0, 0, 0, 1, 1, 0, 0, 1, 0]) > 0)
    assert not gradual.half_out(red, on).any()


def test_switches_allow_for_light_on_red() -> None:
    """Tips that show at rest read as off when all of them are brighter, and as on when one is."""
    places = [(30.0 + 30.0 * k, 60.0) for k in range(4)]
    tips = TipModel(
        on_px=np.array(places), red_rest_px=np.full(4, 64.0), red_on_px=np.full(4, 80.0)
    )

    def bits(radius: list[float]) -> list[bool]:
        image = np.full((120, 160, 3), GREY, dtype=np.uint8)
        for place, each in zip(places, radius, strict=True):
            one = discs([place], ["red"], radius=each)
            image = np.where((one != GREY).any(axis=2, keepdims=True), one, image)
        seen = segment(image.astype(np.uint8), MODEL)
        return read_switches(seen, tips, red_index=2, shift_px=np.zeros((4, 2)))[0].tolist()

    assert bits([5.0] * 4) == [False] * 4
    assert bits([5.0, 5.0, 5.0, 5.9]) == [False, False, False, True]
