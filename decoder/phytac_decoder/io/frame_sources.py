"""Where frames come from: an image, a folder, a video, a camera; of two cameras, two of them."""

import stat
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.live_camera import CameraSource
from phytac_decoder.io.recorded_frames import (
    SUFFIXES,
    ImageFolder,
    ImageSequence,
    SynchronisedTracks,
    VideoFile,
)
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError


class RecordingSource(Source):
    """Recorded images of one camera or two, see :class:`SynchronisedTracks`.

    Parameters
    ----------
    tracks : sequence of Track
        One for each camera.
    fps : float, optional
        Play them at this rate; as fast as they are read if not given.
    every : bool
        Skip none that is late. A camera would not wait.
    loop : bool
        Begin again after the last; time continues.
    report : callable
        Called with a line on frames that cannot be read.
    clock, sleep : callable
        Of seconds.

    Attributes
    ----------
    count : int or None
        Frames of one round; None if only reading them shows it.

    Raises
    ------
    InputError
        If two recordings without comparable times differ in length, or the rate is not valid.
    """

    def __init__(
        self,
        tracks: Sequence[ImageSequence],
        *,
        fps: float | None = None,
        every: bool = False,
        loop: bool = False,
        report: Callable[[str], None] = print,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if fps is not None and not 0.0 < fps <= 1e6:
            raise InputError(
                "frame-rate-invalid",
                f"a rate lies above 0 and up to 1e6 fps (got {fps:g}); change --fps",
            )
        counts = {track.count for track in tracks}
        self._steps = SynchronisedTracks(tracks, report)
        if len(counts) > 1 and None not in counts and not self._steps.by_time:
            said = " and ".join(f"{track.count} in {track.description}" for track in tracks)
            raise InputError(
                "camera-count",
                f"frames of two cameras come in pairs (got {said}); give as many of each",
            )
        self._tracks, self._fps, self._every, self._loop = tracks, fps, every, loop
        self._report, self._clock_s, self._sleep = report, clock, sleep
        self.count = min((count for count in counts if count is not None), default=None)
        self._started_s: float | None = None
        self._stamps: list[float] = []
        self._offset_s = 0.0
        self.description = " and ".join(track.description for track in tracks)
        if fps:
            self.clock = f"number of the frame / {fps:g} fps"
        elif tracks[0].stamped:
            self.clock = "the recording's own"
        else:
            self.clock = "when it was read, from the first (the files' names contain no times)"

    def __iter__(self) -> Iterator[Frame]:
        number, useful = 0, 0
        while True:
            steps = self._steps.grab(number)
            if not steps:
                if not useful:
                    raise InputError(
                        "no-frames-read", f"not one frame of {self.description} could be read"
                    )
                if not self._loop:
                    return
                useful = 0
                self._rewind()
                continue
            self.skipped += steps - 1
            number += steps - 1
            missed = self.missed
            frame = self._frame(number)
            number += 1
            useful += self.missed > missed
            if frame is not None:
                useful += 1
                yield frame

    def _frame(self, number: int) -> Frame | None:
        """The current frame, when it is due; None if it is late or torn."""
        if self._late(number):
            self.missed += 1
            return None
        try:
            images = tuple(image.read() for image in self._steps.now)
        except InputError as error:
            self.skipped += 1
            self._report(f"frame {number} skipped: {error}")
            return None
        now = self._clock_s()
        if self._started_s is None:
            self._started_s = now - (number / self._fps if self._fps else 0.0)
        if self._fps:
            stamp = number / self._fps
            wait = self._started_s + stamp - now
            if wait > 0.0:
                self._sleep(wait)
        elif self._tracks[0].stamped:
            self._stamps.append(self._steps.now[0].time_s)
            stamp = self._offset_s + self._stamps[-1]
        else:
            stamp = now - self._started_s
        return Frame(number=number, timestamp_s=stamp, images=images, ready_s=self._clock_s())

    def _late(self, number: int) -> bool:
        """Whether a camera would be giving the next frame already."""
        if self._fps is None or self._every or self._started_s is None:
            return False
        return (self._clock_s() - self._started_s) * self._fps >= number + 1

    def _rewind(self) -> None:
        self._steps.rewind()
        if self._stamps:
            first, last, steps = self._stamps[0], self._stamps[-1], len(self._stamps) - 1
            # One usual interval between the last frame and the first of the next round.
            self._offset_s += (last - first) * (steps + 1) / steps if steps else 0.0
            self._stamps = []

    def close(self) -> None:
        """Close files."""
        self._steps.rewind()


def open_source(
    wheres: Sequence[str],
    *,
    fps: float | None = None,
    every: bool = False,
    loop: bool = False,
    pace: bool = True,
    sizes_px: Sequence[tuple[int, int]] | None = None,
    controls: Mapping[str, float | str] | None = None,
    report: Callable[[str], None] = print,
) -> Source:
    """Frames of an image, a folder of images, a video or a camera; of two, in step.

    Parameters
    ----------
    wheres : sequence of str
        A path, a camera's number (``0``; a folder of that name is ``./0``), or an address
        (``rtsp://…``); for two cameras two of a kind, the near end's first.
    fps, every, loop
        See :class:`RecordingSource`.
    pace : bool
        Wait until each frame of a recording is due; otherwise ``fps`` only sets the timestamps, and
        no frame is skipped.
    sizes_px : sequence of (int, int), optional
        Width and height that each camera's pictures must have.
    controls : mapping, optional
        Settings of a camera, see :func:`phytac_decoder.io.camera_device.parse_controls`.
    report : callable
        Called with a line on frames that cannot be read.

    Raises
    ------
    InputError
        If there is no such source, or two do not fit together.
    """
    if not 1 <= len(wheres) <= 2:
        raise InputError(
            "camera-count", f"frames come from one camera or two (got {len(wheres)} sources)"
        )
    cameras = [_device(where) for where in wheres]
    devices = [device for device in cameras if device is not None]
    if len(devices) == len(wheres):
        if loop or every:
            raise InputError(
                "camera-option-conflict",
                "a camera neither begins again nor waits; leave --loop, --every out",
            )
        return CameraSource(devices, fps=fps, sizes_px=sizes_px, controls=controls, report=report)
    if controls:
        raise InputError(
            "camera-option-conflict", "--control sets a camera; leave it out for a recording"
        )
    if devices:
        raise InputError(
            "camera-option-conflict",
            f"a camera and a recording do not go together (got {' and '.join(wheres)})",
        )
    tracks = [_track(Path(where)) for where in wheres]
    sleep = time.sleep if pace else lambda _seconds: None
    return RecordingSource(
        tracks, fps=fps, every=every or not pace, loop=loop, report=report, sleep=sleep
    )


class FirstFrames(NamedTuple):
    """Frames (h, w, 3) uint8 of each camera: their mean, which has less noise, and two of them."""

    mean: list[ImageArray]
    first: list[ImageArray]
    last: list[ImageArray]


def first_frames(source: Source, count: int) -> FirstFrames:
    """A source's next frames.

    Parameters
    ----------
    source : Source
        It stays open: a camera keeps its settings.
    count : int
        How many; frames that cannot be read do not count.

    Raises
    ------
    InputError
        If there are fewer, they differ in size, or the camera is lost.
    """
    totals: list[NDArray[np.uint32]] = []
    first: list[ImageArray] = []
    got = 0
    # Summed one by one: memory may not hold them all.
    for _, frame in zip(range(count), source, strict=False):
        if frame.gap_s:
            raise InputError(
                "rest-frames-interrupted",
                f"{source.description} was lost while the rest frames were taken; plug it in "
                "firmly, and start again",
            )
        first = first or list(frame.images)
        totals = totals or [np.zeros(image.shape, np.uint32) for image in first]
        for total, image in zip(totals, frame.images, strict=True):
            if total.shape != image.shape:
                raise InputError(
                    "frame-size-varies",
                    f"frames of {source.description} differ in size; give one recording",
                )
            np.add(total, image, out=total)
        got += 1
    if got < count:
        raise InputError(
            "rest-frames-too-few",
            f"{source.description} gave {got} frames, fewer than the {count} that show the "
            "unloaded sensor; use fewer",
        )
    mean = [np.rint(total / count).astype(np.uint8) for total in totals]
    return FirstFrames(mean, first, list(frame.images))


def _device(where: str) -> int | str | None:
    """What OpenCV opens a camera by; None for a recording."""
    if where.isdecimal() and len(where) <= 4:
        return int(where)
    if "://" in where:
        return where
    try:
        return where if stat.S_ISCHR(Path(where).stat().st_mode) else None
    except (OSError, ValueError):
        return None


def _track(where: Path) -> ImageSequence:
    try:
        kind = where.stat().st_mode
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            "file-unreadable",
            f"no frames at {where} ({reason}); give an image, a folder of images, a video, or a "
            "camera's number",
        ) from None
    if stat.S_ISDIR(kind) or where.suffix.lower() in SUFFIXES:
        return ImageFolder(where)
    return VideoFile(where)
