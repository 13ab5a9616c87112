"""The families of a switch as a table, as JSON, and the recommended one as a curve."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from phytac_design.mechanics.switch.cup_design import CupDesign
from phytac_design.mechanics.switch.family_choice import ChosenSwitch
from phytac_design.mechanics.switch.line_plot import line_plot
from phytac_design.mechanics.switch.switch_families import FamilyCandidate
from phytac_design.mechanics.switch.switch_report import curve_plot, rubber_dict, switch_dict


def candidate_dict(one: FamilyCandidate) -> dict[str, Any]:
    """All facts of a candidate, JSON-ready."""
    plain: dict[str, Any] = {
        "family": one.family,
        "rubber": one.rubber.name,
        "modulus_MPa": one.rubber.material.modulus_MPa,
        "assumption": one.rubber.assumption,
        "fits": one.design is not None,
        "reason": one.reason,
    }
    if one.design is None or one.spread is None or one.receptors_N is None:
        return plain
    plain |= {
        "height_mm": one.height_mm,
        "wall_mm": one.wall_mm,
        "release_N": one.release_N,
        "hysteresis_N": max(one.receptors_N[1] - one.release_N, 0.0)
        if one.family == "bowl"
        else 0.0,
        "strain": one.strain,
        "spread": dict(vars(one.spread)),
        "receptors_N": list(one.receptors_N),
    }
    made = one.design
    if not isinstance(made, CupDesign):
        return plain | {"switch": switch_dict(made)}
    curve = made.curve
    return plain | {
        "switch": {
            "threshold_N": made.threshold_N,
            "error": made.error,
            "travel_mm": made.travel_mm,
            "cup": dict(vars(made.cup)),
            "stop_mm": made.stop_mm,
            "visible_mm": made.visible_mm,
            "stop_N": made.stop_N,
            "buckling_mm": {str(mode): way for mode, way in made.buckling.items()},
            "curve": {
                "pad_mm": curve.pad_mm.round(5).tolist(),
                "tip_mm": curve.tip_mm.round(5).tolist(),
                "force_N": curve.force_N.round(6).tolist(),
                "strain": curve.strain.round(4).tolist(),
            },
        }
    }


def chosen_dict(chosen: ChosenSwitch) -> dict[str, Any]:
    """All facts of a chosen switch, JSON-ready; keys are those of a bowl where they mean the same.

    Thresholds are those at the median receptor.
    """
    one = chosen.candidate
    made, spread = one.design, one.spread
    if made is None or spread is None:
        raise ValueError("a chosen switch fits")
    named = {
        "family": one.family,
        "choice": chosen.reason,
        "tolerance": dict(vars(chosen.tolerance)),
        "spread": dict(vars(spread)),
    }
    if not isinstance(made, CupDesign):
        return switch_dict(made) | named
    way = np.linspace(0.0, made.stop_mm, 61)
    return named | {
        "threshold_N": made.threshold_N,
        "error": made.error,
        "cup": dict(vars(made.cup)),
        "stem_diameter_mm": made.space.stem_diameter_mm,
        "rubber": rubber_dict(made.rubber),
        "limit_N": made.limit_N,
        "valley_N": made.limit_N,
        "on_mm": made.travel_mm,
        "stop_mm": made.stop_mm,
        "stop_N": made.stop_N,
        "visible_mm": made.visible_mm,
        "strain": made.strain,
        "buckling_mm": {str(mode): each for mode, each in made.buckling.items()},
        "curve": {
            "stroke_mm": way.round(5).tolist(),
            "force_N": made.curve.force_at(way).round(6).tolist(),
            "strain": [round(made.curve.at("strain", float(each)), 4) for each in way],
        },
        "warnings": [f"assumed: {made.rubber.assumption}", *_cup_warnings(made)],
    }


def chosen_plots(plain: Mapping[str, Any]) -> dict[str, str]:
    """SVG of a chosen switch, by the end of its file's name: force over stroke, red over force.

    Parameters
    ----------
    plain : mapping
        As of :func:`chosen_dict`, with the red that the camera sees.
    """
    title = f"{plain['family'].capitalize()} for {plain['threshold_N']:g} N"
    curve, red, rubber = plain["curve"], plain["red"], plain["rubber"]
    if "cup" in plain:
        marks = [(plain["on_mm"], plain["limit_N"], f"on at {plain['limit_N']:.3f} N")]
    else:
        marks = [
            (plain[f"{name}_stroke_mm"], plain[f"{name}_N"], f"{name} {plain[f'{name}_N']:.3f} N")
            for name in ("limit", "valley")
        ]
    name = f"{rubber['name']}, {rubber['modulus_MPa']:.3g} MPa"
    seen = np.array([red["force_N"], red["red_px"]])
    read = np.array([[0.0, red["force_N"][-1]], 2 * [red["threshold_px"]]])
    return {
        "": line_plot(
            {name: (np.array(curve["stroke_mm"]), np.array(curve["force_N"]))},
            title=title,
            labels=("stroke (mm)", "force (N)"),
            marks=marks,
        ),
        "_red": line_plot(
            {"visible red of the median receptor": (seen[0], seen[1]), "read as on": (*read,)},
            title=title,
            labels=("force (N)", "red (px)"),
        ),
    }


def _cup_warnings(made: CupDesign) -> list[str]:
    """What to mind before casting a membrane or plunger."""
    if not made.buckling:
        return []
    way = min(made.buckling.values())
    text = (
        f"beyond {way:.2f} mm of travel, {float(made.curve.force_at(way)):.2f} N, it may sway or "
        "fold if the pressing body lets it slide"
    )
    return [text]


def candidates_text(found: Sequence[FamilyCandidate], *, threshold_N: float) -> str:
    """Table of candidates, what the recommended one is, and why others do not fit."""
    fitting = [one for one in found if one.spread]
    lines = []
    if fitting:
        lines.append(
            f"{'family':9} {'rubber':15} {'±':>5} {'95 %':>15} {'worst':>15} {'wall':>5} "
            f"{'height':>6} {'strain':>6} {'release':>7} {'receptors':>15}"
        )
    for one in fitting:
        spread, ends = one.spread, one.receptors_N
        if spread is None or ends is None:
            continue
        lines.append(
            f"{one.family:9} {one.rubber.name:15} {spread.band:5.0%} "
            f"{f'{spread.low_N:.3g} to {spread.high_N:.3g}':>15} "
            f"{f'{spread.worst_low_N:.3g} to {spread.worst_high_N:.3g}':>15} "
            f"{one.wall_mm:5.2f} {one.height_mm:6.2f} {one.strain:6.0%} {one.release_N:7.3f} "
            f"{f'{ends[0]:.3g} to {ends[1]:.3g}':>15}"
        )
    lines += [
        f"{one.family} of {one.rubber.name}: does not fit: {one.reason}"
        for one in found
        if one.reason
    ]
    if fitting:
        lines.append(recommendation(fitting[0], threshold_N=threshold_N))
    return "\n".join(lines)


def recommendation(one: FamilyCandidate, *, threshold_N: float) -> str:
    """Sentence on the candidate that spreads least, and its dimensions."""
    made, spread = one.design, one.spread
    if made is None or spread is None:
        return ""
    first = (
        f"recommended: {one.family} of {one.rubber.name}, {threshold_N:g} N ± {spread.band:.0%} "
        f"(wall {spread.thickness:.1%}, diameter {spread.diameter:.1%}, height "
        f"{spread.height:.1%}, modulus {spread.modulus:.1%})"
    )
    if not isinstance(made, CupDesign):
        return f"{first}; phytac switch without --family describes it"
    cup = made.cup
    boss = f", boss {cup.boss_mm:.2f} mm" if cup.boss_mm else ""
    waves = (
        f"; frictionless, it would sway or fold from {min(made.buckling.values()):.2f} mm on"
        if made.buckling
        else ""
    )
    return (
        f"{first}\n{cup.diameter_mm:.3g} mm wide, {cup.height_mm:.2f} mm high inside, side wall "
        f"{cup.side_mm:.3f} mm, roof {cup.roof_mm:.3f} mm, hub {cup.hub_diameter_mm:.2f} mm{boss}\n"
        f"on at {made.limit_N:.3f} N after {made.travel_mm:.2f} mm of travel, stop at "
        f"{made.stop_N:.2f} N and {made.stop_mm:.2f} mm ({made.visible_mm:.2f} mm of red); it does "
        f"not snap: it is off again below the same force{waves}"
    )


def candidate_plot(one: FamilyCandidate) -> str:
    """Force against the way of pad or tip as SVG; "" if the candidate does not fit."""
    made = one.design
    if made is None:
        return ""
    if not isinstance(made, CupDesign):
        return curve_plot(made)
    return line_plot(
        {f"{one.family} of {one.rubber.name}": (made.curve.tip_mm, made.curve.force_N)},
        title=f"{one.family.capitalize()} for {made.threshold_N:g} N",
        labels=("travel of the tip (mm)", "force (N)"),
        marks=[(made.travel_mm, made.limit_N, f"on at {made.limit_N:.3f} N")],
    )
