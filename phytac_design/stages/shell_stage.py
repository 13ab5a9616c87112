"""Printable shell: STL and 3MF from manifold3d, STEP from OpenCASCADE, from one geometry."""

from pathlib import Path

from phytac_design.engine.stage import Context, Stage, export_path, write_facts
from phytac_design.solids.cad import cad_facts, shell_cad, write_solid, write_step
from phytac_design.solids.mesh_export import write_3mf, write_stl
from phytac_design.solids.mesh_facts import shell_facts
from phytac_design.solids.solid_mesh import painted_manifolds, shell_manifold, to_triangles
from phytac_shapes.errors import CadKernelError, MissingPartError, NumericalError

VOLUME_TOL = 1e-3
"""Largest relative difference of the two kernels' volumes that a build accepts."""
SHELL_SOLID = "shell.bin"
"""The solid of ``shell.step`` for later stages, if there is one."""
FINE_mm = 0.005
"""Chordal tolerance of the finer facets that are compared where the printed ones differ by more."""


def run_shell(context: Context, folder: Path) -> None:
    """Write ``shell/shell.stl`` and ``shell/shell.3mf`` and the shell's facts.

    Where lib3mf is not installed, the 3MF file is left out and the facts give the reason.
    """
    design = context.design
    tolerance = context.accuracy.cad_tolerance_mm
    solid = shell_manifold(context.sensor, tolerance_mm=tolerance)
    facts = shell_facts(
        solid, context.surface, context.markers, holes=design.receptor.diameter_bore_mm > 0.0
    ).as_dict()
    write_stl(to_triangles(solid), export_path(folder, "shell/shell.stl"))
    context.progress("shell: painted bodies")
    painted = painted_manifolds(context.sensor, tolerance_mm=tolerance)
    bodies = {name: to_triangles(body) for name, body in painted.items()}
    try:
        write_3mf(bodies, export_path(folder, "shell/shell.3mf"), name=design.name)
    except ModuleNotFoundError as error:
        if error.name != "lib3mf":
            raise
        reason = "lib3mf is not installed; it has no wheel for Linux on ARM"
        context.progress(f"shell: 3MF left out ({reason})")
        facts["3mf_left_out"] = reason
    facts["body_volume_mm3"] = {name: body.volume() for name, body in painted.items()}
    write_facts(folder, facts)


def run_step(context: Context, folder: Path) -> None:
    """Write ``shell/shell.step`` and compare its volume with the printed mesh.

    The solid itself is kept for the assembly of the stage ``hardware``. A draft has neither. On a
    machine without the graphics libraries that CadQuery links, or where OpenCASCADE cannot make the
    solid, the file is left out and the report gives the reason; STL and 3MF need neither.
    """
    reason = ""
    try:
        solid = shell_cad(context.sensor)
        facts = cad_facts(solid)
    except (MissingPartError, CadKernelError) as error:
        reason = str(error)
    else:
        if not facts.valid or facts.solids != 1:
            reason = f"OpenCASCADE's solid is not sound: {facts.solids} solids"
    if reason:
        context.progress(f"step: left out ({reason})")
        write_facts(folder, {"step_left_out": reason})
        return
    difference = float(context.facts("shell")["volume_mm3"]) / facts.volume_mm3 - 1.0
    if not abs(difference) <= VOLUME_TOL:
        _compare_finer(context, facts.volume_mm3)
    write_step(solid, export_path(folder, "shell/shell.step"), name=context.design.name)
    write_solid(solid, folder / SHELL_SOLID)
    write_facts(
        folder,
        {
            "step_volume_mm3": facts.volume_mm3,
            "step_valid": facts.valid,
            "step_solids": facts.solids,
            "volume_difference": difference,
        },
    )


def _compare_finer(context: Context, step_mm3: float) -> None:
    """Compare the volume with that of finer facets: coarse ones differ by their own error.

    Raises
    ------
    NumericalError
        If that differs as well.
    """
    solid = shell_manifold(context.sensor, tolerance_mm=FINE_mm)
    volume = float(solid.volume())
    if not abs(volume / step_mm3 - 1.0) <= VOLUME_TOL:
        raise NumericalError(
            "kernels-disagree",
            f"two kernels do not make the same shell: {step_mm3:.1f} mm³ in STEP against "
            f"{volume:.1f} mm³ of a mesh; please report this design",
        )


SHELL = Stage(
    name="shell",
    design_fields=("name", "markers", "wall", "receptor"),
    settings=("cad_tolerance_mm",),
    run=run_shell,
)
STEP = Stage(
    name="step",
    design_fields=("name", "tubes", "wall", "receptor"),
    depends_on=("shell",),
    graphics=True,
    only_with="step",
    imports=("cadquery",),
    run=run_step,
)
