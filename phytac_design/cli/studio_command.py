"""The command that shows a design with controls in a browser."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import say
from phytac_shapes.errors import MissingPartError


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
    """Change a design and see it: controls in a browser of this machine, until Ctrl-C.

    Designs are read from and saved into the folder that this is started in; builds go into its
    folder `exports`, studies are found in it.
    """
    try:
        from phytac_design.studio.server import StudioServer, open_browser
    except ModuleNotFoundError as error:
        if error.name not in {"starlette", "uvicorn"}:
            raise
        raise MissingPartError(
            f"the studio needs {error.name}; pip install 'phytac-design[studio]'"
        ) from None
    running = StudioServer(Path.cwd(), design, port=port)

    def ready(url: str) -> None:
        say(f"the studio of {Path.cwd()}: {url} (for this machine alone; Ctrl-C stops)")
        if browser and not open_browser(url):
            say("no browser was found; open that address in one")

    try:
        running.run(ready=ready)
    except KeyboardInterrupt:
        say("stopped")
        raise typer.Exit(130) from None
