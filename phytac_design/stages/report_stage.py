"""Gather every stage's figures into report.json, and show them on one page."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.core.html import images_of, page
from phytac_design.core.json_values import finite
from phytac_design.design.design_file import assumptions
from phytac_design.design.spec import Design
from phytac_design.engine import cache
from phytac_design.engine.stage import Context, Stage, export_path, write_facts, write_text
from phytac_design.fabrication.effort.effort import effort_of
from phytac_design.optics.separability import check_paints
from phytac_design.report.explorer import DATA_ID, explorer_data
from phytac_design.report.fabrication_section import fabrication_facts
from phytac_design.report.provenance import provenance_of
from phytac_design.report.report_sections import sections_of
from phytac_design.report.verdict import SIMULATED, best_of, changes_of, lead, read_well
from phytac_design.report.viewer.assets import data_tag, script_tags, style
from phytac_design.stages.loaded_views_stage import UNDERLOAD
from phytac_design.stages.switch_stage import SWITCH
from phytac_design.stages.views_stage import VIEWS

FABRICATION = ("hardware", "mold", "kit", "inserts", "printing", "bench")


def gather(context: Context) -> dict[str, Any]:
    """Every figure of the build, as report.json holds it."""
    design, markers = context.design, context.markers
    views, shell, step = (context.facts(name) for name in ("views", "shell", "step"))
    decoder, frames, twin = (context.facts(name) for name in ("decoder", "frames", "twin"))
    well = read_well(context, best_of({"decoder": decoder["test"]}))
    density = views["density"]
    reasons = forced_past(context)
    timing = {name: cache.record(folder)["seconds"] for name, folder in context.folders.items()}
    return {
        "schema_version": "1.5",
        "design": design.name,
        "description": design.description,
        "simulated": SIMULATED,
        "markers": {
            "count": density["count"],
            "layout": design.layout.kind,
            "rows": len(np.unique(markers.row)) if markers.in_rows else None,
            "columns": int(markers.column.max()) + 1 if markers.in_rows else None,
            "density_per_cm2": density["per_cm2"],
            "density_local_min_per_cm2": density["local_min_per_cm2"],
            "density_local_max_per_cm2": density["local_max_per_cm2"],
            "density_times_paper": density["times_paper"],
            "sensing_area_cm2": density["area_cm2"],
            "surface_class": density["surface_class"],
            "height_least_mm": float(markers.height_mm.min()),
            "height_greatest_mm": float(markers.height_mm.max()),
            "colours": check_paints(design).summary(),
        },
        "forced": reasons,
        "changes": changes_of(context, reasons, well),
        "visibility": views["visibility"],
        "straight": context.facts("compare").get("straight"),
        "under_load": context.facts("underload"),
        "resolution": context.facts("resolution"),
        "camera": {
            "stand_off_mm": views["stand_off_mm"],
            "rest_centroid_bias_px": views["centroid_bias_px"],
            "end": views["cameras"][0]["end"],
        },
        "cameras": views["cameras"],
        "lens": views["cameras"][0]["lens"],
        "shell": shell | (step if context.accuracy.step else {}),
        "switch": switch_facts(context),
        "fabrication": fabrication_facts({name: context.facts(name) for name in FABRICATION})
        | {"effort": effort_of(context.sensor).as_dict()},
        "mesh": context.facts("mesh"),
        "decoder": {name: decoder["test"][name] for name in decoder["test"]},
        "decoder_anywhere": decoder["anywhere"],
        "read_well": well,
        "training": decoder["training"],
        "limits": decoder["limits"]["sentences"],
        "limit_figures": {k: v for k, v in decoder["limits"].items() if k != "sentences"},
        "twin": twin,
        "places": context.facts("places"),
        "condition_compliance": context.facts("response")["condition"],
        "response": {k: v for k, v in context.facts("response").items() if k != "condition"},
        "frames": {key: value for key, value in frames.items() if key != "estimators"},
        "decoder_frames": frames["estimators"],
        "assumptions": assumptions(design),
        "accuracy": context.accuracy.as_dict(),
        "seed": context.seed,
        "provenance": provenance_of(context),
        "timing_s": timing | {"total": round(sum(timing.values()), 3)},
    }


def switch_facts(context: Context) -> dict[str, Any]:
    """Figures of the switches, with the red of their tips where there are some."""
    facts = context.facts("switch")
    return facts | ({"red": context.facts("views")["red"]} if facts["switches"] else {})


def forced_past(context: Context) -> list[str]:
    """Why this build would have stopped without --force; empty if it would not have."""
    reasons = [stage.gate(context) for stage in (VIEWS, UNDERLOAD, SWITCH) if stage.gate]
    return [reason for reason in reasons if reason]


def run(context: Context, folder: Path) -> None:
    """Write ``report/report.{json,html}``, ``report/viewer.json`` and ``report/images/…``."""
    report = gather(context)
    text = json.dumps(finite(report), indent=1, ensure_ascii=False)
    write_text(folder, "report/report.json", text + "\n")
    data = explorer_data(context, best_of(report))
    text = json.dumps(data, ensure_ascii=False, allow_nan=False)
    write_text(folder, "report/viewer.json", text + "\n")
    html = page(
        f"{report['design']}: camera-based force sensor",
        sections_of(context, report),
        lead(report),
        style=style(),
        tail=data_tag(DATA_ID, data) + script_tags(),
    )
    write_text(folder, "report/report.html", html)
    for name, image in images_of(html).items():
        export_path(folder, f"report/images/{name}").write_bytes(image)
    write_facts(folder, {"page_bytes": len(html.encode())})


REPORT = Stage(
    name="report",
    design_fields=tuple(Design.model_fields),
    depends_on=(
        "views",
        "switch",
        "compare",
        "underload",
        "pressed",
        "resolution",
        "shell",
        "step",
        "hardware",
        "mold",
        "kit",
        "inserts",
        "printing",
        "bench",
        "mesh",
        "response",
        "places",
        "twin",
        "decoder",
        "renders",
        "frames",
    ),
    imports=("matplotlib",),
    run=run,
)
