"""The structure of the code: no import cycles, no stray files, light run time, plain words."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"phytac_shapes": "shapes", "phytac_decoder": "decoder", "phytac_design": "."}
"""Packages, and the folder that holds each."""
HEAVY = (
    "gmsh", "cadquery", "pyrender", "torch", "lib3mf", "onnx", "optuna", "distributed",
    "mcap", "mujoco", "pxr", "rerun",
)  # fmt: skip
"""Libraries that are imported in one module each, at first use."""
OLD_WORDS = re.compile(
    r"\b(Feet|Crew|Eyes|ASTRAY|STILL|FIRM|ANEW|Softest|Rough|Lifted|Teller|Lesson|Uneven|Skin"
    r"|Footing)\b"
)


def modules() -> dict[str, Path]:
    """Every module of the three packages by its dotted name."""
    found = {}
    for package, folder in SOURCES.items():
        for path in sorted((ROOT / folder / package).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


@cache
def parsed(path: Path) -> ast.Module:
    """Syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements anywhere below a node, those for type checkers alone left out."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            continue  # no statement is part of an expression
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        yield from imports(child)


@cache
def imported(path: Path) -> set[str]:
    """Dotted names that a file imports: modules, or names in them."""
    names: set[str] = set()
    for node in imports(parsed(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        else:
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def owner(name: str) -> str | None:
    """Return the module of this project that a dotted name belongs to."""
    return name if name in MODULES else name.rpartition(".")[0]


def graph() -> dict[str, set[str]]:
    """Modules of this project that each module imports, function-local imports included."""
    return {
        module: {found for name in imported(path) if (found := owner(name)) in MODULES} - {module}
        for module, path in MODULES.items()
    }


def test_no_module_imports_itself_through_others() -> None:
    TopologicalSorter(graph()).prepare()


def test_no_folder_imports_itself_through_others() -> None:
    def folder(module: str) -> str:
        package = MODULES[module].name == "__init__.py"
        return module if package else module.rpartition(".")[0]

    folders: dict[str, set[str]] = defaultdict(set)
    for module, used in graph().items():
        folders[folder(module)] |= {folder(name) for name in used} - {folder(module)}
    TopologicalSorter(folders).prepare()


def test_no_module_lies_at_the_root_of_the_design_tool() -> None:
    files = {path.name for path in (ROOT / "phytac_design").iterdir() if path.is_file()}
    assert files == {"__init__.py", "__main__.py", "py.typed"}


@pytest.mark.parametrize("package", ["phytac_shapes", "phytac_decoder"])
def test_run_time_packages_are_light(package: str) -> None:
    allowed = {"phytac_shapes": {"numpy"}, "phytac_decoder": {"numpy", "cv2", "safetensors"}}
    used = {
        name.partition(".")[0]
        for module, path in MODULES.items()
        if module.partition(".")[0] == package
        for name in imported(path)
    }
    assert used - set(sys.stdlib_module_names) - set(SOURCES) == allowed[package]


@pytest.mark.parametrize("library", HEAVY)
def test_each_heavy_library_has_one_module(library: str) -> None:
    users = [
        module
        for module, path in MODULES.items()
        if library in {name.partition(".")[0] for name in imported(path)}
    ]
    assert len(users) <= 1, users


def test_no_class_name_stands_for_two_things() -> None:
    where: dict[str, list[str]] = defaultdict(list)
    for module, path in MODULES.items():
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].append(module)
    assert {name: users for name, users in where.items() if len(users) > 1} == {}


def test_no_module_name_stands_for_two_things() -> None:
    where: dict[str, list[str]] = defaultdict(list)
    for module, path in MODULES.items():
        if path.name not in {"__init__.py", "__main__.py"}:
            where[path.stem].append(module)
    assert {name: users for name, users in where.items() if len(users) > 1} == {}


def test_no_word_of_the_old_dialect_names_anything() -> None:
    found = [
        f"{module}:{number}: {line.strip()}"
        for module, path in MODULES.items()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if OLD_WORDS.search(line)
    ]
    assert found == []


def test_decoder_runs_without_the_design_tool() -> None:
    code = (
        "import sys, phytac_decoder.pipeline.decode\n"
        "heavy = {'torch', 'cadquery', 'pyrender', 'OpenGL', 'scipy', 'phytac_design'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
