"""One camera: its mode, its automatic controls locked, and what its driver made of the request."""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class CameraControl:
    """A camera's setting, as OpenCV's properties of V4L2 give it.

    Attributes
    ----------
    value, mode : int
        Properties of the setting and of its mode.
    automatic, manual : float
        Values of the mode.
    settles : bool
        Whether the automatic mode runs on opening. Focus stays as it is: it changes the lens.
    """

    value: int
    mode: int | None = None
    automatic: float = 1.0
    manual: float = 0.0
    settles: bool = True


CONTROLS = {
    "exposure": CameraControl(
        value=cv2.CAP_PROP_EXPOSURE,
        mode=cv2.CAP_PROP_AUTO_EXPOSURE,
        automatic=3.0,  # V4L2_EXPOSURE_APERTURE_PRIORITY
        manual=1.0,  # V4L2_EXPOSURE_MANUAL
    ),
    "gain": CameraControl(value=cv2.CAP_PROP_GAIN),
    "white_balance": CameraControl(value=cv2.CAP_PROP_WB_TEMPERATURE, mode=cv2.CAP_PROP_AUTO_WB),
    "focus": CameraControl(value=cv2.CAP_PROP_FOCUS, mode=cv2.CAP_PROP_AUTOFOCUS, settles=False),
}


@dataclass(frozen=True, kw_only=True)
class CaptureSettings:
    """How cameras are opened and watched.

    Attributes
    ----------
    raw_max_bytes_per_s : float
        Rate of uncompressed pictures up to which they are preferred to MJPG: an isochronous
        endpoint of USB 2.0 carries 3 x 1024 bytes in each of 8000 microframes a second.
    fps : float
        Rate for that decision if none is requested.
    warm_up_frames : int
        The least number of frames that are discarded after opening, and after locking,
    warm_up_least_s, warm_up_s : float
        the shortest time for automatic controls to act, and the longest for them to settle:
    settled : float
        no channel's mean varies by more than this share over so many frames.
    lock_change_max : float
        Largest factor of brightness by which locking may change the picture without a report.
    lost_s : float
        A camera that gives no picture for this long is lost.
    retry_s : float
        Time between two attempts to open it again.
    give_up_s : float
        A camera that is lost for this long ends the stream.
    """

    raw_max_bytes_per_s: float = 24.576e6
    fps: float = 30.0
    warm_up_frames: int = 10
    warm_up_least_s: float = 1.0
    warm_up_s: float = 3.0
    settled: float = 0.02
    lock_change_max: float = 1.25
    lost_s: float = 1.0
    retry_s: float = 1.0
    give_up_s: float = 60.0


def parse_controls(pairs: Sequence[str]) -> dict[str, float | str]:
    """Settings of a camera from words such as ``exposure=156``, ``focus=auto``, ``format=mjpg``.

    Raises
    ------
    InputError
        If one is not ``NAME=VALUE`` of a known name.
    """
    out: dict[str, float | str] = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        if (name == "format" and text in {"raw", "mjpg"}) or (name in CONTROLS and text == "auto"):
            out[name] = text
        elif name in CONTROLS and text.removeprefix("-").isdecimal():
            out[name] = float(text)
        else:
            raise InputError(
                "camera-control-unknown",
                f"a camera's setting is format=raw, format=mjpg, or a whole number or auto of "
                f"{', '.join(CONTROLS)}, such as exposure=156 (got {pair!r}); change --control",
            )
    return out


@dataclass(kw_only=True)
class CameraDevice:
    """A camera that gives pictures of one size with constant settings.

    On opening, automatic exposure and white balance run until the brightness has settled, and all
    controls are locked at the values that they have reached. When it is opened again, it gets these
    values.

    Attributes
    ----------
    device : int or str
        Number or address that OpenCV opens.
    size_px : tuple of int, optional
        Width and height that its pictures must have.
    fps : float, optional
        Rate to request.
    controls : mapping
        Values in place of those that automatic controls reach, see :func:`parse_controls`.
    settings : CaptureSettings
        How it is opened.
    report : callable
        Called with the line of :meth:`summary` on opening.
    locked : dict
        Value of each control that the driver holds, as read back.
    refused : list of str
        What the driver did not accept, one clause each.
    absent : list of str
        Controls that the camera does not have.
    brightness : float
        Mean grey level of the last picture of the warm-up.
    """

    device: int | str
    size_px: tuple[int, int] | None = None
    fps: float | None = None
    controls: Mapping[str, float | str] = field(default_factory=dict)
    settings: CaptureSettings = field(default_factory=CaptureSettings)
    report: Callable[[str], None] = print
    locked: dict[str, float] = field(default_factory=dict)
    refused: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    brightness: float = 0.0
    _camera: Any = None

    def open(self) -> None:
        """Open the camera, or open it again with the settings it had.

        Raises
        ------
        InputError
            If it cannot be opened, gives no picture, or pictures of another size.
        """
        self.release()
        self.refused, self.absent = [], []
        api = cv2.CAP_ANY
        if sys.platform == "linux" and "://" not in str(self.device):
            api = cv2.CAP_V4L2
        self._camera = cv2.VideoCapture(self.device, api)
        if not self._camera.isOpened():
            self.release()
            raise InputError(
                "camera-not-opened",
                f"camera {self.device} cannot be opened; is it plugged in, free, and may you read "
                "it? (its number counts from 0; on Linux N is /dev/videoN)",
            )
        try:
            self._set_mode()
            if api == cv2.CAP_V4L2:
                self._start_automatic()
            self._check_size(self._warm_up(self.settings.warm_up_least_s))
            if api == cv2.CAP_V4L2:
                self._lock()
        except BaseException:
            self.release()
            raise
        self.report(self.summary(lockable=api == cv2.CAP_V4L2))

    def grab(self) -> bool:
        """Take a picture without unpacking it; False if there is none."""
        return self._camera is not None and bool(self._camera.grab())

    def retrieve(self) -> ImageArray | None:
        """The picture (h, w, 3) uint8, BGR, that was grabbed last; None if it is damaged."""
        good, image = self._camera.retrieve()
        return np.asarray(image, dtype=np.uint8) if good and image is not None else None

    def release(self) -> None:
        """Close the camera."""
        if self._camera is not None:
            self._camera.release()
        self._camera = None

    def summary(self, *, lockable: bool = True) -> str:
        """What the camera gives, what is locked, and what the driver refused, in one line."""
        get = self._camera.get
        code = int(get(cv2.CAP_PROP_FOURCC))
        name = code.to_bytes(4, "little").decode("ascii", "replace") if code > 0 else "unknown"
        size = f"{get(cv2.CAP_PROP_FRAME_WIDTH):.0f}x{get(cv2.CAP_PROP_FRAME_HEIGHT):.0f} px"
        parts = [f"camera {self.device}: {size}, {name}, {get(cv2.CAP_PROP_FPS):g} fps"]
        if not lockable:
            parts.append(
                "its exposure, gain, white balance and focus cannot be locked from here: lock them "
                "with the camera's own program"
            )
        groups = {
            "locked": [f"{name}={value:g}" for name, value in self.locked.items()],
            "left automatic": [key for key, value in self.controls.items() if value == "auto"],
            "has no": self.absent,
            "REFUSED": self.refused,
        }
        parts += [f"{words} {', '.join(names)}" for words, names in groups.items() if names]
        if self.refused:
            parts.append("set what was refused with v4l2-ctl, or expect wrong forces")
        return "; ".join(parts)

    def _set_mode(self) -> None:
        """Pixel format, size and rate: the first format with which the driver grants all."""
        fps = self.fps or self.settings.fps
        width, height = self.size_px or (640, 480)
        formats = {"raw": "YUYV", "mjpg": "MJPG"}
        # Two bytes a pixel.
        raw_first = 2.0 * width * height * fps <= self.settings.raw_max_bytes_per_s
        order = ["raw", "mjpg"] if raw_first else ["mjpg", "raw"]
        if "format" in self.controls:
            order = [str(self.controls["format"])]
        for name in [*order, order[0]]:
            missing = self._request_mode(formats[name])
            if not missing:
                return
        self.refused += missing

    def _request_mode(self, fourcc: str) -> list[str]:
        """Request a mode; what the driver did not grant."""
        code = float(cv2.VideoWriter.fourcc(*fourcc))
        wanted = {"format " + fourcc: (cv2.CAP_PROP_FOURCC, code)}
        if self.size_px:
            # OpenCV sets both when it has the second.
            wanted["width"] = (cv2.CAP_PROP_FRAME_WIDTH, float(self.size_px[0]))
            wanted["height"] = (cv2.CAP_PROP_FRAME_HEIGHT, float(self.size_px[1]))
        if self.fps:
            wanted["fps"] = (cv2.CAP_PROP_FPS, self.fps)
        for key, value in wanted.values():
            self._camera.set(key, value)
        out = []
        for name, (key, value) in wanted.items():
            got = float(self._camera.get(key))
            if key == cv2.CAP_PROP_FOURCC:
                out += [name] if got != value else []
            elif abs(got - value) > 0.01 * value:
                out.append(f"{name} {value:g} (it reports {got:g})")
        return out

    def _warm_up(self, least_s: float = 0.0) -> ImageArray:
        """The first picture after its brightness has settled; those before are discarded."""
        means: list[FloatArray] = []
        image: ImageArray | None = None
        began_s, frames = time.monotonic(), self.settings.warm_up_frames
        while time.monotonic() - began_s < self.settings.warm_up_s:
            taken = self.retrieve() if self.grab() else None
            if taken is None:
                time.sleep(0.005)
                continue
            image = taken
            # By channel: white balance settles more slowly than exposure.
            means.append(image[::8, ::8].mean(axis=(0, 1)))
            last = np.array(means[-frames:])
            steady = np.ptp(last, axis=0) <= self.settings.settled * last.max(axis=0) + 0.5
            long_enough = time.monotonic() - began_s >= least_s and len(means) >= frames
            if long_enough and steady.all():
                break
        else:
            self.refused.append(
                f"to settle (its brightness still changes after {self.settings.warm_up_s:g} s)"
            )
        if image is None:
            raise InputError(
                "camera-no-picture",
                f"camera {self.device} was opened and gives no picture in "
                f"{self.settings.warm_up_s:g} s; unplug it and plug it in again, close other "
                "programs that use it, or request less (--fps, --control format=mjpg)",
            )
        self.brightness = float(means[-1].mean())
        return image

    def _check_size(self, image: ImageArray) -> None:
        got = (image.shape[1], image.shape[0])
        if self.size_px and got != self.size_px:
            raise InputError(
                "camera-size",
                f"camera {self.device} gives pictures of {got[0]}x{got[1]} px, the decoder was "
                f"made for {self.size_px[0]}x{self.size_px[1]}; use a camera that has this mode "
                "(v4l2-ctl --list-formats-ext), or rebuild the design with the camera's size",
            )

    def _start_automatic(self) -> None:
        """Start automatic modes: a driver keeps what an earlier program has locked."""
        for name, control in CONTROLS.items():
            known = name in self.controls or name in self.locked
            wanted = self.controls.get(name) == "auto" or (control.settles and not known)
            if wanted and control.mode is not None and self._camera.get(control.mode) != -1.0:
                self._camera.set(control.mode, control.automatic)

    def _lock(self) -> None:
        """End automatic modes, at requested values, at earlier ones, or where they have settled."""
        before, again = self.brightness, bool(self.locked)
        for name, control in CONTROLS.items():
            wanted = self.controls.get(name, self.locked.get(name))
            if wanted == "auto":
                continue
            now = float(self._camera.get(control.value))
            mode = float(self._camera.get(control.mode)) if control.mode is not None else -1.0
            # OpenCV gives -1 for a control that the camera lacks.
            if now == mode == -1.0:
                self.absent.append(name)
                continue
            if control.mode is not None and mode != -1.0:
                self._camera.set(control.mode, control.manual)
                got = float(self._camera.get(control.mode))
                if got != control.manual:
                    self.refused.append(
                        f"{name} (stays automatic: requested mode {control.manual:g}, it reports "
                        f"{got:g})"
                    )
                    continue
            if now != -1.0:
                self._lock_value(name, control.value, float(now if wanted is None else wanted))
        self._warm_up()
        change = max(self.brightness, 1.0) / max(before, 1.0)
        limit = self.settings.lock_change_max
        given = again or {"exposure", "gain"} & set(self.controls)
        if not given and not 1.0 / limit <= change <= limit:
            self.refused.append(
                f"to hold its brightness when locked (it changed by a factor of {change:.2f}: give "
                "an exposure with --control exposure=N)"
            )

    def _lock_value(self, name: str, key: int, value: float) -> None:
        accepted = bool(self._camera.set(key, value))
        got = float(self._camera.get(key))
        # A driver rounds to its steps.
        if abs(got - value) > max(1.0, 0.02 * abs(value)):
            answer = "accepted" if accepted else "rejected"
            self.refused.append(f"{name}={value:g} ({answer}, and it reports {got:g})")
        self.locked[name] = got
