"""The command ``phytac``: short calls into the library, one clear line for every error."""

import atexit
import gc
import os
import sys
from collections.abc import Callable
from importlib import metadata
from typing import Annotated

import typer

from phytac_design.core.threads import BLAS_THREADS

# One BLAS thread, set before numpy loads and whatever the user's environment says: results are the
# same, byte for byte. The sparse solver's many small products run several times slower on two.
os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))

from phytac_design.cli import (
    advise_command,
    build_command,
    cache_command,
    calibrate_instance_command,
    camera_command,
    check_command,
    compare_command,
    decode_command,
    export_command,
    import_command,
    inspect_command,
    live_command,
    mechanics_commands,
    new_command,
    paints_command,
    plan_command,
    serve_command,
    simulate_commands,
    studio_command,
    study_commands,
    switch_command,
    tradeoff_command,
    train_command,
    watch_command,
)
from phytac_design.cli.options import JsonOption, say
from phytac_design.cli.output import print_json
from phytac_shapes.errors import MissingPartError, PhytacError

app = typer.Typer(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Build a camera-based force sensor from one design file: shell, markers, decoder.",
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"phytac {metadata.version('phytac-design')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version)
    ] = False,
) -> None:
    """Options of the program itself; each acts in its own callback."""


def schema() -> None:
    """Print the JSON Schema of design files."""
    from phytac_design.design.spec import Design

    print_json(Design.model_json_schema())


def shapes(
    name: Annotated[
        str, typer.Argument(help="A family; the command then shows its drawing and variables.")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """List the surface families, and the fields that each needs in a design file."""
    from phytac_design.design.catalogue import shape_facts, shape_list, shape_page

    if as_json:
        print_json(shape_facts())
    else:
        typer.echo(shape_page(name) if name else shape_list())


PANELS: dict[str, tuple[Callable[..., None], ...]] = {
    "Design": (
        new_command.new,
        check_command.check,
        advise_command.advise,
        studio_command.studio,
        compare_command.compare,
        shapes,
        paints_command.paints,
    ),
    "Make": (
        build_command.build,
        watch_command.watch,
        mechanics_commands.press,
        mechanics_commands.mesh,
        switch_command.switch,
        inspect_command.inspect,
        export_command.export,
        train_command.export_onnx,
    ),
    "Decode": (
        decode_command.decode,
        live_command.live,
        serve_command.serve,
        camera_command.camera,
        train_command.train,
        train_command.evaluate,
        calibrate_instance_command.calibrate_instance,
        mechanics_commands.calibrate,
        serve_command.convert,
    ),
    "Simulate": (
        simulate_commands.simulate,
        simulate_commands.scenarios,
        import_command.import_,
        import_command.import_markers,
    ),
    "Explore": (
        study_commands.sweep,
        study_commands.optimise,
        tradeoff_command.tradeoff,
        plan_command.plan,
    ),
    "Maintain": (cache_command.cache, schema),
}
"""Commands by their panel of the help, in the order of the help."""
for panel, commands in PANELS.items():
    for command in commands:
        # `import` is a keyword of Python.
        name = command.__name__.strip("_").replace("_", "-")
        app.command(name, rich_help_panel=panel)(command)


EXTRAS = {
    "design": (
        "OCP cadquery lib3mf manifold3d matplotlib meshio numba OpenGL pyarrow pydantic "
        "pyrender scipy tomlkit trimesh yaml"
    ),
    "solid": "gmsh",
    "train": "onnx",
    "study": "dask distributed optuna",
    "studio": "starlette uvicorn",
}
"""Libraries of each extra, by the names they are imported with."""


def main() -> None:
    """Run the command line; a user's error is one line on standard error and an exit code."""
    # At exit Python looks for garbage among all modules, which takes 0.25 s. Whoever opens a file
    # closes it.
    atexit.register(gc.freeze)
    try:
        app(prog_name="phytac")
    except PhytacError as error:
        say(f"error[{error.code}]: {error}")
        sys.exit(error.exit_code)
    except ModuleNotFoundError as error:
        library = str(error.name).partition(".")[0]
        extra = next((name for name, parts in EXTRAS.items() if library in parts.split()), "")
        if not extra:
            raise
        say(
            f"error[missing-library]: this command needs {library}, which is not installed: "
            f"pip install 'phytac-design[{extra}]'"
        )
        sys.exit(MissingPartError.exit_code)
