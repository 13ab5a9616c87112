"""One measured point: a stage, an error or a choice of use at one setting, in a process of its own.

``python -m phytac_design.study.tradeoff.points`` reads a point as JSON and prints what it found.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.design_file import design_hash, parse_design
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash
from phytac_shapes.errors import NumericalError, OutputError

Kind = Literal["stages", "force", "alone", "truth", "use"]
MARK = "point: "
"""What the line of the result begins with; stages print progress before it."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """What to measure.

    Attributes
    ----------
    kind : str
        ``stages``: run some; ``force``: force errors of settings; ``alone``: those of one knob,
        all else being ideal; ``truth``: those of the simulated sensor's meshes; ``use``: a choice
        of use.
    name : str
        Of the stages, comma separated, or of the knob.
    settings : dict
        Settings that differ from ``draft``, or the choice's value; of errors a list ``each``.
    """

    kind: Kind
    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {"kind": self.kind, "name": self.name, "settings": dict(self.settings)}

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the stages."""
        return tuple(self.name.split(","))

    @property
    def accuracy(self) -> Accuracy:
        """All settings."""
        return replace(PRESETS["draft"], **self.settings)

    @property
    def each(self) -> list[Accuracy]:
        """Many settings whose errors one process finds, as most of the work is the reference."""
        return [replace(PRESETS["draft"], **settings) for settings in self.settings["each"]]


class Points:
    """Measured points of one design in a folder; what a killed run had measured stays.

    Parameters
    ----------
    design : Design
        The sensor.
    folder : Path
        Journal, and the cache that stages are measured in.
    progress : callable
        Called with a line for each point.
    """

    def __init__(
        self, design: Design, folder: Path, progress: Callable[[str], None] = lambda _: None
    ) -> None:
        self.design, self.folder, self.progress = design, folder, progress
        self._prepared: set[str] = set()
        try:
            (folder / "points").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot write {folder}: {error.strerror}; choose another --out"
            ) from None

    def get(self, point: Point) -> dict[str, Any]:
        """Result of a point: from the journal, or measured now.

        Raises
        ------
        NumericalError
            If the measuring process fails.
        """
        path = self.folder / "points" / f"{self._key(point)}.json"
        try:
            found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            found = self._measured(point)
            partial = path.with_suffix(f".{os.getpid()}.part")
            partial.write_text(json.dumps(found | {"point": point.as_dict()}), encoding="utf-8")
            partial.replace(path)
        return found

    def _key(self, point: Point) -> str:
        text = json.dumps([design_hash(self.design), code_hash(), point.as_dict()], sort_keys=True)
        return sha256(text.encode()).hexdigest()[:24]

    def _measured(self, point: Point) -> dict[str, Any]:
        said = ", ".join(
            f"{name} {len(value) if name == 'each' else value}"
            for name, value in point.settings.items()
        )
        if point.kind == "stages":
            self._prepare(point)
        begin = time.perf_counter()
        found = self._asked(point, "measure")
        spent = time.perf_counter() - begin
        self.progress(f"{self.design.name}: {point.kind} {point.name} ({said}): {spent:.1f} s")
        return found

    def _prepare(self, point: Point) -> None:
        """Have what stages need in the cache, so that their own process runs them alone."""
        key = json.dumps(point.as_dict(), sort_keys=True)
        if key not in self._prepared:
            self._asked(point, "prepare")
            self._prepared.add(key)

    def _asked(self, point: Point, mode: str) -> dict[str, Any]:
        asked = {
            "design": self.design.model_dump(mode="json"),
            "point": point.as_dict(),
            "mode": mode,
            "cache": str((self.folder / "cache").resolve()),
        }
        done = subprocess.run(
            [sys.executable, "-m", "phytac_design.study.tradeoff.points"],
            input=json.dumps(asked),
            capture_output=True,
            text=True,
            check=False,
            env={"OPENBLAS_NUM_THREADS": "1"} | os.environ,
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith(MARK)]
        if done.returncode or not lines:
            said = (done.stderr.strip().splitlines() or ["it was killed"])[-1]
            raise NumericalError(
                f"{point.kind} {point.name} {dict(point.settings)} of {self.design.name} could "
                f"not be measured: {said}"
            )
        found: dict[str, Any] = json.loads(lines[-1].removeprefix(MARK))
        return found


def measure(design: Design, point: Point) -> dict[str, Any]:
    """Measure a point in this process: its error or facts, seconds, and peak memory in MB."""
    from phytac_design.study.tradeoff.choices import use
    from phytac_design.study.tradeoff.force import ForceError, rms
    from phytac_design.study.tradeoff.pilot import ForcePilot

    wall, cpu = time.perf_counter(), time.process_time()
    if point.kind == "stages":
        found = _stages(design, point)
    elif point.kind == "force":
        error = ForceError(design)
        found = {"errors": [rms(error.errors(setting)) for setting in point.each]}
    elif point.kind == "alone":
        pilot = ForcePilot(ForceError(design))
        found = {"errors": [pilot.alone(point.name, setting) for setting in point.each]}
    elif point.kind == "truth":
        error = ForceError(design)
        found = {"errors": [error.truth_error(setting.truth_refine) for setting in point.each]}
    else:
        found = use(design, point.name, point.settings[point.name])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    whole = {
        "seconds": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "peak_MB": peak / 1024.0,
    }
    return whole | found


def _ran(design: Design, names: list[str], point: Point) -> tuple[Any, list[str]]:
    from phytac_design.stages.build import run_stages, select_stages

    context, ran, _ = run_stages(
        design,
        select_stages(names),
        accuracy=point.accuracy,
        seed=0,
        force=True,
        progress=lambda _: None,
    )
    return context, ran


def prepare(design: Design, point: Point) -> None:
    """Run what stages need that are not measured themselves."""
    from phytac_design.stages import STAGES

    own = point.stages
    needs = {need for stage in STAGES if stage.name in own for need in stage.needs}
    if needs - set(own):
        _ran(design, sorted(needs - set(own)), point)


def _stages(design: Design, point: Point) -> dict[str, Any]:
    from phytac_design.engine import cache
    from phytac_design.study.tradeoff.room import room_left

    before = time.process_time()
    context, ran = _ran(design, list(point.stages), point)
    old = set(point.stages) - set(ran)
    if old:
        # Another setting shares them, or a killed run could not say what it had measured.
        for name in old:
            shutil.rmtree(context.folders[name])
        before = time.process_time()
        context, _ = _ran(design, list(point.stages), point)
    folders = {name: context.folders[name] for name in point.stages}
    seconds = {name: float(cache.record(folder)["seconds"]) for name, folder in folders.items()}
    room = {"room": room_left(context).tolist()} if "underload" in folders else {}
    return room | {
        "seconds": sum(seconds.values()),
        "cpu_s": time.process_time() - before,
        "stages": seconds,
        "facts": {
            name: _numbers(context.facts(name))
            for name, folder in folders.items()
            if (folder / "facts.json").is_file()
        },
    }


def _numbers(facts: dict[str, Any]) -> dict[str, float]:
    return {key: value for key, value in facts.items() if isinstance(value, int | float)}


def main() -> None:
    """Measure the point on standard input."""
    asked = json.loads(sys.stdin.read())
    os.environ["PHYTAC_CACHE"] = asked["cache"]
    design = parse_design(asked["design"], "measured design")
    point = Point(**asked["point"])
    if asked["mode"] == "prepare":
        prepare(design, point)
        print(f"{MARK}{{}}")
    else:
        print(MARK + json.dumps(measure(design, point)))


if __name__ == "__main__":
    main()
