"""Renders of the pressed sensor, without noise: no decoder is needed for them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phytac_design.engine.stage import Context, Stage, write_facts
from phytac_design.optics.frame_renderer import add_noise, quick_samples, render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.simulation.contacts import Contacts, Switching
from phytac_design.simulation.linear_response import superpose
from phytac_design.stages.response_stage import frame_contacts, truth_responses, truth_solver
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray


@dataclass(frozen=True, kw_only=True)
class FrameContacts:
    """Contacts of all frames, what they trip, and how every marker moves, (samples, n, 6).

    ``shown`` (n, 6) is how a sensor would move in the example: with large displacements, where the
    decoder's tables know of them.
    """

    contacts: Contacts
    switching: Switching
    motion: FloatArray
    shown: FloatArray | None = None


def draw_frame_contacts(context: Context) -> FrameContacts:
    """Draw contacts of one to five at once and solve them on the simulated sensor's meshes."""
    contacts, _ = frame_contacts(context)
    _, responses = truth_responses(context, contacts.uv, contacts.radius_mm)
    return press_frames(context, superpose(responses, contacts))


def press_frames(context: Context, motion: FloatArray) -> FrameContacts:
    """The contacts of :func:`.frame_contacts` with the motion (samples, n, 6) under them."""
    contacts, switching = frame_contacts(context)
    pressed = FrameContacts(contacts=contacts, switching=switching, motion=motion)
    if context.accuracy.place_orders == 1:
        return pressed
    example = contacts.of(switching.example)
    return replace(pressed, shown=truth_solver(context).solve(example, example.force_N).motion)


def camera_scenes(context: Context) -> list[PressedScene]:
    """Scenes of the sensor before each of its cameras."""
    return [PressedScene(context.sensor, camera) for camera in context.sensor.cameras]


def render_sample(
    context: Context,
    scenes: Sequence[PressedScene],
    pressed: FrameContacts,
    index: int | None,
    motion: FloatArray | None = None,
) -> tuple[ImageArray, ...]:
    """Frame of each camera, without noise, of one sample or of the unloaded sensor (None).

    ``scenes`` are those of :func:`camera_scenes`; ``motion`` (n, 6) replaces the sample's own.
    """
    out: BoolArray | FloatArray = np.zeros(context.markers.count, dtype=np.bool_)
    still = np.zeros((context.markers.count, 6))
    if index is not None:
        out = pressed.switching.shown[index]
        still = pressed.motion[index] if motion is None else motion
    return tuple(
        render_frame(scene.scene(still, out), camera, samples=quick_samples(camera))
        for scene, camera in zip(scenes, context.sensor.cameras, strict=True)
    )


def noisy(
    context: Context, frames: Sequence[ImageArray], index: int | None
) -> tuple[ImageArray, ...]:
    """Frames of :func:`render_sample` with the sensor noise of that sample."""
    rng = np.random.default_rng([context.seed, 3, 0 if index is None else index + 1])
    noise = context.design.camera.noise_pixel
    return tuple(add_noise(frame, noise, rng) if noise > 0.0 else frame for frame in frames)


def run(context: Context, folder: Path) -> None:
    """Write each sample's frame of each camera, the unloaded sensor's, the example's if other."""
    pressed = press_frames(context, context.arrays("twin")["frames.motion"])
    scenes = camera_scenes(context)
    jobs: list[tuple[str, int | None, FloatArray | None]] = [
        ("rest", None, None),
        *((str(index), index, None) for index in range(len(pressed.motion))),
    ]
    if pressed.shown is not None:  # else it is the sample's own frame
        jobs.append(("example", pressed.switching.example, pressed.shown))
    for number, (name, index, motion) in enumerate(jobs, start=1):
        context.progress(f"renders: {number} of {len(jobs)}")
        for camera, frame in enumerate(render_sample(context, scenes, pressed, index, motion)):
            write_frame(folder, name, camera, frame)
    samples = quick_samples(context.sensor.cameras[0])
    write_facts(folder, {"renders": len(jobs) * len(scenes), "samples": samples})


def write_frame(folder: Path, name: str, camera: int, frame: ImageArray) -> None:
    """Keep a frame of a camera, by its number: Zstandard takes a third of a PNG's time."""
    import pyarrow as pa

    size = np.array(frame.shape, dtype=np.int64).tobytes()
    data = pa.compress(np.ascontiguousarray(frame), codec="zstd", asbytes=True)
    (folder / f"{name}_{camera}.zst").write_bytes(size + data)


def rendered(context: Context, name: str) -> tuple[ImageArray, ...]:
    """Frames that the stage has rendered, read-only: ``rest``, or of a sample by its number."""
    import pyarrow as pa

    out = []
    for path in sorted(context.folders["renders"].glob(f"{name}_*.zst")):
        file = path.read_bytes()
        size = np.frombuffer(file[:24], dtype=np.int64)
        data = pa.decompress(file[24:], int(size.prod()), codec="zstd")
        out.append(np.frombuffer(data, dtype=np.uint8).reshape(size))
    return tuple(out)


def rendered_example(context: Context, index: int) -> tuple[ImageArray, ...]:
    """Frames of the example, sample ``index``, as the sensor would show it."""
    return rendered(context, "example") or rendered(context, str(index))


RENDERS = Stage(
    name="renders",
    design_fields=("mechanics", "markers", "bodies", "trips", "training"),
    settings=("truth_refine", "frames", "place_orders"),
    depends_on=("twin",),
    arrays={"twin": ("frames.motion",)},
    seeded=True,
    scene=("regions", "reach_mm", "at_once"),
    run=run,
)
