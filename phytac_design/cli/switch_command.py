"""The command of the threshold switch."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.output import print_json


def switch(
    design: Annotated[
        str, typer.Argument(help="A shipped design or the path of a file.")
    ] = "cylinder60",
    threshold: Annotated[
        float | None, typer.Option("--threshold-N", help="Threshold, N; the design's if not given.")
    ] = None,
    material: Annotated[
        str | None,
        typer.Option(help="Rubber: tpu-8400n or silicone-a30; the design's if not given."),
    ] = None,
    modulus: Annotated[
        float | None, typer.Option("--modulus-MPa", help="Young's modulus of the rubber.")
    ] = None,
    test: Annotated[
        Path | None, typer.Option(help="CSV of a tensile test (stretch, stress_MPa) to fit.")
    ] = None,
    law: Annotated[str, typer.Option(help="For --test: neo-hookean, yeoh or ogden.")] = "yeoh",
    wall_min: Annotated[
        float | None, typer.Option("--wall-min-mm", help="Thinnest wall that the mold casts.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance-mm", help="± of the wall, at two deviations.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Force–stroke curve to write, SVG.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Design the threshold switch: a soft bowl that snaps at the given force.

    Missing options come from the switch table of the design.
    """
    from phytac_design.design.design_file import load_design
    from phytac_design.mechanics.switch.design import design_switch
    from phytac_design.mechanics.switch.line_plot import check_svg, write_svg
    from phytac_design.mechanics.switch.switch_inputs import chosen_rubber, rubber_of, space_of
    from phytac_design.mechanics.switch.switch_report import (
        curve_plot,
        switch_dict,
        switch_text,
        warnings,
    )
    from phytac_design.mechanics.switch.switch_space import Tolerance

    if plot:
        check_svg(plot)
    loaded = load_design(design)
    own = loaded.switch
    if material is None and modulus is None and test is None:
        chosen = rubber_of(loaded)
    else:
        chosen = chosen_rubber(material or own.material, modulus_MPa=modulus, test=test, law=law)
    made = design_switch(
        own.threshold_N if threshold is None else threshold,
        chosen,
        space_of(loaded, wall_min_mm=wall_min),
        Tolerance(
            thickness_mm=own.wall_tolerance_mm if tolerance is None else tolerance,
            modulus=own.modulus_tolerance,
        ),
    )
    if plot:
        say(f"wrote {write_svg(plot, curve_plot(made))}")
    minded = warnings(made)
    others = sorted({region.threshold_N for region in own.regions} - {made.threshold_N})
    if threshold is None and others:
        more = ", ".join(f"{other:g}" for other in others)
        minded.append(f"this design also has regions with {more} N: see --threshold-N")
    if as_json:
        plain = switch_dict(made) | {"design": loaded.name, "warnings": minded}
        print_json(plain)
        return
    for warning in minded:
        say(f"warning: {warning}")
    typer.echo(switch_text(made))
