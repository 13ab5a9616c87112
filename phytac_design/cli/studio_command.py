"""The command that shows a design with controls in a browser."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import say


def studio(
    design: Annotated[
        str, typer.Argument(help="A shipped design or the path of a design file.")
    ] = "cylinder60",
    port: Annotated[
        int, typer.Option(help="Port of this machine; 0 takes a free one.", min=0, max=65535)
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Edit a design with controls in a browser of this machine, until Ctrl-C.

    Designs are read from and saved in the current folder; builds are written to its subfolder
    `exports`, and its studies are listed.
    """
    from phytac_design.studio.server import StudioServer

    server = StudioServer(Path.cwd(), design, port=port)

    def ready(url: str) -> None:
        say(f"the studio of {Path.cwd()}: {url} (for this machine only; Ctrl-C stops)")
        if browser and not webbrowser.open(url):
            say("no browser was found; open that address in one")

    try:
        server.run(ready=ready)
    except KeyboardInterrupt:
        say("stopped")
        raise typer.Exit(130) from None
