"""The plan of a build: what runs, at which resolution, why and at what cost; what is left out."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from phytac_design.design.accuracy import Accuracy, preset_name
from phytac_design.design.scene import Scene
from phytac_design.design.spec import Design
from phytac_design.engine import cache
from phytac_design.engine.stage import Context, Stage
from phytac_design.geometry.curvature import curvatures
from phytac_design.mechanics.large.quasi_newton import LINEAR_ERROR_SAFETY
from phytac_design.stages import STAGES
from phytac_design.stages.places_stage import extrapolated_from
from phytac_design.study.planning.cost import Counts, Workload, features, machine_factor, predict
from phytac_design.study.planning.resolve import STAGES_OF, Resolved, resolve
from phytac_design.study.planning.unit_costs import MEMORY_MB, CPU_s

LOST = {
    "views": "no pictures; nothing is known of what the camera sees",
    "switch": "no switch files",
    "compare": "no comparison with straight rows",
    "underload": "markers that hide or fuse under load are not known",
    "pressed": "no pictures of a press in the report",
    "resolution": "the smallest possible error of a force is not known",
    "shell": "no STL, no 3MF",
    "step": "no STEP",
    "hardware": "no camera mount, cover, bar or connector",
    "mold": "no molds",
    "kit": "no calibration kit",
    "inserts": "no coloured inserts, if the design has them",
    "printing": "print rules are not checked",
    "bench": "no paint map, bill of materials or recipe",
    "mesh": "no mesh for other solvers",
    "response": "no matrices of a decoder",
    "places": "no `auto`: koi_inverse errs by about 8 % of a force in the middle, auto by 2 %",
    "twin": "no simulated data",
    "decoder": "no forces",
    "renders": "no frames to decode",
    "frames": "markers that the detector misses are not known",
    "report": "no report page",
}
"""What is missing without a stage."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One stage of a plan.

    Attributes
    ----------
    stage : str
        Name.
    action : str
        ``run``, ``cached`` or ``left out``.
    how : str
        Resolution and amount.
    why : str
        Output or stage that needs it.
    seconds, memory_MB : float
        Predicted cost; 0 from the cache. Of a stage that is left out, its cost in the whole build.
    loses : str
        What is missing because the stage is left out or limited.
    """

    stage: str
    action: str
    how: str
    why: str
    seconds: float
    memory_MB: float
    loses: str


@dataclass(frozen=True, kw_only=True)
class BuildPlan:
    """What a build of a scene will do.

    Attributes
    ----------
    resolved : Resolved
        The scene on the design.
    rows : tuple of Row
        Of all stages, in their order.
    counts, whole_counts : Counts
        Sizes of this build and of a whole one.
    whole_seconds, whole_memory_MB : float
        Predicted cost of a whole build.
    error : dict
        Predicted error of a force in the regions, as a share of it: its parts, and ``force``; empty
        where no decoder is made.
    """

    resolved: Resolved
    rows: tuple[Row, ...]
    counts: Counts
    whole_counts: Counts
    whole_seconds: float
    whole_memory_MB: float
    error: dict[str, float]

    @property
    def seconds(self) -> float:
        """Predicted processor time of what runs, s."""
        return sum(row.seconds for row in self.rows if row.action == "run")

    @property
    def memory_MB(self) -> float:
        """Predicted peak memory of what runs, MB."""
        return max((row.memory_MB for row in self.rows if row.action == "run"), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        resolved = self.resolved
        return {
            "design": resolved.design.name,
            "scene": resolved.scene.model_dump(mode="json"),
            "accuracy": preset_name(resolved.accuracy),
            "settings": resolved.accuracy.as_dict(),
            "decisions": resolved.why,
            "linear_error": resolved.linear_error,
            "stages": [asdict(row) for row in self.rows],
            "counts": asdict(self.counts),
            "whole": asdict(self.whole_counts)
            | {"seconds": self.whole_seconds, "memory_MB": self.whole_memory_MB},
            "predicted": {
                "seconds": self.seconds,
                "memory_MB": self.memory_MB,
                "error": self.error,
            },
        }


def plan_scene(
    design: Design, scene: Scene, *, accuracy: Accuracy, seed: int = 0, speed: float | None = None
) -> BuildPlan:
    """Plan the build of a scene; nothing runs but a pilot of less than a second.

    Parameters
    ----------
    speed : float, optional
        As of :func:`cost.machine_factor`; measured if not given.

    Raises
    ------
    DesignError
        If the scene does not fit the design.
    """
    resolved = resolve(design, scene, accuracy)
    slow = machine_factor(time.process_time) if speed is None else speed
    counts = Workload(resolved.design).counts(
        resolved.accuracy,
        scene=resolved.scene,
        scope=resolved.scope,
        in_play=int(resolved.in_play.sum()),
    )
    whole = Workload(design).counts(accuracy)
    # The whole sensor with the same kinds of files.
    same = replace(accuracy, tools=resolved.accuracy.tools, step=resolved.accuracy.step)
    full_amounts = features(whole, same, design)
    amounts = features(counts, resolved.accuracy, resolved.design, resolved.scene)
    full_s, full_MB = predict(CPU_s, full_amounts), predict(MEMORY_MB, full_amounts)
    own_s, own_MB = predict(CPU_s, amounts), predict(MEMORY_MB, amounts)
    cached = cached_stages(resolved.context(seed), resolved.stages)
    chosen = makers(resolved)
    rows = []
    for name in (stage.name for stage in STAGES):
        action = "left out" if name not in chosen else "cached" if name in cached else "run"
        seconds, memory = (own_s, own_MB) if name in chosen else (full_s, full_MB)
        rows.append(
            Row(
                stage=name,
                action=action,
                how=how_of(name, resolved, counts) if name in chosen else "",
                why=why_of(name, resolved),
                seconds=0.0 if action == "cached" else slow * seconds[name],
                memory_MB=0.0 if action == "cached" else memory[name],
                loses=lost_by(name, resolved, counts),
            )
        )
    return BuildPlan(
        resolved=resolved,
        rows=tuple(rows),
        counts=counts,
        whole_counts=whole,
        whole_seconds=slow * sum(full_s.values()),
        whole_memory_MB=max(full_MB.values()),
        error=predicted_error(resolved) if "decoder" in chosen else {},
    )


def makers(resolved: Resolved) -> set[str]:
    """Names of the stages of a scene that make something with its settings."""
    return {stage.name for stage in resolved.stages if stage.makes(resolved.accuracy)}


def cached_stages(context: Context, stages: Sequence[Stage]) -> frozenset[str]:
    """Stages whose results are in the cache; their folders are added to the context."""
    keys: dict[str, str] = {}
    for stage in stages:
        key = keys[stage.name] = cache.stage_key(stage.name, stage.inputs(context, keys))
        folder = cache.lookup(stage.name, key)
        if folder is not None:
            context.folders[stage.name] = folder
    return frozenset(context.folders)


def predicted_error(resolved: Resolved) -> dict[str, float]:
    """Relative force error of `auto` in the regions, without noise: its parts and the total.

    Linear theory has the error of the pilot, with its safety factor; a series of k powers of the
    force about the k-th power of that error, as the terms of a geometric series have. The error of
    the mesh covers the worst of 6 presses of `fingertip` and `grip5` on curved walls (1.2 %; 0.8 %
    with tables that are extrapolated). On flat and slightly curved walls the camera looks along the
    motion: errors of the tables of 1 % change a force by up to 12 % (`fingertip` on plane, patch
    and cuboid), with finer meshes too.
    """
    plain_mesh = 0.2  # at one element per marker pitch; it falls with the square of their number
    extrapolated_mesh = 0.01
    flat, flat_curvature = 0.12, 0.02  # and 1/mm
    table = 0.002  # of `auto` between the places of its tables, at 0.55 of the patches' radius
    off, accuracy = min(resolved.linear_error, 1.0), resolved.accuracy
    orders = accuracy.place_orders
    if "places" not in {stage.name for stage in resolved.stages}:
        return {}
    parts = {
        "theory": off if orders == 1 else (off / LINEAR_ERROR_SAFETY) ** orders,
        "mesh": extrapolated_mesh
        if extrapolated_from(accuracy.refine, len(resolved.in_play))
        else plain_mesh / accuracy.refine**2,
        "table": table * (accuracy.place_share / 0.55) ** 3,
    }
    sensor = resolved.context().sensor
    bent = np.abs(curvatures(sensor.surface, sensor.markers.uv[resolved.in_play])).max(axis=1)
    if (bent < flat_curvature).any():
        parts["flat wall"] = flat
    return parts | {"force": sum(value**2 for value in parts.values()) ** 0.5}


def how_of(name: str, resolved: Resolved, counts: Counts) -> str:
    """Resolution and amount of a stage."""
    accuracy, scene = resolved.accuracy, resolved.scene
    played = f"{counts.in_play} of {counts.markers} receptors"
    sector = f", one of {counts.repeats} sectors solved" if counts.repeats > 1 else ""
    pictures = "pictures" if scene.pictures else "no pictures"
    theory = "linear" if accuracy.press_tolerance >= 1.0 else "large where linear is not enough"
    powers = "1 power" if accuracy.place_orders == 1 else f"{accuracy.place_orders} powers"
    local = ", fine in the regions alone" if resolved.scope else ""
    networks = "networks trained" if scene.networks else "no networks"
    frames = f"{counts.frames} frames of {counts.megapixels:.1f} Mpx"
    solid = f"{counts.markers} receptors, chords within {accuracy.cad_tolerance_mm:g} mm"
    texts = dict.fromkeys(("shell", "hardware", "mold", "kit", "printing", "bench"), solid) | {
        "views": f"{counts.markers} markers, {counts.megapixels:.1f} Mpx, {pictures}",
        "inserts": solid if resolved.design.receptor.has_inserts else "none",
        "underload": f"{counts.presses} presses on {counts.nodes} nodes, {theory}",
        "pressed": "12 pictures of a press",
        "resolution": f"{played}, {counts.nodes} nodes",
        "mesh": f"{counts.nodes} nodes",
        "response": f"{played}, {counts.nodes} nodes, {counts.response_loads} loads{sector}",
        "places": f"{counts.places} places, {counts.place_solves} solved, {powers} of the force, "
        f"{counts.nodes} nodes",
        "twin": f"{counts.contacts} contacts and those of {counts.frames} frames, "
        f"{counts.twin_loads} loads, {counts.truth_nodes} "
        f"nodes{local}",
        "decoder": f"{played}, {networks}, {scene.estimator}",
        "renders": frames,
        "frames": frames,
    }
    return texts.get(name, f"{counts.markers} receptors")


def why_of(name: str, resolved: Resolved) -> str:
    """Output or stage that needs a stage."""
    own = next((stage for stage in resolved.stages if stage.name == name), None)
    if own and not own.makes(resolved.accuracy):
        return f"quick settings; --set {own.only_with}=true makes it"
    outputs = [o for o in resolved.scene.outputs if name in STAGES_OF[o]]
    if outputs:
        return "output " + ", ".join(outputs)
    readers = [stage.name for stage in resolved.stages if name in stage.depends_on]
    if readers:
        return "read by " + ", ".join(readers)
    if name == "places" and "decoder" in {stage.name for stage in resolved.stages}:
        return resolved.why.get("estimator", "the estimator does not need it")
    return "no output needs it"


def lost_by(name: str, resolved: Resolved, counts: Counts) -> str:
    """What is missing because a stage is left out or limited; "" if nothing."""
    scene, limited = resolved.scene, resolved.scope is not None
    if name not in makers(resolved):
        return LOST[name]
    outside = counts.markers - counts.in_play
    texts = {
        "views": "" if scene.pictures else "no pictures",
        "response": f"no forces on {outside} receptors, listed in the decoder's limits"
        if outside
        else "",
        "places": "none in the regions, whose places are the whole table's; no forces outside"
        if limited
        else "",
        "twin": ""
        if scene.networks
        else "evaluated on few contacts; the mesh is coarse outside the regions",
        "decoder": "" if scene.networks else "no networks of the paper",
        "underload": "no presses outside the regions" if limited else "",
    }
    return texts.get(name, "")
