"""The commands that search the design space."""

from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from phytac_design.cli.options import JsonOption, check_out, say
from phytac_design.cli.output import print_json, resumable

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from phytac_design.study.search.study_file import Budget

StudyArgument = Annotated[
    str, typer.Argument(help="A shipped study or the path of a study file.", show_default=False)
]
OutOption = Annotated[
    Path | None,
    typer.Option(callback=check_out, help="The study's own folder; studies/NAME if not given."),
]
WorkersOption = Annotated[
    int, typer.Option(min=0, help="Worker processes on this machine; 0 runs without any.")
]
SchedulerOption = Annotated[
    str, typer.Option(help="Address of a running Dask scheduler, such as tcp://host:8786.")
]
CandidatesOption = Annotated[
    int | None,
    typer.Option(min=1, help="Number of candidates, in place of the study's budget.candidates."),
]
SecondsOption = Annotated[
    float | None, typer.Option(min=0.0, help="Seconds, in place of the study's budget.seconds.")
]


REASONS = 3
"""Reasons for which candidates were dropped that are printed."""


def sweep(
    study: StudyArgument = "",
    out: OutOption = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = "",
    candidates: CandidatesOption = None,
    seconds: SecondsOption = None,
    measures: Annotated[
        bool, typer.Option("--measures", help="List the measures of studies, and exit.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Sample a design space evenly; without a study, list the shipped ones."""
    if measures:
        _list_measures(as_json=as_json)
        return
    if not study:
        _list_studies()
        return
    _run("sweep", study, out, workers, scheduler, candidates, seconds, "", as_json=as_json)


def optimise(
    study: StudyArgument = "",
    out: OutOption = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = "",
    candidates: CandidatesOption = None,
    seconds: SecondsOption = None,
    storage: Annotated[
        str,
        typer.Option(
            help="Database URL of Optuna's trials; a file in the study's folder if not given."
        ),
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Optimise a design over its variables; without a study, list the shipped ones."""
    if not study:
        _list_studies()
        return
    _run("optimise", study, out, workers, scheduler, candidates, seconds, storage, as_json=as_json)


def _run(
    kind: Literal["sweep", "optimise"],
    name: str,
    out: Path | None,
    workers: int,
    scheduler: str,
    candidates: int | None,
    seconds: float | None,
    storage: str,
    *,
    as_json: bool,
) -> None:
    from phytac_design.study.search.design_space import make_space
    from phytac_design.study.search.driver import run_study
    from phytac_design.study.search.search_report import read_results, summary, write_page
    from phytac_design.study.search.study_file import load_study
    from phytac_shapes.errors import DesignError

    study, folder = load_study(name)
    given = {"candidates": candidates, "seconds": seconds}
    budget = study.budget.model_copy(
        update={key: value for key, value in given.items() if value is not None}
    )
    study = study.model_copy(update={"budget": budget})
    if workers and scheduler:
        raise DesignError(
            "options-exclusive", "--workers and --scheduler exclude each other; omit one"
        )
    space = make_space(study, folder)
    where = out or Path("studies") / study.name
    with resumable(), _pool(workers, scheduler) as pool:
        done = run_study(study, space, where, kind=kind, pool=pool, storage=storage, progress=say)
    page = write_page(done.folder)
    figures = summary(read_results(done.folder))
    if as_json:
        facts = {"out": str(done.folder), "seconds": done.seconds, "new": done.new} | figures
        print_json(facts)
        return
    counts = ", ".join(f"{count} {status}" for status, count in figures["statuses"].items())
    typer.echo(
        f"{done.results}: {figures['candidates']} candidates ({counts}), {done.new} of them now "
        f"in {done.seconds:.0f} s; {page}"
    )
    if study.sampling.sweep == "sobol" or kind == "optimise":
        _say_budget(sum(figures["statuses"].values()), study.budget)
    for reason in figures["reasons"][:REASONS]:
        count = reason["count"]
        typer.echo(f"  {count} for a reason such as: {reason['example']}")
    others = len(figures["reasons"]) - REASONS
    if others > 0:
        typer.echo(f"  and {others} other reason{'' if others == 1 else 's'}")
    if not figures["statuses"].get("ok"):
        say(
            "warning: no candidate meets all rules and constraints; change the variables' ranges "
            "or the constraints (summary.json has all reasons)"
        )
    for row in figures["front"][:10]:
        values = ", ".join(
            f"{key} {value:.5g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in row.items()
            if key != "trial"
        )
        typer.echo(f"  trial {row['trial']}: {values}")
    if len(figures["front"]) > 10:
        typer.echo(f"  … and {len(figures['front']) - 10} more on the front")


def _say_budget(have: int, budget: "Budget") -> None:
    """Say how many candidates of the budget are left, or are more than it."""
    rest = budget.candidates - have
    if rest > 0 and budget.seconds:
        say(f"the time is up, {rest} of {budget.candidates} candidates are left; run it again")
    elif rest < 0:
        say(f"this study has {have} candidates already, more than the {budget.candidates} wanted")


def _pool(workers: int, scheduler: str) -> "AbstractContextManager[Any]":
    """Where candidates are evaluated."""
    if scheduler:
        from phytac_design.study.search.dask_pool import DaskPool

        return closing(DaskPool(scheduler, say=say))
    from phytac_design.study.search.process_pool import ProcessPool

    return closing(ProcessPool(workers)) if workers else nullcontext()


def _list_measures(*, as_json: bool) -> None:
    from dataclasses import asdict

    from phytac_design.study.search.measures import MEASURES

    if as_json:
        print_json([asdict(measure) for measure in MEASURES.values()])
        return
    for measure in MEASURES.values():
        unit = f" ({measure.unit})" if measure.unit else ""
        typer.echo(f"{measure.rung:10s} {measure.name:28s} {measure.doc}{unit}")


def _list_studies() -> None:
    from phytac_design.study.search.study_file import load_study, shipped_studies

    for name in shipped_studies():
        typer.echo(f"{name:24s} {load_study(name)[0].description}")
