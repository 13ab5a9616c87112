"""Following markers over drawn frames with a known answer."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision.segmentation import ColourModel
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from tests.refusals import refused

WIDTH, HEIGHT = 320, 240
ROWS, COLUMNS = 9, 13
COUNT = ROWS * COLUMNS
PITCH, RADIUS, TIP_RADIUS = 23.0, 6.5, 3.0
MODEL = ColourModel.from_rgb({"blue": (28, 72, 214), "green": (24, 168, 62), "red": (214, 30, 34)})
BGR = np.array([(214, 72, 28), (62, 168, 24), (34, 30, 214)], dtype=np.float64)
GREY = (160.0, 170.0, 176.0)
TIP_OFF = np.array([0.0, 4.0])
AGREE_px = 0.02
"""How far centroids may be from those of the full search, RMS."""
OFF = np.zeros(COUNT, dtype=np.bool_)

row, column = np.divmod(np.arange(COUNT), COLUMNS)
REST = np.column_stack([22.3 + PITCH * column, 27.6 + PITCH * row])
# Pairs of columns: a marker's nearest of its own colour is one pitch away.
COLOUR = (column // 2) % 2


def neighbours() -> np.ndarray:
    steps = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    near = np.full((COUNT, 8), -1)
    for slot, (a, b) in enumerate(steps):
        ok = (row + a >= 0) & (row + a < ROWS) & (column + b >= 0) & (column + b < COLUMNS)
        near[ok, slot] = ((row + a) * COLUMNS + column + b)[ok]
    return near


def make_bundle(rest: FloatArray = REST) -> Bundle:
    red = np.pi * TIP_RADIUS**2
    camera = Camera.on_axis(width_px=WIDTH, height_px=HEIGHT, focal_px=200, stand_off_mm=30)
    return Bundle(
        design="drawn",
        design_hash="",
        cameras=(camera,),
        read_by=np.zeros(COUNT, dtype=np.int64),
        colours=MODEL,
        colour=COLOUR,
        position_mm=np.zeros((COUNT, 3)),
        head_mm=camera.position_mm + 40.0 * camera.rays(rest),
        rest_px=rest,
        tip_bias_px=np.tile([0.3, -0.2], (COUNT, 1)),
        tips=TipModel(
            on_px=rest + TIP_OFF, red_rest_px=np.zeros(COUNT), red_on_px=np.full(COUNT, red)
        ),
        model=ForceModel(
            shift_to_mm=np.ones((COUNT, 2)),
            stiffness=np.eye(COUNT),
            compliance_px=np.repeat(np.eye(COUNT), 2, axis=0),
            height_z_mm=np.zeros(COUNT),
            neighbours=neighbours(),
            networks={},
        ),
        threshold_N=np.full(COUNT, 0.5),
    ).with_mount()


def disc(image: FloatArray, centre: FloatArray, radius: float, colour: FloatArray) -> None:
    """Paint an anti-aliased disc."""
    reach = int(radius) + 2
    x0, y0 = np.maximum(np.rint(centre).astype(int) - reach, 0)
    x1, y1 = np.rint(centre).astype(int) + reach + 1
    if x1 <= 0 or y1 <= 0:
        return
    part = image[y0:y1, x0:x1]
    y, x = y0 + np.arange(part.shape[0])[:, None], x0 + np.arange(part.shape[1])
    away = np.hypot(x - centre[0], y - centre[1])
    cover = np.minimum(np.maximum(radius + 0.5 - away, 0.0), 1.0)[:, :, None]
    part += cover * (colour - part)


def draw(
    place: FloatArray,
    bits: BoolArray = OFF,
    *,
    seed: int = 0,
    hidden: tuple[int, ...] = (),
    tip_radius: float = TIP_RADIUS,
    rest: FloatArray = REST,
) -> ImageArray:
    """Frame with markers at ``place``, tips out where ``bits``, and noise of 2 levels."""
    image = np.full((HEIGHT, WIDTH, 3), GREY)
    for i in np.setdiff1d(np.arange(len(place)), hidden):
        disc(image, place[i], RADIUS, BGR[COLOUR[i]])
        if bits[i]:
            disc(image, place[i] + TIP_OFF, tip_radius, BGR[2])
    noise = np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def dent(centre: FloatArray, push: FloatArray, width: float = 30.0) -> FloatArray:
    """Places of all markers when those near ``centre`` are pushed."""
    near = np.exp(-np.sum((REST - centre) ** 2, axis=1) / (2.0 * width**2))
    return np.asarray(REST + near[:, None] * push)


def press_and_slide(frames: int, push: FloatArray) -> list[FloatArray]:
    """A dent that comes, slides across the picture and goes."""
    out = []
    for t in np.linspace(0.0, 1.0, frames):
        depth = np.clip(min(t, 1.0 - t) / 0.25, 0.0, 1.0)
        out.append(dent(np.array([80.0 + 150.0 * t, 90.0 + 60.0 * t]), depth * push))
    return out


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def followed_by(follower: Follower, places: list[FloatArray]) -> FloatArray:
    """Errors (frames, n, 2) px against the true places."""
    out = [
        follower.follow(draw(place, seed=k)).position_px - place
        for k, place in enumerate(places, start=1)
    ]
    return np.stack(out)


def test_tables_are_the_colour_models_own() -> None:
    image = np.random.default_rng(0).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    classes, flat = MODEL.classify(image)
    tables = MODEL.coverage_tables
    assert len(np.unique(classes)) == 4
    for paint in range(3):
        other = (classes > 0) & (classes != paint + 1)
        np.testing.assert_allclose(tables[paint][flat], MODEL.coverage(flat, paint), atol=1e-7)
        assert (tables[paint][flat][other] == 0.0).all()
        assert tables[paint][flat][classes == paint + 1].min() > 0.0


def test_centroids_are_those_of_the_full_search() -> None:
    bundle, rest = make_bundle(), draw(REST)
    follower = Follower(bundle, rest)
    bits = np.isin(np.arange(COUNT), (45, 58))
    for k, place in enumerate(press_and_slide(12, np.array([5.0, 4.0])), start=1):
        frame = draw(place, bits, seed=k)
        seen = follower.follow(frame)
        full = measure_frame(bundle, frame, rest_px=follower.rest_px)
        assert seen.found.all()
        assert rms(seen.shift_px - full.shift_px) < AGREE_px
        assert seen.koi.tolist() == full.koi.tolist() == [45, 58]


def test_the_rest_frame_gives_the_rest_places() -> None:
    # The camera sits a little off: all that counts is the rest frame.
    off = np.array([3.0, -2.0])
    follower = Follower(make_bundle(), draw(REST + off))
    assert rms(follower.rest_px - REST - off) < 0.05
    seen = follower.follow(draw(REST + off, seed=1))
    assert rms(seen.shift_px) < 0.1


def test_no_marker_takes_anothers_place() -> None:
    """Markers move by most of a pitch, onto places where others were."""
    push = np.array([0.5, 0.8]) * 0.95 * PITCH
    places = press_and_slide(100, push)
    assert max(np.abs(place - REST).max() for place in places) > 0.7 * PITCH
    error = followed_by(Follower(make_bundle(), draw(REST)), places)
    assert np.isfinite(error).mean() > 0.999
    assert np.nanmax(np.abs(error)) < 0.5
    # The deepest of these frames by itself, by the lattice alone.
    deep = places[50]
    alone = measure_frame(make_bundle(), draw(deep), rest_px=REST)
    assert np.nanmax(np.abs(REST + alone.shift_px - deep)) < 0.5


def test_markers_on_their_neighbours_dots_are_put_right_within_ten_frames() -> None:
    """A dent of most of a pitch, at once: windows land on other markers of the same colour."""
    follower = Follower(make_bundle(), draw(REST))
    flags: list[str] = []
    place = dent(np.array([160.0, 120.0]), np.array([0.0, 0.95 * PITCH]))
    jumped = np.linalg.norm(place - REST, axis=1) > 0.5 * PITCH
    assert np.count_nonzero(jumped) == 9
    for k in range(10):
        seen = follower.follow(draw(place, seed=k))
        flags += seen.flags
    assert seen.found.all()
    assert np.abs(seen.position_px - place).max() < 0.5
    assert 1 <= flags.count("the whole frame was searched") <= 2
    # And back.
    for k in range(10):
        seen = follower.follow(draw(REST, seed=k))
    assert np.abs(seen.position_px - REST).max() < 0.5


def swap(follower: Follower, one: int, other: int) -> None:
    """Let two markers be followed on each other's dots."""
    camera = follower._cameras[0]
    pair = [camera.ids.tolist().index(marker) for marker in (one, other)]
    place = camera.place_px.copy()
    place[pair] = place[pair[::-1]]
    camera.place_px = place


def test_the_whole_frame_is_searched_at_most_every_fifth_frame() -> None:
    follower, searched = Follower(make_bundle(), draw(REST)), []
    for k in range(11):
        swap(follower, 60, 61)
        seen = follower.follow(draw(REST, seed=k))
        searched += [k] if seen.flags else []
    assert searched == [0, 5, 10]


def test_a_marker_on_anothers_dot_is_not_reported() -> None:
    """Until the next search may take place, which then puts it right."""
    follower = Follower(make_bundle(), draw(REST))
    follower._cameras[0]._search_from = 3
    assert COLOUR[60] == COLOUR[61]
    swap(follower, 60, 61)
    for k in (1, 2):
        seen = follower.follow(draw(REST, seed=k))
        assert np.flatnonzero(~seen.found).tolist() == [60, 61]
        assert np.nanmax(np.abs(seen.position_px - REST)) < 0.5
    seen = follower.follow(draw(REST, seed=3))
    assert seen.found.all()
    assert np.abs(seen.position_px - REST).max() < 0.5
    assert follower.follow(draw(REST, seed=4)).flags == ()


def test_touching_markers_of_one_colour_are_parted() -> None:
    """Two that come so near that their discs overlap by two pixels."""
    one, other = 58, 59 if COLOUR[59] == COLOUR[58] else 57
    way = (REST[other] - REST[one]) / PITCH
    follower, errors = Follower(make_bundle(), draw(REST)), []
    for k, gap in enumerate(np.concatenate([np.linspace(PITCH, 11.0, 30), [11.0] * 5])):
        place = REST.copy()
        # Each comes half of the way.
        place[[one, other]] += 0.5 * (PITCH - gap) * np.array([way, -way])
        frame = draw(place, seed=k)
        seen = follower.follow(frame)
        errors.append(np.linalg.norm((seen.position_px - place)[[one, other]], axis=1))
    assert np.max(errors) < 0.7
    # The full search takes them for one.
    full = measure_frame(make_bundle(), frame, rest_px=REST)
    away = np.linalg.norm(REST + full.shift_px - place, axis=1)[[one, other]]
    assert not full.found[[one, other]].all() or away.max() > 3.0


def test_markers_that_are_one_at_rest_are_not_invented() -> None:
    rest = REST.copy()
    rest[58] += 0.75 * (REST[59] - REST[58])
    follower = Follower(make_bundle(rest), draw(rest))
    for seed in range(1, 4):
        seen = follower.follow(draw(rest, seed=seed))
        assert np.flatnonzero(~seen.found).tolist() == [58, 59]


def test_a_hidden_marker_is_lost_and_regained() -> None:
    follower = Follower(make_bundle(), draw(REST))
    places = press_and_slide(60, np.array([11.0, 9.0]))
    gone, furthest = (43, 44, 56), 0.0
    for k, place in enumerate(places):
        seen = follower.follow(draw(place, seed=k, hidden=gone if 10 <= k < 30 else ()))
        if 10 <= k < 30:
            assert np.flatnonzero(~seen.found).tolist() == list(gone)
            assert np.isnan(seen.shift_px[list(gone)]).all()
            # Their neighbours carry them along.
            camera = follower._cameras[0]
            carried = camera.place_px[np.isin(camera.ids, gone)]
            where = place[list(gone)]
            away = np.linalg.norm(carried[:, None] - where[None], axis=2).min(axis=1)
            furthest = max(furthest, float(away.max()))
        elif k < 10 or k >= 30 + 10:
            assert seen.found.all()
            assert np.abs(seen.position_px - place).max() < 0.5
    way = [places[k][list(gone)] - places[9][list(gone)] for k in range(10, 30)]
    assert furthest < 0.7 * float(np.linalg.norm(way, axis=2).max())


def test_a_lost_marker_is_searched_for_in_the_whole_frame() -> None:
    """Its window has come to lie between dots."""
    follower = Follower(make_bundle(), draw(REST))
    camera = follower._cameras[0]
    place = camera.place_px.copy()
    place[camera.ids.tolist().index(60)] += 0.5 * PITCH
    camera.place_px = place
    seen = [follower.follow(draw(REST, seed=k)) for k in range(10)]
    assert not seen[0].found[60]
    assert seen[-1].found.all()
    assert np.abs(seen[-1].position_px - REST).max() < 0.5


def test_a_marker_that_the_rest_frame_does_not_show_is_not_reported() -> None:
    follower = Follower(make_bundle(), draw(REST, hidden=(60,)))
    seen = follower.follow(draw(REST, seed=1))
    assert np.flatnonzero(~seen.found).tolist() == [60]


def test_a_marker_is_reported_only_beside_two_others() -> None:
    near = neighbours()[60]
    for hidden, lost in ((near[:6], []), (near[:7], [60])):
        follower = Follower(make_bundle(), draw(REST))
        seen = follower.follow(draw(REST, seed=1, hidden=tuple(hidden.tolist())))
        assert set(np.flatnonzero(~seen.found)) == {*hidden.tolist(), *lost}


def broken(kind: str, frame: ImageArray) -> ImageArray:
    if kind == "black":
        return np.zeros_like(frame)
    if kind == "torn":
        out = frame.copy()
        out[90:] = np.roll(frame, 9, axis=1)[90:]
        return out
    other = np.random.default_rng(3).permutation(COUNT)
    return draw(REST[other] + np.array([8.0, 11.0]))


@pytest.mark.parametrize("kind", ["black", "torn", "foreign"])
def test_broken_frames_are_rejected_and_change_nothing(kind: str) -> None:
    places = press_and_slide(60, np.array([6.0, 5.0]))
    follower, other = (Follower(make_bundle(), draw(REST)) for _ in range(2))
    for k, place in enumerate(places[:20]):
        frame = draw(place, seed=k)
        follower.follow(frame)
        other.follow(frame)
    with refused("frame-rejected"):
        follower.follow(broken(kind, frame))
    frame = draw(places[20], seed=20)
    after, without = follower.follow(frame), other.follow(frame)
    assert after.found.all()
    assert np.abs(after.shift_px - without.shift_px).max() < 0.01
    assert after.koi.tolist() == without.koi.tolist()


def test_a_moved_camera_is_found_again_by_a_full_search() -> None:
    follower = Follower(make_bundle(), draw(REST))
    moved = REST + np.array([7.0, 0.0])
    with refused("frame-rejected"):
        follower.follow(draw(REST + np.array([2.8, 0.0])))
    with refused("frame-rejected"):
        follower.follow(draw(moved))
    seen = follower.follow(draw(moved))
    assert seen.flags == ("the whole frame was searched",)
    assert rms(seen.position_px - moved) < 0.05
    assert "take a new rest frame" in " ".join(seen.warnings(make_bundle(), np.zeros(COUNT)))
    assert follower.follow(draw(moved, seed=2)).flags == ()


def test_a_steady_motion_is_foreseen() -> None:
    """Of 3 px a frame: without foresight all markers would have jumped."""
    follower, down = Follower(make_bundle(), draw(REST)), 0.0
    for k, step in enumerate((0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.0, 3.0)):
        down += step
        place = REST + np.array([0.0, down])
        seen = follower.follow(draw(place, seed=k))
        assert np.abs(seen.position_px - place)[:100].max() < 0.3


def test_dropped_frames_are_bridged() -> None:
    places = press_and_slide(100, np.array([9.0, 8.0]))
    follower = Follower(make_bundle(), draw(REST))
    k = 0
    for step in (1, 1, 2, 3, 1, 4, 2, 1, 1, 5, 3, 2) * 2:
        k += step
        seen = follower.follow(draw(places[k], seed=k), elapsed=step)
        assert seen.found.all()
        assert np.abs(seen.position_px - places[k]).max() < 0.5


def test_switches_have_hysteresis() -> None:
    follower = Follower(make_bundle(), draw(REST))
    bits = np.arange(COUNT) == 60

    def read(share: float, seed: int) -> object:
        radius = TIP_RADIUS * np.sqrt(share)
        return follower.follow(draw(REST, bits, seed=seed, tip_radius=radius)).koi.tolist()

    assert read(0.50, 1) == []
    assert read(0.80, 2) == [60]
    assert read(0.50, 3) == [60]
    assert read(0.25, 4) == []
    assert read(0.50, 5) == []


def test_switches_are_read_in_less_light() -> None:
    follower = Follower(make_bundle(), draw(REST))
    bits = np.arange(COUNT) == 60
    frame = draw(REST, bits, tip_radius=TIP_RADIUS * np.sqrt(0.7))
    for light in (1.0, 0.7):
        dim = np.rint(light * frame.astype(np.float64)).astype(np.uint8)
        assert follower.follow(dim).koi.tolist() == [60]
        assert follower.follow(draw(REST)).koi.tolist() == []


def test_tips_that_show_at_rest_show_the_light_on_red() -> None:
    """All of them a third larger are brighter paint; one of them, a switch that is on."""
    plain, every = make_bundle(), np.ones(COUNT, dtype=np.bool_)
    areas = {"red_rest_px": np.full(COUNT, 55.0), "red_on_px": np.full(COUNT, 80.0)}
    bundle = replace(plain, tips=replace(plain.tips, **areas))
    usual, large = np.sqrt(55.0 / np.pi), np.sqrt(73.0 / np.pi)
    follower = Follower(bundle, draw(REST, every, tip_radius=usual))
    assert follower.follow(draw(REST, every, tip_radius=large)).koi.tolist() == []
    one = draw(REST, every, tip_radius=usual)
    bits = np.arange(COUNT) == 60
    x, y = (REST[60] + TIP_OFF).astype(int)
    out = draw(REST, bits, tip_radius=5.4)
    one[y - 8 : y + 9, x - 8 : x + 9] = out[y - 8 : y + 9, x - 8 : x + 9]
    assert follower.follow(one).koi.tolist() == [60]


def test_tips_that_show_more_red_than_at_rest_and_less_than_out_are_named() -> None:
    plain, every = make_bundle(), np.ones(COUNT, dtype=np.bool_)
    areas = {"red_rest_px": np.full(COUNT, 30.0), "red_on_px": np.full(COUNT, 90.0)}
    bundle = replace(plain, tips=replace(plain.tips, **areas))
    rest = draw(REST, every, tip_radius=np.sqrt(30.0 / np.pi))
    lit, larger = rest.copy(), draw(REST, every, tip_radius=np.sqrt(48.0 / np.pi))
    for tip in (40, 60, 61):
        x, y = (REST[tip] + TIP_OFF).astype(int)
        lit[y - 7 : y + 8, x - 7 : x + 8] = larger[y - 7 : y + 8, x - 7 : x + 8]
    follower = Follower(bundle, rest)
    for image, named in ((rest, []), (lit, [40, 60, 61])):
        for seen in (follower.follow(image), measure_frame(bundle, image)):
            assert seen.koi.tolist() == []
            assert seen.half_out.tolist() == named
    # More of it turns a switch on: its tip shows less than one that is out.
    x, y = (REST[60] + TIP_OFF).astype(int)
    more = draw(REST, every, tip_radius=np.sqrt(68.0 / np.pi))
    lit[y - 7 : y + 8, x - 7 : x + 8] = more[y - 7 : y + 8, x - 7 : x + 8]
    for seen in (follower.follow(lit), measure_frame(bundle, lit)):
        assert seen.koi.tolist() == [60]
        assert seen.half_out.tolist() == [40, 60, 61]


def test_every_other_pixel_is_nearly_as_good() -> None:
    places = press_and_slide(15, np.array([4.0, 3.0]))
    whole, some = (Follower(make_bundle(), draw(REST), stride=stride) for stride in (1, 2))
    assert some.pixels < 0.75 * whole.pixels
    errors = [rms(followed_by(each, places)) for each in (whole, some)]
    assert errors[0] < 0.04 < errors[1] < 0.12


def test_two_cameras_are_followed_each_by_itself() -> None:
    one = make_bundle()
    far = REST[::-1] + np.array([1.0, 2.0])
    shown = tuple(
        CameraView(rest_px=rest, tips=replace(one.tips, on_px=rest + TIP_OFF))
        for rest in (REST, far)
    )
    read_by = (np.arange(COUNT) >= 60).astype(np.int64)
    own = read_by[:, None] == 1
    bundle = replace(one, cameras=one.cameras * 2, shown=shown, read_by=read_by,
                     rest_px=np.where(own, far, REST))  # fmt: skip
    follower = Follower(bundle, [draw(REST), draw(far)])
    place, lower = dent(np.array([100.0, 100.0]), np.array([1.0, 1.0])), far + np.array([0.0, 1.0])
    seen = follower.follow([draw(place, seed=1), draw(lower, seed=2)])
    assert rms(seen.position_px - np.where(own, lower, place)) < 0.05
    with refused("camera-count"):
        follower.follow(draw(place))


def test_wrong_input_is_rejected() -> None:
    bundle, rest = make_bundle(), draw(REST)
    with refused("stride-invalid"):
        Follower(bundle, rest, stride=3)
    with refused("markers-not-found"):
        Follower(bundle, np.zeros_like(rest))
    follower = Follower(bundle, rest)
    with refused("frame-size"):
        follower.follow(cv2.resize(rest, (160, 120)))
    assert follower.follow(rest).found.all()
