"""What the convolutional baseline learns from: reduced frames, and forces on receptors."""

from pathlib import Path

import cv2
import numpy as np

from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.datasets.samples_writer import FRAMES
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

FRAME_PX = (160, 120)
"""Width and height of the reduced frame."""
COLOURS = 3


def places_in_frame(rest_px: FloatArray, size_px: tuple[int, int]) -> FloatArray:
    """Places (n, 2) from -1 to 1 of pixel positions (n, 2) in frames of a width and height."""
    return np.asarray((rest_px + 0.5) / np.asarray(size_px) * 2.0 - 1.0)


def reduced(frame: ImageArray) -> FloatArray:
    """A frame (h, w, 3) at the network's size, float32, by averaging areas."""
    whole = frame.astype(np.float32)
    return np.asarray(cv2.resize(whole, FRAME_PX, interpolation=cv2.INTER_AREA))


def read_frames(folder: Path, samples: IntArray) -> FloatArray:
    """Reduced frames (s, h, w, 3) of some samples of a data set that kept its frames.

    Raises
    ------
    InputError
        If one is missing or cannot be read; the data of two cameras have other names.
    """
    out = np.zeros((len(samples), FRAME_PX[1], FRAME_PX[0], COLOURS), dtype=np.float32)
    for k, sample in enumerate(samples.tolist()):
        path = folder / FRAMES / f"{sample:06d}.png"
        frame = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
        if frame is None:
            raise InputError(
                f"{path} is missing or no picture; the network learns from frames of one camera, "
                "kept by --keep frames"
            )
        out[k] = reduced(frame)
    return np.asarray(out)


def marker_forces(samples: Samples) -> FloatArray:
    """True force on every receptor whose switch is on, 0 on the others, (s, n) N.

    Raises
    ------
    InputError
        If the samples do not hold the truth.
    """
    if samples.truth is None:
        raise InputError("the samples hold no truth to learn from; make them with --keep frames")
    out = np.zeros((samples.count, samples.markers))
    np.add.at(out, (samples.truth.sample, samples.truth.marker), samples.truth.force_N)
    out[samples.status == FAILED] = 0.0
    return out
