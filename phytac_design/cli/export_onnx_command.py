"""The command that exports a decoder's network."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import JsonOption
from phytac_design.cli.output import print_json


def export_onnx(
    bundle: Annotated[Path, typer.Argument(help="Decoder folder, as in exports/NAME/decoder.")],
    out: Annotated[Path, typer.Argument(help="File to write, such as network.onnx.")],
    estimator: Annotated[
        str, typer.Option(help="Whose network: fem_nn or fem_nn_identity.")
    ] = "fem_nn",
    as_json: JsonOption = False,
) -> None:
    """Write a decoder's network as ONNX, checked equal to the decoder's own."""
    from phytac_design.training.onnx_export import INPUT, OPSET, OUTPUT
    from phytac_design.training.onnx_export import export_onnx as run

    difference = run(bundle, out, estimator=estimator)
    if as_json:
        facts = {
            "out": str(out),
            "estimator": estimator,
            "input": INPUT,
            "output": OUTPUT,
            "opset": OPSET,
            "difference": difference,
        }
        print_json(facts)
        return
    typer.echo(
        f"{out}: network of {estimator}, {INPUT} to {OUTPUT}, opset {OPSET}; equal "
        f"to the decoder's within {difference:.1g} of the largest stiffness"
    )
