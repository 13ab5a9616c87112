"""Hardware: collisions, screws, light, view, files opened again, outside programs."""

import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.fabrication_molds import fitted
from benchmarks.harness import Table
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.fabrication.hardware.assembly import make_hardware
from phytac_design.fabrication.hardware.bodies import hardware_solids
from phytac_design.fabrication.hardware.by_cad import CadKernel
from phytac_design.fabrication.hardware.step import hardware_bodies, sensor_bodies
from phytac_design.rules.check import check_design
from phytac_design.solids.cad import CadBody, cad_facts
from phytac_design.solids.mesh_facts import manifold_facts, trimesh_facts
from phytac_design.solids.solid_mesh import to_triangles
from phytac_design.stages.build import copy_of
from phytac_design.stages.hardware import HARDWARE
from phytac_design.stages.switch import switches_of
from phytac_shapes.errors import DesignError
from tests.fabrication.cad_files import read_assembly

MAIN = "cylinder60"
ADMESH = (
    "Degenerate facets", "Edges fixed", "Facets removed", "Facets added", "Facets reversed",
    "Backwards edges", "Normals fixed", "Total disconnected facets",
)  # fmt: skip
GCODE_bytes = 20_000
"""A shorter file holds no printed part."""
REFUSED: dict[str, dict[str, dict[str, Any]]] = {
    "M5 set screws on a 4 mm rim": {"hardware": {"screw_clamp": "M5"}},
    "M5 screws in the camera's mount": {"hardware": {"screw_camera": "M5"}},
    "camera board larger than the printer": {"hardware": {"board_size_mm": (180.0, 180.0)}},
    "lens longer than the stand-off": {
        "camera": {"stand_off_mm": 34.0},
        "hardware": {"lens_pupil_mm": 32.0, "lens_length_mm": 40.0},
    },
    "rim without length": {"wall": {"rim_length_mm": 0.0}, "hardware": {"clamps": 5}},
    "board's holes under the lens": {"hardware": {"board_holes_mm": ((8.0, 0.0), (-8.0, 0.0))}},
}
"""Changes to cylinder60 that must be refused, with nothing written."""


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
    table.add(
        f"{name}: hardware, interference of all pairs",
        facts["interference"]["shared_mm3"],
        "mm3",
        reference=pairs,
        source="pairs of bodies, intersected by manifold3d: shell, switches, hardware, screws",
        target="<= 1e-6",
    )
    joints = facts["joints"]
    table.add(
        f"{name}: hardware, joints whose measured holes disagree",
        sum(not joint["agree"] for joint in joints),
        "-",
        reference=len(joints),
        source="joints; diameters measured by rays in the meshes of both sides",
        target="== 0",
    )
    light = facts["light"]
    table.add(
        f"{name}: hardware, ways of light from inside to outside",
        light["leaks"] + light["holes_uncovered"],
        "-",
        reference=light["lines_checked"],
        source="rays from inside; receptors' holes count as closed where a bowl covers them",
        target="== 0",
    )
    view = facts["view"]
    table.add(
        f"{name}: hardware, lines of sight to markers that are cut",
        view["lines_cut"],
        "-",
        reference=view["lines_checked"],
        source="lines from the camera to the markers' painted faces",
        target="== 0",
    )


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
    table.add(
        f"{design.name}: hardware, printed parts not watertight or not one body",
        bad,
        "-",
        reference=len(printed),
        source="printed parts; manifold3d and trimesh",
        target="== 0",
    )
    files = sorted((out / "export" / "fixtures").glob("*.stl"))
    outside(table, design.name, files)


def outside(table: Table, name: str, files: list[Path]) -> None:
    """Run admesh and prusa-slicer on the files as they are."""
    if shutil.which("admesh"):
        repairs = 0
        for file in files:
            report = subprocess.run(
                ["admesh", str(file)], capture_output=True, text=True, check=True
            ).stdout
            fields = dict(line.split(":", 1) for line in report.splitlines() if ":" in line)
            counts = {key.strip(): value.split() for key, value in fields.items()}
            repairs += sum(int(counts[row][0]) for row in ADMESH)
        table.add(
            f"{name}: hardware, repairs by admesh",
            repairs,
            "-",
            reference=len(files),
            source="STL files, all counts of faults",
            target="== 0",
        )
    if shutil.which("prusa-slicer"):
        sliced = 0
        start = time.perf_counter()
        for file in files:
            target = file.with_suffix(".gcode")
            done = subprocess.run(
                ["prusa-slicer", "--export-gcode", str(file), "-o", str(target)],
                capture_output=True,
                text=True,
                check=False,
            )
            sliced += done.returncode == 0 and target.stat().st_size > GCODE_bytes
        table.add(
            f"{name}: hardware, parts not sliced by prusa-slicer",
            len(files) - sliced,
            "-",
            reference=len(files),
            source=f"STL files, {time.perf_counter() - start:.1f} s",
            target="== 0",
        )


def opened_again(table: Table, context: Context, out: Path) -> None:
    """Volumes, names and places of the STEP assembly, opened again."""
    name, design, surface = context.design.name, context.design, context.surface
    kit = make_hardware(design, surface)
    kernel = CadKernel(surface)
    bodies = hardware_bodies(kit, {part.name: kernel.solid(part.node) for part in kit.parts})
    bodies = sensor_bodies(design, surface, context.markers, switches_of(context)) + bodies
    again = read_assembly(out / "export" / "fixtures" / "assembly.step")
    table.add(
        f"{name}: assembly opened again from STEP, names missing or new",
        len({body.name for body in bodies} ^ set(again)),
        "-",
        reference=len(bodies),
        source="bodies: shell, every switch, hardware, screws",
        target="== 0",
    )
    volumes = {body.name: _volume(body) for body in bodies}
    worst = max(abs(_volume(again[key]) / volumes[key] - 1.0) for key in volumes)
    table.add(
        f"{name}: assembly opened again from STEP, volume of the worst body",
        worst,
        "relative",
        reference=len(bodies),
        source="bodies, OpenCASCADE before writing and after reading",
        target="<= 0.0001",
    )
    table.add(
        f"{name}: assembly opened again from STEP, bodies not valid",
        sum(not again[key].shape.isValid() for key in again),
        "-",
        reference=len(bodies),
        source="BRepCheck",
        target="== 0",
    )


def _volume(body: CadBody) -> float:
    return cad_facts(body.shape).volume_mm3


def refusals(table: Table, folder: Path) -> None:
    """Bad input: each refused with one message, and nothing written."""
    base = load_design(MAIN)
    wrong = 0
    for tables in REFUSED.values():
        design = copy_of(base, **tables)
        out = folder / "refused"
        context = Context(
            design=design,
            accuracy=PRESETS["draft"],
            seed=0,
            folders={"switch": folder / f"{MAIN}_switch"},
            progress=lambda _: None,
        )
        try:
            run_stage(context, out)
            wrong += 1
        except DesignError as error:
            wrong += len(str(error)) < 40 or any(out.iterdir())
    table.add(
        "hardware: bad input that is not refused, or leaves files",
        wrong,
        "-",
        reference=len(REFUSED),
        source="; ".join(REFUSED),
        target="== 0",
    )


def timed(table: Table, context: Context, out: Path, accuracy: str, limit_s: float) -> Any:
    """Run the stage on the clock."""
    start = time.perf_counter()
    facts = run_stage(context, out)
    table.add(
        f"{context.design.name}: hardware stage, {accuracy}",
        time.perf_counter() - start,
        "s",
        reference=facts["step"]["bodies"],
        source="bodies in the STEP assembly; CAD already imported",
        target=f"<= {limit_s:g}",
    )
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
        if not quick:
            refusals(table, folder)
