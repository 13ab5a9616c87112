"""What the 3-D shell and the map are given: places, colours, scales, and the still picture."""

import base64
import json
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.paint import PAINTS
from phytac_design.optics.render_scene import build_scene
from phytac_design.report.viewer import assets, still
from phytac_design.report.viewer.data import Colouring, base_colourings, eye_of, viewer_data
from tests.designs import DRAWN, drawn, small


def decoded(text: str, kind: str) -> Any:
    return np.frombuffer(base64.b64decode(text), kind)


def places(data: dict[str, Any], text: str) -> Any:
    counts = decoded(text, "<u2").reshape(-1, 3)
    return np.array(data["box"]["low"]) + np.array(data["box"]["step"]) * counts


@pytest.mark.parametrize("kind", sorted(DRAWN))
def test_places_are_those_of_the_sensor(kind: str) -> None:
    design = drawn(kind, 5)
    surface = design.surface()
    markers = make_markers(design, surface)
    cameras = cameras_of(design, surface)
    data = json.loads(
        json.dumps(
            viewer_data(
                Sensor.of(design, surface, markers), base_colourings(markers), cameras=cameras
            ),
            allow_nan=False,
        )
    )
    half = np.array(data["box"]["step"]) / 2.0 + 1e-9
    assert half.max() < 0.002
    for name, expected in (("foot", markers.base_mm), ("tip", markers.tip_mm)):
        assert (np.abs(places(data, data["tubes"][name]) - expected) <= half).all()
    low, high = surface.bounds_mm()
    wall = data["bodies"][0]
    assert wall["name"] == "wall"
    points = places(data, wall["points"])
    room = design.wall.rim_length_mm + design.wall.rim_flange_mm + 1.0
    assert (points > low - room).all()
    assert (points < high + room).all()
    assert np.ptp(points, axis=0).max() > 0.9 * np.ptp([low, high], axis=0).max()
    triangles = decoded(wall["triangles"], "<u4").reshape(-1, 3)
    assert triangles.max() < len(points)
    lines = places(data, data["lines"]).reshape(-1, 2, 3)
    starts = lines[: len(lines) // 2, 0]
    assert np.abs(starts - cameras[0].position_mm).max() <= half.max()
    # The view starts where the tips are seen: before sheets and domes, beside tubes.
    eye = np.array(data["eye"])
    assert np.linalg.norm(eye) == pytest.approx(1.0, abs=1e-3)
    facing = (markers.normal @ eye < 0.0).mean()
    assert facing > (0.3 if data["wall"] == "cut" and kind != "hemisphere" else 0.7)


@pytest.mark.parametrize("kind", ["cylinder", "hemisphere"])
def test_triangles_of_the_wall_face_outwards(kind: str) -> None:
    design = drawn(kind, 6)
    surface = design.surface()
    markers = make_markers(design, surface)
    data = viewer_data(Sensor.of(design, surface, markers), base_colourings(markers))
    wall = data["bodies"][0]
    points = places(data, wall["points"])
    corners = points[decoded(wall["triangles"], "<u4").reshape(-1, 3)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    middle = corners.mean(axis=1)
    # Away from the axis of a tube; away from a point inside of a dome. Ends of rims stand across.
    inside = np.zeros(3) if kind == "hemisphere" else np.array([0.0, 0.0, 1.0]) * middle
    away = middle - inside
    clear = np.abs(np.einsum("ti,ti->t", normal, away)) > 0.3 * np.linalg.norm(away, axis=1)
    assert clear.mean() > 0.8
    assert (np.einsum("ti,ti->t", normal, away)[clear] > 0.0).all()


def test_scales_leave_out_what_is_not_known() -> None:
    plain = Colouring(key="a", label="a", values=np.array([np.nan, 2.0, -1.0, np.inf])).as_dict()
    assert (plain["low"], plain["high"], plain["log"]) == (-1.0, 2.0, False)
    wide = Colouring(key="a", label="a", values=np.array([0.05, 2.0])).as_dict()
    assert wide["log"]
    none = Colouring(key="a", label="a", values=np.full(2, np.nan)).as_dict()
    assert (none["low"], none["high"]) == (0.0, 1.0)
    assert np.isnan(decoded(none["values"], "<f4")).all()
    json.dumps([plain, none], allow_nan=False)


def test_data_cannot_end_their_script() -> None:
    data = {"name": "</script><script>alert(1)</script>", "note": "a & b"}
    tag = assets.data_tag("x", data)
    assert tag.count("</script>") == 1
    assert json.loads(tag.partition(">")[2].rpartition("</script>")[0]) == data
    with pytest.raises(ValueError, match="JSON"):
        assets.data_tag("x", {"bad": float("nan")})


def test_scripts_are_whole_and_light() -> None:
    text = assets.script_tags()
    assert text.count("<script>") == text.count("</script>") == len(assets.SCRIPTS) + 1
    assert len(text) < 1_000_000
    bundle = assets.text_of("three.bundle.min.js")
    assert bundle.startswith("/*! three.js")
    assert "Permission is hereby granted" in bundle[:1500]
    assert "http" not in assets.style()


def test_the_still_picture_shows_the_open_shell() -> None:
    design = small(layout={"rows": 6, "columns": 10})
    surface = design.surface()
    markers = make_markers(design, surface)
    data = still.still_picture(Sensor.of(design, surface, markers))
    image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (700, 900, 3)
    assert (image[[0, 0, -1, -1], [0, -1, 0, -1]] == 255).all()  # white paper around
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV).reshape(-1, 3).astype(int)
    strong = hsv[hsv[:, 1] > 150, 0]
    for name in ("blue", "green"):
        paint = np.uint8([[PAINTS[name][::-1]]])
        hue = int(cv2.cvtColor(paint, cv2.COLOR_BGR2HSV)[0, 0, 0])
        assert (np.abs(strong - hue) < 8).sum() > 300, name
    eye = eye_of(surface, markers)
    scene = build_scene(Sensor.of(design, surface, markers), tolerance_mm=0.2)
    left = still.cut_open(scene, surface, markers, eye)
    kept = np.unique(left.triangle_owner[left.triangle_owner >= 0])
    assert kept.tolist() == np.flatnonzero(markers.normal @ eye <= 0.0).tolist()
    assert 0 < len(kept) < markers.count


def test_the_still_camera_stands_upright_and_sees_everything() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-30.0, 30.0, (200, 3)) * [1.0, 1.0, 3.0]
    eye = np.array([0.6, -0.7, 0.4]) / np.linalg.norm([0.6, -0.7, 0.4])
    camera = still.camera_at(eye, points, 1800, 1400)
    assert camera.rotation @ camera.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
    pixels = camera.project(points)
    assert (pixels > 0.0).all()
    assert (pixels < [camera.width_px, camera.height_px]).all()
    above = camera.project(np.array([[0.0, 0.0, 10.0], [0.0, 0.0, -10.0]]))
    assert above[0, 1] < above[1, 1]
    # Seen from where it stands, +x lies to the right of this eye.
    aside = camera.project(np.array([[10.0, 0.0, 0.0], [-10.0, 0.0, 0.0]]))
    assert aside[0, 0] > aside[1, 0]
