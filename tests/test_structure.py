"""The rooms and the one direction of imports between them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("shapes", "decoder", "phytac_design")
MODULES = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
ALLOWED = {"shapes": {"shapes"}, "decoder": {"shapes", "decoder"}, "phytac_design": set(ROOMS)}
HEAVY = {
    "gmsh",
    "cadquery",
    "OCP",
    "pyrender",
    "torch",
    "matplotlib",
    "lib3mf",
    "onnx",
    "pyarrow",
} | {
    "optuna",
    "distributed",
}
RUN_TIME = {"numpy", "cv2", "safetensors"}


def imported(path: Path) -> set[str]:
    """Top-level names of every import in a file, wherever it stands."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(str(node.module).split(".")[0])
    return names


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_point_one_way(path: Path) -> None:
    room = path.relative_to(ROOT).parts[0]
    rooms_used = imported(path) & set(ROOMS)
    assert rooms_used <= ALLOWED[room]


def test_shapes_need_only_numpy() -> None:
    used = set().union(*(imported(path) for path in (ROOT / "shapes").rglob("*.py")))
    assert used - set(sys.stdlib_module_names) == {"numpy", "shapes"}


def test_decoder_run_time_is_light() -> None:
    files = [path for path in (ROOT / "decoder").rglob("*.py") if path.name != "train.py"]
    used = set().union(*(imported(path) for path in files)) - set(sys.stdlib_module_names)
    assert used == RUN_TIME | {"decoder", "shapes"}


@pytest.mark.parametrize("heavy", sorted(HEAVY))
def test_each_heavy_part_has_one_module(heavy: str) -> None:
    users = [path.name for path in MODULES if heavy in imported(path) and heavy != "OCP"]
    assert len(users) <= 1, users


@pytest.mark.parametrize(
    "path",
    MODULES + sorted((ROOT / "benchmarks").glob("*.py")) + sorted((ROOT / "tests").rglob("*.py")),
    ids=lambda p: p.relative_to(ROOT).as_posix(),
)
def test_modules_are_small(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 400


def test_decoder_runs_without_the_design_tool() -> None:
    code = (
        "import sys, phytac_decoder.estimation.decode\n"
        "heavy = {'torch', 'cadquery', 'pyrender', 'OpenGL', 'scipy', 'phytac_design'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
