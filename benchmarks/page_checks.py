"""``phytac check`` as a user runs it: shipped designs pass, broken ones are repaired as it says."""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, shipped_designs, to_toml
from phytac_design.study.advice.design_variables import with_fields

BROKEN: dict[str, tuple[str, dict[str, Any]]] = {
    "markers hidden": (
        "grip",
        {"shape.diameters_mm": [60.0, 44.0, 44.0, 60.0, 56.0]},
    ),
    "fused": ("cylinder60", {"layout.spiral_angle_deg": 10.0, "layout.height_far_mm": 5.0}),
    "camera too close": ("cylinder60", {"camera.stand_off_mm": 3.0}),
}
"""A shipped design, and the fields that break it."""
CHANGE = re.compile(r"(\w+\.\w+) \S+ → ([^\s,]+)")


def checked(design: str) -> tuple[bool, str, float]:
    """Whether a design passes, what is printed, and the seconds."""
    words = [sys.executable, "-m", "phytac_design", "check", design]
    begin = time.monotonic()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stderr + done.stdout, time.monotonic() - begin


def named_fields(said: str) -> dict[str, Any]:
    """Fields that the output of a check says to change, with their new values."""
    last = said.strip().splitlines()[-1]
    if last.startswith("this repairs it: "):
        return {name: _value(text) for name, text in CHANGE.findall(last)}
    return {}


def _value(text: str) -> float | int | str:
    """A number, or a word such as ``fit``."""
    try:
        number = float(text)
    except ValueError:
        return text
    return int(number) if number.is_integer() else number


def checks(table: Table, *, quick: bool) -> None:
    """Check the shipped designs and three broken ones; apply what is named to these."""
    names = shipped_designs()[: 2 if quick else None]
    outcomes = {name: checked(name) for name in names}
    failed = [name for name, (passed, _, _) in outcomes.items() if not passed]
    seconds = max(taken for _, _, taken in outcomes.values())
    row = "phytac check: shipped designs that do not pass"
    source = f"{len(names)} designs, the slowest in {seconds:.1f} s"
    table.add(row, len(failed), "designs", 0, source, "== 0", ", ".join(failed))
    for name, (base, fields) in list(BROKEN.items())[-1 if quick else 0 :]:
        design = with_fields(load_design(base), fields)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "mine.toml"
            path.write_text(to_toml(design), encoding="utf-8")
            passed, said, seconds = checked(str(path))
            change = named_fields(said)
            cured = False
            if change:
                path.write_text(to_toml(with_fields(design, change)), encoding="utf-8")
                cured = checked(str(path))[0]
        row = f"phytac check: broken {base} ({name}), repaired by the change that it names"
        note = f"{', '.join(f'{field} = {value}' for field, value in change.items()) or 'none'}"
        source = f"refused: {not passed}; named in {seconds:.1f} s"
        table.add(row, int(cured and not passed), "", 1, source, "== 1", note)
