"""The photograph of a real sensor: camera fit, predicted visibility, and what the decoder finds."""

import numpy as np
import pytest

from benchmarks import real_photo

pytestmark = pytest.mark.skipif(
    not real_photo.FOLDER.is_dir(), reason=f"the photo is not here ({real_photo.FOLDER} is missing)"
)


def test_lens_visibility_and_detector_agree_with_a_real_photo() -> None:
    result = real_photo.compare()
    error = np.hypot(*result.residual_px.T)
    assert len(error) >= 220
    assert np.sqrt(np.mean(error**2)) <= 2.0
    counted = real_photo.COUNTED
    assert (result.cut.sum(), result.hidden.sum()) == (counted.cut, counted.hidden)
    # All rows but the last three, which the glare of the far rim and blur run into.
    assert result.found[: 13 * real_photo.SIDE].sum() >= 200
    assert result.found.sum() >= 220
