"""Shares of contacts on switches, computed for one sensor, are those of any contact."""

import numpy as np
import pytest

from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import CYLINDER, FLAT, SPHERE, Indentations
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.run.switch_loads import SwitchLoads
from tests.designs import drawn
from tests.refusals import refused


def patch(uv: list[float], radius_mm: float, indenter: int) -> Indentations:
    return Indentations(
        uv=np.array([uv]),
        radius_mm=np.array([radius_mm]),
        force_N=np.ones(1),
        indenter=np.array([indenter]),
        length_mm=np.array([4.0 if indenter == CYLINDER else 0.0]),
        turn_rad=np.zeros(1),
        friction=np.zeros((1, 2)),
    )


@pytest.mark.parametrize("kind", ["cylinder", "cuboid", "hemisphere", "plane"])
def test_shares_are_those_of_the_general_function(kind: str) -> None:
    sensor, rng = Sensor(drawn(kind, 3)), np.random.default_rng(3)
    surface, marker_uv = sensor.surface, sensor.markers.uv
    loads, (low, high) = SwitchLoads(surface, marker_uv, 2.5), surface.domain.T
    quick = 0
    for number in range(60):
        own = patch(
            (low + (high - low) * rng.uniform(size=2)).tolist(),
            float(rng.uniform(0.2, 3.0)),
            (FLAT, SPHERE, CYLINDER)[number % 3],
        )
        point, normal = surface.point(own.uv), surface.normal(own.uv)
        found = loads.shares(own, point, normal)
        assert found == pytest.approx(
            footprint_shares(surface, own, marker_uv, 2.5), rel=1e-9, abs=1e-9
        )
        quick += loads._plain(own, point, normal)
    # Rims and edges are left to the general function, most of the face is not.
    assert 10 <= quick <= 40


def test_a_bad_patch_is_rejected() -> None:
    sensor = Sensor(drawn("cylinder", 3))
    loads = SwitchLoads(sensor.surface, sensor.markers.uv, 2.5)
    own = patch([float("nan"), 1.0], 2.0, FLAT)
    with refused("contact-not-finite"):
        loads.shares(own, np.zeros((1, 3)), np.ones((1, 3)))
