"""Builds on a full disk, in a folder that cannot be written, ended, and two at once into one."""

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import to_toml
from phytac_design.engine import cache
from phytac_design.stages import build as module
from phytac_design.stages.build import MANIFEST, OLD_MANIFEST, build
from phytac_design.stages.views_stage import write_image
from tests.designs import small
from tests.refusals import refused

WHOLE = {"design.toml", "manifest.json", "mesh/shell.inp", "mesh/shell.msh", "mesh/shell.vtu"}


def make(out: Path, **changes: Any) -> None:
    """The quickest stage that writes several files."""
    build(small(**changes), out, accuracy="draft", only=["mesh"], progress=lambda _: None)


def files(out: Path) -> set[str]:
    return {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}


def check_whole(out: Path) -> None:
    """Exactly what a build writes, every byte as the manifest says."""
    assert files(out) == WHOLE
    for entry in json.loads((out / MANIFEST).read_text())["files"]:
        assert cache.file_hash(out / entry["path"]) == entry["sha256"]


@contextmanager
def small_files(size: int) -> Iterator[None]:
    """No file may grow beyond so many bytes, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)


def test_a_disk_that_is_full_while_files_are_copied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of an old build nothing is called finished either; the next run has it all."""
    out = tmp_path / "x"
    make(out)
    real, copied = shutil.copyfile, []

    def copy(source: Path, target: Path) -> None:
        copied.append(target)
        if len(copied) == 2:
            target.write_bytes(b"half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "copyfile", copy)
        with refused("output-not-writable"):
            make(out, material={"modulus_MPa": 1900.0})
    assert not (out / MANIFEST).exists()
    assert not list(out.rglob(".*.part"))
    with refused("output-foreign") as caught:
        make(out, name="other")
    caught.match("'small', not 'other'")
    make(out, material={"modulus_MPa": 1900.0})
    check_whole(out)


def test_a_disk_that_is_full_while_a_stage_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    out = tmp_path / "x"
    with small_files(20_000), refused("output-not-writable"):
        make(out)
    assert not (out / MANIFEST).exists()
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]
    make(out)
    check_whole(out)


def test_half_a_picture_is_never_kept(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (300, 300, 3), dtype=np.uint8)
    with small_files(20_000), pytest.raises(OSError, match="File too large"):
        write_image(tmp_path / "x.png", image)


@pytest.mark.parametrize("what", ["out", "cache"])
def test_a_folder_that_cannot_be_written(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even root may make no folder in /proc."""
    nowhere = Path("/proc/phytac")
    monkeypatch.setenv("PHYTAC_CACHE", str(nowhere if what == "cache" else tmp_path / "cache"))
    with refused("output-not-writable"):
        make(nowhere if what == "out" else tmp_path / "x")


def test_an_end_while_files_are_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "x"
    make(out)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "copyfile", stop)
        with pytest.raises(KeyboardInterrupt):
            make(out)
    assert not (out / MANIFEST).exists()
    assert (out / OLD_MANIFEST).exists()
    (out / "mesh" / ".shell.inp.part").write_bytes(b"half")
    make(out)
    check_whole(out)


def test_a_build_that_is_ended_goes_on(tmp_path: Path) -> None:
    """SIGTERM in the middle of a stage: nothing looks finished, and the next run finishes."""
    design, out, own = tmp_path / "x.toml", tmp_path / "x", tmp_path / "cache"
    design.write_text(to_toml(small()))
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom phytac_design.stages.build import build\n"
        "from phytac_design.design.design_file import load_design\n"
        "def report(text):\n    print(text, flush=True)\n    time.sleep(60 * ('mesh …' in text))\n"
        f"build(load_design({str(design)!r}), Path({str(out)!r}), accuracy='draft', "
        "only=['mesh'], progress=report)"
    )
    environment = {**os.environ, "PHYTAC_CACHE": str(own)}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    assert "mesh …" in process.stdout.readline()
    process.terminate()
    process.communicate(timeout=20.0)
    assert process.returncode == -signal.SIGTERM
    assert not (out / MANIFEST).exists()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PHYTAC_CACHE", str(own))
        make(out)
    check_whole(out)
    assert not [path for path in own.rglob(".*") if path.is_dir()]


def test_two_builds_at_once_into_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They take turns: the folder is of one of them, whole."""
    make(tmp_path / "warm")
    make(tmp_path / "warm", material={"modulus_MPa": 1900.0})
    real = shutil.copyfile
    at_it: list[int] = []

    def slow(source: Path, target: Path) -> None:
        at_it.append(threading.get_ident())
        real(source, target)
        time.sleep(0.05)

    monkeypatch.setattr(shutil, "copyfile", slow)
    alone, both = module._alone_in, threading.Barrier(2, timeout=30.0)

    def together(out: Path) -> AbstractContextManager[None]:
        both.wait()
        return alone(out)

    monkeypatch.setattr(module, "_alone_in", together)
    errors: list[BaseException] = []

    def work(modulus_MPa: float) -> None:
        try:
            make(tmp_path / "x", material={"modulus_MPa": modulus_MPa})
        except BaseException as error:  # noqa: BLE001 - reported by the other thread
            errors.append(error)

    threads = [threading.Thread(target=work, args=(modulus,)) for modulus in (1900.0, 2050.0)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    turns = sum(a != b for a, b in pairwise(at_it))
    assert (len(at_it), turns) == (6, 1)
    check_whole(tmp_path / "x")


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "[" * 100_000,
        '{"design": 5, "files": 7}',
        '{"design": {"name": "small"}, "files": [{"path": 5, "stage": "mesh"}]}',
        '{"design": {"name": "small"}, "files": [{"path": "mine", "stage": "mesh"}]}',
        '{"design": {"name": "small"}, "files": [{"path": "../precious", "stage": "mesh"}]}',
        '{"design": {"name": "small"}, "files": [{"path": "/etc/hostname", "stage": []}]}',
    ],
)
def test_a_manifest_that_lies(text: str, tmp_path: Path) -> None:
    """It makes no traceback, and nothing outside the folder is removed by it."""
    out = tmp_path / "x"
    (out / "mine").mkdir(parents=True)
    (tmp_path / "precious").write_text("mine")
    (out / MANIFEST).write_text(text)
    build(small(), out, accuracy="draft", only=["mesh"], force=True, progress=lambda _: None)
    assert (tmp_path / "precious").read_text() == "mine"
    assert files(out) == WHOLE
    assert module.MANIFEST == MANIFEST
