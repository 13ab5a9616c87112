"""Calibration kit: indenters, grippers, seats and jigs that fit the shape, and motion programs."""

from pathlib import Path
from typing import Any

from phytac_design.engine.stage import Context, Stage, export_path, write_facts, write_text
from phytac_design.fabrication.calibration_rig.guide import guide_text
from phytac_design.fabrication.calibration_rig.log_template import log_head
from phytac_design.fabrication.calibration_rig.program import gcode, make_program, program_csv
from phytac_design.fabrication.calibration_rig.regions import make_regions
from phytac_design.fabrication.calibration_rig.tool_bodies import kit_bodies, kit_parts
from phytac_design.solids.mesh_export import write_stl
from phytac_design.solids.solid_mesh import stl_triangles, to_triangles
from phytac_design.stages.switch_stage import switches_of, without_switches


def run(context: Context, folder: Path) -> None:
    """Write ``kit/…`` and the facts: parts, regions, tools."""
    if without_switches(context, folder):
        return
    sensor = context.sensor
    design, markers = context.design, context.markers
    regions = make_regions(sensor)
    switches = switches_of(context)
    bowl = max(float(switches.profile(kind)[:, 1].max()) for kind in switches.kinds)
    kit = kit_bodies(
        sensor,
        regions,
        bowl_mm=bowl,
        tolerance_mm=context.accuracy.cad_tolerance_mm,
    )
    for piece in kit.pieces:
        mesh = stl_triangles(to_triangles(piece.body))
        write_stl(mesh, export_path(folder, f"kit/{piece.name}.stl"))

    program = make_program(sensor, regions, bowl_mm=bowl)
    write_text(folder, "kit/program.csv", program_csv(program, markers))
    write_text(folder, "kit/shell.gcode", gcode(program, "shell", name=design.name))
    write_text(folder, "kit/decoder.gcode", gcode(program, "decoder", name=design.name))
    write_text(folder, "kit/calibration_log.csv", log_head(design.name))
    write_text(folder, "kit/README.md", guide_text(design, markers, regions, program, kit))
    facts: dict[str, Any] = {
        "parts": kit_parts(design, kit),
        "regions": len(regions.marker),
        "regions_too_near_a_rim": len(regions.too_near),
        "markers": markers.count,
        "turns": regions.symmetry.turns,
        "mirrors": regions.symmetry.mirrors,
        "indenters": len(regions.faces),
        "left_out": kit.left_out,
    }
    write_facts(folder, facts)


KIT = Stage(
    name="kit",
    design_fields=(
        "name",
        "markers",
        "wall",
        "receptor",
        "switch",
        "training.force_min_N",
        "touch",
        "kit",
        "print_rules.gap_min_mm",
    ),
    settings=("cad_tolerance_mm",),
    depends_on=("switch",),
    only_with="tools",
    run=run,
)
