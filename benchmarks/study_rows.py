"""A study of ten thousand rows: memory of the driver, time of the front, and the page."""

import resource
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.harness import Table
from benchmarks.study_cases import study_of
from phytac_design.study.search.driver import run_study
from phytac_design.study.search.measures import measures_up_to
from phytac_design.study.search.search_report import read_results, write_page
from phytac_design.study.search.successive_halving import Outcome, SerialPool, Task

RUNGS = ("rules", "sampled")
GOALS = [
    {"measure": "marker_count", "goal": "max"},
    {"measure": "surrogate_force_sd_N", "goal": "min"},
    {"measure": "mass_g", "goal": "min"},
]


class ClosedForm(SerialPool):
    """A pool that answers at once: this part is about the driver, not about designs.

    Also keeps the memory of this process after each batch.
    """

    def __init__(self) -> None:
        self.memory_MB: list[float] = []

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Smooth figures of the variables."""
        for task in tasks:
            values = [float(value) for value in task.params.values()]
            names = measures_up_to(RUNGS)
            found = {name: abs(np.sin(k + sum(values))) for k, name in enumerate(names)}
            found["marker_count"] = values[0] * values[1]
            found["surrogate_force_sd_N"] = values[-2] / values[1] + 0.01 * values[2]
            seconds = dict.fromkeys(RUNGS, 0.05)
            yield task, Outcome(rung=RUNGS[-1], measures=found, seconds=seconds, design="0" * 64)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.memory_MB.append(pages * resource.getpagesize() / 2**20)


def rows(table: Table, *, quick: bool) -> None:
    """Memory at the tenth and at the last batch; front, page, and its bytes."""
    count = 1000 if quick else 10_000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "study"
        study, space = study_of(
            "cylinder",
            objective=GOALS,
            budget={"candidates": count},
            sampling={"batch": 64},
            ladder={"rungs": list(RUNGS)},
        )
        pool = ClosedForm()
        start = time.perf_counter()
        done = run_study(study, space, folder, kind="sweep", pool=pool)
        seconds = time.perf_counter() - start
        source = f"sweep of {count} candidates whose figures are a closed form"
        row = f"driver: growth of memory from the tenth batch to row {done.rows}"
        value = pool.memory_MB[-1] - pool.memory_MB[9]
        table.add(
            row, value, "MB", pool.memory_MB[9], f"{source}; resident set, batches of 64", "<= 20"
        )
        row = "driver: own time for each candidate"
        note = "0.1 s is what ten designs a second take"
        value = 1e3 * seconds / count
        table.add(row, value, "ms", 100.0, f"{source}; ask, journal, rows and parts", note=note)
        size = done.results.stat().st_size
        table.add("results: bytes for each row", size / count, "B", reference="", source="Parquet")
        start = time.perf_counter()
        results = read_results(folder)
        front = results.front()
        row = f"front of {count} rows and three objectives, read from the file"
        note = f"{int(front.sum())} rows on the front"
        table.add(row, time.perf_counter() - start, "s", "", "wall time", "<= 5", note)
        start = time.perf_counter()
        page = write_page(folder)
        row = "page with front, importance and agreement of rungs"
        note = f"{page.stat().st_size / 1e6:.1f} MB, one file"
        value = time.perf_counter() - start
        table.add(row, value, "s", "", "wall time, figures included", "<= 10", note)
