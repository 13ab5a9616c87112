"""The command that measures paints in a photo."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import JsonOption
from phytac_design.cli.output import names_of, print_json


def paints(
    photo: Annotated[Path, typer.Argument(help="Photo of the markers by the sensor's camera.")],
    design: Annotated[
        str, typer.Argument(help="A shipped design or the path of a file.")
    ] = "cylinder60",
    colours: Annotated[
        str,
        typer.Option(
            help="Paints in the photo, comma separated; those of the design's markers if empty."
        ),
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Propose the table `paints` of a design file from a photo, or say why it cannot be."""
    from phytac_decoder.io.recorded_frames import read_image
    from phytac_design.design.design_file import load_design
    from phytac_design.optics.measured_paints import measure_paints

    loaded = load_design(design)
    names = tuple(names_of(colours)) or tuple(dict.fromkeys(loaded.layout.colours))
    found, separation = measure_paints(read_image(photo), loaded, names)
    changed = {name: rgb for name, rgb in found if rgb != getattr(loaded.paints, name)}
    if as_json:
        print_json({"paints": changed, "separation": separation.summary()})
        return
    typer.echo("[paints]")
    for name, rgb in changed.items():
        typer.echo(f"{name} = {list(rgb)}")
    figures = separation.summary()
    text = f"# {figures['min_floor_sigmas']:.1f} standard deviations of a pixel above the wall"
    if not loaded.dots:
        text += (
            f"; {figures['nearest_paints']} are nearest: {figures['min_hue_deg']:.0f} degrees of "
            f"hue, {figures['min_hue_sigmas']:.1f} standard deviations"
        )
    typer.echo(text)
