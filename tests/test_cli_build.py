"""``phytac build``: which ways of asking go together, and what each builds."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_shapes.errors import DesignError


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("cylinder60 --tolerance 2% --budget 60s", "--tolerance and --budget exclude each other"),
        ("cylinder60 --budget 60s --accuracy draft", "--accuracy or --set and --budget exclude"),
        ("cylinder60 --budget 60s --set refine=5", "--accuracy or --set and --budget exclude"),
        ("cylinder60 --scene fingertip --only views", "--scene and --only exclude"),
        ("cylinder60 --scene fingertip --tolerance 2%", "--scene and --tolerance or --budget"),
        ("", "give a design to build"),
        ("cylinder60 --trial 3", "--from-study FOLDER --trial 42"),
        ("--from-study somewhere", "--from-study FOLDER --trial 42"),
        ("cylinder60 --set refin=5", "did you mean 'refine'"),
        ("cylinder60 --budget soon", "soon"),
        ("cylinder60 --tolerance 0%", "0%"),
    ],
)
def test_what_does_not_go_together_is_refused_first(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["build", *words.split()])
    assert isinstance(result.exception, DesignError)
    assert said in str(result.exception)
    assert not list(tmp_path.iterdir())
