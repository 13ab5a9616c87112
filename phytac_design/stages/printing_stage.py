"""Print rules of every printed part: violations, orientation, and parting of a large shell."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.engine.stage import EXPORT, Context, Stage, export_path, write_facts, write_text
from phytac_design.fabrication.printing.overhang import suggest
from phytac_design.fabrication.printing.parting import part_shell
from phytac_design.fabrication.printing.print_checks import check_body, check_shell
from phytac_design.fabrication.printing.print_drawing import draw_report
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.solids.mesh_export import read_stl, write_stl
from phytac_design.solids.solid_mesh import shell_manifold, to_triangles
from phytac_shapes.errors import DesignError

OTHERS = ("mold", "hardware", "kit", "inserts")
"""Stages whose parts lists name more printed files."""
UPRIGHT = np.array([0.0, 0.0, 1.0])
"""Sprues of inserts stand on their bars."""


def run(context: Context, folder: Path) -> None:
    """Write ``shell/print_report.json`` and ``.svg``, and ``shell/shell_part_….stl`` if parted."""
    design, rules = context.design, context.design.print_rules
    tolerance = context.accuracy.cad_tolerance_mm
    shell_file = "shell/shell.stl"
    mesh = read_stl(context.folders["shell"] / EXPORT / shell_file)
    report = check_shell(context.sensor, mesh, tolerance_mm=tolerance)
    picture = draw_report(RayTree(mesh), report, rules, f"{design.name}: the shell, as printed")
    write_text(folder, "shell/print_report.svg", picture)
    parts = {shell_file: report.as_dict()}
    others = printed_files(context)
    unchecked = [] if context.accuracy.tools else sorted(others)
    for file, path in others.items():
        if file in unchecked:
            continue
        context.progress(f"printing: {file}")
        # Measured at coarser points than the shell: they are sturdier.
        up = UPRIGHT if file.startswith("inserts/") else None
        other = check_body(read_stl(path), rules, spacing_mm=1.0, tolerance_mm=tolerance, up=up)
        parts[file] = other.as_dict()
    facts: dict[str, Any] = {
        "process": rules.process,
        "rules": rules.model_dump(mode="json"),
        "files": parts,
        "unchecked": unchecked,
        "violations": sum(len(part["violations"]) for part in parts.values()),
        "pieces": [],
        "not_parted": "",
    }
    if not report.standing.fits:
        context.progress("printing: parts for the bed")
        try:
            facts |= _part(context, folder)
        except DesignError as error:
            facts["not_parted"] = str(error)
    text = json.dumps(facts, indent=1, ensure_ascii=False)
    write_text(folder, "shell/print_report.json", text + "\n")
    write_facts(folder, facts)


def printed_files(context: Context) -> dict[str, Path]:
    """Files of all printed parts but the shell, each once, by their place in the exports."""
    found: dict[str, Path] = {}
    for name in OTHERS:
        if name not in context.folders:
            continue
        for part in context.facts(name).get("parts", []):
            file = str(part["file"])
            path = context.folders[name] / EXPORT / file
            printed = part["material"] == "resin" or part["material"].startswith("paint-")
            if printed and file.endswith(".stl") and path.is_file():
                found.setdefault(file, path)
    return found


def _part(context: Context, folder: Path) -> dict[str, Any]:
    """Write the pieces of a shell that is larger than the bed; their facts."""
    design = context.design
    tolerance = context.accuracy.cad_tolerance_mm
    solid = shell_manifold(context.sensor, tolerance_mm=tolerance)
    parting = part_shell(context.sensor, solid, tolerance_mm=tolerance)
    pieces = []
    for number, piece in enumerate(parting.pieces, start=1):
        file = f"shell/shell_part_{number}.stl"
        mesh = to_triangles(piece)
        write_stl(mesh, export_path(folder, file))
        standing, _ = suggest(mesh, RayTree(mesh), design.print_rules)
        volume = float(piece.volume())
        pieces.append({"file": file, "volume_mm3": volume, "orientation": standing.as_dict()})
    return {
        "pieces": pieces,
        "keys": {
            "count": len(parting.keys_mm),
            "peg_mm": parting.size.peg,
            "socket_mm": parting.size.socket,
            "boss_mm": parting.size.boss,
            "length_mm": parting.size.length,
            "boss_volume_mm3": parting.boss_volume_mm3,
            "clearance_volume_mm3": parting.clearance_volume_mm3,
            "at_mm": parting.keys_mm.round(3).tolist(),
        },
        "cuts": [
            {"normal": cut.normal.round(6).tolist(), "offset_mm": cut.offset_mm}
            for cut in parting.cuts
        ],
    }


PRINTING = Stage(
    name="printing",
    design_fields=("name", "tubes", "wall", "receptor", "print_rules"),
    settings=("cad_tolerance_mm", "tools"),
    depends_on=("shell", *OTHERS),
    imports=("matplotlib",),
    run=run,
)
