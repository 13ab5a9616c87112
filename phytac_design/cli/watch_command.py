"""``phytac watch``: a design is built again whenever its file is saved."""

import json
import re
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from phytac_design.cli.options import Preset, SeedOption, check_out, say
from phytac_design.cli.output import names_of, resumable
from phytac_design.engine.cache import file_hash
from phytac_shapes.errors import InputError, PhytacError

PAGE = """<!doctype html>
<meta charset="utf-8">
<title>report</title>
<style>
html, body { margin: 0; height: 100%; overflow: hidden }
iframe { width: 100%; height: 100%; border: 0 }
#state { position: fixed; right: 0; bottom: 0; margin: 0; padding: 0.3em 1em; max-width: 80%;
  font: 14px sans-serif; background: #fffd; color: #222 }
#state.failed { left: 0; max-width: none; background: #a00; color: #fff }
</style>
<iframe title="report" src="report.html"></iframe>
<p id="state" role="status"></p>
<script>
let shown;
function state(build, text, failed) {
  const line = document.getElementById("state");
  line.textContent = text;
  line.className = failed ? "failed" : "";
  if (shown !== undefined && shown !== build)
    document.querySelector("iframe").src = "report.html?" + build;
  shown = build;
}
function ask() {
  const script = document.createElement("script");
  script.src = "watch.js?" + Date.now();
  script.onload = script.onerror = () => script.remove();
  document.head.append(script);
}
ask();
setInterval(ask, 1000);
</script>
"""
"""Shows the report, and shows it again after a build; pages opened as files cannot use fetch."""


NAMED = re.compile(r'"([^"\n]{1,200})"')
"""Texts of a design file, some of which are paths of other files."""


class SavedError(BaseException):
    """The design was saved again during its build. No ``Exception``: no stage has failed."""


def watch(
    design: Annotated[Path, typer.Argument(help="The design file.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(callback=check_out, help="The build's own folder; exports/NAME if not given."),
    ] = None,
    accuracy: Annotated[
        Preset, typer.Option(help="Preset, a trade of speed against accuracy.")
    ] = "draft",
    only: Annotated[
        str, typer.Option(help="Stages to run, comma separated; the stages that they need run too.")
    ] = "",
    workers: Annotated[
        int | None,
        typer.Option(help="Processes, as of phytac build; one for each core if not given.", min=1),
    ] = None,
    seed: SeedOption = 0,
) -> None:
    """Build a design whenever its file is saved, and refresh the open report, until Ctrl-C.

    A save during a build stops it; finished stages are kept.
    """
    from phytac_design.cli.build_display import BuildDisplay
    from phytac_design.core.threads import workers as usable_cores
    from phytac_design.design.accuracy import settings_of
    from phytac_design.design.design_file import load_design
    from phytac_design.stages.build import build
    from phytac_design.study.planning.cost import stage_costs

    if not design.is_file():
        raise InputError(
            "watch-without-file",
            f"no design file at {design}; phytac new makes one, and one to change from a shipped "
            "design",
        )
    settings, names = settings_of(accuracy), names_of(only) or None
    target = out

    def build_once(seen: Saved) -> tuple[str, bool]:
        """Build what was saved; what there is to say about it, and whether it failed."""
        nonlocal target
        try:
            loaded = load_design(str(design))
            target = out or Path("exports") / loaded.name
            with BuildDisplay() as display:

                def progress(text: str) -> None:
                    if saved(design) not in {seen, ()}:
                        raise SavedError
                    display(text)

                result = build(
                    loaded,
                    target,
                    accuracy=settings,
                    only=names,
                    seed=seed,
                    progress=progress,
                    workers=workers or usable_cores(),
                    costs=partial(stage_costs, loaded, settings),
                )
        except PhytacError as error:
            return f"NOT BUILT: error[{error.code}]: {error}", True
        return f"{target}: {len(result.ran)} stages run, {result.seconds:.1f} s", False

    with resumable("stopped"):
        seen: Saved = ()
        while True:
            now = saved(design)
            if now in {seen, ()}:
                time.sleep(0.3)
                continue
            seen = now
            with suppress(SavedError):
                said, failed = build_once(seen)
                text = f"{time.strftime('%H:%M:%S')} {said}"
                # Colours are left out where the stream is no terminal.
                typer.secho(text, err=True, fg="red" if failed else None, bold=failed)
                if target and write_page(target, text, failed=failed):
                    page = target / "report" / "watch.html"
                    say(f"{page} shows the last build that succeeded" if failed else f"open {page}")


Saved = tuple[tuple[str, int, int], ...]


def saved(design: Path) -> Saved:
    """Path, time and size of a design file and of the files that it names; () if it is not there.

    Editors that replace a file leave none for a moment.
    """
    try:
        text = design.read_text(encoding="utf-8", errors="replace")
        paths = [design, *(design.parent / name for name in NAMED.findall(text))]
        states = [(path, path.stat()) for path in paths if path.is_file()]
    except OSError:
        return ()
    return tuple((str(path), state.st_mtime_ns, state.st_size) for path, state in states)


def write_page(out: Path, text: str, *, failed: bool = False) -> bool:
    """Write the page that shows the report of a build, and what it reads; False without a report.

    Parameters
    ----------
    text : str
        Outcome of the last build.
    failed : bool
        Whether it failed; the report is then that of an earlier one.
    """
    report = out / "report" / "report.html"
    if not report.is_file():
        return False
    page = report.with_name("watch.html")
    if not page.is_file():
        page.write_text(PAGE, encoding="utf-8")
    partial_file = report.with_name(".watch.js.part")
    build = file_hash(report)[:16]
    call = ", ".join(map(json.dumps, (build, text, failed)))
    partial_file.write_text(f"state({call});\n", encoding="utf-8")
    partial_file.replace(report.with_name("watch.js"))
    return True
