"""``phytac watch``: a save builds again, also a bad one, and the page shows the last report."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.cli.watch_command import saved, write_page
from phytac_design.design.design_file import to_toml
from phytac_design.design.spec import Design
from tests.designs import tiny
from tests.refusals import refused


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A watch of ``mine.toml`` that builds the mesh alone."""
    (tmp_path / "mine.toml").write_text(to_toml(tiny()))
    words = [sys.executable, "-m", "phytac_design", "watch", "mine.toml", "--only", "mesh"]
    path = os.pathsep.join(filter(None, sys.path))
    process = subprocess.Popen(
        [*words, "--out", "x", "--workers", "1"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": path, "PHYTAC_CACHE": str(tmp_path / "cache")},
        stderr=subprocess.PIPE,
        text=True,
    )
    yield process
    process.kill()
    process.communicate()


def line_with(process: subprocess.Popen[str], text: str) -> str:
    """Next line that holds a text."""
    assert process.stderr is not None
    while line := process.stderr.readline():
        if text in line:
            return line
    raise AssertionError(f"no line with {text!r}")


def save(path: Path, text: str) -> None:
    """Save as editors do: another file takes the place."""
    path.with_suffix(".new").write_text(text)
    path.with_suffix(".new").replace(path)


def test_each_save_builds_what_it_changes(watched: subprocess.Popen[str], tmp_path: Path) -> None:
    design, mesh = tmp_path / "mine.toml", tmp_path / "x" / "mesh" / "shell.inp"
    assert "x: 1 stages run" in line_with(watched, "stages run")
    before = mesh.read_bytes()
    save(design, to_toml(tiny()).replace("length_mm = 24.0", "length_mm = -24.0"))
    assert "NOT BUILT: error[field-invalid]" in line_with(watched, "error[")
    assert mesh.read_bytes() == before
    save(design, to_toml(tiny(material={"modulus_MPa": 1235.0})))
    assert "x: 1 stages run" in line_with(watched, "stages run")
    assert b"1235" in mesh.read_bytes()
    watched.send_signal(signal.SIGINT)
    watched.communicate(timeout=20.0)
    assert watched.returncode == 130


def test_a_save_during_a_build_stops_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design, built = tmp_path / "mine.toml", []

    def build(loaded: Design, *_: object, progress: Callable[[str], None], **__: object) -> None:
        if loaded.material.modulus_MPa == 1235.0:
            raise KeyboardInterrupt
        progress("mesh ...")
        save(design, to_toml(tiny(material={"modulus_MPa": 1235.0})))
        progress("views ...")
        built.append(loaded)

    save(design, to_toml(tiny(material={"modulus_MPa": 1234.0})))
    monkeypatch.setattr("phytac_design.stages.build.build", build)
    done = CliRunner().invoke(app, ["watch", str(design), "--out", str(tmp_path / "x")])
    assert (done.exit_code, built) == (130, [])


def test_a_file_that_the_design_names_counts_as_the_design(tmp_path: Path) -> None:
    design, other = tmp_path / "mine.toml", tmp_path / "cup.stl"
    assert saved(design) == ()
    design.write_text('file = "cup.stl"\nname = "mine"\n')
    alone = saved(design)
    other.write_text("solid")
    both = saved(design)
    assert (len(alone), len(both)) == (1, 2)
    os.utime(other, (time.time(), time.time() + 5.0))
    assert saved(design) != both


def test_the_page_shows_the_report_again_after_a_build(tmp_path: Path) -> None:
    assert not write_page(tmp_path, "nothing yet")
    report = tmp_path / "report" / "report.html"
    report.parent.mkdir()
    said = []
    for text in ("first", "first", "second"):
        report.write_text(text)
        assert write_page(tmp_path, "built")
        said.append(report.with_name("watch.js").read_text())
    assert said[0] == said[1] != said[2]
    assert '"built"' in said[2]
    assert said[2].endswith('"built", false);\n')
    write_page(tmp_path, "no build", failed=True)
    assert report.with_name("watch.js").read_text().endswith('"no build", true);\n')
    assert 'src="report.html"' in report.with_name("watch.html").read_text()


def test_a_design_without_a_file_is_refused(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["watch", str(tmp_path / "none.toml")])
    with refused("watch-without-file"):
        raise done.exception or AssertionError(done.output)
