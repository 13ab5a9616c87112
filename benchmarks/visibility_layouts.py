"""Layouts of the published sensor side by side: same count, camera and load; and a dense one."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.optics.visibility import check_visibility
from phytac_design.stages.build import copy_of
from phytac_design.stages.loaded_views_stage import see_pressed

STUDY = "design study of this sensor"
PLACES, PLACES_DENSE = 8, 40
LAYOUTS: dict[str, dict[str, Any]] = {
    "spiral, angle from the axis": {},
    "spiral, angle from the circumference": {"spiral_from": "circumference"},
    "straight": {"kind": "straight"},
    "straight, checkerboard colours": {"kind": "straight", "colour_pattern": "checkerboard"},
    "phyllotaxis": {"kind": "phyllotaxis", "count": 368},
    "spiral, line-of-sight heights": {"heights": "line-of-sight", "sight_margin_mm": 1.2},
}
FUSED_STUDY = {
    "spiral, angle from the axis": ("0", "== 0"),
    "spiral, angle from the circumference": ("36-164", None),
    "straight": ("116-316", None),
    "straight, checkerboard colours": ("0", None),
}
GAP_STUDY = {"spiral, angle from the axis": "4-5"}
CROSSTALK_STUDY = {
    "spiral, angle from the axis": "about 0",
    "straight, checkerboard colours": "1-2.6",
}
DENSE_TARGETS = {
    "markers": ">= 736",
    "least gap, same colour": ">= 8",
    "least gap, other colour": ">= 4",
    "least visible fraction": ">= 0.97",
    "occluded": "== 0",
    "fused": "== 0",
    "fused at most": "== 0",
    "hidden at most": "== 0",
    "crosstalk": "<= 0.1",
}


def add_case(
    table: Table, name: str, design: Design, *, places: int = PLACES, linear: bool = False
) -> None:
    """Rows of one layout, at rest and pressed, at standard accuracy."""
    accuracy = replace(PRESETS["standard"], press_places=places)
    if linear:
        accuracy = replace(accuracy, press_tolerance=1.0)
    context = Context(design=design, accuracy=accuracy, seed=0, progress=lambda _: None)
    rest = check_visibility(context.sensor, rng=np.random.default_rng(0))
    load = see_pressed(context, np.minimum(rest.gap_same_colour_px, rest.gap_other_colour_px))[1]
    training, count = design.training, context.markers.count
    dense = design.name == "cylinder60-dense"
    force = f"{training.force_max_N:g} N"
    at_rest = [
        ("markers", count, "markers", None),
        ("occluded", rest.occluded.sum(), "markers", None),
        ("fused", rest.fused.sum(), "markers", FUSED_STUDY.get(name)),
        ("least gap, same colour", rest.gap_same_colour_px.min(), "px", GAP_STUDY.get(name)),
        ("least gap, other colour", rest.gap_other_colour_px.min(), "px", None),
        ("least visible fraction", rest.visible_fraction.min(), "-", None),
    ]
    under = [
        ("fused at most", load.fused.max(), "markers", None),
        ("hidden at most", load.hidden.max(), "markers", None),
        ("least gap, same colour", load.least_gap_same_px.min(), "px", None),
        ("least gap, other colour", load.least_gap_other_px.min(), "px", None),
        ("least visible fraction", load.least_fraction.min(), "-", None),
        ("crosstalk", load.crosstalk_px.max(), "px", CROSSTALK_STUDY.get(name)),
        ("crosstalk where markers stand still", load.crosstalk_still_px.max(), "px", None),
        ("greatest image shift", load.shift_px.max(), "px", None),
    ]
    note = f"worst of {len(load.fused)} presses, radius {training.patch_radius_max_mm:g} mm"
    for when, rows in (("at rest", at_rest), (force, under)):
        for what, value, unit, study in rows:
            reference, target = study if isinstance(study, tuple) else (study, None)
            if dense:
                target = DENSE_TARGETS.get(what)
                if when == force and what.startswith("least"):
                    target = None
            row = f"{design.name} {count}, {name}: {when}: {what}"
            source = STUDY if reference else "not published"
            table.add(
                row,
                float(value),
                unit,
                reference or "none",
                source,
                target,
                note if when == force else "",
            )


def add_rows(table: Table, *, quick: bool) -> None:
    """All layouts of ``cylinder60``, and the dense design."""
    base, dense = load_design("cylinder60"), load_design("cylinder60-dense")
    if quick:
        add_case(table, "spiral, angle from the axis", base, places=2, linear=True)
        return
    for name, change in LAYOUTS.items():
        add_case(table, name, copy_of(base, layout=change))
    add_case(table, "spiral, line-of-sight heights", dense, places=PLACES_DENSE)
