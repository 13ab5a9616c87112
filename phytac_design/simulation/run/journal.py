"""Finished samples of one job on disk: what a killed run had done is not done again.

Each sample is one file, written whole by one rename and checked by its own digest: a file that was
cut short counts as not done. Two runs into one folder are kept apart by a lock.
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

WORK = ".work"
"""Folder of the journal inside the data set's; gone when the data set is done."""
DIGEST = 32
SHELF = 1000
"""Samples in one folder."""


class Journal:
    """Samples of one job, below ``folder``.

    Parameters
    ----------
    folder : Path
        The data set's folder.
    """

    def __init__(self, folder: Path) -> None:
        self.root = folder / WORK

    @contextmanager
    def opened(self, key: str, *, force: bool = False) -> Iterator[None]:
        """Hold the folder for one run of the job ``key``.

        Raises
        ------
        OutputError
            If it cannot be written, another run holds it, or it has samples of another job and
            ``force`` does not drop them.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            lock = (self.root / "lock").open("w")
        except OSError as error:
            raise OutputError(
                f"cannot write {self.root.parent}: {error.strerror}; choose another --out"
            ) from None
        try:
            with lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except OSError:
                    raise OutputError(
                        f"another run is writing to {self.root.parent}; wait for it, or choose "
                        "another --out"
                    ) from None
                self._claim(key, force=force)
                yield
        finally:
            lock.close()

    def _claim(self, key: str, *, force: bool) -> None:
        note = self.root / "job.json"
        if note.is_file():
            try:
                same = json.loads(note.read_text())["key"] == key
            except (ValueError, KeyError, TypeError):
                same = False
            if same:
                return
            if not force:
                raise OutputError(
                    f"{self.root} holds samples of an interrupted run with other settings, or of "
                    "another version of the program; add --force to drop them, or choose another "
                    "--out"
                )
        for path in self.root.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif path.name != "lock":
                path.unlink()
        write_whole(note, json.dumps({"key": key}).encode())

    def path(self, index: int) -> Path:
        """File of a sample."""
        return self.root / f"{index // SHELF:04d}" / f"{index:06d}.bin"

    def put(self, index: int, arrays: Mapping[str, Any], facts: Mapping[str, Any]) -> None:
        """Store a sample: its arrays, and plain values as JSON."""
        stream = io.BytesIO()
        text = np.frombuffer(json.dumps(facts, sort_keys=True).encode(), dtype=np.uint8)
        np.savez(stream, allow_pickle=False, **arrays, facts=text)
        body = stream.getvalue()
        path = self.path(index)
        path.parent.mkdir(exist_ok=True)
        write_whole(path, sha256(body).digest() + body)

    def get(self, index: int) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Arrays and facts of a sample; None if it is not there whole."""
        try:
            data = self.path(index).read_bytes()
        except OSError:
            return None
        if sha256(data[DIGEST:]).digest() != data[:DIGEST]:
            return None
        with np.load(io.BytesIO(data[DIGEST:]), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        facts = json.loads(arrays.pop("facts").tobytes().decode())
        return arrays, facts

    def drop(self) -> None:
        """Remove all, when the data set is written."""
        shutil.rmtree(self.root, ignore_errors=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file by one rename: it is there whole or not at all, whenever the run is killed."""
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    scratch.write_bytes(data)
    scratch.replace(path)
