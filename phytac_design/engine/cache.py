"""Stage results, content-addressed: a folder per stage and key, published by one rename.

Safe under builds at once and under kills: whoever makes a result holds a lock on its key, which
the system frees when the process ends; whoever reads results holds them against eviction.
"""

import errno
import fcntl
import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import IO, Any

from phytac_design.core.cache_folder import cache_root
from phytac_shapes.errors import DesignError, OutputError

RECORD = "stage.json"
LOCK = ".lock"
"""What the file ends in that is locked while a result of its key is made."""


@cache
def code_hash() -> str:
    """Hash of the project's own source: a changed program makes new results."""
    # Suffixes of the program's own files: pages are made of more than Python.
    sources = {".py", ".js", ".css", ".html"}
    digest = sha256()
    for package in ("phytac_shapes", "phytac_decoder", "phytac_design"):
        spec = find_spec(package)
        for folder in spec.submodule_search_locations or () if spec else ():
            for path in sorted(p for p in Path(folder).rglob("*") if p.suffix in sources):
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


def lookup(name: str, key: str, *, report: Callable[[str], None] = lambda _: None) -> Path | None:
    """Folder of a finished and intact result, or None; it counts as used now.

    Every file is read and compared with the hash that it was published with. ``report`` is called
    with a sentence if a result is there but damaged.
    """
    folder = folder_of(name, key)
    if not folder.is_dir():
        return None
    if path := damaged_file(folder):
        report(f"warning: the cached result of {name} is damaged ({path}) and is computed again")
        return None
    # The time of the last use only serves eviction: a read-only cache still works.
    with suppress(OSError):
        os.utime(folder / RECORD)
    return folder


def damaged_file(folder: Path) -> str:
    """First file of a result that is not, byte for byte, as it was published; "" if none."""
    try:
        made = record(folder)
        if made.pop("checksum") != _checksum(made):
            return RECORD
        files: dict[str, list[Any]] = made["files"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return RECORD
    for path, (size, digest) in files.items():
        try:
            intact = (folder / path).stat().st_size == size and file_hash(folder / path) == digest
        except OSError:
            intact = False
        if not intact:
            return path
    return ""


def _checksum(made: dict[str, Any]) -> str:
    return sha256(json.dumps(made, sort_keys=True).encode()).hexdigest()


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
            # Not tempfile.mkdtemp: results are readable as the umask says, not by the owner alone.
            scratch = final.parent / f".{key[:8]}-{secrets.token_hex(6)}"
            scratch.mkdir()
        except OSError as error:
            raise _unwritable(error) from None
        try:
            made = work(scratch)
            made["files"] = {
                path.relative_to(scratch).as_posix(): [path.stat().st_size, file_hash(path)]
                for path in sorted(scratch.rglob("*"))
                if path.is_file()
            }
            # As it will be read back: tuples are lists in JSON.
            made = json.loads(json.dumps(made))
            made["checksum"] = _checksum(made)
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
        "output-not-writable",
        f"cannot write the cache {cache_root()}: {error.strerror}; make room (phytac cache "
        "--prune 0), or set PHYTAC_CACHE to a folder you may write",
    )


@contextmanager
def _alone(path: Path, waiting: Callable[[], None]) -> Iterator[None]:
    """Hold the lock file ``path``; it is gone afterwards."""
    reported = False
    while True:
        with path.open("w") as stream:
            if not reported and not locked(stream, fcntl.LOCK_EX):
                reported = True
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


def solved_once(name: str, inputs: Any, solve: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What ``solve`` finds for inputs, as plain values, from the cache if it is there.

    A cache that cannot be written, as on a full disk, is no fault: nothing in it is the user's.
    """

    def work(_: Path) -> dict[str, Any]:
        return solve()

    try:
        return record(publish(name, stage_key(name, inputs), work))
    except OutputError:
        return solve()


def age_s(folder: Path) -> float:
    """Seconds since a result was last used."""
    return max(time.time() - (folder / RECORD).stat().st_mtime, 0.0)


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One result.

    Attributes
    ----------
    stage : str
        Which stage made it.
    folder : Path
        Where it is.
    size_bytes : int
        Of its files.
    age_s : float
        Since it was last used.
    seconds : float
        What it took to make.
    """

    stage: str
    folder: Path
    size_bytes: int
    age_s: float
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Pruned:
    """Results dropped and their bytes, leftovers of killed runs, results that are in use."""

    dropped: int
    freed_bytes: int
    leftovers: int
    in_use: int


def limit_bytes() -> float:
    """Size that the cache is kept within.

    Raises
    ------
    DesignError
        If ``$PHYTAC_CACHE_GB`` is not a size.
    """
    gb = 1e9
    # Size that a build leaves the cache at most, unless ``$PHYTAC_CACHE_GB`` says another.
    limit_gb = 10.0
    text = os.environ.get("PHYTAC_CACHE_GB", "")
    try:
        size = float(text) if text else limit_gb
    except ValueError:
        size = -1.0
    if not (size >= 0.0 and isfinite(size)):
        raise DesignError(
            "cache-size-invalid",
            f"PHYTAC_CACHE_GB is {text!r}; it is a size in gigabytes, as in 10",
        )
    return size * gb


def entries() -> list[Entry]:
    """Every finished result, the least recently used first."""
    found = []
    for folder in _folders():
        try:
            made = record(folder)
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
            found.append(
                Entry(
                    stage=folder.parent.name,
                    folder=folder,
                    size_bytes=size,
                    age_s=age_s(folder),
                    seconds=float(made.get("seconds", 0.0)),
                )
            )
        except (OSError, ValueError):  # another process is dropping it
            continue
    return sorted(found, key=lambda entry: (-entry.age_s, str(entry.folder)))


def _folders() -> Iterator[Path]:
    root = cache_root()
    if root.is_dir():
        yield from sorted(path.parent for path in root.glob(f"*/*/{RECORD}"))


def damaged() -> list[Path]:
    """Results whose files are not, byte for byte, those that were published; reads all of them."""
    return [folder for folder in _folders() if damaged_file(folder)]


def prune(*, limit_bytes: float, older_than_s: float = float("inf")) -> Pruned:
    """Drop what is older than asked, then the least recently used until the rest fits.

    Results that a running build reads stay, whatever the limit. What killed runs left goes.
    """
    every = entries()
    total = sum(entry.size_bytes for entry in every)
    dropped = freed = in_use = 0
    for entry in every:
        if entry.age_s <= older_than_s and total <= limit_bytes:
            continue
        if not drop(entry.folder):
            in_use += 1
            continue
        dropped += 1
        freed += entry.size_bytes
        total -= entry.size_bytes
    return Pruned(dropped=dropped, freed_bytes=freed, leftovers=sweep(), in_use=in_use)


def drop(folder: Path) -> bool:
    """Remove a result unless a build reads it; it is either whole or gone at every instant."""
    try:
        stream = (folder / RECORD).open("rb")
    except OSError:
        return True
    gone = folder.with_name(f".gone-{folder.name}-{os.getpid()}")
    with stream:
        if not locked(stream, fcntl.LOCK_EX) or not same_file(stream, folder / RECORD):
            return False
        try:
            folder.rename(gone)
        except OSError:
            return False
    shutil.rmtree(gone, ignore_errors=True)
    return True


def sweep() -> int:
    """Remove scratch folders and lock files that no running build owns."""
    root, count = cache_root(), 0
    if not root.is_dir():
        return 0
    # Folders before locks: whoever owns one of these holds its lock still, or is dead.
    scratch = [path for path in root.glob("*/.*") if path.is_dir()]
    busy = set()
    for path in root.glob(f"*/.*{LOCK}"):
        with suppress(FileNotFoundError), path.open("r") as stream:
            if locked(stream, fcntl.LOCK_EX) and same_file(stream, path):
                path.unlink(missing_ok=True)
            else:
                busy.add((path.parent, path.name[1:9]))
    for path in scratch:
        if (path.parent, path.name[1:9]) not in busy:
            shutil.rmtree(path, ignore_errors=True)
            count += 1
    return count
