"""The command that streams forces."""

import contextlib
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phytac_design.cli.console_reporter import ConsoleReporter
from phytac_design.cli.options import say
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError, OutputError

if TYPE_CHECKING:
    from phytac_decoder.estimation.force_regions import Region
    from phytac_decoder.io.bundle import Bundle
    from phytac_decoder.serving.csv_recording import Recorder, RegionRecorder
    from phytac_decoder.serving.sensor_loop import Decode


SourceArgument = Annotated[
    list[str],
    typer.Argument(
        help="Image, folder of images, video, or a camera's number; two of two cameras, near "
        "end first."
    ),
]
FpsOption = Annotated[
    float | None,
    typer.Option(help="Play a recording at this rate, as a camera would; ask a camera for it."),
]
EstimatorOption = Annotated[
    str | None, typer.Option(help="Force estimator; the bundle's best if not given.")
]
RestOption = Annotated[
    list[Path] | None,
    typer.Option(help="Frame of the unloaded sensor; twice for two cameras, near end first."),
]
RestFirstOption = Annotated[
    int,
    typer.Option(help="So many frames at the beginning show the unloaded sensor.", min=0, max=1000),
]
FollowOption = Annotated[
    bool,
    typer.Option(
        "--follow", help="Follow markers from frame to frame, from the unloaded sensor on: faster."
    ),
]
RecordOption = Annotated[Path | None, typer.Option(help="CSV of contacts to write.")]
EveryOption = Annotated[
    bool, typer.Option("--every", help="Leave out no frame of a recording that is late.")
]
LoopOption = Annotated[bool, typer.Option("--loop", help="Play a recording over and over.")]
RegionsOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML or JSON of named regions, such as fingers, in place of the bundle's; see "
        "docs/streaming.md."
    ),
]
DesignOption = Annotated[
    str | None,
    typer.Option(help="The design, for regions by rows or shares; the build's if not given."),
]


class Framing(StrEnum):
    """How messages are told apart."""

    lines = "lines"
    length = "length"


def serve(
    bundle: Annotated[Path, typer.Argument(help="Decoder folder, as in exports/NAME/decoder.")],
    source: SourceArgument,
    fps: FpsOption = None,
    port: Annotated[int, typer.Option(help="TCP port; 0 takes a free one.", min=0, max=65535)] = (
        5757
    ),
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 lets other machines in.")
    ] = "127.0.0.1",
    framing: Annotated[
        Framing, typer.Option("--format", help="JSON lines, or each message after its length.")
    ] = Framing.lines,
    estimator: EstimatorOption = None,
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    follow: FollowOption = False,
    serial: Annotated[
        Path | None, typer.Option(help="Serial port to send JSON lines to as well.")
    ] = None,
    baud: Annotated[int, typer.Option(help="Bits a second of the serial port.")] = 115200,
    imu: Annotated[
        Path | None, typer.Option(help="File or port of motion samples; see docs/streaming.md.")
    ] = None,
    record: RecordOption = None,
    regions: RegionsOption = None,
    design: DesignOption = None,
    record_regions: Annotated[
        Path | None, typer.Option(help="CSV of the regions' forces to write, a row a frame.")
    ] = None,
    every: EveryOption = False,
    loop: LoopOption = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Begin when the first client has come.")
    ] = False,
) -> None:
    """Stream forces to robots, Unity or ROS over TCP, until the source ends or Ctrl-C."""
    import signal
    import time

    from phytac_decoder.io.bundle import load_bundle
    from phytac_decoder.io.frame_sources import open_source
    from phytac_decoder.io.imu import Imu
    from phytac_decoder.io.serial_port import SerialPort
    from phytac_decoder.serving.force_server import StreamServer
    from phytac_decoder.serving.sensor_loop import Progress, Stream
    from phytac_decoder.serving.wire_protocol import MessageBuilder

    loaded = load_bundle(bundle)
    named = named_regions(regions, loaded, bundle, design)
    check_sources(loaded.design, len(loaded.cameras), source)
    chosen = estimator or loaded.model.best
    unloaded = rest_images(loaded, rest or [], source, rest_first)
    decode = decoder_of(loaded, unloaded, estimator=chosen, follow=follow)
    camera = loaded.camera
    # Whoever runs it as a service stops it by SIGTERM.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.ExitStack() as stack:
        tell = stack.enter_context(ConsoleReporter())
        frames = open_source(
            source,
            fps=fps,
            every=every,
            loop=loop,
            size_px=(camera.width_px, camera.height_px),
            report=tell,
        )
        stack.callback(frames.close)
        started_s = time.monotonic()
        messages = MessageBuilder(
            bundle=loaded,
            estimator=chosen,
            source=frames.said,
            clock=frames.clock,
            started_unix_s=time.time(),
            regions=named,
        )
        motion = None
        if imu is not None:
            motion = Imu(imu, clock=lambda: time.monotonic() - started_s, report=tell)
            stack.callback(motion.close)
            check_motion(loop=loop, port=motion.is_port)
        server = stack.enter_context(
            StreamServer(
                messages.hello(),
                host=host,
                port=port,
                framing=framing.value,
                serial=SerialPort(serial, baud=baud) if serial else None,
                serial_hello=messages.hello(positions=False),
                report=tell,
            )
        )
        kept = open_recorders(stack, record, record_regions, [region.name for region in named])
        for warning in (*loaded.limits(), *open_to_others(server.host)):
            tell(f"warning: {warning}")
        tell(f"{loaded.design}: {frames.said} to {server.host} port {server.port}; Ctrl-C stops")

        def each_second(now: Progress) -> None:
            tell(now.text(clients=server.clients, dropped=server.dropped))

        stream = Stream(
            source=frames,
            decode=decode,
            messages=messages,
            publish=server.publish,
            started_s=started_s,
            imu=motion,
            recorders=list(kept.values()),
            report=tell,
            each_second=each_second,
        )
        try:
            if wait:
                server.wait_for_client()
            stream.run()
            stopped = False
        except KeyboardInterrupt:
            server.close("stopped")
            stopped = True
    wrote = "".join(f", {recorder.rows} rows in {path}" for path, recorder in kept.items())
    typer.echo(f"{stream.progress.total()}, {server.dropped} messages dropped{wrote}")
    if stopped:
        raise typer.Exit(130)


def convert(
    recording: Annotated[Path, typer.Argument(help="CSV of `phytac serve --record`, or any.")],
    target: Annotated[Path, typer.Argument(help="Parquet file to make.")],
    force: Annotated[bool, typer.Option(help="Overwrite the file.")] = False,
) -> None:
    """Turn a recording into Parquet, its columns with their types."""
    from phytac_design.core.parquet_recording import to_parquet

    rows, columns = to_parquet(recording, target, force=force, report=say)
    typer.echo(f"{target}: {rows} rows, {columns} columns")


def check_sources(design: str, cameras: int, source: list[str]) -> None:
    """Refuse another number of sources than the sensor has cameras.

    Raises
    ------
    InputError
        If there is.
    """
    if len(source) != cameras:
        each = "one camera: one source" if cameras == 1 else f"{cameras} cameras: one source each"
        raise InputError(f"the sensor {design!r} has {each} (got {len(source)})")


def named_regions(
    path: Path | None, bundle: "Bundle", folder: Path, design: str | None
) -> "tuple[Region, ...]":
    """Regions of a file, or the bundle's own.

    Raises
    ------
    InputError
        See :func:`phytac_design.layout.region_chart.bundle_regions`.
    """
    from phytac_design.layout.region_chart import bundle_regions

    return bundle_regions(path, bundle, folder, design) if path else bundle.regions


def rest_images(
    bundle: "Bundle", rest: list[Path], source: list[str], first: int
) -> list[ImageArray]:
    """A frame of the unloaded sensor of each camera; none if none was named.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    rest : list of Path
        Its images.
    source : list of str
        Where frames come from.
    first : int
        So many of these show the unloaded sensor.

    Raises
    ------
    InputError
        If both are given, or they cannot be read.
    """
    from phytac_decoder.io.frame_sources import first_frames
    from phytac_decoder.pipeline.decode import read_image

    if rest and first:
        raise InputError("--rest and --rest-first name the unloaded sensor both; give one of them")
    if first:
        size = (bundle.camera.width_px, bundle.camera.height_px)
        return first_frames(source, first, size_px=size, report=say)
    return [read_image(path) for path in rest]


def decoder_of(
    bundle: "Bundle", unloaded: list[ImageArray], *, estimator: str, follow: bool
) -> "Decode":
    """Decoder of frames, one by one or followed from the unloaded sensor on.

    Raises
    ------
    InputError
        If markers are to be followed from nowhere.
    """
    from phytac_decoder.pipeline.colour_calibration import calibrate_rest
    from phytac_decoder.serving.sensor_loop import follow_decoder, frame_decoder
    from phytac_decoder.serving.torn_frames import with_torn_frame_check

    if unloaded:
        bundle = calibrate_rest(bundle, unloaded)
    if not follow:
        return with_torn_frame_check(frame_decoder(bundle, estimator=estimator))
    if not unloaded:
        raise InputError(
            "--follow begins at a frame of the unloaded sensor; give it with --rest, or say with "
            "--rest-first that the recording begins with it"
        )
    return with_torn_frame_check(follow_decoder(bundle, unloaded, estimator=estimator))


def open_to_others(address: str) -> list[str]:
    """What to say of an address that is not this machine's own loop."""
    if address.startswith("127.") or address == "::1":
        return []
    return [f"whoever reaches {address} can listen; nothing is encrypted"]


def open_recorders(
    stack: contextlib.ExitStack, record: Path | None, record_regions: Path | None, names: list[str]
) -> "dict[Path, Recorder | RegionRecorder]":
    """Recorders of contacts and of regions' forces, by file; the stack closes them.

    Raises
    ------
    InputError
        If regions are to be kept and there are none.
    OutputError
        If a file cannot be made, or both are one.
    """
    from phytac_decoder.serving.csv_recording import Recorder, RegionRecorder

    if record_regions and not names:
        raise InputError("--record-regions keeps the forces of regions; name them with --regions")
    if record and record_regions and record.resolve() == record_regions.resolve():
        raise OutputError(
            f"--record and --record-regions are one file ({record}); give each a name of its own"
        )
    kept: dict[Path, Recorder | RegionRecorder] = {}
    if record:
        kept[record] = stack.enter_context(Recorder(record))
    if record_regions:
        kept[record_regions] = stack.enter_context(RegionRecorder(record_regions, names))
    return kept


def check_motion(*, loop: bool, port: bool) -> None:
    """Refuse a recording that begins again while its motion samples do not.

    Raises
    ------
    InputError
        If it would.
    """
    if loop and not port:
        raise InputError("a file of motion samples does not begin again; leave out --loop or --imu")
