"""The commands of the virtual sensor."""

import os
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, SeedOption, check_out, say
from phytac_design.cli.output import next_step, print_json, resumable
from phytac_shapes.errors import DesignError

if TYPE_CHECKING:
    from phytac_design.design.spec import Design

Route = Literal["points", "frames"]
Displacement = Literal["auto", "linear", "large"]


Keep = Literal["inputs", "points", "frames"]
TRAIN_SAMPLES = 30
"""Samples from which on training is proposed: with a dozen it is refused."""


def simulate(
    design: DesignArgument,
    scenario: Annotated[
        str, typer.Argument(help="A shipped scenario (see `phytac scenarios`) or a file's path.")
    ] = "platform",
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out,
            help="The data set's own folder; exports/DESIGN-SCENARIO if not given.",
        ),
    ] = None,
    accuracy: Annotated[
        Preset, typer.Option(help="Preset for the mesh of the simulated wall.")
    ] = "standard",
    route: Annotated[
        Route | None,
        typer.Option(help="Projected points or rendered frames; as in the scenario if not given."),
    ] = None,
    displacement: Annotated[
        Displacement | None,
        typer.Option(help="Theory of the wall; as in the scenario if not given."),
    ] = None,
    keep: Annotated[
        Keep,
        typer.Option(
            help="What to keep: inputs of the network, points (all markers), or frames as well."
        ),
    ] = "points",
    unit: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="0: the design itself; k: the k-th virtual print; as in the scenario by default.",
        ),
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Number of samples; as in the scenario if not given.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes; one for each core if not given.")
    ] = None,
    seed: SeedOption = 0,
    force: Annotated[bool, typer.Option(help="Replace what the folder holds.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a scenario on a virtual sensor: a data set to train and evaluate decoders.

    A run that was stopped or killed resumes when the same command is run again.
    """
    from phytac_design.design.design_file import load_design
    from phytac_design.simulation.run.job import Job
    from phytac_design.simulation.scenario.scenario_file import load_scenario, parse_scenario
    from phytac_design.workflows.simulate import simulate as run

    loaded, wanted = load_design(design), load_scenario(scenario)
    if samples is not None and wanted.kind == "cycles":
        raise DesignError(
            "samples-of-cycles",
            f"--samples does not go with {wanted.name}, a scenario of cycles; set cycle.count and "
            "cycle.every in its file",
        )
    data = wanted.model_dump(mode="json", exclude_unset=True)
    for table, key, value in (
        ("solve", "route", route),
        ("solve", "displacement", displacement),
        ("unit", "number", unit),
        ("touch", "samples", samples),
    ):
        if value is not None:
            data.setdefault(table, {})[key] = value
    job = Job(
        design=loaded,
        scenario=parse_scenario(data, scenario),
        seed=seed,
        accuracy=accuracy,
        keep=keep,
    )
    target = out or Path("exports") / f"{loaded.name}-{wanted.name}"
    count = workers or len(os.sched_getaffinity(0))
    with resumable():
        done = run(job, target, workers=count, force=force, progress=say)
    if as_json:
        summary = asdict(done) | {"out": str(done.out), "seconds": round(done.seconds, 3)}
        print_json(summary)
        return
    statuses = ", ".join(f"{number} {name}" for name, number in done.statuses.items() if number)
    theories = ", ".join(f"{number} {name}" for name, number in done.theories.items() if number)
    typer.echo(f"{done.out}: {done.samples} samples ({statuses}; {theories}), {done.seconds:.0f} s")
    reasons = Counter(done.reasons).most_common()
    for reason, number in reasons[:5]:
        typer.echo(f"  {number} sample{'' if number == 1 else 's'}: {reason}")
    if len(reasons) > 5:
        typer.echo(f"  and {len(reasons) - 5} other reasons")
    if keep == "frames":
        _say_frames(loaded, done.out)
    if loaded.has_switches and done.samples >= TRAIN_SAMPLES:
        next_step(f"phytac train {design} {done.out}")
    else:
        next_step(f"phytac evaluate DECODER {done.out}, with the decoder of a build of this design")


def scenarios(as_json: JsonOption = False) -> None:
    """List the shipped scenarios."""
    from phytac_design.simulation.scenario.scenario_file import load_scenario, shipped_scenarios

    known = {name: load_scenario(name).description for name in shipped_scenarios()}
    if as_json:
        print_json(known)
        return
    for name, description in known.items():
        typer.echo(f"{name:10s} {description}")


def _say_frames(design: "Design", out: Path) -> None:
    """Where the true forces of kept frames are, and how to decode the frames."""
    import shlex

    from phytac_decoder.io.bundle import load_bundle
    from phytac_design.design.design_file import design_hash
    from phytac_design.workflows.simulate import TRUTH
    from phytac_shapes.errors import InputError

    typer.echo(f"true forces of the frames are in {out / TRUTH}")
    if design.camera.ends == "both":
        return
    decoder = f"exports/{design.name}/decoder"
    try:
        mine = load_bundle(Path(decoder)).design_hash == design_hash(design)
    except InputError:
        mine = False
    rest = shlex.join([str(out / "frames"), "--rest", str(out / "rest.png")])
    if mine:
        next_step(f"phytac decode {shlex.quote(decoder)} {rest}")
    else:
        next_step(f"phytac decode DECODER {rest}, with the decoder of a build of this design")
