"""Coloured inserts on sprues: STL files, the list of what goes where, and their fits."""

from pathlib import Path
from typing import Any

from phytac_design.engine.stage import Context, Stage, export_path, write_facts, write_text
from phytac_design.fabrication.bill import bill_part
from phytac_design.fabrication.inserts.fits import fits_of
from phytac_design.fabrication.inserts.insert_solids import plate_manifold
from phytac_design.fabrication.inserts.sprues import placement_csv, plan_sprues, plates
from phytac_design.solids.mesh_export import write_stl
from phytac_design.solids.solid_mesh import stl_triangles, to_triangles


def run(context: Context, folder: Path) -> None:
    """Write ``inserts/COLOUR_N.stl``, one for each bed, and ``inserts/placement.csv``."""
    design = context.design
    if not design.receptor.has_inserts:
        write_facts(folder, {"parts": []})
        return
    tolerance = context.accuracy.cad_tolerance_mm
    sprues = plan_sprues(context.sensor)
    parts: list[dict[str, Any]] = []
    for colour, beds in plates(sprues, design).items():
        for number, placed in enumerate(beds, start=1):
            file = f"inserts/{colour}_{number}.stl"
            context.progress(f"inserts: {file}")
            solid = plate_manifold(design, placed, tolerance_mm=tolerance)
            write_stl(stl_triangles(to_triangles(solid)), export_path(folder, file))
            inserts = sum(len(sprue.markers) for sprue, _ in placed)
            part = bill_part(
                f"sprues with {inserts} {colour} inserts",
                file=file,
                material=f"paint-{colour}",
                volume_mm3=float(solid.volume()),
                note=f"{len(placed)} sprues, in {colour} resin, bars on the bed",
            )
            parts.append(part)
    write_text(folder, "inserts/placement.csv", placement_csv(context.markers, sprues))
    write_facts(
        folder,
        {
            "parts": parts,
            "sprues": len(sprues),
            "sprues_single": sum(sprue.way == "single" for sprue in sprues),
            "strain": max(sprue.strain for sprue in sprues),
            "fits_mm": fits_of(context.sensor).as_dict(),
        },
    )


INSERTS = Stage(
    name="inserts",
    design_fields=(
        "markers",
        "wall.thickness_mm",
        "receptor",
        "switch.footprint_diameter_mm",
        "switch.tip_diameter_mm",
        "switch.tip_recess_mm",
        "switch.stroke_mm",
        "switch.wall_min_mm",
        "mold.draft_deg",
        "print_rules",
    ),
    settings=("cad_tolerance_mm",),
    only_with="tools",
    run=run,
)
