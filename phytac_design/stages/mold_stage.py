"""Molds for the design's switches: plates or trays as STL, checked before they are written."""

from pathlib import Path
from typing import Any

from phytac_design.engine.stage import Context, Stage, export_path, write_facts
from phytac_design.fabrication.bill import bill_part
from phytac_design.fabrication.molds.make import make_molds, strips_of
from phytac_design.fabrication.molds.mold_files import mold_files
from phytac_design.fabrication.molds.rules import rule_rows
from phytac_design.fabrication.molds.strip_files import strip_facts, strip_files
from phytac_design.stages.switch_stage import switches_of, without_switches


def run(context: Context, folder: Path) -> None:
    """Write ``mold/*.stl`` and ``mold/cavities.csv``, and the mold's facts."""
    if without_switches(context, folder):
        return
    design, switches = context.design, switches_of(context)
    section = design.mold
    tolerance = context.accuracy.cad_tolerance_mm
    strips = strips_of(context.sensor, switches, tolerance_mm=tolerance)
    made = make_molds(section, design.print_rules, switches, tolerance_mm=tolerance, strips=strips)
    written = mold_files(made, switches, progress=context.progress)
    sets, poured = written.sets, written.poured_mm3
    contents = written.contents
    if strips is not None:
        contents |= strip_files(context.sensor, strips)
    for file, data in contents.items():
        export_path(folder, file).write_bytes(data)
    castings = [each.plan.castings for each in made]
    total = {
        key: sum(
            each[key] * (1 if key.startswith("silicone") else count)
            for count, each in zip(castings, poured, strict=True)
        )
        for key in poured[0]
    }
    plates = [plate for each in sets for plate in each["plates"].values()]
    write_facts(
        folder,
        {
            "way": section.way,
            "sets": sets,
            "castings": sum(castings),
            **({"strips": strip_facts(strips)} if strips is not None else {}),
            "cavities": sum(each.plan.cavities for each in made),
            "pitch_mm": made[0].sizes.pitch_mm,
            "largest_mm": max(max(plate["size_mm"]) for plate in plates),
            "poured_mm3": total,
            "undercut_mm2": sum(plate["undercut_mm2"] for plate in plates),
            "least_draft_deg": min(plate["least_draft_deg"] for plate in plates),
            "shared_mm3": max(each["shared_mm3"] for each in sets),
            "volume_error": max(each["volume_error"] for each in sets),
            "hausdorff_mm": max(each["hausdorff_mm"] for each in sets),
            "print_rules": rule_rows(made[0].sizes),
            "parts": _parts(sets, poured),
        },
    )


def _parts(sets: list[dict[str, Any]], poured: list[dict[str, float]]) -> list[dict[str, Any]]:
    """Parts list: plates, silicone, and surplus rubber; the bench lists the switches."""
    names = {
        "dome_plate": "mold, dome plate",
        "core_plate": "mold, core plate",
        "cap_plate": "mold, cap",
        "dome_tray": "mold, master tray of the domes",
        "core_tray": "mold, master tray of the stems",
    }
    found = []
    for facts, volumes in zip(sets, poured, strict=True):
        number = facts["set"]
        suffix = "" if len(sets) == 1 else f" {number}"
        found += [
            bill_part(
                f"{names[name]}{suffix}",
                file=f"mold/{name}_{number}.stl",
                volume_mm3=plate["volume_mm3"],
                note="printed once",
            )
            for name, plate in facts["plates"].items()
        ]
        found += [
            bill_part(
                f"mold, silicone {half} half{suffix}",
                material="silicone",
                volume_mm3=volumes[f"silicone_{half}"],
                note="cast",
            )
            for half in ("dome", "core")
            if f"silicone_{half}" in volumes
        ]
        over = volumes["rubber"] - volumes["switches"]
        part = f"rubber that runs over{suffix}"
        found.append(
            bill_part(
                part,
                count=facts["castings"],
                material="tpu",
                volume_mm3=over,
                note="each casting",
            )
        )
    return found


MOLD = Stage(
    name="mold",
    design_fields=("tubes", "receptor.diameter_hole_mm", "switch", "mold", "strip", "print_rules"),
    settings=("cad_tolerance_mm",),
    depends_on=("switch",),
    only_with="tools",
    run=run,
)
