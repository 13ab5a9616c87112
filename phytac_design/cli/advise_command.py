"""``phytac advise``: what to change about a design."""

import json
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, SeedOption, say


def advise(
    design: DesignArgument,
    accuracy: Annotated[Preset, typer.Option(help="Fineness of mechanics.")] = Preset.draft,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a setting of the preset: refine=5. As often as asked."),
    ] = None,
    only: Annotated[
        str,
        typer.Option(help="Fields (wall.thickness_mm), tables (layout) or rows, comma separated."),
    ] = "",
    checks: Annotated[
        int, typer.Option(min=0, help="Changes that are applied and judged at most.")
    ] = 5,
    polish: Annotated[
        bool, typer.Option(help="Go on along what helps, until no step gains 1 %.")
    ] = False,
    rounds: Annotated[int, typer.Option(min=1, help="Steps of --polish at most.")] = 6,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for advice.json and the changed designs; none if not given."),
    ] = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Say what to change about a design; each piece of advice is applied and judged first.

    What was judged once is kept in the cache: a command that was stopped goes on where it was.
    """
    from phytac_design.core.json_values import finite
    from phytac_design.design.accuracy import settings_of, with_settings
    from phytac_design.design.design_file import load_design
    from phytac_design.study.advice.advice_report import as_dict, polish_text, polished_dict, text
    from phytac_design.study.advice.advise import advise as run
    from phytac_design.study.advice.files import write_advice, write_polished
    from phytac_design.study.advice.refinement import refine as improve

    loaded = load_design(design)
    chosen = with_settings(settings_of(accuracy.value), settings or [])
    names = [name.strip() for name in only.split(",") if name.strip()]
    try:
        if polish:
            done = improve(loaded, chosen, only=names, rounds=rounds, seed=seed, progress=say)
            facts, words = polished_dict(done), polish_text(done)
            path = write_polished(done, out or Path("exports") / f"{loaded.name}-polished")
            words += f"\nwritten to {path}"
        else:
            found = run(loaded, chosen, only=names, checks=checks, seed=seed, progress=say)
            facts, words = as_dict(found), text(found)
            if out:
                words += f"\nwritten to {write_advice(found, out)}"
    except KeyboardInterrupt:
        say("stopped; run the same command again to go on where it was")
        raise typer.Exit(130) from None
    typer.echo(json.dumps(finite(facts), indent=1, ensure_ascii=False) if as_json else words)
