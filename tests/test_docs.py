"""README and docs are correct: the example runs, commands exist, tables are current."""

import contextlib
import io
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from phytac_design.cli.app import app

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_example_runs() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(code, "README.md", "exec"), {})  # noqa: S102 - our own README
    assert out.getvalue().startswith("216 markers, heights 0.5 to 9.0\n0 hidden, 0 fused\n")


def test_commands_of_the_docs_exist() -> None:
    text = README + "".join(path.read_text() for path in (ROOT / "docs").rglob("*.md"))
    named = set(re.findall(r"phytac ([a-z]+(?:-[a-z]+)*)", text))
    names = (command.name or command.callback.__name__ for command in app.registered_commands)
    known = {name.strip("_").replace("_", "-") for name in names}
    assert named <= known


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="hashes of code are of Python 3.11")
def test_tables_are_made_from_the_committed_results() -> None:
    words = [sys.executable, "-m", "benchmarks.tables", "--check"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_readme_is_read_in_three_minutes() -> None:
    assert len(README.split()) < 900


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    names = {re.split(r"[\[><=; ]", item)[0] for group in groups for item in group}
    table = (ROOT / "docs" / "dependencies.md").read_text()
    names -= {project["name"]}
    assert len(names) > 25
    assert [name for name in names if not re.search(rf"\b{re.escape(name)}\b", table)] == []
