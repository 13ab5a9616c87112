"""Hardware: collisions, screws, light, view, files opened again, outside programs."""

import json
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.fabrication_molds import fitted
from benchmarks.fabrication_outside import repair_row, slice_row
from benchmarks.harness import Table
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.fabrication.hardware.by_cad import CadKernel
from phytac_design.fabrication.hardware.hardware_assembly import make_hardware
from phytac_design.fabrication.hardware.sensor_solids import hardware_solids
from phytac_design.fabrication.hardware.step import hardware_bodies, sensor_bodies
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.solids.cad import CadBody, cad_facts
from phytac_design.solids.mesh_facts import manifold_facts, trimesh_facts
from phytac_design.solids.solid_mesh import to_triangles
from phytac_design.stages.hardware_stage import HARDWARE
from phytac_design.stages.switch_stage import switches_of
from tests.fabrication.cad_files import read_assembly

MAIN = "cylinder60"


def context_of(design: Design, folder: Path, accuracy: str) -> Context:
    """Context of a design whose bowls have been fitted, in ``folder``."""
    made = folder / f"{design.name}_switch"
    if not (made / "facts.json").is_file():
        fitted(design, made)
    return Context(
        design=design,
        accuracy=PRESETS[accuracy],
        seed=0,
        folders={"switch": made},
        progress=lambda _: None,
    )


def run_stage(context: Context, out: Path) -> dict[str, Any]:
    """Run the hardware stage into an empty folder; its facts."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    HARDWARE.run(context, out)
    facts: dict[str, Any] = json.loads((out / "facts.json").read_text())
    return facts


def checks(table: Table, name: str, facts: dict[str, Any]) -> None:
    """Add what the stage's checks of one assembly found."""
    pairs = facts["interference"]["pairs"]
    row = f"{name}: hardware, interference of all pairs"
    source = "pairs of bodies, intersected by manifold3d: shell, switches, hardware, screws"
    table.add(row, facts["interference"]["shared_mm3"], "mm3", pairs, source, "<= 1e-6")
    joints = facts["joints"]
    row = f"{name}: hardware, joints whose measured holes disagree"
    source = "joints; diameters measured by rays in the meshes of both sides"
    table.add(row, sum(not joint["agree"] for joint in joints), "-", len(joints), source, "== 0")
    light = facts["light"]
    row = f"{name}: hardware, ways of light from inside to outside"
    source = "rays from inside; receptors' holes count as closed where a bowl covers them"
    value = light["leaks"] + light["holes_uncovered"]
    table.add(row, value, "-", light["lines_checked"], source, "== 0")
    view = facts["view"]
    row = f"{name}: hardware, lines of sight to markers that are cut"
    source = "lines from the camera to the markers' painted faces"
    table.add(row, view["lines_cut"], "-", view["lines_checked"], source, "== 0")


def parts(table: Table, context: Context, out: Path) -> None:
    """Printed parts of one design: watertight, one body each; by outside programs."""
    design, surface = context.design, context.surface
    kit = make_hardware(design, surface)
    tolerance = context.accuracy.cad_tolerance_mm
    solids = hardware_solids(design, surface, kit, tolerance_mm=tolerance)
    printed = [part.name for part in kit.parts if part.printed]
    bad = 0
    for part in printed:
        found = (manifold_facts(solids[part]), trimesh_facts(to_triangles(solids[part])))
        bad += any((facts.watertight, facts.bodies) != (True, 1) for facts in found)
    row = f"{design.name}: hardware, printed parts not watertight or not one body"
    table.add(row, bad, "-", len(printed), "printed parts; manifold3d and trimesh", "== 0")
    files = sorted((out / "export" / "fixtures").glob("*.stl"))
    repair_row(table, f"{design.name}: hardware, ", files)
    slice_row(table, f"{design.name}: hardware, ", files)


def opened_again(table: Table, context: Context, out: Path) -> None:
    """Volumes, names and places of the STEP assembly, opened again."""
    name, design, surface = context.design.name, context.design, context.surface
    kit = make_hardware(design, surface)
    kernel = CadKernel(surface)
    bodies = hardware_bodies(kit, {part.name: kernel.solid(part.node) for part in kit.parts})
    bodies = (
        sensor_bodies(Sensor.of(design, surface, context.markers), switches_of(context)) + bodies
    )
    again = read_assembly(out / "export" / "fixtures" / "assembly.step")
    row = f"{name}: assembly opened again from STEP, names missing or new"
    source = "bodies: shell, every switch, hardware, screws"
    value = len({body.name for body in bodies} ^ set(again))
    table.add(row, value, "-", len(bodies), source, "== 0")
    volumes = {body.name: _volume(body) for body in bodies}
    worst = max(abs(_volume(again[key]) / volumes[key] - 1.0) for key in volumes)
    row = f"{name}: assembly opened again from STEP, volume of the worst body"
    source = "bodies, OpenCASCADE before writing and after reading"
    table.add(row, worst, "relative", len(bodies), source, "<= 0.0001")
    row = f"{name}: assembly opened again from STEP, bodies not valid"
    value = sum(not again[key].shape.isValid() for key in again)
    table.add(row, value, "-", len(bodies), "BRepCheck", "== 0")


def _volume(body: CadBody) -> float:
    return cad_facts(body.shape).volume_mm3


def timed(table: Table, context: Context, out: Path, accuracy: str, limit_s: float) -> Any:
    """Run the stage on the clock."""
    start = time.perf_counter()
    facts = run_stage(context, out)
    row = f"{context.design.name}: hardware stage, {accuracy}"
    source = "bodies in the STEP assembly; CAD already imported"
    value = time.perf_counter() - start
    table.add(row, value, "s", facts["step"]["bodies"], source, f"<= {limit_s:g}")
    return facts


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes the flat pad alone, at draft."""
    names = ["plane"] if quick else sorted(shipped_designs(), key=lambda item: item != MAIN)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for item in names:
            check_design(load_design(item))
            context = context_of(load_design(item), folder, "draft")
            out = folder / item
            if item == MAIN:
                run_stage(context, out)  # imports and compiles
                timed(table, context, out, "draft", 4.0)
                context = context_of(load_design(item), folder, "standard")
                facts = timed(table, context, out, "standard", 15.0)
                opened_again(table, context, out)
            else:
                facts = run_stage(context, out)
            checks(table, item, facts)
            parts(table, context, out)
