"""Shortcuts that give what NumPy's own functions give, to the last bit."""

import numpy as np
import pytest

from phytac_decoder.camera.camera_motion import median
from phytac_decoder.mechanics import response_table


@pytest.mark.parametrize("count", [1, 2, 3, 8, 367, 368])
def test_median_is_that_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)


def test_tangent_coordinates_of_one_point_are_those_among_many() -> None:
    rng = np.random.default_rng(0)
    arm, along, around = rng.normal(size=(3, 40, 3))
    arm[0] = 0.0
    arm[1] = along[1] = [0.0, 0.0, 1.0]
    around[1] = [1.0, 0.0, 0.0]
    among = response_table._tangent_coordinates(arm, along, around)
    for k in range(len(arm)):
        one = response_table._tangent_coordinates(arm[k : k + 1], along[k : k + 1], around[k])
        np.testing.assert_array_equal(one, among[k : k + 1])
