"""Molds for the design's switches: plates or trays as STL, checked before they are written."""

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phytac_design.engine.stage import Context, Stage, export_path, write_facts
from phytac_design.stages.switch import switches_of, without_switches

if TYPE_CHECKING:
    from phytac_design.fabrication.molds.make import MoldSet
    from phytac_design.fabrication.switch_set import SwitchSet

NAMES = {
    "dome_plate": "mold, dome plate",
    "core_plate": "mold, core plate",
    "cap_plate": "mold, cap",
    "dome_tray": "mold, master tray of the domes",
    "core_tray": "mold, master tray of the stems",
}


def run(context: Context, folder: Path) -> None:
    """Write ``mold/*.stl`` and ``mold/cavities.csv``, and the mold's facts."""
    from phytac_design.fabrication.molds.audit import (
        audit_facts,
        audit_set,
        check_mold,
        fine_sections,
        volumes_mm3,
    )
    from phytac_design.fabrication.molds.make import make_molds
    from phytac_design.fabrication.molds.rules import rule_rows
    from phytac_design.solids.mesh_export import stl_bytes

    if without_switches(context, folder):
        return
    design, switches = context.design, switches_of(context)
    section = design.mold
    made = make_molds(
        section,
        design.print_rules,
        switches,
        tolerance_mm=context.accuracy.cad_tolerance_mm,
    )
    fine = fine_sections(switches)
    sets, poured, files = [], [], {}
    for each in made:
        context.progress(f"mold: set {each.plan.number} of {each.plan.total}")
        audit = audit_set(each, fine)
        check_mold(each, audit)
        sets.append(audit_facts(each, audit))
        poured.append(volumes_mm3(each, audit, fine))
        for name in each.parts:
            files[f"mold/{name}_{each.plan.number}.stl"] = stl_bytes(each.printed(name))
    for file, data in files.items():
        export_path(folder, file).write_bytes(data)
    export_path(folder, "mold/cavities.csv").write_text(_table(made, switches), encoding="utf-8")
    total = {key: sum(each[key] for each in poured) for key in poured[0]}
    rules = rule_rows(made[0].sizes)
    write_facts(
        folder,
        {
            "way": section.way,
            "sets": sets,
            "cavities": sum(each.plan.cavities for each in made),
            "pitch_mm": made[0].sizes.pitch_mm,
            "largest_mm": max(max(p["size_mm"]) for each in sets for p in each["plates"].values()),
            "poured_mm3": total,
            "undercut_rays": sum(
                p["undercut_rays"] for each in sets for p in each["plates"].values()
            ),
            "least_draft_deg": min(
                p["least_draft_deg"] for each in sets for p in each["plates"].values()
            ),
            "shared_mm3": max(each["shared_mm3"] for each in sets),
            "volume_error": max(each["volume_error"] for each in sets),
            "hausdorff_mm": max(each["hausdorff_mm"] for each in sets),
            "print_rules": rules,
            "parts": _parts(sets, poured),
        },
    )


def _table(made: "list[MoldSet]", switches: "SwitchSet") -> str:
    """Where each kind's cavities are, as CSV."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["set", "line", "first", "count", "label", "length_mm", "threshold_N"])
    for each in made:
        for item in each.plan.runs:
            bowl, length = item.kind
            table.writerow(
                [
                    each.plan.number,
                    item.line + 1,
                    item.start + 1,
                    item.count,
                    each.sizes.labels[item.kind],
                    f"{switches.lengths_mm[length]:.1f}",
                    f"{switches.threshold_N[bowl]:g}",
                ]
            )
    return text.getvalue()


def _parts(sets: list[dict[str, Any]], poured: list[dict[str, float]]) -> list[dict[str, Any]]:
    """Parts list: plates, silicone, and the rubber that runs over; the switches list themselves."""
    found: list[dict[str, Any]] = []

    def add(part: str, file: str, count: int, material: str, volume: float, note: str) -> None:
        found.append(
            {
                "part": part,
                "file": file,
                "count": count,
                "material": material,
                "volume_mm3": volume,
                "note": note,
            }
        )

    for facts, volumes in zip(sets, poured, strict=True):
        number = facts["set"]
        suffix = "" if len(sets) == 1 else f" {number}"
        for name, plate in facts["plates"].items():
            file = f"mold/{name}_{number}.stl"
            add(f"{NAMES[name]}{suffix}", file, 1, "resin", plate["volume_mm3"], "printed once")
        for half in ("dome", "core"):
            if f"silicone_{half}" in volumes:
                volume = volumes[f"silicone_{half}"]
                add(f"mold, silicone {half} half{suffix}", "", 1, "silicone", volume, "cast")
        over = volumes["rubber"] - volumes["switches"]
        add(f"rubber that runs over{suffix}", "", 1, "tpu", over, "each casting")
    return found


MOLD = Stage(
    name="mold",
    reads=("tubes", "switch", "mold", "print_rules"),
    knobs=("cad_tolerance_mm",),
    needs=("switch",),
    run=run,
)
