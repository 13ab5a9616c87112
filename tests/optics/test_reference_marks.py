"""Reference marks in the design and before the camera."""

from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.sensor_limits import axial_rotation
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.layout.mark_placement import place_reference_marks
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.render_scene import build_scene, spot_owner
from phytac_design.optics.visibility import check_marks, mark_visibility, marks_advice
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from phytac_design.simulation.imaging.nominal_view import look
from tests.designs import changed, small
from tests.long_cases import TUBES, with_long
from tests.refusals import refused

TWELVE = {"count": 12}


def marked(**tables: Any) -> Design:
    return small(**{"reference_marks": TWELVE, **tables})


def test_a_design_without_marks_keeps_its_hash_and_camera() -> None:
    plain, sized = small(), small(reference_marks={"diameter_mm": 2.0})
    assert design_hash(plain) == design_hash(sized) != design_hash(marked())
    assert Sensor(plain).cameras[0].position_mm[2] == Sensor(sized).cameras[0].position_mm[2]
    # The camera moves back by as much as the marks stand before the wall.
    moved = Sensor(plain).cameras[0].position_mm[2] - Sensor(marked()).cameras[0].position_mm[2]
    assert moved == pytest.approx(marked().reference_marks.reach_mm)


@pytest.mark.parametrize("count", [1, 5, 65])
def test_too_few_marks_and_too_many_are_refused(count: int) -> None:
    with refused("field-invalid"):
        small(reference_marks={"count": count})


def test_marks_that_fit_no_rim_are_refused() -> None:
    with refused("reference-marks-rim"):
        check_design(marked(wall={"rim_length_mm": 2.0}))
    with refused("reference-marks-crowded"):
        check_design(marked(reference_marks={"count": 60}))
    with refused("reference-marks-end"):
        place_reference_marks(
            changed("hemisphere", reference_marks={"count": 12, "ends": "both"}),
            changed("hemisphere").surface(),
        )


def test_marks_lie_on_the_rims_inner_side_and_no_turn_maps_them_onto_themselves() -> None:
    sensor = Sensor(marked(reference_marks={"count": 12, "ends": "both"}))
    marks, wall = sensor.reference_marks, sensor.design.wall
    radius = np.hypot(*marks.outline_mm.reshape(-1, 3)[:, :2].T)
    np.testing.assert_allclose(radius, 30.0 - wall.thickness_mm, atol=1e-3)
    near, far = (marks.outline_mm[marks.end == end, :, 2] for end in (0, 1))
    assert -wall.rim_length_mm < near.min() < near.max() < 0.0
    assert 60.0 < far.min() < far.max() < 60.0 + wall.rim_length_mm
    for own in (marks.point_mm[marks.end == end] for end in (0, 1)):
        for turn in np.arange(1, 24) / 24.0:
            gap = np.linalg.norm(own @ axial_rotation(turn).T - own[:, None], axis=2)
            assert np.count_nonzero(gap.min(axis=0) > 1.0) >= 1, turn


@pytest.mark.parametrize("shape", ["cone", "hemisphere", "plane", "grip"])
def test_marks_of_other_shapes_lie_on_their_rims(shape: str) -> None:
    sensor = Sensor(changed(shape, reference_marks=TWELVE))
    marks = sensor.reference_marks
    rim, t = marks.point_mm, sensor.design.wall.thickness_mm
    beside = sensor.surface.point(marks.edge_uv, -t)
    np.testing.assert_allclose(np.linalg.norm(rim - beside, axis=1), marks.distance_mm, rtol=0.5)
    across = np.linalg.norm(marks.outline_mm - rim[:, None], axis=2)
    np.testing.assert_allclose(across, sensor.design.reference_marks.diameter_mm / 2, rtol=0.25)


def test_every_mark_is_seen_apart_from_the_markers() -> None:
    sensor = Sensor(marked())
    shot = look(sensor, sensor.cameras[0], rng=np.random.default_rng(0))
    assert shot.marks.clear.all()
    assert shot.marks.visible_px.min() > 100
    assert not shot.seen.fused.any()
    assert marks_advice(sensor, shot.marks.clear, shot.marks.visible_px) == ""
    expected = sensor.cameras[0].project(sensor.reference_marks.point_mm)
    np.testing.assert_allclose(shot.expected.marks_px, expected, atol=0.5)


@pytest.mark.parametrize(
    "shape", with_long(("cone", "cuboid", "hemisphere", "plane", "grip"), TUBES)
)
def test_the_camera_of_every_shape_sees_all_marks(shape: str) -> None:
    # Beside a flat wall the nearer row would be hidden by the receptors along the edge.
    gap_mm = 1.5 if shape == "plane" else 0.25
    assert check_marks(Sensor(changed(shape, reference_marks={**TWELVE, "gap_mm": gap_mm}))) == ""


def test_marks_on_a_rim_that_no_camera_sees_are_named() -> None:
    sensor = Sensor(marked(reference_marks={"count": 12, "ends": "far"}))
    camera = sensor.cameras[0]
    scene = build_scene(sensor, tolerance_mm=0.05)
    frame = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)
    seen = mark_visibility(sensor, scene, camera, frame)
    assert not seen.clear.any()
    text = marks_advice(sensor, seen.clear, seen.visible_px)
    assert "12 of 12 reference marks" in text
    assert "far rim" in text


def test_scenes_number_marks_after_the_markers_and_can_leave_them_out() -> None:
    sensor = Sensor(marked())
    count = sensor.markers.count
    painted, bare = (build_scene(sensor, tolerance_mm=0.05, marks=on) for on in (True, False))
    assert (painted.marks, bare.marks) == (12, 0)
    owners = np.unique(spot_owner(painted.part, count))
    assert owners.tolist() == list(range(-1, count + 12))
    assert bare.part.min() >= 0
    assert len(painted.spot_colour) == count + 12


def test_the_review_of_a_design_names_hidden_marks() -> None:
    good, bad = checkup(marked()), checkup(marked(reference_marks={"count": 12, "ends": "far"}))
    assert good["clear"]
    assert good["advice"] == ""
    assert not bad["clear"]
    assert "12 of 12 reference marks" in bad["advice"]
