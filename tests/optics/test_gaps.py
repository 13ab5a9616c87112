"""Gaps between markers with a limit, against those without and every pair of pixels."""

import numpy as np
import pytest
from numpy.typing import NDArray

from phytac_design.optics.gaps import marker_gaps, outline_gaps
from phytac_shapes.arrays import FloatArray, IntArray


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


def test_gaps_of_no_visible_marker_are_inf() -> None:
    marker = np.full((5, 5), -1, dtype=np.int32)
    assert np.isinf(np.stack(marker_gaps(marker, np.zeros(3, dtype=np.int64)))).all()


@pytest.mark.parametrize("scattered", [False, True])
def test_gaps_with_one_colour_and_hidden_markers(
    rng: np.random.Generator, *, scattered: bool
) -> None:
    """Blots of any form, some missing; and scattered pixels, where bounding boxes give no bound."""
    owner = np.full((80, 90), -1, dtype=np.int32)
    for marker in range(30):
        if marker % 7:
            top, left = rng.integers(0, 70), rng.integers(0, 80)
            owner[top : top + rng.integers(1, 9), left : left + rng.integers(1, 9)] = marker
    owner[rng.random(owner.shape) < 0.2] = -1
    if scattered:
        owner[:] = -1
        owner[rng.integers(0, 80, 150), rng.integers(0, 90, 150)] = rng.integers(0, 29, 150)
    y, x = np.nonzero(owner >= 0)
    order = np.argsort(owner[y, x], kind="stable")
    starts = np.searchsorted(owner[y, x][order], np.arange(31))
    pixels = np.column_stack([x, y])[order].astype(np.int64)
    for colours in (1, 3):
        colour = np.arange(30) % colours
        for mine, plain in zip(
            outline_gaps(pixels, starts, colour), marker_gaps(owner, colour), strict=True
        ):
            assert np.array_equal(mine, plain)
    assert np.isinf(outline_gaps(pixels, starts, np.zeros(30, dtype=np.int64))[1]).all()
