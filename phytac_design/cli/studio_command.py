"""The command that shows a design with controls in a browser."""

import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import say


def studio(
    design: Annotated[
        str, typer.Argument(help="A shipped design or the path of a design file.")
    ] = "cylinder60",
    port: Annotated[
        int, typer.Option(help="Port of this machine; 0 chooses a free one.", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Edit a design with controls in a browser of this machine, until Ctrl-C.

    Designs are read from and saved in the current folder; builds are written to its subfolder
    `exports`, and its studies are listed.
    """
    from phytac_design.studio.redirect_file import opened_in_browser
    from phytac_design.studio.server import StudioServer

    server = StudioServer(Path.cwd(), design, port=port)
    ended_by: list[int] = []

    def end(number: int, _frame: object) -> None:
        ended_by.append(number)
        raise KeyboardInterrupt

    # The server raises a signal again after its end: nothing would be cleaned up by default.
    signal.signal(signal.SIGTERM, end)
    try:
        with ExitStack() as stack:

            def ready(url: str) -> None:
                say(f"the studio of {Path.cwd()}: {url} (for this machine only; Ctrl-C stops)")
                if browser and not stack.enter_context(opened_in_browser(url, Path.cwd())):
                    say("no browser was found; open that address in one")

            server.run(ready=ready)
    except KeyboardInterrupt:
        say("stopped")
        for number in ended_by:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        raise typer.Exit(130) from None
