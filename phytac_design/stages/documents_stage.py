"""Documents for the workbench: paint map, switch placement, bill, recipe, assembly sheet."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from phytac_design.core.figures import pdf, svg
from phytac_design.design.spec import Design
from phytac_design.design.switch_table import BEST
from phytac_design.engine.stage import EXPORT, Context, Stage, export_path, write_facts, write_text
from phytac_design.fabrication.documents import bill_of_materials as bill
from phytac_design.fabrication.documents.assembly_page import assembly_html, fixture_steps
from phytac_design.fabrication.documents.exploded import (
    RUBBER,
    Body,
    insert_bodies,
    part_colour,
    picture,
    switch_bodies,
)
from phytac_design.fabrication.documents.paint_map import (
    make_map,
    marks_csv,
    paper_pages,
    placement_csv,
    whole_page,
)
from phytac_design.fabrication.documents.recipe import make_recipe, recipe_steps, recipe_text
from phytac_design.fabrication.documents.section_view import section_svg
from phytac_design.fabrication.documents.strip_drawing import strips_svg, wrapped_webs
from phytac_design.fabrication.hardware.sensor_solids import exploded_bodies
from phytac_design.fabrication.molds.make import strips_of
from phytac_design.fabrication.switch_strips import StripSet
from phytac_design.solids.mesh_export import DISPLAY_COLOURS, read_stl
from phytac_design.stages.printing_stage import OTHERS
from phytac_design.stages.switch_stage import switches_of, without_switches


def run(context: Context, folder: Path) -> None:
    """Write ``bench/…`` and the facts: map, bill, recipe."""
    if without_switches(context, folder, needed=False):
        return
    design, markers = context.design, context.markers
    switches, cast = switches_of(context), cast_design(context)

    strips = strips_of(context.sensor, switches, tolerance_mm=context.accuracy.cad_tolerance_mm)

    drawn = make_map(context.sensor, switches, strips)
    write_text(folder, "bench/paint_map.svg", svg(whole_page(drawn)))
    write_text(folder, "bench/paint_map_inside.svg", svg(whole_page(drawn, inside=True)))
    pages = paper_pages(drawn)
    data = pdf(pages, title=f"{design.name}: paint map")
    export_path(folder, "bench/paint_map.pdf").write_bytes(data)
    if switches.kinds:
        placement = placement_csv(context.surface, markers, switches, drawn)
        write_text(folder, "bench/switch_placement.csv", placement)
    if context.sensor.reference_marks.count:
        marks = marks_csv(context.sensor, drawn)
        write_text(folder, "bench/reference_marks.csv", marks)

    lists, hardware = parts_of(context), context.facts("hardware")
    shell_volume = float(context.facts("shell")["volume_mm3"])
    rows = bill.bill_rows(
        [
            *bill.shell_parts(design, shell_volume, context.facts("printing")["pieces"]),
            *bill.switch_parts(switches, strips),
            *bill.optics_parts(design, listed=bool(lists["hardware"])),
            *(part for parts in lists.values() for part in parts),
        ]
    )
    write_text(folder, "bench/bill_of_materials.csv", bill.bill_csv(rows))
    recipe = None
    if switches.kinds:
        castings = int(context.facts("mold").get("castings", 1)) if strips else 1
        recipe = make_recipe(cast, rubber_mm3(rows), _volume_mm3(rows, "silicone"), castings)
        text = recipe_text(cast, recipe, strips, body=switches.body)
        write_text(folder, "bench/casting.md", text)
    flat = ""
    if strips is not None:
        flat = strips_svg(context.sensor, strips)
        write_text(folder, "bench/strips.svg", flat)
    context.progress("bench: assembly sheet")
    sheet = assembly_html(
        cast,
        switches,
        recipe,
        count=markers.count,
        bill=rows,
        steps=recipe_steps(cast, recipe, strips, body=switches.body) if recipe else (),
        fixture_steps=fixture_steps(design, hardware),
        pictures=pictures(context, strips),
        section=section_svg(design, markers, switches) if recipe else "",
        strips=strips,
        flat=flat,
    )
    write_text(folder, "bench/assembly.html", sheet)
    masses = {name: bill.total_mass_g(rows, name) for name in ("resin", "tpu", "silicone")}
    if design.receptor.has_inserts:
        colours = set(design.layout.colours)
        masses["inserts"] = sum(bill.total_mass_g(rows, f"paint-{name}") for name in colours)
    write_facts(
        folder,
        {
            "bill": rows,
            "mass_g": masses,
            "recipe": asdict(recipe) if recipe else None,
            "map": {
                "kind": drawn.unrolled.kind,
                "pieces": drawn.unrolled.pieces,
                "scale_least": float(drawn.unrolled.stretch[0]),
                "scale_most": float(drawn.unrolled.stretch[1]),
                "sheets": len(pages),
            },
        },
    )


def cast_design(context: Context) -> Design:
    """The design with the rubber that was chosen for its switches, where it names none."""
    design = context.design
    if not design.has_switches or design.switch.material != BEST:
        return design
    chosen = context.facts("switch")["switches"][0]["rubber"]["name"]
    switch = design.switch.model_copy(update={"material": chosen})
    return design.model_copy(update={"switch": switch})


def parts_of(context: Context) -> dict[str, list[dict[str, Any]]]:
    """Parts lists of the other stages, by stage."""
    return {name: context.facts(name)["parts"] for name in OTHERS if name in context.folders}


def _volume_mm3(rows: list[dict[str, Any]], material: str) -> float:
    return float(sum(r["count"] * r["volume_mm3"] for r in rows if r["material"] == material))


def rubber_mm3(rows: list[dict[str, Any]]) -> float:
    """Rubber of all parts that are cast."""
    return _volume_mm3(rows, "tpu")


def pictures(context: Context, strips: StripSet | None = None) -> dict[str, bytes]:
    """Exploded pictures by caption."""
    pull_mm = 16.0  # how far the exploded picture pulls the switches out

    markers = context.markers
    out = {}
    if "hardware_left_out" not in context.facts("hardware"):
        tolerance = context.accuracy.cad_tolerance_mm
        parts = exploded_bodies(context.sensor, tolerance_mm=tolerance)
        bodies = [
            Body(mesh=mesh.moved(shift), colour=part_colour(name))
            for name, (mesh, shift) in parts.items()
        ]
        out["Shell, camera, light and their holders, pulled apart."] = picture(bodies)
    stl = context.folders["shell"] / EXPORT / "shell/shell.stl"
    shell = Body(mesh=read_stl(stl), colour=DISPLAY_COLOURS["resin"][:3])
    if context.design.receptor.has_inserts:
        inserts = insert_bodies(context.sensor, pull_mm)
        out[f"Shell and {markers.count} inserts, pulled out."] = picture([shell, *inserts])
    if not context.design.has_switches:
        return out
    switches = switch_bodies(context.surface, markers, switches_of(context), pull_mm)
    caption = f"Shell and {markers.count} switches, pulled out."
    if strips is not None:
        caption = f"Shell and {len(strips.strips)} strips of switches, pulled out."
        web = wrapped_webs(context.sensor, strips, pull_mm=pull_mm)
        switches.append(Body(mesh=web, colour=RUBBER))
    out[caption] = picture([shell, *switches])
    return out


BENCH = Stage(
    name="bench",
    design_fields=(
        "name",
        "description",
        "markers",
        "cameras",
        "bodies",
        "camera.pixel_um",
        "switch",
        "mold",
        "strip",
        "bench",
        "hardware",
        "print_rules",
        "material.modulus_MPa",
    ),
    settings=("cad_tolerance_mm",),
    depends_on=("shell", "switch", "printing", *OTHERS),
    only_with="tools",
    imports=("matplotlib",),
    run=run,
)
