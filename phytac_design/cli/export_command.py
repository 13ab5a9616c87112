"""The command that writes a design as a part for robot simulators."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, check_out, say
from phytac_design.cli.output import next_step, print_json

SimulatorFormat = Literal["mjcf", "urdf", "sdf", "usd"]
NEXT = {
    "mjcf": "python -m mujoco.viewer --mjcf={out}/{name}.xml",
    "urdf": "load {out}/{name}.urdf, with --mesh-prefix package://… where ROS needs it",
    "sdf": "gz sdf --check {out}/model.sdf, then include the folder in a world",
    "usd": "add {out}/{name}.usda to a stage as a reference",
}
"""What to do with each format."""


def export(
    design: DesignArgument,
    to: Annotated[
        SimulatorFormat,
        typer.Option(help="MuJoCo, ROS, Gazebo, or Isaac Sim (extra usd)."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out, help="The export's own folder; exports/NAME-TO if not given."
        ),
    ] = None,
    receptors: Annotated[
        bool | None,
        typer.Option(
            "--receptors/--no-receptors",
            help="Write a frame for each receptor; by default not in URDF, where each is a link.",
        ),
    ] = None,
    mesh_prefix: Annotated[
        str,
        typer.Option(help="Prefix of the names of mesh files, such as package://my_robot/sensor/."),
    ] = "",
    force: Annotated[
        bool, typer.Option(help="Overwrite a folder that holds something else.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a part for robot simulators: meshes, mass, collisions, cameras, receptors."""
    from phytac_design.design.design_file import load_design
    from phytac_design.workflows.export_simulator import export_simulator

    loaded = load_design(design)
    out = out or Path("exports") / f"{loaded.name}-{to}"
    facts = export_simulator(
        loaded,
        out,
        to=to,
        receptors=receptors,
        prefix=mesh_prefix,
        force=force,
        progress=say,
    )
    if as_json:
        print_json({"out": str(out)} | facts)
        return
    typer.echo(
        f"{out}: {1e3 * facts['mass_kg']:.1f} g, {facts['collision_pieces']} convex collision "
        f"pieces, {len(facts['cameras'])} camera(s), {facts['receptors']} receptor frames"
    )
    next_step(NEXT[to].format(out=out, name=loaded.name))
