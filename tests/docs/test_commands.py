"""Every command of README and docs: run on a small sensor, or checked by the program's parser."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.design.design_file import to_toml
from phytac_design.stages.build import BuildResult
from phytac_design.workflows.export_simulator import export_simulator
from tests.coarse_switches import coarse_bowls
from tests.designs import small
from tests.docs.pages import PAGES, Command, commands, inline
from tests.docs.parser import OWN_SHAPES, fault, inline_fault

ALL = commands(PAGES)
RUN = {
    "check", "new", "shapes", "press", "mesh", "decode", "scenarios", "plan", "cache",
    "sweep", "optimise", "export", "schema",
}  # fmt: skip
"""Commands that run here if the fixture ``shop`` has their files; all others are parsed only."""
PARSED = {
    "build": "minutes; tests/test_build.py, tests/test_cli_build.py",
    "watch": "runs until Ctrl-C; tests/test_cli_watch.py",
    "switch": "solves a bowl, a quarter of a minute; tests/mechanics/switch",
    "compare": "needs two whole builds; tests/report",
    "studio": "needs a browser; tests/studio",
    "advise": "a minute; tests/study/advice",
    "train": "needs data; tests/test_train.py",
    "evaluate": "needs data; tests/test_evaluate.py",
    "camera": "needs a camera; tests/decoder/test_camera_check.py",
    "live": "needs a camera; tests/test_cli_live.py",
    "paints": "needs a photo; tests/optics/test_measured_paints.py",
    "inspect": "needs a photo; tests/test_inspect.py",
    "serve": "needs a camera; tests/test_cli_serve.py",
    "calibrate": "needs measurements; tests/test_calibrate_cli.py",
    "calibrate-instance": "needs a camera; tests/test_calibrate_instance.py",
    "simulate": "minutes; tests/test_simulate.py",
    "tradeoff": "minutes; tests/study",
    "import": "needs a decoder of the rig; tests/simulation/test_rig.py",
    "import-markers": "needs public data; tests/test_marker_data.py",
    "convert": "needs a recording; tests/test_recording.py",
    "export-onnx": "needs a trained decoder; tests/test_onnx.py",
}
"""Commands that are parsed only, why, and where they are tested."""
FILE = re.compile(r"/|\.[A-Za-z]")
"""A word that names a file or a folder."""
DEVICES = ("0", "--serial", "--scheduler", "--workers", "--build", "--from-step")
"""Words of lines that need a device, other processes or minutes."""


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory, built: BuildResult) -> Path:
    """A reader's folder: design, build and frames under the names that the docs use."""
    folder = tmp_path_factory.mktemp("shop")
    (folder / "mine.toml").write_text(to_toml(small(name="mine")))
    shutil.copytree(built.out, folder / "exports" / "mine")
    shutil.copytree(built.out / "decoder", folder / "my-decoder")
    views = built.out / "views"
    shutil.copyfile(views / "frame_pressed.png", folder / "frame.png")
    shutil.copyfile(views / "frame_rest.png", folder / "rest.png")
    with coarse_bowls():  # `export` finds them in the cache
        export_simulator(small(name="mine"), folder / "first", to="sdf", progress=lambda _: None)
    (folder / "frames").mkdir()
    for number, name in enumerate(["rest"] * 5 + ["pressed"]):
        shutil.copyfile(views / f"frame_{name}.png", folder / "frames" / f"{number}.png")
    return folder


def runs(command: Command) -> bool:
    """Whether a line is run here: a quick command, on files that the shop has."""
    words = command.words
    if words == ("phytac", "new"):
        return False  # asks in a terminal; tests/test_new_by_questions.py
    if words[0] != "phytac" or words[1] not in RUN or set(words) & {*DEVICES, *OWN_SHAPES}:
        return False
    # Files that the shop has; what is written (--out) need not exist.
    had = {"mine.toml", "exports/mine/decoder", "my-decoder", "frame.png", "rest.png", "frames/"}
    return all(
        word in had or words[k] == "--out" for k, word in enumerate(words[1:]) if FILE.search(word)
    ) and not (words[1] in {"sweep", "optimise"} and "--measures" not in words and len(words) > 2)


@contextmanager
def coarse_checks() -> Iterator[None]:
    """Switches on the coarse mesh; no other test takes them for the exact ones."""
    with pytest.MonkeyPatch.context() as patch, coarse_bowls():
        patch.setenv("PHYTAC_CACHE", os.environ["PHYTAC_CACHE"] + "-coarse-checks")
        yield


@pytest.mark.parametrize("command", ALL, ids=str)
def test_every_command_is_one(command: Command) -> None:
    assert fault(command.words) == ""


@pytest.mark.parametrize("command", inline(PAGES), ids=str)
def test_commands_in_running_text_exist(command: Command) -> None:
    assert inline_fault(command.words[1:]) == ""


def test_every_command_is_run_or_has_a_reason_not_to_be() -> None:
    named = {command.words[1] for command in ALL if command.words[0] == "phytac"}
    assert named <= RUN | set(PARSED)
    assert {command.words[1] for command in ALL if runs(command)} == RUN


LARGE = ("phytac", "check", "cylinder60")
"""On the published sensor; the same command of the reader's own design is as every other."""


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(words, id=" ".join(words), marks=[pytest.mark.long] * (words == LARGE))
        for words in sorted({command.words for command in ALL if runs(command)})
    ],
)
def test_quick_commands_run_as_they_stand(words: tuple[str, ...], shop: Path) -> None:
    home = Path.cwd()
    os.chdir(shop)
    try:
        # Delete what an earlier `new` wrote.
        for made in ("--out", "new"):
            if made in words:
                name = words[words.index(made) + 1]
                shutil.rmtree(shop / name, ignore_errors=True)
                if name != "mine":
                    (shop / f"{name}.toml").unlink(missing_ok=True)
        if words[1] == "new" and words[2] == "mine":
            words = (*words, "--out", "other.toml")
            (shop / "other.toml").unlink(missing_ok=True)
        with coarse_checks() if words[1] == "check" else nullcontext():
            done = CliRunner().invoke(app, list(words[1:]), catch_exceptions=False)
    finally:
        os.chdir(home)
    assert done.exit_code == 0, done.output
    assert done.stdout.strip()


def test_help_imports_nothing_heavy() -> None:
    """``phytac --help`` is fast: libraries are imported when a command needs them."""
    code = (
        "import sys\nimport phytac_design.cli.app\n"
        "heavy = 'scipy numba cv2 pydantic matplotlib cadquery torch pyrender optuna distributed'\n"
        "print(sorted(set(heavy.split()) & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
