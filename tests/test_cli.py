"""The command line as a person uses it: output, exit codes, one line for every error."""

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from phytac_design import __version__
from phytac_design.cli.app import PANELS, app, main
from phytac_design.stages.build import BuildResult

PHYTAC = [sys.executable, "-c", "from phytac_design.cli.app import main; main()"]
"""A process of its own: starting one takes a second."""


def phytac(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The same in this process."""
    out, errors, code = io.StringIO(), io.StringIO(), 0
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        patch.setattr(sys, "argv", ["phytac", *words])
        if cwd is not None:
            patch.chdir(cwd)
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    for number, handler in handlers.items():
        signal.signal(number, handler)
    return subprocess.CompletedProcess(words, code, out.getvalue(), errors.getvalue())


def test_a_process_says_the_same(tmp_path: Path) -> None:
    for words in (["check", str(tmp_path / "nowhere.toml")], ["shapes"]):
        alone = subprocess.run([*PHYTAC, *words], capture_output=True, text=True, check=False)
        here = phytac(*words)
        assert (here.returncode, here.stdout, here.stderr) == (
            alone.returncode,
            alone.stdout,
            alone.stderr,
        )
        assert bool(alone.stderr) == bool(alone.returncode)


def test_help_lists_the_commands() -> None:
    out = phytac("--help")
    assert out.returncode == 0
    for word in ("build", "check", "decode", "new", "schema"):
        assert word in out.stdout


def test_every_command_belongs_to_one_panel() -> None:
    assert list(PANELS) == ["Design", "Make", "Decode", "Simulate", "Explore", "Maintain"]
    placed = [command for commands in PANELS.values() for command in commands]
    registered = [info.callback for info in app.registered_commands]
    assert sorted(map(id, placed)) == sorted(map(id, registered))
    assert len(set(placed)) == len(placed)
    for info in app.registered_commands:
        assert info.callback in PANELS[str(info.rich_help_panel)]
    out = phytac("--help").stdout
    places = [out.index(f" {panel} ─") for panel in ("Options", *PANELS)]
    assert places == sorted(places)


@pytest.mark.parametrize("name", ["", *(str(info.name) for info in app.registered_commands)])
def test_help_has_a_short_form(name: str) -> None:
    long, short = (phytac(*name.split(), word) for word in ("--help", "-h"))
    assert short.returncode == long.returncode == 0
    assert short.stdout == long.stdout
    assert "Usage: phytac" in short.stdout


def test_help_texts_are_no_markup() -> None:
    """Rich takes words in square brackets for markup and drops them."""
    group: Any = get_command(app)
    for name, command in group.commands.items():
        for text in (command.help, *(item.help or "" for item in command.params)):
            assert not re.search(r"\[[a-z/]", text), name


def test_version() -> None:
    assert phytac("--version").stdout == f"phytac {__version__}\n"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("phytac ch", ["check"]),
        ("phytac check cylinder4", ["cylinder40"]),
        ("phytac build grip --acc", ["--accuracy"]),
    ],
)
def test_the_shell_completes(line: str, words: list[str]) -> None:
    asked = {"_PHYTAC_COMPLETE": "complete_bash", "COMP_WORDS": line}
    done = subprocess.run(
        PHYTAC,
        env={**os.environ, **asked, "COMP_CWORD": str(line.count(" "))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == words, done.stderr


def test_schema_is_json() -> None:
    schema = json.loads(phytac("schema").stdout)
    assert schema["additionalProperties"] is False
    assert "wall" in schema["properties"]


@pytest.mark.usefixtures("coarse_switches")
def test_new_then_check(tmp_path: Path) -> None:
    made = phytac("new", "mine", "--from", "cylinder60", cwd=tmp_path)
    assert made.returncode == 0
    assert made.stdout.splitlines()[-1] == "next: edit it, then phytac check mine.toml"
    text = (tmp_path / "mine.toml").read_text()
    small_camera = (
        text.replace("width_px = 2592", "width_px = 1296")
        .replace("height_px = 1944", "height_px = 972")
        .replace("focal_px = 970.0", "focal_px = 485.0")
        .replace("rows = 23", "rows = 10")
    )
    (tmp_path / "mine.toml").write_text(small_camera)
    out = phytac("check", "mine.toml", "--json", cwd=tmp_path)
    assert out.returncode == 0, out.stderr
    report = json.loads(out.stdout)
    assert report["markers"]["count"] == 160
    assert report["clear"] is True
    assert not (tmp_path / "exports").exists()


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("check", "cylinder6"), 2, "error[toml-file-not-found]: no design 'cylinder6'"),
        (("build", "cylinder60", "--only", "mseh"), 2, "did you mean 'mesh'"),
        (("build", "cylinder60", "--seed", "99999999999999999999"), 2, "seed"),
        (
            ("decode", "nowhere", "x.png"),
            4,
            "error[bundle-not-found]: no decoder bundle in nowhere",
        ),
    ],
)
def test_errors_are_one_line(
    words: tuple[str, ...], code: int, message: str, tmp_path: Path
) -> None:
    out = phytac(*words, cwd=tmp_path)
    assert out.returncode == code
    assert message in out.stderr
    if out.stderr.startswith("error["):  # the command's own words are explained in a box
        assert len(out.stderr.strip().splitlines()) == 1
    assert "Traceback" not in out.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_build_ends_with_its_verdict(built: BuildResult, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phytac_design.stages.build.build", lambda *_, **__: built)
    out = phytac("build", "cylinder60", "--out", str(built.out))
    assert out.returncode == 0, out.stderr
    report = json.loads((built.out / "report" / "report.json").read_text())
    *_, page, after = lines = out.stdout.splitlines()
    verdict = next(line for line in lines if "hidden" in line)
    for text in report["changes"]:
        assert f"to change or to mind: {text}" in lines
    assert report["changes"]
    gap = report["visibility"]["min_gap_px"]
    assert "0 hidden, 0 fused (must be 0)" in verdict
    assert f"smallest gap of one colour {gap:.1f} px (needs more than 2)" in verdict
    assert page == f"open {built.out / 'report' / 'report.html'}"
    assert after.startswith(f"next: phytac decode {built.out / 'decoder'} ")
    # A build of some stages has no report.
    part = replace(built, ran=("shell",), cached=())
    monkeypatch.setattr("phytac_design.stages.build.build", lambda *_, **__: part)
    out = phytac("build", "cylinder60", "--out", str(built.out), "--only", "shell")
    assert out.stdout.splitlines()[-1].startswith("next: phytac build cylinder60")


def test_decode_prints_newtons(built: BuildResult, tmp_path: Path) -> None:
    views, decoder = built.out / "views", str(built.out / "decoder")
    words = ("decode", decoder, str(views / "frame_pressed.png"))
    out = phytac(*words, "--rest", str(views / "frame_rest.png"), "--json")
    assert out.returncode == 0, out.stderr
    result = json.loads(out.stdout)
    truth = json.loads((views / "frame_pressed.json").read_text())
    assert set(result["forces_N"]) == set(truth)
    assert result["total_N"] == pytest.approx(sum(truth.values()), rel=0.3)
    assert result["true_forces_N"] == truth
    switched = [one for one in result["contacts"] if one["markers"]]
    assert switched
    for one in switched:
        wanted_N = sum(truth.get(str(marker), 0.0) for marker in one["markers"])
        assert one["true_force_N"] == pytest.approx(wanted_N, abs=1e-3)
    plain = phytac(*words)
    assert "markers found" in plain.stdout
    assert " N on " in plain.stdout
    assert plain.stdout.count(" N  (true: ") == len(truth)
    assert f"rendered with {sum(truth.values()):.2f} N on {len(truth)} receptors" in plain.stdout
    assert "0 not found, 0 switches on where nothing presses" in plain.stdout
    assert "side the 90 % interval of " in plain.stdout
    verdict, after = plain.stdout.splitlines()[-2:]
    assert re.fullmatch(
        r"the frame is good: 100% of the markers found \(needs 95%\)"
        r"(; but (a contact|contacts) of [\d., ]+ N reach(es)? over the end of the sensing surface"
        r": .*)?",
        verdict,
    )
    assert after.startswith("next: give --rest FRAME")
    with_rest = phytac(*words, "--rest", str(views / "frame_rest.png")).stdout
    assert with_rest.splitlines()[-1].startswith(f"next: phytac live {decoder} 0")
    wrong = phytac("decode", decoder, str(views / "straight.png")[:-4] + ".jpg")
    assert wrong.returncode == 4
    assert "no image at" in wrong.stderr
    (tmp_path / "not.png").write_text("hello")
    assert "is not an image" in phytac("decode", decoder, str(tmp_path / "not.png")).stderr
