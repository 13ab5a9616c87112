"""Stage results, content-addressed: a folder per stage and key, published by one rename.

Safe under builds at once and under kills: whoever makes a result holds a lock on its key, which
the system frees when the process ends; whoever reads results holds them against eviction.
"""

import errno
import fcntl
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from phytac_shapes.errors import OutputError

RECORD = "stage.json"
SOURCES = {".py", ".js", ".css", ".html"}
"""Suffixes of the program's own files: pages are made of more than Python."""
LOCK = ".lock"
"""What the file ends in that is locked while a result of its key is made."""


def cache_root() -> Path:
    """Folder of the cache: ``$PHYTAC_CACHE``, or ``phytac`` in the user's cache folder."""
    own = os.environ.get("PHYTAC_CACHE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "phytac"


@cache
def code_hash() -> str:
    """Hash of the project's own source: a changed program makes new results."""
    import phytac_decoder
    import phytac_design
    import phytac_shapes

    digest = sha256()
    for package in (phytac_shapes, phytac_decoder, phytac_design):
        for folder in package.__path__:
            for path in sorted(p for p in Path(folder).rglob("*") if p.suffix in SOURCES):
                digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def stage_key(name: str, inputs: Any) -> str:
    """Key of a stage's result: hash of its name, its inputs and the program."""
    text = json.dumps([name, code_hash(), inputs], sort_keys=True)
    return sha256(text.encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, as hex."""
    digest = sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def folder_of(name: str, key: str) -> Path:
    """Where the result of a key is, or would be."""
    return cache_root() / name / key[:24]


def lookup(name: str, key: str) -> Path | None:
    """Folder of a finished and whole result, or None; it counts as used now."""
    folder = folder_of(name, key)
    if not is_whole(folder):
        return None
    # When it was last used is only for eviction: a cache that may not be written still serves.
    with suppress(OSError):
        os.utime(folder / RECORD)
    return folder


def is_whole(folder: Path, *, read: bool = False) -> bool:
    """Whether a result has every file that it was published with, by size or (``read``) content."""
    try:
        files: dict[str, list[Any]] = record(folder)["files"]
        return all(
            (folder / path).stat().st_size == size
            and (not read or file_hash(folder / path) == digest)
            for path, (size, digest) in files.items()
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False


def publish(
    name: str,
    key: str,
    work: Callable[[Path], dict[str, Any]],
    *,
    waiting: Callable[[], None] = lambda: None,
) -> Path:
    """Run ``work`` in a fresh folder and publish it whole, or not at all.

    Parameters
    ----------
    name, key : str
        Stage, and :func:`stage_key`.
    work : callable
        Writes files into the folder it is given and returns the record.
    waiting : callable
        Called once if another process is making the same result: this one waits, and takes it.

    Returns
    -------
    folder : Path
        Of the result, made now or, meanwhile, by another.

    Raises
    ------
    OutputError
        If the cache folder cannot be written, or its disk is full.
    """
    final = folder_of(name, key)
    with ExitStack() as stack:
        try:
            final.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(_alone(final.with_name(f".{final.name}{LOCK}"), waiting))
            if (done := lookup(name, key)) is not None:
                return done
            # What is here now is of a run that was killed, or was damaged since.
            for left in (final, *final.parent.glob(f".{key[:8]}-*")):
                shutil.rmtree(left, ignore_errors=True)
            scratch = Path(tempfile.mkdtemp(prefix=f".{key[:8]}-", dir=final.parent))
        except OSError as error:
            raise _unwritable(error) from None
        try:
            made = work(scratch)
            made["files"] = {
                path.relative_to(scratch).as_posix(): [path.stat().st_size, file_hash(path)]
                for path in sorted(scratch.rglob("*"))
                if path.is_file()
            }
            (scratch / RECORD).write_text(json.dumps(made, sort_keys=True))
            scratch.rename(final)
        except OSError as error:
            if error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}:
                raise _unwritable(error) from None
            raise
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    return final


def _unwritable(error: OSError) -> OutputError:
    return OutputError(
        f"cannot write the cache {cache_root()}: {error.strerror}; make room (phytac cache "
        "--prune 0), or set PHYTAC_CACHE to a folder you may write"
    )


@contextmanager
def _alone(path: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """Hold the lock file ``path``; it is gone afterwards."""
    told = False
    while True:
        with path.open("w") as stream:
            if not told and not locked(stream, fcntl.LOCK_EX):
                told = True
                waiting()
            fcntl.flock(stream, fcntl.LOCK_EX)
            # The one before us took the file away as it left: then ours is nobody's lock.
            if not same_file(stream, path):
                continue
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
            return


def locked(stream: IO[Any], kind: int) -> bool:
    """Take a lock on an open file if that needs no waiting; say whether."""
    try:
        fcntl.flock(stream, kind | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def same_file(stream: IO[Any], path: Path) -> bool:
    """Whether an open file is still the one at ``path``."""
    try:
        return os.path.samestat(os.fstat(stream.fileno()), path.stat())
    except OSError:
        return False


@contextmanager
def held(folder: Path) -> Iterator[bool]:
    """Keep a result from being evicted; False if it was gone already."""
    try:
        stream = (folder / RECORD).open("rb")
    except OSError:
        yield False
        return
    with stream:
        fcntl.flock(stream, fcntl.LOCK_SH)
        yield same_file(stream, folder / RECORD)


def record(folder: Path) -> dict[str, Any]:
    """Return what the stage wrote about itself (seconds, files with size and hash)."""
    data: dict[str, Any] = json.loads((folder / RECORD).read_text())
    return data


def age_s(folder: Path) -> float:
    """Seconds since a result was last used."""
    return max(time.time() - (folder / RECORD).stat().st_mtime, 0.0)
