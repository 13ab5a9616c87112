"""What the commands share: arguments, options, and progress on standard error."""

import errno
import os
import stat
import sys
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import typer

from phytac_shapes.errors import OutputError

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
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
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


def check_out(out: Path | None) -> Path | None:
    """Return an ``--out`` whose nearest existing folder may be written, before any work.

    Raises
    ------
    OutputError
        If it lies below a file, or permissions forbid to look there or to write.
    """
    for place in (out, *out.parents) if out else ():
        reason: object = ""
        try:
            mode = place.stat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            continue  # its parents show why
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
        else:
            if not stat.S_ISDIR(mode):
                reason = "" if place == out else f"{place} is not a folder"
            elif not os.access(place, os.W_OK | os.X_OK):
                reason = f"no permission to write in {place}"
        if reason:
            raise OutputError(
                "output-not-writable", f"cannot write {out}: {reason}; choose another --out"
            )
        break
    return out
