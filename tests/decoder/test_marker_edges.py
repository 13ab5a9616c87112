"""Edges of small markers: compressed pictures, shifts below a pixel, red tips, changes of light."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame, with_edges
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision import marker_edges
from phytac_decoder.vision.marker_edges import SETTINGS, MarkerEdges
from phytac_decoder.vision.segmentation import ColourModel
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder import test_follow
from tests.decoder.test_calibrate_colours import plain_bundle, rms
from tests.decoder.test_follow import (
    BGR,
    COLOUR,
    COUNT,
    GREY,
    MODEL,
    OFF,
    REST,
    dent,
    draw,
)
from tests.decoder.test_light_response import half_in_shade

MOVED: FloatArray = dent(np.array([150.0, 120.0]), np.array([2.0, -1.5]))
AREA: FloatArray = np.full(COUNT, 130.0)


def jpeg(frame: ImageArray, quality: int = 90) -> ImageArray:
    """JPEG and back: chroma has half the resolution."""
    data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)


def without(bundle: Bundle) -> Bundle:
    return replace(bundle, edges=())


def error(bundle: Bundle, frame: ImageArray, moved: FloatArray) -> float:
    return rms(measure_frame(bundle, frame).shift_px - moved)


@pytest.fixture(scope="module")
def plain() -> Bundle:
    return calibrate_rest(plain_bundle(), draw(REST))


def test_compressed_pictures() -> None:
    bundle = calibrate_rest(plain_bundle(), jpeg(draw(REST)))
    frame = jpeg(draw(MOVED, seed=1))
    exact = error(bundle, frame, MOVED - REST)
    assert exact < 0.02
    assert exact < 0.6 * error(without(bundle), frame, MOVED - REST)


def test_a_film_is_read_alike() -> None:
    rest, frame = jpeg(draw(REST)), jpeg(draw(MOVED, seed=1))
    bundle = calibrate_rest(plain_bundle(), rest)
    seen, alone = (
        Follower(each, rest).follow(frame).shift_px for each in (bundle, without(bundle))
    )
    assert rms(seen - measure_frame(bundle, frame).shift_px) < 0.02
    assert rms(seen - (MOVED - REST)) < 0.6 * rms(alone - (MOVED - REST))


@pytest.mark.parametrize("shift", [0.05, 0.1, 0.25, 0.4, 0.75, 1.0, 1.4])
def test_shifts_below_a_pixel_are_not_drawn_to_whole_ones(shift: float) -> None:
    rest = REST + np.random.default_rng(3).uniform(-0.5, 0.5, REST.shape)
    edges = MarkerEdges.at_rest(draw(rest), MODEL, rest, AREA)
    assert edges is not None
    moved = np.tile([shift, -0.6 * shift], (COUNT, 1))
    frame = draw(rest + moved, seed=1)
    found, seen = edges._aligned(frame, np.arange(COUNT), 0.8 * moved, OFF)
    gain = np.sum(found * moved) / np.sum(moved**2)
    # Noise of 0.007 px in 117 markers is 1.5 % of 0.05 px.
    assert gain == pytest.approx(1.0, abs=0.035 if shift < 0.1 else 0.01)
    assert (seen == 1.0).all()


@pytest.mark.parametrize("blur_px", [0.6, 0.8, 1.0])
@pytest.mark.parametrize("shift", [0.1, 0.3, 0.5, 1.0])
def test_edges_out_of_focus_move_as_far(shift: float, blur_px: float) -> None:
    rest = REST + np.random.default_rng(3).uniform(-0.5, 0.5, REST.shape)
    edges = MarkerEdges.at_rest(draw(rest), MODEL, rest, AREA)
    assert edges is not None
    moved = np.tile([shift, -0.6 * shift], (COUNT, 1))
    frame = cv2.GaussianBlur(draw(rest + moved, seed=1), (0, 0), blur_px)
    found, _ = edges._aligned(frame, np.arange(COUNT), moved, OFF)
    # By the sharp edges of the rest frame they would seem to move by a sixth less at 0.8 px.
    limit = 0.02 if blur_px < 1.0 else 0.05
    assert np.sum(found * moved) / np.sum(moved**2) == pytest.approx(1.0, abs=limit)


def test_the_loss_by_blur_is_that_by_theory_where_nothing_shows_it(plain: Bundle) -> None:
    (edges,) = plain.edges
    assert edges is not None
    assert edges.blur_loss > 0.1
    flat = np.full_like(draw(REST), 128)
    assert replace(edges, blur_loss=0.2)._blur_loss_in(flat) == 0.2


def test_red_tips_do_not_move_edges(plain: Bundle) -> None:
    """A tip covers paint: the centroid moves by a pixel, of which the design knows nothing here."""
    bits = OFF.copy()
    bits[[30, 58, 86]] = True
    frame = draw(MOVED, bits, seed=2)
    seen, covered = (measure_frame(each, frame) for each in (plain, without(plain)))
    assert seen.koi.tolist() == covered.koi.tolist() == [30, 58, 86]
    wrong, right = (rms((one.shift_px - (MOVED - REST))[bits]) for one in (covered, seen))
    assert wrong > 0.3
    assert right < 0.3 * wrong


def test_blur_hardly_moves_edges_that_are_brighter_on_one_side() -> None:
    edges = MarkerEdges.at_rest(half_in_shade(draw(REST)), MODEL, REST, AREA)
    assert edges is not None
    soft = cv2.GaussianBlur(half_in_shade(draw(REST, seed=1)), (0, 0), 0.6)
    start = np.zeros((len(edges.ids), 2))
    # All markers are brighter on the same side, and their noise averages out.
    unknown, ignored = (
        rms(each._aligned(soft, np.arange(len(start)), start, OFF)[0].mean(axis=0))
        for each in (edges, replace(edges, blur=0.0 * edges.blur))
    )
    assert unknown < 0.0025
    assert unknown < 0.7 * ignored


def test_light_that_differs_from_place_to_place_moves_no_edges(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    edges = MarkerEdges.at_rest(half_in_shade(draw(REST)), MODEL, REST, AREA)
    assert edges is not None
    frame = half_in_shade(draw(MOVED, seed=1))
    across = np.linspace(0.8, 1.2, frame.shape[1])[None, :, None]
    lit = np.clip(np.rint(frame * across), 0, 255).astype(np.uint8)
    usual = edges.combined(frame, MOVED - REST, OFF, OFF)
    error = rms(edges.combined(lit, MOVED - REST, OFF, OFF) - usual)
    monkeypatch.setattr(
        marker_edges, "SETTINGS", replace(marker_edges.SETTINGS, brightness=(1.0, 1.0))
    )
    without = rms(edges.combined(lit, MOVED - REST, OFF, OFF) - usual)
    assert error < 0.006
    assert error < 0.4 * without


def test_brightness_is_that_of_the_markers_around(plain: Bundle) -> None:
    """A single marker that looks brighter has moved, or is hidden in part."""
    (edges,) = plain.edges
    assert edges is not None
    rows = np.arange(len(edges.ids))
    rest, even = edges.level, (edges.weight > 0.0).astype(np.float32)
    now = rest.copy()
    now[58] *= 0.5
    offset, factor = edges._brightness(rows, rest, now, even)
    assert offset == pytest.approx(0.0, abs=0.01)
    assert 1.05 < factor[58].mean() < 1.3
    assert 1 < np.count_nonzero(factor.mean(axis=1) > 1.01) < 3 * SETTINGS.around
    # Markers that red covers say nothing.
    bare = even.copy()
    bare[55:62] = 0.0
    offset, factor = edges._brightness(rows, rest, now, bare)
    assert factor == pytest.approx(1.0, abs=0.01)
    offset, factor = edges._brightness(rows, rest, now, 0.0 * even)
    assert (offset, factor.min(), factor.max()) == (0.0, 1.0, 1.0)
    # A veil of light, and a picture that is darker on one side; of all markers, or of some.
    x = edges.pixel[0] / 320.0
    shaded = (0.8 + 0.4 * x) * rest + 20.0
    for some in (rows, rows[20:60]):
        offset, factor = edges._brightness(some, rest[some], shaded[some], even[some])
        back = (shaded[some] - offset) * factor
        assert offset == pytest.approx(20.0, abs=2.0)
        assert np.abs(back - rest[some])[even[some] > 0.0].max() < 4.0
    _, factor = edges._brightness(rows, rest, 0.01 * rest, even)
    assert factor.max() == SETTINGS.brightness[1]


def test_tips_of_markers_without_edges_count_too() -> None:
    area = np.where(np.arange(COUNT) == 31, 1.0, AREA)
    edges = MarkerEdges.at_rest(draw(REST), MODEL, REST, area)
    assert edges is not None
    assert 31 not in edges.ids
    shift, red = np.zeros((COUNT, 2)), np.arange(COUNT) == 31
    shift[31] = -10.0, 0.0
    near = edges._reddened(np.arange(len(edges.ids)), shift, red)
    assert edges.ids[near].tolist() == [30]


def test_light_that_changes_moves_edges_less_than_centroids(plain: Bundle) -> None:
    usual = error(plain, draw(MOVED, seed=3), MOVED - REST)
    for frame in (
        np.clip(np.rint(draw(MOVED, seed=3) * 0.7), 0, 255).astype(np.uint8),
        np.clip(draw(MOVED, seed=3).astype(np.int64) + 25, 0, 255).astype(np.uint8),
    ):
        assert error(plain, frame, MOVED - REST) < 1.5 * usual


def test_doubtful_switches_and_lost_markers_are_left_alone(plain: Bundle) -> None:
    tips = replace(plain.tips, red_on_px=np.where(np.arange(COUNT) == 40, 1.0, 30.0))
    bundle = replace(plain, tips=tips)
    assert np.flatnonzero(~bundle.tips.readable).tolist() == [40]
    moved = MOVED - REST + 0.1
    moved[7] = np.nan
    on = np.arange(COUNT) == 40
    found = with_edges(bundle, [draw(MOVED, seed=4)], moved, on, OFF)
    np.testing.assert_array_equal(found[40], moved[40])
    assert np.isnan(found[7]).all()
    others = np.delete(np.arange(COUNT), [7, 40])
    assert rms((found - (MOVED - REST))[others]) < 0.5 * 0.1


def test_each_camera_reads_its_own(plain: Bundle) -> None:
    moved = MOVED - REST + 0.1
    far = np.arange(COUNT) % 3 == 0
    two = replace(plain, cameras=plain.cameras * 2, read_by=far.astype(np.int64))
    two = replace(two, edges=(plain.edges[0], None))
    found = with_edges(two, [draw(MOVED, seed=4)] * 2, moved, OFF, OFF)
    np.testing.assert_array_equal(found[far], moved[far])
    assert rms((found - (MOVED - REST))[~far]) < 0.5 * 0.1


def test_edges_that_contradict_the_centroid_do_not_count(plain: Bundle) -> None:
    (edges,) = plain.edges
    assert edges is not None
    frame, start = draw(REST, seed=5), np.zeros((COUNT, 2))
    start[5] = 1.0, 0.0
    found = edges.combined(frame, start, OFF, OFF)
    np.testing.assert_array_equal(found[5], start[5])
    # A tip that is out moves the centroid that far.
    on = np.arange(COUNT) == 5
    assert np.hypot(*edges.combined(frame, start, on, on)[5]) < 0.1


def test_large_and_tiny_markers_and_dots_have_none() -> None:
    frame = draw(REST)
    assert MarkerEdges.at_rest(frame, MODEL, REST, AREA) is not None
    for size in (SETTINGS.area_max_px, 0.9 * SETTINGS.area_min_px):
        assert MarkerEdges.at_rest(frame, MODEL, REST, np.full(COUNT, size)) is None
    assert MarkerEdges.at_rest(frame, MODEL, np.full((COUNT, 2), np.nan), AREA) is None
    assert MarkerEdges.at_rest(frame, MODEL, REST + 5.0, AREA) is None
    dots = ColourModel.from_rgb({"white": (250, 250, 250), "red": (214, 30, 34)})
    assert MarkerEdges.at_rest(frame, dots, REST, AREA) is None
    assert plain_bundle().edges == ()


def test_paint_as_bright_as_the_wall_is_read_by_its_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    luma = np.array([0.114, 0.587, 0.299])
    paints = np.array([[214.0, 150.0, 112.0], [134.0, 184.0, 150.0]])
    paints *= (np.array(GREY) @ luma / (paints @ luma))[:, None]
    monkeypatch.setattr(test_follow, "BGR", np.vstack([paints, BGR[2]]))
    assert calibrate_rest(plain_bundle(), draw(REST)).edges == (None,)
    paints[0] *= 0.5
    monkeypatch.setattr(test_follow, "BGR", np.vstack([paints, BGR[2]]))
    (edges,) = calibrate_rest(plain_bundle(), draw(REST)).edges
    assert edges is not None
    np.testing.assert_array_equal(edges.ids, np.flatnonzero(COLOUR == 0))
