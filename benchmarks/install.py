"""Each extra alone in a fresh environment, and what it promises: python -m benchmarks.install.

Makes one virtual environment per Python and extra, installs the wheel of the working tree there
from the package index, and runs ``phytac --help`` and the commands that the extra is for. Needs the
network.

``--pythons`` names interpreters (comma separated), ``--extras`` a part of the extras, ``--lowest``
resolves to the lower bounds of ``pyproject.toml`` (needs uv).
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path

from benchmarks.harness import RESULTS, Table
from benchmarks.provenance import record

ROOT = Path(__file__).parents[1]
EXTRAS = (
    "", "design", "solid", "train", "study", "studio", "all", "recordings", "ros2", "zarr"
)  # fmt: skip
PACKAGES = ("shapes", "decoder", "phytac_design")
SOURCE = "success"


def make_wheel(folder: Path) -> Path:
    """Build the wheel from a copy of the working tree."""
    source, out = folder / "source", folder / "out"
    out.mkdir(parents=True)
    for package in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__", "node_modules")
        shutil.copytree(ROOT / package, source / package, ignore=ignore)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / name, source / name)
    words = ["wheel", "--quiet", "--no-deps", "--wheel-dir", str(out), str(source)]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True)
    (path,) = out.glob("*.whl")
    return path


class Environment:
    """A virtual environment with one extra, and a folder and cache of its own.

    Attributes
    ----------
    install_s : float
        Seconds that the installation took.
    """

    def __init__(self, folder: Path, python: str, requirement: str, *, lowest: bool) -> None:
        self.folder = folder
        self.bin = folder / "env" / "bin"
        subprocess.run([python, "-m", "venv", str(folder / "env")], check=True)
        start = time.perf_counter()
        if lowest:
            tool = ["uv", "pip", "install", "--quiet", "--resolution", "lowest-direct"]
            tool += ["--python", str(self.bin / "python")]
        else:
            tool = [str(self.bin / "python"), "-m", "pip", "install", "--quiet"]
            tool += ["--disable-pip-version-check"]
        subprocess.run([*tool, requirement], check=True)
        self.install_s = time.perf_counter() - start

    def environment(self) -> dict[str, str]:
        """Environment variables: nothing of the checkout is found, the cache is empty."""
        own = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        return own | {
            "PHYTAC_CACHE": str(self.folder / "cache"),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }

    def phytac(self, *words: str, expect: int = 0) -> str:
        """Run a command; "" if it exited with ``expect``, else the last line that it printed."""
        return self.run("phytac", *words, expect=expect)

    def run(self, program: str, *words: str, expect: int = 0) -> str:
        """Run one of the environment's programs, see :meth:`phytac`."""
        done = subprocess.run(
            [str(self.bin / program), *words],
            cwd=self.folder,
            env=self.environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode == expect:
            return ""
        lines = (done.stderr + done.stdout).strip().splitlines()
        return f"exit code {done.returncode}: {lines[-1] if lines else ''}"

    def size_MB(self) -> float:
        """Size on disk."""
        files = (path for path in (self.folder / "env").rglob("*") if path.is_file())
        return sum(path.lstat().st_size for path in files) / 1e6


def pressed(built: Path, command: str) -> list[str]:
    """Words of a command for the frame that a build leaves beside its bundle."""
    frames = built / "views"
    words = [command, str(built / "decoder"), str(frames / "frame_pressed.png")]
    return [*words, "--rest", str(frames / "frame_rest.png")]


def decodes(env: Environment, built: Path) -> str:
    """Decode a frame."""
    return env.phytac(*pressed(built, "decode"), "--csv", "forces.csv")


def records(env: Environment, built: Path) -> str:
    """Decode a frame to ROS 2 messages."""
    return env.phytac(*pressed(built, "decode"), "--mcap", "forces.mcap")


def publishes(env: Environment, built: Path) -> str:
    """Publish a frame as ROS 2 topics."""
    return env.phytac(*pressed(built, "serve"), "--port", "0", "--ros2")


MCAP = """
import numpy
from mcap_ros2.writer import Writer
with open("markers.mcap", "wb") as file:
    writer = Writer(file)
    schema = writer.register_msgdef("some_msgs/msg/Numbers", "float64[] data")
    for k, row in enumerate(numpy.random.default_rng(0).normal(size=(40, 3))):
        for topic in ("/markers", "/force"):
            writer.write_message(topic, schema, {"data": row.tolist()}, log_time=k * 10**8)
    writer.finish()
"""
ZARR = """
import numpy, zarr
data = zarr.open_group("markers.zarr", mode="w").create_group("data")
for name in ("markers", "force"):
    data.create_array(name, data=numpy.random.default_rng(0).normal(size=(40, 3)))
"""


def judges_mcap(env: Environment, _: Path) -> str:
    """Judge markers of an MCAP file, which the format's own library wrote."""
    words = ("markers.mcap", "--markers", "/markers.data", "--wrench", "/force.data")
    return env.run("python", "-c", MCAP) or env.phytac("import-markers", *words)


def judges_zarr(env: Environment, _: Path) -> str:
    """Judge markers of a Zarr."""
    words = ("markers.zarr", "--markers", "markers", "--wrench", "force")
    return env.run("python", "-c", ZARR) or env.phytac("import-markers", *words)


def refuses(env: Environment, _: Path) -> str:
    """Anything but decoding names the extra to install."""
    return env.phytac("build", "cylinder60", expect=6)


def builds(env: Environment, _: Path) -> str:
    """Build a draft from start to manifest."""
    failure = env.phytac("build", "cylinder60", "--accuracy", "draft")
    manifest = env.folder / "exports" / "cylinder60" / "manifest.json"
    return failure or ("" if manifest.is_file() else "no manifest.json")


def meshes(env: Environment, _: Path) -> str:
    """Mesh the true CAD with tetrahedra, coarsely."""
    return env.phytac("mesh", "cone", "--out", "mesh", "--solid", "--size", "2")


def learns(env: Environment, built: Path) -> str:
    """Export the network of a decoder as ONNX."""
    return env.phytac("export-onnx", str(built / "decoder"), "network.onnx")


def searches(env: Environment, _: Path) -> str:
    """Search a few candidates, with one worker process."""
    words = ("optimise", "dense-cylinder", "--candidates", "4", "--workers", "1", "--out", "study")
    return env.phytac(*words)


def serves(env: Environment, _: Path) -> str:
    """Start the studio and read its page."""
    words = [str(env.bin / "phytac"), "studio", "--no-browser"]
    process = subprocess.Popen(
        words, cwd=env.folder, env=env.environment(), stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if (at := line.find("http://")) >= 0:
                url = line[at:].split()[0]
                with urllib.request.urlopen(url, timeout=60) as page:  # noqa: S310 - our own server
                    return "" if page.status == HTTPStatus.OK else f"status {page.status}"
        return "no address printed"
    finally:
        process.terminate()
        process.communicate()


def shows_help(env: Environment, _: Path) -> str:
    """Print the help."""
    return env.phytac("--help")


PROMISES: dict[str, tuple[tuple[str, Callable[[Environment, Path], str]], ...]] = {
    "": (("decodes a frame", decodes), ("other commands name the extra", refuses)),
    "design": (("draft build to manifest", builds),),
    "solid": (("solid mesh", meshes),),
    "train": (("ONNX export", learns),),
    "study": (("four candidates of a search", searches),),
    "studio": (("serves its page", serves),),
    "all": (
        ("draft build to manifest", builds),
        ("decodes a frame", decodes),
        ("ONNX export", learns),
    ),
    "recordings": (("decodes to MCAP", records), ("judges markers of MCAP", judges_mcap)),
    "ros2": (("publishes a frame", publishes),),
    "zarr": (("judges markers of a Zarr", judges_zarr),),
}


def version_of(python: str) -> str:
    """Version of an interpreter, as in 3.11."""
    words = [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


def measure(
    table: Table, python: str, extra: str, wheel: Path, built: Path, given: argparse.Namespace
) -> None:
    """Rows of one extra on one Python."""
    version = version_of(python)
    bounds = ", lowest versions" if given.lowest else ""
    name = f"Python {version}, [{extra}]{bounds}" if extra else f"Python {version}, bare{bounds}"
    with tempfile.TemporaryDirectory() as folder:
        requirement = f"{wheel}[{extra}]" if extra else str(wheel)
        env = Environment(Path(folder), python, requirement, lowest=given.lowest)
        for what, check in (("phytac --help", shows_help), *PROMISES[extra]):
            failure = check(env, built)
            table.add(
                f"{name}: {what}, failures", int(bool(failure)), "", 0, SOURCE, "== 0", failure
            )
        table.add(f"{name}: installed size", env.size_MB(), "MB", "-", "reported only")
        table.add(f"{name}: time to install", env.install_s, "s", "-", "reported only")


def main() -> None:
    """Run all environments that were asked for; rows of others are kept."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--pythons", default=sys.executable, help="interpreters, comma separated")
    parser.add_argument("--extras", default=",".join(EXTRAS), help="a part of them")
    parser.add_argument("--lowest", action="store_true", help="lower bounds instead of the newest")
    parser.add_argument("--bundle", type=Path, help="a build to decode with, instead of a new one")
    parser.add_argument("--dry", action="store_true", help="results are not written")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = make_wheel(folder)
        built = given.bundle
        if built is None:
            words = ["-m", "phytac_design", "build", "cylinder60", "--accuracy", "draft"]
            built = folder / "built"
            subprocess.run([sys.executable, *words, "--out", str(built)], check=True)
        for python in given.pythons.split(","):
            for extra in given.extras.split(","):
                label = f"{version_of(python)} [{extra}]" + (" lowest" if given.lowest else "")
                made = record("benchmarks.install", "python -m benchmarks.install")
                table = Table("install", part=label, made=made)
                measure(table, python, extra, wheel, built.resolve(), given)
                if not given.dry:
                    table.write(order=parts_with(label))


def parts_with(label: str) -> list[str]:
    """Parts of the committed results, and this one."""
    path = RESULTS / "install.json"
    old = json.loads(path.read_text())["parts"] if path.is_file() else {}
    return sorted({*old, label})


if __name__ == "__main__":
    main()
