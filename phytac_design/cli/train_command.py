"""The commands that train, evaluate and export decoders."""

from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, SeedOption, check_out, say
from phytac_design.cli.output import next_step, print_json

DataArgument = Annotated[
    list[Path], typer.Argument(help="Data sets of `phytac simulate` or `phytac import`.")
]


def train(
    design: DesignArgument,
    data: DataArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out,
            help="The decoder's own folder; exports/NAME/decoder-trained if not given.",
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="Number of samples to use, from the first; all if not given."),
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option(help="Decoder of another sensor; training starts from its network weights."),
    ] = None,
    accuracy: Annotated[
        Preset, typer.Option(help="Preset for the decoder's own mechanics.")
    ] = "standard",
    seed: SeedOption = 0,
    force: Annotated[
        bool, typer.Option(help="Overwrite a folder that holds something else.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Train the decoder of a design from data sets."""
    from phytac_design.design.design_file import load_design
    from phytac_design.workflows.train_decoder import train as run

    loaded = load_design(design)
    out = out or Path("exports") / loaded.name / "decoder-trained"
    facts = run(
        loaded,
        data,
        out,
        samples=samples,
        seed=seed,
        start=start,
        accuracy=accuracy,
        force=force,
        progress=say,
    )
    if as_json:
        print_json({"out": str(out)} | facts)
        return
    parts = ", ".join(f"{count} {name}" for name, count in facts["samples"].items())
    typer.echo(f"{out}: {parts} samples")
    for name, trainer in facts["trainers"].items():
        typer.echo(f"  {name:16s} trained in {trainer['seconds']:.1f} s")
    for name, score in (facts["test"] or {}).items():
        typer.echo(
            f"  {name:16s} test part: relative error {100.0 * score['relative_error']:.1f} %, "
            f"absolute error {score['absolute_error_mean_N']:.3f} N, {score['contacts']} contacts"
        )
    if facts["test"]:
        errors = {name: score["relative_error"] for name, score in facts["test"].items()}
        counts = [score["contacts"] for score in facts["test"].values()]
        typer.echo(_verdict(errors, min(counts)))
    next_step(f"phytac evaluate {out} DATA, with data that it was not trained on")


def evaluate(
    bundle: Annotated[
        Path, typer.Argument(help="Folder of a decoder, such as exports/NAME/decoder.")
    ],
    data: DataArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out, help="The result's own folder; next to the decoder if not given."
        ),
    ] = None,
    design: Annotated[
        str | None,
        typer.Option(
            help="Design of the decoder, for heights and sides; searched for if not given."
        ),
    ] = None,
    seed: SeedOption = 0,
    force: Annotated[
        bool, typer.Option(help="Overwrite a folder that holds something else.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Evaluate every estimator of a decoder on data sets: tables, contacts, figures."""
    from phytac_design.training.evaluation.interval_scores import intervals_text
    from phytac_design.workflows.evaluate_decoder import evaluate as run

    folder = bundle.resolve()
    out = out or folder.with_name(f"{folder.name}-evaluation")
    facts = run(
        bundle,
        data,
        out,
        design=design,
        seed=seed,
        force=force,
        progress=say,
    )
    if as_json:
        print_json({"out": str(out)} | facts)
        return
    typer.echo(
        f"{out}: {facts['contacts']['judged']} contacts in {facts['samples']['judged']} "
        f"samples; {facts['contacts']['tripped_none']} tripped no switch, "
        f"{facts['samples']['failed']} samples failed"
    )
    for name, sections in facts["estimators"].items():
        score = sections["all"]["all"]
        relative, absolute = score["relative_error"], score["absolute_error_mean_N"]
        typer.echo(
            f"  {name:16s} relative error {100.0 * relative['value']:6.2f} % "
            f"{_interval(relative, 100.0, 2)}, absolute error {absolute['value']:.3f} N "
            f"{_interval(absolute, 1.0, 3)}"
        )
    errors = {
        name: sections["all"]["all"]["relative_error"]["value"]
        for name, sections in facts["estimators"].items()
    }
    typer.echo(_verdict(errors, facts["contacts"]["judged"]))
    if facts["intervals"]:
        typer.echo(intervals_text(facts["intervals"]))
    next_step(
        f"phytac live {bundle} 0 shows forces of a camera; every table is in {out / 'tables.md'}"
    )


def _verdict(relative: dict[str, float | None], contacts: int) -> str:
    """The best estimator, against the published sensor, and whether its contacts are enough."""
    contacts_min = 100  # a mean of 100 errors is known to a tenth of their standard deviation
    known = {
        name: value for name, value in relative.items() if value is not None and isfinite(value)
    }
    if not known:
        return "no estimator has an error: no held-out contact turned a switch on"
    best = min(known, key=known.__getitem__)
    few = ""
    if contacts < contacts_min:
        few = f"; {contacts} contacts are few, {contacts_min} or more give a figure to rely on"
    return (
        f"best estimator: {best}, relative error {100.0 * known[best]:.2f} % (the published "
        f"sensor has 2.3 %) on these data; a build evaluates its own contacts{few}"
    )


def _interval(measure: dict[str, Any], factor: float, digits: int) -> str:
    if measure["low"] is None:
        return "[too few samples for an interval]"
    return f"[{factor * measure['low']:.{digits}f}, {factor * measure['high']:.{digits}f}]"


def export_onnx(
    bundle: Annotated[
        Path, typer.Argument(help="Folder of a decoder, such as exports/NAME/decoder.")
    ],
    out: Annotated[Path, typer.Argument(help="File to write, such as network.onnx.")],
    estimator: Annotated[
        str, typer.Option(help="Estimator whose network is written: fem_nn or fem_nn_identity.")
    ] = "fem_nn",
    as_json: JsonOption = False,
) -> None:
    """Write a decoder's network as ONNX, and check that it equals the decoder's own."""
    from phytac_design.training.onnx_export import INPUT, OPSET, OUTPUT
    from phytac_design.training.onnx_export import export_onnx as run
    from phytac_shapes.errors import InputError

    if out.suffix.lower() != ".onnx":
        raise InputError(
            "file-ending", f"a network is written as ONNX (got {out.name}); end its name in .onnx"
        )
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
