"""What a stage is: a pure function of the design's tables and of earlier stages, writing files."""

import ctypes
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.field_groups import values_of
from phytac_design.design.scene import Scene
from phytac_design.design.spec import Design
from phytac_design.engine.cache import record as cache_record
from phytac_design.layout.markers import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface

EXPORT = "export"
"""Files below this folder of a result are the user's; the rest is for later stages."""


@dataclass(frozen=True, kw_only=True)
class Context:
    """Inputs of a running stage.

    Attributes
    ----------
    design : Design
        The resolved design.
    accuracy : Accuracy
        The preset's settings.
    seed : int
        Seed of everything random.
    folders : dict
        Result folder of each stage that this one depends on.
    progress : callable
        Called with a short progress text.
    array_names : dict
        For the stages of which the running stage reads only some arrays, the names of those.
    scene : Scene, optional
        Scope of the build; None for everything.
    """

    design: Design
    accuracy: Accuracy
    seed: int
    folders: dict[str, Path] = field(default_factory=dict)
    progress: Callable[[str], None] = print
    array_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    scene: Scene | None = None

    @cached_property
    def sensor(self) -> Sensor:
        """The design with its surface, markers and cameras."""
        return _sensor_of(self.design)

    @property
    def surface(self) -> Surface:
        """The sensing surface."""
        return self.sensor.surface

    @property
    def markers(self) -> Markers:
        """The markers on it."""
        return self.sensor.markers

    def facts(self, stage: str) -> dict[str, Any]:
        """Figures of an earlier stage."""
        data: dict[str, Any] = json.loads((self.folders[stage] / "facts.json").read_text())
        return data

    def arrays(self, stage: str) -> dict[str, Any]:
        """Arrays of an earlier stage."""
        with np.load(self.folders[stage] / "arrays.npz") as data:
            return {name: data[name] for name in self.array_names.get(stage, data.files)}


@lru_cache(maxsize=1)
def _sensor_of(design: Design) -> Sensor:
    """Sensor that stages of one build share: heights by lines of sight take 0.3 s."""
    return Sensor(design)


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One step of a build.

    Attributes
    ----------
    name : str
        As in ``--only`` and the timings.
    design_fields : tuple of str
        Design fields that it reads, in the names of :mod:`field_groups`. A change of any other
        field does not rerun it.
    settings : tuple of str
        Settings of the accuracy preset that it reads.
    depends_on : tuple of str
        Stages whose results it reads.
    arrays : dict
        For some of these stages, the only arrays that it reads; the others may change.
    seeded : bool
        Whether it draws random numbers.
    graphics : bool
        Whether it does more where the machine has graphics libraries.
    scene : tuple of str
        Properties of a scene that it reads.
    imports : tuple of str
        Packages of :data:`.runner.IMPORT_s` that it imports.
    only_with : str
        Setting of the accuracy preset without which it makes nothing; "" if it always does.
    gate : callable or None
        Reads the stage's result and returns why the build should stop here; "" to continue.
    finish : callable or None
        Called with the exports folder after the files are written. Adds what the cached result
        does not depend on, such as the design's name.
    run : callable
        Writes ``facts.json``, ``arrays.npz`` and ``export/…`` into the given folder.
    """

    name: str
    design_fields: tuple[str, ...]
    run: Callable[[Context, Path], None]
    settings: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()
    arrays: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seeded: bool = False
    graphics: bool = False
    scene: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()
    only_with: str = ""
    gate: Callable[[Context], str] | None = None
    finish: Callable[[Design, Path], None] | None = None

    def makes(self, accuracy: Accuracy) -> bool:
        """Whether it makes anything with these settings."""
        return not self.only_with or bool(getattr(accuracy, self.only_with))

    def make(self, context: Context, folder: Path) -> None:
        """Run, or write why there is no result."""
        if self.makes(context.accuracy):
            self.run(context, folder)
            return
        why = f"quick settings; --set {self.only_with}=true makes it"
        context.progress(f"{self.name}: left out ({why})")
        write_facts(folder, {"left_out": why, "parts": []})

    def inputs(self, context: Context, keys: dict[str, str]) -> dict[str, Any]:
        """Everything the result depends on, as plain values.

        A dependency with a result in ``context.folders`` enters by the hashes of its contents, so
        an unchanged result reruns nothing. Any other enters by its key.
        """
        settings = context.accuracy.as_dict()
        read = (*self.settings, self.only_with) if self.only_with else self.settings
        values = context.scene.inputs(self.scene) if context.scene else {}
        if "regions" in values:  # which markers belong to a region depends on the footprint
            values["footprint_mm"] = context.design.switch.footprint_diameter_mm
        # A build without a scene keeps its keys.
        limits = {"scene": values} if values else {}
        return limits | {
            "reads": values_of(context.design, self.design_fields),
            "knobs": {name: settings[name] for name in read},
            "needs": {name: self._dependency(name, context, keys) for name in self.depends_on},
            "seed": context.seed if self.seeded else None,
            "graphics": graphics_libraries() if self.graphics else None,
        }

    def _dependency(self, name: str, context: Context, keys: dict[str, str]) -> Any:
        """What represents a dependency in the key."""
        folder = context.folders.get(name)
        if folder is None:
            return keys[name]
        made = cache_record(folder)
        if name in self.arrays:
            return {array: made["arrays"][array] for array in self.arrays[name]}
        return made["files"]


def array_hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of each array that a stage wrote, shape and type included."""
    path = folder / "arrays.npz"
    if not path.is_file():
        return {}
    out = {}
    with np.load(path) as data:
        for name in data.files:
            array = np.ascontiguousarray(data[name])
            kind = f"{array.dtype.str}{array.shape}"
            out[name] = sha256(kind.encode() + array.tobytes()).hexdigest()
    return out


@cache
def graphics_libraries() -> dict[str, bool]:
    """Which of the system's graphics libraries can be loaded; installing one reruns stages."""
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


def thumbnail_path(folder: Path, name: str) -> Path:
    """Path of the small picture of an exported one, below a stage's folder."""
    return folder / "thumbnails" / f"{Path(name).stem}.jpg"


def write_text(folder: Path, name: str, text: str) -> None:
    """Write a text that is exported."""
    export_path(folder, name).write_text(text, encoding="utf-8")


def write_facts(folder: Path, facts: dict[str, Any]) -> None:
    """Write a stage's figures."""
    (folder / "facts.json").write_text(json.dumps(facts, indent=1, sort_keys=True))


def write_arrays(folder: Path, arrays: dict[str, Any]) -> None:
    """Write a stage's arrays."""
    np.savez(folder / "arrays.npz", allow_pickle=False, **arrays)
