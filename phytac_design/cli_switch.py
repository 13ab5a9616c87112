"""The command of the threshold switch."""

import json
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli_options import JsonOption, say


def switch(
    design: Annotated[
        str, typer.Argument(help="A shipped design or the path of a file.")
    ] = "cylinder60",
    threshold: Annotated[
        float | None, typer.Option("--threshold-N", help="Threshold, N; the design's if not given.")
    ] = None,
    material: Annotated[str, typer.Option(help="Rubber: tpu-8400n or silicone-a30.")] = "tpu-8400n",
    modulus: Annotated[
        float | None, typer.Option("--modulus-MPa", help="Young's modulus of the rubber.")
    ] = None,
    test: Annotated[
        Path | None, typer.Option(help="CSV of a tensile test (stretch, stress_MPa) to fit.")
    ] = None,
    law: Annotated[str, typer.Option(help="For --test: neo-hookean, yeoh or ogden.")] = "yeoh",
    wall_min: Annotated[
        float, typer.Option("--wall-min-mm", help="Thinnest wall that the mold casts.")
    ] = 0.2,
    tolerance: Annotated[
        float, typer.Option("--tolerance-mm", help="± of the wall, at two deviations.")
    ] = 0.05,
    plot: Annotated[Path | None, typer.Option(help="Force–stroke curve to write, SVG.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Design the threshold switch: a soft bowl that snaps at the asked force."""
    from phytac_design.design_file import load_design
    from phytac_design.mechanics.switch.design import design_switch
    from phytac_design.mechanics.switch.receptor import chosen_rubber, space_of
    from phytac_design.mechanics.switch.report import (
        curve_plot,
        switch_dict,
        switch_text,
        warnings,
    )
    from phytac_design.mechanics.switch.space import Tolerance
    from phytac_design.mechanics.switch.svg import check_svg, write_svg

    if plot:
        check_svg(plot)
    loaded = load_design(design)
    made = design_switch(
        loaded.switch.threshold_N if threshold is None else threshold,
        chosen_rubber(material, modulus_MPa=modulus, test=test, law=law),
        space_of(loaded, wall_min_mm=wall_min),
        Tolerance(thickness_mm=tolerance),
    )
    if plot:
        say(f"wrote {write_svg(plot, curve_plot(made))}")
    minded = warnings(made, printed_wall_mm=loaded.print_rules.wall_min_mm)
    if as_json:
        plain = switch_dict(made) | {"design": loaded.name, "warnings": minded}
        typer.echo(json.dumps(plain, indent=1, ensure_ascii=False))
        return
    for warning in minded:
        say(f"warning: {warning}")
    typer.echo(switch_text(made))
