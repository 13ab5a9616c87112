"""The wheel in a new environment, outside the checkout: what is in it, and that it builds.

Third-party libraries come from the environment that runs this (a path file names them one by one,
the project itself left out), so nothing is downloaded.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
import zipfile
from pathlib import Path

from benchmarks.harness import Table

ROOT = Path(__file__).parents[1]
PACKAGES = ("shapes", "decoder", "phytac_design")
LEFT_BEHIND = {".md", ".pyc", ".nbi", ".nbc"}
"""Files beside the modules that a program does not read: notes, compiled kernels."""
OWN = ("__editable__", "phytac_design", "phytac-design")


def make_wheel(folder: Path) -> Path:
    """Build the wheel from a copy of the working tree."""
    source, out = folder / "source", folder / "out"
    out.mkdir(parents=True)
    for package in PACKAGES:
        ignore = shutil.ignore_patterns("__pycache__", "node_modules")
        shutil.copytree(ROOT / package, source / package, ignore=ignore)
    for name in ("pyproject.toml", "README.md"):
        shutil.copyfile(ROOT / name, source / name)
    code = f"from setuptools import build_meta; build_meta.build_wheel({str(out)!r})"
    words = [sys.executable, "-W", "ignore", "-c", code]
    subprocess.run(words, cwd=source, check=True, capture_output=True)
    (path,) = out.glob("*.whl")
    return path


def environment(folder: Path, wheel: Path) -> Path:
    """Make a virtual environment with the wheel; returns its ``bin``."""
    subprocess.run([sys.executable, "-m", "venv", str(folder / "env")], check=True)
    libraries = folder / "libraries"
    libraries.mkdir()
    for path in Path(sysconfig.get_paths()["purelib"]).iterdir():
        if not path.name.startswith(OWN):
            (libraries / path.name).symlink_to(path)
    (site,) = (folder / "env" / "lib").glob("python*/site-packages")
    (site / "libraries.pth").write_text(f"{libraries}\n")
    words = ["install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([str(folder / "env" / "bin" / "pip"), *words], check=True)
    return folder / "env" / "bin"


def wheel(table: Table, *, quick: bool) -> None:
    """Files of the wheel, and a build of ``cylinder60`` by what it installs; quick: a check."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = make_wheel(folder)
        packed = set(zipfile.ZipFile(path).namelist())
        wanted = {
            item.relative_to(ROOT).as_posix()
            for package in PACKAGES
            for item in (ROOT / package).rglob("*")
            if item.is_file()
            and item.suffix not in LEFT_BEHIND
            and "node_modules" not in item.parts
        }
        row = "wheel: files of the packages that are not in it"
        source = f"the working tree, {len(wanted)} files"
        table.add(row, len(wanted - packed), "files", 0, source, "== 0")
        table.add("wheel: size", path.stat().st_size / 1e6, "MB", "-", "reported only")
        programs = environment(folder, path)
        away = folder / "away"
        away.mkdir()
        words = ["check", "cylinder60"] if quick else ["build", "cylinder60", "--accuracy", "draft"]
        start = time.perf_counter()
        done = subprocess.run(
            [str(programs / "phytac"), *words],
            cwd=away,
            env={**os.environ, "PHYTAC_CACHE": str(folder / "cache")},
            capture_output=True,
            text=True,
            check=False,
        )
        seconds = time.perf_counter() - start
        what = "checked" if quick else "draft built"
        row = f"wheel in a new environment, outside the checkout: cylinder60 {what}, exit code"
        note = done.stderr.strip().splitlines()[-1] if done.returncode else ""
        table.add(row, done.returncode, "", 0, "success", "== 0", note)
        row = f"wheel in a new environment: cylinder60 {what}, empty cache"
        table.add(row, seconds, "s", "-", "reported only")
        if not quick:
            made = list((away / "exports" / "cylinder60").rglob("*"))
            whole = {"shell/shell.step", "decoder/bundle.json", "report/report.html"}
            names = {item.relative_to(away / "exports" / "cylinder60").as_posix() for item in made}
            row = "wheel in a new environment: STEP, decoder and report that are missing"
            table.add(row, len(whole - names), "files", 0, "what a build writes", "== 0")
