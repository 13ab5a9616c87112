"""Stages brought into the cache: one after the other, or side by side in worker processes."""

import gc
import json
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from phytac_design.core.machine import available_memory_MB, release_memory
from phytac_design.core.workers import Assigned, TaskResult, WorkerPool, send_note
from phytac_design.engine import cache
from phytac_design.engine.stage import Context, Stage, array_hashes
from phytac_shapes.errors import DesignError, NumericalError

IMPORT_s = {"cadquery": 2.0, "matplotlib": 0.5}
"""Packages that take long to import, and seconds, on the machine that costs are stated for."""


class GateError(DesignError):
    """A stage stops the build because of its result."""


@dataclass(frozen=True, kw_only=True)
class StageCosts:
    """Predicted costs of each stage by its name.

    Attributes
    ----------
    seconds : mapping
        On one core of the machine that costs were measured on.
    memory_MB : mapping
        Peaks.
    machine : callable
        Measures the seconds of this machine over those of that one.
    """

    seconds: Mapping[str, float]
    memory_MB: Mapping[str, float]
    machine: Callable[[], float] = lambda: 1.0


@dataclass(kw_only=True)
class StageTask:
    """A stage to run, as the cache calls it; ``done`` says whether this process ran it."""

    stage: Stage
    context: Context
    key: str
    done: bool = False

    def __call__(self, folder: Path) -> dict[str, Any]:
        """Run into a folder; returns the record."""
        self.context.progress(f"{self.stage.name} …")
        start = time.perf_counter()
        self.stage.make(self.context, folder)
        seconds = time.perf_counter() - start
        self.done = True
        return {
            "stage": self.stage.name,
            "seconds": round(seconds, 3),
            "arrays": array_hashes(folder),
        }

    def publish(self) -> Path:
        """Bring the result into the cache; returns its folder."""
        return cache.publish(self.stage.name, self.key, self, waiting=self._waiting)

    def _waiting(self) -> None:
        """Report that another process computes the same result."""
        self.context.progress(f"{self.stage.name}: waiting for another build that is making it")


def publish_in_worker(_: None, task: StageTask) -> tuple[Path, bool] | Exception:
    """Folder of a result and whether this process made it, or the error of the stage."""
    task.context = replace(task.context, progress=send_note)
    try:
        return task.publish(), task.done
    except Exception as error:  # noqa: BLE001  raised by the process that gave the task
        error.add_note(traceback.format_exc())
        return error
    finally:
        release_memory()  # while this process waits, another stage may need it
        gc.freeze()  # what a stage has imported is no garbage: looking through it takes 40 ms


class _StageFailure(Exception):  # noqa: N818  carries the error of a stage
    """A stage failed: its position, and its error."""

    def __init__(self, position: int, error: Exception) -> None:
        super().__init__(position, error)
        self.position, self.error = position, error


class StageRun:
    """One execution of a stage graph.

    Parameters
    ----------
    context : Context
        Its ``folders`` receive the folder of each result.
    stages : sequence of Stage
        Each after those that it depends on.
    keep : ExitStack
        Results are not evicted from the cache until it is closed.
    force : bool
        Whether to continue where a stage would stop the build.
    costs : callable, optional
        Predicts costs once a stage has to run: they decide which stage starts first, which ones
        fit the memory together, and the time left.

    Attributes
    ----------
    ran : set of str
        Stages that were not in the cache.
    timing_s : dict
        Seconds that each stage took when it ran.
    """

    memory_MB = 1500.0
    """Peak of a stage without a prediction; those of `cylinder60` need at most 1350."""
    memory_share = 0.8
    """Share of the memory available at the start that stages may take together."""

    def __init__(
        self,
        context: Context,
        stages: Sequence[Stage],
        *,
        keep: ExitStack,
        force: bool = False,
        costs: Callable[[], StageCosts] | None = None,
    ) -> None:
        self.context, self.stages, self.force = context, list(stages), force
        self.ran: set[str] = set()
        self.timing_s: dict[str, float] = {}
        self._keep, self._predict, self._workers = keep, costs, 1
        self._keys: dict[str, str] = {}
        self._looked_up: set[str] = set()
        self._begun: dict[str, float] = {}
        """Stages that are running, and since when."""
        self._imported: dict[int, set[str]] = {}
        """Packages that stages of each worker have imported."""

    def run(self, workers: int) -> None:
        """Bring all stages into the cache, in this process or in several others.

        Raises
        ------
        GateError
            If a stage stops the build and ``force`` is not set.
        DesignError
            If the design cannot be built.
        NumericalError
            If the process of a stage died twice.
        """
        self._workers = min(workers, len(self.stages))
        if workers > 1:
            self._run_side_by_side(self.stages)
            return
        for stage in self.stages:
            while not self._take_cached(stage):
                self._begun[stage.name] = time.monotonic()
                task = self._task(stage, self._report)
                folder = task.publish()
                del self._begun[stage.name]
                self._take(stage, folder, ran=task.done)

    def _run_side_by_side(self, stages: Sequence[Stage]) -> None:
        given: list[StageTask] = []

        def tasks() -> Iterator[Assigned | None]:
            while any(stage.name not in self.context.folders for stage in stages):
                choice = self._next(stages, pool.free())
                if choice is None:
                    yield None
                    continue
                worker, stage = choice
                self._begun[stage.name] = time.monotonic()
                if stage.makes(self.context.accuracy):
                    self._imported.setdefault(worker, set()).update(stage.imports)
                given.append(self._task(stage, print))
                yield Assigned(worker, given[-1])

        self._imported.clear()
        try:
            with WorkerPool(publish_in_worker, workers=self._workers) as pool:
                for result in pool.run(tasks(), note=lambda _, text: self._report(text)):
                    self._settle(given[result.index].stage, result)
        except _StageFailure as failure:
            cache.sweep()
            self._begun.clear()
            # The error is that of stages one after the other: of the first in order that fails.
            # Those of lower order that were stopped run again.
            self._run_side_by_side(stages[: failure.position])
            raise failure.error from None
        except BaseException:
            cache.sweep()  # what the processes that were stopped have left
            raise

    def _next(self, stages: Sequence[Stage], free: Sequence[int]) -> tuple[int, Stage] | None:
        """Worker and stage to run next; None if all that are ready run, or must wait for memory.

        A worker that has imported a stage's packages is preferred. If only busy ones have, the
        stage's rank falls by the seconds that it takes to import them again.
        """
        folders = self.context.folders
        while True:
            ready = [
                stage
                for stage in stages
                if stage.name not in {*folders, *self._begun}
                and all(name in folders for name in stage.depends_on)
            ]
            with_results = False
            for stage in ready:
                with self._failures_of(stage):
                    with_results |= self._take_cached(stage)
            if not with_results:
                break
        taken_MB = sum(self._peak_MB(name) for name in self._begun)
        busy = (have for worker, have in self._imported.items() if worker not in free)
        elsewhere, choices = set[str]().union(*busy), []
        for stage in ready:
            if not self._begun or taken_MB + self._peak_MB(stage.name) <= self._limit_MB:
                missing = {k: set(stage.imports) - self._imported.get(k, set()) for k in free}
                worker = min(free, key=lambda k: len(missing[k]))
                again_s = sum(IMPORT_s[name] for name in missing[worker] & elsewhere)
                choices.append((self._ranks[stage.name] - again_s, worker, stage))
        return max(choices, key=lambda choice: choice[0])[1:] if choices else None

    def _settle(self, stage: Stage, result: TaskResult) -> None:
        """Take the result of a worker."""
        del self._begun[stage.name]
        with self._failures_of(stage):
            if result.lost:
                raise NumericalError(
                    "stage-process-died",
                    f"the stage {stage.name} was started twice and did not end: {result.lost}; "
                    "free memory, or use --workers 1, and run the same command again: finished "
                    "stages are kept",
                )
            if isinstance(result.value, Exception):
                raise result.value
            folder, ran = result.value
            self._take(stage, folder, ran=ran)

    @contextmanager
    def _failures_of(self, stage: Stage) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            raise _StageFailure(self.stages.index(stage), error) from error

    def _task(self, stage: Stage, progress: Callable[[str], None]) -> StageTask:
        context = self.context
        needed = {name: context.folders[name] for name in stage.depends_on}
        return StageTask(
            stage=stage,
            context=replace(context, folders=needed, array_names=stage.arrays, progress=progress),
            key=self._keys[stage.name],
        )

    def _take_cached(self, stage: Stage) -> bool:
        """Take a result that is in the cache already; looks there once."""
        name = stage.name
        if name not in self._looked_up:
            self._looked_up.add(name)
            inputs = stage.inputs(self.context, self._keys)
            self._keys[name] = cache.stage_key(name, inputs)
            folder = cache.lookup(name, self._keys[name], report=self.context.progress)
            if folder is not None:
                self._take(stage, folder, ran=False)
        return name in self.context.folders

    def _take(self, stage: Stage, folder: Path, *, ran: bool) -> None:
        """Keep a result in the cache, unless it was evicted meanwhile.

        Raises
        ------
        GateError
            If it stops the build and ``force`` is not set.
        """
        if ran:
            self.ran.add(stage.name)
        if not self._keep.enter_context(cache.held(folder)):
            return
        self.context.folders[stage.name] = folder
        self.timing_s[stage.name] = float(cache.record(folder)["seconds"])
        if ran:
            self._report(f"{stage.name} {self.timing_s[stage.name]:.1f} s", counted=True)
        elif why := _left_out(stage.name, folder):
            # As the stage itself reports when it runs.
            self.context.progress(f"{stage.name}: left out ({why})")
        reason = stage.gate(self.context) if stage.gate and not self.force else ""
        if reason:
            raise GateError(
                "build-gate",
                f"{reason}; or continue anyway with --force, which marks the report",
            )

    @cached_property
    def _costs(self) -> StageCosts | None:
        return self._predict() if self._predict else None

    @cached_property
    def _limit_MB(self) -> float:
        return self.memory_share * available_memory_MB()

    def _peak_MB(self, name: str) -> float:
        return self._costs.memory_MB.get(name, self.memory_MB) if self._costs else self.memory_MB

    def _seconds(self, name: str) -> float:
        return self._costs.seconds.get(name, 0.0) if self._costs else 1.0

    @cached_property
    def _ranks(self) -> dict[str, float]:
        """Seconds from the start of each stage to the end of the build if no stage ever waits."""
        ranks: dict[str, float] = {}
        for stage in reversed(self.stages):
            later = [ranks[each.name] for each in self.stages if stage.name in each.depends_on]
            ranks[stage.name] = self._seconds(stage.name) + max(later, default=0.0)
        return ranks

    def _report(self, text: str, *, counted: bool = False) -> None:
        """Report progress; where a stage starts or ends, with those that have ended and the time.

        Stages end in another order than theirs where they run side by side.
        """
        if counted or text.removesuffix(" …") in self._begun:
            ended = sum(stage.name in self.context.folders for stage in self.stages)
            text = f"[{ended}/{len(self.stages)}] {text}"
            if self._costs and ended < len(self.stages):
                left_s = max(5.0 * round(self.left_s() / 5.0), 5.0)
                text += f" (about {left_s:.0f} s left)"
        self.context.progress(text)

    def left_s(self) -> float:
        """Predicted seconds to the end, scaled by those of the stages that have ended."""
        machine = self._costs.machine() if self._costs else 1.0
        # A fifth of the whole counts as predicted rightly, so that one stage does not decide.
        right = 0.2 * sum(self._seconds(stage.name) for stage in self.stages)
        predicted = sum(self._seconds(name) for name in self.timing_s)
        spent = sum(self.timing_s.values())
        scale = (spent + machine * right) / (predicted + right) if right else machine
        now, clock = time.monotonic(), 0.0
        ends = {
            # One that takes longer than predicted is not about to end.
            name: max(scale * self._seconds(name) - (now - begun), 0.1 * (now - begun))
            for name, begun in self._begun.items()
        }
        ended = set(self.context.folders)
        order = sorted(self.stages, key=lambda stage: -self._ranks[stage.name])
        while len(ended) < len(self.stages):
            for stage in order:
                if (
                    len(ends) < self._workers
                    and stage.name not in {*ended, *ends}
                    and ended.issuperset(stage.depends_on)
                ):
                    ends[stage.name] = clock + scale * self._seconds(stage.name)
            name = min(ends, key=lambda each: ends[each])
            clock = max(clock, ends.pop(name))
            ended.add(name)
        return clock


def _left_out(stage: str, folder: Path) -> str:
    """Why a stage left out what it makes, "" where it did not."""
    facts = folder / "facts.json"
    if not facts.is_file():
        return ""
    found = json.loads(facts.read_text(encoding="utf-8"))
    why = found.get(f"{stage}_left_out", found.get("left_out", ""))
    return why if isinstance(why, str) else ""
