"""Time and memory of stages: each runs in its own forked process, one after the other.

``python -m benchmarks.tradeoff_measure DESIGN ACCURACY [SCENE]`` prints them as JSON.
"""

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from phytac_design.engine import cache
from phytac_design.engine.stage import Context, Stage
from phytac_design.stages.build import StageTask
from phytac_design.study.planning.run_plan import cpu_s, peak_MB
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What a stage cost when it ran.

    Attributes
    ----------
    wall_s, cpu_s : float
        Wall and processor time.
    peak_MB : float
        Greatest memory of its process, libraries included.
    """

    wall_s: float
    cpu_s: float
    peak_MB: float


def measure_stages(
    context: Context, stages: Sequence[Stage], progress: Callable[[str], None] = lambda _: None
) -> dict[str, Measured]:
    """Run stages in order, each in a fork of its own; results lie in the cache as a build's do.

    What the cache holds already is not run: its figures are those of the run that made it, if that
    was measured, else it is left out.

    Raises
    ------
    NumericalError
        If a stage fails.
    """
    keys: dict[str, str] = {}
    out: dict[str, Measured] = {}
    for stage in stages:
        keys[stage.name] = cache.stage_key(stage.name, stage.inputs(context, keys))
        if cache.lookup(stage.name, keys[stage.name]) is None:
            progress(f"measuring {stage.name}")
            needed = {name: context.folders[name] for name in stage.depends_on}
            inner = replace(context, folders=needed, array_names=stage.arrays)
            _forked(stage, keys[stage.name], inner)
        folder = cache.lookup(stage.name, keys[stage.name])
        if folder is None:
            raise NumericalError(
                "stage-failed", f"the stage {stage.name} failed; build the design to see why"
            )
        context.folders[stage.name] = folder
        record = cache.record(folder)
        if "cpu_s" in record:
            out[stage.name] = Measured(
                wall_s=record["seconds"], cpu_s=record["cpu_s"], peak_MB=record["peak_MB"]
            )
    return out


def _forked(stage: Stage, key: str, context: Context) -> None:
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        return
    # The child leaves without the parent's clean-up, whatever happens.
    try:
        cache.publish(stage.name, key, lambda folder: _record(stage, context, folder))
    finally:
        os._exit(0)


def _record(stage: Stage, context: Context, folder: Path) -> dict[str, Any]:
    cpu = cpu_s()
    return StageTask(stage, context, f"measuring {stage.name}")(folder) | {
        "cpu_s": round(cpu_s() - cpu, 3),
        "peak_MB": round(peak_MB(), 1),
    }


def measure(design: str, accuracy: str, scene: str = "") -> dict[str, Any]:
    """Costs and result folders of the stages of a build, of a scene if one is named."""
    from phytac_design.design.accuracy import settings_of
    from phytac_design.design.design_file import load_design
    from phytac_design.design.scene import load_scene
    from phytac_design.stages import STAGES
    from phytac_design.study.planning.resolve import resolve

    loaded, settings = load_design(design), settings_of(accuracy)
    stages: Sequence[Stage] = STAGES
    context = Context(design=loaded, accuracy=settings, seed=0, progress=lambda _: None)
    if scene:
        resolved = resolve(loaded, load_scene(scene), settings)
        stages, context = resolved.stages, resolved.context()
    costs = measure_stages(context, stages, lambda text: print(text, file=sys.stderr, flush=True))
    return {
        "costs": {name: asdict(cost) for name, cost in costs.items()},
        "folders": {name: str(folder) for name, folder in context.folders.items()},
    }


if __name__ == "__main__":
    print(json.dumps(measure(*sys.argv[1:])))
