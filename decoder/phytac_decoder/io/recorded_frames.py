"""Recorded images of one camera, a folder or a video, and two of them in step."""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from phytac_decoder.io.picture_size import check_pixels, picture_size
from phytac_shapes.arrays import ImageArray
from phytac_shapes.bounded_reader import read_bytes
from phytac_shapes.errors import InputError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
FILE_BYTES_MAX = 1 << 30
"""Largest file of an image: the largest picture without compression has some 0.5 GB."""


class RecordedImage(NamedTuple):
    """An image of a recording.

    ``at`` counts the images up to this one, this and lost ones included; ``time_s`` is the time at
    which it was taken, if the recording contains it; ``read`` raises InputError if it is torn.
    """

    at: int
    time_s: float
    read: Callable[[], ImageArray]


class ImageSequence(ABC):
    """Recorded images of one camera.

    Attributes
    ----------
    description : str
        Folder or file.
    count : int or None
        Number of images; None if only reading them shows it.
    stamped : bool
        Whether the recording contains the times at which they were taken.
    announced : int or None
        Number in its header, which some formats only estimate.
    interval_s : float
        Usual time between images; 0 if not known.
    span_s : tuple of float
        Times of the first and the last; infinity if not known.
    """

    description: str
    count: int | None = None
    stamped: bool = True
    announced: int | None = None
    interval_s: float = 0.0
    span_s: tuple[float, float] = (0.0, math.inf)

    @abstractmethod
    def images(self) -> Iterator[RecordedImage]:
        """Readable images from the first on."""


class ImageFolder(ImageSequence):
    """Image files, ordered by time if all names are times, else by the numbers in their names.

    Names are times if all are seconds with decimals (``12.350.png``) or nanoseconds, as ROS
    exports them.

    Raises
    ------
    InputError
        If there are none.
    """

    def __init__(self, where: Path) -> None:
        self.description = str(where)
        if where.is_dir():
            try:
                files = [item for item in where.iterdir() if _is_image(item.name)]
            except OSError as error:
                raise InputError(
                    "file-unreadable", f"no frames at {where} ({error.strerror})"
                ) from None
        else:
            files = [where]
        if not files:
            raise InputError(
                "folder-without-images",
                f"{where} holds no image (got none of {', '.join(SUFFIXES)}); give the folder of "
                "the frames themselves, or a video",
            )
        stamps = times_in_names([item.stem for item in files])
        self.stamped, times = stamps is not None, stamps or [0.0] * len(files)
        order = sorted(range(len(files)), key=lambda i: (times[i], _natural(files[i].name)))
        self._files = [files[i] for i in order]
        self._times = [times[i] for i in order]
        self.count = len(files)
        self.span_s = self._times[0], self._times[-1]
        self.interval_s = float(np.median(np.diff(self._times))) if len(files) > 1 else 0.0

    def images(self) -> Iterator[RecordedImage]:
        """All files in their order."""
        for number, (file, time_s) in enumerate(zip(self._files, self._times, strict=True)):
            yield RecordedImage(number + 1, time_s, partial(read_image, file))


class VideoFile(ImageSequence):
    """A video that OpenCV reads, continued after damaged places.

    Raises
    ------
    InputError
        If it cannot be read.
    """

    def __init__(self, where: Path) -> None:
        self.description = str(where)
        video = self._opened()
        count = float(video.get(cv2.CAP_PROP_FRAME_COUNT))
        # A header with an absurd number knows none.
        self.announced = int(count) if 0.0 < count < 1e9 else None
        rate = float(video.get(cv2.CAP_PROP_FPS))
        self.interval_s = 1.0 / rate if 0.0 < rate < math.inf else 0.0
        self.span_s = 0.0, (self.announced or math.inf) * (self.interval_s or math.inf)
        video.release()

    def _opened(self) -> cv2.VideoCapture:
        video = cv2.VideoCapture(self.description)
        if not video.isOpened():
            raise InputError(
                "file-not-image",
                f"{self.description} is not a video or image that can be read; give an image (PNG, "
                "JPEG), a folder of images, a video, or a camera's number",
            )
        sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        width, height = map(video.get, sides)
        check_pixels(width, height, self.description)
        return video

    def images(self) -> Iterator[RecordedImage]:
        """Images that can be grabbed, numbered as if none was lost in a damaged place."""
        video, at, last_s = self._opened(), 0, 0.0
        try:
            while True:
                left, failed = (self.announced or 0) - at, 0
                while not video.grab():
                    # A damaged place in a video may take many grabs to pass; each fails at once.
                    if failed >= min(left, 300):
                        return
                    failed += 1
                now_s = float(video.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
                if failed and self.interval_s and now_s > last_s:
                    # One failure may stand for several images.
                    failed = round((now_s - last_s) / self.interval_s) - 1
                at += 1 + max(min(failed, left - 1), 0)
                last_s = now_s
                yield RecordedImage(at, now_s, partial(self._decoded, video))
        finally:
            video.release()

    def _decoded(self, video: cv2.VideoCapture) -> ImageArray:
        good, image = video.retrieve()
        if not good or image is None:
            raise InputError(
                "frame-not-decoded", f"a frame of {self.description} cannot be decoded"
            )
        return np.asarray(image, dtype=np.uint8)


class SynchronisedTracks:
    """Advances through the recordings of one camera, or of two by images that belong together.

    Images belong together if they are of one instant, where both recordings contain times that can
    be compared, and otherwise if they have the same place in the order.

    Parameters
    ----------
    tracks : sequence of Track
        One for each camera.
    report : callable
        Called with a line on missing images.

    Attributes
    ----------
    by_time : bool
        Whether images are paired by time.
    now : list of RecordedImage
        The current image of each camera.
    """

    pair_share = 0.55
    """Images of one instant are at most this share of an interval apart: any two are at most half
    an interval apart, plus jitter."""

    def __init__(self, tracks: Sequence[ImageSequence], report: Callable[[str], None]) -> None:
        self._tracks, self._report = tracks, report
        self._reported: set[str] = set()
        self.by_time = len(tracks) > 1 and comparable(*tracks)
        timed = all(track.stamped and track.interval_s > 0.0 for track in tracks)
        if len(tracks) > 1 and timed and not self.by_time:
            said = " and ".join(track.description for track in tracks)
            report(f"the times of {said} cannot be compared; their frames are paired in order")

        self._images: list[Iterator[RecordedImage]] = []
        self.rewind()

    def rewind(self) -> None:
        """Return to before the first image."""
        self._images = [track.images() for track in self._tracks]
        self.now = [RecordedImage(0, 0.0, partial(read_image, Path())) for _ in self._tracks]

    def _advance(self, camera: int) -> bool:
        """Advance one camera's recording; False after its last image."""
        image = next(self._images[camera], None)
        if image is not None:
            self.now[camera] = image
        return image is not None

    def grab(self, number: int) -> int:
        """Advance to the next pair, frame ``number`` if none is lost.

        Returns the number of frames passed, lost ones included, and 0 after the last.
        """
        before = [image.at for image in self.now]
        more = [self._advance(camera) for camera in range(len(self._tracks))]
        first = self._counted(before)
        while all(more) and (behind := self._behind()) is not None:
            more[behind] = self._advance(behind)
        if not all(more):
            self._report_end(more, number)
            return 0
        each = self._counted(before)
        steps = max(each)
        if steps > 1:
            which = f"frame {number}" if steps == 2 else f"frames {number} to {number + steps - 2}"
            if max(first) > 1:
                why = f"{self._tracks[first.index(max(first))].description} is damaged there"
            else:
                why = f"{self._tracks[each.index(min(each))].description} has none of that time"
            self._report(f"{which} skipped: {why}")
        return steps

    def _counted(self, before: Sequence[int]) -> list[int]:
        return [image.at - at for image, at in zip(self.now, before, strict=True)]

    def _behind(self) -> int | None:
        """The camera that has to advance alone; None if the images belong together."""
        places = [image.time_s if self.by_time else image.at for image in self.now]
        behind = places.index(min(places))
        apart = self.pair_share * self._tracks[behind].interval_s if self.by_time else 0.0
        return behind if max(places) - min(places) > apart else None

    def _report_end(self, more: Sequence[bool], number: int) -> None:
        """Report recordings that end too early."""
        for track, image, advanced in zip(self._tracks, self.now, more, strict=True):
            expected = track.announced or 0
            if advanced or image.at >= expected or track.description in self._reported:
                continue
            self._reported.add(track.description)
            self._report(
                f"{track.description} ends after {image.at} frames, and its header promises "
                f"{expected}: it may be cut off or damaged (some formats only estimate that number)"
            )
        if any(more):
            short = self._tracks[list(more).index(False)].description
            self._report(f"{short} ends after {number} frames, before the other camera's")


def comparable(near: ImageSequence, far: ImageSequence) -> bool:
    """Whether the times of two recordings seem to be of one clock.

    Their intervals differ by 5 % at most, and they share half of the shorter recording.
    """
    rates = near.interval_s, far.interval_s
    if not (near.stamped and far.stamped and min(rates) > 0.0):
        return False
    if max(rates) - min(rates) > 0.05 * max(rates):
        return False
    firsts, lasts = zip(near.span_s, far.span_s, strict=True)
    shorter = min(last - first for first, last in (near.span_s, far.span_s))
    return min(lasts) - max(firsts) >= 0.5 * shorter


def times_in_names(stems: Sequence[str]) -> list[float] | None:
    """Times, s, if all names are seconds with decimals, or nanoseconds as ROS exports them."""
    if all(re.fullmatch(r"\d+\.\d+", stem) for stem in stems):
        return [float(stem) for stem in stems]
    if all(re.fullmatch(r"\d{16,19}", stem) for stem in stems):
        return [int(stem) / 10**9 for stem in stems]
    return None


def read_image(path: Path) -> ImageArray:
    """Read an image file as BGR.

    Raises
    ------
    InputError
        If it is missing, cut off, too large or not an image.
    """
    try:
        data = read_bytes(path, bytes_max=FILE_BYTES_MAX)
    except OSError as error:
        raise InputError("file-unreadable", f"no image at {path} ({error.strerror})") from None
    # What a whole PNG or JPEG begins and ends with: OpenCV gives half an image for half a file.
    ends = {b"\x89PNG": b"IEND\xaeB`\x82", b"\xff\xd8": b"\xff\xd9"}.items()
    body = data.rstrip(b"\0")  # some cameras pad their files
    if not data or any(data.startswith(head) and not body.endswith(tail) for head, tail in ends):
        raise InputError("image-truncated", f"{path} is cut off; it holds {len(data)} bytes")
    image = None
    if size := picture_size(data):
        check_pixels(*size, path)
        try:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
        except cv2.error as error:
            raise InputError(
                "frame-not-decoded", f"{path} cannot be decoded ({error.err})"
            ) from None
    if image is None:
        raise InputError(
            "file-not-image", f"{path} is not an image that can be read (PNG, JPEG, BMP, TIFF)"
        )
    return np.asarray(image, dtype=np.uint8)


def _is_image(name: str) -> bool:
    # macOS puts a ._ file beside each on foreign disks; it holds no image.
    return name.lower().endswith(SUFFIXES) and not name.startswith("._")


def _natural(name: str) -> list[tuple[str, int]]:
    """Sorts frame_9 before frame_10."""
    parts = re.split(r"(\d+)", name)
    return [(a, int(b or 0)) for a, b in zip(parts[::2], [*parts[1::2], ""], strict=True)]
