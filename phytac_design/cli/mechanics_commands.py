"""Commands of the shell's mechanics: press, mesh, calibrate."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, check_out, say
from phytac_design.cli.output import names_of, next_step, print_json
from phytac_shapes.errors import InputError

Theory = Literal["auto", "linear", "large"]
Parameter = StrEnum("Parameter", ["modulus", "thickness", "poisson"])
AtOption = Annotated[
    str,
    typer.Option(
        help="Marker number, or chart position u,v; the middle if not given. Around the axis of a "
        "closed shape v is an angle in radians, on a cuboid a length in mm."
    ),
]
RadiusOption = Annotated[
    float | None,
    typer.Option(
        help="Radius of the pressed disc, mm; the design's fingertip if not given, 0 for a point."
    ),
]
RefineOption = Annotated[
    int, typer.Option(help="Number of shell elements per marker pitch.", min=1, max=32)
]
PressRefineOption = Annotated[
    int,
    typer.Option(
        help="Number of shell elements per marker pitch; linear motion is extrapolated from twice "
        "and half as many.",
        min=1,
        max=16,
    ),
]


def press(
    design: DesignArgument,
    force: Annotated[float, typer.Option(help="Force of the press, N, inward.")],
    at: AtOption = "",
    radius: RadiusOption = None,
    theory: Annotated[
        Theory,
        typer.Option(
            help="Theory; auto uses large displacements where linear theory is not accurate enough."
        ),
    ] = "auto",
    tolerance: Annotated[float, typer.Option(help="Accepted error of linear theory, %.")] = 5.0,
    refine: PressRefineOption = 4,
    receptors: Annotated[
        bool, typer.Option(help="Include the stiffness of tubes and holes in the wall.")
    ] = True,
    vtu: Annotated[
        Path | None,
        typer.Option(help="File for the displaced mesh, for ParaView: one mesh, not extrapolated."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Press on the shell with a force; print motion, theory used and estimated errors."""
    from phytac_design.design.design_file import load_design
    from phytac_design.layout.sensor import Sensor
    from phytac_design.mechanics.pressing import press as mechanics
    from phytac_design.mechanics.pressing.contact_patch import parse_contact_patch
    from phytac_design.mechanics.pressing.press_report import press_dict, press_text, press_warnings

    loaded = load_design(design)
    sensor = Sensor(loaded)
    place = parse_contact_patch(sensor, force_N=force, at=at, radius_mm=radius)
    if vtu and vtu.suffix.lower() != ".vtu":
        raise InputError(
            "file-ending", f"--vtu writes a VTK file (got {vtu.name}); end its name in .vtu"
        )
    accepted = tolerance / 100.0
    result = mechanics.press(
        sensor,
        place,
        theory=theory,
        tolerance=accepted,
        refine=refine,
        receptors=receptors,
        progress=say,
    )
    if vtu:
        say(f"wrote {mechanics.write_press(vtu, result)}")
    for warning in press_warnings(result, tolerance=accepted):
        say(f"warning: {warning}")
    if as_json:
        plain = press_dict(result, sensor.markers, name=loaded.name, tolerance=accepted)
        print_json(plain)
    else:
        typer.echo(press_text(result, sensor.markers, name=loaded.name, tolerance=accepted))


def mesh(
    design: DesignArgument,
    out: Annotated[Path, typer.Option(callback=check_out, help="Folder for the files.")],
    solid: Annotated[
        bool,
        typer.Option(
            help="Also mesh the exact CAD solid with quadratic tetrahedra (gmsh; takes minutes)."
        ),
    ] = False,
    formats: Annotated[str, typer.Option(help="File formats: inp, msh, vtu, comma separated.")] = (
        "inp,msh,vtu"
    ),
    force: Annotated[
        float, typer.Option(help="Force of the load step in the file, N, inward.")
    ] = 10.0,
    at: AtOption = "",
    radius: RadiusOption = None,
    refine: RefineOption = 4,
    size: Annotated[
        float | None,
        typer.Option(
            help="Factor on the solid's element sizes; chosen for the sensor if not given."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write meshes with sets, section, material and a load step: ccx runs them unchanged."""
    from phytac_design.design.design_file import load_design
    from phytac_design.layout.sensor import Sensor
    from phytac_design.mechanics.pressing.contact_patch import parse_contact_patch
    from phytac_design.mechanics.solid import mesh_files

    kinds = names_of(formats)
    mesh_files.check_formats(kinds)
    loaded = load_design(design)
    sensor = Sensor(loaded)
    place = parse_contact_patch(sensor, force_N=force, at=at, radius_mm=radius)
    if solid:
        mesh_files.check_solid(sensor, place, size=size)
    mesh_files.make_folder(out)
    facts = {
        "shell": mesh_files.write_shell_files(out, sensor, place, refine=refine, formats=kinds)
    }
    if solid:
        facts["solid"] = mesh_files.write_solid_files(
            out, sensor, place, size=size, formats=kinds, progress=say
        )
    if as_json:
        print_json({"out": str(out)} | facts)
        return
    for name, made in facts.items():
        files = ", ".join(f"{name}.{kind}" for kind in kinds)
        typer.echo(f"{out}: {files}: {made['nodes']} nodes, {made['elements']} elements")


def calibrate(
    design: DesignArgument,
    measurements: Annotated[Path, typer.Argument(help="CSV of forces and displacements.")],
    fix: Annotated[
        list[Parameter] | None, typer.Option(help="Parameter that is known and stays as designed.")
    ] = None,
    limit: Annotated[
        float,
        typer.Option(help="Largest relative uncertainty (±) that is accepted.", min=0.001, max=1.0),
    ] = 0.1,
    accuracy: Annotated[
        Preset, typer.Option(help="Preset, a trade of speed against accuracy.")
    ] = "standard",
    out: Annotated[
        Path | None, typer.Option(callback=check_out, help="Calibrated design file to write.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit modulus, wall and Poisson's ratio to measured forces and displacements."""
    from phytac_design.design.design_file import load_design
    from phytac_design.mechanics.calibration.calibrate_design import (
        calibrate_design,
        refuse_existing,
        write_calibrated,
    )

    if out:
        refuse_existing(out)  # before any work
    loaded = load_design(design)
    fit = calibrate_design(
        loaded,
        measurements,
        fixed=[one.value for one in fix or []],
        limit=limit,
        accuracy=accuracy,
        progress=say,
    )
    if out:
        say(f"wrote {write_calibrated(loaded, fit, out)}")
    if as_json:
        print_json(fit.as_dict())
        return
    typer.echo(fit.text())
    typer.echo(f"known to ± {100.0 * fit.half_width():.2g} % at worst (needs {100.0 * limit:g} %)")
    next_step(f"phytac build {out}" if out else "the same with --out FILE writes the design")
