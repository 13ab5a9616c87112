"""``stand_off_mm = "fit"``: the least distance, also for lenses that look sideways or back."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import LENSES, BrownConrady, Lens
from phytac_design.layout.cameras import fit_distance_mm, fit_stand_off_mm
from phytac_shapes.arrays import FloatArray
from tests.decoder.test_lens import LENS, SIZE, direction
from tests.refusals import refused

RADIUS_MM, FILL, HALF_PX = 29.2, 0.975, 324.0
TURN = np.linspace(0.0, 2.0 * np.pi, 65)
RIM = RADIUS_MM * np.column_stack([np.cos(TURN), np.sin(TURN), 0.0 * TURN])
WIDE = ("kannala_brandt", "bent fisheye", "omnidirectional")


def lens_with(name: str, edge_rad: float) -> Lens:
    """Lens whose image is filled by what lies this far from its axis."""
    unbent = {"kannala_brandt": (), "bent fisheye": (-0.02, 0.002, 0.0, 0.0)}.get(name, (1.2,))
    model = name if name in LENSES else "kannala_brandt"
    unit = LENSES[model](
        width_px=648, height_px=648, fx_px=1.0, fy_px=1.0, cx_px=323.5, cy_px=323.5,
        distortion=unbent,
    )  # fmt: skip
    focal = FILL * HALF_PX / float(unit.radius(np.array([edge_rad]))[0][0])
    return replace(unit, fx_px=focal, fy_px=focal)


def reach_of(lens: Lens, stand_off: float) -> FloatArray:
    camera = Camera.at(lens, z_mm=-stand_off)
    return np.asarray(np.linalg.norm(camera.project(RIM) - camera.centre_px, axis=1))


@pytest.mark.parametrize("name", WIDE)
@pytest.mark.parametrize("field_deg", [150.0, 170.0, 174.0, 175.0, 177.0, 178.0, 179.0, 179.9])
def test_the_rim_fills_the_image_to_a_millionth(name: str, field_deg: float) -> None:
    edge = np.radians(field_deg / 2.0)
    lens = lens_with(name, float(edge))
    stand_off = fit_stand_off_mm(lens, RIM, end=0, start_mm=0.0, fill=FILL)
    assert stand_off == pytest.approx(RADIUS_MM / np.tan(edge), rel=1e-6)
    assert reach_of(lens, stand_off) / HALF_PX == pytest.approx(FILL, rel=1e-6)


@pytest.mark.parametrize("name", WIDE)
@pytest.mark.parametrize("field_deg", [180.5, 190.0, 220.0])
def test_a_lens_that_looks_back_stands_a_little_before_the_rim(name: str, field_deg: float) -> None:
    """No rim before it fills its image."""
    lens = lens_with(name, float(np.radians(field_deg / 2.0)))
    stand_off = fit_stand_off_mm(lens, RIM, end=0, start_mm=0.0, fill=FILL)
    assert stand_off == pytest.approx(0.05 * RADIUS_MM)
    assert reach_of(lens, 1e-3 * RADIUS_MM).max() < FILL * HALF_PX


def test_fit_is_the_least_distance() -> None:
    ring = 29.2 * direction(np.pi / 2.0, np.linspace(0.0, 6.2, 100))
    mild = BrownConrady(**SIZE, distortion=(-0.05, 0.01, 0.0, 0.0))
    for lens in (LENS["pinhole"], mild, LENS["fisheye"], LENS["omni"]):

        def away(distance: float, lens: Lens = lens) -> float:
            off = lens.project(ring + np.array([0.0, 0.0, distance])) - lens.centre_px
            return float(np.linalg.norm(off, axis=1).max())

        best = fit_distance_mm(
            lens, lambda d: ring + np.array([0.0, 0.0, d]), fill=0.6, least_mm=0.1
        )
        assert away(best) == pytest.approx(0.6 * 972.0, rel=1e-9)
        assert not away(best * (1.0 - 1e-6)) <= 0.6 * 972.0
    # A lens whose field ends before that decides itself how near it may come.
    barrel = LENS["barrel"]
    best = fit_distance_mm(barrel, lambda d: ring + np.array([0, 0, d]), fill=1.3, least_mm=0.1)
    assert np.arctan(29.2 / best) == pytest.approx(barrel.field_rad, rel=1e-6)
    far = {"lens": LENS["pinhole"], "fill": 0.9, "least_mm": 1.0}
    needed = 970.0 / (0.9 * 972.0)  # px over px: the distance of a point one mm off the axis
    point = np.array([[1.0, 0.0, 0.0]])
    for share, fits in ((0.999, True), (1.001, False)):

        def reach(distance: float, size: float = share * 1e6 / needed) -> FloatArray:
            return np.asarray(size * point + np.array([0.0, 0.0, distance]))

        if fits:
            assert fit_distance_mm(reach=reach, **far) == pytest.approx(share * 1e6)
        else:
            with refused("camera-fit-unreachable"):
                fit_distance_mm(reach=reach, **far)
    with refused("camera-fit-size-invalid"):
        fit_distance_mm(LENS["pinhole"], lambda d: ring + d, fill=0.9, least_mm=0.0)
    with refused("camera-fit-unreachable"):
        fit_distance_mm(LENS["pinhole"], lambda d: ring * d, fill=0.9, least_mm=1.0)
