"""Gaps between markers with a limit, against those without and every pair of pixels."""

import numpy as np
import pytest
from numpy.typing import NDArray

from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import paint_owner
from phytac_shapes.arrays import FloatArray, IntArray
from tests.optics.cases import Bench


def every_pair(marker: NDArray[np.int32], colour: IntArray) -> FloatArray:
    """Least distance over all pixels of all pairs, (2, n)."""
    gaps = np.full((2, len(colour)), np.inf)
    y, x = np.nonzero(marker >= 0)
    owner = marker[y, x]
    for i in range(len(colour)):
        mine = owner == i
        d = np.hypot(x[mine][:, None] - x, y[mine][:, None] - y)
        for kind, same in enumerate((colour[owner] == colour[i], colour[owner] != colour[i])):
            gaps[kind, i] = d[:, same & ~mine].min(initial=np.inf)
    return gaps


@pytest.fixture
def blots(rng: np.random.Generator) -> NDArray[np.int32]:
    """Sixty rectangles, some over others, some at the border, one hidden."""
    marker = np.full((90, 140), -1, dtype=np.int32)
    for i in range(60):
        x, y = rng.integers(-3, 138), rng.integers(-3, 88)
        wide, high = rng.integers(1, 9, 2)
        marker[max(y, 0) : max(y + high, 0), max(x, 0) : max(x + wide, 0)] = i
    marker[marker == 31] = -1
    return marker


@pytest.mark.parametrize("colours", [2, 7])
def test_gaps_are_those_of_every_pair_of_pixels(blots: NDArray[np.int32], colours: int) -> None:
    colour = np.arange(60) % colours
    expected = every_pair(blots, colour)
    assert np.isinf(expected[:, 31]).all()
    np.testing.assert_allclose(np.stack(marker_gaps(blots, colour)), expected, rtol=1e-15)


@pytest.mark.parametrize("limit_px", [1.0, 5.0, 8.3, 64.0, 200.0])
def test_gaps_up_to_a_limit_are_the_same_and_inf_beyond(
    blots: NDArray[np.int32], limit_px: float
) -> None:
    colour = np.arange(60) % 3
    expected = every_pair(blots, colour)
    found = np.stack(marker_gaps(blots, colour, limit_px=limit_px))
    np.testing.assert_array_equal(found, np.where(expected <= limit_px, expected, np.inf))
    if limit_px < 64.0:
        assert np.isfinite(found).any()
        assert np.isinf(found).sum() > np.isinf(expected).sum()


def test_a_limit_that_a_gap_meets_exactly_keeps_it() -> None:
    marker = np.full((20, 30), -1, dtype=np.int32)
    marker[2, 2], marker[6, 5] = 0, 1  # 3, 4, 5
    colour = np.zeros(2, dtype=np.int64)
    assert marker_gaps(marker, colour, limit_px=5.0)[0].tolist() == [5.0, 5.0]
    assert np.isinf(marker_gaps(marker, colour, limit_px=4.999)[0]).all()


def test_gaps_of_no_visible_marker_are_inf() -> None:
    marker = np.full((5, 5), -1, dtype=np.int32)
    assert np.isinf(np.stack(marker_gaps(marker, np.zeros(3, dtype=np.int64)))).all()


def test_a_limit_on_a_real_picture(small: Bench) -> None:
    marker = paint_owner(rasterise(small.scene(), small.camera).part)
    whole = np.stack(marker_gaps(marker, small.markers.colour))
    some = np.stack(marker_gaps(marker, small.markers.colour, limit_px=4.0))
    assert 20 < np.isfinite(some).sum() < 0.8 * some.size
    np.testing.assert_array_equal(some, np.where(whole <= 4.0, whole, np.inf))
