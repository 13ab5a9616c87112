"""Advice as files: the report, and each changed design, ready to build."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

from phytac_design.design.design_file import to_toml
from phytac_design.study.advice.advice_report import as_dict, polished_dict
from phytac_design.study.advice.advise import Advice
from phytac_shapes.errors import OutputError

if TYPE_CHECKING:
    from phytac_design.study.advice.refinement import RefinedDesign


def write_advice(advice: Advice, folder: Path) -> Path:
    """Write ``advice.json`` and ``advice_N.toml``, the design with piece N applied; the folder.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    texts = {"advice.json": json.dumps(as_dict(advice), indent=1, ensure_ascii=False) + "\n"}
    for number, trial in enumerate(advice.pieces, start=1):
        if trial.design is not None:
            texts[f"advice_{number}.toml"] = to_toml(trial.design)
    return _write(texts, folder)


def write_polished(done: "RefinedDesign", folder: Path) -> Path:
    """Write ``polish.json`` and ``NAME.toml``, the polished design; the design's path.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    name = f"{done.design.name}.toml"
    facts = json.dumps(polished_dict(done), indent=1, ensure_ascii=False) + "\n"
    return _write({"polish.json": facts, name: to_toml(done.design)}, folder) / name


def _write(texts: dict[str, str], folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Pieces of an earlier run are no part of this one.
        for old in folder.glob("advice_*.toml"):
            if old.name not in texts:
                old.unlink()
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"cannot write {folder}: {error.strerror}; choose another --out"
        ) from None
    return folder
