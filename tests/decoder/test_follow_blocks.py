"""Windows cut along the borders to their rivals."""

import numpy as np
import pytest

from phytac_decoder.vision import window_batches
from phytac_decoder.vision.colour_codes import COUNT, Picture
from phytac_decoder.vision.window_batches import Block, Cuts, Space

SPOTS, RIVALS, SIDE = 7, 3, 9


def drawn() -> Cuts:
    """Borders of spots in the middle of their windows against rivals all around."""
    rng = np.random.default_rng(2)
    rivals = rng.normal(0.0, 8.0, (SPOTS, RIVALS, 2))
    rivals[-1] = 1e6  # one that stands alone
    return Cuts.between(
        np.full((SPOTS, 2), SIDE // 2) + rng.uniform(-0.5, 0.5, (SPOTS, 2)),
        rivals,
        rng.normal(0.0, 0.5, (SPOTS, RIVALS)),
        np.full(SPOTS, SIDE - 1.0),
    )


@pytest.mark.parametrize("most", [1, 200, 1 << 20])
@pytest.mark.parametrize("stride", [1, 2])
def test_a_pixel_counts_by_the_nearest_border(
    most: int, stride: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(window_batches, "LAY_MOST", most)
    block = Block(
        first=0,
        spots=SPOTS,
        side=SIDE,
        stride=stride,
        paints=[(0, SPOTS, np.zeros((1, COUNT), dtype=np.float32))],
        space=Space.of([(SPOTS, SIDE, stride)]),
        picture=Picture((40, 30)),
    )
    cuts = drawn()
    block.lay(np.arange(SPOTS), cuts, slice(None))
    at = np.arange(0, SIDE, stride)
    for spot in range(SPOTS):
        for row, y in enumerate(at):
            for column, x in enumerate(at):
                counts = min(float(line @ [1.0, x, y]) for line in cuts.lines[spot])
                expected = min(max(counts, 0.0), 1.0)
                assert block.mask[spot, row, column] == pytest.approx(expected, abs=1e-5)
    assert 0.05 < block.mask[:-1].mean() < 0.95
    assert (block.mask[-1] == 1.0).all()
    assert not block.cut[-1]


def test_a_border_lies_half_way_and_is_a_pixel_wide() -> None:
    cuts = Cuts.between(
        np.array([[4.0, 4.0]]), np.array([[[6.0, 0.0]]]), np.zeros((1, 1)), np.array([8.0])
    )
    along = cuts.lines[0, 0] @ np.array([[1.0, 1.0, 1.0], [6.5, 7.0, 7.5], [4.0, 4.0, 4.0]])
    np.testing.assert_allclose(along, [1.0, 0.5, 0.0], atol=1e-6)
    assert cuts.nearest == pytest.approx(3.0)
