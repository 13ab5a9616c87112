"""Shares of shaped touches on footprints: closed forms, fine sums, tilings, rims, large patches."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import dblquad

from phytac_design.mechanics.indenter import CYLINDER, FLAT, SPHERE
from phytac_design.mechanics.shell import footprints
from phytac_design.mechanics.shell.footprints import (
    carried_share,
    footprint_shares,
    hertz_disc_share,
    strip_share,
)
from phytac_design.mechanics.shell.pressure import ContactFrames, contact_frames, tangent_frame
from phytac_design.mechanics.shell.pressure_sharing import on_shell_share
from phytac_design.simulation.contacts import Contacts
from phytac_shapes import Plane, Surface
from phytac_shapes.arrays import FloatArray
from tests.mechanics.families import FAMILIES, golden
from tests.mechanics.touches import make_touches
from tests.refusals import refused

KINDS = (FLAT, SPHERE, CYLINDER)
SHEET = Plane(width_mm=80.0, height_mm=80.0)


def one(*numbers: float) -> tuple[FloatArray, ...]:
    return tuple(np.array([number]) for number in numbers)


def test_a_footprint_under_the_middle_of_a_sphere() -> None:
    foot = np.array([0.01, 0.5, 1.0, 2.0, 3.9, 4.0, 7.0])
    want = 1.0 - (1.0 - np.minimum(foot / 4.0, 1.0) ** 2) ** 1.5
    np.testing.assert_allclose(hertz_disc_share(0.0 * foot, 4.0 + 0.0 * foot, foot), want, 1e-11)
    assert hertz_disc_share(*one(11.0, 4.0, 7.0))[0] == pytest.approx(0.0, abs=1e-12)
    # Half of the contact: a footprint with its edge, nearly straight, across the middle.
    assert hertz_disc_share(*one(1e5, 4.0, 1e5))[0] == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize("gap", [0.3, 1.7, 2.3, 4.1, 4.9])
@pytest.mark.parametrize("foot", [0.6, 2.0, 4.4])
def test_a_footprint_anywhere_under_a_sphere(gap: float, foot: float) -> None:
    # Rings of the footprint, not of the contact: another integral, of 2e6 points.
    r, turn = np.meshgrid(
        (np.arange(2000) + 0.5) / 2000 * foot, (np.arange(1000) + 0.5) / 1000 * np.pi
    )
    from_centre = np.sqrt(gap**2 + r**2 + 2.0 * gap * r * np.cos(turn))
    press = np.sqrt(np.maximum(1.0 - (from_centre / 4.0) ** 2, 0.0))
    total = 2.0 * np.sum(press * r) * foot / 2000 * np.pi / 1000
    got = hertz_disc_share(*one(gap, 4.0, foot))[0]
    assert got == pytest.approx(total * 3.0 / (2.0 * np.pi * 16.0), abs=2e-6)


def test_a_footprint_as_wide_as_a_strip() -> None:
    # ∫ √(1 - s²)·2b√(1 - s²) b ds over the whole width: 8b²/3 of the strip's (π/2) b L.
    share = strip_share(*one(3.0, 0.0, 1.5, 20.0, 1.5))[0]
    assert share == pytest.approx(16.0 * 1.5 / (3.0 * np.pi * 20.0), rel=1e-12)
    # All of it, half of it, none of it; and a line.
    assert strip_share(*one(0.0, 0.0, 1.5, 20.0, 10.2))[0] == pytest.approx(1.0, rel=1e-9)
    assert strip_share(*one(1e4, 0.0, 1.5, 20.0, 1e4))[0] == pytest.approx(0.5, abs=1e-5)
    assert strip_share(*one(0.0, 3.6, 1.5, 20.0, 2.0))[0] == 0.0
    assert strip_share(*one(1.0, 0.6, 1e-6, 20.0, 1.0))[0] == pytest.approx(0.08, rel=1e-6)


@pytest.mark.parametrize(
    ("x", "y", "foot"), [(0.3, 0.8, 1.0), (5.1, -0.9, 1.0), (4.0, 2.5, 2.0), (-4.6, 0.4, 3.0)]
)
def test_a_footprint_anywhere_under_a_strip(x: float, y: float, foot: float) -> None:
    b, L = 1.2, 10.0

    def press(t: float, s: float) -> float:
        inside = abs(s) < L / 2.0 and abs(t) < b
        return float(np.sqrt(1.0 - (t / b) ** 2)) if inside else 0.0

    def half(s: float) -> float:
        return float(np.sqrt(max(foot**2 - (s - x) ** 2, 0.0)))

    # Along first, then across: the other order, by another rule.
    total = dblquad(
        press,
        max(x - foot, -L / 2.0),
        min(x + foot, L / 2.0),
        lambda s: max(y - half(s), -b),
        lambda s: max(min(y + half(s), b), y - half(s), -b),
        epsabs=1e-6,
        epsrel=1e-5,
    )[0]
    got = strip_share(*one(x, y, b, L, foot))[0]
    assert got == pytest.approx(total / (0.5 * np.pi * b * L), rel=2e-4)


def pressure(frames: ContactFrames, points: FloatArray) -> FloatArray:
    """Pressure of the first touch at points (n, 3), from its definition."""
    arm = points - frames.at[0]
    chord = np.linalg.norm(arm, axis=1)
    if frames.kind[0] == FLAT:
        return (chord < frames.half_mm[0]) * 1.0
    if frames.kind[0] == SPHERE:
        return np.sqrt(np.maximum(1.0 - (chord / frames.half_mm[0]) ** 2, 0.0))
    x, y = arm @ frames.axis[0], arm @ frames.across[0]
    scale = chord / np.hypot(x, y)
    across = np.sqrt(np.maximum(1.0 - (y * scale / frames.half_mm[0]) ** 2, 0.0))
    return across * (np.abs(x * scale) < frames.length_mm[0] / 2.0)


def summed(surface: Surface, touches: Contacts, marker: FloatArray, foot: float) -> FloatArray:
    """Shares of the first touch on footprints, by a sum over the part of the surface under it."""
    low, high = surface.domain.T
    if surface.periodic[1]:
        low, high = np.stack([low, high]) - [0.0, np.pi - touches.uv[0, 1]]
    frames = contact_frames(surface, touches)
    for count in (150, 400):
        axes = [
            a + (np.arange(count) + 0.5) / count * (b - a) for a, b in zip(low, high, strict=True)
        ]
        uv = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        point = surface.point(uv)
        press = pressure(frames, point) * (surface.normal(uv) @ frames.normal[0] > 0.0)
        under = press > 0.0
        step = 2.0 * (high - low) / count
        low = np.maximum(uv[under].min(axis=0) - step, low)
        high = np.minimum(uv[under].max(axis=0) + step, high)
    press = press[under] * np.sqrt(np.maximum(np.linalg.det(surface.metric(uv[under])), 0.0))
    gap = np.linalg.norm(point[under] - surface.point(marker)[:, None], axis=2)
    return np.asarray((gap < foot) @ press / press.sum())


CASES = [
    ("plane", (0.0, 3.0), 5.0, 0.004),
    ("plane", (-28.0, 39.0), 5.0, 0.012),  # over a corner
    ("cylinder", (40.0, 6.28), 6.0, 0.006),  # on the seam
    ("cylinder", (2.0, 1.0), 6.0, 0.015),  # over the rim
    ("cylinder", (40.0, 1.0), 45.0, 0.01),  # half around the sensor
    ("hemisphere", (47.12, 2.0), 6.0, 0.006),  # on the pole
    ("hemisphere", (20.0, 2.0), 15.0, 0.012),
    ("grip", (33.0, 2.0), 6.0, 0.01),
    ("cuboid", (30.0, 16.0), 7.0, 0.03),  # around an edge
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "uv", "radius", "slack"), CASES)
def test_shares_are_those_of_the_pressure_on_the_face(
    kind: int, name: str, uv: tuple[float, float], radius: float, slack: float
) -> None:
    surface = FAMILIES[name]
    strip = kind == CYLINDER
    touches = make_touches(
        np.array([uv]),
        kind,
        radius_mm=0.3 * radius if strip else radius,
        length_mm=2.5 * radius,
        turn_rad=0.6,
    )
    u, v = (axis[0] for axis in tangent_frame(surface, touches.uv))
    ring = np.arange(10) * 0.65
    step = np.column_stack([np.cos(ring), np.sin(ring)]) * np.linspace(0.0, 0.9, 10)[:, None]
    beside = surface.point(touches.uv) + radius * (step[:, :1] * u + step[:, 1:] * v)
    marker = np.clip(surface.chart(beside), *surface.domain.T)
    foot = min(0.25 * radius, 3.0)
    marker = marker[on_shell_share(surface, marker, 1.05 * foot) == 1.0]
    assert len(marker) >= 2
    got = footprint_shares(surface, touches, marker, foot)[0]
    want = summed(surface, touches, marker, foot)
    assert want.max() > 0.001
    assert np.abs(got - want).max() < slack * want.max() + 2e-4


@pytest.mark.parametrize("kind", KINDS)
def test_a_tiling_of_footprints_carries_it_all(kind: int) -> None:
    # Footprints of as much area as there are points evenly spread: on average each place has one.
    for name in ("cylinder", "hemisphere", "plane"):
        surface = FAMILIES[name]
        marker = golden(surface, 2500, 0.0)
        foot = np.sqrt(surface.area_mm2() / 2500 / np.pi)
        uv = golden(surface, 8, 0.002)
        for radius, length in ((5.0, 22.0), (60.0, 300.0)):
            touches = make_touches(uv, kind, radius_mm=radius, length_mm=length, turn_rad=0.4)
            total = footprint_shares(surface, touches, marker, foot).sum(axis=1)
            # Footprints stick out over rims, by more of a small touch than of a large one.
            assert np.abs(total - 1.0).max() < (0.12 if radius < 10.0 else 0.02)
            assert np.abs(np.median(total) - 1.0) < 0.012


def test_turning_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    marker, angle = rng.uniform(-15.0, 15.0, (80, 2)), 1.1
    c, s = np.cos(angle), np.sin(angle)
    turned = marker @ np.array([[c, -s], [s, c]])  # clockwise in (u, v): v runs that way
    kept = np.array([[0.0, 0.0]])
    size = {"radius_mm": 3.0, "length_mm": 16.0}
    before = footprint_shares(
        SHEET, make_touches(kept, CYLINDER, turn_rad=0.2, **size), marker, 1.3
    )
    after = footprint_shares(
        SHEET, make_touches(kept, CYLINDER, turn_rad=0.2 + angle, **size), turned, 1.3
    )
    assert before.max() > 0.03
    np.testing.assert_allclose(after, before, atol=1e-12)
    tube, uv = FAMILIES["cylinder"], np.array([[40.0, 0.05]])
    marker = golden(tube, 400)
    for kind in KINDS:
        plain = footprint_shares(tube, make_touches(uv, kind, turn_rad=0.3, **size), marker, 1.5)
        around = [0.0, 3.9]
        moved = make_touches(uv + around, kind, turn_rad=0.3, **size)
        np.testing.assert_allclose(
            footprint_shares(tube, moved, marker + around, 1.5), plain, atol=1e-9
        )


def test_what_rims_and_bends_leave_of_a_touch() -> None:
    uv = np.array([[-40.0, 0.0], [-37.0, 5.0], [-40.0, 40.0], [0.0, 0.0]])
    ball = make_touches(uv, SPHERE, radius_mm=6.0)
    t = 0.5  # of Hertz's pressure beyond a straight edge at t radii: 1/2 - 3t/4 + t³/4
    want = [0.5, 1.0 - (0.5 - 0.75 * t + 0.25 * t**3), 0.25, 1.0]
    np.testing.assert_allclose(
        carried_share(SHEET, uv, contact_frames(SHEET, ball)), want, atol=1e-3
    )
    along = make_touches(uv[:2], CYLINDER, radius_mm=4.0, length_mm=24.0, turn_rad=np.pi / 2.0)
    s = 0.75
    beyond = (np.arccos(s) - s * np.sqrt(1.0 - s * s)) / np.pi
    carried = carried_share(SHEET, uv[:2], contact_frames(SHEET, along))
    np.testing.assert_allclose(carried, [0.5, 1.0 - beyond], atol=2e-3)
    across = make_touches(uv[:2], CYLINDER, radius_mm=0.5, length_mm=24.0)
    carried = carried_share(SHEET, uv[:2], contact_frames(SHEET, across))
    np.testing.assert_allclose(carried, [0.5, 15.0 / 24.0], atol=2e-3)
    for kind in (FLAT, SPHERE):  # a point is a point, even on a rim
        point = contact_frames(SHEET, make_touches(uv, kind, radius_mm=0.0))
        np.testing.assert_array_equal(carried_share(SHEET, uv, point), 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_points_lines_and_backs(kind: int) -> None:
    tube = FAMILIES["cylinder"]
    uv = np.array([[40.0, 1.0], [40.0, 1.2], [0.0, 1.0]])
    size = {"radius_mm": 0.0, "length_mm": 1e-9}
    share = footprint_shares(tube, make_touches(uv, kind, **size), uv, 2.0)
    np.testing.assert_allclose(share, np.eye(3), atol=1e-6)
    # The wall behind is within the patch's reach, but faces away.
    large = make_touches(uv[:1], kind, radius_mm=90.0, length_mm=180.0)
    share = footprint_shares(tube, large, np.array([[40.0, 1.0], [40.0, 1.0 + np.pi]]), 2.0)
    assert share[0, 0] > 0.0
    assert share[0, 1] == 0.0


def test_no_contacts_no_markers_and_bad_contacts() -> None:
    tube, marker = FAMILIES["cylinder"], golden(FAMILIES["cylinder"], 50)
    touches = make_touches(marker[:3] + 0.01, SPHERE, radius_mm=4.0)
    assert footprint_shares(tube, touches, marker, 2.0).max() > 0.3
    none = touches.pick(np.zeros(0, dtype=np.int64), [])
    assert footprint_shares(tube, none, marker, 2.0).shape == (0, 50)
    assert footprint_shares(tube, touches, marker[:0], 2.0).shape == (3, 0)
    touches.radius_mm[1] = -1.0
    with refused("contact-radius-negative"):
        footprint_shares(tube, touches, marker, 2.0)


def test_shares_do_not_depend_on_other_contacts() -> None:
    dome = FAMILIES["finger"]
    rng = np.random.default_rng(2)
    uv = rng.uniform(*dome.domain.T, (12, 2))
    marker = golden(dome, 200)
    touches = make_touches(uv, SPHERE, radius_mm=rng.uniform(0.5, 20.0, 12))
    touches.indenter[:6], touches.length_mm[:6] = CYLINDER, 15.0
    both = footprint_shares(dome, touches, marker, 1.5)
    for k in range(12):
        alone = footprint_shares(dome, touches.pick(np.array([k]), [0]), marker, 1.5)
        np.testing.assert_array_equal(alone[0], both[k])


def test_only_near_pairs_are_worked_on(monkeypatch: pytest.MonkeyPatch) -> None:
    tube = FAMILIES["cylinder"]
    uv, marker = golden(tube, 600), golden(tube, 10_000)
    touches = make_touches(uv, SPHERE, radius_mm=5.0, length_mm=20.0, turn_rad=0.5)
    touches.indenter[:300], touches.radius_mm[:300] = CYLINDER, 1.0
    worked: list[int] = []

    def watched(law: Callable[..., FloatArray]) -> Callable[..., FloatArray]:
        def counting(*parts: FloatArray) -> FloatArray:
            worked.append(len(parts[0]))
            return law(*parts)

        return counting

    monkeypatch.setattr(footprints, "hertz_disc_share", watched(hertz_disc_share))
    monkeypatch.setattr(footprints, "strip_share", watched(strip_share))
    share = footprint_shares(tube, touches, marker, 0.7)
    assert len(worked) == 2
    # Of a strip's corners, and of discs just beyond reach, a few feel nothing.
    assert (share > 0.0).sum() <= sum(worked) < 1.1 * (share > 0.0).sum()
