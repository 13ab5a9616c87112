"""Windows cut along the borders to their rivals."""

import numpy as np
import pytest

from phytac_decoder.pipeline.tracker import _extent
from phytac_decoder.vision.windows import WindowGroup, border_lines

SPOTS, RIVALS, SIDE = 7, 3, 9


@pytest.mark.parametrize("stride", [1, 2])
def test_a_pixel_counts_by_the_nearest_border(stride: int) -> None:
    """Spots in the middle of their windows, with rivals all around."""
    rng = np.random.default_rng(2)
    rivals = rng.normal(0.0, 8.0, (SPOTS, RIVALS, 2))
    rivals[-1] = 1e6  # one that stands alone
    lines = border_lines(SIDE // 2 + rng.uniform(-0.5, 0.5, (SPOTS, 2)), rivals)
    tables = np.zeros((1, 1 << 16), dtype=np.float32)
    spots = np.arange(SPOTS)
    group = WindowGroup(spots, np.zeros_like(spots), SIDE, stride, tables)
    group.cut(spots, lines)
    at = np.arange(0, SIDE, stride)
    mask = group.mask.reshape(SPOTS, len(at), len(at))
    for spot in range(SPOTS):
        for row, y in enumerate(at):
            for column, x in enumerate(at):
                counts = min(float(line @ [1.0, x, y]) for line in lines[spot])
                expected = min(max(counts, 0.0), 1.0)
                assert mask[spot, row, column] == pytest.approx(expected, abs=1e-5)
    assert 0.05 < mask[:-1].mean() < 0.95
    assert (mask[-1] == 1.0).all()


def test_a_border_lies_half_way_and_is_a_pixel_wide() -> None:
    lines = border_lines(np.array([[4.0, 4.0]]), np.array([[[6.0, 0.0]]]))
    along = lines[0, 0] @ np.array([[1.0, 1.0, 1.0], [6.5, 7.0, 7.5], [4.0, 4.0, 4.0]])
    np.testing.assert_allclose(along, [1.0, 0.5, 0.0], atol=1e-6)


def test_a_marker_without_paint_has_the_extent_of_its_neighbours() -> None:
    # Half widths 4.5 and 6.5 px, and 40.5 px of one whose paint runs into another's.
    place = np.array([[20.0, 20.0], [50.0, 20.0], [80.0, 20.0], [200.0, 20.0]])
    half = {0: 4, 1: 6, 3: 40}
    xy = np.array([[place[k, 0] + side * w, 20] for k, w in half.items() for side in (-1, 1)])
    owner = np.repeat(list(half), 2)
    neighbours = np.array([[1, 2, -1], [0, 2, -1], [0, 1, -1], [0, 1, -1]])
    got = _extent(xy.astype(np.int64), owner, place, neighbours)
    assert got == pytest.approx([4.5, 6.5, 5.5, 1.5 * 5.5])
