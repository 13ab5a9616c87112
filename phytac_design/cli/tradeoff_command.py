"""``phytac tradeoff``, and the options ``--tolerance`` and ``--budget`` of ``phytac build``."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, check_out, say
from phytac_design.cli.output import names_of, print_json, resumable

if TYPE_CHECKING:
    from phytac_design.design.spec import Design


def tradeoff(
    design: DesignArgument,
    only: Annotated[
        str,
        typer.Option(
            help="Settings, comma separated, or `joint` for the whole build; all if not given."
        ),
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out, help="The result's own folder; exports/NAME-tradeoff if not given."
        ),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Measure only few joint settings.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure time, memory and error of every setting, and the fronts of the whole build.

    The same command resumes an interrupted run.
    """
    from phytac_design.design.design_file import load_design
    from phytac_design.study.tradeoff.run_tradeoff import tradeoff as run

    loaded = load_design(design)
    target = out or Path("exports") / f"{loaded.name}-tradeoff"
    names = names_of(only)
    with resumable():
        done = run(loaded, target, only=names, quick=quick, progress=say)
    if as_json:
        print_json(done.as_dict())
        return
    typer.echo(done.text())
    typer.echo(f"written to {target}")


def build_within(
    design: "Design",
    out: Path,
    *,
    tolerance: str | None,
    tolerance_of: str,
    budget: str | None,
    seed: int,
    force: bool,
    as_json: bool = False,
) -> None:
    """Build to a tolerance (``2%``) or within a time (``60s``); print prediction and result.

    ``tolerance_of`` is ``force``, ``visibility`` or ``volume``; ``as_json`` prints
    ``report/trade.json``; the other arguments are those of ``phytac build``.
    """
    from typing import get_args

    from phytac_design.study.tradeoff.build_to import (
        AUDIT,
        audit_lines,
        build_to,
        read_seconds,
        read_tolerance,
    )
    from phytac_design.study.tradeoff.settings import Quantity
    from phytac_shapes.errors import DesignError

    known = {name: name for name in get_args(Quantity) if name != "score"}
    if tolerance_of not in known:
        raise DesignError(
            "tolerance-kind-unknown",
            f"--tolerance-of {tolerance_of!r} is not known; choose of {', '.join(known)}",
        )
    result, choice = build_to(
        design,
        out,
        tolerance=None if tolerance is None else read_tolerance(tolerance),
        of=known[tolerance_of],
        budget_s=None if budget is None else read_seconds(budget),
        seed=seed,
        force=force,
        progress=say,
    )
    if as_json:
        typer.echo((out / AUDIT).read_text(encoding="utf-8").rstrip())
        return
    typer.echo(f"{result.out}: {result.seconds:.0f} s, {len(result.ran)} stages ran")
    for line in audit_lines(choice, result.seconds):
        typer.echo(f"  {line}")
    page = out / "report" / "report.json"
    for text in json.loads(page.read_text(encoding="utf-8"))["changes"]:
        typer.echo(f"to change or to mind: {text}")
