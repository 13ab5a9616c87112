"""``phytac compare``: two or more builds side by side."""

from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import JsonOption, check_out
from phytac_design.cli.output import print_json


def compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Folders of whole builds, two or more.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(callback=check_out, help="Page to write; comparison.html if not given."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare builds: key figures, differences of their designs, maps and shells."""
    from phytac_design.report.built_sensors import read_builds
    from phytac_design.report.compare import compare_page, comparison
    from phytac_shapes.errors import InputError, OutputError

    if len(folders) < 2:
        raise InputError(
            "comparison-too-few",
            f"a comparison needs two builds or more (got {len(folders)}); name another folder",
        )
    builds = read_builds(folders)
    if as_json:
        print_json(comparison(builds))
    if as_json and out is None:
        return
    target = out or Path("comparison.html")
    try:
        target.write_text(compare_page(builds), encoding="utf-8")
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {target}: {error.strerror}; choose another --out"
        ) from None
    if not as_json:
        typer.echo(f"wrote {target}: {', '.join(build.label for build in builds)}")
