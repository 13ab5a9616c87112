"""What a stage is: a pure function of the design's tables and of earlier stages, writing files."""

import ctypes
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.accuracy import Accuracy
from phytac_design.layout import Markers, make_markers
from phytac_design.spec import Design
from shapes import Surface

EXPORT = "export"
"""Files below this folder of a result are the user's; the rest is for later stages."""


@dataclass(frozen=True, kw_only=True)
class Context:
    """What a running stage sees.

    Attributes
    ----------
    design : Design
        The resolved design.
    accuracy : Accuracy
        The preset's settings.
    seed : int
        Seed of everything random.
    folders : dict
        Result folder of each stage that this one needs.
    progress : callable
        Called with a short text about what is being done.
    """

    design: Design
    accuracy: Accuracy
    seed: int
    folders: dict[str, Path] = field(default_factory=dict)
    progress: Callable[[str], None] = print

    @cached_property
    def surface(self) -> Surface:
        """The sensing surface."""
        return self.design.surface()

    @cached_property
    def markers(self) -> Markers:
        """The markers on it."""
        return make_markers(self.design, self.surface)

    def facts(self, stage: str) -> dict[str, Any]:
        """Figures that an earlier stage reported."""
        data: dict[str, Any] = json.loads((self.folders[stage] / "facts.json").read_text())
        return data

    def arrays(self, stage: str) -> dict[str, Any]:
        """Arrays that an earlier stage left."""
        with np.load(self.folders[stage] / "arrays.npz") as data:
            return {name: data[name] for name in data.files}


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One step of a build.

    Attributes
    ----------
    name : str
        As in ``--only`` and the timings.
    tables : tuple of str
        Tables of the design file that it reads: a change elsewhere does not run it again.
    knobs : tuple of str
        Settings of the accuracy preset that it reads.
    needs : tuple of str
        Stages it reads from.
    seeded : bool
        Whether it draws random numbers.
    graphics : bool
        Whether it does more where the machine has graphics libraries.
    gate : callable or None
        Reads the stage's result and says why a build should stop here; "" to go on.
    run : callable
        Writes ``facts.json``, ``arrays.npz`` and ``export/…`` into the folder it is given.
    """

    name: str
    tables: tuple[str, ...]
    run: Callable[[Context, Path], None]
    knobs: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    seeded: bool = False
    graphics: bool = False
    gate: Callable[[Context], str] | None = None

    def inputs(self, context: Context, keys: dict[str, str]) -> dict[str, Any]:
        """Everything the result depends on, as plain values."""
        tables = context.design.model_dump(mode="json", include=set(self.tables))
        settings = context.accuracy.as_dict()
        return {
            "tables": tables,
            "knobs": {knob: settings[knob] for knob in self.knobs},
            "needs": {name: keys[name] for name in self.needs},
            "seed": context.seed if self.seeded else None,
            "graphics": graphics_libraries() if self.graphics else None,
        }


@cache
def graphics_libraries() -> dict[str, bool]:
    """Which of the system's graphics libraries can be loaded: installing one runs stages again."""
    found = {}
    for name in ("libEGL.so.1", "libGL.so.1", "libX11.so.6"):
        try:
            ctypes.CDLL(name)
            found[name] = True
        except OSError:
            found[name] = False
    return found


def export_path(folder: Path, name: str) -> Path:
    """Path of an exported file below a stage's folder; makes its parent."""
    path = folder / EXPORT / name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def write_facts(folder: Path, facts: dict[str, Any]) -> None:
    """Write a stage's figures."""
    (folder / "facts.json").write_text(json.dumps(facts, indent=1, sort_keys=True))


def write_arrays(folder: Path, arrays: dict[str, Any]) -> None:
    """Write a stage's arrays."""
    np.savez(folder / "arrays.npz", allow_pickle=False, **arrays)
