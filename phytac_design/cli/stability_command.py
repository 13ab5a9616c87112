"""The command ``phytac stability``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import JsonOption, SeedOption, say

WRONG = 1
"""Exit code where a case is wrong."""


def stability(
    room: Annotated[str, typer.Option(help="One room only, e.g. shell; all if not given.")] = "",
    shape: Annotated[str, typer.Option(help="One surface family only.")] = "",
    cases: Annotated[
        int | None,
        typer.Option(min=1, help="So many cases: fewer than there are, or more, drawn at random."),
    ] = None,
    seed: SeedOption = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the journal (to go on after a stop) and JSON.")
    ] = None,
    table: Annotated[Path | None, typer.Option(help="Write the page on stability here.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Try every room at its extremes: each case right, refused in words, or wrong."""
    from phytac_design.study.stability.run import choose, run
    from phytac_design.study.stability.table import page
    from phytac_shapes.errors import OutputError

    chosen = choose(room=room, shape=shape, count=cases, seed=seed)
    report = run(chosen, workers=workers, seed=seed, out=out, progress=say)
    if table:
        try:
            table.write_text(page(report), encoding="utf-8")
        except OSError as error:
            raise OutputError(
                f"cannot write {table}: {error.strerror}; choose another file"
            ) from None
    if as_json:
        from phytac_design.core.json_values import finite

        typer.echo(json.dumps(finite(report.plain()), indent=1, ensure_ascii=False))
    else:
        typer.echo(f"{'room':16s} {'cases':>6s} {'right':>6s} {'refused':>8s} {'wrong':>6s}")
        for name, row in report.counts().items():
            typer.echo(
                f"{name:16s} {sum(row.values()):6d} {row['right']:6d} {row['refused']:8d} "
                f"{row['wrong']:6d}"
            )
        for outcome in report.wrong:
            typer.echo(f"wrong: {outcome.room}: {outcome.name}: {outcome.why}")
        typer.echo(f"{len(report.outcomes)} cases in {report.seconds:.0f} s")
    if report.wrong:
        raise typer.Exit(WRONG)
