"""Lens facts of the check and the page, and the warning about a lens that `fit` puts too close."""

import json
import math
from typing import Any

import numpy as np
import pytest

from phytac_design.core.json_values import finite
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.sharpness import lens_facts, row_groups
from phytac_design.report.report_sections import lens_section
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from tests.optics.cases import Bench, make_design
from tests.refusals import refused

BANDS = 8

FEW = {"rows": 3, "columns": 8, "height_near_mm": 0.5, "height_far_mm": 6.0}


def facts_of(bench: Bench) -> dict[str, Any]:
    return lens_facts(Sensor.of(bench.design, bench.surface, bench.markers), bench.camera)


def page_of(bench: Bench) -> str:
    context = Context(design=bench.design, accuracy=PRESETS["draft"], seed=0)
    return lens_section(context, {"cameras": [{"end": "near", "lens": facts_of(bench)}]})


def test_rows_hold_a_pinholes_scale() -> None:
    bench = Bench(make_design(layout=FEW))
    facts = facts_of(bench)
    p = bench.camera.to_camera(bench.markers.tip_mm)
    assert [row["row"] for row in facts["rows"]] == [0, 1, 2]
    for row in facts["rows"]:
        own = p[bench.markers.row == row["row"]]
        assert row["markers"] == 8
        assert row["mm_per_px_circumferential"] == pytest.approx(own[0, 2] / 242.5)
        radius = np.hypot(own[0, 0], own[0, 1])
        assert row["mm_per_px_axial"] == pytest.approx(own[0, 2] ** 2 / radius / 242.5)
        noise = bench.design.camera.noise_centroid_px
        assert row["noise_radial_mm"] == pytest.approx(noise * row["mm_per_px_radial"])
    assert max(row["blur_px"] for row in facts["rows"]) == pytest.approx(facts["max_blur_px"])


def test_markers_without_rows_are_grouped_along_the_sensor() -> None:
    bench = Bench(make_design(layout={"kind": "phyllotaxis", "count": 60}))
    group = row_groups(bench.markers)
    assert set(np.bincount(group)) <= {7, 8}
    assert len(np.unique(group)) == BANDS
    order = np.argsort(bench.markers.uv[:, 0])
    assert np.all(np.diff(group[order]) >= 0)
    assert len(facts_of(bench)["rows"]) == BANDS


def test_the_check_is_plain_json_and_the_page_has_a_row_each() -> None:
    design = make_design(layout=FEW, camera={"f_number": 64.0})
    report = finite(checkup(design))
    (camera,) = json.loads(json.dumps(report, allow_nan=False))["cameras"]
    assert camera["lens"]["depth_far_mm"] is None
    bench = Bench(design)
    facts = facts_of(bench)
    assert math.isinf(facts["depth_far_mm"])
    html = page_of(bench)
    assert html.count("<tr>") == 1 + 3
    for words in (
        "mm per px, along",
        "noise, inward (mm)",
        f"{facts['focus_mm']:.1f} mm from",
        " on, ",
    ):
        assert words in html
    bench = Bench(make_design(layout=FEW, camera={"focus_mm": 30.0}))
    near = facts_of(bench)
    assert f"to {near['depth_far_mm']:.1f} mm" in page_of(bench)


def test_a_wide_lens_too_close_is_said_with_a_distance_that_works() -> None:
    shape = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 60.0}
    layout = {"rows": 3, "columns": 8, "height_near_mm": 2.0, "height_far_mm": 10.0}
    wide = {"width_px": 648, "height_px": 486, "model": "kannala_brandt", "focal_px": 150.0}
    report = checkup(make_design(shape=shape, layout=layout, camera=wide))
    assert not report["clear"]
    (warning,) = report["warnings"]
    assert "the lens is so wide" in warning
    better = float(warning.split("camera.stand_off_mm = ")[-1].split(":")[0])
    assert better > 1.2 * report["stand_off_mm"]
    again = checkup(make_design(shape=shape, layout=layout, camera=wide | {"stand_off_mm": better}))
    assert again["clear"]
    assert again["warnings"] == []


def test_a_focus_inside_the_lens_is_refused_before_a_build() -> None:
    with refused("focus-within-focal-length"):
        check_design(make_design(layout=FEW, camera={"focus_mm": 0.1}))


def test_blur_as_wide_as_gaps_is_reported_with_a_larger_f_number() -> None:
    layout = {"rows": 8, "columns": 16, "height_near_mm": 0.5, "height_far_mm": 6.0}
    fast = {"width_px": 648, "height_px": 486, "focal_px": 242.5, "pixel_um": 5.6, "f_number": 0.5}
    (warning,) = checkup(make_design(layout=layout, camera=fast))["warnings"]
    assert "the image of a point at marker" in warning
    slower = float(warning.split("raise camera.f_number to ")[1].split(",")[0])
    assert 0.5 < slower <= 64.0
    assert checkup(make_design(layout=layout, camera=fast | {"f_number": slower}))["warnings"] == []
    almost = checkup(make_design(layout=layout, camera=fast | {"f_number": 0.8 * slower}))
    assert len(almost["warnings"]) == 1
