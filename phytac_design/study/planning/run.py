"""Build what a scene requires, and audit the plan."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.design.scene import building
from phytac_design.engine import cache
from phytac_design.rules.check import check_design
from phytac_design.stages.build import _claim, _export, run_stages
from phytac_design.study.planning.audit import audit
from phytac_design.study.planning.measure import cpu_s
from phytac_design.study.planning.plan import Plan

FILE = "report/plan.json"


@dataclass(frozen=True, kw_only=True)
class SceneResult:
    """What a build of a scene did.

    Attributes
    ----------
    out : Path
        The exports folder.
    ran : tuple of str
        Stages that ran; the others came from the cache.
    audit : dict
        Predicted and actual cost and error.
    """

    out: Path
    ran: tuple[str, ...]
    audit: dict[str, Any]


def run_plan(
    plan: Plan,
    out: Path,
    *,
    seed: int = 0,
    force: bool = False,
    errors: bool = True,
    progress: Callable[[str], None] = print,
) -> SceneResult:
    """Run a plan into ``out``, audit it, and write both as ``report/plan.json``.

    Parameters
    ----------
    errors : bool
        Whether the audit presses the sensor for the error of a force.

    Raises
    ------
    DesignError
        If the design cannot be built.
    OutputError
        If the folder is not writable, or holds another design and ``force`` is not set.
    """
    resolved = plan.resolved
    check_design(resolved.design)
    _claim(out, resolved.design, force=force)
    start = cpu_s()
    with building(resolved.scene):
        context, ran, _ = run_stages(
            resolved.design,
            resolved.stages,
            accuracy=resolved.accuracy,
            seed=seed,
            force=force,
            progress=progress,
        )
        used = cpu_s() - start
        seconds = {name: float(cache.record(context.folders[name])["seconds"]) for name in ran}
        _export(out, resolved.design, resolved.stages, context)
    done = audit(plan, context, ran=seconds, used_s=used, errors=errors, progress=progress)
    path = out / FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(finite(plan.as_dict() | {"audit": done}), indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
    return SceneResult(out=out, ran=tuple(ran), audit=done)
