"""The whole way through images: press, render, find, decode; and example frames for the user."""

import json
from pathlib import Path

import numpy as np

from phytac_design.stage import EXPORT, Context, Stage, export_path, write_facts
from phytac_design.stages.decoder import along_mm, middle_mm
from phytac_design.stages.views import write_image


def run(context: Context, folder: Path) -> None:
    """Decode rendered frames of one to five contacts each and judge the forces."""
    from decoder.bundle import load_bundle
    from decoder.estimators import ESTIMATORS
    from decoder.run import measure_frame, rest_positions
    from phytac_design.optics.frame import render_frame
    from phytac_design.optics.scene import build_scene
    from phytac_design.optics.view import camera_of, tolerance_mm
    from phytac_design.twin.contacts import draw_contacts, switch_states
    from phytac_design.twin.judge import judge
    from phytac_design.twin.response import motion_responses, superpose
    from phytac_design.twin.shell import truth_shell

    design, surface, markers = context.design, context.surface, context.markers
    rng = np.random.default_rng([context.seed, 2])
    count = context.accuracy.frames
    contacts = draw_contacts(design, surface, markers, samples=count, rng=rng)
    switching = switch_states(design, surface, markers, contacts)
    mesh, model = truth_shell(design, surface, context.accuracy.truth_refine)
    responses = motion_responses(
        model, mesh, surface, markers, uv=contacts.uv, radius_mm=contacts.radius_mm
    )
    motion = superpose(responses, contacts)
    camera = camera_of(design, surface)
    tolerance = tolerance_mm(camera, markers)
    noise = design.camera.noise_pixel
    bundle = load_bundle(context.folders["decoder"] / EXPORT / "decoder")

    rest = build_scene(design, surface, markers, tolerance_mm=tolerance)
    rest_frame = render_frame(rest, camera, noise_std=noise, rng=rng)
    rest_px = rest_positions(bundle, rest_frame)
    write_image(export_path(folder, "views/frame_rest.png"), rest_frame)
    forces = {name: np.zeros((count, markers.count)) for name in ESTIMATORS}
    missed = false = lost = 0
    for index in range(count):
        context.progress(f"frames: {index + 1} of {count}")
        bits = switching.bits[index]
        scene = build_scene(design, surface, markers, tolerance_mm=tolerance, switch_on=bits)
        scene = scene.moved(motion[index, :, :3], motion[index, :, 3:], markers.mid_mm)
        frame = render_frame(scene, camera, noise_std=noise, rng=rng)
        measured = measure_frame(bundle, frame, rest_px=rest_px)
        for name in ESTIMATORS:
            forces[name][index] = measured.forces_N(bundle, name)
        found = np.isin(np.arange(markers.count), measured.koi)
        missed += int((bits & ~found).sum())
        false += int((found & ~bits).sum())
        lost += int((~measured.found).sum())
        if index == 0:
            write_image(export_path(folder, "views/frame_pressed.png"), frame)
            truth = switching.receptor_force_N[0]
            export_path(folder, "views/frame_pressed.json").write_text(
                json.dumps({f"{i}": round(float(truth[i]), 4) for i in np.flatnonzero(truth)})
            )
    height = along_mm(context, contacts.uv)
    scores = {
        name: judge(
            forces[name], contacts, switching, height_mm=height, middle_mm=middle_mm(context)
        )
        for name in ESTIMATORS
    }
    on = int(switching.bits.sum())
    write_facts(
        folder,
        {
            "frames": count,
            "renderer": "own rasteriser, 8 samples a pixel, sensor noise",
            "contacts": len(contacts.force_N),
            "tripped_no_switch": int((~switching.tripped).sum()),
            "koi": on,
            "koi_missed": missed,
            "koi_false": false,
            "markers_not_found": lost,
            "estimators": scores,
        },
    )


FRAMES = Stage(
    name="frames",
    tables=(
        "shape",
        "wall",
        "layout",
        "receptor",
        "switch",
        "camera",
        "light",
        "material",
        "training",
    ),
    knobs=("truth_refine", "frames"),
    needs=("decoder",),
    seeded=True,
    run=run,
)
