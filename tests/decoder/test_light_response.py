"""Changes of light and focus since the rest frame: unknowns of every fit, and no force."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline import light_response
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.light_response import LightSettings
from phytac_decoder.vision import marker_edges
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder.test_calibrate_colours import plain_bundle, rms
from tests.decoder.test_follow import REST, draw

NONE = np.zeros(0, dtype=np.int64)


def half_in_shade(frame: ImageArray) -> ImageArray:
    """Frame whose markers are darker on their right, as the sides of receptors are."""
    y, x = np.mgrid[0 : frame.shape[0], 0 : frame.shape[1]]
    gap = (x[..., None] - REST[:, 0]) ** 2 + (y[..., None] - REST[:, 1]) ** 2
    right = x > REST[gap.argmin(axis=2), 0]
    return np.rint(frame * np.where(right, 0.7, 1.0)[..., None]).astype(np.uint8)


def with_gamma(frame: ImageArray, exponent: float) -> ImageArray:
    return np.rint(255.0 * (frame / 255.0) ** exponent).astype(np.uint8)


@pytest.fixture(scope="module", autouse=True)
def _centroids_alone() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(marker_edges, "SETTINGS", replace(marker_edges.SETTINGS, area_max_px=0.0))
        yield


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return calibrate_rest(plain_bundle().with_mount("bench"), half_in_shade(draw(REST)))


def free(bundle: Bundle, frame: ImageArray) -> tuple[FloatArray, FloatArray, list[str]]:
    """Shifts as measured, shifts less all that is no press, and what is beyond the priors."""
    shift = measure_frame(bundle, frame).shift_px
    b = bundle.model.motion(shift, NONE)
    assert bundle.model.camera_motion is not None
    return shift, bundle.model.without_motion(shift, b), bundle.model.camera_motion.excess(b)


@pytest.mark.parametrize(
    "change",
    [lambda f: with_gamma(f, 0.75), lambda f: cv2.GaussianBlur(with_gamma(f, 0.85), (0, 0), 1.2)],
)
def test_gamma_and_blur_are_estimated(
    bundle: Bundle, change: Callable[[ImageArray], ImageArray]
) -> None:
    measured, left, excess = free(bundle, change(half_in_shade(draw(REST, seed=2))))
    usual = rms(free(bundle, half_in_shade(draw(REST, seed=2)))[0])
    assert rms(measured) > 2.5 * usual
    assert rms(left) < 1.5 * usual
    assert not excess


def test_every_paint_has_its_own_unknowns(bundle: Bundle) -> None:
    motion = bundle.model.camera_motion
    assert motion is not None
    assert motion.light == 2 * len(np.unique(bundle.colour)) + 2
    assert motion.count == motion.motions + motion.light == 7 + motion.light
    for row in motion.first[motion.motions : -2]:
        moved = np.abs(row.reshape(-1, 2)).sum(axis=1) > 0.0
        assert len(np.unique(bundle.colour[moved])) == 1


def test_a_rolling_shutter_is_estimated(bundle: Bundle) -> None:
    frame = half_in_shade(draw(REST, seed=2))
    y, x = np.mgrid[0 : frame.shape[0], 0 : frame.shape[1]].astype(np.float32)
    x += np.float32(1.5) * (y / frame.shape[0] - np.float32(0.5))
    measured, left, excess = free(bundle, cv2.remap(frame, x, y, cv2.INTER_CUBIC))
    assert rms(measured) > 3.0 * rms(left)
    assert not excess


def test_a_change_beyond_correction_is_named(bundle: Bundle) -> None:
    motion = bundle.model.camera_motion
    assert motion is not None
    b = np.zeros(motion.count)
    b[-1] = 10.0
    assert motion.excess(b) == ["light, exposure, focus or the delay between rows have changed"]


def test_a_blur_that_hides_the_markers_is_no_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_response, "SETTINGS", LightSettings(blur_px2=400.0))
    lit = calibrate_rest(plain_bundle().with_mount("bench"), half_in_shade(draw(REST)))
    motion = lit.model.camera_motion
    assert motion is not None
    assert motion.light == len(np.unique(lit.colour)) + 2


def test_calibrating_twice_is_calibrating_once(bundle: Bundle) -> None:
    again = calibrate_rest(bundle, half_in_shade(draw(REST)))
    one, two = bundle.model.camera_motion, again.model.camera_motion
    assert one is not None
    assert two is not None
    assert one.count == two.count
    np.testing.assert_allclose(one.first, two.first, atol=0.3)
