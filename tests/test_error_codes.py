"""Codes of errors: a literal in kebab-case at every place, and one class for each code."""

import ast
import copy
import gc
import pickle
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from phytac_design.mechanics.switch.bowl_check import UnsuitableBowlError
from phytac_design.mechanics.switch.switch_path import PathError
from phytac_shapes.errors import DesignError, InputError, PhytacError
from tests.refusals import refused

ROOT = Path(__file__).parents[1]
FOLDERS = ("shapes", "decoder", "phytac_design", "verification", "benchmarks", "examples")
KEBAB = re.compile(r"[a-z0-9]+(-[a-z0-9]+){1,3}")


ERRORS = re.compile(r"Error[()]|refuse\(")
"""What a module holds that makes errors, or derives one; ruff has all names end in ``Error``."""


def walked() -> dict[Path, list[ast.AST]]:
    """Nodes of the syntax trees of all modules that may raise errors."""
    paths = (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")))
    texts = {path: path.read_text(encoding="utf-8") for path in paths}
    gc.disable()  # it would go through all nodes again and again
    try:
        return {
            path: list(ast.walk(ast.parse(text)))
            for path, text in texts.items()
            if ERRORS.search(text)
        }
    finally:
        gc.enable()


def name_of(node: ast.expr) -> str:
    """Name of a class or function, without its module."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def family(trees: dict[Path, list[ast.AST]]) -> set[str]:
    """Names of ``PhytacError`` and all its subclasses."""
    out = {"PhytacError"}
    classes = [node for nodes in trees.values() for node in nodes if type(node) is ast.ClassDef]
    for _ in range(3):  # subclasses of subclasses
        out |= {node.name for node in classes if out & {name_of(base) for base in node.bases}}
    return out


@cache
def code_arguments() -> list[tuple[str, str, ast.expr]]:
    """:func:`find_code_arguments`, found once."""
    return list(find_code_arguments())


def find_code_arguments() -> Iterator[tuple[str, str, ast.expr]]:
    """Place, class and argument ``code`` of every error that is made, directly or by a helper."""
    trees = walked()
    errors = family(trees)
    for path, nodes in trees.items():
        # Functions of this module that hand their parameter ``code`` to an error.
        helpers: dict[str, tuple[str, int]] = {"refuse": ("DesignError", 0)}
        for node in nodes:
            names = [each.arg for each in node.args.args] if type(node) is ast.FunctionDef else []
            if "code" not in names:
                continue
            for call in (item for item in ast.walk(node) if isinstance(item, ast.Call)):
                if name_of(call.func) in errors:
                    helpers[node.name] = name_of(call.func), names.index("code")
        for call in (node for node in nodes if isinstance(node, ast.Call)):
            place = f"{path.relative_to(ROOT)}:{call.lineno}"
            if name_of(call.func) in errors:
                yield place, name_of(call.func), call.args[0]
            elif isinstance(call.func, ast.Name) and call.func.id in helpers:
                kind, at = helpers[call.func.id]
                yield place, kind, call.args[at]


def test_codes_are_literals_in_kebab_case() -> None:
    found = code_arguments()
    assert len(found) > 600
    for place, _, code in found:
        if isinstance(code, ast.Constant):
            assert KEBAB.fullmatch(str(code.value)), place
        else:  # of the error that is raised again, or of the caller
            assert name_of(code) == "code", f"{place}: the code must be a literal"


def test_a_code_belongs_to_one_class() -> None:
    classes: dict[str, dict[str, str]] = defaultdict(dict)
    for place, kind, code in code_arguments():
        if isinstance(code, ast.Constant):
            classes[code.value][kind] = place
    assert {code: kinds for code, kinds in classes.items() if len(kinds) > 1} == {}


def test_text_is_the_message_alone() -> None:
    error = DesignError("wall-too-thin", "the wall is too thin")
    assert (error.code, str(error)) == ("wall-too-thin", "the wall is too thin")
    with pytest.raises(TypeError):
        PhytacError("no code")  # type: ignore[call-arg]


@pytest.mark.parametrize(
    "error",
    [
        InputError("file-unreadable", "no file"),
        UnsuitableBowlError("bowl-no-snap", "too thick", thin=True),
        PathError("switch-path-ended", "it ends", []),
    ],
)
def test_errors_are_pickled_and_copied(error: PhytacError) -> None:
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):  # noqa: S301 - its own bytes
        assert type(again) is type(error)
        assert (again.code, str(again)) == (error.code, str(error))
        assert vars(again) == vars(error)


def test_refused_fails_on_another_code_and_on_none() -> None:
    message = "'wall-too-thin' instead of 'wall-too-thick'"
    with pytest.raises(AssertionError, match=message), refused("wall-too-thick"):
        raise DesignError("wall-too-thin", "0.1 mm")
    with pytest.raises(pytest.fail.Exception), refused("wall-too-thin"):
        pass
    with refused("wall-too-thin") as caught:
        raise DesignError("wall-too-thin", "0.1 mm")
    assert str(caught.value) == "0.1 mm"
