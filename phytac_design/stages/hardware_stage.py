"""Camera mount, cover, light bar, connector or frame: printable files and the whole assembly."""

from pathlib import Path
from typing import Any

from phytac_design.design.hardware_table import HardwareSection
from phytac_design.engine.stage import Context, Stage, export_path, write_facts
from phytac_design.fabrication.hardware.assembly_checks import hardware_facts, verdict
from phytac_design.fabrication.hardware.by_cad import (
    CadKernel,
    hardware_bodies,
    sensor_bodies,
    wall_body,
)
from phytac_design.fabrication.hardware.hardware_assembly import make_hardware
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.hardware.sensor_solids import hardware_solids, sensor_solids
from phytac_design.solids.cad import (
    cad_facts,
    read_solid,
    shell_cad,
    write_assembly,
    write_step,
)
from phytac_design.solids.mesh_export import write_stl
from phytac_design.solids.solid_mesh import to_triangles
from phytac_design.stages.shell_stage import SHELL_SOLID, VOLUME_TOL
from phytac_design.stages.switch_stage import refusal, switches_of
from phytac_shapes.errors import DesignError, MissingPartError, NumericalError


def run(context: Context, folder: Path) -> None:
    """Write ``fixtures/….stl`` and ``.step`` of printed parts and ``fixtures/assembly.step``.

    A draft has no STEP files. Default hardware that cannot be made never stops a build: it is left
    out, and the facts give the reason.

    Raises
    ------
    DesignError
        If the design's own hardware does not fit, collides, hides markers or lets light in.
    """
    if reason := refusal(context):
        why = f"without its switches the sensor's holes are open ({reason})"
        _left_out(context, folder, why)
        return
    try:
        kit, solids, facts = _checked(context)
    except DesignError as error:
        if context.design.hardware != HardwareSection():
            raise
        _left_out(context, folder, str(error))
        return
    if not kit.parts:
        _left_out(context, folder, kit.left_out["hardware"])
        return
    # Both kernels must agree before the first file is written.
    try:
        shapes = _cad(context, kit, solids) if context.accuracy.step else {}
    except MissingPartError as error:
        context.progress(f"hardware: STEP left out ({error})")
        facts["step_left_out"] = str(error)
        shapes = {}

    for part in kit.parts:
        if part.printed:
            path = export_path(folder, f"fixtures/{part.name}.stl")
            write_stl(to_triangles(solids[part.name]), path)
    if shapes:
        facts["step"] = _write_step(context, kit, shapes, folder)
    write_facts(folder, facts)


def _left_out(context: Context, folder: Path, why: str) -> None:
    context.progress(f"hardware: left out ({why})")
    write_facts(folder, {"hardware_left_out": why, "parts": []})


def _checked(context: Context) -> tuple[HardwareAssembly, dict[str, Any], dict[str, Any]]:
    """Kit, its solids with shell and switches, and facts; rejected unless all checks pass."""
    design, surface = context.design, context.surface
    kit = make_hardware(design, surface)
    if not kit.parts:
        return kit, {}, {}
    switches = switches_of(context)
    tolerance = context.accuracy.cad_tolerance_mm
    solids = sensor_solids(context.sensor, switches, tolerance_mm=tolerance)
    solids |= hardware_solids(design, surface, kit, tolerance_mm=tolerance)
    cameras = list(context.sensor.cameras)
    found = verdict(context.sensor, switches, cameras, kit, solids)
    found.raise_failure()
    return kit, solids, hardware_facts(design, kit, found, solids)


def _cad(context: Context, kit: HardwareAssembly, solids: dict[str, Any]) -> dict[str, Any]:
    """CAD of all parts by name, each compared with its mesh."""
    kernel = CadKernel(context.surface)
    shapes = {}
    for part in kit.parts:
        shape = kernel.solid(part.node)
        facts, volume = cad_facts(shape), float(solids[part.name].volume())
        difference = abs(volume / facts.volume_mm3 - 1.0)
        if not facts.valid or difference > VOLUME_TOL:
            raise NumericalError(
                "hardware-solid-unsound",
                f"the CAD of {part.name} is not sound: valid {facts.valid}, "
                f"{facts.volume_mm3:.1f} mm³ against {volume:.1f} mm³ of the printed mesh; please "
                "report this design",
            )
        shapes[part.name] = shape
    return shapes


def _write_step(
    context: Context, kit: HardwareAssembly, shapes: dict[str, Any], folder: Path
) -> dict[str, Any]:
    """Write each printed part and the assembly; return what it contains."""
    design = context.design
    for part in kit.parts:
        if part.printed:
            path = export_path(folder, f"fixtures/{part.name}.step")
            write_step(shapes[part.name], path, name=part.name)
    shell = context.folders["step"] / SHELL_SOLID
    whole = shell.is_file()
    if whole:
        context.progress("hardware: STEP of the whole sensor")
        inserts = design.receptor.has_inserts
        solid = shell_cad(context.sensor, glued=True) if inserts else read_solid(shell)
        sensor = sensor_bodies(context.sensor, switches_of(context), solid)
    else:
        why = context.facts("step")["step_left_out"]
        context.progress(f"hardware: the assembly holds the wall without receptors ({why})")
        sensor = [wall_body(design, context.surface)]
    bodies = sensor + hardware_bodies(kit, shapes)
    write_assembly(bodies, export_path(folder, "fixtures/assembly.step"), name=design.name)
    return {"bodies": len(bodies), "shell_with_receptors_and_switches": whole}


HARDWARE = Stage(
    name="hardware",
    design_fields=(
        "name",
        "markers",
        "cameras",
        "bodies",
        "camera.pixel_um",
        "switch",
        "print_rules",
        "hardware",
    ),
    settings=("cad_tolerance_mm", "step"),
    depends_on=("switch", "step"),
    graphics=True,
    imports=("cadquery",),
    run=run,
)
