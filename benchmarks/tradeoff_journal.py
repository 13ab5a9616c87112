"""Results of long runs, each in a file of its own, keyed by design, program and case."""

import json
import os
from collections.abc import Callable
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
