"""The command that decodes frames: one to a table of forces, a recording to a row a frame."""

import contextlib
import json
import re
import sys
from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.serve_command import (
    DesignOption,
    FollowOption,
    RegionsOption,
    RestFirstOption,
    RestOption,
    check_sources,
    decoder_of,
    named_regions,
    open_recorders,
    rest_images,
)
from phytac_shapes.errors import InputError, OutputError

if TYPE_CHECKING:
    from phytac_decoder.estimation.force_regions import Region
    from phytac_decoder.io.bundle import Bundle
    from phytac_decoder.serving.csv_recording import Recorder, RegionRecorder
    from phytac_decoder.serving.sensor_loop import Progress
    from phytac_decoder.serving.wire_protocol import Message


class Estimator(StrEnum):
    """Force estimators of a bundle."""

    fem = "fem"
    fem_nn = "fem_nn"
    fem_nn_identity = "fem_nn_identity"
    koi_inverse = "koi_inverse"
    auto = "auto"


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a recording is decoded to; names are those of the options."""

    source: list[str]
    fps: float | None
    chosen: str
    rest: list[Path]
    rest_first: int
    follow: bool
    csv: Path | None
    parquet: Path | None
    record_regions: Path | None
    as_json: bool

    @property
    def files(self) -> list[tuple[str, Path]]:
        """Files to write, with the options that name them."""
        each = (
            ("--csv", self.csv),
            ("--parquet", self.parquet),
            ("--record-regions", self.record_regions),
        )
        return [(option, path) for option, path in each if path is not None]


def decode(
    bundle: Annotated[Path, typer.Argument(help="Decoder folder, as in exports/NAME/decoder.")],
    frame: Annotated[
        list[str],
        typer.Argument(
            help="Image, folder of images, video, or a camera's number; two of two cameras, near "
            "end first."
        ),
    ],
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    estimator: Annotated[
        Estimator | None, typer.Option(help="Force estimator; the decoder's best if not given.")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            help="Rate of a recording, for its timestamps; it is decoded as fast as that goes."
        ),
    ] = None,
    follow: FollowOption = False,
    csv: Annotated[Path | None, typer.Option(help="CSV of contacts to write.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="The same as Parquet.")] = None,
    regions: RegionsOption = None,
    design: DesignOption = None,
    record_regions: Annotated[
        Path | None, typer.Option(help="CSV of the regions' forces to write, a row a frame.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Decode an image, a folder of images, a video or a camera to forces in newtons."""
    from phytac_decoder.io.bundle import load_bundle

    loaded = load_bundle(bundle)
    chosen = estimator.value if estimator else loaded.model.best
    known = loaded.model.estimators
    if chosen not in known:
        raise InputError(f"the decoder has no estimator {chosen!r}; known: {', '.join(known)}")
    named = named_regions(regions, loaded, bundle, design)
    wanted = Wanted(
        source=frame,
        fps=fps,
        chosen=chosen,
        rest=rest or [],
        rest_first=rest_first,
        follow=follow,
        csv=csv,
        parquet=parquet,
        record_regions=record_regions,
        as_json=as_json,
    )
    if wanted.files or rest_first or follow or fps or not all(map(is_image, frame)):
        _decode_recording(loaded, named, wanted)
    else:
        _decode_frame(loaded, named, wanted)


def is_image(where: str) -> bool:
    """Whether a source is a single image, by its name."""
    from phytac_decoder.io.recorded_frames import SUFFIXES

    path = Path(where)
    return "://" not in where and path.suffix.lower() in SUFFIXES and not path.is_dir()


def _decode_frame(bundle: "Bundle", regions: "tuple[Region, ...]", wanted: Wanted) -> None:
    """One frame of each camera, in full."""
    from phytac_decoder.estimation.force_regions import RegionForces
    from phytac_decoder.pipeline.colour_calibration import calibrate_rest
    from phytac_decoder.pipeline.decode import measure_frame, read_image
    from phytac_decoder.pipeline.frame_reading import marker_loads, read

    images = [read_image(Path(where)) for where in wanted.source]
    if wanted.rest:
        bundle = calibrate_rest(bundle, rest_images(bundle, wanted.rest, [], 0))
    measured = measure_frame(bundle, images)
    chosen = wanted.chosen
    reading = read(bundle, measured, chosen)
    koi, forces, warnings = reading.koi, reading.forces_N, reading.warnings
    contacts = reading.found.contacts if reading.found else []
    pressed = marker_loads(reading, koi, bundle.position_mm)
    total_N = float(pressed.force_N.sum())
    sums = RegionForces(regions=regions, markers=len(forces))
    held = dict(
        zip(
            [region.name for region in regions],
            sums.of(pressed.markers, pressed.force_N),
            strict=True,
        )
    )
    for warning in (*bundle.limits(), *warnings):
        say(f"warning: {warning}")
    if wanted.as_json:
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
                    "radius_mm": round(contact.radius_mm, 3),
                    "markers": contact.markers.tolist(),
                }
                for contact in contacts
            ],
            "warnings": warnings,
            "limits": bundle.limits(),
        }
        if regions:
            result["regions"] = {name: round(force, 4) for name, force in held.items()}
        typer.echo(json.dumps(result, indent=1))
        return
    typer.echo(f"{bundle.design}: {int(measured.found.sum())} of {len(forces)} markers found")
    for marker in koi:
        x, y, z = bundle.position_mm[marker]
        typer.echo(
            f"  marker {marker:4d} at ({x:6.1f}, {y:6.1f}, {z:6.1f}) mm  {forces[marker]:7.2f} N"
        )
    for contact in contacts:
        x, y, z = contact.point_mm
        switched = "" if len(contact.markers) else "; it tripped no switch"
        typer.echo(
            f"  contact at ({x:6.1f}, {y:6.1f}, {z:6.1f}) mm  {contact.force_N:.2f} N, standard "
            f"deviation {contact.sd_N:.2f} N, radius {contact.radius_mm:.1f} mm{switched}"
        )
    for name, force in held.items():
        typer.echo(f"  region {name}  {force:.2f} N")
    aside = f" and {len(reading.silent)} contacts without one" if reading.silent else ""
    typer.echo(f"total {total_N:.2f} N on {len(koi)} switched receptors{aside}")


@dataclass(kw_only=True)
class Teller:
    """Prints a row a frame, and each kind of warning once.

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


def _decode_recording(bundle: "Bundle", regions: "tuple[Region, ...]", wanted: Wanted) -> None:
    """A row a frame, until the source ends or Ctrl-C; what was decoded is kept."""
    import signal

    from phytac_decoder.io.frame_sources import open_source
    from phytac_decoder.serving.sensor_loop import Stream
    from phytac_decoder.serving.wire_protocol import MessageBuilder

    check_sources(bundle.design, len(bundle.cameras), wanted.source)
    _check_files(wanted)
    unloaded = rest_images(bundle, wanted.rest, wanted.source, wanted.rest_first)
    reader = decoder_of(bundle, unloaded, estimator=wanted.chosen, follow=wanted.follow)
    teller = Teller(as_json=wanted.as_json, rows=wanted.as_json or not wanted.files)
    size = (bundle.camera.width_px, bundle.camera.height_px)
    stopped, failed = False, None
    # Whoever runs it as a service stops it by SIGTERM.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.ExitStack() as stack:
        frames = open_source(wanted.source, fps=wanted.fps, pace=False, size_px=size, report=say)
        stack.callback(frames.close)
        kept = _recorders(stack, wanted, [region.name for region in regions])
        for limit in bundle.limits():
            say(f"warning: {limit}")
        stream = Stream(
            source=frames,
            decode=reader,
            messages=MessageBuilder(
                bundle=bundle,
                estimator=wanted.chosen,
                source=frames.said,
                clock=frames.clock,
                regions=regions,
            ),
            publish=teller.publish,
            recorders=list(kept.values()),
            report=say,
            each_second=_progress(getattr(frames, "count", None), rows=teller.rows),
        )
        try:
            stream.run()
        except KeyboardInterrupt:
            stopped = True
        except InputError as error:
            # Such as a camera that was unplugged: what it gave is kept.
            failed = error
    wrote = _written(wanted, kept)
    say(f"{stream.progress.total()}, {teller.flagged} with warnings{wrote}")
    if failed:
        raise failed
    if stopped:
        raise typer.Exit(130)
    if not teller.valid:
        raise InputError(
            f"none of the {stream.progress.frames} frames of {frames.said} could be decoded; are "
            f"they of the sensor {bundle.design!r}?"
        )


def _progress(count: int | None, *, rows: bool) -> Any:
    """What to say each second: nothing where rows show on the same screen."""

    def each_second(now: "Progress") -> None:
        of = f" of {count}" if count else ""
        say(f"{now.seconds:6.0f} s  {now.frames}{of} frames, {now.fps:.1f} a second")

    def nothing(_now: "Progress") -> None:
        return

    return nothing if rows and sys.stdout.isatty() else each_second


def _check_files(wanted: Wanted) -> None:
    """Refuse files that are there already, before anything is decoded.

    Raises
    ------
    OutputError
        If one is.
    MissingPartError
        If Parquet cannot be written here.
    """
    from phytac_design.core.parquet_recording import parquet_library

    for option, path in wanted.files:
        if path.exists():
            raise OutputError(f"{path} is there already; give {option} another name, or remove it")
    if len({path.absolute() for _, path in wanted.files}) < len(wanted.files):
        each = ", ".join(f"{option} {path}" for option, path in wanted.files)
        raise OutputError(f"two of {each} are one file; give each a name of its own")
    if wanted.parquet:
        parquet_library()
        rows = _scratch(wanted.parquet)
        if wanted.csv is None and rows.exists():
            raise OutputError(
                f"{rows} is there already, the rows of a run that was cut off; keep them with "
                f"`phytac convert {rows} {wanted.parquet}`, or remove it"
            )


def _scratch(parquet: Path) -> Path:
    """CSV of a recording that ends as Parquet alone."""
    return parquet.with_name(parquet.name + ".csv")


def _recorders(
    stack: contextlib.ExitStack, wanted: Wanted, names: list[str]
) -> "dict[Path, Recorder | RegionRecorder]":
    """Recorders by file; Parquet is made of the CSV at the end."""
    contacts = wanted.csv
    if wanted.parquet and contacts is None:
        contacts = _scratch(wanted.parquet)
    return open_recorders(stack, contacts, wanted.record_regions, names)


def _written(wanted: Wanted, kept: "dict[Path, Recorder | RegionRecorder]") -> str:
    """Make what is asked for of closed recordings; which rows lie where."""
    from phytac_design.core.parquet_recording import to_parquet

    rows = {path: recorder.rows for path, recorder in kept.items()}
    if wanted.parquet:
        source = wanted.csv or _scratch(wanted.parquet)
        try:
            rows[wanted.parquet], _ = to_parquet(source, wanted.parquet)
        except OutputError as error:
            raise OutputError(f"{error}; {rows[source]} rows are kept in {source}") from None
        if wanted.csv is None:
            rows.pop(source)
            source.unlink()
    return "".join(f", {count} rows in {path}" for path, count in rows.items())
