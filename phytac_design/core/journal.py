"""Finished results of a long run on disk, so that a killed run resumes where it ended.

Each result is one file, written by one rename and checked by its own digest: a file that was cut
short counts as missing. A lock keeps two runs out of one folder.
"""

import fcntl
import io
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from phytac_shapes.errors import OutputError


class Journal:
    """Results by key, below ``folder``.

    Parameters
    ----------
    folder : Path
        The journal's own folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @contextmanager
    def opened(self, run: str, *, force: bool = False) -> Iterator[None]:
        """Lock the folder for one run, and keep what an earlier run of the same name stored.

        Parameters
        ----------
        run : str
            Hash of all that the results depend on.
        force : bool
            Drop results of another run.

        Raises
        ------
        OutputError
            If the folder cannot be written, another process holds it, or it has results of
            another run and ``force`` is not set.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = (self.folder / "lock").open("w")
        except OSError as error:
            raise OutputError(
                "output-not-writable",
                f"cannot write {self.folder.parent}: {error.strerror}; choose another --out",
            ) from None
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise OutputError(
                    "output-locked",
                    f"another run is writing to {self.folder.parent}; wait for it, or choose "
                    "another --out",
                ) from None
            self._claim(run, force=force)
            yield

    def _claim(self, run: str, *, force: bool) -> None:
        note = self.folder / "run.json"
        if note.is_file():
            try:
                if json.loads(note.read_text())["key"] == run:
                    return
            except (ValueError, KeyError, TypeError):
                pass  # Damaged: of another run.
            if not force:
                raise OutputError(
                    "output-foreign",
                    f"{self.folder} holds results of an interrupted run with other settings, or of "
                    "another version of the program; add --force to drop them, or choose another "
                    "--out",
                )
        for path in self.folder.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif path.name != "lock":
                path.unlink()
        write_atomically(note, json.dumps({"key": run}).encode())

    def path(self, key: str) -> Path:
        """File of a result."""
        name = sha256(key.encode()).hexdigest()
        return self.folder / name[:2] / f"{name[2:32]}.bin"

    def put(
        self, key: str, facts: Mapping[str, Any], arrays: Mapping[str, Any] | None = None
    ) -> None:
        """Store a result: plain values that JSON holds, and arrays."""
        stream = io.BytesIO()
        text = np.frombuffer(json.dumps(facts, sort_keys=True).encode(), dtype=np.uint8)
        np.savez(stream, allow_pickle=False, **(arrays or {}), facts=text)
        body = stream.getvalue()
        path = self.path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, sha256(body).digest() + body)

    def get(self, key: str) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Facts and arrays of a result; None if it is missing or damaged."""
        try:
            data = self.path(key).read_bytes()
        except OSError:
            return None
        digest, body = data[:32], data[32:]
        if sha256(body).digest() != digest:
            return None
        with np.load(io.BytesIO(body), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return json.loads(arrays.pop("facts").tobytes()), arrays

    def drop(self) -> None:
        """Remove all, when the run is complete."""
        shutil.rmtree(self.folder, ignore_errors=True)


def write_atomically(path: Path, data: bytes, *, mode: int | None = None) -> None:
    """Write a file by one rename: it is complete or absent, whenever the process is killed."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        partial.write_bytes(data)
        if mode is not None:
            partial.chmod(mode)
        partial.replace(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
