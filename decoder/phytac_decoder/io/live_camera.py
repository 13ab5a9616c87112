"""Frames of a running camera."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np

from phytac_decoder.io.frame import Frame, Source
from phytac_shapes.errors import InputError


class CameraSource(Source):
    """A camera, or two that are read together; always the newest frame.

    They are read by a thread of their own, so that a slow decoder gets no frame that waited in
    a driver. Two cameras are triggered within about a millisecond of each other only if their
    hardware does so.

    Parameters
    ----------
    devices : sequence of int or str
        Numbers or addresses that OpenCV opens.
    fps : float, optional
        Rate to request from the camera.
    size_px : tuple of int, optional
        Width and height to request.
    report : callable
        Called with a line on frames that cannot be read.

    Raises
    ------
    InputError
        If one cannot be opened.
    """

    live = True
    clock = "seconds since the stream began"
    silent_s = 5.0
    """A camera that gives no frame for this long is disconnected."""

    def __init__(
        self,
        devices: Sequence[int | str],
        *,
        fps: float | None = None,
        size_px: tuple[int, int] | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        self.description = " and ".join(f"camera {device}" for device in devices)
        self._report = report
        self._cameras: list[Any] = []
        for device in devices:
            camera = cv2.VideoCapture(device)
            self._cameras.append(camera)
            if not camera.isOpened():
                self._release()
                raise InputError(
                    "camera-not-opened",
                    f"camera {device} cannot be opened; is it plugged in, free, and may you read "
                    "it? (its number counts from 0; on Linux N is /dev/videoN)",
                )
            self._set_up(camera, device, fps, size_px)
        self._slot: Frame | None = None
        self._news = threading.Condition()
        self._stop = False
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    def _set_up(
        self, camera: Any, device: int | str, fps: float | None, size_px: tuple[int, int] | None
    ) -> None:
        camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size_px:
            camera.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
            camera.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
        if fps:
            camera.set(cv2.CAP_PROP_FPS, fps)
            got = float(camera.get(cv2.CAP_PROP_FPS))
            if abs(got - fps) > 0.01 * fps:
                self._report(f"camera {device} was set to {fps:g} fps and reports {got:g}")

    def __iter__(self) -> Iterator[Frame]:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._slot or self._stop, timeout=self.silent_s)
                frame, self._slot = self._slot, None
            if frame is None:
                if self._stop:
                    return
                raise InputError(
                    "camera-silent",
                    f"{self.description} has given no frame for {self.silent_s:g} s; plug it in",
                )
            yield frame

    def _read(self) -> None:
        started, number = time.monotonic(), 0
        # Usual time between frames, until two have come.
        period_s, last_s = 1.0 / 30.0, -1.0
        while not self._stop:
            tried_s = time.monotonic()
            # All are grabbed before any is unpacked, so that they are of one instant.
            grabbed = [camera.grab() for camera in self._cameras]
            now = time.monotonic()
            read = [camera.retrieve() for camera in self._cameras] if all(grabbed) else []
            if not read or not all(good and image is not None for good, image in read):
                self.skipped += 1
                if self.skipped == 1:
                    self._report(f"{self.description}: a frame could not be read; such are skipped")
                # One that fails at once has not lost a frame each time.
                rest_s = 0.0 if read else period_s - (now - tried_s)
                time.sleep(max(rest_s, 0.005))
                last_s = -1.0
            else:
                if last_s >= 0.0:
                    period_s = min(now - last_s, 0.5)
                last_s = now
                images = tuple(np.asarray(image, dtype=np.uint8) for _, image in read)
                frame = Frame(number=number, timestamp_s=now - started, images=images, ready_s=now)
                with self._news:
                    self.missed += self._slot is not None
                    self._slot = frame
                    self._news.notify()
            number += 1

    def close(self) -> None:
        """Release the cameras."""
        self._stop = True
        with self._news:
            self._news.notify()
        self._thread.join(timeout=1.0)
        # A camera that hangs would hang its release too.
        if not self._thread.is_alive():
            self._release()

    def _release(self) -> None:
        for camera in self._cameras:
            camera.release()
