"""Following markers from frame to frame: eyes at camera speed.

``measure_frame`` searches a whole frame. A ``Follower`` starts from a rest frame, and then reads
only small windows around the places where markers are expected: the last place, moved on with the
marker's and its neighbours' velocity.
"""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.camera_tracker import CameraFollower, SeenBy
from phytac_decoder.pipeline.decode import (
    Frames,
    Measured,
    confirmed_switches,
    one_frame_per_camera,
)
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import InputError

MARGIN_px, MARGIN_SHARE = 0.4, 1e-3
"""Margin of the windows: so much, and this share of the image's width; 1 px at 640 px."""


@dataclass(frozen=True, kw_only=True)
class Followed(Measured):
    """What one frame (of each camera) shows; arrays over n markers.

    Attributes
    ----------
    position_px : (n, 2) float
        Centroid of each marker's paint; NaN where not found.
    paint : (n,) float
        Paint that shows, over that at rest.
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
        places by this much from one frame to the next before a second look is needed. 1 px in an
        image 640 px wide, 3 px in one of 2592 px, if not given.
    search_every : int
        A full search (slow, see :func:`phytac_decoder.pipeline.decode.locate_in`) after this many frames; 0 for only
        when three frames in a row were refused.

    Raises
    ------
    InputError
        If the rest frame is none of this sensor, see :func:`phytac_decoder.pipeline.decode.locate_in`.
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
            margin = MARGIN_px + MARGIN_SHARE * bundle.cameras[number].width_px
            self._cameras.append(
                CameraFollower(
                    bundle,
                    number,
                    frame,
                    stride=stride,
                    margin_px=margin if margin_px is None else margin_px,
                )
            )
        self._markers = np.arange(len(bundle.colour))
        measured = self._own([each.rest_px for each in self._cameras])
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
            them have jumped: it is black, torn or of something else. What is known of the markers
            stays as it was; give the next frame.
        """
        given = one_frame_per_camera(self._bundle, frames)
        self._count += 1
        if self._every and self._count % self._every == 0:
            seen = [each.search(frame) for each, frame in zip(self._cameras, given, strict=True)]
        else:
            seen = [
                each.follow(frame, elapsed)
                for each, frame in zip(self._cameras, given, strict=True)
            ]
        return self._measured(seen)

    def _own(self, each: list[FloatArray]) -> FloatArray:
        """Values of each marker from the camera that reads it."""
        if len(each) == 1:
            return each[0]
        return np.asarray(np.stack(each)[self._bundle.read_by, self._markers])

    def _measured(self, seen: list[SeenBy]) -> Followed:
        bundle = self._bundle
        position = self._own([item.position_px for item in seen])
        bits = self._bits(seen)
        koi = np.flatnonzero(bits)
        shift = position - self.rest_px
        shift[koi] -= bundle.tip_bias_px[koi]
        sure = confirmed_switches(bundle, bits, shift)
        if sure is not bits:
            koi = np.flatnonzero(sure)
            shift = position - self.rest_px
            shift[koi] -= bundle.tip_bias_px[koi]
        return Followed(
            koi=koi,
            shift_px=shift,
            found=np.isfinite(position[:, 0]),
            position_px=position,
            paint=self._own([item.paint for item in seen]),
            flags=tuple(flag for item in seen for flag in item.flags),
        )

    def _bits(self, seen: list[SeenBy]) -> BoolArray:
        if len(seen) == 1:
            return seen[0].bits
        return np.asarray(
            np.stack([item.bits for item in seen])[self._bundle.read_by, self._markers]
        )
