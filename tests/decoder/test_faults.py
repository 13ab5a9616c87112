"""Frames with faults give warnings; sound ones give none."""

from collections.abc import Callable
from dataclasses import replace
from unittest import mock

import cv2
import numpy as np
import pytest

from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame
from phytac_decoder.pipeline.fault_detection import FaultDetector
from phytac_decoder.pipeline.frame_reading import read as read_frame
from phytac_decoder.vision.matching import fill_from_neighbours, match_markers
from phytac_decoder.vision.segmentation import Blobs
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.discs import disc_overlap_share
from tests.decoder import flat_sensor
from tests.decoder.test_camera_motion import motion as camera_table
from tests.decoder.test_camera_motion import true_shift
from tests.decoder.test_follow import BGR, COLOUR, COUNT, OFF, PITCH, REST, TIP_OFF, disc, draw
from tests.decoder.test_follow import make_bundle as drawn_bundle

PX_N = 0.33
NOISE_px = 0.04
PRESSED_TEXT = "moved as if pressed, and their switches do not read as on"


def make_bundle() -> Bundle:
    """Markers that move down under a force on them, and less the farther from it."""
    base = drawn_bundle()
    gap = np.linalg.norm(REST[:, None] - REST[None], axis=2) / PITCH
    push = PX_N * np.exp(-(gap**2))
    compliance = np.zeros((2 * COUNT, COUNT))
    compliance[0::2], compliance[1::2] = 0.4 * push, push
    return replace(
        base,
        model=replace(base.model, compliance_px=compliance),
        tip_bias_px=np.zeros((COUNT, 2)),
    )


BUNDLE = make_bundle()


def motion(forces: dict[int, float]) -> FloatArray:
    each = np.zeros(COUNT)
    each[list(forces)] = list(forces.values())
    return np.asarray((BUNDLE.model.compliance_px @ each).reshape(-1, 2))


def read(forces: dict[int, float], koi: tuple[int, ...], *, seed: int = 0) -> FrameMeasurement:
    shift = motion(forces) + np.random.default_rng(seed).normal(0.0, NOISE_px, (COUNT, 2))
    return FrameMeasurement(koi=np.array(koi, dtype=np.int64), shift_px=shift, found=~OFF)


def warnings_of(measured: FrameMeasurement) -> list[str]:
    forces = measured.forces_N(BUNDLE, "koi_inverse")
    return measured.warnings(BUNDLE, forces, estimator="koi_inverse")


PRESSES = {
    "none": ({}, ()),
    "light": ({58: 0.8}, (58,)),
    "strong": ({58: 25.0}, (58,)),
    "several": ({30: 3.0, 84: 20.0, 87: 9.0}, (30, 84, 87)),
    "side by side": ({58: 9.0, 59: 6.0, 71: 4.0}, (58, 59, 71)),
    # A contact that lies between: the neighbour carries part of it, too little to switch.
    "half beside": ({58: 20.0, 59: 5.0}, (58,)),
}


@pytest.mark.parametrize("press", PRESSES)
def test_sound_frames_are_free_of_warnings(press: str) -> None:
    forces, koi = PRESSES[press]
    for seed in range(20):
        assert warnings_of(read(forces, koi, seed=seed)) == []


def test_softening_is_not_taken_for_a_fault() -> None:
    """A dent that is a third deeper and narrower than linear theory has it."""
    for marker in (16, 58, 100):
        soft = motion({marker: 25.0})
        soft *= 1.0 + 0.33 * np.linalg.norm(soft, axis=1, keepdims=True) / (PX_N * 27.0)
        measured = replace(read({}, (marker,)), shift_px=soft)
        assert warnings_of(measured) == []


def test_a_dead_switch_is_told_of() -> None:
    (text,) = warnings_of(read({30: 6.0, 84: 20.0}, (84,)))
    assert PRESSED_TEXT in text
    assert "30" in text
    (alone,) = warnings_of(read({58: 4.0}, ()))
    assert PRESSED_TEXT in alone
    assert "58" in alone
    # Beside one that is on, too, if it carries most of the force.
    (beside,) = warnings_of(read({58: 5.0, 59: 15.0}, (58,)))
    assert PRESSED_TEXT in beside
    assert "(59)" in beside


def test_a_light_press_between_switches_is_no_alarm() -> None:
    assert warnings_of(read({30: 1.0, 84: 20.0}, (84,))) == []


def test_a_stuck_switch_is_told_of() -> None:
    (text,) = warnings_of(read({84: 20.0}, (30, 84)))
    assert "1 switched receptors (30) show no force" in text
    (alone,) = warnings_of(read({}, (30,)))
    assert "(30) show no force" in alone
    # Red in the middle of a real contact does no harm: its force is the contact's.
    assert warnings_of(read({58: 12.0}, (58, 59))) == []


def test_a_stuck_switch_does_not_live_on_others_force() -> None:
    """The inverse gives it force that is pressed beside another switch: that one's neighbours may
    carry some."""
    measured = read({84: 20.0, 83: 20.0}, (81, 84))
    forces = measured.forces_N(BUNDLE, "koi_inverse")
    assert forces[81] > BUNDLE.threshold_N[81]
    found = FaultDetector(BUNDLE, measured.shift_px, measured.koi)
    assert found.switches_without_force(forces).tolist() == [81]


def explained(
    forces: dict[int, float], koi: tuple[int, ...], bundle: Bundle = BUNDLE
) -> FaultDetector:
    return FaultDetector(bundle, motion(forces), np.array(koi, dtype=np.int64))


def test_a_switch_that_is_about_to_let_go_is_not_stuck() -> None:
    threshold = BUNDLE.threshold_N[84]
    for share, weak in ((0.8, []), (0.5, [84])):
        held = explained({84: share * threshold}, (84,))
        assert held.switches_without_force(held.forces_on(np.arange(COUNT))).tolist() == weak


def test_a_force_that_markers_hardly_show_is_no_stuck_switch() -> None:
    """Beside a rim markers show 1.7 N as 0 ± 1.5 N."""
    for share, weak in ((1.0, [30]), (0.05, [])):
        faint = BUNDLE.model.compliance_px.copy()
        faint[:, 30] *= share
        bundle = replace(BUNDLE, model=replace(BUNDLE.model, compliance_px=faint))
        held = FaultDetector(bundle, motion({}), np.array([30]))
        assert held.switches_without_force(np.eye(COUNT)[30] * 1.67).tolist() == weak
        # Where the estimator gives it no force either, it is reported.
        assert held.switches_without_force(np.zeros(COUNT)).tolist() == [30]


def test_a_strong_group_is_not_asked_about() -> None:
    """It is solved for with its neighbours only where its force is small."""
    for force, asked in ((6.0, False), (1.0, True)):
        held = explained({84: force}, (84,))
        with mock.patch.object(FaultDetector, "forces_on", wraps=held.forces_on) as solved:
            assert held.switches_without_force(motion({84: force})[:, 1] / PX_N).size == 0
        assert solved.called is asked


def test_the_more_force_the_more_motion_may_be_unexplained() -> None:
    """Models err by a share of the force."""
    for beside, told_of in ((1.0, True), (25.0, False)):
        pressed, _ = explained({30: 5.0, 84: beside, 108: beside}, (84, 108)).unexplained()
        assert (30 in pressed.tolist()) is told_of


def test_what_noise_can_make_is_no_press() -> None:
    loud = replace(BUNDLE, noise_centroid_px=1.0)
    for bundle, told_of in ((BUNDLE, True), (loud, False)):
        pressed, _ = explained({30: 5.0, 84: 1.0}, (84,), bundle).unexplained()
        assert (30 in pressed.tolist()) is told_of


def test_forces_that_cannot_be_read_are_not_told_of() -> None:
    """Where a force hardly moves its marker: what moves it is something else."""
    faint = BUNDLE.model.compliance_px.copy()
    faint[:, 30] *= 0.006 / np.linalg.norm(faint[:, 30])
    bundle = replace(BUNDLE, model=replace(BUNDLE.model, compliance_px=faint))
    assert not bundle.force_readable[30]
    shift = (50.0 * faint[:, 30]).reshape(-1, 2)
    assert FaultDetector(bundle, shift, np.array([], dtype=np.int64)).unexplained()[0].size == 0


def test_a_blind_switch_beside_a_strong_press_may_be_off_by_a_share() -> None:
    red = BUNDLE.tips.red_rest_px.copy()
    red[59] = BUNDLE.tips.red_on_px[59]
    bundle = replace(BUNDLE, tips=replace(BUNDLE.tips, red_rest_px=red))
    for share, told_of in ((1.33, False), (2.0, True)):
        shift = motion({58: 25.0})
        shift[59] *= share
        pressed, _ = FaultDetector(bundle, shift, np.array([58])).unexplained()
        assert (59 in pressed.tolist()) is told_of


def test_faults_are_detected_for_any_estimator() -> None:
    measured = read({84: 4.0}, (84,))
    found = FaultDetector(BUNDLE, measured.shift_px, measured.koi)
    assert found.switches_without_force(measured.forces_N(BUNDLE, "koi_inverse")).tolist() == []
    assert found.switches_without_force(np.zeros(COUNT)).tolist() == [84]


def test_an_outlier_marker_is_reported() -> None:
    measured = read({84: 10.0}, (84,))
    shift = measured.shift_px.copy()
    shift[20] += (-1.5, 0.0)
    (text,) = warnings_of(replace(measured, shift_px=shift))
    assert "1 markers (20) are where no force" in text
    # Missing ones are no reason, wherever they are.
    shift[[20, 84, 85]] = np.nan
    assert warnings_of(replace(measured, shift_px=shift)) == []


def test_a_camera_that_has_moved_is_the_only_reason() -> None:
    measured = read({84: 10.0}, (84,))
    (text,) = warnings_of(replace(measured, shift_px=measured.shift_px + np.array([2.0, 0.0])))
    assert "take a new rest frame" in text


def test_faults_at_unreadable_switches_are_detected_beside_others() -> None:
    red = BUNDLE.tips.red_rest_px.copy()
    red[59] = BUNDLE.tips.red_on_px[59]
    bundle = replace(BUNDLE, tips=replace(BUNDLE.tips, red_rest_px=red))
    measured = read({58: 10.0, 59: 6.0}, (58,))
    assert warnings_of(measured) == []
    forces = measured.forces_N(bundle, "koi_inverse")
    (text,) = measured.warnings(bundle, forces, estimator="koi_inverse")
    assert "(59) moved as if pressed" in text


FORCES = {45: 9.0, 70: 6.0}
BITS = np.isin(np.arange(COUNT), list(FORCES))


def shot(bits: BoolArray = BITS, *, hidden: tuple[int, ...] = ()) -> ImageArray:
    return draw(REST + motion(FORCES), bits, seed=4, hidden=hidden)


def bridged(frame: ImageArray) -> ImageArray:
    """A thin bridge that leaves the tip below it free."""
    out = frame.copy()
    ends = np.rint((REST + motion(FORCES))[[45, 46]]).astype(int).tolist()
    cv2.line(out, ends[0], ends[1], BGR[COLOUR[45]].tolist(), 2)
    return out


def with_red(frame: ImageArray) -> ImageArray:
    out = frame.astype(np.float64)
    disc(out, REST[100] + motion(FORCES)[100] + TIP_OFF, 3.0, BGR[2])
    return np.rint(out).astype(np.uint8)


FAULTS: dict[str, tuple[Callable[[], ImageArray], str]] = {
    "hidden": (lambda: shot(hidden=tuple(range(0, COUNT, 5))), "of 117 markers were found"),
    "fused": (lambda: bridged(shot()), "the paint of 2 markers (45, 46) is one"),
    "dead": (lambda: shot(np.arange(COUNT) == 70), PRESSED_TEXT),
    "stuck": (lambda: with_red(shot()), "(100) show no force"),
    "bumped": (lambda: np.roll(shot(), 3, axis=1), "take a new rest frame"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_in_frames_are_told_of(fault: str) -> None:
    make, words = FAULTS[fault]
    assert warnings_of(measure_frame(BUNDLE, shot())) == []
    assert words in " ".join(warnings_of(measure_frame(BUNDLE, make())))


def test_markers_run_into_one_do_not_pull_forces() -> None:
    """The bridge would move the one marker by half a pitch: it is left out instead."""
    seen = measure_frame(BUNDLE, bridged(shot()))
    assert seen.merged.tolist() == [45, 46]
    assert np.flatnonzero(~seen.found).tolist() == [45, 46]
    assert np.isnan(seen.shift_px[[45, 46]]).all()
    forces = seen.forces_N(BUNDLE, "koi_inverse")
    assert abs(forces[45] - FORCES[45]) < 0.5


def test_motion_of_what_is_not_seen_is_its_neighbours() -> None:
    near = np.array([[1, 2, -1], [0, 2, -1], [0, 1, 3], [-1, -1, -1]])
    moved = np.array([[1.0, 4.0], [np.nan, np.nan], [3.0, 8.0], [np.nan, np.nan]])
    expected = [[1.0, 4.0], [2.0, 6.0], [3.0, 8.0], [0.0, 0.0]]
    assert fill_from_neighbours(moved, near).tolist() == expected


def test_a_lost_marker_within_the_box_of_another_colour_is_only_lost() -> None:
    rest = np.array([[20.0, 20.0], [26.0, 26.0], [60.0, 20.0]])
    blobs = Blobs(
        colour=np.array([0, 1]),
        centroid_px=rest[[0, 2]],
        area_px=np.array([80, 80]),
        weight=np.array([80.0, 80.0]),
        box_px=np.array([[10, 10, 30, 30], [50, 10, 70, 30]]),
    )
    nobody = np.full((3, 8), -1)
    for colour, merged in ((1, []), (0, [0, 1])):
        seen = match_markers(
            blobs, rest_px=rest, colour=np.array([0, colour, 1]), neighbours=nobody
        )
        assert seen.found.tolist() == [True, False, True]
        assert np.flatnonzero(seen.merged).tolist() == merged


def test_hidden_markers_are_not_run_into_others() -> None:
    seen = measure_frame(BUNDLE, shot(hidden=(20, 64)))
    assert np.flatnonzero(~seen.found).tolist() == [20, 64]
    assert seen.merged.tolist() == []


def test_tips_of_hidden_markers_are_looked_for_where_their_neighbours_went() -> None:
    place = REST + np.array([0.0, 11.0])
    frame = draw(place, BITS, seed=5, hidden=(45, 70))
    image = frame.astype(np.float64)
    for marker in (45, 70):
        disc(image, place[marker] + TIP_OFF, 3.0, BGR[2])
    seen = measure_frame(BUNDLE, np.rint(image).astype(np.uint8))
    assert np.flatnonzero(~seen.found).tolist() == [45, 70]
    assert seen.koi.tolist() == [45, 70]


def test_markers_that_are_not_seen_give_no_warning() -> None:
    measured = read({58: 20.0}, (58,))
    shift = measured.shift_px.copy()
    shift[[44, 45, 46, 57, 59, 70, 71, 72]] = np.nan
    assert warnings_of(replace(measured, shift_px=shift)) == []
    as_if_still = FaultDetector(BUNDLE, np.nan_to_num(shift), measured.koi)
    assert any(len(markers) for markers in as_if_still.unexplained())


def flat_bundle(*, noise_px: float = 0.02) -> Bundle:
    """A decoder with tables of large displacement, of a sensor in closed form."""
    base, places = drawn_bundle(), flat_sensor.MARKERS
    count = len(places)
    red = TipModel(
        on_px=np.zeros((count, 2)), red_rest_px=np.zeros(count), red_on_px=np.full(count, 40.0)
    )
    model = replace(
        base.model,
        compliance_px=np.stack([flat_sensor.per_newton(place) for place in places], axis=1),
        neighbours=flat_sensor.neighbours(),
        locator=flat_sensor.flat_locator(noise_px=noise_px),
        camera_motion=None,
    )
    return replace(
        base,
        position_mm=places,
        threshold_N=np.full(count, 0.5),
        noise_centroid_px=0.02,
        tips=red,
        model=model,
    )


def suspects(
    bundle: Bundle, shift: FloatArray, at: FloatArray, *, noise_px: float = 0.02
) -> list[int]:
    """Markers that seem pressed where the switch nearest to a contact is on."""
    noise = np.random.default_rng(6).normal(0.0, noise_px, shift.shape)
    koi = np.array([flat_sensor.nearest(at)])
    pressed, _ = FaultDetector(bundle, (shift + noise).reshape(-1, 2), koi).unexplained()
    return pressed.tolist()


AT = np.array([28.2, 29.6, 0.0])
WIDE = np.array([3.4, -1.3, 4.6])


def test_what_tables_of_large_displacement_explain_is_no_fault() -> None:
    bundle = flat_bundle()
    plain = replace(bundle, model=replace(bundle.model, locator=None))
    press = flat_sensor.shifts(AT, 22.0, WIDE)
    assert suspects(plain, press, AT) == [45]
    assert suspects(bundle, press, AT) == []
    # Not where more is left than noise.
    assert suspects(bundle, press, AT, noise_px=0.025) == [45]
    # Nor a frame with a dead switch besides.
    dead = flat_sensor.shifts(np.array([9.0, 9.0, 0.0]), 6.0)
    assert 11 in suspects(bundle, press + dead, AT)


def test_motion_of_the_camera_is_no_residual_of_the_contacts() -> None:
    """The shifts are without it, the contacts that ``auto`` found in the frame explain it."""
    bundle, koi = flat_bundle(), np.array([flat_sensor.nearest(AT)])
    table = camera_table()
    model = replace(
        bundle.model,
        locator=replace(bundle.model.locator, camera_motion=table),
        camera_motion=table,
    )
    bundle = replace(bundle, model=model)
    noise = np.random.default_rng(6).normal(0.0, 0.02, 2 * len(flat_sensor.MARKERS))
    seen = flat_sensor.shifts(AT, 22.0, WIDE) + noise + true_shift([-0.25, 0, 0, 0, 0, 0, 0])
    found = model.contacts(seen.reshape(-1, 2), koi)
    still = model.without_motion(seen.reshape(-1, 2), found.motion)
    detector = FaultDetector(bundle, still, koi, found)
    one, limit_N = np.array([45]), np.array([0.1])
    assert detector._explained_by_contacts(one, limit_N)
    moved = replace(found, shift_px=found.shift_px - table.shift_px(found.motion))
    assert not FaultDetector(bundle, still, koi, moved)._explained_by_contacts(one, limit_N)


def test_a_press_in_what_tables_leave_is_not_excused() -> None:
    """Presumed noise so high that the fit seems good."""
    light = flat_sensor.shifts(np.array([3.0, 3.0, 0.0]), 3.5)
    assert suspects(flat_bundle(noise_px=1.0), flat_sensor.shifts(AT, 5.0) + light, AT) == [0]


def test_a_contact_without_a_switch_excuses_nobody() -> None:
    """It explains the motion, and its force is on no receptor all the same."""
    light = flat_sensor.shifts(np.array([45.0, 45.0, 0.0]), 3.2)
    bundle, both = flat_bundle(), flat_sensor.shifts(AT, 5.0) + light
    found = bundle.model.contacts(both.reshape(-1, 2), np.array([flat_sensor.nearest(AT)]))
    assert [len(contact.markers) for contact in found.contacts] == [1, 0]
    assert suspects(bundle, both, AT) == [55, 77]


def test_tables_are_not_asked_about_many_markers() -> None:
    """That takes milliseconds, and a dead switch would take them in every frame."""
    dead = flat_sensor.shifts(np.array([9.0, 9.0, 0.0]), 20.0)
    with mock.patch.object(ForceModel, "contacts") as asked:
        found = suspects(flat_bundle(), flat_sensor.shifts(AT, 5.0) + dead, AT)
        alone = FaultDetector(flat_bundle(), dead.reshape(-1, 2), np.zeros(0, dtype=np.int64))
        assert len(alone.unexplained()[0]) > 2
    assert len(found) > 2
    assert not asked.called


RADIUS_MM = 9.0
PLACES = [np.array([x, y, 0.0]) for x in (16.0, 44.0) for y in (16.0, 44.0)]


def tripped(forces_N: dict[int, float]) -> IntArray:
    """Switches (m,) that discs of ``RADIUS_MM`` at some of ``PLACES`` turn on, by geometry."""
    carried = np.zeros(len(flat_sensor.MARKERS))
    for place, force_N in forces_N.items():
        gap_mm = np.linalg.norm(flat_sensor.MARKERS - PLACES[place], axis=1)
        carried += force_N * disc_overlap_share(gap_mm, RADIUS_MM, 2.3)
    return np.flatnonzero(carried > 0.5)


def wide_frame(forces_N: dict[int, float], koi: IntArray) -> FrameMeasurement:
    """What a frame shows under those discs where ``koi`` read as on."""
    moments = np.array([1.0, 0.0, 1.0]) * RADIUS_MM**2 / 4.0
    shift = np.sum(
        [flat_sensor.shifts(PLACES[k], force, moments) for k, force in forces_N.items()], axis=0
    )
    noise = np.random.default_rng(3).normal(0.0, 0.02, shift.shape)
    found = np.ones(len(flat_sensor.MARKERS), dtype=np.bool_)
    return FrameMeasurement(koi=koi, shift_px=(shift + noise).reshape(-1, 2), found=found)


def about_many(bundle: Bundle, measured: FrameMeasurement, estimator: str) -> list[str]:
    """Warnings about the number of switches that are on."""
    return [text for text in read_frame(bundle, measured, estimator).warnings if " of 100" in text]


FOUR = dict.fromkeys(range(4), 22.0)


@pytest.mark.parametrize("estimator", ["auto", "koi_inverse"])
def test_wide_contacts_may_turn_on_many_switches(estimator: str) -> None:
    """A third of all, which few narrow contacts never do."""
    koi = tripped(FOUR)
    assert len(koi) > 0.3 * len(flat_sensor.MARKERS)
    assert about_many(flat_bundle(), wide_frame(FOUR, koi), estimator) == []


@pytest.mark.parametrize("estimator", ["auto", "koi_inverse"])
def test_switches_that_no_contact_reaches_are_told_of(estimator: str) -> None:
    """Red light: a patch of switches, or scattered ones, read as on beside a real contact."""
    bundle, one = flat_bundle(), {0: 10.0}
    scattered = np.random.default_rng(0).choice(len(flat_sensor.MARKERS), 35, replace=False)
    for false in (np.arange(60, 100), scattered):
        koi = np.union1d(tripped(one), false)
        (text,) = about_many(bundle, wide_frame(one, koi), estimator)
        assert text.startswith(f"{len(koi)} of 100 switches read as on, and no contact reaches")
        beyond = int(text.split("reaches ")[1].split()[0])
        assert 0.6 * len(false) < beyond <= len(false)
    every = np.arange(len(flat_sensor.MARKERS))
    (text,) = about_many(bundle, wide_frame(FOUR, every), estimator)
    assert "100 of 100 switches read as on, more than contacts turn on" in text


def test_without_tables_many_switches_are_doubtful() -> None:
    bundle = flat_bundle()
    older = replace(bundle, model=replace(bundle.model, locator=None))
    (text,) = about_many(older, wide_frame(FOUR, tripped(FOUR)), "koi_inverse")
    assert "check for red light" in text
