"""The whole way through images: find markers in renders, decode; and frames for the user."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import load_bundle
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.engine.stage import EXPORT, Context, Stage, export_path, write_facts
from phytac_design.layout.heights_along import along_mm, middle_mm
from phytac_design.simulation.contacts import Switching
from phytac_design.simulation.force_errors import score_contacts
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES
from phytac_design.stages.renders_stage import noisy, rendered, rendered_example
from phytac_design.stages.response_stage import frame_contacts
from phytac_design.stages.views_stage import write_view
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError


@dataclass(kw_only=True)
class DecodedFrames:
    """What decoding all frames gave: forces (samples, n) by estimator, and counts."""

    forces_N: dict[str, FloatArray]
    missed: int = 0
    false: int = 0
    lost: int = 0
    rejected: list[str] = field(default_factory=list)


def write_frames(folder: Path, name: str, frames: tuple[ImageArray, ...]) -> None:
    """Write ``views/NAME.png``, and ``views/NAME_far.png`` of a second camera."""
    for frame, mark in zip(frames, CAMERA_SUFFIXES, strict=False):
        write_view(folder, f"{name}{mark}.png", frame)


def decode_all(context: Context, folder: Path, switching: Switching) -> DecodedFrames:
    """Decode every sample's frame; write the unloaded frame and the example."""
    bundle = load_bundle(context.folders["decoder"] / EXPORT / "decoder")
    # All frames but the example are of a linear shell.
    bundle = replace(bundle, model=bundle.model.linear)
    bits, example = switching.bits, switching.example
    tally = DecodedFrames(forces_N={name: np.zeros(bits.shape) for name in bundle.model.estimators})
    rest_frames = noisy(context, rendered(context, "rest"), None)
    write_frames(folder, "frame_rest", rest_frames)
    rest_px = bundle.rest_px
    try:
        rest_px = rest_positions(bundle, rest_frames)
    except InputError as error:  # only a forced build of markers that cannot be seen gets here
        tally.rejected.append(str(error))
    truth = switching.receptor_force_N[example]
    write_frames(
        folder, "frame_pressed", noisy(context, rendered_example(context, example), example)
    )
    export_path(folder, "views/frame_pressed.json").write_text(
        json.dumps({str(i): round(float(truth[i]), 4) for i in np.flatnonzero(truth)})
    )
    for index, on in enumerate(bits):
        context.progress(f"frames: {index + 1} of {len(bits)}")
        frames = noisy(context, rendered(context, str(index)), index)
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
    contacts, switching = frame_contacts(context)
    tally = decode_all(context, folder, switching)
    height = along_mm(context.surface, contacts.uv)
    samples = context.facts("renders")["samples"]
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
            "renderer": f"own rasteriser, {samples} samples a pixel on edges, sensor noise",
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
    design_fields=("markers", "trips", "training", "camera.noise_pixel"),
    settings=("frames",),
    depends_on=("decoder", "renders"),
    seeded=True,
    scene=("regions", "reach_mm", "at_once"),
    run=run,
)
