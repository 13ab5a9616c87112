"""Commands checked by the programs' own parsers: words, options, and names that are shipped."""

import re
from collections.abc import Callable, Sequence
from importlib import resources
from importlib.util import find_spec
from typing import Any

from typer.main import get_command

from phytac_design.cli.app import app
from phytac_design.design.accuracy import with_settings
from phytac_design.design.design_file import shipped_designs
from phytac_design.stages import STAGES
from phytac_shapes import REGISTRY
from phytac_shapes.errors import PhytacError
from tests.docs.pages import ROOT

PLACEHOLDER = re.compile(r"^[A-Z][A-Z.…]*$")
"""``DESIGN``, ``LOG``, ``DATA…``: placeholders for the reader's own names."""
GROUP: Any = get_command(app)
PROGRAM_OPTIONS = {"--help", "-h"} | {option for item in GROUP.params for option in item.opts}


def shipped(folder: str) -> list[str]:
    """Names of the files that come with the package."""
    files = resources.files("phytac_design") / "data" / folder
    return [item.name.removesuffix(".toml") for item in files.iterdir()]


def file_or(known: Sequence[str]) -> Callable[[str], bool]:
    """Whether a word is a shipped name, a file of the reader's, or a placeholder."""
    return lambda word: word in known or word.endswith(".toml") or bool(PLACEHOLDER.match(word))


def is_setting(word: str) -> bool:
    from phytac_design.design.accuracy import PRESETS

    try:
        with_settings(PRESETS["draft"], [word])
    except PhytacError:
        return False
    return True


OWN_SHAPES = ("barrel",)
"""Families that a guide adds."""
CHECKS: dict[tuple[str, str], Callable[[str], bool]] = {
    ("*", "design"): file_or(shipped_designs()),
    ("new", "source"): file_or(shipped_designs()),
    ("*", "scene"): file_or(shipped("scenes")),
    ("simulate", "scenario"): file_or(shipped("scenarios")),
    ("sweep", "study"): file_or(shipped("studies")),
    ("optimise", "study"): file_or(shipped("studies")),
    ("shapes", "name"): lambda word: word in (*REGISTRY, *OWN_SHAPES),
    ("*", "settings"): is_setting,
    ("*", "assignments"): is_setting,
}


def phytac_fault(words: Sequence[str]) -> str:
    """What is wrong with a ``phytac`` command; "" if it would run on files of these names."""
    import typer
    from typer._click.exceptions import ClickException

    name, *rest = words
    if name in PROGRAM_OPTIONS:
        return ""
    if name not in GROUP.commands:
        return f"no command {name!r}"
    command = GROUP.commands[name]
    try:
        context = command.make_context(name, list(rest))
    except typer.Exit:
        return ""
    except ClickException as error:
        text = error.format_message()
        # Files of the reader are not there.
        return "" if "does not exist" in text else text
    for parameter, value in context.params.items():
        check = CHECKS.get((name, parameter)) or CHECKS.get(("*", parameter))
        given = value if isinstance(value, list | tuple) else [value]
        wrong = [item for item in given if isinstance(item, str) and item]
        wrong = [item for item in wrong if check is not None and not check(item)]
        if wrong:
            return f"{parameter} of `phytac {name}` cannot be {wrong[0]!r}"
    only = context.params.get("only") if name == "build" else None
    stages = {stage.name for stage in STAGES}
    unknown = [item for item in (only or "").split(",") if item and item not in stages]
    return f"no stage {unknown[0]!r}" if unknown else ""


def inline_fault(words: Sequence[str]) -> str:
    """What is wrong with a command in running text: its name and its options count."""
    name, *rest = words
    if name in PROGRAM_OPTIONS:
        return ""
    if name not in GROUP.commands:
        return f"no command {name!r}"
    known = {option for item in GROUP.commands[name].params for option in item.opts} | {"--help"}
    unknown = [word for word in rest if word.startswith("--") and word.split("=")[0] not in known]
    return f"`phytac {name}` has no {unknown[0]}" if unknown else ""


def python_fault(words: Sequence[str]) -> str:
    """What is wrong with ``python -m MODULE`` or ``python FILE``."""
    if words[:1] == ("-m",):
        return "" if find_spec(words[1]) else f"no module {words[1]!r}"
    return "" if (ROOT / words[0]).is_file() else f"no file {words[0]!r}"


def make_fault(words: Sequence[str]) -> str:
    """What is wrong with ``make TARGET``."""
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    wrong = [word for word in words if "=" not in word and word not in targets]
    return f"no target {wrong[0]!r}" if wrong else ""


def dask_fault(words: Sequence[str]) -> str:
    """What is wrong with ``dask scheduler`` or ``dask worker``."""
    import click
    from distributed.cli import dask_scheduler, dask_worker

    known: dict[str, click.Command] = {
        "scheduler": dask_scheduler.main,
        "worker": dask_worker.main,
    }
    if words[0] not in known:
        return f"no command 'dask {words[0]}'"
    try:
        known[words[0]].make_context(words[0], list(words[1:]))
    except click.ClickException as error:
        return error.format_message()
    return ""


def fault(words: Sequence[str]) -> str:
    """What is wrong with a command; "" if nothing is."""
    program, rest = words[0], tuple(words[1:])
    if program in FREE:
        return ""
    if program not in PROGRAMS:
        return f"no program {program!r} is known here"
    return PROGRAMS[program](rest)


PROGRAMS: dict[str, Callable[[Sequence[str]], str]] = {
    "phytac": phytac_fault,
    "python": python_fault,
    "make": make_fault,
    "dask": dask_fault,
}
FREE = {
    "cd", "ls", "cat", "cp", "ssh", "git", "pip", "uv", "sbatch", "srun", "jupyter", "source",
    "v4l2-ctl", "ffmpeg", "export", "openssl", "umask",
}  # fmt: skip
"""Programs of others, whose words are not checked."""
