"""What is seen of pressed sensors: against plain visibility, and on moves with a known outcome."""

import numpy as np
import pytest

from decoder.camera import Camera
from phytac_design.layout import Markers, make_markers
from phytac_design.optics.raster import pixels_alone
from phytac_design.optics.scene import Scene, build_scene
from phytac_design.optics.underload import FUSED_PX, press_all, sight
from phytac_design.optics.view import camera_of, tolerance_mm
from phytac_design.spec import Design
from tests.designs import small


@pytest.fixture(scope="module")
def sensor() -> tuple[Design, Markers, Scene, Camera]:
    design = small()
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    scene = build_scene(design, surface, markers, tolerance_mm=tolerance_mm(camera, markers))
    return design, markers, scene, camera


def moved(markers: Markers, who: int, by: np.ndarray) -> np.ndarray:
    motion = np.zeros((markers.count, 6))
    motion[who, :3] = by
    return motion


def over(markers: Markers, camera: Camera, front: int, back: int) -> np.ndarray:
    """Move that puts a marker on the line of sight to another one's tip, nearer the camera."""
    eye, target = camera.position_mm, markers.tip_mm[back]
    share = np.linalg.norm(markers.tip_mm[front] - eye) / np.linalg.norm(target - eye)
    return np.asarray(eye + min(share, 0.85) * (target - eye) - markers.tip_mm[front])


def test_at_rest_like_plain_visibility(sensor: tuple[Design, Markers, Scene, Camera]) -> None:
    _, markers, scene, camera = sensor
    rest = sight(scene, camera)
    alone = pixels_alone(scene, camera)[0]
    assert np.array_equal(rest.visible_px, np.rint(rest.fraction * alone))
    assert not rest.hidden.any()
    assert not rest.fused.any()
    whole = rest.fraction == 1.0
    assert whole.any()
    assert np.abs(rest.offset_px[whole]).max() < 1e-9
    assert rest.crosstalk_px(rest).max() == 0.0
    assert len(rest.fraction) == markers.count


def test_a_marker_in_front_hides_another_and_only_that_one_is_disturbed(
    sensor: tuple[Design, Markers, Scene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    back = int(np.flatnonzero(markers.row == markers.row.max())[0])
    front = int(np.flatnonzero(markers.row == 0)[0])
    motion = moved(markers, front, over(markers, camera, front, back))
    rest = sight(scene, camera)
    pressed = sight(scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera)
    assert pressed.hidden[back]
    others = np.arange(markers.count)
    untouched = ~np.isin(others, [front, back]) & (pressed.fraction == rest.fraction)
    assert untouched.sum() > markers.count // 2
    assert pressed.crosstalk_px(rest)[untouched].max() == 0.0


def test_half_covered_marker_has_crosstalk_though_it_stands_still(
    sensor: tuple[Design, Markers, Scene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    back = int(np.flatnonzero(markers.row == markers.row.max())[0])
    front = int(np.flatnonzero(markers.row == 0)[0])
    whole = over(markers, camera, front, back)
    rest = sight(scene, camera)
    for side in np.linspace(0.0, 3.0, 13):
        motion = moved(markers, front, whole + np.array([side, 0.0, 0.0]))
        pressed = sight(scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera)
        if 0.2 < pressed.fraction[back] < 0.8:
            break
    assert 0.2 < pressed.fraction[back] < 0.8
    assert pressed.crosstalk_px(rest)[back] > 0.5


def test_first_force_is_found_and_nothing_before(
    sensor: tuple[Design, Markers, Scene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    same = np.flatnonzero(markers.colour == markers.colour[0])
    near = same[np.argsort(np.linalg.norm(markers.tip_mm[same] - markers.tip_mm[0], axis=1))[1]]
    towards = markers.tip_mm[near] - markers.tip_mm[0]
    motions = np.stack([moved(markers, 0, s * towards) for s in (0.5, 1.0)])[None]
    still = np.zeros_like(motions)
    still[:, :, 0, 2] = 1e-4
    found = press_all(
        scene,
        camera,
        pivots_mm=markers.mid_mm,
        motions=np.concatenate([motions, still]),
        forces_N=np.array([5.0, 10.0]),
    )
    assert found.fused.tolist()[1] == 0
    assert found.fused[0] >= 2
    assert np.isinf(found.first_force_N[1])
    assert found.worst == 0
    first = float(found.first_force_N[0])
    assert 0.0 < first < 10.0

    def fused(force: float) -> bool:
        motion = moved(markers, 0, force / 10.0 * towards)
        seen = sight(scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera)
        return bool((seen.gap_same_px <= FUSED_PX).any() or seen.hidden.any())

    assert fused(first)
    assert not fused(first - 10.0 / 2**6)
    assert found.least_gap_same_px[near] <= FUSED_PX


def test_still_markers_are_told_from_moving_ones(
    sensor: tuple[Design, Markers, Scene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    back = int(np.flatnonzero(markers.row == markers.row.max())[0])
    motion = moved(markers, 0, over(markers, camera, 0, back) + np.array([1.0, 0.0, 0.0]))
    found = press_all(
        scene,
        camera,
        pivots_mm=markers.mid_mm,
        motions=motion[None, None],
        forces_N=np.array([10.0]),
    )
    assert found.crosstalk_still_px[0] == 0.0  # it moved most of all
    assert (found.crosstalk_still_px <= found.crosstalk_px).all()
    assert found.shift_px[0] > 10.0
