"""Results of long runs, each in a file of its own, keyed by design, program and case; caches."""

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.decoder_data import data_folder
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash


def folder() -> Path:
    """Where the journal lies."""
    path = data_folder() / "tradeoff"
    path.mkdir(parents=True, exist_ok=True)
    return path


def once(design: Design, case: str, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Result of a case: from the journal, or made now."""
    key = sha256(f"{design_hash(design)} {code_hash()} {case}".encode()).hexdigest()[:24]
    path = folder() / f"{key}.json"
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = work()
        partial = path.with_suffix(f".{os.getpid()}.part")
        partial.write_text(json.dumps(found), encoding="utf-8")
        partial.replace(path)
    return found


@contextmanager
def cache_at(path: Path) -> Iterator[None]:
    """Builds use this cache."""
    before = os.environ.get("PHYTAC_CACHE")
    os.environ["PHYTAC_CACHE"] = str(path)
    try:
        yield
    finally:
        os.environ.pop("PHYTAC_CACHE")
        if before is not None:
            os.environ["PHYTAC_CACHE"] = before


@contextmanager
def empty_cache() -> Iterator[Path]:
    """Folder for a build whose cache is empty, gone afterwards."""
    with tempfile.TemporaryDirectory() as name, cache_at(Path(name) / "cache"):
        yield Path(name)
