"""Tips that come out as the force grows: in scenes, plans, frames and points."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import Exposure
from phytac_design.optics.pressed_scene import with_tips
from phytac_design.optics.tip_travel import tip_red
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.simulation.scenario import instance_scatter
from phytac_design.simulation.scenario.draw_plan import draw_plan
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection, parse_scenario
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_design.simulation.switch_law import SwitchLaw
from phytac_shapes.arrays import FloatArray
from tests.designs import changed

NEWTON_PER_mm = 0.7
SENSOR = Sensor(
    changed(
        "cylinder60",
        shape={"length_mm": 50.0},
        layout={"rows": 5, "columns": 8, "height_near_mm": 1.5, "height_far_mm": 6.0},
        camera={"width_px": 864, "height_px": 648, "focal_px": 323.0},
        light={"bar_radius_mm": 2.0},
    )
)
COUNT = SENSOR.markers.count
STROKE_mm = SENSOR.design.switch.stroke_mm


@pytest.fixture(scope="module")
def law() -> SwitchLaw:
    """Springs, each on where the camera counts its tip as out."""
    travel = tip_red(SENSOR).travel_on_mm
    assert np.isfinite(travel).all()
    way = np.array([0.0, STROKE_mm])
    return SwitchLaw(
        on_N=NEWTON_PER_mm * travel,
        curve=np.zeros(COUNT, dtype=np.int64),
        force_N=(NEWTON_PER_mm * way,),
        travel_mm=(way,),
        stroke_mm=STROKE_mm,
        spread=np.full(COUNT, 0.07),
    )


@pytest.fixture(scope="module")
def unit(law: SwitchLaw) -> SensorInstance:
    plain = draw_sensor_instance(SENSOR, SensorInstanceSection(number=0), 0)
    return replace(plain, law=law, on_N=law.on_N, off_N=law.on_N)


@pytest.fixture(scope="module")
def imaging(unit: SensorInstance) -> ImagingModel:
    return ImagingModel(
        SENSOR.design,
        SENSOR.surface,
        unit,
        exposure=Exposure(noise_pixel=2.0),
        views=expected_views(SENSOR),
    )


SOME = np.arange(COUNT) % 4 == 0
"""Tips that are out: where all are, their red is taken for a brighter light."""


def shown(law: SwitchLaw, share: float) -> FloatArray:
    """How far tips are out, some at a share of their thresholds."""
    carried = share * law.on_N * SOME
    return law.out_share(carried, carried > law.on_N, law.on_N)


def test_tips_go_along_their_axis(imaging: ImagingModel) -> None:
    rest, on = imaging.cameras[0].rest, imaging.cameras[0].on
    half = with_tips(rest, on, np.full(COUNT, 0.5))
    assert half.vertices == pytest.approx(0.5 * (rest.vertices + on.vertices))
    whole = with_tips(rest, on, np.ones(COUNT))
    assert whole.vertices == pytest.approx(with_tips(rest, on, np.ones(COUNT) > 0.0).vertices)
    some = np.arange(COUNT) % 2 * 0.5
    moved = (with_tips(rest, on, some).vertices != rest.vertices).any(axis=1)
    assert set((rest.vertex_owner[moved] % 2).tolist()) == {1}


@pytest.mark.parametrize(("share", "on"), [(0.8, False), (1.05, True)])
def test_the_camera_counts_them_as_out_at_the_law_s_force(
    imaging: ImagingModel, law: SwitchLaw, share: float, on: bool
) -> None:
    still = np.zeros((COUNT, 6))
    read = imaging.read(imaging.frame(still, shown(law, share)))
    assert (read.bits[SOME] == on).all()
    assert not read.bits[~SOME].any()


def test_points_have_what_a_tip_half_out_covers(
    imaging: ImagingModel, law: SwitchLaw, monkeypatch: pytest.MonkeyPatch
) -> None:
    still, rest = np.zeros((COUNT, 6)), imaging.at_rest
    # Edges are read where nothing covers them.
    by_colour = replace(rest, bundle=replace(rest.bundle, edges=()))
    monkeypatch.setattr(imaging, "rest", by_colour)
    zero = imaging.read(imaging.frame(still, np.zeros(COUNT)))
    for share in (0.8, 1.1):
        out = shown(law, share)
        frame = imaging.read(imaging.frame(still, out))
        bits = SOME & (share > 1.0)
        assert (frame.bits == bits).all()
        moved = (frame.shift_px - zero.shift_px)[SOME]
        error, plain = (
            np.sqrt(np.mean((imaging.points(still, bits, out=each).shift_px[SOME] - moved) ** 2))
            for each in (out, None)
        )
        assert error < 0.09
        assert error < 0.4 * plain


def test_a_print_of_them_has_no_hysteresis(law: SwitchLaw, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instance_scatter, "switch_law", lambda *_: law)
    drawn = draw_sensor_instance(SENSOR, SensorInstanceSection(number=3), 0)
    assert drawn.law is law
    assert drawn.on_N / law.on_N == pytest.approx(1.0, abs=0.31)
    assert np.std(drawn.on_N / law.on_N) > 0.05
    assert (drawn.off_N == drawn.on_N).all()


def test_plans_say_how_far_tips_are_out(unit: SensorInstance, law: SwitchLaw) -> None:
    own = parse_scenario({"name": "t", "kind": "presses", "touch": {"samples": 40}}, "t")
    got = draw_plan(SENSOR.design, SENSOR.surface, unit, own, seed=3).switching
    assert got.out is not None
    # On is where the tip is farther out than the camera needs.
    needed = law.on_N / NEWTON_PER_mm / STROKE_mm
    assert (got.bits == (got.out > needed)).mean() > 0.999
    partly = (got.out > 0.0) & (got.out < 1.0)
    assert partly.sum() > 20
    snapping = draw_plan(SENSOR.design, SENSOR.surface, replace(unit, law=None), own, seed=3)
    assert snapping.switching.out is None
    assert (snapping.switching.shown == snapping.switching.bits).all()
