"""Assignment of blobs to markers by the smoothest shifts, on a drawn lattice."""

import numpy as np
import pytest

from phytac_decoder.vision.lattice_matching import directed_edges, smoothest_shifts
from phytac_shapes.arrays import FloatArray, IntArray

ROWS, COLUMNS, PITCH = 12, 14, 10.0
row, column = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
REST = PITCH * np.column_stack([column, row])
COLOUR = (column // 2) % 2
CENTRE = REST.mean(axis=0)


def grid_neighbours() -> IntArray:
    near = np.full((len(REST), 8), -1)
    steps = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    for slot, (a, b) in enumerate(steps):
        ok = (row + a >= 0) & (row + a < ROWS) & (column + b >= 0) & (column + b < COLUMNS)
        near[ok, slot] = ((row + a) * COLUMNS + column + b)[ok]
    return near


NEAR = grid_neighbours()


def bulge(most: FloatArray, sd: float) -> FloatArray:
    gap = np.sum((REST - CENTRE) ** 2, axis=1, keepdims=True)
    return np.asarray(most * np.exp(-0.5 * gap / sd**2))


def assigned(place: FloatArray, keep: IntArray, expected: FloatArray = REST) -> FloatArray:
    """Shifts from blobs of the markers to keep, in a mixed order."""
    order = np.random.default_rng(1).permutation(keep)
    return smoothest_shifts(
        place[order],
        COLOUR[order],
        rest_px=REST,
        expected_px=expected,
        colour=COLOUR,
        neighbours=NEAR,
        spacing_px=np.full(len(REST), PITCH),
    )


ALL = np.arange(len(REST))


@pytest.mark.parametrize("share", [0.3, 0.6, 1.0])
def test_motions_of_up_to_a_pitch_are_named_right(share: float) -> None:
    shift = bulge(share * PITCH * np.array([0.2, 0.98]), sd=25.0)
    found = assigned(REST + shift, ALL)
    np.testing.assert_allclose(found, shift, atol=1e-9)


def test_the_nearest_blob_would_be_anothers() -> None:
    """What the lattice is worth in the largest of these motions."""
    shift = bulge(PITCH * np.array([0.2, 0.98]), sd=25.0)
    gap = np.linalg.norm(REST[:, None] - (REST + shift)[None], axis=2)
    gap[COLOUR[:, None] != COLOUR[None]] = np.inf
    assert np.count_nonzero(np.argmin(gap, axis=1) != ALL) > 10


def test_hidden_markers_take_no_others_blob() -> None:
    hidden = ALL[(np.abs(REST - CENTRE) < 2.1 * PITCH).all(axis=1)]
    shift = bulge(np.array([3.0, 4.0]), sd=30.0)
    found = assigned(REST + shift, np.setdiff1d(ALL, hidden))
    seen = np.isfinite(found[:, 0])
    assert len(hidden) == 16
    assert not seen[hidden].any()
    assert seen.sum() == len(ALL) - len(hidden)
    np.testing.assert_allclose(found[seen], shift[seen], atol=1e-9)


def test_a_slipped_expectation_is_corrected() -> None:
    """A patch that was followed on its neighbours' dots, one pitch off."""
    expected = REST.copy()
    slipped = (np.abs(REST - CENTRE) < 2.1 * PITCH).all(axis=1)
    expected[slipped] += [0.0, PITCH]
    found = assigned(REST, ALL, expected)
    np.testing.assert_allclose(found, 0.0, atol=1e-9)


def test_a_picture_without_blobs_names_none() -> None:
    found = assigned(REST, ALL[:0])
    assert found.shape == REST.shape
    assert np.isnan(found).all()


def test_a_lone_marker_takes_the_nearest_blob() -> None:
    found = smoothest_shifts(
        np.array([[9.0, 0.0], [2.0, 0.0], [1.0, 0.0]]),
        np.array([0, 0, 1]),
        rest_px=np.zeros((1, 2)),
        expected_px=np.zeros((1, 2)),
        colour=np.zeros(1, dtype=np.int64),
        neighbours=np.full((1, 8), -1),
        spacing_px=np.full(1, 200.0),
    )
    np.testing.assert_allclose(found, [[2.0, 0.0]])


def test_edges_go_both_ways() -> None:
    """Also where only one of two markers lists the other."""
    to, of, back = directed_edges(np.array([[1, 2], [-1, -1], [3, 1]]))
    pairs = list(zip(to.tolist(), of.tolist(), strict=True))
    # 3 is no marker.
    assert pairs == [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]
    assert [pairs[k] for k in back] == [(b, a) for a, b in pairs]
