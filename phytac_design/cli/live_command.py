"""The command that shows forces in a browser."""

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.console_reporter import ConsoleReporter
from phytac_design.cli.serve_command import (
    DesignOption,
    EstimatorOption,
    EveryOption,
    FollowOption,
    FpsOption,
    LoopOption,
    RecordOption,
    RegionsOption,
    RestFirstOption,
    RestOption,
    SourceArgument,
    check_sources,
    decoder_of,
    named_regions,
    open_recorders,
    rest_images,
)


def live(
    bundle: Annotated[Path, typer.Argument(help="Decoder folder, as in exports/NAME/decoder.")],
    source: SourceArgument,
    fps: FpsOption = None,
    port: Annotated[
        int, typer.Option(help="Port of this machine; 0 takes a free one.", min=0, max=65535)
    ] = 8057,
    estimator: EstimatorOption = None,
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    follow: FollowOption = False,
    regions: RegionsOption = None,
    design: DesignOption = None,
    record: RecordOption = None,
    every: EveryOption = False,
    loop: LoopOption = False,
) -> None:
    """Show forces in a browser of this machine, until the source ends or Ctrl-C."""
    import signal
    import time

    from phytac_decoder.io.bundle import load_bundle
    from phytac_decoder.io.frame_sources import open_source
    from phytac_decoder.serving.live_view import LiveView
    from phytac_decoder.serving.sensor_loop import Stream
    from phytac_decoder.serving.wire_protocol import MessageBuilder

    loaded = load_bundle(bundle)
    named = named_regions(regions, loaded, bundle, design)
    check_sources(loaded.design, len(loaded.cameras), source)
    chosen = estimator or loaded.model.best
    unloaded = rest_images(loaded, rest or [], source, rest_first)
    decode = decoder_of(loaded, unloaded, estimator=chosen, follow=follow)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    stopped = False
    with contextlib.ExitStack() as stack:
        tell = stack.enter_context(ConsoleReporter())
        frames = open_source(
            source,
            fps=fps,
            every=every,
            loop=loop,
            size_px=(loaded.camera.width_px, loaded.camera.height_px),
            report=tell,
        )
        stack.callback(frames.close)
        messages = MessageBuilder(
            bundle=loaded,
            estimator=chosen,
            source=frames.said,
            clock=frames.clock,
            started_unix_s=time.time(),
            regions=named,
        )
        view = stack.enter_context(LiveView(messages.hello(), port=port))
        kept = open_recorders(stack, record, None, [])
        tell(f"{loaded.design}: {frames.said}; look at {view.url}; Ctrl-C stops")
        stream = Stream(
            source=frames,
            decode=decode,
            messages=messages,
            publish=view.publish,
            recorders=list(kept.values()),
            report=tell,
        )
        try:
            stream.run()
        except KeyboardInterrupt:
            view.close("stopped")
            stopped = True
    wrote = "".join(f", {recorder.rows} rows in {path}" for path, recorder in kept.items())
    typer.echo(f"{stream.progress.total()}{wrote}")
    if stopped:
        raise typer.Exit(130)
