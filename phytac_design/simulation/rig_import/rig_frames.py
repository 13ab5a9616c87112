"""The pictures of a user's rig: a folder of images or a video, and which is whose."""

import re
from abc import ABC, abstractmethod
from pathlib import Path

import cv2
import numpy as np

from phytac_decoder.io.picture_size import check_pixels
from phytac_decoder.io.recorded_frames import SUFFIXES, read_image, times_in_names
from phytac_design.simulation.rig_import.rig_log import RigLog
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError


class FrameSource(ABC):
    """Pictures of one camera.

    Attributes
    ----------
    where : Path
        Folder or video.
    names : tuple of str
        What each picture is called, in order.
    time_s : (m,) float or None
        When each was taken, on the source's own clock; None where it does not say.
    """

    where: Path
    names: tuple[str, ...]
    time_s: FloatArray | None

    @abstractmethod
    def read(self, number: int) -> ImageArray:
        """Picture of a number, BGR; ask in growing order."""

    @abstractmethod
    def find(self, text: str) -> int | None:
        """Number of the picture of a name or number; None if there is none, or several."""


class FrameFolder(FrameSource):
    """Image files, in the order of their names.

    Their names are their times where all are seconds with decimals (``12.350.png``) or
    nanoseconds (as ROS exports them).

    Raises
    ------
    InputError
        If there are none.
    """

    def __init__(self, where: Path, fps: float | None) -> None:
        self.where = where
        try:
            entries = list(where.iterdir())
        except OSError as error:
            raise InputError(
                "file-unreadable", f"no frames at {where} ({error.strerror})"
            ) from None
        files = [item for item in entries if item.suffix.lower() in SUFFIXES]
        if not files:
            raise InputError(
                "folder-without-images",
                f"{where} holds no image; give the folder of the frames ({', '.join(SUFFIXES)}) or "
                "a video",
            )
        self.files = sorted(files, key=lambda item: (_trailing(item.stem), item.name))
        self.names = tuple(item.name for item in self.files)
        times = times_in_names([item.stem for item in self.files])
        if times is None and fps:
            times = [number / fps for number in range(len(files))]
        self.time_s = None if times is None else np.array(times)
        self._known: dict[str, int | None] = {}
        for kind in (
            self.names,
            tuple(item.stem for item in self.files),
            tuple(str(_trailing(item.stem)) for item in self.files),
        ):
            mine: dict[str, int | None] = {}
            for number, name in enumerate(kind):
                mine[name] = None if name in mine or name == "-1" else number
            # A whole name counts before a number in another's.
            self._known = mine | self._known

    def read(self, number: int) -> ImageArray:
        """Picture of a number, BGR."""
        return read_image(self.files[number])

    def find(self, text: str) -> int | None:
        """Number of the file of this name, with or without its ending, or with this number."""
        whole = str(int(text)) if text.isdecimal() else text
        return self._known.get(text, self._known.get(whole))


class FrameVideo(FrameSource):
    """A video that OpenCV reads; its pictures are numbered from 0.

    Raises
    ------
    InputError
        If it cannot be read.
    """

    def __init__(self, where: Path, fps: float | None) -> None:
        self.where = where
        self._open()
        times: list[float] = []
        while self._video.grab():
            times.append(self._video.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
        if not times:
            raise InputError(
                "file-not-video", f"{where} is not a video that can be read, or holds no frame"
            )
        rate = fps or float(self._video.get(cv2.CAP_PROP_FPS))
        self.names = tuple(str(number) for number in range(len(times)))
        stamps = np.array(times) - times[0]
        if np.any(np.diff(stamps) <= 0.0):
            stamps = np.arange(len(times)) / rate
        self.time_s = stamps
        self._open()

    def _open(self) -> None:
        self._video, self._next = cv2.VideoCapture(str(self.where)), 0
        if not self._video.isOpened():
            raise InputError(
                "file-not-video",
                f"{self.where} is not a video that can be read; give a video or a folder of images",
            )
        sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        width, height = map(self._video.get, sides)
        check_pixels(width, height, self.where)

    def read(self, number: int) -> ImageArray:
        """Picture of a number, BGR."""
        if number < self._next:
            self._open()
        while self._next < number and self._video.grab():
            self._next += 1
        good, image = self._video.read()
        self._next += 1
        if not good:
            raise InputError("frame-not-decoded", f"{self.where}: frame {number} cannot be decoded")
        return np.asarray(image, dtype=np.uint8)

    def find(self, text: str) -> int | None:
        """Frame of this number."""
        number = int(text) if text.isdecimal() else -1
        return number if 0 <= number < len(self.names) else None


def open_source(where: Path, *, fps: float | None) -> FrameSource:
    """Pictures of a folder or a video.

    Parameters
    ----------
    where : Path
        Either.
    fps : float or None
        Pictures per second, where neither names nor the video give their times.

    Raises
    ------
    InputError
        If there are none.
    """
    if where.is_file():
        return FrameVideo(where, fps)
    return FrameFolder(where, fps)


def _trailing(stem: str) -> int:
    number = re.compile(r"(\d+)$")
    found = number.search(stem)
    return int(found[1]) if found else -1


def match_frames(
    log: RigLog,
    source: FrameSource,
    *,
    offset_s: float,
    tolerance_s: float | None,
) -> IntArray:
    """Picture of each sample, (s,); -1 where there is none, which is noted.

    By name or number where the log gives one, else by the nearest time.

    Parameters
    ----------
    log : RigLog
        The log.
    source : Source
        Pictures of one camera.
    offset_s : float
        Added to the log's clock to give the pictures'.
    tolerance_s : float or None
        Largest difference of times; half the pictures' usual interval if not given.

    Raises
    ------
    InputError
        If pictures have no times and the log no names, or not one time agrees.
    """
    if log.frame:
        found = [source.find(text) for text in log.frame]
        out = np.array([-1 if number is None else number for number in found], dtype=np.int64)
        said = [f"no single frame {text!r} in {source.where}" for text in log.frame]
    else:
        out, said = _nearest(log, source, offset_s, tolerance_s)
    log.problems.add_rows(out < 0, np.arange(len(out)), log.first_line, said.__getitem__)
    owner: dict[int, int] = {}
    for sample in np.flatnonzero(out >= 0):
        earlier = owner.setdefault(int(out[sample]), int(sample))
        if earlier != sample:
            log.problems.add(
                int(sample),
                f"line {log.first_line[sample]}: its frame {source.names[out[sample]]!r} is also "
                f"that of line {log.first_line[earlier]}",
            )
    return out


def _nearest(
    log: RigLog, source: FrameSource, offset_s: float, tolerance_s: float | None
) -> tuple[IntArray, list[str]]:
    if source.time_s is None or log.time_s is None:
        raise InputError(
            "rig-frame-times-missing",
            f"{source.where}: when its frames were taken is not said; name them by their time "
            "(12.350.png in seconds, or whole nanoseconds), give --fps, or add a column 'frame' "
            f"to {log.path}",
        )
    order = np.argsort(source.time_s, kind="stable")
    stamps = source.time_s[order]
    limit = tolerance_s
    if limit is None:
        limit = 0.5 * float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.02
    wanted = log.time_s + offset_s
    after = np.clip(np.searchsorted(stamps, wanted), 1, max(len(stamps) - 1, 1))
    pair = np.stack([after - 1, np.minimum(after, len(stamps) - 1)])
    away = np.abs(stamps[pair] - wanted)
    best = np.argmin(away, axis=0)
    gap = away[best, np.arange(len(wanted))]
    near = gap <= limit * (1.0 + 1e-9) + 1e-9
    if np.isfinite(gap).any() and not near.any():
        raise InputError(
            "rig-clocks-differ",
            f"no time of {log.path} ({np.nanmin(log.time_s):.3f} to {np.nanmax(log.time_s):.3f} s) "
            f"is within {limit:g} s of a frame of {source.where} ({stamps[0]:.3f} to "
            f"{stamps[-1]:.3f} s); give --offset-s, the seconds to add to the log's clock",
        )
    out = np.where(near, order[pair[best, np.arange(len(wanted))]], -1)
    said = [f"the nearest frame is {far:.3g} s away (tolerance {limit:g} s)" for far in gap]
    return out, said
