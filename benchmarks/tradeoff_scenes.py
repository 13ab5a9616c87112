"""Scenes: their cost against the whole sensor's, the error that costs, predicted against actual.

Part of ``python -m benchmarks.tradeoff``. Results of stages lie below ``$PHYTAC_DATA``: a run that
was killed resumes. ``python -m benchmarks.tradeoff_scenes --units`` measures the unit costs of
plans and writes them into ``phytac_design/study/planning/unit_costs.py``.
"""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.decoder_data import data_folder
from benchmarks.harness import Table, argument_parser
from benchmarks.tradeoff_costs import write_units
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.scene import load_scene
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.simulation.dataset import Dataset
from phytac_design.study.planning.cost import PREDICTED_WITHIN, Amounts, Workload, features, fit
from phytac_design.study.planning.plan import plan_scene
from phytac_design.study.planning.resolve import Resolved, resolve
from phytac_design.study.planning.run_plan import force_errors, reference_presses

SHAPES = ("cylinder60", "grip")
SCENES = ("fingertip", "grip5", "occlusion", "fabrication")
PRESSES = 16
FITTED = (
    ("cylinder60", "standard", ""),
    ("cylinder60", "draft", ""),
    ("grip", "standard", ""),
    ("hemisphere", "draft", ""),
    ("cylinder60", "standard", "fingertip"),
    ("cylinder60", "standard", "grip5"),
    ("grip", "standard", "fingertip"),
    ("hemisphere", "standard", "fingertip"),
)
"""Builds that unit costs are fitted to."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Cost of a build: processor and wall time, s, greatest memory, MB; and where results lie."""

    cpu_s: float
    wall_s: float
    peak_MB: float
    stages: dict[str, dict[str, float]]
    folders: dict[str, Path]


def measured(design: str, accuracy: str, scene: str = "") -> Cost:
    """Build in a process of its own, from what the benchmark's cache lacks."""
    words = [design, accuracy, *([scene] if scene else [])]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.tradeoff_measure", *words],
        env={**os.environ, "PHYTAC_CACHE": str(data_folder() / "scenes")},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    data = json.loads(done.stdout.splitlines()[-1])
    costs = data["costs"]
    return Cost(
        cpu_s=sum(item["cpu_s"] for item in costs.values()),
        wall_s=sum(item["wall_s"] for item in costs.values()),
        peak_MB=max(item["peak_MB"] for item in costs.values()),
        stages=costs,
        folders={name: Path(folder) for name, folder in data["folders"].items()},
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows of all scenes on two shapes."""
    accuracy = "draft" if quick else "standard"
    for shape in SHAPES[:1] if quick else SHAPES:
        whole = measured(shape, accuracy)
        for name in SCENES[:1] if quick else SCENES:
            cost = measured(shape, accuracy, name)
            resolved = resolve(load_design(shape), load_scene(name), PRESETS[accuracy])
            label = f"scene {name} on {shape}, {accuracy}"
            _add_costs(table, label, cost, whole, one=name == "fingertip")
            _add_prediction(table, label, shape, accuracy, name, cost)
            context = resolved.context()
            context.folders.update(cost.folders)
            if "decoder" in cost.folders:
                _add_forces(table, label, context, whole, presses=4 if quick else PRESSES)
            if name == "fingertip":
                _add_outside(table, label, resolved, cost, whole)
            if name == "occlusion":
                _add_occlusion(table, label, context, whole)
            if name == "fabrication":
                _add_fabrication(table, label, context, whole)


def _add_costs(table: Table, label: str, cost: Cost, whole: Cost, *, one: bool) -> None:
    row = f"{label}: times cheaper than the whole sensor, processor time"
    source = f"the whole sensor, s of all stages; the scene takes {cost.cpu_s:.1f} s"
    value = whole.cpu_s / cost.cpu_s
    table.add(row, value, "ratio", round(whole.cpu_s, 1), source, ">= 10" if one else None)
    shared = [name for name in cost.stages if name in whole.stages]
    row = f"{label}: times cheaper than the same stages of the whole sensor, processor time"
    source = "these stages, of all of the surface, s"
    value = sum(whole.stages[name]["cpu_s"] for name in shared) / cost.cpu_s
    table.add(
        row, value, "ratio", round(sum(whole.stages[name]["cpu_s"] for name in shared), 1), source
    )
    row = f"{label}: wall time, one stage after the other"
    table.add(row, cost.wall_s, "s", round(whole.wall_s, 1), "the whole sensor, s")
    table.add(
        f"{label}: peak memory", cost.peak_MB, "MB", round(whole.peak_MB, 0), "the whole sensor, MB"
    )


def _add_prediction(
    table: Table, label: str, shape: str, accuracy: str, name: str, cost: Cost
) -> None:
    """Predicted over actual cost, as a factor of at least 1."""
    with tempfile.TemporaryDirectory() as empty:
        before = os.environ.get("PHYTAC_CACHE")
        os.environ["PHYTAC_CACHE"] = empty
        try:
            plan = plan_scene(load_design(shape), load_scene(name), accuracy=PRESETS[accuracy])
        finally:
            os.environ.pop("PHYTAC_CACHE")
            if before is not None:
                os.environ["PHYTAC_CACHE"] = before
    for what, predicted, actual in (
        ("processor time", plan.seconds, cost.cpu_s),
        ("peak memory", plan.memory_MB, cost.peak_MB),
    ):
        table.add(
            f"{label}: {what}, predicted against actual, off by the factor",
            max(predicted / actual, actual / predicted),
            "ratio",
            reference=round(predicted, 1),
            source=f"predicted; actual {actual:.1f}",
            target=f"<= {PREDICTED_WITHIN}",
        )


def _bundle(folders: dict[str, Path]) -> Bundle:
    return load_bundle(folders["decoder"] / EXPORT / "decoder")


def _add_forces(table: Table, label: str, context: Context, whole: Cost, *, presses: int) -> None:
    """Forces in the regions: by the scene's decoder against the whole one's, and the truth."""
    pressed = reference_presses(context, presses)
    mine, full = _bundle(context.folders), _bundle(whole.folders)
    ours, theirs = (force_errors(bundle.model, pressed, "auto") for bundle in (mine, full))
    judged = np.isfinite(ours) & np.isfinite(theirs)
    apart = np.abs((ours - theirs) / (1.0 + theirs))[judged]
    where = f"{int(judged.sum())} presses in the regions, large displacement, finer mesh, no noise"
    row = f"{label}: force by its decoder against the whole sensor's, greatest difference"
    source = f"reference: median; {where}"
    table.add(row, 100.0 * float(apart.max()), "%", 100.0 * float(np.median(apart)), source, "<= 1")
    row = f"{label}: force by its decoder against the truth, median error"
    source = f"the whole sensor's decoder; {where}"
    value = 100.0 * float(np.median(np.abs(ours[judged])))
    table.add(row, value, "%", 100.0 * float(np.median(np.abs(theirs[judged]))), source)
    named = load_scene(context.scene.name if context.scene else "")
    design = load_design(context.design.name)
    plan = plan_scene(design, named, accuracy=context.accuracy, speed=1.0)
    row = f"{label}: worst error of a force"
    source = f"predicted by the plan; {where}"
    value = 100.0 * float(np.abs(ours[judged]).max())
    target = f"<= {100.0 * plan.resolved.scene.error_allowed:g}"
    table.add(row, value, "%", 100.0 * plan.error["force"], source, target)


def _add_outside(table: Table, label: str, resolved: Resolved, cost: Cost, whole: Cost) -> None:
    """Single contacts off the receptors in play: whether their forces are doubted."""
    bundle, doubted, outside = _bundle(cost.folders), 0, 0
    with np.load(whole.folders["twin"] / "arrays.npz") as data:
        arrays = {name: data[name] for name in data.files}
    for name in ("test", "anywhere"):
        for one in singles(Dataset.from_arrays(arrays, name)):
            if len(one.koi) == 0 or resolved.in_play[one.koi].any():
                continue
            outside += 1
            forces = one.forces_N(bundle, "auto")
            doubted += bool(one.warnings(bundle, forces, estimator="auto"))
    row = f"{label}: contacts that trip only switches out of play, doubted"
    source = "contacts of the whole sensor's simulated data, one at a time"
    table.add(row, 100.0 * doubted / outside, "%", outside, source, ">= 100")


def singles(data: Dataset) -> list[FrameMeasurement]:
    """Samples of a single contact, as eyes that miss nothing measure them."""
    contacts = data.contacts
    alone = np.flatnonzero(contacts.counts[contacts.sample] == 1)
    return [
        FrameMeasurement(
            koi=np.flatnonzero(data.switching.bits[sample]),
            shift_px=data.shift_px[sample],
            found=np.ones(data.shift_px.shape[1], dtype=np.bool_),
        )
        for sample in contacts.sample[alone]
    ]


def both(context: Context, whole: Cost) -> tuple[dict[str, Path], dict[str, Path]]:
    """Result folders of a scene's build and of the whole sensor's."""
    return context.folders, whole.folders


def _facts(folders: dict[str, Path], stage: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((folders[stage] / "facts.json").read_text())
    return data


def _add_occlusion(table: Table, label: str, context: Context, whole: Cost) -> None:
    """Figures of visibility against those of the whole build."""
    mine, full = (_facts(folders, "views") for folders in both(context, whole))
    row = f"{label}: markers hidden or fused at rest, against the whole build's"
    source = "the whole build"
    value = abs(sum(mine["visibility"][k] - full["visibility"][k] for k in ("occluded", "fused")))
    reference = full["visibility"]["occluded"] + full["visibility"]["fused"]
    table.add(row, value, "markers", reference, source, "== 0")
    mine, full = (_facts(folders, "underload") for folders in both(context, whole))
    row = f"{label}: least gap of a colour under load, difference from the whole build's"
    source = "the whole build"
    value = abs(mine["least_gap_same_colour_px"] - full["least_gap_same_colour_px"])
    table.add(row, value, "px", full["least_gap_same_colour_px"], source, "<= 0.5")


def _add_fabrication(table: Table, label: str, context: Context, whole: Cost) -> None:
    """The shell against that of the whole build."""
    mine, full = (float(_facts(folders, "shell")["volume_mm3"]) for folders in both(context, whole))
    row = f"{label}: volume of the shell, difference from the whole build's"
    table.add(row, abs(mine / full - 1.0), "relative", full, "the whole build, mm3", "== 0")


def measure_units() -> None:
    """Fit unit costs to measured builds and write them."""
    times: dict[str, list[tuple[Amounts, float]]] = {}
    peaks: dict[str, list[tuple[Amounts, float]]] = {}
    for shape, accuracy, name in FITTED:
        design, settings = load_design(shape), PRESETS[accuracy]
        amounts = features(Workload(design).counts(settings), settings, design)
        if name:
            own = resolve(design, load_scene(name), settings)
            counts = Workload(own.design).counts(
                own.accuracy, scene=own.scene, scope=own.scope, in_play=int(own.in_play.sum())
            )
            amounts = features(counts, own.accuracy, own.design, own.scene)
        for stage, cost in measured(shape, accuracy, name).stages.items():
            times.setdefault(stage, []).append((amounts[stage], cost["cpu_s"]))
            peaks.setdefault(stage, []).append((amounts[stage], cost["peak_MB"]))
    write_units(CPU_s=fit(times), MEMORY_MB=fit(peaks))


def main() -> None:
    """Measure unit costs, or print the rows."""
    parser = argument_parser(__doc__ or "")
    parser.add_argument("--units", action="store_true", help="measure and write unit costs")
    given = parser.parse_args()
    if given.units:
        measure_units()
        return
    add_rows(Table("tradeoff", part="scenes"), quick=given.quick)


if __name__ == "__main__":
    main()
