"""A camera that creeps is followed while nothing is pressed; no press is taken for its motion."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from phytac_decoder.camera.camera_motion import MARKED
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.drift import DriftReference, DriftSettings
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.sensor_loop import follow_decoder, frame_decoder
from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.cli import live_command, serve_command
from phytac_design.cli.live_command import live
from phytac_design.cli.serve_command import serve
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError
from tests.decoder.flat_sensor import MARKERS, flat_locator, nearest, neighbours, per_newton, shifts
from tests.decoder.test_camera_motion import CAMERA, NOISE_PX, motion, true_shift
from tests.decoder.toy_sensor import toy_bundle, toy_frame, toy_recording
from tests.refusals import refused

COUNT = len(MARKERS)
AT = np.array([21.0, 34.0, 0.0])
STEP_S = 5.0
SLOW: FloatArray = np.array([0.02, 0.01, -0.01, 2e-4, 3.5e-4, 0.0, 0.0]) / 60.0
"""Motion in a second, about 0.02 mm and 0.02° in a minute."""
FREE = replace(DriftSettings(), chi2_max=np.inf, pull_max=np.inf)
"""Follows whatever is seen in frames without switches."""


def flat_bundle() -> Bundle:
    camera = motion()
    model = ForceModel(
        shift_to_mm=np.tile([0.1, 0.0], (COUNT, 1)),
        stiffness=np.eye(COUNT),
        compliance_px=np.stack([per_newton(at) for at in MARKERS], axis=1),
        height_z_mm=np.zeros(COUNT),
        neighbours=neighbours(),
        networks={},
        locator=replace(flat_locator(noise_px=NOISE_PX), camera_motion=camera),
        camera_motion=camera,
        noise_px=NOISE_PX,
    )
    rest = CAMERA.project(MARKERS)
    return replace(
        toy_bundle(),
        cameras=(CAMERA,),
        read_by=np.zeros(COUNT, dtype=np.int64),
        colour=np.zeros(COUNT, dtype=np.int64),
        position_mm=MARKERS,
        head_mm=MARKERS,
        rest_px=rest,
        tip_bias_px=np.zeros((COUNT, 2)),
        tips=TipModel(on_px=rest, red_rest_px=np.zeros(COUNT), red_on_px=np.full(COUNT, 12.0)),
        model=model,
        threshold_N=np.full(COUNT, 0.5),
        noise_centroid_px=NOISE_PX / 1.4,
    )


class Film:
    """A camera that moves by ``rate`` (7,) a second while frames are decoded."""

    def __init__(self, rate: FloatArray = SLOW, settings: DriftSettings | None = None) -> None:
        self.rng, self.time_s, self.rate = np.random.default_rng(4), 0.0, rate
        self.reference, self.noise_px = DriftReference(flat_bundle(), settings), NOISE_PX

    def shot(
        self, force_N: float = 0.0, *, estimator: str = "auto", on: bool | None = None
    ) -> Reading:
        """Decode the next frame, of a press of so many newtons; its switch is on from 0.5 N."""
        shift = true_shift((self.time_s * self.rate).tolist())
        shift = shift + shifts(AT, force_N) + self.noise_px * self.rng.normal(size=2 * COUNT)
        koi = [nearest(AT)] if (force_N >= 0.5 if on is None else on) else []
        measured = FrameMeasurement(
            koi=np.array(koi, dtype=np.int64),
            shift_px=shift.reshape(-1, 2),
            found=np.ones(COUNT, dtype=np.bool_),
        )
        reading = self.reference.read(measured, estimator, self.time_s)
        self.time_s += STEP_S
        return reading

    def wait(self, minutes: float, force_N: float = 0.0, estimator: str = "auto") -> Reading:
        for _ in range(round(60.0 * minutes / STEP_S) - 1):
            self.shot(force_N, estimator=estimator)
        return self.shot(force_N, estimator=estimator)


def error_N(reading: Reading, force_N: float) -> float:
    assert reading.found is not None
    (contact,) = reading.found.contacts
    return abs(contact.raw_N - force_N) / contact.raw_sd_N


@pytest.mark.parametrize("estimator", ["auto", "koi_inverse"])
def test_a_camera_that_creeps_is_followed(estimator: str) -> None:
    film = Film()
    assert film.wait(30.0, estimator=estimator).valid
    pressed = film.shot(8.0, estimator=estimator)
    assert pressed.valid
    if estimator == "auto":
        assert error_N(pressed, 8.0) < 3.0
    else:
        assert pressed.forces_N.sum() == pytest.approx(8.0, rel=0.1)
    # 0.6 mm in all, less the lag of a minute and what markers do not show.
    assert film.reference.motion[0] == pytest.approx(0.58, abs=0.03)
    still = Film(settings=DriftSettings(time_constant_s=np.inf))
    assert still.wait(30.0, estimator=estimator).code == "rest-frame-outdated"
    assert not still.reference.motion.any()


@pytest.mark.parametrize("settings", [None, FREE])
def test_a_press_that_is_held_for_minutes_stays(settings: DriftSettings | None) -> None:
    film = Film(settings=settings)
    film.wait(10.0)
    before = film.reference.motion.copy()
    for minutes in (0.1, 1.0, 5.0):
        assert error_N(film.wait(minutes, 8.0), 8.0) < 3.0
    assert (film.reference.motion == before).all()


def test_a_press_that_grows_slowly_below_its_switch_is_not_absorbed() -> None:
    """The press first hides in the noise; then it stops the reference until it has gone."""
    film, free = (Film(np.zeros(7), settings) for settings in (None, FREE))
    for each in (film, free):
        each.wait(5.0)
        for force in np.linspace(0.0, 0.45, 120):
            each.shot(force)
        each.wait(10.0, 0.45)
    taken_px, free_px = (
        np.abs(motion().shift_px(each.reference.motion)).max() for each in (film, free)
    )
    # Of a press that moves its marker by 0.2 px.
    assert taken_px < 0.5 * NOISE_PX < free_px
    assert error_N(film.wait(0.1, 8.0), 8.0) < 3.0


def test_a_dead_switch_stops_the_reference() -> None:
    film = Film(np.zeros(7))
    film.wait(2.0)
    before = film.reference.motion.copy()
    for _ in range(20):
        film.shot(6.0, on=False)
    assert (film.reference.motion == before).all()


@pytest.mark.parametrize(("noises", "follows"), [(1.0, True), (1.5, False)])
def test_a_frame_that_is_noisier_than_expected_is_not_followed(
    noises: float, follows: bool
) -> None:
    film = Film(settings=replace(DriftSettings(), pull_max=np.inf))
    film.noise_px = noises * NOISE_PX
    film.wait(3.0)
    assert film.reference.motion.any() == follows


def test_the_reference_ends_where_its_tables_do() -> None:
    film = Film(np.array([0.2 / 60.0, 0, 0, 0, 0, 0, 0]))
    for _ in range(20):
        film.wait(0.5)
    assert film.reference.motion[0] == MARKED.shift_mm
    assert film.shot().code == "rest-frame-outdated"


@pytest.mark.parametrize("follow", [False, True])
def test_frames_are_decoded_relative_to_the_reference(follow: bool) -> None:
    bundle, frame = toy_bundle().with_mount("handheld"), toy_frame()
    reference = DriftReference(bundle, FREE)
    decode = (
        follow_decoder(bundle, [frame], drift=reference)
        if follow
        else frame_decoder(bundle, drift=reference)
    )
    aside = np.roll(frame, 1, axis=1)
    for number, image in enumerate([frame, *[aside] * 10]):
        time_s = 60.0 * number
        decode(Frame(number=number, timestamp_s=time_s, images=(image,), ready_s=0.0))
    assert bundle.model.camera_motion is not None
    moved = bundle.model.camera_motion.shift_px(reference.motion).reshape(-1, 2)
    np.testing.assert_allclose(moved, np.tile([1.0, 0.0], (len(moved), 1)), atol=0.3)


@pytest.mark.parametrize(("command", "module"), [(serve, serve_command), (live, live_command)])
@pytest.mark.parametrize("drift", [True, False])
def test_the_commands_follow_unless_it_is_switched_off(
    command: Callable[..., None], module: ModuleType, drift: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*_: object, **options: object) -> None:
        assert options["drift"] is drift
        raise InputError("seen", "the option has arrived")

    monkeypatch.setattr(module, "open_session", opened)
    with refused("seen"):
        command(Path("decoder"), ["0"], **({} if drift else {"drift": False}))


@pytest.mark.parametrize("follow", [True, False])
@pytest.mark.parametrize("drift", [True, False])
def test_a_session_follows_if_asked_to(
    drift: bool, follow: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoder, frames = toy_recording(tmp_path, [{}, {}])
    times: list[float] = []
    whole = DriftReference.read

    def noted(self: DriftReference, *words: Any, **more: Any) -> Reading:
        times.append(words[2])
        return whole(self, *words, **more)

    monkeypatch.setattr(DriftReference, "read", noted)
    with contextlib.ExitStack() as stack:
        options: dict[str, Any] = {"regions": None, "design": None, "report": print, "pace": False}
        where = (decoder, [str(frames)], None, [frames / "frame_0.png"], 0)
        session = serve_command.open_session(stack, *where, follow=follow, drift=drift, **options)
        for frame in session.source:
            session.decode(frame)
    assert len(times) == (2 if drift else 0)


def test_time_that_goes_back_moves_nothing() -> None:
    """A recording that begins again."""
    film = Film()
    film.wait(2.0)
    before, film.time_s = film.reference.motion.copy(), 0.0
    film.shot()
    assert (film.reference.motion == before).all()
