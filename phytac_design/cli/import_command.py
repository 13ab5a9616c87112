"""The commands that read a user's own rig, and data of other sensors."""

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


def import_markers(
    source: Annotated[
        Path,
        typer.Argument(
            help="Zarr (folder, or .zarr.zip) as of FTP-1 and UMI, an NPZ file, or MCAP with ROS 2 "
            "messages (a file, a bag, or a folder of them)."
        ),
    ],
    markers: Annotated[
        str,
        typer.Option(
            help="Array of marker displacements or positions, one row per frame; of MCAP a topic, "
            "or TOPIC.FIELD."
        ),
    ],
    wrench: Annotated[
        str,
        typer.Option(
            help="Array of measured forces, one row per frame; of MCAP a topic, such as one of "
            "geometry_msgs/WrenchStamped."
        ),
    ],
    pad: Annotated[
        int, typer.Option(help="Which pad, of arrays of FTP-1 that hold several.", min=0)
    ] = 0,
    rest_first: Annotated[
        bool, typer.Option("--rest-first", help="The first frame of each episode is at rest.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(callback=check_out, help="NPZ file to make of the frames that are used."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Judge estimators that need no model of the sensor on data of any sensor with markers."""
    import numpy as np

    from phytac_design.training.marker_regression import judge
    from phytac_design.workflows.marker_data import read_marker_data, write_marker_data

    data, notes = read_marker_data(source, markers, wrench, pad=pad, rest_first=rest_first)
    found = judge(data)
    none = found["mean"].rms_error
    if np.all(np.minimum(found["ridge"].rms_error, found["kernel"].rms_error) > 0.9 * none):
        notes.append(
            f"no estimator is much better than the mean of {wrench}: do the rows of {markers} and "
            f"{wrench} belong to the same instants, and are markers in one order in all episodes?"
        )
    if out:
        write_marker_data(out, data)
    for note in notes:
        say(f"warning: {note}")
    spread = np.where(np.ptp(data.wrench, axis=0) > 0.0, data.wrench.std(axis=0), 0.0)
    if as_json:
        print_json(
            {
                "frames": len(data.wrench),
                "episodes": len(np.unique(data.episode)),
                "spread": spread.tolist(),
                "held_out": {
                    name: {key: value.tolist() for key, value in vars(one).items()}
                    for name, one in found.items()
                },
                "notes": notes,
            }
        )
        return
    typer.echo(
        f"{len(data.wrench)} frames of {len(np.unique(data.episode))} episodes; errors on episodes "
        "that were not learnt from, in the unit of the data:"
    )
    typer.echo("estimator  component  mean error      rms   of spread  intervals of 90 % hold")
    for name, one in found.items():
        for part, width in enumerate(spread):
            typer.echo(
                f"{name:<9}  {part:9d}  {one.mean_error[part]:10.4g} {one.rms_error[part]:8.4g}  "
                f"{one.rms_error[part] / width if width else np.nan:10.0%}  "
                f"{one.covered[part]:20.0%}"
            )
