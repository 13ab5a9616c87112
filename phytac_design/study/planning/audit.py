"""After the run: predicted and actual cost and error, side by side."""

import resource
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import load_bundle
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.layout.arc import by_area
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads
from phytac_design.simulation.contacts import Contacts, Switching, switch_states
from phytac_design.simulation.indenters import flat_touches
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_design.simulation.scene_scope import scope_of
from phytac_design.stages.response import image_response_of, truth_model
from phytac_design.study.planning.measure import MB
from phytac_design.study.planning.plan import Plan
from phytac_shapes.arrays import FloatArray

PRESSES = 6
"""Presses that the error of a force is measured with."""
GOLDEN = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of an even sequence in the plane."""
POOL = 4096


@dataclass(frozen=True, kw_only=True)
class Presses:
    """Single contacts of a reference: large displacement on a finer mesh, without noise.

    Attributes
    ----------
    contacts : Contacts
        One in each sample.
    switching : Switching
        What they trip.
    shift_px : (p, n, 2) float
        Marker shifts; NaN in all of a press that was not solved.
    """

    contacts: Contacts
    switching: Switching
    shift_px: FloatArray


def reference_presses(
    context: Context, count: int = PRESSES, progress: Callable[[str], None] = lambda _: None
) -> Presses:
    """Presses all over the regions of a context's scene, with forces over the whole range."""
    design, surface, markers = context.design, context.surface, context.markers
    training, scope = design.training, scope_of(context)
    uv = by_area(surface, np.mod(0.5 + np.arange(1, POOL + 1)[:, None] * GOLDEN, 1.0))
    uv = uv[surface.sensing(uv)]
    if scope is not None:
        uv = uv[scope.holds(uv)]
    uv = uv[:count]
    # Strong presses are where theories part: the upper half of the range.
    low, high = max(training.force_min_N, training.force_max_N / 2.0), training.force_max_N
    share = np.mod(0.5 + np.arange(len(uv)) * GOLDEN[0], 1.0)
    contacts = Contacts(
        sample=np.arange(len(uv)),
        uv=uv,
        radius_mm=np.full(
            len(uv), (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        ),
        force_N=low + share * (high - low),
        samples=len(uv),
    )
    mesh, model = truth_model(context)
    receptor = design.receptor
    holes = Holes.of(surface, markers.uv, receptor.diameter_hole_mm / 2.0)
    feet = ReceptorKinematics(mesh, surface, markers.uv, receptor.diameter_outer_mm / 2.0)
    shell, see = QuasiNewtonSolver(model), image_response_of(context)
    unit = indentation_loads(mesh, surface, flat_touches(contacts), holes=holes).toarray()
    shift = np.full((len(uv), markers.count, 2), np.nan)
    for k, force in enumerate(contacts.force_N):
        progress(f"audit: press {k + 1} of {len(uv)}")
        motion = shell.solve(force * unit[:, k]).sample.motion
        if motion is not None:
            shift[k] = see.shift(feet.large(motion.ravel()))
    return Presses(
        contacts=contacts,
        switching=switch_states(design, surface, markers, contacts),
        shift_px=shift,
    )


def force_errors(model: Any, presses: Presses, estimator: str) -> FloatArray:
    """Relative error of every press's force, (p,); NaN where no switch tripped or none solved."""
    out = np.full(presses.contacts.samples, np.nan)
    for k, (shift, bits) in enumerate(zip(presses.shift_px, presses.switching.bits, strict=True)):
        if bits.any() and np.isfinite(shift).all():
            forces = model.forces(estimator, shift, np.flatnonzero(bits))
            truth = float(presses.contacts.force_N[k])
            out[k] = float(forces.sum()) / truth - 1.0
    return out


def audit(
    plan: Plan,
    context: Context,
    *,
    ran: dict[str, float],
    used_s: float,
    errors: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Hold a plan against what came of it.

    Parameters
    ----------
    context : Context
        With the folder of every stage.
    ran : dict
        Wall seconds of the stages that ran.
    used_s : float
        Processor time of all of them, s.
    errors : bool
        Whether to press the sensor for the error of a force, which takes seconds.
    """
    rows = {row.stage: row for row in plan.rows}
    out: dict[str, Any] = {
        "stages": {
            name: {"predicted_s": rows[name].seconds, "wall_s": seconds}
            for name, seconds in ran.items()
        },
        "seconds": {"predicted": plan.seconds, "actual": used_s, "wall": sum(ran.values())},
        "memory_MB": {
            "predicted": plan.memory_MB,
            "actual": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MB if ran else 0.0,
        },
        "counts": _counted(plan, context),
    }
    if errors and plan.error and "decoder" in context.folders:
        bundle = load_bundle(context.folders["decoder"] / EXPORT / "decoder")
        presses = reference_presses(context, progress=progress)
        found = np.abs(force_errors(bundle.model, presses, plan.resolved.scene.estimator))
        judged = found[np.isfinite(found)]
        out["error"] = {
            "predicted": plan.error["force"],
            "allowed": plan.resolved.scene.error_allowed,
            "actual": float(np.median(judged)) if len(judged) else None,
            "worst": float(judged.max()) if len(judged) else None,
            "presses": len(judged),
            "tripped_no_switch": int((~presses.switching.tripped).sum()),
        }
    return out


def _counted(plan: Plan, context: Context) -> dict[str, dict[str, float]]:
    """Counts that stages tell of, beside those planned."""
    told = {
        "nodes": ("response", "nodes"),
        "truth_nodes": ("twin", "nodes"),
        "places": ("places", "places"),
        "place_solves": ("places", "solves"),
        "presses": ("underload", "presses"),
    }
    out = {}
    for name, (stage, fact) in told.items():
        if stage in context.folders:
            predicted = float(getattr(plan.counts, name))
            out[name] = {"predicted": predicted, "actual": float(context.facts(stage)[fact])}
    return out
