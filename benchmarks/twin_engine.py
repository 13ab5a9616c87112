"""The simulation itself: time, workers, sizes, every shape; rows of ``twin``."""

import hashlib
import os
import tempfile
from pathlib import Path

from benchmarks.harness import Table
from phytac_design.datasets.samples_file import FILE, TABLE, read_samples
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import Scenario, load_scenario, parse_scenario
from phytac_design.workflows.simulate import SimulationResult, simulate
from phytac_shapes.errors import PhytacError

SEED = 11


def changed(name: str, **tables: dict[str, object]) -> Scenario:
    """Shipped scenario with some fields changed."""
    data = load_scenario(name).model_dump(mode="json", exclude_unset=True)
    for table, fields in tables.items():
        data[table] = {**data.get(table, {}), **fields}
    return parse_scenario(data, name)


def run_job(job: Job, *, workers: int, folder: Path) -> SimulationResult:
    """Simulate into an empty folder, quietly."""
    return simulate(job, folder, workers=workers, progress=lambda _: None)


def fingerprint(folder: Path) -> str:
    """Hash of both files of a data set."""
    total = hashlib.sha256()
    for name in (TABLE, FILE):
        total.update((folder / name).read_bytes())
    return total.hexdigest()


def time_rows(table: Table, *, quick: bool) -> None:
    """All samples of the platform on cylinder60, by both routes, on two cores."""
    design = load_design("cylinder60")
    for route, minutes in (("points", 10.0), ("frames", 20.0)):
        solve: dict[str, object] = {"route": route}
        touch: dict[str, object] = {"samples": 6} if quick else {}
        job = Job(design=design, scenario=changed("platform", solve=solve, touch=touch), seed=SEED)
        with tempfile.TemporaryDirectory() as folder:
            done = run_job(job, workers=2, folder=Path(folder) / "data")
            samples, _ = read_samples(Path(folder) / "data")
        head = f"cylinder60, platform, {done.samples} samples, {route}, standard, two workers"
        row = f"{head}: time"
        value = done.seconds / 60.0
        target = None if quick else f"<= {minutes:g}"
        table.add(row, value, "min", "none that does this", "wall clock", target)
        row = f"{head}: flagged or failed"
        source = "the samples' status"
        note = "; ".join(samples.reasons)
        table.add(row, done.samples - done.statuses["ok"], "samples", 0, source, note=note)
        row = f"{head}: solved with large displacements"
        source = "auto, tolerance of the scenario"
        table.add(row, done.theories["large"], "samples", done.samples, source)


def worker_rows(table: Table, *, quick: bool) -> None:
    """One, two and four processes: identical data; how well two share the work."""
    design = load_design("cylinder60")
    count = 8 if quick else 240
    job = Job(
        design=design,
        scenario=changed("platform", touch={"samples": count}),
        seed=SEED,
        accuracy="draft" if quick else "standard",
    )
    seconds, prints = {}, {}
    for workers in (1, 2, 4):
        with tempfile.TemporaryDirectory() as folder:
            done = run_job(job, workers=workers, folder=Path(folder) / "data")
            seconds[workers], prints[workers] = done.seconds, fingerprint(Path(folder) / "data")
    row = f"cylinder60, platform, {count} samples: data sets of 1, 2 and 4 workers that differ"
    table.add(row, len(set(prints.values())) - 1, "of 2", 0, "SHA-256 of both files", "== 0")
    for workers in (2, 4):
        row = (
            f"cylinder60, platform, {count} samples: efficiency of {workers} workers "
            f"on {os.cpu_count()} cores, start included"
        )
        source = "one worker in the same run"
        value = seconds[1] / (min(workers, os.cpu_count() or 1) * seconds[workers])
        table.add(
            row, value, "of ideal", 1.0, source, ">= 0.85" if workers == 2 and not quick else None
        )


def size_rows(table: Table, *, quick: bool) -> None:
    """The paper's data set: 598 samples of the network's inputs and outputs."""
    design = load_design("cylinder60")
    scenario = changed("platform", solve={"displacement": "linear"})
    job = Job(design=design, scenario=scenario, seed=SEED, accuracy="draft", keep="inputs")
    if quick:
        return
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "data"
        run_job(job, workers=2, folder=out)
        size = sum((out / name).stat().st_size for name in (TABLE, FILE))
        samples, _ = read_samples(out)
    rows = samples.key_nodes
    nodes = 0 if rows is None else len(rows.sample)
    row = f"cylinder60, 598 samples, network's inputs and outputs ({nodes} key nodes): size on disk"
    table.add(row, size / 1024.0, "KiB", 45.0, "the paper's data set, KB", "<= 64")


def shape_rows(table: Table, *, quick: bool) -> None:
    """Every shipped design runs the platform's scenario."""
    count = 4 if quick else 48
    for name in shipped_designs():
        job = Job(
            design=load_design(name),
            scenario=changed("platform", touch={"samples": count}),
            seed=SEED,
            accuracy="draft",
        )
        with tempfile.TemporaryDirectory() as folder:
            note = ""
            try:
                done = run_job(job, workers=2, folder=Path(folder) / "data")
                ok, seconds = done.statuses["ok"], done.seconds
                note = "; ".join(read_samples(Path(folder) / "data")[0].reasons)
            except PhytacError as error:
                ok, seconds, note = 0, float("nan"), str(error)
        row = f"{name}, platform, first {count} samples, draft: samples that are ok"
        source = "the samples' status"
        target = f"== {count}"
        table.add(
            row,
            ok,
            f"of {count}",
            count,
            source,
            target,
            f"{seconds:.0f} s{'; ' + note if note else ''}",
        )
