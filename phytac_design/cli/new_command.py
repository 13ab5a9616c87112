"""``phytac new``: a design file to edit."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.output import next_step


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
        next_step(f"edit it, then phytac check {target}")
        return
    changes, said = patch_changes(from_step, face=face, rows=rows, columns=columns)
    typer.echo(
        f"wrote {write_new_design(name, source or 'patch', target, changes=changes)}: {said}"
    )
    next_step(f"edit it, then phytac check {target}")
