"""Scenes: their cost against the whole sensor's, the error that costs, predicted against actual.

Parts ``scenes`` and ``units`` of ``python -m benchmarks.tradeoff``; the latter measures the unit
costs of plans and writes them into ``phytac_design/study/planning/unit_costs.py``.
"""

import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.decoder_data import data_folder
from benchmarks.harness import Table
from benchmarks.tradeoff_costs import write_units
from benchmarks.tradeoff_journal import cache_at, empty_cache, once
from phytac_decoder.io.bundle import load_bundle
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.scene import Scene, load_scene
from phytac_design.design.spec import Design
from phytac_design.engine.stage import EXPORT, Context, Stage
from phytac_design.stages import STAGES
from phytac_design.stages.build import run_stages
from phytac_design.study.planning.cost import Amounts, Workload, features, fit
from phytac_design.study.planning.plan import plan_scene
from phytac_design.study.planning.resolve import resolve
from phytac_design.study.planning.run_plan import (
    cpu_s,
    force_errors,
    peak_MB,
    reference_presses,
)

SHAPES = ("cylinder60", "grip")
SCENES = ("fingertip", "grip5", "occlusion", "fabrication")
PREDICTED_WITHIN = 2.0
"""Factor between predicted and actual cost; see docs/plan.md."""
SAME: dict[str, tuple[tuple[str, str, tuple[str, ...], str, str], ...]] = {
    "occlusion": (
        (
            "markers hidden or fused at rest, against the whole build's",
            "views",
            ("occluded", "fused"),
            "markers",
            "== 0",
        ),
        (
            "least gap of a colour under load, difference from the whole build's",
            "underload",
            ("least_gap_same_colour_px",),
            "px",
            "<= 0.5",
        ),
    ),
    "fabrication": (
        (
            "volume of the shell, difference from the whole build's",
            "shell",
            ("volume_mm3",),
            "relative",
            "== 0",
        ),
    ),
}
"""Figures of scenes that must be those of the whole build: row, stage, facts, unit and target."""
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
    """Cost of a build by stage: processor and wall time, s, and peak memory, MB; and results."""

    stages: dict[str, dict[str, Any]]

    @property
    def cpu_s(self) -> float:
        """Processor time of all stages."""
        return sum(float(item["cpu_s"]) for item in self.stages.values())

    @property
    def peak_MB(self) -> float:
        """Greatest memory of a stage, libraries included."""
        return max(float(item["peak_MB"]) for item in self.stages.values())

    @property
    def folders(self) -> dict[str, Path]:
        """Result folder of each stage."""
        return {name: Path(item["folder"]) for name, item in self.stages.items()}


def build_of(
    name: str, accuracy: str, scene: str
) -> tuple[Design, Sequence[Stage], Any, Scene | None]:
    """Design, stages, settings and scene of a build."""
    design, settings = load_design(name), PRESETS[accuracy]
    if not scene:
        return design, STAGES, settings, None
    own = resolve(design, load_scene(scene), settings)
    return own.design, own.stages, own.accuracy, own.scene


def run_last(name: str, accuracy: str, scene: str, count: int) -> dict[str, Any]:
    """Run the last of the first stages of a build, those before being in the cache."""
    design, stages, settings, own = build_of(name, accuracy, scene)
    spent: list[float] = []
    with cache_at(data_folder() / "scenes"):
        context, ran, seconds = run_stages(
            design,
            stages[:count],
            accuracy=settings,
            scene=own,
            seed=0,
            force=True,
            progress=lambda _: spent.append(cpu_s()),
        )
    last = stages[count - 1].name
    if last not in ran:  # by a run that was killed
        shutil.rmtree(context.folders[last])
        return run_last(name, accuracy, scene, count)
    return {
        "cpu_s": spent[-1] - spent[0],
        "wall_s": seconds[last],
        "peak_MB": peak_MB(),
        "folder": str(context.folders[last]),
    }


def apart(*arguments: Any) -> dict[str, Any]:
    """:func:`run_last` in a process of its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(run_last, *arguments).result()


def measured(name: str, accuracy: str, scene: str = "") -> Cost:
    """Cost of a build, each stage in a process of its own, one after the other."""
    design, stages, _, _ = build_of(name, accuracy, scene)
    return Cost(
        stages={
            stage.name: once(
                design,
                f"stage {stage.name} {accuracy} {scene}",
                partial(apart, name, accuracy, scene, number),
            )
            for number, stage in enumerate(stages, start=1)
        }
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows of all scenes on two shapes."""
    accuracy = "draft" if quick else "standard"
    for shape in SHAPES[:1] if quick else SHAPES:
        whole = measured(shape, accuracy)
        for name in SCENES[:1] if quick else SCENES:
            cost = measured(shape, accuracy, name)
            label = f"scene {name} on {shape}, {accuracy}"
            row = f"{label}: times cheaper than the whole sensor, processor time"
            source = f"the whole sensor, s of all stages; the scene takes {cost.cpu_s:.1f} s"
            target = ">= 10" if name == "fingertip" else None
            value = whole.cpu_s / cost.cpu_s
            table.add(row, value, "ratio", round(whole.cpu_s, 1), source, target)
            row = f"{label}: peak memory"
            table.add(row, cost.peak_MB, "MB", round(whole.peak_MB, 0), "the whole sensor, MB")
            with empty_cache():
                plan = plan_scene(load_design(shape), load_scene(name), accuracy=PRESETS[accuracy])
            for what, predicted, actual in (
                ("processor time", plan.seconds, cost.cpu_s),
                ("peak memory", plan.memory_MB, cost.peak_MB),
            ):
                row = f"{label}: {what}, predicted against actual, off by the factor"
                value = max(predicted / actual, actual / predicted)
                source = f"predicted; actual {actual:.1f}"
                target = f"<= {PREDICTED_WITHIN}"
                table.add(row, value, "ratio", round(predicted, 1), source, target)
            for what, stage, figures, unit, target in SAME.get(name, ()):
                mine, full = (
                    _figure(folders[stage], figures) for folders in (cost.folders, whole.folders)
                )
                value = abs(mine / full - 1.0) if unit == "relative" else abs(mine - full)
                table.add(f"{label}: {what}", value, unit, full, "the whole build", target)
            if "decoder" in cost.folders:
                context = plan.resolved.context()
                context.folders.update(cost.folders)
                allowed, predicted = plan.resolved.scene.error_allowed, plan.error["force"]
                presses = 4 if quick else 16
                _add_forces(table, label, context, whole, presses, allowed, predicted)


def _figure(folder: Path, names: Sequence[str]) -> float:
    """Sum of some facts of a stage."""
    facts = json.loads((folder / "facts.json").read_text())
    return float(sum({**facts, **facts.get("visibility", {})}[name] for name in names))


def _add_forces(
    table: Table,
    label: str,
    context: Context,
    whole: Cost,
    presses: int,
    allowed: float,
    predicted: float,
) -> None:
    """Forces in the regions: by the scene's decoder against the whole one's, and the truth."""
    pressed = reference_presses(context, presses)
    ours, theirs = (
        force_errors(load_bundle(folders["decoder"] / EXPORT / "decoder").model, pressed, "auto")
        for folders in (context.folders, whole.folders)
    )
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
    row = f"{label}: worst error of a force"
    source = f"predicted by the plan; {where}"
    value = 100.0 * float(np.abs(ours[judged]).max())
    table.add(row, value, "%", 100.0 * predicted, source, f"<= {100.0 * allowed:g}")


def measure_units(table: Table) -> None:
    """Fit unit costs to measured builds and write them; adds no rows."""
    del table
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
