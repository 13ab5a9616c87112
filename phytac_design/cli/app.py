"""The command ``phytac``: short calls into the library, one clear line for every error."""

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

# One BLAS thread, set before numpy loads: the sparse solver's many small products run several
# times slower on two.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from phytac_design.cli import (
    advise_command,
    build_command,
    cache_command,
    camera_command,
    compare_command,
    decode_command,
    import_command,
    live_command,
    mechanics_commands,
    paints_command,
    plan_command,
    serve_command,
    simulate_commands,
    studio_command,
    study_commands,
    switch_command,
    tradeoff_command,
    train_command,
)
from phytac_design.cli.options import DesignArgument, JsonOption, SeedOption, say
from phytac_design.cli.output import print_json
from phytac_shapes.errors import DesignError, MissingPartError, PhytacError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="From one design file: a camera-based force sensor, printable, proven visible, decoded.",
)


@app.command()
def check(design: DesignArgument, seed: SeedOption = 0, as_json: JsonOption = False) -> None:
    """Check rules, visibility and density alone: no solid, no mesh."""
    from phytac_design.design.design_file import load_design
    from phytac_design.rules.design_review import checkup

    report = checkup(load_design(design), seed=seed)
    if as_json:
        print_json(report)
    else:
        _print_check(report)
    for warning in report["warnings"]:
        say(f"warning: {warning}")
    if not report["clear"]:
        raise typer.Exit(DesignError.exit_code)


def _print_check(report: dict[str, Any]) -> None:
    density, seen = report["markers"], report["visibility"]
    typer.echo(
        f"{report['design']}: {density['count']} markers on {density['sensing_area_cm2']:.1f} cm² "
        f"({density['density_per_cm2']:.2f} /cm², {density['surface_class']} to the optical axis)"
    )
    for camera in report["cameras"]:
        lens = camera["lens"]
        typer.echo(
            f"camera {camera['stand_off_mm']:.2f} mm before the {camera['end']} rim; a px is "
            f"{lens['median_mm_per_px_axial']:.3g} mm along the sensor, "
            f"{lens['median_mm_per_px_circumferential']:.3g} mm around it; sharp from "
            f"{lens['depth_near_mm']:.1f} to {lens['depth_far_mm']:.1f} mm, blur up to "
            f"{lens['max_blur_px']:.2g} px"
        )
    for key, value in seen.items():
        typer.echo(f"  {key:26s} {value:g}")
    verdict = (
        "every marker is visible and can be distinguished" if report["clear"] else report["advice"]
    )
    blind = report["visibility"].get("switch_unreadable", 0)
    if blind:
        verdict += f"; {blind} switches cannot be read"
    typer.echo(f"{verdict} ({report['seconds']:.1f} s)")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the new design.")],
    source: Annotated[
        str, typer.Option("--from", help="Design to start from; cylinder60 if not given.")
    ] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; NAME.toml if not given.")] = None,
    from_step: Annotated[
        Path | None, typer.Option(help="STEP file: a patch design of one of its faces.")
    ] = None,
    face: Annotated[
        int | None, typer.Option(help="Number of the face, from 0; the largest if not given.")
    ] = None,
    rows: Annotated[int, typer.Option(help="Points taken along the face.", min=2, max=200)] = 9,
    columns: Annotated[int, typer.Option(help="Points taken across it.", min=2, max=200)] = 9,
) -> None:
    """Write a commented design file to edit."""
    from phytac_design.design.design_file import write_new_design
    from phytac_design.workflows.design_from_step import patch_changes

    target = out or Path(f"{name}.toml")
    if from_step is None:
        typer.echo(f"wrote {write_new_design(name, source or 'cylinder60', target)}")
        return
    changes, said = patch_changes(from_step, face=face, rows=rows, columns=columns)
    typer.echo(
        f"wrote {write_new_design(name, source or 'patch', target, changes=changes)}: {said}"
    )


@app.command()
def schema() -> None:
    """Print the JSON Schema of design files."""
    from phytac_design.design.spec import Design

    print_json(Design.model_json_schema())


@app.command()
def shapes(
    name: Annotated[str, typer.Argument(help="A family, for its drawing and variables.")] = "",
    as_json: JsonOption = False,
) -> None:
    """List the surface families and what each asks of a design file."""
    from phytac_design.design.catalogue import shape_facts, shape_list, shape_page

    if as_json:
        print_json(shape_facts())
    else:
        typer.echo(shape_page(name) if name else shape_list())


for command in (
    advise_command.advise,
    build_command.build,
    cache_command.cache,
    camera_command.camera,
    compare_command.compare,
    decode_command.decode,
    mechanics_commands.press,
    mechanics_commands.mesh,
    mechanics_commands.calibrate,
    live_command.live,
    train_command.export_onnx,
    plan_command.plan,
    tradeoff_command.tradeoff,
    studio_command.studio,
    study_commands.sweep,
    study_commands.optimise,
    serve_command.serve,
    serve_command.convert,
    paints_command.paints,
    switch_command.switch,
    train_command.train,
    train_command.evaluate,
    simulate_commands.simulate,
    simulate_commands.scenarios,
):
    app.command()(command)
app.command("import")(import_command.import_)


EXTRAS = {
    "design": (
        "OCP cadquery lib3mf manifold3d matplotlib meshio numba OpenGL pyarrow pydantic "
        "pyrender scipy tomlkit trimesh yaml"
    ),
    "solid": "gmsh",
    "train": "onnx",
    "study": "dask distributed optuna",
    "studio": "starlette uvicorn",
}
"""Libraries of each extra, by the names they are imported with."""


def main() -> None:
    """Run the command line; a user's error is one line on standard error and an exit code."""
    try:
        app()
    except PhytacError as error:
        say(f"error[{error.code}]: {error}")
        sys.exit(error.exit_code)
    except ModuleNotFoundError as error:
        library = str(error.name).partition(".")[0]
        extra = next((name for name, parts in EXTRAS.items() if library in parts.split()), "")
        if not extra:
            raise
        say(
            f"error[missing-library]: this command needs {library}, which is not installed: "
            f"pip install 'phytac-design[{extra}]'"
        )
        sys.exit(MissingPartError.exit_code)
