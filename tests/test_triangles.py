import numpy as np
import pytest

from phytac_design.geometry.triangles import distinct_points


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_distinct_points_are_the_unique_rows(kind: type) -> None:
    rng = np.random.default_rng(0)
    points = rng.integers(-2, 3, (500, 3)).astype(kind)
    found, number = distinct_points(points)
    rows, inverse = np.unique(points, axis=0, return_inverse=True)
    np.testing.assert_array_equal(found, rows)
    np.testing.assert_array_equal(number, inverse.reshape(-1))
    assert found.dtype == kind


def test_no_points_are_no_distinct_points() -> None:
    found, number = distinct_points(np.zeros((0, 3)))
    assert (found.shape, number.shape) == ((0, 3), (0,))
