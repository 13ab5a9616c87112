"""Outlines, the quick figures and their slopes, against closed forms and independent runs."""

import numpy as np
import pytest

from phytac_design.layout import with_heights
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.study.advice.design_evaluation import evaluate_design
from phytac_design.study.advice.design_variables import rows_of, variables_of, with_fields
from phytac_design.study.advice.local_model import (
    LocalModel,
    contacts_of,
    gaps_px,
    row_sensitivities,
    sensitivities,
)
from phytac_design.study.search.fidelity_levels import band_rings
from phytac_design.study.search.surrogate import FORCE_N
from tests.designs import of_shape
from tests.study.advice.cases import COLUMNS, DRAFT, ROWS, judged_tube, tube


@pytest.fixture(scope="module")
def probe() -> LocalModel:
    return LocalModel(judged_tube(), DRAFT)


def test_gap_of_discs_square_before_the_camera() -> None:
    # Tubes of a flat sheet look at the camera: at the tip each image is a disc of radius f r / z.
    design = of_shape(
        "plane",
        {"width_mm": 60.0, "height_mm": 40.0},
        {
            "kind": "straight", "rows": 2, "columns": 3, "heights": "constant",
            "height_near_mm": 3.0, "colours": ["blue"],
        },
        camera={"focal_px": 233.0},
        receptor={"band_marker_mm": 0.0},
    )  # fmt: skip
    from phytac_design.rules.check import check_design

    sensor = check_design(design)
    markers = sensor.markers
    camera = cameras_of(design, sensor.surface)[0]
    found = gaps_px(camera, band_rings(design, markers), markers.colour)
    apart = np.linalg.norm(markers.tip_mm[:, None] - markers.tip_mm[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    depth = camera.to_camera(markers.tip_mm)[:, 2]
    scale = 233.0 / depth
    assert np.ptp(depth) < 1e-9
    # Circles are 16-gons and directions 64: both within 2 % of the radius.
    assert found == pytest.approx(scale * (apart.min(axis=1) - 2.4), abs=0.02 * 2.4 * scale[0])


def test_probe_takes_the_judged_bound(probe: LocalModel) -> None:
    base = judged_tube()
    contacts = contacts_of(base.sensor)
    assert len(contacts) == ROWS
    bound = base.bound[f"force_N_{FORCE_N:g}"][contacts]
    assert probe.figures(base.design)["force_mean_N"] == pytest.approx(bound.mean(), rel=1e-6)


@pytest.mark.parametrize(
    ("field", "step"),
    [
        ("wall.thickness_mm", 0.02),
        ("material.modulus_MPa", 50.0),
        ("layout.height_far_mm", 0.2),
        pytest.param("camera.focal_px", 5.0, marks=pytest.mark.long),
        ("receptor.diameter_outer_mm", 0.05),
        pytest.param("layout.row_pitch_exponent", 0.01, marks=pytest.mark.long),
    ],
)
def test_slopes_are_those_of_judged_designs(probe: LocalModel, field: str, step: float) -> None:
    base = judged_tube()
    (variable,) = [k for k in variables_of(base.sensor) if k.name == field]
    (slope,) = sensitivities(probe, [variable])
    sides = [
        evaluate_design(with_fields(base.design, variable.fields(sign * step)), DRAFT).figures
        for sign in (1.0, -1.0)
    ]
    for name in ("force_middle_N", "force_mean_N"):
        truth = np.log(sides[0][name] / sides[1][name]) / (2.0 * step)
        # Paint is transferred, short tubes stiffen as they did: 0.2 % of
        # the figure per step of the workshop is what that may cost, or a tenth of the slope.
        room = max(0.1 * abs(truth), 0.002 / variable.step)
        assert slope.rate[name] == pytest.approx(truth, abs=room), name


def test_a_softer_resin_needs_no_solve(probe: LocalModel) -> None:
    base = judged_tube()
    probe.figures(base.design)
    solves = probe.solves
    found = probe.figures(with_fields(base.design, {"material.modulus_MPa": 1100.0}))
    probe.figures(with_fields(base.design, {"layout.height_far_mm": 4.2}))
    assert probe.solves == solves
    truth = evaluate_design(
        with_fields(base.design, {"material.modulus_MPa": 1100.0}), DRAFT
    ).figures
    assert found["force_mean_N"] == pytest.approx(truth["force_mean_N"], rel=2e-3)


def test_rows_add_up_to_all_heights(probe: LocalModel) -> None:
    base = judged_tube()
    row = rows_of(base.sensor)
    found = row_sensitivities(probe, row)
    assert sorted(one.row for one in found) == list(range(ROWS))
    assert [one.share for one in found] == sorted(one.share for one in found)
    # One row raised for itself, by another way: the whole figure with these markers.
    worst = found[0].row
    sides = []
    for rise in (0.5, -0.5):
        height = base.markers.height_mm + np.where(row == worst, rise, 0.0)
        markers = with_heights(base.design, base.surface, base.markers, height)
        sides.append(probe.figures(base.design, markers=markers, held=True)["force_middle_N"])
    here = probe.figures(base.design)["force_middle_N"]
    assert found[0].share == pytest.approx((sides[0] - sides[1]) / (2.0 * here), rel=1e-6)


def test_rows_of_layouts_without_rows() -> None:
    base = judged_tube()
    assert np.array_equal(rows_of(base.sensor), np.repeat(np.arange(ROWS), COLUMNS))
    single = tube(layout={"kind": "phyllotaxis", "count": 30})
    sensor = Sensor(single)
    assert np.array_equal(rows_of(sensor), np.arange(30))
