"""What a designed switch is, as a dict, as text, as plots."""

from typing import Any

from phytac_design.design.switch_table import SwitchSection
from phytac_design.mechanics.switch.design import SwitchDesign
from phytac_design.mechanics.switch.line_plot import line_plot
from phytac_design.mechanics.switch.rubbers import Rubber


def switch_dict(made: SwitchDesign) -> dict[str, Any]:
    """All facts of a switch, JSON-ready."""
    stroke, force, strain = made.curve.dense()
    spread = made.spread
    return {
        "threshold_N": made.threshold_N,
        "error": made.error,
        "bowl": dict(vars(made.bowl)),
        "rubber": rubber_dict(made.rubber),
        **vars(made.snap),
        "visible_mm": made.visible_mm,
        "buckling_mm": {str(mode): way for mode, way in made.buckling.items()},
        "spread": {
            "thickness_mm": made.tolerance.thickness_mm,
            "modulus": made.tolerance.modulus,
            **vars(spread),
        },
        "curve": {
            "stroke_mm": stroke.round(5).tolist(),
            "force_N": force.round(6).tolist(),
            "strain": strain.round(4).tolist(),
        },
        "warnings": warnings(made),
    }


def rubber_dict(rubber: Rubber) -> dict[str, Any]:
    """Facts of a rubber, JSON-ready."""
    return {
        "name": rubber.name,
        "modulus_MPa": rubber.material.modulus_MPa,
        "poisson": rubber.material.poisson,
        "strain_max": rubber.strain_max,
        "assumption": rubber.assumption,
    }


def warnings(made: SwitchDesign) -> list[str]:
    """What to mind before casting."""
    out = [f"assumed: {made.rubber.assumption}"]
    band = max(made.spread.high_N - made.threshold_N, made.threshold_N - made.spread.low_N)
    if band > 0.25 * made.threshold_N:
        out.append(
            f"the threshold spreads from {made.spread.low_N:.3g} to {made.spread.high_N:.3g} N "
            f"with walls ± {made.tolerance.thickness_mm:g} mm: measure and sort, or cast closer"
        )
    if made.buckling:
        mode = min(made.buckling, key=lambda n: made.buckling[n])
        out.append(
            f"beyond its limit load the bowl may leave the axisymmetric way, with {mode} waves "
            f"from {made.buckling[mode]:.3g} mm on"
        )
    if not made.curve.complete:
        out.append(
            f"the way was followed to {made.snap.travel_mm:.3g} mm, where the wall folds onto "
            "itself"
        )
    return out


def release_notes(made: SwitchDesign, table: SwitchSection) -> list[str]:
    """Note where the bowl does not release at the force that the design assumes."""
    near = 0.05  # differences over the threshold that change nothing
    ratio = made.threshold_N / table.threshold_N
    found, assumed = max(made.snap.valley_N, 0.0), ratio * table.release_N
    if abs(found - assumed) <= near * made.threshold_N:
        return []
    note = (
        f"the bowl releases below {found:.3g} N, the design assumes {assumed:.3g} N: set "
        f"switch.release_N = {found / ratio:.2g}"
    )
    return [note]


def switch_text(made: SwitchDesign) -> str:
    """Describe a switch for a person."""
    bowl, snap, spread = made.bowl, made.snap, made.spread
    shape = (
        f"bowl {bowl.diameter_mm:.3g} mm wide, {bowl.depth_mm:.3f} mm deep, wall "
        f"{bowl.thickness_mm:.3f} mm, fillets {bowl.fillet_mm:.2g} mm; pad "
        f"{bowl.pad_diameter_mm:.3g} mm, stem {bowl.stem_diameter_mm:.3g} mm"
    )
    threshold = (
        f"threshold {snap.limit_N:.4f} N at {snap.limit_stroke_mm:.3f} mm (target "
        f"{made.threshold_N:g} N, {made.error:+.2%}); releases below {snap.valley_N:.3f} N"
    )
    stroke = (
        f"stroke {snap.stroke_mm:.3f} mm: {made.visible_mm:.3f} mm of red come out; peak "
        f"strain {snap.strain:.0%} of {made.rubber.strain_max:.0%}"
    )
    band = (
        f"threshold {spread.low_N:.3g} to {spread.high_N:.3g} N (95 %) with walls ± "
        f"{made.tolerance.thickness_mm:g} mm and modulus ± {made.tolerance.modulus:.0%}; "
        f"it grows as wall^{spread.exponent_thickness:.2f} (± {spread.sensitivity_N:.3g} N)"
    )
    waves = (
        f"unstable against waves {sorted(made.buckling)} beyond the limit load"
        if made.buckling
        else "stays axisymmetric"
    )
    return f"{shape}\n{threshold}\n{stroke}\n{band}\n{waves}"


def curve_plot(made: SwitchDesign) -> str:
    """Force–stroke curve as SVG."""
    stroke, force, _ = made.curve.dense()
    snap = made.snap
    return line_plot(
        {f"{made.rubber.name}, {made.rubber.material.modulus_MPa:.3g} MPa": (stroke, force)},
        title=f"Threshold switch for {made.threshold_N:g} N",
        labels=("stroke (mm)", "force (N)"),
        marks=[
            (snap.limit_stroke_mm, snap.limit_N, f"limit {snap.limit_N:.3f} N"),
            (snap.valley_stroke_mm, snap.valley_N, f"valley {snap.valley_N:.3f} N"),
        ],
    )
