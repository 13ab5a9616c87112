"""``phytac build``: everything of a design, or what a scene, a tolerance or a budget asks for."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from phytac_design.cli.options import (
    JsonOption,
    Preset,
    SeedOption,
    check_out,
    complete_design,
)
from phytac_design.cli.output import names_of, next_step, print_json, resumable
from phytac_shapes.errors import DesignError


def build(
    design: Annotated[
        str,
        typer.Argument(
            help="A shipped design or the path of a file; omit it with --from-study.",
            autocompletion=complete_design,
        ),
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option(callback=check_out, help="The build's own folder; exports/NAME if not given."),
    ] = None,
    accuracy: Annotated[
        Preset | None,
        typer.Option(help="Preset, a trade of speed against accuracy; standard if not given."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="Change one setting of the preset, such as refine=5. May be repeated."
        ),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(help="Use the cheapest settings with at most this error, such as 2%."),
    ] = None,
    tolerance_of: Annotated[
        str, typer.Option(help="Quantity that --tolerance limits: force, visibility or volume.")
    ] = "force",
    budget: Annotated[
        str | None,
        typer.Option(
            help="Use the finest settings that take at most this time, such as 60s or 5min."
        ),
    ] = None,
    scene: Annotated[
        str, typer.Option(help="Build only what a scene requires; see phytac plan.")
    ] = "",
    only: Annotated[
        str, typer.Option(help="Stages to run, comma separated; the stages that they need run too.")
    ] = "",
    from_study: Annotated[
        Path | None, typer.Option(help="Folder of a study; one of its candidates is built.")
    ] = None,
    trial: Annotated[
        int | None, typer.Option(help="Number of the candidate of --from-study.", min=0)
    ] = None,
    seed: SeedOption = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Processes that run stages in parallel; one for each core if not given.", min=1
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            help="Overwrite another design's folder, and continue although markers hide or fuse."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Build everything of a design: shell, views, mesh, decoder, report."""
    from phytac_design.core.threads import workers as usable_cores
    from phytac_design.core.workers import import_ahead

    _refuse_both(
        {
            "--accuracy or --set": accuracy is not None or bool(settings),
            "--tolerance": tolerance is not None,
            "--budget": budget is not None,
        }
    )
    within = tolerance is not None or budget is not None
    _refuse_both({"--scene": bool(scene), "--only": bool(only), "--tolerance or --budget": within})
    _refuse_both({"--workers": workers is not None, "--scene": bool(scene), "--tolerance": within})
    if bool(design) == (from_study is not None) or (from_study is None) != (trial is None):
        raise DesignError(
            "design-argument-missing",
            "give a design to build, as in: phytac build cylinder60; or a study's candidate, as "
            "in: phytac build --from-study FOLDER --trial 42",
        )
    if not within and not scene and (workers or usable_cores()) > 1:
        import_ahead("phytac_design.stages.build")
    from phytac_design.design.accuracy import settings_of, with_settings
    from phytac_design.design.design_file import load_design
    from phytac_design.design.spec import Design
    from phytac_design.stages.build import build as run_build
    from phytac_design.stages.build import with_named

    loaded: Design
    if from_study is not None and trial is not None:
        from phytac_design.study.search.study_folder import rebuild

        loaded = rebuild(from_study, trial)
    else:
        loaded = load_design(design)
    target = out or Path("exports") / (f"{loaded.name}-{scene}" if scene else loaded.name)
    names = names_of(only)
    chosen = with_settings(settings_of(accuracy or "standard"), settings or [])
    with resumable():
        if within:
            from phytac_design.cli.tradeoff_command import build_within

            build_within(
                loaded,
                target,
                tolerance=tolerance,
                tolerance_of=tolerance_of,
                budget=budget,
                seed=seed,
                force=force,
                as_json=as_json,
            )
            return
        if scene:
            from phytac_design.cli.plan_command import build_scene

            build_scene(
                loaded, scene, target, accuracy=chosen, seed=seed, force=force, as_json=as_json
            )
            return
        from phytac_design.cli.build_display import BuildDisplay
        from phytac_design.study.planning.cost import stage_costs

        with BuildDisplay() as display:
            result = run_build(
                loaded,
                target,
                accuracy=chosen,
                only=names or None,
                seed=seed,
                force=force,
                progress=display,
                workers=workers or usable_cores(),
                costs=partial(stage_costs, loaded, with_named(chosen, names)),
            )
    if as_json:
        summary = {
            "out": str(result.out),
            "ran": list(result.ran),
            "cached": list(result.cached),
            "seconds": round(result.seconds, 3),
            "timing_s": result.timing_s,
        }
        print_json(summary)
        return
    typer.echo(
        f"{target}: {len(result.ran)} stages run, {len(result.cached)} from the cache, "
        f"{result.seconds:.1f} s"
    )
    page = target / "report" / "report.html"
    if "report" not in {*result.ran, *result.cached}:
        next_step(f"phytac build {design or target / 'design.toml'} makes the other parts as well")
        return
    report = json.loads((page.parent / "report.json").read_text(encoding="utf-8"))
    typer.echo(_verdict(report, loaded.training.force_max_N))
    linear = [text for text in report["limits"] if text.startswith("linear-tables")]
    for text in (*linear, *report["changes"]):
        typer.echo(f"to change or to mind: {text}")
    typer.echo(f"open {page}")
    rest = target / "views" / "frame_rest.png"
    next_step(
        f"phytac decode {target / 'decoder'} {target / 'views' / 'frame_pressed.png'} --rest {rest}"
    )


def _verdict(report: dict[str, Any], force_N: float) -> str:
    """Figures that decide whether a sensor is good, each with what it needs.

    The bound is that of the design's greatest force ``force_N``.
    """
    from phytac_design.optics.loaded_visibility import FUSED_PX
    from phytac_design.report.verdict import decoded

    seen = report["visibility"]
    bound = report["resolution"]["bound"][f"{force_N:g} N"]
    return (
        f"{report['markers']['count']} markers: {seen['occluded']} hidden, {seen['fused']} fused "
        f"(must be 0), smallest gap of one colour {seen['min_gap_px']:.1f} px (needs more than "
        f"{FUSED_PX:g}). {report['under_load']['sentence']} {force_N:g} N has at best a standard "
        f"deviation of {bound['force_N_median']:.2f} N (median over the receptors; less is "
        f"better). {decoded(report)}"
    )


def _refuse_both(given: dict[str, bool]) -> None:
    """Say which two of several options that exclude each other were given."""
    names = [name for name, is_given in given.items() if is_given]
    if len(names) > 1:
        raise DesignError(
            "options-exclusive", f"{names[0]} and {names[1]} exclude each other; give one of them"
        )
