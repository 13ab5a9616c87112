"""The command that shows what a camera gives, and what to change before forces are read."""

import contextlib
import json
import shlex
from math import isfinite
from typing import Annotated, Any

import typer

from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.serve_command import (
    BundleArgument,
    ControlOption,
    FpsOption,
    open_frames,
)
from phytac_shapes.errors import InputError


def camera(
    bundle: BundleArgument,
    device: Annotated[
        list[str] | None,
        typer.Option(help="Camera's number or address (or a recording); twice for two cameras."),
    ] = None,
    fps: FpsOption = None,
    control: ControlOption = None,
    seconds: Annotated[
        float, typer.Option(help="Stop after this time; Ctrl-C stops as well.", min=1.0)
    ] = 3600.0,
    as_json: JsonOption = False,
) -> None:
    """Show focus, exposure, markers and motion of a camera each second, and what to change."""
    from phytac_decoder.io.bundle import load_bundle
    from phytac_decoder.io.live_camera import CameraSource
    from phytac_decoder.serving.camera_check import CameraCheck
    from phytac_design.core.json_values import finite

    loaded, sources = load_bundle(bundle), device or ["0"]
    check = CameraCheck(loaded, fps=fps)
    with contextlib.ExitStack() as stack:
        frames = open_frames(stack, loaded, sources, control, report=say, fps=fps)
        say("leave the sensor unloaded; Ctrl-C stops and gives the verdict")
        with contextlib.suppress(KeyboardInterrupt):
            for frame in frames:
                report = check.add(frame, lost=frames.skipped)
                if report:
                    line = json.dumps(finite(report), ensure_ascii=False)
                    typer.echo(line if as_json else _line(report))
                if frame.timestamp_s > seconds:
                    break
    problems = check.problems()
    if fps and frames.missed and not isinstance(frames, CameraSource):
        problems.append(
            f"{frames.missed} pictures came too late: they cannot be read at {fps:g} a second; "
            "leave out --fps for a recording"
        )
    locked: dict[str, float] = {}
    if isinstance(frames, CameraSource):
        problems += [f"refused by camera {text}; set it with v4l2-ctl" for text in frames.refused]
        locked = frames.locked
    if as_json:
        verdict = {"ready": not problems, "change": problems, "locked": locked}
        typer.echo(json.dumps(verdict, ensure_ascii=False))
    else:
        for problem in problems:
            typer.echo(f"to change: {problem}")
        words = [str(bundle), *sources, "--rest-first", "30"]
        words += [word for name in locked for word in ("--control", f"{name}={locked[name]:g}")]
        typer.echo("not ready" if problems else f"ready; next: phytac live {shlex.join(words)}")
    if problems:
        raise typer.Exit(InputError.exit_code)


def _known(value: float, digits: int) -> str:
    """Return a figure, or a question mark where the picture does not show it."""
    return f"{value:.{digits}f}" if isfinite(value) else "?"


def _line(report: dict[str, Any]) -> str:
    """One second in one line."""
    parts = [f"{report['time_s']:5.0f} s"]
    if report["cameras"]:
        parts.append(f"{report['fps']:.1f} fps")
    parts += [
        f"focus {_known(one['blur_px'], 2)} px blur, brightness {one['brightness']:.0f}, clipped "
        f"{100.0 * one['clipped']:.1f} %, colour {_known(one['chroma'], 0)}, markers "
        f"{one['found']}/{one['markers']}, motion {one['motion_px']:.2f}, scatter "
        f"{one['scatter_px']:.3f} px"
        for one in report["cameras"]
    ]
    return "  ".join([*parts, "; ".join(report["change"]) or "good"])
