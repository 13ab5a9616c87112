"""Limits that messages name for a user to type."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from phytac_design.design.safe_rounding import at_least, at_most
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.sizes import check_training
from tests.optics.cases import make_design
from tests.refusals import refused


@given(st.floats(1e-3, 1e5), st.sampled_from([1.0, -1.0]))
def test_limits_are_rounded_to_the_safe_side(size: float, sign: float) -> None:
    limit = sign * size
    above, below = float(at_least(limit)), float(at_most(limit))
    step = 10.0 ** (math.floor(math.log10(size)) - 3)
    assert limit - 1e-8 * step <= above < limit + 1.01 * step
    assert limit + 1e-8 * step >= below > limit - 1.01 * step


def test_limits_that_need_few_digits_stay_as_they_are() -> None:
    assert (at_least(0.1 + 0.2), at_most(1.2 - 0.3), at_least(-29.5)) == ("0.3", "0.9", "-29.5")


@pytest.mark.parametrize("field_deg", [168.0, 169.0, 170.0, 171.0])
def test_the_stand_off_that_a_message_names_shows_the_rim(field_deg: float) -> None:
    size = {"model": "kannala_brandt", "width_px": 1280, "height_px": 720}
    camera = size | {"field_of_view_deg": field_deg, "stand_off_mm": 5.0}
    design = make_design(camera=camera)
    with refused("rim-outside-view") as caught:
        cameras_of(design, design.surface())
    named = re.search(r"at least ([\d.]+) mm", str(caught.value))
    assert named
    again = make_design(camera=camera | {"stand_off_mm": float(named[1])})
    cameras_of(again, again.surface())


@pytest.mark.parametrize("diameter_mm", [30.0127, 41.99877])
def test_the_patch_that_a_message_names_passes(diameter_mm: float) -> None:
    shape = {"kind": "cylinder", "diameter_outer_mm": diameter_mm, "length_mm": 60.0}
    design = make_design(shape=shape, training={"patch_radius_max_mm": 40.0})
    with refused("patch-exceeds-sensor") as caught:
        check_training(Sensor(design))
    named = re.search(r"patch_radius_max_mm to ([\d.]+)", str(caught.value))
    assert named
    again = make_design(shape=shape, training={"patch_radius_max_mm": float(named[1])})
    check_training(Sensor(again))
