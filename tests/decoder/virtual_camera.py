"""A webcam that does not exist: its driver accepts, refuses or lies, and its pictures misbehave.

It stands in for ``cv2.VideoCapture`` of the V4L2 backend, whose properties behave as in OpenCV's
``cap_v4l.cpp``: ``set`` returns whether the driver took the request, ``get`` what it holds now, and
-1 for a control that the camera lacks.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.io import camera_device
from phytac_decoder.io.camera_device import CaptureSettings
from phytac_decoder.io.live_camera import CameraSource
from phytac_shapes.arrays import ImageArray

AUTO, MANUAL = 3.0, 1.0
YUYV, MJPG = (float(cv2.VideoWriter.fourcc(*name)) for name in ("YUYV", "MJPG"))


def usual_driver() -> dict[int, float]:
    """Properties of a webcam that was just plugged in: all is automatic."""
    return {
        cv2.CAP_PROP_FOURCC: YUYV,
        cv2.CAP_PROP_FRAME_WIDTH: 640.0,
        cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
        cv2.CAP_PROP_FPS: 30.0,
        cv2.CAP_PROP_AUTO_EXPOSURE: AUTO,
        cv2.CAP_PROP_EXPOSURE: 156.0,
        cv2.CAP_PROP_GAIN: 4.0,
        cv2.CAP_PROP_AUTO_WB: 1.0,
        cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
        cv2.CAP_PROP_AUTOFOCUS: 1.0,
        cv2.CAP_PROP_FOCUS: 30.0,
    }


@dataclass(kw_only=True)
class VirtualWorld:
    """The bench with its camera.

    Attributes
    ----------
    picture : callable
        Picture (h, w, 3) uint8 by its number since the camera was opened.
    lack, refuse : set of int
        Properties that the camera lacks, and that its driver rejects.
    lie : dict
        Properties that the driver accepts, and what it holds all the same.
    size_px : (int, int), optional
        The only size that the camera has; any if not given.
    modes : dict
        Highest rate that the camera gives in a pixel format.
    dark_frames : float
        Frames over which automatic exposure settles after opening.
    exposure : float
        Value at which automatic exposure has settled when the camera is opened.
    pump : float
        Amplitude by which exposure pumps while it is automatic, or always if ``pump_always``.
    torn : callable
        Whether the picture of this number is damaged.
    plugged : bool
        Whether the camera is connected; pictures end while it is not.
    frames : int, optional
        Pictures until it is unplugged, since it was opened.
    period_s : float
        Time between pictures.
    drivers : dict
        Properties of each device, which last until it is unplugged.
    opened : list of VirtualCamera
        All that were opened.
    """

    picture: Callable[[int], ImageArray]
    lack: set[int] = field(default_factory=set)
    refuse: set[int] = field(default_factory=set)
    lie: dict[int, float] = field(default_factory=dict)
    size_px: tuple[int, int] | None = None
    modes: dict[float, float] = field(default_factory=dict)
    dark_frames: float = 0.0
    exposure: float = 156.0
    pump: float = 0.0
    pump_always: bool = False
    torn: Callable[[int], bool] = lambda _: False
    plugged: bool = True
    frames: int | None = None
    period_s: float = 0.005
    drivers: dict[int | str, dict[int, float]] = field(default_factory=dict)
    opened: list["VirtualCamera"] = field(default_factory=list)

    def open(self, device: int | str, _api: int = 0) -> "VirtualCamera":
        camera = VirtualCamera(self, device)
        self.opened.append(camera)
        return camera

    @property
    def last(self) -> "VirtualCamera":
        return self.opened[-1]


class VirtualCamera:
    """See :class:`VirtualWorld`."""

    def __init__(self, world: VirtualWorld, device: int | str) -> None:
        self.world, self.device, self.released = world, device, False
        self.held = world.drivers.setdefault(device, usual_driver())
        self.asked: list[tuple[int, float]] = []
        self.number = -1

    def isOpened(self) -> bool:
        return self.world.plugged and self.device != 9

    def set(self, key: int, value: float) -> bool:
        self.asked.append((key, value))
        if key in self.world.lack | self.world.refuse:
            return False
        if key in self.world.lie:
            value = self.world.lie[key]
        sizes = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        if key in sizes and self.world.size_px:
            value = float(self.world.size_px[sizes.index(key)])
        if key == cv2.CAP_PROP_FPS:
            value = min(value, self.world.modes.get(self.held[cv2.CAP_PROP_FOURCC], 1000.0))
        self.held[key] = value
        return True

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_EXPOSURE and self.held[cv2.CAP_PROP_AUTO_EXPOSURE] != MANUAL:
            self.held[key] = self.world.exposure
        return -1.0 if key in self.world.lack else self.held.get(key, -1.0)

    def grab(self) -> bool:
        if not self.world.plugged:
            return False
        time.sleep(self.world.period_s)
        self.number += 1
        return self.world.frames is None or self.number < self.world.frames

    def retrieve(self) -> tuple[bool, ImageArray | None]:
        if self.world.torn(self.number):
            return False, None
        image = self.world.picture(self.number)
        return True, np.clip(np.rint(image * self.light), 0, 255).astype(np.uint8)

    @property
    def light(self) -> float:
        """Factor on the picture by exposure."""
        automatic = self.held[cv2.CAP_PROP_AUTO_EXPOSURE] != MANUAL
        pumping = self.world.pump if automatic or self.world.pump_always else 0.0
        factor = 1.0 + pumping * math.sin(0.1 * self.number)
        if automatic and self.world.dark_frames:
            factor *= 1.0 - 0.9 * math.exp(-max(self.number, 0) / self.world.dark_frames)
        return factor * self.get(cv2.CAP_PROP_EXPOSURE) / 156.0

    def release(self) -> None:
        self.released = True


def install(patch: pytest.MonkeyPatch, world: VirtualWorld, **settings: float) -> VirtualWorld:
    """Let OpenCV open this camera; it is lost and given up within a test's patience."""
    quick: dict[str, Any] = {
        "lost_s": 0.2,
        "retry_s": 0.05,
        "give_up_s": 0.6,
        "warm_up_s": 1.0,
        "warm_up_least_s": 0.0,
    }
    patch.setattr(camera_device.cv2, "VideoCapture", world.open)
    patch.setattr(CameraSource, "settings", CaptureSettings(**(quick | settings)))
    return world
