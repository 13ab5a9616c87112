"""Frames of a running camera, which may be unplugged and come back."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from phytac_decoder.io.camera_device import CameraDevice, CaptureSettings
from phytac_decoder.io.frame import Frame, Source
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError


class CameraSource(Source):
    """A camera, or two that are read together; always the newest frame.

    They are read by a thread of their own, so that a slow decoder gets no frame that waited in
    a driver. Two cameras are triggered within about a millisecond of each other only if their
    hardware does so.

    While a camera gives no picture, frames without images are given, one each ``lost_s``, and the
    camera is opened again as soon as it is back.

    Parameters
    ----------
    devices : sequence of int or str
        Numbers or addresses that OpenCV opens.
    fps : float, optional
        Rate to request from the camera.
    sizes_px : sequence of (int, int), optional
        Width and height that each camera's pictures must have.
    controls : mapping, optional
        Settings of all cameras, see :func:`phytac_decoder.io.camera_device.parse_controls`.
    report : callable
        Called with a line on each camera's settings, and on frames that cannot be read.

    Raises
    ------
    InputError
        If one cannot be opened, or see :meth:`phytac_decoder.io.camera_device.CameraDevice.open`.
    """

    live = True
    clock = "seconds since the stream began"
    settings = CaptureSettings()

    def __init__(
        self,
        devices: Sequence[int | str],
        *,
        fps: float | None = None,
        sizes_px: Sequence[tuple[int, int]] | None = None,
        controls: Mapping[str, float | str] | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        self.description = " and ".join(f"camera {device}" for device in devices)
        self._report = report
        self._devices = [
            CameraDevice(
                device=device,
                size_px=sizes_px[number] if sizes_px else None,
                fps=fps,
                controls=controls or {},
                settings=self.settings,
                report=report,
            )
            for number, device in enumerate(devices)
        ]
        try:
            for device in self._devices:
                device.open()
        except BaseException:
            self._release()
            raise
        self._slot: Frame | None = None
        self._news = threading.Condition()
        self._stop = False
        # Usual time between frames, until two have come.
        self._period_s = 1.0 / (fps or self.settings.fps)
        self.restart()
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    @property
    def locked(self) -> dict[str, float]:
        """Values of controls that the first camera's driver holds."""
        return self._devices[0].locked

    @property
    def refused(self) -> list[str]:
        """What the drivers did not accept, as clauses."""
        return [f"{one.device}: {text}" for one in self._devices for text in one.refused]

    def restart(self) -> None:
        """Count frames and time from now on; the camera keeps running."""
        with self._news:
            self._slot = None
            self._began_s = self._last_s = time.monotonic()
            self._number = self._last_number = self.missed = self.skipped = 0

    def __iter__(self) -> Iterator[Frame]:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._slot or self._stop, self.settings.lost_s)
                frame, self._slot = self._slot, None
                if frame is None and self._stop:
                    return
                frame = frame or self._frame_without_image()
            if frame is not None:
                yield frame

    def _frame_without_image(self) -> Frame | None:
        """A frame that shows that the camera is lost; None if it is not."""
        now = time.monotonic()
        gap_s = now - self._last_s
        if gap_s > self.settings.give_up_s:
            raise InputError(
                "camera-silent",
                f"{self.description} has given no frame for {gap_s:.0f} s; plug it in, and start "
                "again",
            )
        if gap_s < self.settings.lost_s:
            return None
        number, self._number = self._number, self._number + 1
        stamp = now - self._began_s
        return Frame(number=number, timestamp_s=stamp, images=(), ready_s=now, gap_s=gap_s)

    def _read(self) -> None:
        follows = False
        while not self._stop:
            tried_s = time.monotonic()
            # All are grabbed before any is unpacked, so that they are of one instant.
            grabbed = [device.grab() for device in self._devices]
            now = time.monotonic()
            read = [device.retrieve() for device in self._devices] if all(grabbed) else []
            images = tuple(image for image in read if image is not None)
            if len(images) == len(self._devices):
                if follows:
                    self._period_s = min(now - self._last_s, 0.5)
                self._publish(images, now)
                follows = True
                continue
            follows = False
            self._skip()
            if now - self._last_s > self.settings.lost_s:
                self._reopen()
            else:
                # One that fails at once has not lost a frame each time.
                rest_s = 0.0 if read else self._period_s - (now - tried_s)
                time.sleep(max(rest_s, 0.005))

    def _publish(self, images: tuple[ImageArray, ...], now: float) -> None:
        with self._news:
            gap_s, slot = now - self._last_s, self._slot
            if gap_s < self.settings.lost_s:
                gap_s = 0.0
            else:
                # So many frames would have come.
                due = self._last_number + round(gap_s / self._period_s)
                self.skipped += max(due - self._number, 0)
                self._number = max(due, self._number)
            self.missed += slot is not None
            self._slot = Frame(
                number=self._number,
                timestamp_s=now - self._began_s,
                images=images,
                ready_s=now,
                gap_s=max(gap_s, slot.gap_s if slot else 0.0),
            )
            self._last_s, self._last_number = now, self._number
            self._number += 1
            self._news.notify()
        if gap_s:
            self._report(f"{self.description} is back after {gap_s:.1f} s")

    def _skip(self) -> None:
        with self._news:
            self.skipped += 1
            self._number += 1
            first = self.skipped == 1
        if first:
            self._report(f"{self.description}: a frame could not be read; such are skipped")

    def _reopen(self) -> None:
        """Open the cameras again, until they give pictures or the stream is closed."""
        self._report(f"{self.description} gives no picture and is opened again")
        while not self._stop:
            self._release()
            try:
                for device in self._devices:
                    device.open()
            except InputError as error:
                if error.code != "camera-not-opened":
                    self._report(str(error))
                time.sleep(self.settings.retry_s)
            else:
                return

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
        for device in self._devices:
            device.release()
