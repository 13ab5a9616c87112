"""The shell mesh for other solvers: Abaqus/CalculiX, Gmsh, VTK."""

from pathlib import Path

from phytac_design.engine.stage import EXPORT, Context, Stage, write_facts
from phytac_design.mechanics.pressing.contact_patch import middle_marker, parse_contact_patch
from phytac_design.mechanics.solid.mesh_files import make_folder, write_shell_files


def run(context: Context, folder: Path) -> None:
    """Write ``mesh/shell.{inp,msh,vtu}`` with a fingertip load step and its linear result."""
    load_N = 10.0  # a fingertip in the middle of the sensor
    place = parse_contact_patch(context.sensor, force_N=load_N)
    target = folder / EXPORT / "mesh"
    make_folder(target)
    facts = write_shell_files(target, context.sensor, place, refine=context.accuracy.refine)
    write_facts(
        folder,
        facts
        | {
            "load_N": load_N,
            "load_radius_mm": place.radius_mm,
            "load_marker": middle_marker(context.surface, context.markers),
        },
    )


MESH = Stage(
    name="mesh",
    design_fields=("name", "bases", "material", "training.patch_radius_max_mm"),
    settings=("refine",),
    run=run,
)
