"""Every ``--out`` that cannot be written is one clear error, before any work."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.cli.options import check_out
from phytac_design.design.design_file import load_design
from phytac_design.stages.build import build
from tests.refusals import refused


def commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Words of every command that has an option ``--out``."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*words, name))
        elif any("--out" in parameter.opts for parameter in command.params):
            yield (*words, name)


ALL = list(commands(typer.main.get_command(app)))


def test_all_are_found() -> None:
    assert len(ALL) >= 14
    assert {("build",), ("train",), ("simulate",), ("sweep",)} <= {*ALL}


@pytest.mark.parametrize("words", ALL, ids=" ".join)
def test_below_a_file_is_refused_first(words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "below" / "deeper"
    # It comes before all other problems, such as arguments that are missing.
    done = CliRunner().invoke(app, [*words, "--out", str(out)])
    with refused("output-not-writable") as caught:
        raise done.exception or AssertionError(done.output)
    assert f"{tmp_path / 'file'} is not a folder; choose another --out" in str(caught.value)
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_folders_without_permission_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "new" / "out"
    assert check_out(None) is None
    assert check_out(out) == out
    assert check_out(Path("exports") / "x") == Path("exports") / "x"
    (tmp_path / "page.html").touch()
    assert check_out(tmp_path / "page.html") == tmp_path / "page.html"
    with refused("output-not-writable"):
        check_out(Path("a\0b"))
    # Root may do everything: what others get is made up.
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *_: False)
        with refused("output-not-writable") as caught:
            check_out(out)
        assert f"no permission to write in {tmp_path};" in str(caught.value)
    unsearchable(monkeypatch)
    with refused("output-not-writable") as caught:
        check_out(out)
    assert "Permission denied; choose another --out" in str(caught.value)


def unsearchable(monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(path: Path, **_: Any) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "stat", denied)


def test_a_build_by_python_into_a_folder_that_cannot_be_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    design = load_design("plane")
    unsearchable(monkeypatch)
    with refused("output-not-writable"):
        build(design, tmp_path / "out")
