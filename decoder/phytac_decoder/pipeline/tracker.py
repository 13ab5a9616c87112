"""Following markers from frame to frame, at camera speed.

``measure_frame`` searches a whole frame. A ``Follower`` starts from a rest frame and then reads
only small windows around the positions where markers are expected: the last position plus the
mean velocity of the marker and its neighbours.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.camera_tracker import CameraFollower, Observed
from phytac_decoder.pipeline.decode import (
    FrameMeasurement,
    Frames,
    corrected_shift,
    one_frame_per_camera,
)
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Followed(FrameMeasurement):
    """What one frame (of each camera) shows; arrays over n markers.

    Attributes
    ----------
    position_px : (n, 2) float
        Centroid of each marker's paint; NaN where not found.
    paint : (n,) float
        Visible paint over that at rest.
    flags : tuple of str
        What was unusual about the frame, each as a sentence; empty for a sound one.
    """

    position_px: FloatArray
    paint: FloatArray
    flags: tuple[str, ...] = ()


class Follower:
    """Follows a sensor's markers over the frames of its cameras.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    rest : (h, w, 3) uint8, or a sequence of them
        Frame of the unloaded sensor; of several cameras one of each.
    stride : int
        1 reads every pixel of the windows; 2 every other in both directions: faster, and less
        exact. Switches are always read from every pixel.
    margin_px : float, optional
        How far windows reach beyond a marker's paint at rest: markers may leave their expected
        positions by this much from one frame to the next before a second look is needed. 1 px in
        an image 640 px wide, 3 px in one of 2592 px, if not given.
    search_every : int
        A full search (slow, see :func:`locate_in`) after this many frames; 0 for only
        when three frames in a row were rejected.

    Raises
    ------
    InputError
        If the rest frame is none of this sensor, see :func:`locate_in`.
    """

    def __init__(
        self,
        bundle: Bundle,
        rest: Frames,
        *,
        stride: int = 1,
        margin_px: float | None = None,
        search_every: int = 0,
    ) -> None:
        if stride not in (1, 2):
            raise InputError(f"stride must be 1 or 2 (got {stride}); 1 reads every pixel")
        self._bundle, self._every, self._count = bundle, search_every, 0
        self._cameras = []
        for number, frame in enumerate(one_frame_per_camera(bundle, rest)):
            usual = 0.4 + 1e-3 * bundle.cameras[number].width_px
            margin = usual if margin_px is None else margin_px
            camera = CameraFollower(bundle, number, frame, stride=stride, margin_px=margin)
            self._cameras.append(camera)
        measured = self._read([each.rest_px for each in self._cameras])
        self.rest_px = np.where(np.isfinite(measured), measured, bundle.rest_px)

    @property
    def pixels(self) -> int:
        """Pixels that are read of a frame in which nothing is lost, of all cameras."""
        return sum(each.pixels for each in self._cameras)

    def follow(self, frames: Frames, *, elapsed: float = 1.0) -> Followed:
        """Find markers and switches in the next frame, or the next one of each camera.

        Parameters
        ----------
        frames : (h, w, 3) uint8, or a sequence of them
            BGR, as for :func:`phytac_decoder.pipeline.decode.measure_frame`.
        elapsed : float
            Frame intervals since the last frame given; more than 1 if frames were dropped.

        Raises
        ------
        InputError
            If a frame has another size, shows less than half of the markers, or more than 30 % of
            them have jumped: it is black, torn or of something else. The state of the markers does
            not change; give the next frame.
        """
        given = one_frame_per_camera(self._bundle, frames)
        self._count += 1
        search = self._every and self._count % self._every == 0
        return self._measured(
            [
                camera.search(frame) if search else camera.follow(frame, elapsed)
                for camera, frame in zip(self._cameras, given, strict=True)
            ]
        )

    def _read(self, each: list[NDArray[Any]]) -> NDArray[Any]:
        """Values of each marker from the camera that reads it."""
        if len(each) == 1:
            return each[0]
        return np.asarray(np.stack(each)[self._bundle.read_by, np.arange(len(self._bundle.colour))])

    def _measured(self, seen: list[Observed]) -> Followed:
        bundle = self._bundle
        position = self._read([item.position_px for item in seen])
        moved = position - self.rest_px
        switch_on = self._read([item.switch_on for item in seen])
        koi, shift = corrected_shift(bundle, switch_on, moved)
        return Followed(
            koi=koi,
            shift_px=shift,
            found=np.isfinite(position[:, 0]),
            position_px=position,
            paint=self._read([item.paint for item in seen]),
            flags=tuple(flag for item in seen for flag in item.flags),
        )
