"""The whole way through images: press, render, find, decode; and example frames for the user."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import load_bundle
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.design.scene import ALL_AT_ONCE
from phytac_design.engine.stage import EXPORT, Context, Stage, export_path, write_facts
from phytac_design.layout.heights_along import along_mm, middle_mm
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.simulation.contacts import Contacts, Switching, draw_contacts, switch_states
from phytac_design.simulation.force_errors import score_contacts
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES
from phytac_design.simulation.linear_response import motion_responses, superpose
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.stages.response_stage import truth_model
from phytac_design.stages.views_stage import write_image
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError


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

    @property
    def example(self) -> int:
        """The sample with the most switches on."""
        return int(np.argmax(self.switching.bits.sum(axis=1)))


@dataclass(kw_only=True)
class DecodedFrames:
    """What decoding all frames gave: forces (samples, n) by estimator, and counts."""

    forces_N: dict[str, FloatArray]
    missed: int = 0
    false: int = 0
    lost: int = 0
    rejected: list[str] = field(default_factory=list)


def draw_frame_contacts(context: Context) -> FrameContacts:
    """Draw contacts of one to five at once and solve them on the simulated sensor's mesh."""
    rng = np.random.default_rng([context.seed, 2])
    scope = scope_of(context)
    contacts = draw_contacts(
        context.sensor,
        samples=context.accuracy.frames,
        rng=rng,
        most=context.scene.at_once if context.scene else ALL_AT_ONCE,
        inside=scope.holds if scope else None,
    )
    mesh, model = truth_model(context)
    responses = motion_responses(
        model, mesh, context.surface, context.markers, uv=contacts.uv, radius_mm=contacts.radius_mm
    )
    switching = switch_states(context.sensor, contacts)
    motion = superpose(responses, contacts)
    pressed = FrameContacts(contacts=contacts, switching=switching, motion=motion)
    if context.accuracy.place_orders == 1:
        return pressed
    example = contacts.of(pressed.example)
    return replace(pressed, shown=large_motion(context, mesh, model, example))


def large_motion(
    context: Context, mesh: ShellMesh, model: ShellModel, contacts: Contacts
) -> FloatArray | None:
    """Motion (n, 6) under the contacts of one sample by large displacements; None without one."""
    receptor, surface, uv = context.design.receptor, context.surface, context.markers.uv
    holes = Holes.of(surface, uv, receptor.diameter_hole_mm / 2.0)
    unit = indentation_loads(mesh, surface, contacts, holes=holes)
    motion = QuasiNewtonSolver(model).solve(np.asarray(unit @ contacts.force_N).ravel()).motion
    if motion is None:
        return None
    return ReceptorKinematics(mesh, surface, uv, receptor.diameter_outer_mm / 2.0).large(motion)


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
    """Noisy frame of each camera of one sample, or of the unloaded sensor (None).

    ``scenes`` are those of :func:`camera_scenes`; ``motion`` (n, 6) replaces the sample's own.
    """
    bits = np.zeros(context.markers.count, dtype=np.bool_)
    still = np.zeros((context.markers.count, 6))
    if index is not None:
        bits = pressed.switching.bits[index]
        still = pressed.motion[index] if motion is None else motion
    rng = np.random.default_rng([context.seed, 3, 0 if index is None else index + 1])
    noise = context.design.camera.noise_pixel
    return tuple(
        render_frame(scene.scene(still, bits), camera, noise_std=noise, rng=rng)
        for scene, camera in zip(scenes, context.sensor.cameras, strict=True)
    )


def write_frames(folder: Path, name: str, frames: tuple[ImageArray, ...]) -> None:
    """Write ``views/NAME.png``, and ``views/NAME_far.png`` of a second camera."""
    for frame, mark in zip(frames, CAMERA_SUFFIXES, strict=False):
        write_image(export_path(folder, f"views/{name}{mark}.png"), frame)


def decode_all(context: Context, folder: Path, pressed: FrameContacts) -> DecodedFrames:
    """Render and decode every sample; write the unloaded frame and the example."""
    bundle = load_bundle(context.folders["decoder"] / EXPORT / "decoder")
    # All frames but the example are of a linear shell.
    bundle = replace(bundle, model=bundle.model.linear)
    bits = pressed.switching.bits
    tally = DecodedFrames(forces_N={name: np.zeros(bits.shape) for name in bundle.model.estimators})
    scenes = camera_scenes(context)
    rest_frames = render_sample(context, scenes, pressed, None)
    write_frames(folder, "frame_rest", rest_frames)
    rest_px = bundle.rest_px
    try:
        rest_px = rest_positions(bundle, rest_frames)
    except InputError as error:  # only a forced build of markers that cannot be seen gets here
        tally.rejected.append(str(error))
    truth = pressed.switching.receptor_force_N[pressed.example]
    example = render_sample(context, scenes, pressed, pressed.example, pressed.shown)
    write_frames(folder, "frame_pressed", example)
    export_path(folder, "views/frame_pressed.json").write_text(
        json.dumps({str(i): round(float(truth[i]), 4) for i in np.flatnonzero(truth)})
    )
    for index, on in enumerate(bits):
        context.progress(f"frames: {index + 1} of {len(bits)}")
        frames = render_sample(context, scenes, pressed, index)
        try:
            measured = measure_frame(bundle, frames, rest_px=rest_px)
        except InputError as error:
            tally.rejected.append(str(error))
            tally.missed += int(on.sum())
            continue
        for name in tally.forces_N:
            tally.forces_N[name][index] = measured.forces_N(bundle, name)
        found = np.isin(np.arange(len(on)), measured.koi)
        tally.missed += int((on & ~found).sum())
        tally.false += int((found & ~on).sum())
        tally.lost += int((~measured.found).sum())
    return tally


def run(context: Context, folder: Path) -> None:
    """Decode rendered frames of one to five contacts each and evaluate the forces."""
    pressed = draw_frame_contacts(context)
    tally = decode_all(context, folder, pressed)
    contacts, switching = pressed.contacts, pressed.switching
    height = along_mm(context.surface, contacts.uv)
    scores: dict[str, Any] = {
        name: score_contacts(
            forces, contacts, switching, height_mm=height, middle_mm=middle_mm(context.surface)
        )
        for name, forces in tally.forces_N.items()
    }
    write_facts(
        folder,
        {
            "frames": contacts.samples,
            "renderer": "own rasteriser, 8 samples a pixel, sensor noise",
            "contacts": len(contacts.force_N),
            "tripped_no_switch": int((~switching.tripped).sum()),
            "koi": int(switching.bits.sum()),
            "koi_missed": tally.missed,
            "koi_false": tally.false,
            "markers_not_found": tally.lost,
            "refused": len(tally.rejected),
            "first_refusal": tally.rejected[0] if tally.rejected else "",
            "estimators": scores,
        },
    )


FRAMES = Stage(
    name="frames",
    design_fields=("mechanics", "markers", "bodies", "trips", "training", "camera.noise_pixel"),
    settings=("truth_refine", "frames", "place_orders"),
    depends_on=("decoder",),
    seeded=True,
    scene=("regions", "reach_mm", "at_once"),
    run=run,
)
