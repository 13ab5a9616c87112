"""The design's threshold switches: one of a family for each threshold, solved and fitted."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.core.json_values import finite
from phytac_design.engine.stage import Context, Stage, export_path, write_facts, write_text
from phytac_design.fabrication.documents.bill_of_materials import family_words
from phytac_design.fabrication.switch_set import SwitchSet, make_switches, revolved_volume_mm3
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.design import design_switch
from phytac_design.mechanics.switch.family_report import chosen_plots
from phytac_design.mechanics.switch.line_plot import write_svg
from phytac_design.mechanics.switch.switch_inputs import rubber_of, space_of
from phytac_design.mechanics.switch.switch_report import curve_plot, switch_dict
from phytac_design.mechanics.switch.switch_space import Tolerance
from phytac_design.simulation.switch_law import chosen_switches
from phytac_shapes.errors import DesignError


def run(context: Context, folder: Path) -> None:
    """Write ``switch/switches.json``, and a curve (JSON and SVG) for each threshold.

    A switch that does not fit is recorded with its reason: the stage's gate stops the build, and
    with ``--force`` the sensor is built without its switches.
    """
    if not context.design.has_switches:
        absent = "the design has no switches (receptor.diameter_hole_mm = 0)"
        write_facts(folder, {"refused": "", "absent": absent, "switches": [], "parts": []})
        return
    try:
        made = design_switches(context, folder)
    except DesignError as error:
        context.progress(f"switch: {error}")
        write_facts(folder, {"refused": str(error), "switches": [], "parts": []})
        return
    switches = _set_of(context, made)
    parts = [
        {
            "part": f"switch {switches.label(kind)}",
            "file": "",
            "count": len(switches.markers_of(kind)),
            "material": "tpu",
            "volume_mm3": revolved_volume_mm3(switches.profile(kind)),
            "note": f"{family_words(switches, kind[0])}{float(switches.lengths_mm[kind[1]]):.1f} "
            "mm from the outer face to the tip",
        }
        for kind in switches.kinds
    ]
    facts = {"refused": "", "switches": made, "parts": parts}
    text = json.dumps(finite(facts), indent=1, ensure_ascii=False)
    write_text(folder, "switch/switches.json", text + "\n")
    write_facts(folder, facts)


def design_switches(context: Context, folder: Path) -> list[dict[str, Any]]:
    """Design one switch for each threshold, write its curves, and return its facts without them.

    Raises
    ------
    DesignError
        If one does not fit the space or has no data for its rubber.
    """
    design, switch = context.design, context.design.switch
    if switch.family != "bowl":
        return [
            _written(made, chosen_plots(made), folder)
            for made in chosen_switches(design, context.progress)
        ]
    rubber, space = rubber_of(design), space_of(design)
    tolerance = Tolerance(thickness_mm=switch.wall_tolerance_mm, modulus=switch.modulus_tolerance)
    found = []
    for threshold in np.unique(thresholds_N(design, context.markers)):
        context.progress(f"switch: bowl for {threshold:g} N")
        found.append(design_switch(float(threshold), rubber, space, tolerance))
    return [_written(switch_dict(made), {"": curve_plot(made)}, folder) for made in found]


def _written(made: dict[str, Any], plots: dict[str, str], folder: Path) -> dict[str, Any]:
    """Write a switch and its plots, and return its facts without curves."""
    name = f"switch/switch_{made['threshold_N']:g}N"
    text = json.dumps(made, indent=1, ensure_ascii=False)
    write_text(folder, f"{name}.json", text + "\n")
    for ending, plot in plots.items():
        write_svg(export_path(folder, f"{name}{ending}.svg"), plot)
    facts = {k: v for k, v in made.items() if k not in {"curve", "red", "receptors_N"}}
    if "receptors_N" in made:
        facts["receptors_least_N"] = min(made["receptors_N"])
        facts["receptors_most_N"] = max(made["receptors_N"])
    return facts


def refusal(context: Context) -> str:
    """Why the design's switches cannot be made; "" if they can."""
    return str(context.facts("switch").get("refused", ""))


def absence(context: Context) -> str:
    """Why there are no switches, by design or because they cannot be made; "" if there are."""
    return str(context.facts("switch").get("absent", "")) or refusal(context)


def switches_of(context: Context) -> SwitchSet:
    """Switches of a design whose switch stage has run; an empty set if it has none.

    Raises
    ------
    DesignError
        If they cannot be made; see :func:`refusal`.
    """
    if refusal(context):
        raise DesignError("switch-infeasible", refusal(context))
    return _set_of(context, context.facts("switch")["switches"])


def without_switches(context: Context, folder: Path, *, needed: bool = True) -> bool:
    """Write facts that say why a stage makes nothing, if there are no switches.

    A stage for which switches are not ``needed`` is left out only where the design has some that
    cannot be made.
    """
    reason = absence(context) if needed else refusal(context)
    if reason:
        why = "the switches cannot be made" if refusal(context) else reason
        context.progress(f"left out: {why}")
        write_facts(folder, {"left_out": reason, "parts": []})
    return bool(reason)


def _set_of(context: Context, made: list[dict[str, Any]]) -> SwitchSet:
    thresholds = thresholds_N(context.design, context.markers)
    return make_switches(context.sensor, made, thresholds)


SWITCH = Stage(
    name="switch",
    design_fields=(
        *("tubes", "cameras", "wall", "receptor", "switch", "mold", "print_rules"),
        "trips",
    ),
    gate=refusal,
    imports=("matplotlib",),
    run=run,
)
