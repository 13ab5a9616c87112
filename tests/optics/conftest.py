"""Fixtures of the optics tests."""

import numpy as np
import pytest

from tests.optics.cases import Bench, make_design


@pytest.fixture(scope="session")
def small() -> Bench:
    """The published sensor at a quarter of the resolution."""
    return Bench(make_design())


@pytest.fixture(scope="session")
def few() -> Bench:
    """Twelve receptors, apart from each other."""
    layout = {"rows": 3, "columns": 4, "height_near_mm": 3.0, "height_far_mm": 6.0}
    return Bench(make_design(layout=layout))


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator."""
    return np.random.default_rng(0)
