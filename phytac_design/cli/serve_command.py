"""The command that streams forces, and what the commands that decode have in common."""

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from phytac_design.cli.console_reporter import ConsoleReporter
from phytac_design.cli.options import say
from phytac_shapes.errors import InputError, OutputError

if TYPE_CHECKING:
    from phytac_decoder.camera.camera_motion import Mount
    from phytac_decoder.estimation.force_regions import Region
    from phytac_decoder.io.bundle import Bundle
    from phytac_decoder.io.frame import Source
    from phytac_decoder.serving.sensor_loop import Decode, MessageRecorder
    from phytac_decoder.serving.tare import TareDecoder
    from phytac_decoder.serving.wire_protocol import MessageBuilder
    from phytac_shapes.arrays import ImageArray

    Recorders = dict[Path, MessageRecorder]

BundleArgument = Annotated[
    Path, typer.Argument(help="Folder of a decoder, such as exports/NAME/decoder.")
]
SourceArgument = Annotated[
    list[str],
    typer.Argument(
        help="Image, folder of images, video, or a camera's number; two of two cameras, near "
        "end first."
    ),
]
FpsOption = Annotated[
    float | None,
    typer.Option(help="Rate at which a recording is played, or that a camera is set to."),
]
EstimatorOption = Annotated[
    str | None,
    typer.Option(
        help="Force estimator. If not given: auto, or koi_inverse if the bundle has no tables."
    ),
]
RestOption = Annotated[
    list[Path] | None,
    typer.Option(help="Frame of the unloaded sensor; twice for two cameras, near end first."),
]
StiffnessOption = Annotated[
    float,
    typer.Option(
        "--stiffness-change",
        help="How much the wall may have softened or stiffened since the decoder was trained, % "
        "(standard deviation): about 0.5 per kelvin.",
        min=0.0,
        max=50.0,
    ),
]
MountOption = Annotated[
    Literal["rigid", "bench", "handheld"],
    typer.Option(
        help="How firmly the camera is held against the shell. This limits the motion since the "
        "rest frame that is corrected."
    ),
]
DriftOption = Annotated[
    bool,
    typer.Option(
        help="While nothing is pressed, follow slow motion of the camera, with a time constant of "
        "a minute."
    ),
]
RestFirstOption = Annotated[
    int,
    typer.Option(
        help="Number of frames at the beginning that show the unloaded sensor.", min=0, max=1000
    ),
]
FollowOption = Annotated[
    bool,
    typer.Option(
        "--follow",
        help="Track markers from frame to frame, starting with the unloaded sensor: faster.",
    ),
]
ControlOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Setting of a camera: a locked value (exposure=156; also gain, white_balance, focus), "
        "automatic (focus=auto), or the format (format=raw or format=mjpg). May be repeated."
    ),
]
RecordOption = Annotated[
    Path | None,
    typer.Option(
        help="CSV of contacts to write, or ROS 2 messages as NAME.mcap (extra recordings), or a "
        "recording for Rerun as NAME.rrd (extra rerun), or FTP-1's Zarr as NAME.zarr."
    ),
]
RecordRegionsOption = Annotated[
    Path | None, typer.Option(help="CSV of the regions' forces to write, one row per frame.")
]
EveryOption = Annotated[
    bool, typer.Option("--every", help="Decode every frame of a recording, also late ones.")
]
LoopOption = Annotated[bool, typer.Option("--loop", help="Play a recording over and over.")]
RegionsOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML or JSON of named regions, such as fingers, in place of the bundle's; see "
        "docs/streaming.md."
    ),
]
MomentAboutOption = Annotated[
    tuple[float, float, float],
    typer.Option(
        help="Point x y z in the sensor's frame, mm, about which net moments are taken.",
        metavar="X Y Z",
    ),
]
DesignOption = Annotated[
    str | None,
    typer.Option(
        help="Design file, for regions by rows or shares; that of the build if not given."
    ),
]


Framing = Literal["lines", "length"]


def serve(
    bundle: BundleArgument,
    source: SourceArgument,
    fps: FpsOption = None,
    port: Annotated[int, typer.Option(help="TCP port; 0 chooses a free one.", min=0, max=65535)] = (
        5757
    ),
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 lets other machines in.")
    ] = "127.0.0.1",
    framing: Annotated[
        Framing,
        typer.Option(
            "--format", help="Framing of messages: one JSON line each, or each after its length."
        ),
    ] = "lines",
    estimator: EstimatorOption = None,
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    mount: MountOption = "bench",
    stiffness_change: StiffnessOption = 2.0,
    drift: DriftOption = True,
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
    record_regions: RecordRegionsOption = None,
    moment_about: MomentAboutOption = (0.0, 0.0, 0.0),
    control: ControlOption = None,
    every: EveryOption = False,
    loop: LoopOption = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Start when the first client has connected.")
    ] = False,
    ros2: Annotated[
        bool,
        typer.Option(
            "--ros2", help="Publish ROS 2 topics, too, in the domain ROS_DOMAIN_ID (extra ros2)."
        ),
    ] = False,
    ros2_images: Annotated[
        bool, typer.Option("--ros2-images", help="Also publish pictures, 30 a second at most.")
    ] = False,
) -> None:
    """Stream forces to robots, Unity or ROS over TCP, until the source ends or Ctrl-C."""
    import time

    from phytac_decoder.io.imu import Imu
    from phytac_decoder.io.serial_port import SerialPort
    from phytac_decoder.serving.force_server import StreamServer
    from phytac_decoder.serving.sensor_loop import Progress, Stream

    with contextlib.ExitStack() as stack:
        report = stack.enter_context(ConsoleReporter())
        session = open_session(
            stack,
            bundle,
            source,
            estimator,
            rest,
            rest_first,
            follow=follow,
            regions=regions,
            design=design,
            mount=mount,
            stiffness_change=stiffness_change,
            drift=drift,
            control=control,
            report=report,
            fps=fps,
            every=every,
            loop=loop,
        )
        loaded, frames = session.bundle, session.source
        started_s = time.monotonic()
        messages = session.messages(moment_about)
        motion = None
        if imu is not None:
            motion = Imu(imu, clock=lambda: time.monotonic() - started_s, report=report)
            stack.callback(motion.close)
            if loop and not motion.is_port:
                raise InputError(
                    "imu-file-repeats",
                    "a file of motion samples does not begin again; leave out --loop or --imu",
                )
        server = stack.enter_context(
            StreamServer(
                messages.hello(),
                host=host,
                port=port,
                framing=framing,
                serial=SerialPort(serial, baud=baud) if serial else None,
                serial_hello=messages.hello(positions=False),
                tare=session.tare.tare,
                report=report,
            )
        )
        kept = open_recorders(stack, record, record_regions, messages)
        if ros2 or ros2_images:
            kept[Path("ROS 2")], session = open_topics(
                stack, messages, session, report, images=ros2_images
            )
        for limit in loaded.limits(session.estimator):
            report(f"warning: {limit}")
        if not (server.host.startswith("127.") or server.host == "::1"):
            report(
                f"warning: whoever reaches {server.host} can listen and tare; nothing is encrypted"
            )
        where = f"{server.host} port {server.port}"
        report(f"{loaded.design}: {frames.description} to {where}; Ctrl-C stops")

        def each_second(now: Progress) -> None:
            report(now.text(clients=server.clients, dropped=server.dropped))

        stream = Stream(
            source=frames,
            decode=session.decode,
            messages=messages,
            publish=server.publish,
            started_s=started_s,
            imu=motion,
            recorders=list(kept.values()),
            tare_result=session.tare.result,
            report=report,
            each_second=each_second,
        )
        stopped = False
        try:
            if wait:
                server.wait_for_client()
            stream.run()
        except KeyboardInterrupt:
            server.close("stopped")
            stopped = True
    lost = f", {server.dropped} messages dropped"
    typer.echo(f"{stream.progress.total()}{lost}{rows_text(kept)}")
    if stopped:
        raise typer.Exit(130)


def convert(
    recording: Annotated[
        Path, typer.Argument(help="CSV of `phytac serve --record` or --record-regions.")
    ],
    target: Annotated[Path, typer.Argument(help="Parquet file to make.")],
    force: Annotated[bool, typer.Option(help="Overwrite the file.")] = False,
) -> None:
    """Convert a recording to Parquet, with a type for each column."""
    from phytac_design.core.parquet_recording import to_parquet

    rows, columns = to_parquet(recording, target, force=force, report=say)
    typer.echo(f"{target}: {rows} rows, {columns} columns")


class Session(NamedTuple):
    """A sensor's decoder and its frames, set up for one run."""

    bundle: "Bundle"
    source: "Source"
    regions: "tuple[Region, ...]"
    estimator: str
    decode: "Decode"
    tare: "TareDecoder"

    def messages(self, moment_about_mm: tuple[float, float, float]) -> "MessageBuilder":
        """Messages of a stream that begins now, with moments about a point."""
        import time

        from phytac_decoder.serving.wire_protocol import MessageBuilder

        return MessageBuilder(
            bundle=self.bundle,
            estimator=self.estimator,
            source=self.source.description,
            clock=self.source.clock,
            started_unix_s=time.time(),
            regions=self.regions,
            moment_about_mm=moment_about_mm,
        )


def open_session(
    stack: contextlib.ExitStack,
    folder: Path,
    source: list[str],
    estimator: str | None,
    rest: list[Path] | None,
    rest_first: int,
    *,
    follow: bool,
    regions: Path | None,
    design: str | None,
    mount: "Mount" = "bench",
    stiffness_change: float = 2.0,
    drift: bool = False,
    control: list[str] | None = None,
    **options: Any,
) -> Session:
    """Load a decoder and set it up as the options say; from now on SIGTERM stops as Ctrl-C does.

    A camera is opened once: its rest frames have the same settings as all others.

    Parameters
    ----------
    stack : ExitStack
        Closes the source.
    folder, source, estimator, rest, rest_first, follow, regions, design, mount, stiffness_change,
    drift, control
        Of the command line.
    **options
        See :func:`phytac_decoder.io.frame_sources.open_source`.

    Raises
    ------
    InputError
        If the options do not fit the sensor.
    """
    import signal

    from phytac_decoder.io.bundle import load_bundle
    from phytac_decoder.io.frame_sources import open_source
    from phytac_decoder.io.recorded_frames import read_image
    from phytac_decoder.pipeline.colour_calibration import calibrate_rest
    from phytac_decoder.pipeline.decode import measure_frame
    from phytac_decoder.pipeline.drift import DriftReference
    from phytac_decoder.pipeline.rest_frames import pressed_note, take_rest_frames
    from phytac_decoder.serving.exposure_monitor import with_exposure_check
    from phytac_decoder.serving.sensor_loop import check_estimator, follow_decoder, frame_decoder
    from phytac_decoder.serving.tare import TareDecoder
    from phytac_decoder.serving.torn_frames import with_torn_frame_check

    bundle = load_bundle(folder, mount=mount, stiffness_change=stiffness_change / 100.0)
    named = named_regions(regions, bundle, folder, design)
    check_source_count(bundle, source)
    chosen = estimator or bundle.model.best
    check_estimator(bundle, chosen)
    check_rest_options(rest, rest_first)
    if follow and not (rest or rest_first):
        raise InputError(
            "rest-frame-missing",
            "--follow begins at a frame of the unloaded sensor; give it with --rest, or use "
            "--rest-first if the recording begins with it",
        )
    unloaded = [read_image(path) for path in rest or []]
    frames = open_frames(stack, bundle, source, control, **options)
    if rest_first:
        begun = frames
        if not frames.live:
            begun = open_source(source, pace=False, report=options["report"])
            stack.callback(begun.close)
        unloaded = take_rest_frames(bundle, begun, rest_first)
    calibrated = calibrate_rest(bundle, unloaded) if unloaded else bundle
    if rest and (note := pressed_note(measure_frame(calibrated, unloaded).koi)):
        say(f"warning: {note}: forces there are too small")

    def decoder_of(calibrated: "Bundle", unloaded: "Sequence[ImageArray]") -> "Decode":
        reference = DriftReference(calibrated) if drift else None
        if follow:
            return follow_decoder(calibrated, unloaded, estimator=chosen, drift=reference)
        return frame_decoder(calibrated, estimator=chosen, drift=reference)

    taring = TareDecoder(bundle, decoder_of(calibrated, unloaded), decoder_of)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    checked = with_exposure_check(with_torn_frame_check(taring))
    frames.restart()
    return Session(calibrated, frames, named, chosen, checked, taring)


def check_source_count(bundle: "Bundle", source: "Sequence[str]") -> None:
    """Check that there is one source for each camera.

    Raises
    ------
    InputError
        If there is not.
    """
    cameras = len(bundle.cameras)
    if len(source) != cameras:
        each = "one camera: one source" if cameras == 1 else f"{cameras} cameras: one source each"
        raise InputError(
            "camera-count", f"the sensor {bundle.design!r} has {each} (got {len(source)})"
        )


def check_rest_options(rest: list[Path] | None, rest_first: int) -> None:
    """Check that the unloaded sensor is named once.

    Raises
    ------
    InputError
        If it is named twice.
    """
    if rest and rest_first:
        raise InputError(
            "rest-options-exclusive",
            "--rest and --rest-first name the unloaded sensor both; give one of them",
        )


def open_frames(
    stack: contextlib.ExitStack,
    bundle: "Bundle",
    source: list[str],
    control: list[str] | None,
    **options: Any,
) -> "Source":
    """Source of a sensor's frames, which the stack closes.

    Raises
    ------
    InputError
        If a setting of ``--control`` is not valid, or see
        :func:`phytac_decoder.io.frame_sources.open_source`.
    """
    from phytac_decoder.io.camera_device import parse_controls
    from phytac_decoder.io.frame_sources import open_source

    sizes = [(camera.width_px, camera.height_px) for camera in bundle.cameras]
    frames = open_source(source, sizes_px=sizes, controls=parse_controls(control or []), **options)
    stack.callback(frames.close)
    return frames


def rows_text(kept: "Recorders") -> str:
    """How many rows were written to which file."""
    return "".join(f", {recorder.rows} rows in {path}" for path, recorder in kept.items())


def named_regions(
    path: Path | None, bundle: "Bundle", folder: Path, design: str | None
) -> "tuple[Region, ...]":
    """Regions of a file, or the bundle's own.

    Raises
    ------
    InputError
        See :func:`phytac_design.layout.region_chart.bundle_regions`.
    """
    if path is None:
        return bundle.regions
    # Regions by rows and columns need the design; decoding alone must not.
    from phytac_design.layout.region_chart import bundle_regions

    return bundle_regions(path, bundle, folder, design)


def open_topics(
    stack: contextlib.ExitStack,
    messages: "MessageBuilder",
    session: "Session",
    report: "Callable[[str], None]",
    *,
    images: bool,
) -> "tuple[MessageRecorder, Session]":
    """ROS 2 topics of a stream, which the stack ends, and the session that hands them its pictures.

    Raises
    ------
    MissingPartError
        If DDS is not installed.
    InputError, OutputError
        See :class:`phytac_design.core.ros2_topics.Ros2Topics`.
    """
    from phytac_design.core.ros2_topics import TOPICS, Ros2Topics

    topics = Ros2Topics(messages, session.tare.tare, images=images)

    def lost() -> None:
        if topics.dropped:
            report(f"warning: {topics.dropped} frames were not sent over ROS 2: it took too long")

    stack.callback(lost)
    stack.enter_context(topics)
    report(f"ROS 2: topics {TOPICS}... and service {TOPICS}tare in domain {topics.domain}")
    if not topics.local:
        report(
            "warning: whoever is in this network can listen and tare over ROS 2; "
            "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST keeps topics on this machine"
        )
    if images:
        session = session._replace(decode=topics.with_images(session.decode))
    return topics, session


OTHER_KINDS = (".parquet", ".json", ".jsonl", ".npz", ".h5", ".hdf5", ".bag", ".db3", ".xlsx")
"""Names of files that programs read as something other than CSV."""


def _recorder(path: Path, messages: "MessageBuilder") -> Any:
    """Recorder of contacts as Zarr, or as CSV, by the file's name."""
    from phytac_decoder.serving.csv_recording import Recorder

    kind = path.suffix.lower()
    if kind in OTHER_KINDS:
        raise OutputError(
            "output-kind-unknown",
            f"{path} would hold CSV: recordings are .csv, .mcap, .rrd or .zarr, and decode "
            "--parquet writes Parquet",
        )
    if kind != ".zarr":
        return Recorder(path)
    from phytac_design.core.zarr_recording import ZarrRecorder

    return ZarrRecorder(path, len(messages.bundle.position_mm))


def open_recorders(
    stack: contextlib.ExitStack,
    record: Path | None,
    record_regions: Path | None,
    messages: "MessageBuilder",
    *,
    mcap: Path | None = None,
    rerun: bool = False,
) -> "Recorders":
    """Recorders of contacts and of regions' forces, by file; the stack closes them.

    Parameters
    ----------
    stack : ExitStack
        Closes them.
    record, record_regions : Path, optional
        Files; ``record`` ending in .mcap holds ROS 2 messages, in .rrd a recording for Rerun,
        in .zarr the layout of FTP-1.
    messages : MessageBuilder
        Of the stream.
    mcap : Path, optional
        File of ROS 2 messages, of any name.
    rerun : bool
        Show the stream in Rerun's viewer.

    Raises
    ------
    InputError
        If regions are to be kept and there are none.
    OutputError
        If a file cannot be made, or both are one.
    MissingPartError
        If MCAP or Rerun's files cannot be written here.
    """
    from phytac_decoder.serving.csv_recording import RegionRecorder

    names = [region.name for region in messages.regions]
    if record_regions and not names:
        raise InputError(
            "regions-missing",
            "--record-regions keeps the forces of regions; name them with --regions",
        )
    if record and record_regions and record.resolve() == record_regions.resolve():
        raise OutputError(
            "output-name-twice",
            f"--record and --record-regions are one file ({record}); give each a name of its own",
        )
    kept: Recorders = {}
    if record and record.suffix.lower() == ".mcap":
        record, mcap = None, record
    if rerun or (record and record.suffix.lower() == ".rrd"):
        from phytac_design.core.rerun_recording import RerunRecorder

        started_s = messages.started_unix_s
        if record and record.suffix.lower() == ".rrd":
            kept[record] = stack.enter_context(RerunRecorder(record, messages.bundle, started_s))
            record = None
        if rerun:
            viewer = RerunRecorder(None, messages.bundle, started_s)
            kept[Path("Rerun's viewer")] = stack.enter_context(viewer)
    if record:
        kept[record] = stack.enter_context(_recorder(record, messages))
    if mcap:
        from phytac_design.core.mcap_recording import McapRecorder

        kept[mcap] = stack.enter_context(
            McapRecorder(mcap, messages.bundle, messages.started_unix_s)
        )
    if record_regions:
        kept[record_regions] = stack.enter_context(RegionRecorder(record_regions, names))
    return kept
