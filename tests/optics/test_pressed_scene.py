"""Scenes of pressed sensors: the wall moves with its receptors."""

from pathlib import Path

import numpy as np

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.engine.stage import Context
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import RenderScene, paint_owner
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_design.stages.renders_stage import FrameContacts, camera_scenes, render_sample
from phytac_shapes.arrays import FloatArray, IntArray

RIG = Sensor(load_design(str(Path(__file__).parents[2] / "examples/rig/rig.toml")))


def outward(sensor: Sensor, amount_mm: float) -> FloatArray:
    """Motion (n, 6) of all markers away from the axis."""
    middle = sensor.markers.mid_mm[:, :2]
    across = amount_mm * middle / np.linalg.norm(middle, axis=1, keepdims=True)
    return np.column_stack([across, np.zeros((len(across), 4))])


def test_short_receptors_keep_their_paint_when_the_wall_bulges() -> None:
    """Receptors beside the rim are 0.5 mm tall and painted down to the wall; every other moves."""
    sensor = Sensor(load_design("cylinder60"))
    camera, count = sensor.cameras[0], sensor.markers.count
    scenes, off = PressedScene(sensor, camera), np.zeros(count, dtype=np.bool_)
    moved = outward(sensor, 0.3)
    near = np.arange(0, 16, 2)
    moved[np.setdiff1d(np.arange(count), near)] = 0.0

    def painted_px(scene: RenderScene) -> IntArray:
        owner = paint_owner(rasterise(scene, camera).part)
        return np.bincount(owner[owner >= 0], minlength=count)[near]

    rest = painted_px(scenes.scene(0.0 * moved, off))
    assert (painted_px(scenes.scene(moved, off)) > 0.97 * rest).all()
    assert (painted_px(scenes.scene(moved, off, wall_follows=False)) < 0.9 * rest).all()


def test_frames_of_a_build_are_of_walls_that_follow() -> None:
    """Forces beside a rim were read too small in frames of a wall that stood still."""
    context = Context(design=RIG.design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    contacts = Contacts.flat(
        sample=np.array([0]),
        uv=RIG.markers.uv[:1],
        radius_mm=np.array([4.0]),
        force_N=np.array([5.0]),
        samples=1,
    )
    switching = switch_states(RIG, contacts)
    pressed = FrameContacts(contacts=contacts, switching=switching, motion=outward(RIG, 0.3)[None])
    (scenes,) = camera_scenes(context)
    (frame,) = render_sample(context, [scenes], pressed, 0)
    shown = [
        render_frame(
            scenes.scene(outward(RIG, 0.3), switching.bits[0], wall_follows=follow), RIG.cameras[0]
        )
        for follow in (True, False)
    ]
    off = [float(np.std(frame.astype(float) - other)) for other in shown]
    noise = RIG.design.camera.noise_pixel
    assert off[0] < 1.1 * noise
    assert off[1] > 1.5 * off[0]
