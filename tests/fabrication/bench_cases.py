"""Designs whose earlier stages are made up or run small, for the tests of bench and kit."""

import json
from pathlib import Path
from typing import Any

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.stages.calibration_rig_stage import KIT
from phytac_design.stages.documents_stage import BENCH
from phytac_design.stages.mold_stage import MOLD
from phytac_design.stages.shell_stage import run_shell
from phytac_design.stages.switch_stage import switches_of

BOWL = {"diameter_mm": 4.6, "depth_mm": 1.77, "thickness_mm": 0.22, "stem_diameter_mm": 1.44}
BOWL |= {"pad_diameter_mm": 1.44, "pad_height_mm": 0.02, "fillet_mm": 0.24}
THIN = BOWL | {"diameter_mm": 4.0, "depth_mm": 1.65, "stem_diameter_mm": 1.2}
THIN |= {"pad_diameter_mm": 1.2}
PLUNGER: dict[str, Any] = {
    "family": "plunger",
    "cup": {
        "family": "plunger",
        "diameter_mm": 4.6,
        "height_mm": 4.1,
        "side_mm": 0.73,
        "roof_mm": 0.8,
        "hub_diameter_mm": 2.0,
        "draft_deg": 0.51,
    },
    "stop_mm": 1.5,
    "stem_diameter_mm": 1.44,
    "rubber": {"name": "dragon-skin-20"},
}


def context_of(design: Design, folder: Path) -> Context:
    """Context whose switch stage is made up: one bowl or plunger for every threshold."""
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    bowl = BOWL if design.switch.footprint_diameter_mm > 4.5 else THIN
    wanted = sorted(set(thresholds_N(design, context.markers).tolist()))
    one = {"bowl": bowl} if design.switch.family == "bowl" else PLUNGER
    facts: dict[str, Any] = {"switches": [{"threshold_N": force} | one for force in wanted]}
    if not design.has_switches:
        facts = {"switches": [], "absent": "the design has no switches"}
    put(context, folder, "switch", facts)
    return context


def put(context: Context, folder: Path, stage: str, facts: dict[str, Any]) -> None:
    """Make up the facts of a stage."""
    own = folder / stage
    own.mkdir(parents=True)
    (own / "facts.json").write_text(json.dumps(facts))
    context.folders[stage] = own


def switches(design: Design, folder: Path) -> SwitchSet:
    return switches_of(context_of(design, folder))


def ran(design: Design, folder: Path) -> Path:
    """Run shell, mold, kit and bench; the hardware is left out. Returns the folder of stages."""
    context = context_of(design, folder)
    put(context, folder, "hardware", {"hardware_left_out": "for the test", "parts": []})
    put(context, folder, "printing", {"pieces": []})
    for stage, run in (("shell", run_shell), ("mold", MOLD.run), ("kit", KIT.run)):
        context.folders[stage] = folder / stage
        (folder / stage).mkdir()
        run(context, folder / stage)
    (folder / "bench").mkdir()
    BENCH.run(context, folder / "bench")
    return folder
