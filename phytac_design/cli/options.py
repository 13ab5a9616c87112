"""What the commands share: arguments, options, and progress on standard error."""

import errno
import os
import sys
from importlib import resources
from typing import Annotated, Literal

import typer

Preset = Literal["draft", "standard", "fine"]


def complete_design(incomplete: str) -> list[str]:
    """Shipped designs for the shell's completion; it completes names of files itself."""
    folder = resources.files("phytac_design") / "data" / "designs"
    names = sorted(item.name.removesuffix(".toml") for item in folder.iterdir())
    return [name for name in names if name.startswith(incomplete)]


DesignArgument = Annotated[
    str,
    typer.Argument(help="A shipped design or the path of a file.", autocompletion=complete_design),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
SeedOption = Annotated[int, typer.Option(help="Seed of everything random.", min=0, max=2**31 - 1)]


def say(text: str) -> None:
    """Progress goes to standard error, so that standard output stays clean.

    The reader may have closed the pipe; the work continues.
    """
    try:
        typer.echo(text, err=True)
    except OSError as error:
        if error.errno not in {errno.EPIPE, errno.EIO}:
            return
        # What is left in the buffer would fail again at the exit, and spoil its code.
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stderr.fileno())
        os.close(nothing)
