"""Hardware of designs with a stand-in for the fitted bowls, which take seconds to find."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.fabrication.hardware.hardware_assembly import make_hardware
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.hardware.sensor_solids import hardware_solids, sensor_solids
from phytac_design.fabrication.switch_set import SwitchSet, make_switches
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.stages.build import copy_of
from phytac_shapes import Surface

SHIPPED = ("cylinder60", "cylinder40", "cone", "cuboid", "hemisphere", "grip", "plane", "patch")


def bowl(design: Design) -> dict[str, float]:
    """A bowl that fits the design's receptors."""
    return {
        "diameter_mm": design.switch.footprint_diameter_mm,
        "depth_mm": 0.8,
        "thickness_mm": 0.22,
        "stem_diameter_mm": design.switch.tip_diameter_mm + 0.05,
        "pad_diameter_mm": 1.5,
    }


def switches(design: Design, surface: Surface, markers: Markers) -> SwitchSet:
    wanted = thresholds_N(design, markers)
    made = [{"threshold_N": float(value), "bowl": bowl(design)} for value in sorted(set(wanted))]
    return make_switches(Sensor.of(design, surface, markers), made, wanted)


@cache
def case(name: str) -> tuple[Design, Surface, Markers, HardwareAssembly]:
    design = load_design(name)
    surface = design.surface()
    return design, surface, make_markers(design, surface), make_hardware(design, surface)


@cache
def solids(name: str) -> dict[str, Any]:
    """Shell, switches and hardware of a shipped design."""
    design, surface, markers, kit = case(name)
    made = switches(design, surface, markers)
    sensor = sensor_solids(Sensor.of(design, surface, markers), made, tolerance_mm=0.05)
    return sensor | hardware_solids(design, surface, kit, tolerance_mm=0.05)


def changed(name: str, **tables: Any) -> Design:
    return copy_of(load_design(name), **tables)


def context(design: Design, folder: Path, accuracy: str = "draft") -> Context:
    """What the stage sees after those of switch and STEP, with stand-ins' facts."""
    facts: dict[str, dict[str, Any]] = {
        "switch": {"switches": [{"threshold_N": design.switch.threshold_N, "bowl": bowl(design)}]},
        "step": {"step_left_out": "no shell of a stand-in"},
    }
    for name, own in facts.items():
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / "facts.json").write_text(json.dumps(own))
    return Context(
        design=design,
        accuracy=replace(PRESETS[accuracy], step=True),
        seed=0,
        folders={name: folder / name for name in facts},
        progress=lambda _: None,
    )
