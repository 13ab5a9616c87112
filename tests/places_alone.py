"""The estimator ``auto`` without its average over places, for tests of what is beside it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation import place_average


@contextmanager
def places_alone() -> Iterator[None]:
    """Each contact at its best place alone: a quarter of the time, and worse near rims.

    In a cache of its own: no other test takes what is decoded so for the exact result.
    """
    never = replace(place_average.SETTINGS, force_share=np.inf, log_switches_min=-np.inf)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(place_average, "SETTINGS", never)
        patch.setenv("PHYTAC_CACHE", os.environ["PHYTAC_CACHE"] + "-places-alone")
        yield
