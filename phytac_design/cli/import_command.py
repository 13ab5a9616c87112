"""The command that reads a user's own rig."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, check_out, say
from phytac_design.cli.output import print_json
from phytac_design.cli.simulate_commands import Keep


def import_(
    design: DesignArgument,
    log: Annotated[Path, typer.Argument(help="CSV of contacts; see docs/datasets.md.")],
    frames: Annotated[
        list[Path],
        typer.Option(help="Folder of images, or a video; twice for two cameras, near end first."),
    ],
    bundle: Annotated[
        Path, typer.Option(help="Decoder of the design, such as exports/NAME/decoder.")
    ],
    out: Annotated[Path, typer.Option(callback=check_out, help="The data set's own folder.")],
    rest: Annotated[
        list[str] | None,
        typer.Option(help="The unloaded sensor: one of the frames (name or number) or a file."),
    ] = None,
    camera: Annotated[
        list[Path] | None,
        typer.Option(help="Lens calibration (OpenCV, ROS, Kalibr) to compare with the design's."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance-s",
            help="Largest time between a row and its frame, s; half a frame if not given.",
            min=0.0,
        ),
    ] = None,
    offset: Annotated[
        float, typer.Option("--offset-s", help="Seconds to add to the log's clock.")
    ] = 0.0,
    fps: Annotated[
        float | None,
        typer.Option(help="Frames a second, if neither file names nor video give it.", min=1e-6),
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(
            "--radius-mm", help="Radius of contacts that have none in the log, mm.", min=0.0
        ),
    ] = None,
    off: Annotated[
        float,
        typer.Option("--off-mm", help="Largest distance of a contact from the wall, mm.", min=0.0),
    ] = 2.0,
    keep: Annotated[
        Keep,
        typer.Option(
            help="What to keep: inputs of the network, points (all markers), or frames as well."
        ),
    ] = "points",
    skip_bad: Annotated[
        bool, typer.Option("--skip-bad", help="Leave samples with problems out.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Make a data set from your own rig: a log of contacts, and images or video."""
    from phytac_design.design.design_file import load_design
    from phytac_design.workflows.import_rig import ImportSettings, import_rig

    done = import_rig(
        load_design(design),
        log,
        frames=frames,
        bundle=bundle,
        out=out,
        rest=rest or [],
        cameras=camera or [],
        settings=ImportSettings(
            off_mm=off,
            tolerance_s=tolerance,
            offset_s=offset,
            fps=fps,
            radius_mm=radius,
            keep=keep,
            skip_bad=skip_bad,
        ),
        progress=say,
    )
    samples = done.samples
    flagged = int((samples.status > 0).sum())
    if done.left_out:
        say(f"left out: {done.problems.text()}")
    if as_json:
        summary = {
            "out": str(out),
            "samples": samples.count,
            "flagged": flagged,
            "contacts": int(samples.contacts.sum()),
            "left_out": done.left_out,
            "problems": [text for _, text in done.problems.found],
            "notes": done.meta.notes,
        }
        print_json(summary)
        return
    said = f", {done.left_out} left out" if done.left_out else ""
    typer.echo(
        f"{out}: {samples.count} samples ({flagged} flagged{said}), "
        f"{int(samples.contacts.sum())} contacts"
    )
    for index, reason in enumerate(samples.reasons):
        count = int((samples.reason_index == index).sum())
        if count:
            typer.echo(f"  {count} flagged: {reason}")
