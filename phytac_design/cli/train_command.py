"""The commands that train and judge decoders."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, SeedOption, say

DataArgument = Annotated[
    list[Path], typer.Argument(help="Data sets of `phytac simulate` or `phytac import`.")
]


def train(
    design: DesignArgument,
    data: DataArgument,
    out: Annotated[
        Path | None,
        typer.Option(help="The decoder's own folder; exports/NAME/decoder-trained if not given."),
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Learn from the first so many samples; all.")
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option(help="Another sensor's decoder, whose networks' weights are the start."),
    ] = None,
    accuracy: Annotated[
        Preset, typer.Option(help="Fineness of the decoder's own mechanics.")
    ] = Preset.standard,
    seed: SeedOption = 0,
    force: Annotated[bool, typer.Option(help="Take a folder that holds something else.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Train the decoder of a design from data sets."""
    from phytac_design.design.design_file import load_design
    from phytac_design.workflows.train_decoder import train as run

    loaded = load_design(design)
    done = run(
        loaded,
        data,
        out or Path("exports") / loaded.name / "decoder-trained",
        samples=samples,
        seed=seed,
        start=start,
        accuracy=accuracy.value,
        force=force,
        progress=say,
    )
    if as_json:
        _print_json({"out": str(done.out)} | done.facts)
        return
    parts = ", ".join(f"{count} {name}" for name, count in done.facts["samples"].items())
    typer.echo(f"{done.out}: {parts} samples")
    for name, facts in done.facts["trainers"].items():
        typer.echo(f"  {name:16s} trained in {facts['seconds']:.1f} s")
    for name, score in (done.facts["test"] or {}).items():
        typer.echo(
            f"  {name:16s} test part: relative error {100.0 * score['relative_error']:.1f} %, "
            f"absolute error {score['absolute_error_mean_N']:.3f} N, {score['contacts']} contacts"
        )


def evaluate(
    bundle: Annotated[Path, typer.Argument(help="Decoder folder, as in exports/NAME/decoder.")],
    data: DataArgument,
    out: Annotated[
        Path | None,
        typer.Option(help="The result's own folder; beside the decoder if not given."),
    ] = None,
    design: Annotated[
        str | None,
        typer.Option(help="The decoder's design, for heights and sides; looked for if not given."),
    ] = None,
    seed: SeedOption = 0,
    force: Annotated[bool, typer.Option(help="Take a folder that holds something else.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Judge every estimator of a decoder on data sets: tables, contacts, pictures."""
    from phytac_design.workflows.evaluate_decoder import evaluate as run

    folder = bundle.resolve()
    done = run(
        bundle,
        data,
        out or folder.with_name(f"{folder.name}-evaluation"),
        design=design,
        seed=seed,
        force=force,
        progress=say,
    )
    facts = done.facts
    if as_json:
        _print_json({"out": str(done.out)} | facts)
        return
    typer.echo(
        f"{done.out}: {facts['contacts']['judged']} contacts in {facts['samples']['judged']} "
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


def _interval(measure: dict[str, Any], factor: float, digits: int) -> str:
    if measure["low"] is None:
        return "[too few samples for an interval]"
    return f"[{factor * measure['low']:.{digits}f}, {factor * measure['high']:.{digits}f}]"


def _print_json(facts: dict[str, Any]) -> None:
    from phytac_design.core.json_values import finite

    typer.echo(json.dumps(finite(facts), indent=1, ensure_ascii=False))
