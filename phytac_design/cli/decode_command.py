"""The command that decodes frames: one to a table of forces, a recording to one row per frame."""

import contextlib
import json
import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.output import next_step, print_json
from phytac_design.cli.serve_command import (
    BundleArgument,
    ControlOption,
    DesignOption,
    FollowOption,
    MomentAboutOption,
    MountOption,
    RecordRegionsOption,
    RegionsOption,
    RestFirstOption,
    RestOption,
    Session,
    SourceArgument,
    StiffnessOption,
    named_regions,
    open_recorders,
    open_session,
    rows_text,
)
from phytac_shapes.errors import InputError, OutputError

if TYPE_CHECKING:
    from phytac_decoder.camera.camera_motion import Mount
    from phytac_decoder.estimation.contact_estimates import LocatedContact
    from phytac_decoder.io.bundle import Bundle
    from phytac_decoder.pipeline.frame_reading import Reading
    from phytac_decoder.serving.sensor_loop import Progress
    from phytac_decoder.serving.wire_protocol import Message

GIVE_REST = (
    "give --rest FRAME, a picture of the unloaded sensor in the same light: forces are measured "
    "from it"
)


Estimator = Literal["fem", "fem_nn", "fem_nn_identity", "koi_inverse", "auto"]


def decode(
    bundle: BundleArgument,
    frame: SourceArgument,
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    mount: MountOption = "bench",
    stiffness_change: StiffnessOption = 2.0,
    estimator: Annotated[
        Estimator | None,
        typer.Option(
            help="Force estimator. If not given: auto, or koi_inverse if the bundle has no tables."
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Rate of a recording, for its timestamps; decoding is as fast as possible."
        ),
    ] = None,
    follow: FollowOption = False,
    control: ControlOption = None,
    csv: Annotated[Path | None, typer.Option(help="CSV of contacts to write.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Parquet file of contacts to write.")] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(help="ROS 2 messages as MCAP, for Foxglove and ros2 bag (extra recordings)."),
    ] = None,
    regions: RegionsOption = None,
    design: DesignOption = None,
    record_regions: RecordRegionsOption = None,
    moment_about: MomentAboutOption = (0.0, 0.0, 0.0),
    as_json: JsonOption = False,
) -> None:
    """Decode an image, a folder of images, a video or a camera to forces in newtons."""
    options = {
        "--csv": csv,
        "--parquet": parquet,
        "--mcap": mcap,
        "--record-regions": record_regions,
    }
    files = {option: path for option, path in options.items() if path is not None}
    if not (files or rest_first or follow or fps) and all(map(is_image, frame)):
        _decode_frame(
            bundle,
            frame,
            rest or [],
            estimator,
            regions,
            design,
            mount=mount,
            stiffness_change=stiffness_change,
            moment_about=moment_about,
            as_json=as_json,
        )
        return
    _check_files(files)
    with contextlib.ExitStack() as stack:
        session = open_session(
            stack,
            bundle,
            frame,
            estimator,
            rest,
            rest_first,
            follow=follow,
            regions=regions,
            design=design,
            mount=mount,
            stiffness_change=stiffness_change,
            control=control,
            report=say,
            fps=fps,
            pace=False,
        )
        _decode_recording(session, files, moment_about, as_json=as_json)
        rate = "" if fps else "; --fps gives a recording the rate that it was taken with"
        say(f"timestamps: {session.source.clock}{rate}")
    if not (rest or rest_first or as_json):
        # Rows are on the other stream.
        say(f"next: {GIVE_REST}")


def is_image(where: str) -> bool:
    """Whether a source is a single image, by its name."""
    from phytac_decoder.io.recorded_frames import SUFFIXES

    path = Path(where)
    return "://" not in where and path.suffix.lower() in SUFFIXES and not path.is_dir()


def _decode_frame(
    folder: Path,
    frames: list[str],
    rest: list[Path],
    estimator: str | None,
    regions_file: Path | None,
    design: str | None,
    *,
    mount: "Mount",
    stiffness_change: float,
    moment_about: tuple[float, float, float],
    as_json: bool,
) -> None:
    """One frame of each camera, in full."""
    import numpy as np

    from phytac_decoder.estimation.force_regions import RegionForces
    from phytac_decoder.io.bundle import load_bundle
    from phytac_decoder.io.recorded_frames import read_image
    from phytac_decoder.pipeline.colour_calibration import calibrate_rest
    from phytac_decoder.pipeline.decode import measure_frame
    from phytac_decoder.pipeline.frame_reading import marker_loads, read
    from phytac_decoder.pipeline.rest_frames import pressed_note
    from phytac_decoder.serving.sensor_loop import check_estimator
    from phytac_decoder.serving.wire_protocol import MessageBuilder, wrench_fields

    bundle = load_bundle(folder, mount=mount, stiffness_change=stiffness_change / 100.0)
    chosen = estimator or bundle.model.best
    check_estimator(bundle, chosen)
    regions = named_regions(regions_file, bundle, folder, design)
    images = [read_image(Path(where)) for where in frames]
    if rest:
        unloaded = [read_image(path) for path in rest]
        bundle = calibrate_rest(bundle, unloaded)
        if note := pressed_note(measure_frame(bundle, unloaded).koi):
            say(f"warning: {note}: forces there are too small")
    messages = MessageBuilder(bundle=bundle, estimator=chosen, moment_about_mm=moment_about)
    measured = measure_frame(bundle, images)
    reading = read(bundle, measured, chosen)
    if not reading.valid:
        raise _no_forces(reading, bundle.design, with_rest=bool(rest))
    koi, forces = reading.koi, reading.forces_N
    contacts = reading.found.contacts if reading.found else []
    markers, force_N = marker_loads(reading, koi, bundle.position_mm)
    total_N = float(force_N.sum())
    sums = RegionForces(regions=regions, markers=len(forces))
    region_N = dict(
        zip(
            [region.name for region in regions],
            sums.of(markers, force_N),
            strict=True,
        )
    )
    normals = messages.normals(np.array([one.point_mm for one in contacts]).reshape(-1, 3))
    net = wrench_fields(messages.wrench(reading), moment_about)
    truth_N = _true_forces(Path(frames[0]))
    for warning in (*bundle.limits(chosen), *reading.warnings):
        say(f"warning: {warning}")
    if as_json:
        result: dict[str, Any] = {
            "design": bundle.design,
            "estimator": chosen,
            "found": int(measured.found.sum()),
            "forces_N": {str(i): round(float(forces[i]), 4) for i in koi},
            "total_N": round(total_N, 4),
            "contacts": [
                {
                    "force_N": round(contact.force_N, 4),
                    "sd_N": round(contact.sd_N, 4),
                    "position_mm": [round(float(x), 3) for x in contact.point_mm],
                    "normal": [round(float(x), 5) for x in normal],
                    "radius_mm": round(contact.radius_mm, 3),
                    "markers": contact.markers.tolist(),
                    **shear_of(contact),
                    **_true_interval(contact, truth_N),
                }
                for contact, normal in zip(contacts, normals, strict=True)
            ],
            **net,
            "warnings": reading.warnings,
            "limits": bundle.limits(chosen),
        }
        if regions:
            result["regions"] = {name: round(force, 4) for name, force in region_N.items()}
        if truth_N:
            result["true_forces_N"] = {str(marker): force for marker, force in truth_N.items()}
        print_json(result)
        return
    typer.echo(f"{bundle.design}: {int(measured.found.sum())} of {len(forces)} markers found")
    _print_loads(bundle, reading, truth_N)
    for name, force in region_N.items():
        typer.echo(f"  region {name}  {force:.2f} N")
    _print_sums(reading, total_N, truth_N, net)
    typer.echo(f"the frame is {_frame_verdict(reading, float(measured.found.mean()))}")
    next_step(f"phytac live {folder} 0 shows forces of a camera" if rest else GIVE_REST)


def _no_forces(reading: "Reading", design: str, *, with_rest: bool) -> InputError:
    """Error of a frame that was not decoded."""
    text = reading.warnings[0]
    if reading.code == "rest-frame-outdated" and not with_rest:
        text = (
            f"{text}. Without --rest, that is the design's own picture: {GIVE_REST}; or this is no "
            f"frame of the sensor {design!r}"
        )
    return InputError(reading.code, text)


def _frame_verdict(reading: "Reading", found_share: float) -> str:
    """Whether a frame is good, or why it is doubtful."""
    from phytac_decoder.pipeline.decode import FOUND_WELL, OVER_END

    of_frame = [text for text in reading.warnings if OVER_END not in text]
    if of_frame:
        return f"doubtful: {of_frame[0]}"
    good = f"good: {found_share:.0%} of the markers found (needs {FOUND_WELL:.0%})"
    return "; but ".join([good, *reading.warnings])


def _print_sums(
    reading: "Reading", total_N: float, truth_N: dict[int, float], net: dict[str, Any]
) -> None:
    """Sum of the forces, how far they are from the truth where it is known, and the net force."""
    koi = [int(marker) for marker in reading.koi]
    aside = f" and {len(reading.unswitched)} contacts without one" if reading.unswitched else ""
    typer.echo(f"total {total_N:.2f} N on {len(koi)} switched receptors{aside}")
    if truth_N:
        typer.echo(_against_truth({mark: float(reading.forces_N[mark]) for mark in koi}, truth_N))
    typer.echo(
        "net force ({:.2f}, {:.2f}, {:.2f}) N, moment ({:.1f}, {:.1f}, {:.1f}) N·mm about "
        "({:g}, {:g}, {:g}) mm".format(
            *net["net_force_N"], *net["net_moment_Nmm"], *net["moment_about_mm"]
        )
    )


def _true_forces(frame: Path) -> dict[int, float]:
    """Forces that a rendered frame was pressed with, N by marker; empty for other pictures.

    A build writes them beside its frame, with the same name and the suffix ``.json``.
    """
    try:
        data = json.loads(frame.with_suffix(".json").read_text(encoding="utf-8"))
        return {int(marker): float(force_N) for marker, force_N in data.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}  # no file, or one of something else


def _against_truth(found_N: dict[int, float], truth_N: dict[int, float]) -> str:
    """How far receptors' forces are from those of a rendered frame."""
    off_N = [abs(found_N.get(marker, 0.0) - force_N) for marker, force_N in truth_N.items()]
    missed = len(truth_N.keys() - found_N.keys())
    false = len(found_N.keys() - truth_N.keys())
    total_N = sum(truth_N.values())
    return (
        f"rendered with {total_N:.2f} N on {len(truth_N)} receptors: each is "
        f"{sum(off_N) / len(off_N):.2f} N off on average, {missed} not found, {false} switches "
        "on where nothing presses"
    )


def _print_loads(bundle: "Bundle", reading: "Reading", truth_N: dict[int, float]) -> None:
    """Markers and contacts of one frame with their forces, and the true ones where known."""
    for marker in reading.koi:
        x, y, z = bundle.position_mm[marker]
        force_N = reading.forces_N[marker]
        true = f"  (true: {truth_N.get(marker, 0.0):.2f} N)" if truth_N else ""
        typer.echo(
            f"  marker {marker:4d} at ({x:6.1f}, {y:6.1f}, {z:6.1f}) mm  {force_N:7.2f} N{true}"
        )
    for contact in reading.found.contacts if reading.found else []:
        x, y, z = contact.point_mm
        switched = "" if len(contact.markers) else "; it tripped no switch"
        shear = shear_of(contact)
        aside = ""
        if shear:
            aside = ", along the surface ({:.2f}, {:.2f}, {:.2f}) N".format(*shear["shear_N"])
        known = _true_interval(contact, truth_N)
        if known:
            word = "inside" if known["true_force_inside"] else "outside"
            low, high = known["interval_90_N"]
            switched += (
                f"; true: {known['true_force_N']:.2f} N, {word} the 90 % interval of {low:.2f} to "
                f"{high:.2f} N"
            )
        typer.echo(
            f"  contact at ({x:6.1f}, {y:6.1f}, {z:6.1f}) mm  {contact.force_N:.2f} N, standard "
            f"deviation {contact.sd_N:.2f} N, radius {contact.radius_mm:.1f} mm{aside}{switched}"
        )


def _true_interval(contact: "LocatedContact", truth_N: dict[int, float]) -> dict[str, Any]:
    """True force on a contact's switches, its 90 % interval, and whether that holds the force.

    Empty where the truth is not known, as for contacts that tripped no switch.
    """
    if not truth_N or not len(contact.markers):
        return {}
    true_N = sum(truth_N.get(int(marker), 0.0) for marker in contact.markers)
    reach_N = NormalDist().inv_cdf(0.95) * contact.sd_N
    low, high = max(contact.force_N - reach_N, 0.0), contact.force_N + reach_N
    return {
        "true_force_N": round(true_N, 4),
        "interval_90_N": [round(low, 4), round(high, 4)],
        "true_force_inside": bool(low <= true_N <= high),
    }


def shear_of(contact: "LocatedContact") -> dict[str, list[float]]:
    """Force along the surface and its standard deviations; empty where it is not determined."""
    if not contact.shear_observed:
        return {}
    return {
        "shear_N": [round(float(part), 4) for part in contact.shear_N],
        "shear_sd_N": [round(float(part), 4) for part in contact.shear_sd_N],
    }


@dataclass(kw_only=True)
class FramePrinter:
    """Prints one row per frame, and each kind of warning once.

    Attributes
    ----------
    as_json : bool
        Rows are the stream's messages.
    rows : bool
        Whether rows are printed at all.
    valid, flagged : int
        Frames that could be decoded, and those with warnings.
    kinds : Counter
        How often each kind of warning came, by its words without numbers.
    """

    as_json: bool
    rows: bool
    valid: int = 0
    flagged: int = 0
    kinds: Counter[str] = field(default_factory=Counter)

    def publish(self, message: "Message") -> None:
        """Print one frame's row."""
        from phytac_decoder.serving.wire_protocol import json_bytes

        self.valid += message["valid"]
        self.flagged += bool(message["warnings"])
        for warning in message["warnings"]:
            # Which markers, and how many, changes from frame to frame.
            kind = re.sub(r"\([^)]*\)|-?\d+(\.\d+)?", "", warning)
            self.kinds[kind] += 1
            if self.kinds[kind] == 1 and message["valid"]:
                say(f"warning: frame {message['sequence']}: {warning}")
        if self.rows:
            typer.echo(json_bytes(message).decode() if self.as_json else _row(message))


def _row(message: "Message") -> str:
    """One frame in one line."""
    head = f"{message['sequence']:6d} {message['timestamp_s']:10.3f} s"
    if not message["valid"]:
        return f"{head}  could not be decoded"
    parts = [f"{head} {message['total_N']:8.2f} N"]
    for contact in message["contacts"]:
        x, y, z = contact["position_mm"]
        region = f" {contact['region']}" if contact.get("region") else ""
        spread = f" ± {contact['sd_N']:.2f}" if "sd_N" in contact else ""
        force = f"#{contact['id']} {contact['force_N']:.2f}{spread} N"
        parts.append(f"{force} at ({x:.1f}, {y:.1f}, {z:.1f}) mm{region}")
    parts += [f"{one['name']} {one['force_N']:.2f} N" for one in message.get("regions", ())]
    if message["warnings"]:
        parts.append("doubtful")
    return "  ".join(parts)


def _decode_recording(
    session: Session,
    files: dict[str, Path],
    moment_about: tuple[float, float, float],
    *,
    as_json: bool,
) -> None:
    """One row per frame, until the source ends or Ctrl-C; what was decoded is kept."""
    from phytac_decoder.serving.sensor_loop import Stream
    from phytac_design.core.parquet_recording import to_parquet

    printer = FramePrinter(as_json=as_json, rows=as_json or not files)
    parquet = files.get("--parquet")
    # Parquet is made of the CSV at the end.
    contacts = files.get("--csv") or (_scratch(parquet) if parquet else None)
    stopped, failed, frames = False, None, session.source
    with contextlib.ExitStack() as stack:
        messages = session.messages(moment_about)
        kept = open_recorders(
            stack, contacts, files.get("--record-regions"), messages, mcap=files.get("--mcap")
        )
        for limit in session.bundle.limits(session.estimator):
            say(f"warning: {limit}")
        stream = Stream(
            source=frames,
            decode=session.decode,
            messages=messages,
            publish=printer.publish,
            recorders=list(kept.values()),
            report=say,
            each_second=_progress(getattr(frames, "count", None), rows=printer.rows),
        )
        try:
            stream.run()
        except KeyboardInterrupt:
            stopped = True
        except InputError as error:
            # Such as a camera that was unplugged: what it gave is kept.
            failed = error
    wrote = rows_text(kept)
    if parquet and contacts:
        try:
            rows, _ = to_parquet(contacts, parquet)
        except OutputError as error:
            kept_rows = kept[contacts].rows
            raise OutputError(
                error.code, f"{error}; {kept_rows} rows are kept in {contacts}"
            ) from None
        if "--csv" not in files:
            kept.pop(contacts)
            contacts.unlink()
        wrote = f"{rows_text(kept)}, {rows} rows in {parquet}"
    say(f"{stream.progress.total()}, {printer.flagged} with warnings{wrote}")
    if failed:
        raise failed
    if stopped:
        raise typer.Exit(130)
    if not printer.valid:
        raise InputError(
            "no-frames-decoded",
            f"none of the {stream.progress.frames} frames of {frames.description} could be "
            f"decoded; are they of the sensor {session.bundle.design!r}?",
        )


def _progress(count: int | None, *, rows: bool) -> "Callable[[Progress], None]":
    """What to print each second: nothing where rows show on the same screen."""
    if rows and sys.stdout.isatty():
        return lambda _: None
    of = f" of {count}" if count else ""
    return lambda now: say(f"{now.seconds:6.0f} s  {now.frames}{of} frames, {now.fps:.1f} a second")


def _check_files(files: dict[str, Path]) -> None:
    """Reject files that exist already, before anything is decoded.

    Raises
    ------
    OutputError
        If one does.
    MissingPartError
        If Parquet cannot be written here.
    """
    from phytac_design.core.parquet_recording import parquet_library

    for option, path in files.items():
        if path.exists():
            raise OutputError(
                "output-exists",
                f"{path} is there already; give {option} another name, or remove it",
            )
    if len({path.absolute() for path in files.values()}) < len(files):
        each = ", ".join(f"{option} {path}" for option, path in files.items())
        raise OutputError(
            "output-name-twice", f"two of {each} are one file; give each a name of its own"
        )
    if "--parquet" in files:
        parquet_library()
        rows = _scratch(files["--parquet"])
        if "--csv" not in files and rows.exists():
            raise OutputError(
                "output-partial-exists",
                f"{rows} is there already, the rows of a run that was cut off; keep them with "
                f"`phytac convert {rows} {files['--parquet']}`, or remove it",
            )


def _scratch(parquet: Path) -> Path:
    """CSV of a recording that ends as Parquet alone."""
    return parquet.with_name(parquet.name + ".csv")
