"""What made the rows of a part: commit, day, machine, command, seconds, and the code behind them.

Rows are *current* as long as no module that their part imports, directly or not, has changed but
for comments and docstrings, nor a data file of the packages. Hashes are of Python 3.11, the
version of ``requirements.lock``: others have other syntax trees.
"""

import ast
import hashlib
import importlib.util
import platform
import subprocess
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import grimp

ROOT = Path(__file__).parents[1]
PACKAGES = ("benchmarks", "phytac_decoder", "phytac_design", "phytac_shapes", "verification")
COMMANDS = {
    "benchmarks.build": "phytac_design.cli.app",
    "benchmarks.fabrication_switch": "phytac_design.cli.app",
    "benchmarks.mutation": "phytac_design.cli.app",
    "benchmarks.page": "phytac_design.cli.app",
    "benchmarks.page_studio": "phytac_design.cli.app",
    "benchmarks.stability": "verification",
    "benchmarks.study_dask": "phytac_design.cli.app",
}
"""What modules run as a process of its own: a module, or a package with all that is in it."""
DATA_FILES = frozenset({".css", ".html", ".js", ".svg", ".toml"})
"""Names of data files end so."""
WITHOUT_EFFECT = frozenset({"benchmarks.harness", "benchmarks.provenance"})
"""They write rows and make none."""


def code_digest(module: str, *, packages: Sequence[str] = PACKAGES) -> str:
    """Hash of the code of a module and of all that it imports, and of the shipped data files.

    Parameters
    ----------
    module : str
        Of one of the packages.
    packages : sequence of str
        Importable packages whose code counts.
    """
    graph, names, new = _graph(tuple(packages)), set(), {module}
    while new:
        names |= new.union(*map(graph.find_upstream_modules, new))
        run = {COMMANDS[name] for name in names if name in COMMANDS}
        new = run.union(*map(graph.find_descendants, run)) - names
    whole = hashlib.sha256()
    for name in sorted(names - WITHOUT_EFFECT):
        whole.update(f"{name} {_module_digest(name)}\n".encode())
    if "phytac_design" in packages:
        whole.update(_data_digest(names).encode())
    return whole.hexdigest()[:16]


@cache
def _graph(packages: tuple[str, ...]) -> grimp.ImportGraph:
    return grimp.build_graph(*packages, cache_dir=None)


@cache
def _module_digest(name: str) -> str:
    """Hash of a module's code without comments and docstrings."""
    return hashlib.sha256(bare_code(_file(name).read_text("utf-8")).encode()).hexdigest()


def _file(name: str) -> Path:
    """Return the file of a module."""
    package, *inner = name.split(".")
    spec = importlib.util.find_spec(package)
    base = Path((spec.submodule_search_locations or [""])[0] if spec else "").joinpath(*inner)
    path = base / "__init__.py" if base.is_dir() else base.with_suffix(".py")
    if spec is None or not path.is_file():
        raise LookupError(f"no file of module {name!r}")
    return path


def bare_code(text: str) -> str:
    """Syntax tree of a source file without docstrings; it differs between versions of Python."""
    return ast.dump(_WithoutTexts().visit(ast.parse(text)))


class _WithoutTexts(ast.NodeTransformer):
    """Leaves out statements that are strings, as docstrings are."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if text else node


def _data_digest(names: set[str]) -> str:
    """Hash of shipped designs and studies, and of the data files in the packages of modules."""
    packages = names | {name.rpartition(".")[0] for name in names}
    whole = hashlib.sha256()
    for path, package in _data_files():
        if package in packages or path.suffix == ".toml":
            whole.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return whole.hexdigest()


@cache
def _data_files() -> list[tuple[Path, str]]:
    """Data files of the packages, each with the package that it lies in, in it or deeper."""
    found = []
    for base in (ROOT, ROOT / "decoder", ROOT / "shapes"):
        for top in base.glob("phytac_*"):
            for path in sorted(top.rglob("*")):
                if path.suffix in DATA_FILES:
                    folder = next(up for up in path.parents if (up / "__init__.py").exists())
                    found.append((path, ".".join(folder.relative_to(base).parts)))
    return found


def record(module: str, command: str) -> dict[str, Any]:
    """Return what is known of a part before it runs.

    Parameters
    ----------
    module : str
        Where its rows are made.
    command : str
        That makes them again.
    """
    return {
        "commit": _git("rev-parse", "--short", "HEAD") or "none",
        "changed": bool(_git("status", "--porcelain", "--", ":!benchmarks/results")),
        "day": time.strftime("%Y-%m-%d", time.gmtime()),
        "command": command,
        "machine": machine(),
        "module": module,
        "code": code_digest(module),
    }


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def machine() -> dict[str, Any]:
    """Processor, cores and Python of this machine."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
        cores = len(names)
    else:
        cores = 0
    return {"processor": model, "cores": cores, "python": platform.python_version()}


def is_current(known: dict[str, Any]) -> bool:
    """Whether a part's rows were made by the code as it is now, without uncommitted changes."""
    if not known.get("module") or known["changed"]:
        return False
    return bool(known["code"] == _digest_now(known["module"]))


@cache
def _digest_now(module: str) -> str:
    return code_digest(module)
