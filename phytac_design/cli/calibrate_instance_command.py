"""The command that calibrates one print's decoder by a few presses of known force."""

import contextlib
import csv
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, check_out, say
from phytac_design.cli.output import next_step, print_json
from phytac_design.cli.serve_command import (
    BundleArgument,
    ControlOption,
    RestFirstOption,
    RestOption,
    SourceArgument,
    open_frames,
)
from phytac_shapes.errors import InputError, OutputError

if TYPE_CHECKING:
    from phytac_decoder.io.frame import Frame, Source
    from phytac_design.simulation.rig_import.rig_frames import FrameFolder
    from phytac_design.workflows.calibrate_instance import InstanceCalibration
    from phytac_shapes.arrays import ImageArray

UNITS_N = {"": 1.0, "n": 1.0, "g": 9.80665e-3, "kg": 9.80665, "oz": 0.278014, "lb": 4.448222}
"""Newtons of a unit of a scale or force gauge."""
REST_FRAMES = 30
"""Rest frames that are taken if neither option says otherwise."""
STEADY_FRAMES, STEADY_SHARE = 5, 0.05
"""Frames of a camera in which a press is held, and the largest change of its force meanwhile."""


def calibrate_instance(
    design: DesignArgument,
    bundle: BundleArgument,
    source: SourceArgument,
    out: Annotated[
        Path,
        typer.Option(callback=check_out, help="The calibrated decoder's own folder."),
    ],
    presses: Annotated[int, typer.Option(help="Number of presses.", min=1, max=1000)] = 10,
    accuracy: Annotated[
        float,
        typer.Option(
            help="Stop as soon as half the 95 % interval of a press is at most this, % of its "
            "force; 0: after all presses.",
            min=0.0,
        ),
    ] = 0.0,
    forces: Annotated[
        Path | None,
        typer.Option(
            help="CSV of the presses' pictures (column frame, files of the folder SOURCE) and "
            "forces (force_N), instead of questions."
        ),
    ] = None,
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    control: ControlOption = None,
    force: Annotated[
        bool, typer.Option(help="Overwrite a folder that holds something else.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Calibrate the decoder of one print by a few presses on a scale, at proposed places."""
    from phytac_decoder.io.bundle import load_bundle
    from phytac_decoder.io.recorded_frames import read_image
    from phytac_decoder.pipeline.rest_frames import take_rest_frames
    from phytac_design.design.design_file import load_design
    from phytac_design.layout.sensor import Sensor
    from phytac_design.training.result_folder import reserve_folder
    from phytac_design.workflows.calibrate_instance import LOG, TABLE, InstanceCalibration

    loaded = load_design(design)
    decoder = load_bundle(bundle)
    unloaded = [read_image(path) for path in rest or []]
    if rest and rest_first:
        raise InputError(
            "rest-options-exclusive",
            "--rest and --rest-first name the unloaded sensor both; give one of them",
        )
    if any(out.resolve() in Path(where).resolve().parents for where in source):
        raise OutputError(
            "output-holds-source",
            f"{out} holds the pictures that are to be read; choose another --out",
        )
    if (out / LOG).exists() and not force:
        raise OutputError(
            "output-exists",
            f"{out} holds the presses of another run; choose another --out, or drop them with "
            "--force",
        )
    with reserve_folder(out, TABLE, loaded.name, force=force), contextlib.ExitStack() as stack:
        if forces is not None:
            if not unloaded:
                raise InputError(
                    "rest-frame-missing", "give the unloaded sensor's picture with --rest"
                )
            calibration = InstanceCalibration(Sensor(loaded), decoder, out, unloaded)
            _add_listed(calibration, forces, source, presses, accuracy)
        else:
            frames = open_frames(stack, decoder, source, control, report=say, pace=False)
            if not unloaded:
                say("leave the sensor unloaded")
                unloaded = take_rest_frames(decoder, frames, rest_first or REST_FRAMES)
            calibration = InstanceCalibration(Sensor(loaded), decoder, out, unloaded)
            _add_asked(calibration, frames, decoder.force_max_N, presses, accuracy)
        if not calibration.presses:
            raise InputError(
                "no-presses", "no press is known: nothing is calibrated; start again with a scale"
            )
        facts = calibration.save()
    if as_json:
        print_json({"out": str(out)} | facts)
        return
    typer.echo(
        f"{out}: presses: {facts['presses']}, {facts['auto']['stiffness']:.3f} times the stiffness "
        f"of the design, forces of such presses within ± {100.0 * facts['interval_share']:.1f} % "
        "(95 %)"
    )
    next_step(f"phytac live {shlex.join([str(out), *source])} --rest-first 30")


def newtons(text: str) -> float:
    """Force of a reading, such as ``9.3``, ``9.3 N``, ``948 g`` or ``0,948 kg``.

    Raises
    ------
    InputError
        If it is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:[.,]\d*)?|[.,]\d+)\s*([a-z]*)\s*", text.lower())
    if found is None or found[2] not in UNITS_N:
        units = ", ".join(name for name in UNITS_N if name)
        raise InputError(
            "force-invalid", f"a force is a number, in newtons or with a unit ({units}): {text!r}"
        )
    value = float(found[1].replace(",", ".")) * UNITS_N[found[2]]
    if value <= 0.0:
        raise InputError("force-invalid", f"a force is above 0 (got {text!r})")
    return value


def _add_asked(
    calibration: "InstanceCalibration",
    source: "Source",
    force_max_N: float,
    presses: int,
    accuracy: float,
) -> None:
    """Propose presses and ask for their forces, until there are enough or the user stops."""
    frames = iter(source)
    say("for each press: hold it, type what the scale reads, and press Enter; or skip, undo, done")
    while _wanted(calibration, presses, accuracy):
        number = len(calibration.presses) + 1
        say(
            f"press {number} of {presses}: {calibration.proposal()}, along the normal, with about "
            f"{0.5 * force_max_N:.2g} N"
        )
        try:
            answer = typer.prompt("force", err=True).strip().lower()
        except typer.Abort:  # Ctrl-C, or the end of the answers
            return
        if answer in ("done", "d", "q"):
            return
        try:
            _answer(calibration, answer, frames, live=source.live)
        except InputError as error:
            say(f"not taken: {error}")


def _answer(
    calibration: "InstanceCalibration", answer: str, frames: "Iterator[Frame]", *, live: bool
) -> None:
    """Do what an answer says: a press, or one of the words."""
    if answer in ("skip", "s"):
        calibration.skip()
        return
    if answer in ("undo", "u"):
        calibration.undo()
        say(f"presses so far: {len(calibration.presses)}")
        return
    force_N = newtons(answer)
    shots = [_images(frames) for _ in range(STEADY_FRAMES if live else 1)]
    change = calibration.change_share(shots) if live else 0.0
    if change > STEADY_SHARE:
        raise InputError(
            "press-unsteady",
            f"the force changed by {100.0 * change:.0f} % while it was read; hold still, and type "
            "the force again",
        )
    _say_press(calibration, shots[-1], force_N)


def _images(frames: "Iterator[Frame]") -> "Sequence[ImageArray]":
    """Images of the next frame.

    Raises
    ------
    InputError
        If there is none, or the camera gives no picture.
    """
    frame = next(frames, None)
    if frame is None or not frame.images:
        raise InputError("camera-lost", "there is no picture; check the camera and its plug")
    return frame.images


def _add_listed(
    calibration: "InstanceCalibration",
    path: Path,
    folders: list[str],
    presses: int,
    accuracy: float,
) -> None:
    """Add the presses of a table, in its order."""
    from phytac_design.simulation.rig_import.rig_frames import FrameFolder

    sources = [FrameFolder(Path(folder), None) for folder in folders]
    for line, name, force in _rows(path):
        if not _wanted(calibration, presses, accuracy):
            return
        where = f"{path}, line {line}"
        try:
            images = [_picture(source, name) for source in sources]
            _say_press(calibration, images, newtons(force))
        except InputError as error:
            say(f"not taken: {where}: {error}")


def _picture(source: "FrameFolder", name: str) -> "ImageArray":
    """Picture of a name or number in a folder.

    Raises
    ------
    InputError
        If there is none.
    """
    number = source.find(name)
    if number is None:
        raise InputError("file-unreadable", f"{source.where} holds no picture {name!r}")
    return source.read(number)


def _rows(path: Path) -> "Iterator[tuple[int, str, str]]":
    """Line, picture and force of each row of a table.

    Raises
    ------
    InputError
        If a column is missing.
    """
    from phytac_shapes.bounded_reader import read_text

    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    rows = csv.DictReader(lines)
    missing = {"frame", "force_N"} - set(rows.fieldnames or ())
    if missing:
        raise InputError(
            "csv-columns",
            f"{path} has no column {' and '.join(sorted(missing))}; its first line names the "
            "columns, separated by commas",
        )
    for number, row in enumerate(rows, start=2):
        yield number, row["frame"] or "", row["force_N"] or ""


def _wanted(calibration: "InstanceCalibration", presses: int, accuracy: float) -> bool:
    """Whether more presses are needed."""
    known = len(calibration.presses)
    good = known > 0 and 100.0 * calibration.interval_share <= accuracy
    return known < presses and not good


def _say_press(
    calibration: "InstanceCalibration", images: "Sequence[ImageArray]", force_N: float
) -> None:
    press = calibration.add(images, force_N)
    for warning in press.warnings:
        say(f"warning: {warning}")
    say(
        f"{force_N:.2f} N, read as {press.contact.raw_N:.2f} N by design; forces of such presses "
        f"are now within ± {100.0 * calibration.interval_share:.1f} % (95 %)"
    )
