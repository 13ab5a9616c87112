"""Commands that the bare package must run: nothing of the design tool's libraries is imported."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.decoder.toy_sensor import toy_recording

BARE = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
from phytac_design.cli.app import main
main()
"""
ABSENT = {
    "OCP", "cadquery", "dask", "distributed", "gmsh", "lib3mf", "manifold3d", "matplotlib",
    "meshio", "numba", "onnx", "optuna", "pyarrow", "pyrender", "scipy", "starlette", "tomlkit",
    "torch", "trimesh", "uvicorn", "yaml",
}  # fmt: skip
"""Libraries of the extras; typer brings pydantic."""


def bare(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run ``phytac`` as if only the bare package's libraries were installed."""
    code = BARE.format(absent=ABSENT)
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_camera_is_checked(tmp_path: Path) -> None:
    decoder, frames = toy_recording(tmp_path, [{}, {}])
    done = bare(tmp_path, "camera", str(decoder), "--device", str(frames), "--fps", "1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("ready; next: phytac live")
    assert "markers 30/30" in done.stdout


def test_ros_messages_are_recorded(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="mcap is not installed (extra recordings)")
    decoder, frames = toy_recording(tmp_path, [{}, {5: 3.0}])
    words = ("--rest-first", "1", "--mcap", "out.mcap")
    done = bare(tmp_path, "decode", str(decoder), str(frames), *words)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.mcap").read_bytes().startswith(b"\x89MCAP0")


@pytest.mark.parametrize("command", ["decode", "serve", "live"])
def test_recordings_are_decoded_served_and_shown(command: str, tmp_path: Path) -> None:
    decoder, frames = toy_recording(tmp_path, [{}, {5: 3.0}, {5: 3.0}])
    options = {"decode": (), "serve": ("--port", "0"), "live": ("--port", "0")}[command]
    done = bare(tmp_path, command, str(decoder), str(frames), "--rest-first", "1", *options)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        (("build", "cylinder60"), "design"),
        (("check", "cylinder60"), "design"),
        (("train", "cylinder60", "x"), "design"),
        (("studio",), "studio"),
    ],
)
def test_other_commands_name_the_extra(words: tuple[str, ...], extra: str, tmp_path: Path) -> None:
    done = bare(tmp_path, *words)
    assert done.returncode == 6, done.stderr
    assert f"pip install 'phytac-design[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_is_there(tmp_path: Path) -> None:
    assert bare(tmp_path, "--help").returncode == 0
