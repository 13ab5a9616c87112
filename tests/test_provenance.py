"""Rows of benchmarks know the code that made them, and tables mark those of earlier code."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from benchmarks import __main__ as program
from benchmarks import harness, provenance, tables
from benchmarks.harness import Table
from benchmarks.provenance import bare_code, code_digest


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package: ``first`` imports ``second`` in a function, that ``fourth``, none ``third``."""
    folder = tmp_path / "made_up"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "first.py").write_text("def f():\n    from made_up.second import b\n    return b\n")
    (folder / "second.py").write_text('"""Text."""\n\nimport made_up.fourth\n\nb = 1\n')
    (folder / "fourth.py").write_text("d = 1\n")
    (folder / "third.py").write_text("c = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.startswith("made_up")]:
        del sys.modules[name]


def digest(module: str) -> str:
    """Digest of a module of the package as it is now."""
    provenance._graph.cache_clear()
    provenance._module_digest.cache_clear()
    return code_digest(f"made_up.{module}", packages=("made_up",))


def test_what_is_imported_later_counts_and_comments_do_not(package: Path) -> None:
    before = digest("first")
    (package / "third.py").write_text("c = 2\n")
    (package / "second.py").write_text(
        '"""Other text."""\n\nimport made_up.fourth\n\n# A comment.\nb  = 1\n'
    )
    assert digest("first") == before
    (package / "fourth.py").write_text("d = 2\n")
    assert digest("first") != before


def test_a_module_that_is_run_as_a_process_counts(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(provenance.COMMANDS, "made_up.second", "made_up.third")
    before = digest("first")
    (package / "third.py").write_text("c = 2\n")
    assert digest("first") != before


def test_data_files_of_what_is_imported_count(monkeypatch: pytest.MonkeyPatch) -> None:
    files = dict(provenance._data_files())
    page = next(path for path in files if path.name == "studio.css")
    design = next(path for path in files if path.name == "cone.toml")
    assert files[page] == "phytac_design.studio"
    names = {"studio": {"phytac_design.studio.app"}, "other": {"phytac_design.engine.cache"}}
    before = {key: provenance._data_digest(one) for key, one in names.items()}
    read_bytes = Path.read_bytes
    changed = page

    def read(path: Path) -> bytes:
        return read_bytes(path) + (b"." if path == changed else b"")

    monkeypatch.setattr(Path, "read_bytes", read)
    assert provenance._data_digest(names["studio"]) != before["studio"]
    assert provenance._data_digest(names["other"]) == before["other"]
    changed = design
    assert provenance._data_digest(names["other"]) != before["other"]


def test_the_decoders_code_is_behind_its_rows() -> None:
    graph = provenance._graph(provenance.PACKAGES)
    for benchmark in ("camera", "demo_frames", "hands"):
        behind = graph.find_upstream_modules(f"benchmarks.{benchmark}")
        assert {"phytac_decoder.estimation.contact_fit", "phytac_design.optics.zbuffer"} <= behind
    assert "phytac_design.stages.build" not in graph.find_upstream_modules("benchmarks.mechanics")


def test_docstrings_are_no_code() -> None:
    plain = "class A:\n    x = 1\n\n    def f(self):\n        return 'text'\n"
    longer = plain.replace("    x = 1", "    '''Words.'''\n    x = 1\n    '''Of x.'''")
    assert bare_code(longer) == bare_code(plain)
    assert bare_code(plain.replace("'text'", "'other'")) != bare_code(plain)


def known(**changes: Any) -> dict[str, Any]:
    """What made a part's rows just now."""
    made = provenance.record("benchmarks.camera_faults", "python -m …")
    return made | {"changed": False} | changes


def test_rows_are_current_until_the_code_changes() -> None:
    assert provenance.is_current(known())
    assert not provenance.is_current(known(code="0123456789abcdef"))
    assert not provenance.is_current(known(changed=True))
    before = {"commit": "a5ccaf9", "day": "2026-11-24", "command": "python -m …"}
    assert not provenance.is_current(before)
    row = {"case": "a", "value": 1.0, "unit": "%", "reference": 2.0, "source": "b"}
    assert "| 1 % |" in tables.line(row, known())
    assert "| 1 %† |" in tables.line(row, known(code="0123456789abcdef"))
    assert "has changed since" in tables.made("camera", known(code="0123456789abcdef"))


def test_parts_are_written_beside_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(harness, "RESULTS", tmp_path)
    for part, value in (("two", 1.0), ("one", 2.0), ("two", 3.0)):
        table = Table("some", part=part, made=known())
        table.add("case", value, "%", 0.0, "none", "<= 2")
        path = table.write(order=["one", "two"])
    data = json.loads(path.read_text())
    assert list(data["parts"]) == ["one", "two"]
    assert [(row["part"], row["value"], row["holds"]) for row in data["rows"]] == [
        ("one", 2.0, True),
        ("two", 3.0, False),
    ]
    assert data["parts"]["two"]["seconds"] >= 0.0
    assert len(data["parts"]["two"]["code"]) == 16


def test_every_miss_has_one_reason_and_every_reason_a_miss(monkeypatch: pytest.MonkeyPatch) -> None:
    results = tables.read()
    assert tables.misses(results).count("\n| ") == len(tables.GROUPS) + 1
    row = {"case": "new", "value": 2.0, "unit": "s", "target": "<= 1", "holds": False, "part": "a"}
    added = results["page"] | {"rows": [row], "parts": {"a": known()}}
    with pytest.raises(LookupError, match=r"no group in .* for page: new"):
        tables.misses(results | {"page": added})
    gone = tables.GROUPS[0] | {"rows": "no such row"}
    monkeypatch.setattr(tables, "GROUPS", [*tables.GROUPS, gone])
    with pytest.raises(LookupError, match=f"no row of {gone['benchmark']} misses 'no such row'"):
        tables.misses(results)


def test_every_part_of_the_results_is_known_and_can_be_made_again() -> None:
    for name, data in tables.read().items():
        assert {row["part"] for row in data["rows"]} == set(data["parts"])
        assert {"commit", "day", "command"} <= set.intersection(*map(set, data["parts"].values()))
        if name in program.NAMES:
            assert set(data["parts"]) <= {part.name for part in program.parts_of(name)}
        else:
            assert name == "install"
