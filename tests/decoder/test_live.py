"""A camera that fails for a while."""

import time

import numpy as np
import pytest

from phytac_decoder.io import live_camera
from phytac_decoder.io.frame_sources import open_source

PERIOD_S = 0.02
OUTAGE_S = 1.0


class Failing:
    """Gives 50 frames a second, except for a second in which it fails at once."""

    def __init__(self, _device: int | str) -> None:
        self.begun = time.monotonic()

    def isOpened(self) -> bool:
        return True

    def set(self, *_words: float) -> bool:
        return True

    def grab(self) -> bool:
        if 0.5 < time.monotonic() - self.begun < 0.5 + OUTAGE_S:
            return False
        time.sleep(PERIOD_S)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.zeros((4, 4, 3), dtype=np.uint8)

    def release(self) -> None:
        pass


def test_an_outage_costs_as_many_frames_as_it_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_camera.cv2, "VideoCapture", Failing)
    source = open_source(["0"], report=lambda _: None)
    for frame in source:
        if frame.timestamp_s > 0.7 + OUTAGE_S:
            break
    source.close()
    # A busy machine sleeps longer, never shorter.
    assert 5 < source.skipped <= 1.2 * OUTAGE_S / PERIOD_S
