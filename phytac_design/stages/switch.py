"""The design's threshold switches: one bowl for each threshold, solved and fitted."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.fabrication.switch_set import SwitchSet, make_switches
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.stage import Context, Stage, export_path, write_facts

TABLES = ("shape", "wall", "layout", "receptor", "switch", "mold", "print_rules", "camera", "light")


def run(context: Context, folder: Path) -> None:
    """Write ``switch/switch_….json`` and ``.svg`` for each threshold."""
    from phytac_design.mechanics.switch.design import design_switch
    from phytac_design.mechanics.switch.receptor import chosen_rubber, space_of
    from phytac_design.mechanics.switch.report import curve_plot, switch_dict
    from phytac_design.mechanics.switch.space import Tolerance
    from phytac_design.mechanics.switch.svg import write_svg

    design = context.design
    switch = design.switch
    rubber = chosen_rubber(switch.material, modulus_MPa=switch.modulus_MPa or None)
    space = space_of(design)
    tolerance = Tolerance(thickness_mm=switch.wall_tolerance_mm, modulus=switch.modulus_tolerance)
    made = []
    for threshold in np.unique(thresholds_N(design, context.markers)):
        context.progress(f"switch: bowl for {threshold:g} N")
        found = design_switch(float(threshold), rubber, space, tolerance)
        facts = switch_dict(found)
        name = f"switch/switch_{threshold:g}N"
        text = json.dumps(facts, indent=1, ensure_ascii=False)
        export_path(folder, f"{name}.json").write_text(text + "\n", encoding="utf-8")
        write_svg(export_path(folder, f"{name}.svg"), curve_plot(found))
        made.append({key: value for key, value in facts.items() if key != "curve"})
    write_facts(folder, {"switches": made})


def switches_of(context: Context) -> SwitchSet:
    """Switches of a design whose switch stage has run."""
    made: list[dict[str, Any]] = context.facts("switch")["switches"]
    return make_switches(
        context.design,
        context.surface,
        context.markers,
        made,
        thresholds_N(context.design, context.markers),
    )


SWITCH = Stage(name="switch", tables=TABLES, run=run)
