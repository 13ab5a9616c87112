"""``phytac plan``: the stages that a scene requires, their cost, and their build."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, Preset, SeedOption, check_out, say
from phytac_design.cli.output import print_json

if TYPE_CHECKING:
    from phytac_design.design.accuracy import Accuracy
    from phytac_design.design.spec import Design
    from phytac_design.study.planning.plan import BuildPlan


def plan(
    design: DesignArgument,
    scene: Annotated[
        str, typer.Argument(help="A shipped scene or a file: fingertip, grip5, occlusion, …")
    ] = "",
    accuracy: Annotated[
        Preset, typer.Option(help="Preset whose settings the scene starts from.")
    ] = "standard",
    build: Annotated[
        bool, typer.Option("--build", help="Build the plan, and compare it with the result.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            callback=check_out, help="The build's own folder; exports/NAME-SCENE if not given."
        ),
    ] = None,
    audit: Annotated[
        bool, typer.Option(help="After the build, measure the force error with simulated presses.")
    ] = True,
    seed: SeedOption = 0,
    force: Annotated[bool, typer.Option(help="Overwrite another design's folder.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show what a scene models of a design, at which resolution, for which reason and cost."""
    from phytac_design.design.accuracy import PRESETS
    from phytac_design.design.design_file import load_design
    from phytac_design.design.scene import Scene, load_scene
    from phytac_design.rules.check import check_design
    from phytac_design.study.planning.plan import plan_scene
    from phytac_design.study.planning.run_plan import run_plan

    loaded = load_design(design)
    everything = Scene(name="everything", outputs=("report",))
    wanted = load_scene(scene) if scene else everything
    check_design(loaded)
    made = plan_scene(loaded, wanted, accuracy=PRESETS[accuracy], seed=seed)
    if not as_json:
        print_plan(made)
    report: dict[str, Any] = made.as_dict()
    if build:
        target = out or Path("exports") / f"{loaded.name}-{wanted.name}"
        built, found = run_plan(made, target, seed=seed, force=force, errors=audit, progress=say)
        report |= {"out": str(built.out), "ran": list(built.ran), "audit": found}
        if not as_json:
            print_audit(found, target)
    if as_json:
        print_json(report)


def build_scene(
    design: "Design",
    scene: str,
    out: Path,
    *,
    accuracy: "Accuracy",
    seed: int,
    force: bool,
    as_json: bool,
) -> None:
    """Build what a scene requires, as ``phytac build --scene`` does, and audit the plan."""
    from phytac_design.design.scene import load_scene
    from phytac_design.study.planning.plan import plan_scene
    from phytac_design.study.planning.run_plan import run_plan

    made = plan_scene(design, load_scene(scene), accuracy=accuracy, seed=seed)
    built, audit = run_plan(made, out, seed=seed, force=force, progress=say)
    if as_json:
        report = made.as_dict() | {"out": str(out), "ran": list(built.ran), "audit": audit}
        print_json(report)
        return
    print_audit(audit, out)


def print_plan(made: "BuildPlan") -> None:
    """Print a plan as a table."""
    scene = made.resolved.scene
    typer.echo(f"{made.resolved.design.name}, scene {scene.name}: {scene.description}".rstrip(": "))
    for name, reason in made.resolved.why.items():
        typer.echo(f"  {name}: {reason}")
    for row in made.rows:
        cost = "-" if row.action == "cached" else f"{row.seconds:.1f} s"
        memory = "-" if row.action == "cached" else f"{row.memory_MB:.0f} MB"
        sign = {"run": "run     ", "cached": "cached  ", "left out": "left out"}[row.action]
        saved = "saves " if row.action == "left out" else ""
        typer.echo(f"  {row.stage:10s} {sign} {saved + cost:>13s} {memory:>8s}  {row.why}")
        if row.how:
            typer.echo(f"{'':14s}{row.how}")
        if row.loses:
            typer.echo(f"{'':14s}costs: {row.loses}")
    typer.echo(
        f"predicted: {made.seconds:.1f} s of one core and {made.memory_MB:.0f} MB; the whole "
        f"sensor {made.whole_seconds:.1f} s and {made.whole_memory_MB:.0f} MB"
    )
    if made.error:
        parts = ", ".join(
            f"{name} {100.0 * value:.2g} %" for name, value in made.error.items() if name != "force"
        )
        typer.echo(
            f"predicted error of a force: {100.0 * made.error['force']:.2g} % ({parts}), without "
            f"noise and print scatter; allowed {100.0 * scene.error_allowed:g} %"
        )
        if made.error["force"] > scene.error_allowed:
            fix = "take a finer --accuracy, or allow more"
            if made.error.get("flat wall", 0.0) > scene.error_allowed:
                fix = "allow more: finer settings do not help on flat walls"
            say(f"warning: more than the scene allows; {fix}")


def print_audit(done: dict[str, Any], out: Path) -> None:
    """Print predicted and actual cost and error."""
    typer.echo(f"{out}: plan audited")
    for name, item in done["stages"].items():
        typer.echo(
            f"  {name:10s} predicted {item['predicted_s']:6.1f} s  wall {item['wall_s']:6.1f} s"
        )
    for name, unit in (("seconds", "s"), ("memory_MB", "MB")):
        item = done[name]
        typer.echo(
            f"  {name:10s} predicted {item['predicted']:6.1f} {unit}  "
            f"actual {item['actual']:6.1f} {unit}"
        )
    if "error" in done and done["error"]["actual"] is not None:
        item = done["error"]
        typer.echo(
            f"  error of a force: predicted {100.0 * item['predicted']:.2g} %, median of "
            f"{item['presses']} presses {100.0 * item['actual']:.2g} %, worst "
            f"{100.0 * item['worst']:.2g} %, allowed {100.0 * item['allowed']:g} %"
        )
        if item["worst"] > max(item["predicted"], item["allowed"]):
            say(
                "warning: the worst press is further off than was predicted, and than the scene "
                "allows. Where markers hardly determine a force, as near rims, the prediction is "
                "too small: rely on the interval that the decoder gives with each force"
            )
