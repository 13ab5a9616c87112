"""The command that calibrates one print's decoder by a few presses of known force."""

import contextlib
import re
import shlex
import signal
from collections.abc import Sequence
from functools import partial
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
    check_rest_options,
    check_source_count,
    open_frames,
)
from phytac_shapes.errors import InputError, OutputError, PhytacError

if TYPE_CHECKING:
    from phytac_decoder.io.bundle import Bundle
    from phytac_decoder.io.frame import Source
    from phytac_design.design.spec import Design
    from phytac_design.simulation.rig_import.rig_frames import FrameFolder
    from phytac_design.workflows.calibrate_instance import InstanceCalibration
    from phytac_shapes.arrays import ImageArray

UNITS_N = {
    "": 1.0,
    "n": 1.0,
    "mn": 1e-3,
    "kn": 1e3,
    "g": 9.80665e-3,
    "gf": 9.80665e-3,
    "kg": 9.80665,
    "kgf": 9.80665,
    "oz": 0.2780139,
    "ozf": 0.2780139,
    "lb": 4.4482216,
    "lbf": 4.4482216,
}
"""Newtons of a unit of a scale or force gauge."""
PRESSES, PRESSES_MIN = 10, 3
"""Presses that are asked for by default, and least before ``--accuracy`` ends them."""
REST_FRAMES = 30
"""Rest frames of a camera if neither option says otherwise."""
STEADY_FRAMES, STEADY_SHARE = 5, 0.05
"""Frames of a camera in which a press is held, and the largest change of its force meanwhile."""


def calibrate_instance(
    design: DesignArgument,
    bundle: BundleArgument,
    source: Annotated[
        list[str],
        typer.Argument(
            help="Camera's number or address; with --table the folder of the presses' pictures; "
            "two of two cameras, near end first."
        ),
    ],
    out: Annotated[
        Path, typer.Option(callback=check_out, help="The calibrated decoder's own folder.")
    ],
    presses: Annotated[
        int | None,
        typer.Option(help="Number of presses; 10, or all of the table, if not given.", min=1),
    ] = None,
    accuracy: Annotated[
        float,
        typer.Option(
            help="Stop, after three presses or more, as soon as half the 95 % interval of a press "
            "is at most this, % of its force; 0: never.",
            min=0.0,
        ),
    ] = 0.0,
    table: Annotated[
        Path | None,
        typer.Option(
            help="CSV of presses, columns frame (a picture in the folder SOURCE) and force_N: "
            "nothing is asked."
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
    """Calibrate the decoder of your print by a few presses on a scale, at proposed places.

    For each press: hold it, press Enter, and type what the scale reads, such as 9.3 (newtons),
    948 g or 2.1 lb; or skip, undo, done.
    """
    from phytac_decoder.io.bundle import load_bundle
    from phytac_design.design.design_file import load_design
    from phytac_design.layout.sensor import Sensor
    from phytac_design.training.result_folder import reserve_folder
    from phytac_design.workflows.calibrate_instance import (
        TABLE,
        InstanceCalibration,
        designed_locator,
        doubts,
    )

    loaded, decoder = load_design(design), load_bundle(bundle)
    check_rest_options(rest, rest_first)
    check_source_count(decoder, source)
    designed_locator(decoder)
    _check_out_folder(out, bundle, source, force=force)
    for limit in decoder.limits("auto"):
        say(f"warning: {limit}")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with reserve_folder(out, TABLE, loaded.name, force=force), contextlib.ExitStack() as stack:
        camera = None if table else _camera(stack, decoder, source, control)
        unloaded = _unloaded(decoder, camera, rest, rest_first)
        calibration = InstanceCalibration(Sensor(loaded), decoder, out, unloaded)
        say(f"stiffness by design: ± {100.0 * calibration.interval_share:.0f} % (95 %)")
        finished = True
        if camera is not None:
            finished = _add_asked(
                calibration, camera, decoder.force_max_N, presses or PRESSES, accuracy
            )
        elif table is not None:
            _add_table(calibration, table, source, presses, accuracy)
        if not calibration.presses:
            raise InputError("no-presses", "no press was taken, so that nothing is calibrated")
        if finished and calibration.shows_wall:
            _fit_wall(calibration, loaded)
        facts = calibration.save()
    for doubt in doubts(calibration.presses):
        say(f"warning: {doubt}")
    if as_json:
        print_json({"out": str(out)} | facts)
        return
    typer.echo(
        f"{out}: presses: {facts['presses']}; {facts['auto']['stiffness']:.3f} times the stiffness "
        f"of the design; forces of such presses within ± {100.0 * facts['interval_share']:.1f} % "
        "(95 %, median)"
    )
    wall = facts["auto"]["wall"]
    if "thinnest" in wall:
        thin, thick = wall["thinnest"], wall["thickest"]
        typer.echo(f"its wall: {thin:.2f} to {thick:.2f} times the designed thickness")
    if table is None:
        next_step(f"phytac live {shlex.join([str(out), *source])} --rest-first {REST_FRAMES}")
    else:
        next_step(f"phytac decode {shlex.quote(str(out))} FRAME --rest REST")


def _fit_wall(calibration: "InstanceCalibration", design: "Design") -> None:
    """Fit the thickness of the wall; without it the presses so far are as good."""
    from phytac_design.workflows.calibrate_instance import designed_wall

    say("the thickness of the wall, by all presses (Ctrl-C leaves it out)")
    try:
        calibration.fit_wall(partial(designed_wall, design, say))
    except KeyboardInterrupt:
        say("stopped: the wall is taken as even")
    except (PhytacError, OSError, MemoryError) as error:
        say(f"warning: the wall is taken as even: {str(error) or type(error).__name__}")


def _camera(
    stack: contextlib.ExitStack, bundle: "Bundle", source: list[str], control: list[str] | None
) -> "Source":
    """Running camera, which the stack closes.

    Raises
    ------
    InputError
        If it is a recording.
    """
    frames = open_frames(stack, bundle, source, control, report=say)
    if not frames.live:
        raise InputError(
            "source-not-live",
            f"{frames.description} is a recording; name its presses in a file with --table, or "
            "give a camera",
        )
    return frames


def _unloaded(
    bundle: "Bundle", camera: "Source | None", rest: list[Path] | None, rest_first: int
) -> "Sequence[ImageArray]":
    """Pictures of the unloaded sensor, of files or of the running camera.

    Raises
    ------
    InputError
        If there are none.
    """
    from phytac_decoder.io.recorded_frames import read_image
    from phytac_decoder.pipeline.rest_frames import take_rest_frames

    if rest:
        return [read_image(path) for path in rest]
    if camera is None:
        raise InputError(
            "rest-frame-missing",
            "--table needs the unloaded sensor's picture; give it with --rest",
        )
    say("leave the sensor unloaded until the first press is proposed")
    return take_rest_frames(bundle, camera, rest_first or REST_FRAMES)


def newtons(text: str) -> float:
    """Force of a reading, such as ``9.3``, ``9.3 N``, ``948 g`` or ``0,948 kg``.

    Raises
    ------
    InputError
        If it is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:[.,]\d*)?|[.,]\d+)\s*([a-z]*)\s*", text.lower())
    if found is None or found[2] not in UNITS_N:
        raise InputError(
            "force-invalid",
            f"a force is a number above 0, in newtons or with a unit (g, kg, oz, lb): {text!r}",
        )
    value = float(found[1].replace(",", ".")) * UNITS_N[found[2]]
    if value <= 0.0:
        raise InputError("force-invalid", f"a force is above 0 (got {text!r})")
    return value


def _check_out_folder(out: Path, bundle: Path, source: Sequence[str], *, force: bool) -> None:
    """Refuse to overwrite what is to be read, or the presses of another run.

    Raises
    ------
    OutputError
        If ``out`` holds either.
    """
    from phytac_design.workflows.calibrate_instance import LOG

    whole = out.resolve()
    folders = [Path(where).resolve() for where in source if Path(where).is_dir()]
    if whole == bundle.resolve() or any(whole in folder.parents for folder in folders):
        raise OutputError(
            "output-holds-source", f"{out} holds what is to be read; choose another --out"
        )
    if (out / LOG).exists() and not force:
        raise OutputError(
            "output-exists",
            f"{out} holds the presses of another run; choose another --out, or drop them with "
            f"--force; --table {out}/{LOG} calibrates by them (docs/guides/on-your-bench.md)",
        )


def _ask(text: str) -> str:
    """Answer to a question on standard error; "done" at the end of the answers."""
    typer.echo(f"{text} ", nl=False, err=True)
    try:
        return input().strip().lower()
    except EOFError:
        say("")
        return "done"


def _add_asked(
    calibration: "InstanceCalibration",
    source: "Source",
    force_max_N: float,
    presses: int,
    accuracy: float,
) -> bool:
    """Propose presses and ask for their forces, until there are enough or the user is done.

    Returns
    -------
    bool
        False if the user stopped the program.
    """
    answer = ""
    while answer != "done" and _wanted(calibration, presses, accuracy):
        say(
            f"press {len(calibration.presses) + 1} of {presses}: {calibration.proposal()}, "
            f"straight onto the wall, with about {0.5 * force_max_N:.2g} N"
        )
        try:
            answer = _ask("hold it and press Enter (or skip, undo, done):")
            if answer == "":
                answer = _take(calibration, source)
            if answer == "skip":
                calibration.skip()
            elif answer == "undo":
                calibration.undo()
                say(f"presses so far: {len(calibration.presses)}")
            elif answer not in ("", "done"):
                say("press Enter while you hold the press; or type skip, undo or done")
        except InputError as error:
            say(f"not taken: {error}")
        except KeyboardInterrupt:
            say("stopped")
            return False
    return True


def _take(calibration: "InstanceCalibration", source: "Source") -> str:
    """Take the pictures of a press that is held, and ask for its force.

    Returns
    -------
    str
        What was answered instead of a force: skip, undo or done; else "".

    Raises
    ------
    InputError
        If there is no picture, or the press is of no use.
    """
    shots: list[tuple[ImageArray, ...]] = []
    for frame in source:
        shots.append(frame.images)
        if not frame.images or len(shots) > STEADY_FRAMES:
            break
    # The first one may have been waiting.
    shots = shots[1:]
    if len(shots) < STEADY_FRAMES or not all(shots):
        raise InputError("camera-lost", "the camera gives no picture; check it and its plug")
    change = calibration.change_share(shots)
    if change > STEADY_SHARE:
        raise InputError(
            "press-unsteady",
            f"the force changed by {100.0 * change:.0f} % (at most {100.0 * STEADY_SHARE:.0f} %) "
            "while it was looked at; hold still",
        )
    answer = _ask("what the scale reads (newtons; or 948 g, 0.95 kg, 2.1 lb):")
    if answer in ("skip", "undo", "done"):
        return answer
    _add(calibration, shots[len(shots) // 2], newtons(answer))
    return ""


def _add_table(
    calibration: "InstanceCalibration",
    path: Path,
    folders: list[str],
    presses: int | None,
    accuracy: float,
) -> None:
    """Add the presses of a table, in its order.

    Raises
    ------
    InputError
        If the table cannot be read, or names no picture or force.
    """
    from phytac_design.simulation.rig_import.rig_frames import FrameFolder
    from phytac_design.simulation.rig_import.rig_log import read_rows

    names, rows, _ = read_rows(path)
    missing = [name for name in ("frame", "force_N") if name not in names]
    if missing:
        raise InputError(
            "csv-columns",
            f"{path} has no column {' and '.join(missing)} (its first line: {','.join(names)}); "
            "columns are separated by commas",
        )
    sources = [FrameFolder(Path(folder), None) for folder in folders]
    pictures = [sources[0].find(row["frame"]) for _, row in rows]
    twice = [
        line
        for at, (line, _) in enumerate(rows)
        if pictures[at] is not None and pictures[at] in pictures[:at]
    ]
    if twice:
        raise InputError(
            "frame-twice",
            f"{path}, line {twice[0]}: its picture is that of a line above; give each press one",
        )
    for count, (line, row) in enumerate(rows):
        if not _wanted(calibration, presses or len(rows), accuracy):
            say(f"rows that are not needed: {len(rows) - count}")
            return
        try:
            images = [_picture(source, row["frame"]) for source in sources]
            _add(calibration, images, newtons(row["force_N"]))
        except InputError as error:
            say(f"not taken: {path}, line {line}: {error}")


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


def _wanted(calibration: "InstanceCalibration", presses: int, accuracy: float) -> bool:
    """Whether more presses are needed."""
    known = len(calibration.presses)
    good = known >= PRESSES_MIN and 100.0 * calibration.interval_share <= accuracy
    return known < presses and not good


def _add(
    calibration: "InstanceCalibration", images: "Sequence[ImageArray]", force_N: float
) -> None:
    from phytac_design.workflows.calibrate_instance import doubts

    press = calibration.add(images, force_N)
    for warning in (*press.warnings, *doubts(calibration.presses)):
        say(f"warning: {warning}")
    say(
        f"press {len(calibration.presses)}: {force_N:.2f} N at {calibration.seen_at(press)}, read "
        f"as {press.contact.raw_N:.2f} N by design; forces of such presses are now within ± "
        f"{100.0 * calibration.interval_share:.1f} % (95 %)"
    )
