"""``phytac advise``: what to change about a design."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, SeedOption, check_out, say
from phytac_design.cli.output import names_of, next_step, print_json, resumable


def advise(
    design: DesignArgument,
    accuracy: Annotated[Preset, typer.Option(help="Preset for the mechanics.")] = "draft",
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Change one setting of the preset, such as refine=5. May be repeated."
        ),
    ] = None,
    only: Annotated[
        str,
        typer.Option(
            help="What may change: fields (wall.thickness_mm), tables (layout), rows; with commas."
        ),
    ] = "",
    checks: Annotated[
        int, typer.Option(min=0, help="Largest number of changes that are applied and evaluated.")
    ] = 5,
    polish: Annotated[
        bool, typer.Option(help="Refine the design until no step gains 1 %.")
    ] = False,
    rounds: Annotated[int, typer.Option(min=1, help="Largest number of steps of --polish.")] = 6,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out,
            help="Folder for advice.json and the changed designs; nothing is written if not given.",
        ),
    ] = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Suggest changes to a design; each one is applied and evaluated first.

    Evaluations are cached: a command that was stopped resumes where it was.
    """
    from phytac_design.design.accuracy import settings_of, with_settings
    from phytac_design.design.design_file import load_design
    from phytac_design.study.advice import advice_report as report
    from phytac_design.study.advice import advise as advising
    from phytac_design.study.advice import refinement as polishing

    loaded = load_design(design)
    chosen = with_settings(settings_of(accuracy), settings or [])
    names = names_of(only)
    with resumable():
        if polish:
            done = polishing.refine(
                loaded, chosen, only=names, rounds=rounds, seed=seed, progress=say
            )
            facts, text = report.refined_dict(done), report.refined_text(done)
            path = report.write_refined(done, out or Path("exports") / f"{loaded.name}-polished")
            text, after = f"{text}\nwritten to {path}", f"phytac check {path}"
        else:
            found = advising.advise(
                loaded, chosen, only=names, checks=checks, seed=seed, progress=say
            )
            facts, text = report.as_dict(found), report.text(found)
            if out:
                text += f"\nwritten to {report.write_advice(found, out)}"
            after = report.next_words(found, design, out)
    if as_json:
        print_json(facts)
        return
    typer.echo(text)
    next_step(after)
