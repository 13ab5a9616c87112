"""What is seen of pressed sensors: against plain visibility, and on moves with a known outcome."""

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.vision.segmentation import ColourModel, segment
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.loaded_visibility import FUSED_PX, scene_state, visibility_under_load
from phytac_design.optics.paint import paints_of
from phytac_design.optics.raster import pixels_alone
from phytac_design.optics.render_scene import RenderScene, build_scene
from tests.designs import FINE_CAMERA, small


@pytest.fixture(scope="module")
def sensor() -> tuple[Design, Markers, RenderScene, Camera]:
    design = small(camera=FINE_CAMERA)
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    scene = build_scene(
        Sensor.of(design, surface, markers), tolerance_mm=tolerance_mm(camera, markers)
    )
    return design, markers, scene, camera


def moved(markers: Markers, who: int, by: np.ndarray) -> np.ndarray:
    motion = np.zeros((markers.count, 6))
    motion[who, :3] = by
    return motion


def random_motion(count: int, size_mm: float) -> np.ndarray:
    """Small moves and turns of all markers."""
    rng = np.random.default_rng(3)
    return rng.normal(scale=[size_mm] * 3 + [size_mm / 20.0] * 3, size=(count, 6))


def finer(design: Design, factor: int) -> Design:
    """The same view with ``factor`` times the pixels each way."""
    camera = design.camera
    update = {
        "width_px": factor * camera.width_px,
        "height_px": factor * camera.height_px,
        "focal_px": factor * camera.focal_px,
    }
    return design.model_copy(update={"camera": camera.model_copy(update=update)})


def over(markers: Markers, camera: Camera, front: int, back: int) -> np.ndarray:
    """Move that puts a marker on the line of sight to another one's tip, nearer the camera."""
    camera_mm, target = camera.position_mm, markers.tip_mm[back]
    share = np.linalg.norm(markers.tip_mm[front] - camera_mm) / np.linalg.norm(target - camera_mm)
    return np.asarray(camera_mm + min(share, 0.85) * (target - camera_mm) - markers.tip_mm[front])


def test_at_rest_like_plain_visibility(sensor: tuple[Design, Markers, RenderScene, Camera]) -> None:
    _, markers, scene, camera = sensor
    rest = scene_state(scene, camera)
    alone = pixels_alone(scene, camera)
    assert np.array_equal(rest.visible_px, np.rint(rest.fraction * alone))
    assert not rest.hidden.any()
    assert not rest.fused.any()
    whole = rest.fraction == 1.0
    assert whole.any()
    assert np.abs(rest.offset_px[whole]).max() < 1e-9
    assert rest.crosstalk_px(rest).max() == 0.0
    assert len(rest.fraction) == markers.count


def test_a_marker_in_front_hides_another_and_only_that_one_is_disturbed(
    sensor: tuple[Design, Markers, RenderScene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    back = int(np.flatnonzero(markers.row == markers.row.max())[0])
    front = int(np.flatnonzero(markers.row == 0)[0])
    motion = moved(markers, front, over(markers, camera, front, back))
    rest = scene_state(scene, camera)
    pressed = scene_state(scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera)
    assert pressed.hidden[back]
    others = np.arange(markers.count)
    untouched = ~np.isin(others, [front, back]) & (pressed.fraction == rest.fraction)
    assert untouched.sum() > markers.count // 2
    assert pressed.crosstalk_px(rest)[untouched].max() == 0.0


def test_half_covered_marker_has_crosstalk_though_it_stands_still(side_mm: float) -> None:
    rest, pressed, camera, back = half_covered(1, side_mm)
    assert scene_state(pressed, camera).crosstalk_px(scene_state(rest, camera))[back] > 0.5


def test_first_force_is_found_and_nothing_before(
    sensor: tuple[Design, Markers, RenderScene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    same = np.flatnonzero(markers.colour == markers.colour[0])
    near = same[np.argsort(np.linalg.norm(markers.tip_mm[same] - markers.tip_mm[0], axis=1))[1]]
    towards = markers.tip_mm[near] - markers.tip_mm[0]
    motions = np.stack([moved(markers, 0, s * towards) for s in (0.5, 1.0)])[None]
    still = np.zeros_like(motions)
    still[:, :, 0, 2] = 1e-4
    found = visibility_under_load(
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
        seen = scene_state(scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera)
        return bool((seen.gap_same_px <= FUSED_PX).any() or seen.hidden.any())

    assert fused(first)
    assert not fused(first - 10.0 / 2**6)
    assert found.least_gap_same_px[near] <= FUSED_PX
    assert found.first_marker.tolist() in ([0, -1], [near, -1])


def test_stationary_markers_are_separated_from_moving_ones(
    sensor: tuple[Design, Markers, RenderScene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    back = int(np.flatnonzero(markers.row == markers.row.max())[0])
    motion = moved(markers, 0, over(markers, camera, 0, back) + np.array([1.0, 0.0, 0.0]))
    found = visibility_under_load(
        scene,
        camera,
        pivots_mm=markers.mid_mm,
        motions=motion[None, None],
        forces_N=np.array([10.0]),
    )
    assert found.crosstalk_still_px[0] == 0.0  # it moved most of all
    assert (found.crosstalk_still_px <= found.crosstalk_px).all()
    assert found.shift_px[0] > 10.0
    mine = np.linalg.norm(
        camera.project(markers.tip_mm[:1] + motion[:1, :3]) - camera.project(markers.tip_mm[:1])
    )
    # The point looked at is the middle of the paint, not of the end face.
    assert found.shift_px[0] == pytest.approx(mine, rel=0.2)


def test_own_motion_is_no_crosstalk() -> None:
    """Markers that nothing covers, moved and turned every way, have none, to the last bit."""
    design = small(layout={"rows": 3, "columns": 8}, receptor={"band_marker_mm": 0.4})
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    scene = build_scene(
        Sensor.of(design, surface, markers), tolerance_mm=tolerance_mm(camera, markers)
    )
    # Inward, so that none sinks into the wall.
    motion = random_motion(markers.count, 0.4)
    motion[:, :3] += 2.0 * markers.direction
    rest = scene_state(scene, camera)
    pressed = scene_state(scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera)
    free = (rest.fraction == 1.0) & (pressed.fraction == 1.0)
    assert free.sum() >= 12
    assert pressed.shift_px(rest)[free].min() > 3.0
    assert pressed.crosstalk_px(rest)[free].max() == 0.0


@pytest.fixture(scope="module")
def side_mm() -> float:
    """How far aside the one in front must be moved to cover about half of the other."""
    for side in np.linspace(0.0, 3.0, 13):
        _, pressed, camera, back = half_covered(1, float(side))
        if 0.2 < scene_state(pressed, camera).fraction[back] < 0.8:
            return float(side)
    pytest.fail("never half covered")


def half_covered(factor: int, side: float) -> tuple[RenderScene, RenderScene, Camera, int]:
    """Scenes at rest and with a marker half covered by one that moved; camera; that marker."""
    scene, markers, motion, camera, back = half_covering(factor, side)
    return scene, scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm), camera, back


def half_covering(factor: int, side: float) -> tuple[RenderScene, Markers, np.ndarray, Camera, int]:
    """Scene at rest; its markers; the motion that half covers one; camera; that marker."""
    design = finer(small(), factor)
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    scene = build_scene(Sensor.of(design, surface, markers), tolerance_mm=1e-3)
    back = int(np.flatnonzero(markers.row == markers.row.max())[0])
    # Of the other colour, so that the two make no blob together.
    front = int(np.flatnonzero((markers.row == 0) & (markers.colour != markers.colour[back]))[0])
    whole = over(markers, camera, front, back)
    return scene, markers, moved(markers, front, whole + np.array([side, 0.0, 0.0])), camera, back


def test_sampling_of_crosstalk(side_mm: float) -> None:
    """Four times finer pixels give the same crosstalk in pixels, within what sampling allows."""
    coarse, fine = (
        scene_state(pressed, camera).crosstalk_px(scene_state(rest, camera))[back]
        for rest, pressed, camera, back in (half_covered(1, side_mm), half_covered(4, side_mm))
    )
    assert fine / 4.0 > 0.5
    assert coarse == pytest.approx(fine / 4.0, abs=0.15)


def test_a_decoder_suffers_what_crosstalk_says(side_mm: float) -> None:
    """Blobs of the decoder's own segmentation shift by it, of a marker that stands still."""
    rest, markers, motion, camera, back = half_covering(2, side_mm)
    pressed = rest.moved(motion[:, :3], motion[:, 3:], markers.mid_mm)
    model = ColourModel.from_rgb(paints_of(rest.paints))
    home = scene_state(rest, camera)
    seen = scene_state(pressed, camera)
    expected = seen.offset_px[back] - home.offset_px[back]
    assert np.linalg.norm(expected) > 1.0
    centre = home.alone_px[back] + home.offset_px[back]
    found = []
    for scene in (rest, pressed):
        blobs = segment(render_frame(scene, camera), model)
        own = blobs.centroid_px[blobs.colour == model.names.index(rest.paints[rest.colour[back]])]
        found.append(own[np.linalg.norm(own - centre, axis=1).argmin()])
    assert found[1] - found[0] == pytest.approx(expected, abs=0.35)
    # It stands still, so that its whole shift is crosstalk.
    shift = float(np.linalg.norm(found[1] - found[0]))
    under_load = visibility_under_load(
        rest,
        camera,
        pivots_mm=markers.mid_mm,
        motions=motion[None, None],
        forces_N=np.array([10.0]),
    )
    assert seen.crosstalk_px(home)[back] == pytest.approx(shift, rel=0.3)
    assert under_load.crosstalk_still_px[back] == pytest.approx(shift, rel=0.3)


def test_worst_press_is_the_tightest_where_nothing_happens(
    sensor: tuple[Design, Markers, RenderScene, Camera],
) -> None:
    _, markers, scene, camera = sensor
    one = int(scene_state(scene, camera).gap_same_px.argmin())
    same = np.flatnonzero(markers.colour == markers.colour[one])
    image = camera.project(markers.tip_mm)
    near = same[np.argsort(np.linalg.norm(image[same] - image[one], axis=1))[1]]
    towards = markers.tip_mm[near] - markers.tip_mm[one]
    motions = np.stack([moved(markers, one, s * towards)[None] for s in (0.0, 0.2, 0.1)])
    found = visibility_under_load(
        scene, camera, pivots_mm=markers.mid_mm, motions=motions, forces_N=np.array([5.0])
    )
    assert np.isinf(found.first_force_N).all()
    assert (found.first_marker == -1).all()
    assert found.worst == 1
    assert found.press_gap_same_px[1] == found.least_gap_same_px.min()
    assert found.press_crosstalk_px.max() == found.crosstalk_px.max()
