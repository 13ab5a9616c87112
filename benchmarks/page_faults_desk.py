"""What disturbed builds are made with: a small design, processes, a small disk, what was seen."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from benchmarks.harness import Table
from phytac_design.design.design_file import to_toml
from phytac_design.engine import cache
from phytac_design.stages.build import MANIFEST

PHYTAC = (sys.executable, "-m", "phytac_design")
BYTES, BYTES_LIMIT = 150_000, 60_000
"""Of a small disk; of a file where there is none. The small design's mesh is 240 kB."""
PATIENCE_S = 900.0
SMALL = {
    "name": "small",
    "shape": {"length_mm": 60.0},
    "layout": {"rows": 8, "columns": 14, "height_far_mm": 6.0},
    "camera": {"width_px": 1296, "height_px": 972, "focal_px": 485.0},
}
"""Changes to `cylinder60` that make it quick."""


def files_of(folder: Path) -> dict[str, str]:
    """Hash of every file but the manifest, which holds times; by its path."""
    return {
        path.relative_to(folder).as_posix(): cache.file_hash(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path != folder / MANIFEST
    }


def kept(store: Path) -> list[Path]:
    """Files of a cache."""
    return [path for path in store.rglob("*") if path.is_file()]


class Run:
    """A `phytac` that runs in a session of its own.

    Parameters
    ----------
    words : sequence of str
        Of the command.
    folder : Path
        Where it runs.
    store : Path
        Its cache.
    before : sequence of str
        What it is started by.
    """

    def __init__(
        self, *words: str, folder: Path, store: Path, before: tuple[str, ...] = ()
    ) -> None:
        self.process = subprocess.Popen(
            # What runs in the background of a script has Ctrl-C ignored, and hands that down.
            [*before, "env", "--default-signal=INT", *PHYTAC, *words],
            cwd=folder,
            env={**os.environ, "PHYTAC_CACHE": str(store), "PYTHONUNBUFFERED": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.said = ""

    def until(self, text: str) -> bool:
        """Wait until it says something; False if it ends before."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said += line
            if text in line:
                return True
        return False

    def running(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def end(self, sign: signal.Signals | None = None) -> int:
        """Wait for its end, after a signal if one is given; its exit code."""
        assert self.process.stderr is not None
        if sign is not None:
            self.process.send_signal(sign)
        with self.process.stderr:
            self.said += self.process.stderr.read()
        return self.process.wait(PATIENCE_S)

    def gone(self, seconds: float = 5.0) -> bool:
        """Whether nothing that it started is left after some seconds."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            try:
                os.killpg(self.process.pid, 0)
            except ProcessLookupError:
                return True
            time.sleep(0.05)
        return False

    def has_open(self, path: Path) -> bool:
        """Whether it holds a file or folder open."""
        try:
            links = list(Path(f"/proc/{self.process.pid}/fd").iterdir())
            return any(link.resolve() == path.resolve() for link in links)
        except OSError:
            return False


class Desk:
    """A small design and another of its name, a filled cache, and what calm builds give.

    Parameters
    ----------
    root : Path
        Folder for everything.
    """

    def __init__(self, root: Path) -> None:
        from phytac_design.design.design_file import load_design, parse_design

        self.root, self.store = root.resolve(), root.resolve() / "cache"
        data = load_design("cylinder60").model_dump(mode="json")
        for name, change in SMALL.items():
            data[name] = {**data[name], **change} if isinstance(change, dict) else change
        self.design, self.other = self.root / "small.toml", self.root / "other.toml"
        self.design.write_text(to_toml(parse_design(data, "small")))
        data["material"]["modulus_MPa"] *= 0.95
        self.other.write_text(to_toml(parse_design(data, "other")))
        self.reference: dict[str, dict[str, str]] = {}
        for name, only, design in (
            ("mesh", "mesh", self.design),
            ("views,mesh", "views,mesh", self.design),
            ("other", "mesh", self.other),
        ):
            out = self.root / f"calm-{name}"
            code = self.build(out, self.store, only=only, design=design).end()
            assert code == 0
            self.reference[name] = files_of(out)

    def build(
        self,
        out: Path,
        store: Path,
        *,
        only: str = "mesh",
        design: Path | None = None,
        before: tuple[str, ...] = (),
    ) -> Run:
        """Start a build of the small design."""
        words = ("build", str(design or self.design), "--out", str(out), "--accuracy", "draft")
        return Run(*words, "--only", only, folder=self.root, store=store, before=before)

    def whole(self, name: str, out: Path, store: Path) -> Run:
        """Start a whole draft build of a shipped design."""
        words = ("build", name, "--out", str(out), "--accuracy", "draft")
        return Run(*words, folder=self.root, store=store)


class Disk:
    """A disk of little room, which can grow and be made read-only.

    Parameters
    ----------
    at : Path
        Where it is; a folder where none may be mounted.
    """

    def __init__(self, at: Path) -> None:
        at.mkdir()
        self.at = at
        self._mounted = self._mount(f"size={BYTES}", "-t", "tmpfs", "tmpfs")
        self.limited: tuple[str, ...] = (
            () if self._mounted else ("prlimit", f"--fsize={BYTES_LIMIT}")
        )

    def __enter__(self) -> Self:
        """Give it out."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take it away."""
        self.unlock()
        if self._mounted:
            subprocess.run(["umount", str(self.at)], check=True)

    @property
    def how(self) -> str:
        """What it is."""
        return (
            f"a file system of {BYTES // 1000} kB"
            if self._mounted
            else f"a limit of {BYTES_LIMIT // 1000} kB for files"
        )

    def grow(self) -> None:
        """Make room."""
        if self._mounted:
            self._mount("remount,size=64m")

    def lock(self) -> str:
        """Make it read-only; how."""
        if self._mounted:
            self._mount("remount,ro")
            return "a file system mounted read-only"
        for folder in (self.at, *(path for path in self.at.rglob("*") if path.is_dir())):
            folder.chmod(0o555)
        return "folders without the right to write"

    def unlock(self) -> None:
        """Make it writable."""
        if self._mounted:
            self._mount("remount,rw")
        else:
            for folder in (self.at, *(path for path in self.at.rglob("*") if path.is_dir())):
                folder.chmod(0o755)

    def _mount(self, options: str, *words: str) -> bool:
        if os.geteuid() != 0 or shutil.which("mount") is None:
            return False
        command = ["mount", "-o", options, *words, str(self.at)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0


class Look:
    """What was looked for after one fault.

    Parameters
    ----------
    root : Path
        Left out of what is told.
    """

    def __init__(self, root: Path) -> None:
        self._root = f"{root.resolve()}/"
        self._told: list[str] = []
        self._missed: list[str] = []

    def note(self, text: str) -> None:
        """Tell something that cannot be wrong."""
        self._told.append(text)

    def true(self, text: str, so: bool) -> None:
        """Tell what was seen, and whether it is as it should be."""
        (self._told if so else self._missed).append(text)

    def refusal(self, run: Run, hint: str) -> None:
        """One line with a hint, and exit code 3."""
        code = run.end()
        lines = [line for line in run.said.splitlines() if line.startswith("error: ")]
        said = lines[-1] if lines else run.said[-200:]
        right = code == 3 and len(lines) == 1 and hint in said and "Traceback" not in run.said
        self.true(f"exit code {code}, {said!r}", right)

    def row(self, table: Table, case: str) -> None:
        """Add the row: 1 if everything was as it should be."""
        missed = [f"NOT as it should be: {text}" for text in self._missed]
        note = "; ".join([*missed, *self._told]).replace(self._root, "")
        table.add(
            case,
            float(not missed),
            "",
            reference=1,
            source="docs/hardening.md; a process of its own",
            target="== 1",
            note=note,
        )
