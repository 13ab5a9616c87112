"""What the cache holds, and keeping it within bounds: the least recently used goes first."""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from phytac_design.core.cache_folder import cache_root
from phytac_design.engine.cache import (
    LOCK,
    RECORD,
    age_s,
    damaged_file,
    locked,
    record,
    same_file,
)
from phytac_shapes.errors import DesignError

LIMIT_GB = 10.0
"""Size that a build leaves the cache at most, unless ``$PHYTAC_CACHE_GB`` says another."""
GB = 1e9


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
    text = os.environ.get("PHYTAC_CACHE_GB", "")
    try:
        size = float(text) if text else LIMIT_GB
    except ValueError:
        size = -1.0
    if not (size >= 0.0 and isfinite(size)):
        raise DesignError(
            "cache-size-invalid",
            f"PHYTAC_CACHE_GB is {text!r}; it is a size in gigabytes, as in 10",
        )
    return size * GB


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
    return Pruned(dropped=dropped, freed_bytes=freed, leftovers=_sweep(), in_use=in_use)


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


def _sweep() -> int:
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
