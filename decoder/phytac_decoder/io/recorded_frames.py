"""Recorded pictures of one camera: a folder of images, or a video."""

import math
import re
from abc import ABC, abstractmethod
from pathlib import Path

import cv2
import numpy as np

from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
STAMP_NS = re.compile(r"\d{16,19}")
STAMP_S = re.compile(r"\d+\.\d+")
ENDS_OF_FILES = {b"\x89PNG": b"IEND\xaeB`\x82", b"\xff\xd8": b"\xff\xd9"}
"""What a whole PNG or JPEG begins and ends with; OpenCV gives half a picture for half a file."""
TRIES = 300
"""A damaged place in a video may take so many grabs to get over; each fails at once."""
COUNT_MAX = 10**9
"""Headers that speak of more pictures know of none."""


class ImageSequence(ABC):
    """Pictures of one camera that were recorded.

    Attributes
    ----------
    said : str
        Folder or file.
    count : int or None
        How many there are; None where only reading them tells.
    stamped : bool
        Whether the recording says when they were taken.
    announced : int or None
        How many its header speaks of, which some formats only estimate.
    interval_s : float
        Usual time from picture to picture; 0 where not known.
    span_s : tuple of float
        Times of the first and the last; infinity where not known.
    at : int
        Pictures up to the one gone to, this and lost ones included.
    """

    said: str
    count: int | None
    stamped: bool
    announced: int | None = None
    interval_s: float = 0.0
    span_s: tuple[float, float] = (0.0, math.inf)
    at: int = 0

    @abstractmethod
    def grab(self) -> bool:
        """Go on to the next picture that is there; False after the last."""

    @abstractmethod
    def retrieve(self) -> ImageArray:
        """The picture gone to.

        Raises
        ------
        InputError
            If it is torn.
        """

    @abstractmethod
    def time_s(self) -> float:
        """When the picture gone to was taken, where the recording says so."""

    @abstractmethod
    def rewind(self) -> None:
        """Before the first picture."""

    def close(self) -> None:  # noqa: B027 - most have nothing to let go
        """Let files go."""


class ImageFolder(ImageSequence):
    """Image files, by their times where all names are times, else by the numbers in their names.

    Names are times if all are seconds with decimals (``12.350.png``) or nanoseconds, as ROS
    exports them.

    Raises
    ------
    InputError
        If there are none.
    """

    def __init__(self, where: Path) -> None:
        self.said = str(where)
        if where.is_dir():
            try:
                files = [item for item in where.iterdir() if _is_image(item.name)]
            except OSError as error:
                raise InputError(f"no frames at {where} ({error.strerror})") from None
        else:
            files = [where]
        if not files:
            raise InputError(
                f"{where} holds no image (got none of {', '.join(SUFFIXES)}); give the folder of "
                "the frames themselves, or a video"
            )
        stems = [item.stem for item in files]
        self.stamped = True
        if all(STAMP_S.fullmatch(stem) for stem in stems):
            times = [float(stem) for stem in stems]
        elif all(STAMP_NS.fullmatch(stem) for stem in stems):
            times = [int(stem) / 10**9 for stem in stems]
        else:
            times, self.stamped = [0.0] * len(files), False
        order = sorted(range(len(files)), key=lambda i: (times[i], _natural(files[i].name)))
        self._files = [files[i] for i in order]
        self._times = [times[i] for i in order]
        self.count = len(files)
        self.span_s = self._times[0], self._times[-1]
        self.interval_s = float(np.median(np.diff(self._times))) if len(files) > 1 else 0.0

    def grab(self) -> bool:
        """Go on to the next picture; False after the last."""
        if self.at == len(self._files):
            return False
        self.at += 1
        return True

    def retrieve(self) -> ImageArray:
        """The picture gone to."""
        return whole_image(self._files[self.at - 1])

    def time_s(self) -> float:
        """What its name says."""
        return self._times[self.at - 1]

    def rewind(self) -> None:
        """Before the first picture."""
        self.at = 0


class VideoFile(ImageSequence):
    """A video that OpenCV reads, on beyond places that are damaged.

    Raises
    ------
    InputError
        If it cannot be read.
    """

    count = None
    stamped = True

    def __init__(self, where: Path) -> None:
        self.said = str(where)
        self._open()

    def _open(self) -> None:
        self._video = cv2.VideoCapture(self.said)
        if not self._video.isOpened():
            raise InputError(
                f"{self.said} is not a video or image that can be read; give an image (PNG, JPEG), "
                "a folder of images, a video, or a camera's number"
            )
        count = float(self._video.get(cv2.CAP_PROP_FRAME_COUNT))
        self.announced = int(count) if 0.0 < count < COUNT_MAX else None
        rate = float(self._video.get(cv2.CAP_PROP_FPS))
        self.interval_s = 1.0 / rate if 0.0 < rate < math.inf else 0.0
        self.span_s = 0.0, (self.announced or math.inf) * (self.interval_s or math.inf)
        self.at, self._last_s = 0, 0.0

    def grab(self) -> bool:
        """Go on to the next picture that is there; False after the last."""
        left = (self.announced or 0) - self.at
        failed = 0
        while not self._video.grab():
            if failed >= min(left, TRIES):
                return False
            failed += 1
        now_s = self.time_s()
        self.at += 1 + (self._lost(failed, now_s, left - 1) if failed else 0)
        self._last_s = now_s
        return True

    def _lost(self, failed: int, now_s: float, most: int) -> int:
        """Pictures that a damaged place has cost: one failure may stand for several."""
        usual_s = self._last_s / (self.at - 1) if self.at > 1 else 0.0
        passed_s = now_s - self._last_s
        if usual_s > 0.0 and passed_s > 0.0:
            failed = max(round(passed_s / usual_s) - 1, 0)
        return max(min(failed, most), 0)

    def retrieve(self) -> ImageArray:
        """The picture gone to."""
        good, image = self._video.retrieve()
        if not good or image is None:
            raise InputError(f"a frame of {self.said} cannot be decoded")
        return np.asarray(image, dtype=np.uint8)

    def time_s(self) -> float:
        """When it is shown."""
        return float(self._video.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0

    def rewind(self) -> None:
        """Before the first picture."""
        self._video.release()
        self._open()

    def close(self) -> None:
        """Let the file go."""
        self._video.release()


def whole_image(path: Path) -> ImageArray:
    """An image file as BGR.

    Raises
    ------
    InputError
        If it cannot be read, or is cut off.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})") from None
    # Some cameras pad their files.
    body = data.rstrip(b"\0")
    ends = ENDS_OF_FILES.items()
    if not data or any(data.startswith(head) and not body.endswith(tail) for head, tail in ends):
        raise InputError(f"{path} is cut off; it holds {len(data)} bytes")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise InputError(f"{path} cannot be decoded ({error.err})") from None
    if image is None:
        raise InputError(f"{path} is not an image that can be read (PNG, JPEG, BMP, TIFF)")
    return np.asarray(image, dtype=np.uint8)


def _is_image(name: str) -> bool:
    # macOS puts a ._ file beside each on foreign disks; it holds no picture.
    return name.lower().endswith(SUFFIXES) and not name.startswith("._")


def _natural(name: str) -> list[tuple[str, int]]:
    """Sorts frame_9 before frame_10."""
    parts = re.split(r"(\d+)", name)
    return [(a, int(b or 0)) for a, b in zip(parts[::2], [*parts[1::2], ""], strict=True)]
