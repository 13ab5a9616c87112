"""Build what a scene requires, and compare the plan with the result."""

import json
import resource
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import load_bundle
from phytac_design.core.json_values import finite
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.layout.arc import by_area
from phytac_design.simulation.contacts import Contacts, Switching, switch_states
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.stages.build import BuildResult, build
from phytac_design.stages.response_stage import image_response_of, truth_solver
from phytac_design.study.planning.plan import BuildPlan
from phytac_shapes.arrays import FloatArray

Progress = Callable[[str], None]


def run_plan(
    plan: BuildPlan,
    out: Path,
    *,
    seed: int = 0,
    force: bool = False,
    errors: bool = True,
    progress: Progress = print,
) -> tuple[BuildResult, dict[str, Any]]:
    """Run a plan into ``out``, audit it, and write both as ``report/plan.json``.

    Returns the build and the audit: predicted and actual cost and error.

    Parameters
    ----------
    errors : bool
        Whether the audit presses the sensor to measure the force error.

    Raises
    ------
    DesignError
        If the design cannot be built.
    OutputError
        If the folder is not writable, or holds another design and ``force`` is not set.
    """
    resolved = plan.resolved
    start = cpu_s()
    built = build(
        resolved.design,
        out,
        accuracy=resolved.accuracy,
        stages=resolved.stages,
        scene=resolved.scene,
        seed=seed,
        force=force,
        progress=progress,
    )
    used = cpu_s() - start
    context = resolved.context(seed)
    context.folders.update(built.folders)
    seconds = {name: built.timing_s[name] for name in built.ran}
    done = audit(plan, context, ran=seconds, used_s=used, errors=errors, progress=progress)
    path = out / "report" / "plan.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(finite(plan.as_dict() | {"audit": done}), indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
    return built, done


def cpu_s() -> float:
    """Processor time of this process and its finished children, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def peak_MB() -> float:
    """Peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


@dataclass(frozen=True, kw_only=True)
class ReferencePresses:
    """Single contacts of a reference: large displacement on a finer mesh, without noise.

    Attributes
    ----------
    contacts : Contacts
        One in each sample.
    switching : Switching
        Switches that they trip.
    shift_px : (p, n, 2) float
        Marker shifts; NaN in all of a press without a solution.
    """

    contacts: Contacts
    switching: Switching
    shift_px: FloatArray


def reference_presses(
    context: Context, count: int = 6, progress: Progress = lambda _: None
) -> ReferencePresses:
    """Presses all over the regions of a context's scene, in the upper half of the force range.

    Theories differ at large forces.
    """
    design, surface, markers = context.design, context.surface, context.markers
    training, scope = design.training, scope_of(context)
    # An even additive sequence in the plane: powers of 1/p, p³ = p + 1.
    steps = np.array([0.7548776662466927, 0.5698402909980532])
    uv = by_area(surface, np.mod(0.5 + np.arange(1, 4097)[:, None] * steps, 1.0))
    uv = uv[surface.sensing(uv)]
    if scope is not None:
        uv = uv[scope.holds(uv)]
    uv = uv[:count]
    low, high = max(training.force_min_N, training.force_max_N / 2.0), training.force_max_N
    share = np.mod(0.5 + np.arange(len(uv)) * steps[0], 1.0)
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    contacts = Contacts.flat(
        sample=np.arange(len(uv)),
        uv=uv,
        radius_mm=np.full(len(uv), radius),
        force_N=low + share * (high - low),
        samples=len(uv),
    )
    solver, vision = truth_solver(context), image_response_of(context)
    shift = np.full((len(uv), markers.count, 2), np.nan)
    for k in range(len(uv)):
        progress(f"audit: press {k + 1} of {len(uv)}")
        motion = solver.solve(contacts.of(k), contacts.force_N[[k]]).motion
        if motion is not None:
            shift[k] = vision.shift(motion)
    return ReferencePresses(
        contacts=contacts,
        switching=switch_states(context.sensor, contacts),
        shift_px=shift,
    )


def force_errors(model: Any, presses: ReferencePresses, estimator: str) -> FloatArray:
    """Relative force error of every press, (p,); NaN without a tripped switch or a solution."""
    out = np.full(presses.contacts.samples, np.nan)
    for k, (shift, on) in enumerate(zip(presses.shift_px, presses.switching.bits, strict=True)):
        if on.any() and np.isfinite(shift).all():
            forces = model.forces(estimator, shift, np.flatnonzero(on))
            out[k] = float(forces.sum()) / float(presses.contacts.force_N[k]) - 1.0
    return out


def audit(
    plan: BuildPlan,
    context: Context,
    *,
    ran: dict[str, float],
    used_s: float,
    errors: bool = True,
    progress: Progress = lambda _: None,
) -> dict[str, Any]:
    """Predicted and actual cost and error of a plan.

    Parameters
    ----------
    context : Context
        With the folder of every stage.
    ran : dict
        Wall seconds of the stages that ran.
    used_s : float
        Processor time of all of them, s.
    errors : bool
        Whether to press the sensor to measure the force error, which takes seconds.
    """
    predicted = {row.stage: row.seconds for row in plan.rows}
    out: dict[str, Any] = {
        "stages": {
            name: {"predicted_s": predicted[name], "wall_s": seconds}
            for name, seconds in ran.items()
        },
        "seconds": {"predicted": plan.seconds, "actual": used_s, "wall": sum(ran.values())},
        "memory_MB": {"predicted": plan.memory_MB, "actual": peak_MB() if ran else 0.0},
        "counts": _counts(plan, context),
    }
    if errors and plan.error and "decoder" in context.folders:
        bundle = load_bundle(context.folders["decoder"] / EXPORT / "decoder")
        # The simulated sensor of a draft is of one mesh: up to 3 % off, and more beside rims.
        finer = max(context.accuracy.truth_refine, PRESETS["standard"].truth_refine)
        own = replace(context, accuracy=replace(context.accuracy, truth_refine=finer))
        presses = reference_presses(own, progress=progress)
        found = np.abs(force_errors(bundle.model, presses, plan.resolved.scene.estimator))
        found = found[np.isfinite(found)]
        out["error"] = {
            "predicted": plan.error["force"],
            "allowed": plan.resolved.scene.error_allowed,
            "actual": float(np.median(found)) if len(found) else None,
            "worst": float(found.max()) if len(found) else None,
            "presses": len(found),
            "tripped_no_switch": int((~presses.switching.tripped).sum()),
        }
    return out


def _counts(plan: BuildPlan, context: Context) -> dict[str, dict[str, float]]:
    """Amounts that stages report, beside those planned."""
    reported = {
        "nodes": ("response", "nodes"),
        "truth_nodes": ("twin", "nodes"),
        "places": ("places", "places"),
        "place_solves": ("places", "solves"),
        "presses": ("underload", "presses"),
    }
    return {
        name: {
            "predicted": float(getattr(plan.counts, name)),
            "actual": float(context.facts(stage)[fact]),
        }
        for name, (stage, fact) in reported.items()
        if stage in context.folders
    }
