"""The decoder's own mechanics (response) and, on another mesh, simulated data (stage twin)."""

from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.design.scene import ALL_AT_ONCE
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, Stage, write_arrays, write_facts
from phytac_design.layout.cameras import Readers
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.contacts import Contacts, Switching, draw_contacts, switch_states
from phytac_design.simulation.dataset import Dataset
from phytac_design.simulation.instance_shell import instance_shells
from phytac_design.simulation.linear_response import (
    condense_pressed,
    motion_responses,
    pressed_motion,
    superpose,
)
from phytac_design.simulation.pressed_series import ImageResponse
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.simulation.sensor_instance import designed_shell
from phytac_design.simulation.solver import Solver
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

IMAGE_ARRAYS = {"views": ("paint_point_mm", "paint_slope", "camera")}
"""Where the paint is, how its image moves with the wall, and which camera reads it: all that
mechanics asks of the pictures."""
SCENE_SAMPLES = {"test": 24, "anywhere": 12}
"""Samples of a scene that trains nothing, for evaluation."""


def arms_mm(context: Context) -> FloatArray:
    """From each marker's place on the middle face to the paint that its camera sees, (n, 3)."""
    return np.asarray(context.arrays("views")["paint_point_mm"] - context.markers.mid_mm)


def readers_of(context: Context) -> Readers:
    """The cameras, each marker read through the one that sees it best (of the stage ``views``)."""
    cameras = context.sensor.cameras
    return Readers(cameras=cameras, read_by=context.arrays("views")["camera"])


def image_response_of(context: Context) -> ImageResponse:
    """What the cameras see of motion (of the stage ``views``)."""
    slope = context.arrays("views")["paint_slope"]
    return ImageResponse(readers_of(context), context.markers.mid_mm, arms_mm(context), slope)


def decoder_shell(
    context: Context, refine: int | None = None
) -> tuple[ShellMesh, ShellModel, bool]:
    """Mesh and model of the decoder's own shell, and whether it has its receptors' stiffness.

    ``refine`` replaces the setting.
    """
    design, markers = context.design, context.markers
    mesh = marker_mesh(
        context.surface,
        markers,
        thickness_mm=design.wall.thickness_mm,
        refine=refine or context.accuracy.refine,
    )
    receptors = context.accuracy.receptors and not unknown_receptors(design)
    return mesh, sensor_model(design, markers, mesh, receptors=receptors), receptors


def cell_radius_mm(context: Context) -> float:
    """Radius of the disc that has the area of one marker's cell.

    The decoder lets each receptor carry the force on its own cell, as a node of the paper's mesh
    carries the load of the elements around it. How far a force spreads matters: a wall this thin
    dents half as much again under a switch's footprint (radius 2.3 mm) as under a cell (4.4 mm),
    and the estimators err accordingly.
    """
    area = context.surface.area_mm2() / context.markers.count
    return float(np.sqrt(area / np.pi))


def run_response(context: Context, folder: Path) -> None:
    """Condense the decoder's mesh to what each marker's camera sees of it.

    In a scene only forces on receptors in play are: to the others the matrices give no force.
    """
    surface, markers = context.surface, context.markers
    unknown = unknown_receptors(context.design)
    if context.accuracy.receptors and unknown:
        context.progress(f"response: the wall is taken as plain: {unknown}")
    mesh, model, receptors = decoder_shell(context)
    scope = scope_of(context)
    pressed = np.arange(markers.count)
    if scope is not None:
        pressed = np.flatnonzero(scope.in_play(markers))
    motion = pressed_motion(
        model, mesh, surface, markers, pressed=pressed, radius_mm=cell_radius_mm(context)
    )
    condensed = condense_pressed(
        context.arrays("views")["paint_slope"],
        normal=markers.normal,
        motion=motion,
        pressed=pressed,
    )
    # Training finds how far the forces of its contacts spread between these two.
    on_footprints = pressed_motion(
        model,
        mesh,
        surface,
        markers,
        pressed=pressed,
        radius_mm=context.design.switch.footprint_diameter_mm / 2.0,
    )
    footprint = np.zeros((markers.count, 2, markers.count))
    slope = context.arrays("views")["paint_slope"]
    footprint[:, :, pressed] = np.einsum("nij,njm->nim", slope, on_footprints)
    write_arrays(
        folder,
        {
            "shift_to_mm": condensed.shift_to_mm,
            "compliance_px": condensed.compliance_px,
            "footprint_px": footprint.reshape(2 * markers.count, markers.count),
            "stiffness": condensed.stiffness,
            "sensitivity_px_mm": condensed.sensitivity_px_mm,
        },
    )
    write_facts(
        folder,
        {
            "nodes": len(mesh.nodes_mm),
            "condition": condensed.condition,
            "sensitivity_px_mm_least": float(condensed.sensitivity_px_mm[pressed].min()),
            "sensitivity_px_mm_median": float(np.median(condensed.sensitivity_px_mm[pressed])),
            "receptors": receptors,
            "receptors_unknown": unknown,
        },
    )


def frame_contacts(context: Context) -> tuple[Contacts, Switching]:
    """Draw the contacts of rendered frames, one to five at once, and what they trip."""
    scope = scope_of(context)
    contacts = draw_contacts(
        context.sensor,
        samples=context.accuracy.frames,
        rng=np.random.default_rng([context.seed, 2]),
        most=context.scene.at_once if context.scene else ALL_AT_ONCE,
        inside=scope.holds if scope else None,
    )
    return contacts, switch_states(context.sensor, contacts)


def run_twin(context: Context, folder: Path) -> None:
    """Draw contacts, solve them on the simulated sensor's meshes, project and add noise.

    The contacts of rendered frames are solved with them, whether or not frames are wanted: factors
    of those meshes are what takes time.
    """
    design = context.design
    rng = np.random.default_rng([context.seed, 1])
    count = samples_of(design, context.accuracy.sample_share, context.accuracy.frames)
    if context.scene is not None and not context.scene.networks:
        count = dict(SCENE_SAMPLES)
    scope = scope_of(context)
    drawn = {
        name: draw_contacts(
            context.sensor,
            samples=samples,
            rng=rng,
            placement="anywhere" if name == "anywhere" else "receptor",
            most=context.scene.at_once if context.scene else ALL_AT_ONCE,
            inside=scope.holds if scope else None,
        )
        for name, samples in count.items()
    }
    framed, _ = frame_contacts(context)
    solved = (*drawn.values(), framed)
    nodes, responses = truth_responses(
        context,
        np.concatenate([item.uv for item in solved]),
        np.concatenate([item.radius_mm for item in solved]),
    )
    dent = deepest_dent_mm(context, responses, np.concatenate([i.force_N for i in solved]))
    see = image_response_of(context)
    arrays: dict[str, Any] = {}
    start = 0
    for name, item in drawn.items():
        end = start + len(item.force_N)
        shift = see.shift(superpose(responses[start:end], item), linear=True)
        start = end
        noise = rng.normal(0.0, design.camera.noise_centroid_px, shift.shape)
        switching = switch_states(context.sensor, item)
        arrays |= Dataset(contacts=item, switching=switching, shift_px=shift + noise).arrays(name)
    write_arrays(folder, arrays | {"frames.motion": superpose(responses[start:], framed)})
    wall = "plain shell" if unknown_receptors(design) else "shell with receptors"
    write_facts(
        folder,
        {
            "model": f"linear {wall} on finer, non-nested meshes; simulated",
            "nodes": nodes,
            "samples": count,
            "dent_mm_largest": dent,
            "contacts": {name: len(item.force_N) for name, item in drawn.items()},
            "tripped_no_switch": {name: int((~arrays[f"{name}.tripped"]).sum()) for name in drawn},
        },
    )


def truth_responses(
    context: Context, uv: FloatArray, radius_mm: FloatArray
) -> tuple[int, FloatArray]:
    """Nodes of all meshes, and motion (c, n, 6) of the receptors per newton of each patch.

    It is extrapolated with a coarser mesh, where there is one.
    """
    unit = designed_shell(context.surface, context.markers)
    finer, pair = instance_shells(
        context.design,
        context.surface,
        unit,
        context.accuracy.truth_refine,
        _touched(context),
        markers=context.markers,
    )
    meshes = pair.each if pair else [finer]
    motion, *coarser = (
        motion_responses(
            model,
            mesh,
            context.surface,
            context.markers,
            uv=uv,
            radius_mm=radius_mm,
            progress=context.progress,
        )
        for mesh, model in meshes
    )
    if pair:
        # One patch after the other: motion of all of them may fill the memory.
        for k, coarse in enumerate(coarser[0]):
            motion[k] += pair.correction(motion[k], coarse)
    return sum(len(mesh.nodes_mm) for mesh, _ in meshes), motion


def truth_solver(context: Context) -> Solver:
    """The wall of the simulated sensor under large displacements."""
    return Solver(
        context.design,
        context.surface,
        designed_shell(context.surface, context.markers),
        refine=context.accuracy.truth_refine,
        displacement="large",
        region=_touched(context),
        markers=context.markers,
    )


def _touched(context: Context) -> ChartBox | None:
    """Part of the chart that a scene touches; None: all of it."""
    scope = scope_of(context)
    return scope.touched if scope else None


def deepest_dent_mm(context: Context, responses: FloatArray, force_N: FloatArray) -> float:
    """Largest motion of a marker under any one contact, by linear theory, mm.

    Raises
    ------
    DesignError
        If it is larger than the sensor: the forces are not for this wall.
    """
    per_N = np.linalg.norm(responses[..., :3], axis=2).max(axis=1)
    dent = float((per_N * force_N).max(initial=0.0))
    size = float(np.sort(np.ptp(context.surface.bounds_mm(), axis=0))[1]) / 2.0
    if dent > size:
        most = context.design.training.force_max_N
        raise DesignError(
            "contact-force-too-large",
            f"contacts of up to {most:g} N are too strong for this wall: they would press it in "
            f"by {dent:.3g} mm, and the sensor is {size:.3g} mm from its middle to its side; lower "
            f"training.force_max_N (a tenth of that depth is {0.1 * most * size / dent:.2g} N) or "
            "raise wall.thickness_mm",
        )
    return dent


def samples_of(design: Design, share: float, frames: int) -> dict[str, int]:
    """Samples of each set, of a share of the design's and of a number of rendered frames.

    Held-out samples beyond five for each frame are left out: they would make the scores of points
    more certain than those of frames, at 20 ms each.
    """
    test = max(round(min(share * design.training.samples_test, 5.0 * frames)), 10)
    return {
        "train": max(round(share * design.training.samples), 20),
        "test": test,
        "anywhere": max(test // 2, 10),
    }


RESPONSE = Stage(
    name="response",
    design_fields=("mechanics", "switch.footprint_diameter_mm"),
    settings=("refine", "receptors"),
    depends_on=("views",),
    arrays=IMAGE_ARRAYS,
    scene=("regions", "reach_mm"),
    run=run_response,
)
TWIN = Stage(
    name="twin",
    design_fields=("mechanics", "trips", "training", "camera.noise_centroid_px"),
    settings=("truth_refine", "sample_share", "frames"),
    depends_on=("views",),
    arrays=IMAGE_ARRAYS,
    seeded=True,
    scene=("regions", "reach_mm", "at_once", "networks"),
    run=run_twin,
)
