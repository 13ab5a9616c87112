"""A camera that fails for a while."""

import time

import numpy as np
import pytest

from phytac_decoder.io import camera_device
from phytac_decoder.io.camera_device import CaptureSettings
from phytac_decoder.io.frame_sources import open_source
from phytac_decoder.io.live_camera import CameraSource

PERIOD_S = 0.02
OUTAGE_S = 1.0


class Failing:
    """Gives 50 frames a second, except for a second in which it fails at once."""

    def __init__(self, _device: int | str, _api: int) -> None:
        self.begun = time.monotonic() + 0.5

    def isOpened(self) -> bool:
        return True

    def set(self, *_words: float) -> bool:
        return True

    def get(self, _key: int) -> float:
        return -1.0

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
    monkeypatch.setattr(camera_device.cv2, "VideoCapture", Failing)
    # It is not lost yet.
    settings = CaptureSettings(lost_s=5.0, warm_up_least_s=0.0)
    monkeypatch.setattr(CameraSource, "settings", settings)
    source = open_source(["0"], report=lambda _: None)
    for frame in source:
        if frame.timestamp_s > 0.7 + OUTAGE_S:
            break
    source.close()
    # A busy machine sleeps longer, never shorter.
    assert 5 < source.skipped <= 1.2 * OUTAGE_S / PERIOD_S
