"""Contacts on every shape: spread by area, jitter by length, inside the edges."""

import numpy as np
import pytest

from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import draw_contacts, switch_states
from tests.test_layout_shapes import SHAPES, designed

JITTER_MM = 1.0


@pytest.mark.parametrize("placement", ["receptor", "anywhere"])
@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_contacts_lie_on_the_surface(shape: str, placement: str) -> None:
    design = designed(shape, "phyllotaxis")
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(3)
    drawn = draw_contacts(
        Sensor.of(design, surface, markers), samples=150, rng=rng, placement=placement
    )
    low, high = surface.domain.T
    inside = (drawn.uv >= low - 1e-9) & (drawn.uv <= high + 1e-9)
    assert (inside | np.array(surface.periodic)).all()
    assert drawn.counts.min() >= 1
    if placement == "receptor":
        points, known = surface.point(drawn.uv), surface.point(markers.uv)
        apart = np.linalg.norm(points[:, None] - known[None], axis=2).min(axis=1)
        assert apart.max() <= JITTER_MM * np.sqrt(2.0) + 1e-6
        assert apart.max() > 0.8 * JITTER_MM
    state = switch_states(Sensor.of(design, surface, markers), drawn)
    assert state.bits.any()


def test_anywhere_is_uniform_by_area_on_a_dome() -> None:
    """On a hemisphere equal areas are equal steps of height (Archimedes)."""
    design = designed("hemisphere", "phyllotaxis", shape_more={"skirt_mm": 0.0})
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(0)
    # One contact a sample: several on so small a dome push each other apart.
    drawn = draw_contacts(
        Sensor.of(design, surface, markers), samples=8000, rng=rng, placement="anywhere", most=1
    )
    z = surface.point(drawn.uv)[:, 2] / 20.0
    count = np.histogram(z, bins=10, range=(0.0, 1.0))[0]
    # χ² of 9 degrees of freedom: 40 is beyond one in a hundred thousand.
    assert float(((count - 800.0) ** 2 / 800.0).sum()) < 40.0


def test_jitter_is_as_long_at_the_pole() -> None:
    pole = 20.0 * np.pi / 2.0
    design = designed(
        "hemisphere", "explicit", shape_more={"skirt_mm": 0.0}, positions=[[pole, 0.0]]
    )
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(2)
    drawn = draw_contacts(Sensor.of(design, surface, markers), samples=400, rng=rng, most=1)
    x, y, _ = surface.point(drawn.uv).T
    # A square of ± 1 mm: standard deviation 1/√3 along both.
    assert x.std() == pytest.approx(JITTER_MM / np.sqrt(3.0), rel=0.1)
    assert y.std() == pytest.approx(JITTER_MM / np.sqrt(3.0), rel=0.1)
    assert max(np.abs(x).max(), np.abs(y).max()) <= JITTER_MM


def test_contacts_anywhere_press_sensing_faces_only() -> None:
    design = designed("cuboid", "straight", shape_more={"faces": ["+y"]})
    surface = design.surface()
    rng = np.random.default_rng(1)
    drawn = draw_contacts(
        Sensor.of(design, surface, make_markers(design, surface)),
        samples=100,
        rng=rng,
        placement="anywhere",
    )
    assert surface.sensing(drawn.uv).all()


def test_one_marker_and_no_room() -> None:
    """A sensor hardly larger than a patch still gets one contact a sample."""
    design = designed("plane", "straight", rows=1, columns=1)
    surface = design.surface()
    markers = make_markers(design, surface)
    drawn = draw_contacts(
        Sensor.of(design, surface, markers), samples=40, rng=np.random.default_rng(0)
    )
    assert (drawn.counts == 1).all()
    assert switch_states(Sensor.of(design, surface, markers), drawn).tripped.any()


def test_jitter_stays_within_the_edges() -> None:
    design = designed("plane", "explicit", positions=[[29.9, -39.9]])
    surface = design.surface()
    markers = make_markers(design, surface)
    rng = np.random.default_rng(0)
    drawn = draw_contacts(Sensor.of(design, surface, markers), samples=100, rng=rng, most=1)
    low, high = surface.domain.T
    assert ((drawn.uv >= low) & (drawn.uv <= high)).all()
    assert (drawn.uv[:, 0] == high[0]).any()
