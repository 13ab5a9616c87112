"""The part of a sensor that a scene is about."""

import numpy as np
import pytest

from phytac_design.design.scene import SceneRegionSection
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import draw_contacts
from phytac_design.simulation.scenario.scene_scope import Scope, windows_of
from phytac_design.simulation.turned_places import rings
from tests.designs import changed, small
from tests.refusals import refused

MARGIN_SPACINGS = 3.0


def scope_on(design: Design, *regions: SceneRegionSection) -> Scope:
    surface = design.surface()
    return Scope(
        surface=surface,
        windows=windows_of(surface, regions),
        reach_mm=7.0,
        footprint_mm=design.switch.footprint_diameter_mm / 2.0,
    )


SEAM = SceneRegionSection(along=(0.4, 0.6), around=(0.9, 0.1))


def test_share_of_area_and_seam() -> None:
    scope = scope_on(small(), SEAM)
    assert scope.share == pytest.approx(0.04, rel=0.06)
    surface = scope.surface
    (u0, u1), (v0, v1) = surface.domain
    middle = (u0 + u1) / 2.0
    uv = np.array([[middle, v0], [middle, v0 + 0.95 * (v1 - v0)], [middle, (v0 + v1) / 2.0]])
    assert scope.holds(uv).tolist() == [True, True, False]


def test_receptors_in_play_are_those_that_contacts_trip() -> None:
    design = small()
    scope = scope_on(design, SEAM)
    markers = make_markers(design, scope.surface)
    played = scope.in_play(markers)
    assert 0 < played.sum() < markers.count // 3
    # By hand: chords from each receptor to a fine grid of the region.
    (u0, u1), (v0, v1) = scope.surface.domain
    u = u0 + np.linspace(0.4, 0.6, 201) * (u1 - u0)
    v = v0 + np.linspace(-0.1, 0.1, 401) % 1.0 * (v1 - v0)
    grid = scope.surface.point(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    for marker, point in enumerate(scope.surface.point(markers.uv)):
        away = np.linalg.norm(grid - point, axis=1).min()
        reach = scope.reach_mm + scope.footprint_mm
        if abs(away - reach) > 0.2:
            assert played[marker] == (away < reach)


def test_places_near_hold_all_that_the_cubics_inside_are_fitted_to() -> None:
    from phytac_decoder.mechanics.response_table import FIT_PLACES

    design = small()
    scope = scope_on(design, SEAM)
    spacing = 3.0
    ring = rings(scope.surface, spacing, 14)
    kept = scope.near(spacing, ring.uv)
    assert 0.03 < kept.mean() < 0.5
    point = scope.surface.point(ring.uv)
    for place in np.flatnonzero(scope.holds(ring.uv)):
        nearest = np.argsort(np.linalg.norm(point - point[place], axis=1), kind="stable")[
            :FIT_PLACES
        ]
        assert kept[nearest].all()
    assert not kept[scope.distance_mm(ring.uv) > MARGIN_SPACINGS * spacing].any()


def test_contacts_are_drawn_inside() -> None:
    design = small()
    scope = scope_on(design, SEAM)
    markers = make_markers(design, scope.surface)
    for placement in ("receptor", "anywhere"):
        contacts = draw_contacts(
            Sensor.of(design, scope.surface, markers),
            samples=40,
            rng=np.random.default_rng(0),
            placement=placement,
            most=1,
            inside=scope.holds,
        )
        assert len(contacts.force_N) == 40
        assert scope.holds(contacts.uv).all()
    with refused("no-contact-drawn"):
        draw_contacts(
            Sensor.of(design, scope.surface, markers),
            samples=1,
            rng=np.random.default_rng(0),
            inside=lambda uv: np.zeros(len(uv), dtype=np.bool_),
        )


def test_presses_lie_inside_and_in_one_sector() -> None:
    design = small()
    around = scope_on(design, SceneRegionSection(along=(0.3, 0.7)))
    markers = make_markers(design, around.surface)
    gap = np.linspace(3.0, 9.0, markers.count)
    sector = around.presses(around.surface, markers, gap, 24, repeats=True)
    assert around.holds(sector).all()
    # As dense as 24 in a whole sector: two fifths of it.
    assert 8 <= len(sector) <= 12
    # No two are turned copies of one another.
    assert markers.lattice is not None
    turned = np.mod(sector[:, 1], markers.lattice.pitch_v)
    aside = np.abs(turned[:, None] - turned)
    aside = np.minimum(aside, markers.lattice.pitch_v - aside)
    apart = np.hypot(aside, np.abs(sector[:, 0, None] - sector[:, 0]))
    assert apart[~np.eye(len(sector), dtype=np.bool_)].min() > 1e-6
    alone = scope_on(design, SEAM)
    assert len(alone.presses(alone.surface, markers, gap, 24)) == 4
    tightest = np.flatnonzero(alone.holds(markers.uv))[0]
    found = alone.presses(alone.surface, markers, gap, 24)
    assert np.abs(found - markers.uv[tightest]).sum(axis=1).min() < 1e-9
    between = scope_on(design, SceneRegionSection(along=(0.0, 1e-3), around=(0.0, 1e-3)))
    with refused("scene-without-receptors"):
        between.presses(between.surface, markers, gap, 24)


def test_an_open_surface_has_no_seam() -> None:
    plane = changed("plane").surface()
    with refused("range-over-open-seam") as caught:
        windows_of(plane, (SEAM,))
    caught.match(r"regions\.0\.around")
