"""Frames that are partly the one before: texts of by what noise always changes."""

import numpy as np
import pytest

from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.torn_frames import (
    TornFrameDetector,
    with_torn_frame_check,
)
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError
from tests.refusals import refused

HEIGHT, WIDTH = 96, 128


def noisy(seed: int, *, dark: slice | None = None) -> ImageArray:
    """A grey picture with a sensor's noise; some rows black and without any."""
    rng = np.random.default_rng(seed)
    image = np.clip(rng.normal(120.0, 2.0, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
    if dark:
        image[dark] = 0
    return image


def warmed(dark: slice | None = None) -> tuple[TornFrameDetector, ImageArray]:
    """One who has seen enough frames, and the last of them."""
    tears = TornFrameDetector()
    for seed in range(TornFrameDetector.frames_changed_min + 1):
        assert tears.check([noisy(seed, dark=dark)]) == []
    return tears, noisy(TornFrameDetector.frames_changed_min, dark=dark)


def torn(seed: int, old: ImageArray, part: slice) -> ImageArray:
    image = noisy(seed)
    image[part] = old[part]
    return image


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (slice(48, None), "the lower 50 % of the frame"),
        (slice(0, 24), "the upper 25 % of the frame"),
        (slice(0, None), "the frame is the one before to the last bit"),
    ],
)
def test_old_rows_give_a_warning(part: slice, words: str) -> None:
    tears, last = warmed()
    (text,) = tears.check([torn(9, last, part)])
    assert text.startswith(words)
    # The next whole frame is sound again.
    assert tears.check([noisy(10)]) == []


def test_a_cut_through_a_row_is_a_tear_as_well() -> None:
    tears, last = warmed()
    image = torn(9, last, slice(48, None))
    image[47, WIDTH // 10 :] = last[47, WIDTH // 10 :]
    assert "torn" in tears.check([image])[0]


def test_rows_without_noise_are_not_evaluated() -> None:
    """Black borders, drawn pictures, and a first frame."""
    tears, last = warmed(dark=slice(0, 40))
    lower = torn(9, last, slice(70, None))
    lower[:40] = 0
    assert "the lower" in tears.check([lower])[0]
    drawn, flat = TornFrameDetector(), np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8)
    moved = flat.copy()
    moved[60:80, 20:100] = 200
    for image in (flat, flat, moved, flat, flat):
        assert drawn.check([image]) == []


def test_rows_that_are_old_here_and_there_are_no_tear() -> None:
    """As compressed videos leave blocks alone that hardly change."""
    tears, last = warmed()
    image = torn(9, last, slice(20, 30))
    image[60:70] = last[60:70]
    assert tears.check([image]) == []


def test_each_camera_is_checked_and_a_new_size_restarts() -> None:
    tears = TornFrameDetector()
    for seed in range(TornFrameDetector.frames_changed_min + 1):
        assert tears.check([noisy(seed), noisy(50 + seed)]) == []
    (text,) = tears.check(
        [noisy(9), torn(60, noisy(50 + TornFrameDetector.frames_changed_min), slice(0, 48))]
    )
    assert "upper" in text
    small = noisy(9)[:50, :60]
    assert tears.check([small, small]) == []
    assert tears.check([small, small]) == []


def test_a_camera_that_uses_its_buffer_again_is_seen_through() -> None:
    tears, buffer = TornFrameDetector(), noisy(0)
    for seed in range(TornFrameDetector.frames_changed_min + 1):
        buffer[:] = noisy(seed)
        assert tears.check([buffer]) == []
    # And for as long as it stands still.
    for _ in range(5):
        assert "stopped" in tears.check([buffer])[0]


def test_a_single_change_is_no_noise() -> None:
    """A press that is drawn without noise changes rows, and they stand still after it."""
    tears = TornFrameDetector()
    for number in range(TornFrameDetector.frames_changed_min):
        assert tears.check([noisy(number)]) == []
    assert tears.check([noisy(TornFrameDetector.frames_changed_min - 1)]) == []
    # Rows that stood still start again: noise does not pause.
    for number in range(1, TornFrameDetector.frames_changed_min):
        assert tears.check([noisy(10 * number)]) == []
    assert tears.check([noisy(10 * (TornFrameDetector.frames_changed_min - 1))]) == []


def test_only_the_band_is_read_of_wide_pictures() -> None:
    wide = np.zeros((40, 4 * TornFrameDetector.band_px, 3), dtype=np.uint8)
    tears = TornFrameDetector()
    rng = np.random.default_rng(0)
    for _ in range(TornFrameDetector.frames_changed_min + 1):
        wide[:, 3 * TornFrameDetector.band_px // 4 : 7 * TornFrameDetector.band_px // 4] = (
            rng.integers(0, 99, (40, TornFrameDetector.band_px, 3))
        )
        assert tears.check([wide]) == []
    wide[:, : TornFrameDetector.band_px // 2] = 7
    assert "stopped" in tears.check([wide])[0]


def frame(number: int, image: ImageArray) -> Frame:
    return Frame(number=number, timestamp_s=0.1 * number, images=(image,), ready_s=0.0)


def test_a_checked_decoder_adds_the_warning() -> None:
    def decode(given: Frame) -> Reading:
        if given.number == 1:
            raise InputError("frame-rejected", "black")
        nothing = np.zeros(0)
        return Reading(koi=nothing.astype(np.int64), forces_N=nothing, warnings=["dark"])

    reader = with_torn_frame_check(decode)
    assert reader(frame(0, noisy(0))).warnings == ["dark"]
    # One that cannot be decoded is looked at all the same.
    with refused("frame-rejected"):
        reader(frame(1, noisy(1)))
    for number in range(2, TornFrameDetector.frames_changed_min + 1):
        assert reader(frame(number, noisy(number))).warnings == ["dark"]
    last = torn(99, noisy(TornFrameDetector.frames_changed_min), slice(48, None))
    dark, text = reader(frame(TornFrameDetector.frames_changed_min + 1, last)).warnings
    assert dark == "dark"
    assert "it is torn" in text
