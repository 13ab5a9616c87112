"""Virtual prints: repeatable, apart from each other, consistent in themselves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.simulation.scenario import instance_scatter
from phytac_design.simulation.scenario.instance_scatter import (
    _mounted,
    _wall,
    cut_normal,
    draw_sensor_instance,
)
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.sensor_instance import SensorInstance, thickness_factor
from phytac_shapes.arrays import FloatArray
from tests.designs import changed
from tests.test_layout_shapes import designed

HEIGHT_SHARE_MIN = 0.2

CUT_SD = 3.0

DESIGN = changed("cylinder40")
SURFACE = DESIGN.surface()
MARKERS = make_markers(DESIGN, SURFACE)
CAMERAS = cameras_of(DESIGN, SURFACE)
SDS = (
    "thickness_share", "thickness_wave_share", "modulus_share", "marker_mm", "height_mm",
    "threshold_share", "release_scatter", "camera_mm", "camera_deg", "focal_share", "paint_share",
)  # fmt: skip


def unit(number: int = 1, seed: int = 4, **section: Any) -> SensorInstance:
    return draw_sensor_instance(
        Sensor.of(DESIGN, SURFACE, MARKERS), SensorInstanceSection(number=number, **section), seed
    )


def arrays(print_: SensorInstance) -> dict[str, FloatArray]:
    """Everything that scatters, by the standard deviation that rules it."""
    camera = print_.cameras[0]
    return {
        "thickness_share": np.array([print_.wall.mean]),
        "thickness_wave_share": print_.wall.waves,
        "modulus_share": np.array([print_.modulus]),
        "marker_mm": print_.markers.uv,
        "height_mm": print_.markers.height_mm,
        "threshold_share": print_.on_N,
        "release_scatter": print_.off_N / print_.on_N,
        "camera_mm": camera.position_mm,
        "camera_deg": camera.rotation,
        "focal_share": np.array([camera.lens.fx_px, camera.lens.fy_px]),
        "paint_share": print_.paint,
    }


def grid(count: int = 60) -> FloatArray:
    low, high = SURFACE.domain.T
    share = np.stack(np.meshgrid(*[np.linspace(0, 1, count, endpoint=False)] * 2), -1)
    return np.asarray(low + share.reshape(-1, 2) * (high - low))


def test_number_zero_is_the_design_itself() -> None:
    own = unit(0)
    assert own.markers is MARKERS
    assert (own.on_N == thresholds_N(DESIGN, MARKERS)).all()
    assert own.off_N == pytest.approx(own.on_N * 0.4 / 0.5, rel=1e-12)
    assert (thickness_factor(own.wall, grid()) == 1.0).all()
    assert own.modulus == 1.0
    assert (own.paint == 1.0).all()
    assert own.paint.shape == (len(DESIGN.layout.colours) + 1, 3)
    for camera, known in zip(own.cameras, CAMERAS, strict=True):
        assert camera.lens == known.lens
        assert (camera.position_mm == known.position_mm).all()
        assert (camera.rotation == known.rotation).all()


def test_a_print_is_the_same_each_time_and_unlike_others() -> None:
    first, again = arrays(unit()), arrays(unit())
    for name, array in first.items():
        assert (array == again[name]).all(), name
    for other in (unit(2), unit(seed=5)):
        for name, array in arrays(other).items():
            assert not np.array_equal(array, first[name]), name


@pytest.mark.parametrize("name", SDS)
def test_each_deviation_has_numbers_of_its_own(name: str) -> None:
    """One at zero: that property is as designed, every other one as before."""
    first, other, plain = arrays(unit()), arrays(unit(1, 4, **{name: 0.0})), arrays(unit(0))
    for key, array in other.items():
        if key != name:
            assert array == pytest.approx(first[key], rel=1e-12, abs=1e-12), key
        elif key == "thickness_wave_share":
            assert (array[:, 0] == 0.0).all()
        else:
            assert array == pytest.approx(plain[key], rel=1e-12), key


def test_deviations_are_those_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over 100 prints; the standard error of a standard deviation is 7 %, cut ones are 1 % low."""
    monkeypatch.setattr(
        instance_scatter, "cameras_of", lambda *_: CAMERAS
    )  # the same for every print
    section = SensorInstanceSection()
    prints = [unit(k) for k in range(1, 101)]
    camera = CAMERAS[0]
    seen = {
        "modulus_share": [p.modulus - 1.0 for p in prints],
        "thickness_share": [p.wall.mean - 1.0 for p in prints],
        "focal_share": [p.cameras[0].focal_px / camera.focal_px - 1.0 for p in prints],
        "camera_mm": [p.cameras[0].position_mm - camera.position_mm for p in prints],
        "paint_share": [p.paint - 1.0 for p in prints],
        "height_mm": [p.markers.height_mm - MARKERS.height_mm for p in prints],
        "threshold_share": [p.on_N / 0.5 - 1.0 for p in prints],
        "camera_deg": [
            np.degrees(_vector(p.cameras[0].rotation @ camera.rotation.T)) for p in prints
        ],
    }
    for name, values in seen.items():
        size = getattr(section, name)
        z = np.array(values) / size
        assert z.std() == pytest.approx(0.987, rel=0.28), name
        assert abs(float(z.mean())) < 4.0 / np.sqrt(100), name
        assert np.abs(z).max() <= CUT_SD + 1e-6, name
        assert np.abs(z).max() > 1.9, name


def _vector(turn: FloatArray) -> FloatArray:
    """Rotation vector of a small turn (to its cube)."""
    skew = (turn - turn.T) / 2.0
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def test_cut_normals_have_no_outliers() -> None:
    z = cut_normal(np.random.default_rng(0), 200_000)
    assert np.abs(z).max() <= CUT_SD
    # Variance of a normal cut at ±3: 1 - 2·3·φ(3)/(2Φ(3) - 1).
    assert z.var() == pytest.approx(0.9733, abs=0.01)


SHAPES = ("cylinder", "cone", "cuboid", "hemisphere", "plane", "patch", "grip")


@pytest.mark.parametrize("kind", SHAPES)
def test_receptors_move_by_lengths_within_the_edges(kind: str) -> None:
    design = designed(kind, "phyllotaxis")
    surface = design.surface()
    markers = make_markers(design, surface)
    section = SensorInstanceSection(number=1, marker_mm=0.2)
    moved = draw_sensor_instance(Sensor.of(design, surface, markers), section, 0).markers
    low, high = surface.domain.T
    inside = (moved.uv >= low) & (moved.uv <= high)
    assert (inside | np.array(surface.periodic)).all()
    step = surface.point(moved.uv) - surface.point(markers.uv)
    size = np.linalg.norm(step, axis=1) / 0.2
    # Two normals cut at 3: a root mean square of 0.987·√2, at most 3√2.
    assert size.max() <= CUT_SD * np.sqrt(2.0) + 1e-3
    rms = float(np.sqrt((size**2).mean()))
    assert rms == pytest.approx(1.39, rel=5.0 / np.sqrt(4 * markers.count))
    assert np.abs(np.sum(step * markers.normal, axis=1)).max() < 0.1
    assert surface.sensing(moved.uv).all()
    assert moved.lattice is None
    for name in ("row", "column", "colour", "neighbours"):
        assert (getattr(moved, name) == getattr(markers, name)).all()


@pytest.mark.parametrize(
    ("direction", "tilt_deg"), [("normal", 0.0), ("tilted", 25.0), ("axis", 0.0)]
)
def test_a_printed_receptor_is_that_of_a_layout_with_its_place_and_height(
    direction: str, tilt_deg: float
) -> None:
    lean = {"direction": direction, "tilt_deg": tilt_deg}
    design = changed("cone", receptor=lean)
    surface = design.surface()
    markers = make_markers(design, surface)
    moved = draw_sensor_instance(
        Sensor.of(design, surface, markers), SensorInstanceSection(number=2), 0
    ).markers
    # The explicit layout numbers along u: hand it the receptors in that order.
    order = np.argsort(moved.uv[:, 0], kind="stable")
    layout = {
        "kind": "explicit",
        "positions": moved.uv[order].tolist(),
        "position_heights_mm": moved.height_mm[order].tolist(),
    }
    own = _explicit(design, layout)
    for item in ("uv", "normal", "direction", "mid_mm", "base_mm", "tip_mm"):
        assert getattr(own, item) == pytest.approx(getattr(moved, item)[order], abs=1e-9), item


def _explicit(design: Design, layout: dict[str, Any]) -> Markers:
    data = design.model_dump(mode="json")
    keep = {key: data["layout"][key] for key in ("colours",)}
    new = Design.model_validate(data | {"layout": keep | layout})
    return make_markers(new, new.surface())


def test_a_lattice_stays_where_receptors_stay() -> None:
    assert MARKERS.lattice is not None
    assert unit().markers.lattice is None
    still = unit(marker_mm=0.0).markers
    assert still.lattice is MARKERS.lattice
    assert (still.uv == MARKERS.uv).all()
    length = np.linalg.norm(still.tip_mm - still.base_mm, axis=1)
    assert length == pytest.approx(still.height_mm, rel=1e-12)


def test_receptors_keep_some_height_and_switches_their_order() -> None:
    rough = unit(height_mm=10.0, threshold_share=0.3, release_share=0.95, release_scatter=0.3)
    assert (rough.markers.height_mm >= HEIGHT_SHARE_MIN * MARKERS.height_mm - 1e-12).all()
    assert (rough.on_N > 0.0).all()
    assert (rough.off_N <= rough.on_N).all()
    assert (rough.off_N == rough.on_N).any()


def test_a_release_share_of_the_file_counts_for_the_design_too() -> None:
    own = unit(0, release_share=0.5)
    assert own.off_N == pytest.approx(0.5 * own.on_N, rel=1e-12)


def test_walls_have_the_given_scatter_and_close_at_the_seam() -> None:
    for number in range(1, 20):
        field = _wall(SURFACE, SensorInstanceSection(number=number), 4)
        factor = thickness_factor(field, grid())
        # Waves of half cycles are not quite square to each other.
        assert (factor / field.mean).std() == pytest.approx(0.03, rel=0.35)
        edge = np.column_stack([np.linspace(0.0, 80.0, 50), np.zeros(50)])
        turned = edge + np.array([0.0, float(np.ptp(SURFACE.domain[1]))])
        assert thickness_factor(field, edge) == pytest.approx(
            thickness_factor(field, turned), rel=1e-12
        )


def test_the_wildest_wall_is_still_a_wall() -> None:
    wild = [
        SensorInstanceSection(number=k, thickness_share=0.15, thickness_wave_share=0.15)
        for k in range(1, 100)
    ]
    least = min(thickness_factor(_wall(SURFACE, section, 4), grid(30)).min() for section in wild)
    assert 0.2 < least < 0.6


def test_a_wall_is_smooth_at_a_pole() -> None:
    """One thickness there, from whichever side one comes, and no cusp."""
    surface = changed("hemisphere").surface()
    (u0, u1), (v0, v1) = surface.domain
    for number in range(1, 10):
        field = _wall(surface, SensorInstanceSection(number=number), 0)
        v = np.linspace(v0, v1, 20)
        pole = thickness_factor(field, np.column_stack([np.full(20, u1), v]))
        assert np.ptp(pole) < 1e-12
        step = 1e-4 * (u1 - u0)
        near = thickness_factor(field, np.array([[u1 - step, 0.0]]))[0]
        assert abs(near - pole[0]) < 1e-6
        assert np.ptp(thickness_factor(field, np.column_stack([np.linspace(u0, u1, 20), v]))) > 1e-3


def test_cameras_turn_and_focus() -> None:
    moved = unit(camera_deg=2.0, focal_share=0.05).cameras[0]
    assert moved.rotation @ moved.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(moved.rotation) == pytest.approx(1.0, abs=1e-12)
    lens, known = moved.lens, CAMERAS[0].lens
    assert lens.fx_px / known.fx_px == pytest.approx(lens.fy_px / known.fy_px, rel=1e-12)
    assert lens.fx_px != known.fx_px
    assert (lens.cx_px, lens.width_px) == (known.cx_px, known.width_px)


def test_a_camera_turns_about_its_own_axes() -> None:
    """A roll spins the image about its centre; pitch and yaw move what lies on the optical axis."""
    aside = Rotation.from_euler("xyz", [70.0, -35.0, 20.0], degrees=True).as_matrix()
    camera = replace(CAMERAS[0], rotation=aside)
    ahead = camera.position_mm + 50.0 * aside[2]
    points = ahead + np.random.default_rng(0).uniform(-10.0, 10.0, (20, 3))
    centre = np.array(camera.centre_px)
    turn = 0.1
    before = camera.project(points) - centre

    def turned(*vector: float) -> Camera:
        return _mounted(camera, step_mm=np.zeros(3), turn_rad=np.array(vector), focal=1.0)

    after = turned(0.0, 0.0, turn).project(points) - centre
    c, s = np.cos(turn), np.sin(turn)
    np.testing.assert_allclose(after, before @ np.array([[c, s], [-s, c]]), atol=1e-8)
    step = camera.focal_px * np.tan(turn)
    for vector, expected in (((turn, 0.0, 0.0), (0.0, -step)), ((0.0, turn, 0.0), (step, 0.0))):
        moved = turned(*vector).project(ahead[None])[0] - centre
        np.testing.assert_allclose(moved, expected, atol=1e-8)


def test_two_cameras_move_apart() -> None:
    design = changed("cylinder40", camera={"ends": "both"})
    surface = design.surface()
    markers = make_markers(design, surface)
    near, far = draw_sensor_instance(
        Sensor.of(design, surface, markers), SensorInstanceSection(number=1), 0
    ).cameras
    first, last = cameras_of(design, surface)
    assert not np.allclose(near.position_mm - first.position_mm, far.position_mm - last.position_mm)
    assert _vector(near.rotation @ first.rotation.T) != pytest.approx(
        _vector(far.rotation @ last.rotation.T)
    )


def test_properties_do_not_share_random_numbers() -> None:
    """On a cylinder u is a length: the steps along can be read off exactly."""
    moved = unit().markers
    along = (moved.uv[:, 0] - MARKERS.uv[:, 0]) / 0.05
    taller = (moved.height_mm - MARKERS.height_mm) / 0.05
    switches = (unit().on_N / 0.5 - 1.0) / 0.1
    drawn = np.concatenate([along, taller, switches]).round(9)
    assert len(np.unique(drawn)) == len(drawn)


def test_receptors_stay_on_faces_that_sense() -> None:
    design = changed("cuboid", shape={"faces": ["+y"]})
    surface = design.surface()
    markers = make_markers(design, surface)
    section = SensorInstanceSection(number=1, marker_mm=5.0)
    moved = draw_sensor_instance(Sensor.of(design, surface, markers), section, 0).markers
    assert surface.sensing(moved.uv).all()
    stayed = (moved.uv == markers.uv).all(axis=1)
    assert 0 < stayed.sum() < markers.count
