"""One measured point: stages, errors or a choice of use at one setting, in its own process."""

import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

from phytac_design.core.journal import Journal
from phytac_design.core.threads import one_thread_each
from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.design_file import design_hash, parse_design
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash
from phytac_shapes.errors import NumericalError, OutputError


@dataclass(frozen=True, kw_only=True)
class Point:
    """What to measure.

    Attributes
    ----------
    kind : str
        ``stages``: time of stages; ``force``: force errors of settings; ``alone``: those of one
        setting, everything else being ideal; ``truth``: those of the simulated sensor's meshes;
        ``use``: a choice of use.
    name : str
        Of the stages, comma separated, or of the setting.
    settings : dict
        Settings that differ from ``draft``, or the choice's value; for errors a list ``each``:
        one process computes them all, as they share the reference.
    """

    kind: Literal["stages", "force", "alone", "truth", "use"]
    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stages(self) -> list[str]:
        """Names of the stages."""
        return self.name.split(",")


class Points:
    """Measured points of one design in a folder; an interrupted run resumes.

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
        self.journal = Journal(folder / "points")
        try:
            self.journal.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                "output-not-writable",
                f"cannot write {folder}: {error.strerror}; choose another --out",
            ) from None

    def get(self, point: Point) -> dict[str, Any]:
        """Result of a point: from the journal, or measured now.

        Raises
        ------
        NumericalError
            If the measuring process fails.
        """
        key = json.dumps([design_hash(self.design), code_hash(), asdict(point)], sort_keys=True)
        known = self.journal.get(key)
        if known is not None:
            return known[0]
        begin = time.perf_counter()
        found = measure_apart(self.design, point, self.folder / "cache")
        spent = time.perf_counter() - begin
        self.progress(
            f"{self.design.name}: {point.kind} {point.name} "
            f"({', '.join(map(str, point.settings.values()))}): {spent:.1f} s"
        )
        self.journal.put(key, found)
        return found


def measure_apart(design: Design, point: Point, cache: Path) -> dict[str, Any]:
    """Measure a point in a new process; what its stages depend on is run before in another."""
    found: dict[str, Any] = {}
    arguments = design.model_dump(mode="json"), point, str(cache.resolve())
    try:
        for work in (prepare, measure) if point.kind == "stages" else (measure,):
            with one_thread_each(), ProcessPoolExecutor(1, get_context("spawn")) as pool:
                found = pool.submit(_in_child, work, *arguments).result()
    except Exception as error:
        raise NumericalError(
            "point-not-measured",
            f"{point.kind} {point.name} {dict(point.settings)} of {design.name} could not be "
            f"measured: {error}",
        ) from error
    return found


def _in_child(
    work: Callable[[Design, Point], dict[str, Any]], data: dict[str, Any], point: Point, cache: str
) -> dict[str, Any]:
    """Call ``work`` with the given cache, and without output to the command's own."""
    os.environ["PHYTAC_CACHE"] = cache
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return work(parse_design(data, "measured design"), point)


def prepare(design: Design, point: Point) -> dict[str, Any]:
    """Run the stages that the measured ones depend on."""
    from phytac_design.stages import STAGES

    needs = {need for stage in STAGES if stage.name in point.stages for need in stage.depends_on}
    if needs - {*point.stages}:
        _run(design, sorted(needs - {*point.stages}), point)
    return {}


def measure(design: Design, point: Point) -> dict[str, Any]:
    """Measure a point in this process: its error or facts, seconds, and peak memory in MB."""
    from phytac_design.study.planning.run_plan import peak_MB
    from phytac_design.study.tradeoff.choices import use

    wall, cpu = time.perf_counter(), time.process_time()
    if point.kind == "stages":
        found = _stages(design, point)
    elif point.kind == "use":
        found = use(design, point.name, point.settings[point.name])
    else:
        found = {"errors": _errors(design, point)}
    return {
        "seconds": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "peak_MB": peak_MB(),
    } | found


def _errors(design: Design, point: Point) -> list[float]:
    from phytac_design.study.tradeoff.force import ForceError
    from phytac_design.study.tradeoff.pilot import ForcePilot

    error = ForceError(design)
    pilot = ForcePilot(error)
    errors: dict[str, Callable[[Accuracy], float]] = {
        "force": pilot.achieved,
        "alone": lambda setting: pilot.alone(point.name, setting),
        "truth": lambda setting: error.truth_error(setting.truth_refine),
    }
    return [errors[point.kind](accuracy_of(settings)) for settings in point.settings["each"]]


def _run(design: Design, names: list[str], point: Point) -> tuple[Any, list[str]]:
    from phytac_design.stages.build import run_stages, select_stages

    context, ran, _ = run_stages(
        design,
        select_stages(names),
        accuracy=accuracy_of(point.settings),
        seed=0,
        force=True,
        progress=lambda _: None,
    )
    return context, ran


def _stages(design: Design, point: Point) -> dict[str, Any]:
    from phytac_design.engine import cache
    from phytac_design.study.tradeoff.pilot import built_clearance

    before = time.process_time()
    context, ran = _run(design, point.stages, point)
    old = set(point.stages) - set(ran)
    if old:
        # They were run for another setting, or by a run that was killed: measure them again.
        for name in old:
            shutil.rmtree(context.folders[name])
        before = time.process_time()
        context, _ = _run(design, point.stages, point)
    cpu_s = time.process_time() - before
    seconds = {name: float(cache.record(context.folders[name])["seconds"]) for name in point.stages}
    out: dict[str, Any] = {"seconds": sum(seconds.values()), "cpu_s": cpu_s, "stages": seconds}
    if "underload" in seconds:
        out["clearance"] = built_clearance(context).tolist()
    if "shell" in seconds:
        out["volume_mm3"] = float(context.facts("shell")["volume_mm3"])
    return out


def accuracy_of(settings: Mapping[str, Any]) -> Accuracy:
    """All settings, given those that differ from ``draft``."""
    return replace(PRESETS["draft"], **settings)
