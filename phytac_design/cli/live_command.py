"""The command that shows forces in a browser."""

import contextlib
from typing import Annotated

import typer

from phytac_design.cli.console_reporter import ConsoleReporter
from phytac_design.cli.serve_command import (
    BundleArgument,
    ControlOption,
    DesignOption,
    DriftOption,
    EstimatorOption,
    EveryOption,
    FollowOption,
    FpsOption,
    LoopOption,
    MomentAboutOption,
    MountOption,
    RecordOption,
    RegionsOption,
    RestFirstOption,
    RestOption,
    SourceArgument,
    StiffnessOption,
    open_recorders,
    open_session,
    rows_text,
)


def live(
    bundle: BundleArgument,
    source: SourceArgument,
    fps: FpsOption = None,
    port: Annotated[
        int, typer.Option(help="Port of this machine; 0 chooses a free one.", min=0, max=65535)
    ] = 8057,
    estimator: EstimatorOption = None,
    rest: RestOption = None,
    rest_first: RestFirstOption = 0,
    mount: MountOption = "bench",
    stiffness_change: StiffnessOption = 2.0,
    drift: DriftOption = True,
    follow: FollowOption = False,
    regions: RegionsOption = None,
    design: DesignOption = None,
    record: RecordOption = None,
    moment_about: MomentAboutOption = (0.0, 0.0, 0.0),
    control: ControlOption = None,
    every: EveryOption = False,
    loop: LoopOption = False,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Show the stream in Rerun's viewer, too (extra rerun).")
    ] = False,
) -> None:
    """Show forces in a browser of this machine, until the source ends or Ctrl-C."""
    from phytac_decoder.serving.live_view import LiveView
    from phytac_decoder.serving.sensor_loop import Stream

    stopped = False
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
        frames, messages = session.source, session.messages(moment_about)
        view = stack.enter_context(LiveView(messages.hello(), port=port, tare=session.tare.tare))
        kept = open_recorders(stack, record, None, messages, rerun=rerun)
        report(f"{session.bundle.design}: {frames.description}; look at {view.url}; Ctrl-C stops")
        for limit in session.bundle.limits(session.estimator):
            report(f"warning: {limit}")
        stream = Stream(
            source=frames,
            decode=session.decode,
            messages=messages,
            publish=view.publish,
            recorders=list(kept.values()),
            tare_result=session.tare.result,
            report=report,
        )
        try:
            stream.run()
        except KeyboardInterrupt:
            view.close("stopped")
            stopped = True
    typer.echo(f"{stream.progress.total()}{rows_text(kept)}")
    if stopped:
        raise typer.Exit(130)
