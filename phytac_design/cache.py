"""Stage results, content-addressed: a folder per stage and key, published by one rename."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from shapes.errors import OutputError

RECORD = "stage.json"


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
    import decoder
    import phytac_design
    import shapes

    digest = sha256()
    for package in (shapes, decoder, phytac_design):
        for folder in package.__path__:
            for path in sorted(Path(folder).rglob("*.py")):
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


def lookup(name: str, key: str) -> Path | None:
    """Folder of a finished result, or None."""
    folder = cache_root() / name / key[:24]
    return folder if (folder / RECORD).is_file() else None


def publish(name: str, key: str, work: Callable[[Path], dict[str, Any]]) -> Path:
    """Run ``work`` in a fresh folder and publish it whole, or not at all.

    A run that is killed leaves only a temporary folder; two runs of the same key both finish and
    the first one published stays.

    Raises
    ------
    OutputError
        If the cache folder cannot be written.
    """
    final = cache_root() / name / key[:24]
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{key[:8]}-", dir=final.parent))
    except OSError as error:
        raise OutputError(
            f"cannot write the cache {cache_root()}: {error.strerror}; set PHYTAC_CACHE to a "
            "folder you may write"
        ) from None
    try:
        record = work(scratch)
        (scratch / RECORD).write_text(json.dumps(record, sort_keys=True))
        try:
            scratch.rename(final)
        except OSError:
            if lookup(name, key) is None:
                raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return final


def record(folder: Path) -> dict[str, Any]:
    """Return what the stage wrote about itself (seconds, facts)."""
    data: dict[str, Any] = json.loads((folder / RECORD).read_text())
    return data
