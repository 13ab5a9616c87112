"""How changes of light and focus since the rest frame shift the markers in the image.

The rest frame is disturbed and read again. The shifts by a small disturbance are the derivatives of
all markers' positions; with them the size of a change is one unknown per paint, which every fit
estimates with the contacts (:mod:`phytac_decoder.camera.camera_motion`). A gamma curve stands for
all changes of contrast, clipping included: they weight the bright and the dark side of a marker
differently. Gain and white balance do not move centroids (``ColourModel.counts``). A rolling
shutter adds two unknowns per camera: rows that are read later are moved sideways and along.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import (
    Frames,
    in_rest_light,
    locate_markers,
    one_frame_per_camera,
    prepared_frames,
    with_edges,
)
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class LightSettings:
    """Disturbances of the rest frame, and how large they may be in use.

    Attributes
    ----------
    log_gamma, blur_px2 : float
        Logarithm of the exponent, and variance of the Gaussian, of the disturbance.
    log_gamma_sd, blur_sd_px2 : float
        Standard deviations of these changes: three of them are an exponent of 0.4 to 2.5, and a
        blur of 2.4 px.
    skew_sd_px : float
        Standard deviation of the motion of the last row against the first, of a rolling shutter.
    shift_max_px : float
        A marker that moves farther was confused with another one: it shows nothing.
    """

    log_gamma: float = -0.16
    blur_px2: float = 1.0
    log_gamma_sd: float = 0.3
    blur_sd_px2: float = 2.0
    skew_sd_px: float = 1.0
    shift_max_px: float = 1.0


SETTINGS = LightSettings()


def with_light_response(bundle: Bundle, rest_frames: Frames) -> Bundle:
    """Bundle whose estimators allow for changes of light and focus since the rest frame.

    Parameters
    ----------
    bundle : Bundle
        Calibrated with these frames, see :func:`.colour_calibration.calibrate_rest`.
    rest_frames : (h, w, 3) uint8, or a sequence of them
        Frame of the unloaded sensor; of several cameras one of each.
    """
    camera_motion = bundle.model.camera_motion
    if camera_motion is None:
        return bundle
    curve = 255.0 * (np.arange(256) / 255.0) ** np.exp(SETTINGS.log_gamma)
    table = curve.round().astype(np.uint8)
    sigma = float(np.sqrt(SETTINGS.blur_px2))

    def gamma(frame: ImageArray) -> ImageArray:
        return np.asarray(cv2.LUT(frame, table))

    def blur(frame: ImageArray) -> ImageArray:
        return np.asarray(cv2.GaussianBlur(frame, (0, 0), sigma))

    disturbances = (
        (gamma, SETTINGS.log_gamma, SETTINGS.log_gamma_sd),
        (blur, SETTINGS.blur_px2, SETTINGS.blur_sd_px2),
    )
    frames = one_frame_per_camera(bundle, rest_frames)
    still = locate_markers(bundle, frames)[0].position_px
    off = np.zeros(len(bundle.colour), dtype=np.bool_)
    rows: list[FloatArray] = []
    sds: list[float] = []
    for disturb, size, sd in disturbances:
        disturbed = [disturb(frame) for frame in frames]
        try:
            matched = locate_markers(bundle, disturbed).matched
        except InputError:
            # So small or weak markers are not found after such a change in use either.
            continue
        # Reference marks follow the markers.
        shift = matched.position_px - still
        images = in_rest_light(bundle, prepared_frames(bundle, disturbed))
        shift = with_edges(bundle, images, shift, off, off)[: len(off)]
        sound = ~matched.merged[: len(shift)] & (np.hypot(*shift.T) < SETTINGS.shift_max_px)
        for camera in range(len(frames)):
            for paint in np.unique(bundle.colour):
                own = sound & (bundle.read_by == camera) & (bundle.colour == paint)
                rows.append(np.where(own[:, None], shift / size, 0.0).reshape(-1))
                sds.append(sd)
    still = still[: len(bundle.colour)]
    for number, view in enumerate(bundle.cameras):
        late = still[:, 1] / view.height_px - 0.5
        late = np.where((bundle.read_by == number) & np.isfinite(late), late, 0.0)
        for axis in range(2):
            rows.append((late[:, None] * np.eye(2)[axis]).reshape(-1))
            sds.append(SETTINGS.skew_sd_px)
    camera_motion = camera_motion.with_light(np.stack(rows), np.array(sds))
    model = bundle.model.with_camera_motion(camera_motion, bundle.noise_centroid_px)
    return replace(bundle, model=model)
