"""Exposure and white balance of each frame, brought back to those of the rest frame.

A camera that changes its white balance multiplies each channel by another factor (in a picture
with a power law of brightness, too). Where pixels show paint and wall together, centroids of colour
then move: by 0.06 px RMS on the markers of ``handle`` if red fades by a tenth. The factors are
measured on the bare wall, which is most of the picture, and divided out.
"""

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from phytac_decoder.vision.segmentation import ColourModel
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray


@dataclass(frozen=True, kw_only=True)
class WhiteBalance:
    """Levels of the bare wall in one camera's rest frame.

    Attributes
    ----------
    pixel : (k,) int
        Pixels of the wall, by number in the image.
    level : (k, 3) float
        Blue, green and red there.
    """

    pixel: IntArray
    level: FloatArray

    pixels: ClassVar[int] = 600
    pixels_min: ClassVar[int] = 100
    """Pixels that are compared, and how many a rest frame must have to choose them from."""
    margin_px: ClassVar[int] = 3
    """Distance from paint. Markers that move farther are few: the median does not see them."""
    dark_level: ClassVar[int] = 20
    clipped_level: ClassVar[int] = 250
    unclipped_min: ClassVar[float] = 0.5
    """Share of the pixels that must be below the clipped level."""
    change_min: ClassVar[float] = 0.02
    """Change of a channel up to which a frame is left as it is: it moves markers by 0.01 px."""
    change_max: ClassVar[float] = 2.2
    """Factor above which it is left, too: of the levels too little remains."""

    @classmethod
    def at_rest(
        cls, frame: ImageArray, colours: ColourModel, place_px: FloatArray
    ) -> "WhiteBalance | None":
        """Choose pixels between the markers; None if too little of the wall is seen.

        None also of dots that are separated from the wall by brightness: they have no colour.

        Parameters
        ----------
        frame : (h, w, 3) uint8
            Rest frame.
        colours : ColourModel
            Calibrated paints.
        place_px : (n, 2) float
            Places of the markers, NaN of those that are not seen.
        """
        seen = place_px[np.isfinite(place_px[:, 0])]
        if colours.dots or not len(seen):
            return None
        painted = (colours.classify(frame)[0] > 0).astype(np.uint8)
        near_paint = cv2.dilate(painted, np.ones((2 * cls.margin_px + 1,) * 2, dtype=np.uint8))
        bare = (near_paint == 0) & (frame.min(axis=2) >= cls.dark_level)
        bare &= frame.max(axis=2) < cls.clipped_level
        left, top = np.maximum(np.floor(seen.min(axis=0)), 0).astype(np.int64)
        right, bottom = np.ceil(seen.max(axis=0)).astype(np.int64) + 1
        between = np.zeros_like(bare)
        between[top:bottom, left:right] = True
        pixel = np.flatnonzero(bare & between)
        if len(pixel) < cls.pixels_min:
            return None
        chosen = pixel[np.linspace(0, len(pixel) - 1, cls.pixels).round().astype(np.int64)]
        # Without the noise of single pixels.
        smooth = cv2.blur(frame, (3, 3)).reshape(-1, 3)
        return cls(pixel=chosen, level=smooth[chosen].astype(np.float64))

    def change(self, frame: ImageArray) -> FloatArray:
        """Factors (3,) by which blue, green and red have grown; 1 where too many are clipped."""
        now = frame.reshape(-1, 3)[self.pixel]
        unclipped = now.max(axis=1) < self.clipped_level
        if unclipped.mean() < self.unclipped_min:
            return np.ones(3)
        return np.asarray(np.median(now[unclipped] / self.level[unclipped], axis=0))

    def as_at_rest(self, frame: ImageArray) -> ImageArray:
        """Frame (h, w, 3) in the exposure and white balance of the rest frame."""
        change = self.change(frame)
        size = np.abs(np.log(np.maximum(change, 1e-3))).max()
        if not np.log1p(self.change_min) <= size <= np.log(self.change_max):
            return frame
        levels = np.minimum(np.rint(np.arange(256.0)[:, None] / change), 255.0)
        return np.asarray(cv2.LUT(frame, levels.astype(np.uint8)[None]))
