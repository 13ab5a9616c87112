"""The simulation itself: time, workers, kills, sizes, extremes, every shape; rows of ``twin``."""

import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import Table
from phytac_design.datasets.samples import STATUSES
from phytac_design.datasets.samples_reader import read_samples
from phytac_design.datasets.samples_writer import FILE, TABLE
from phytac_design.design.accuracy import Preset
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import Scenario, load_scenario, parse_scenario
from phytac_design.workflows.simulate import JOURNAL_FOLDER, SimulationResult, simulate
from phytac_shapes.errors import InputError, PhytacError

KILLS = 10
SPARE = 0.15
"""Efficiency at two workers may fall this short of 1."""
SEED = 11
PLATFORM = "the paper's rig: 598 samples"
ASKED_BYTES = 64 * 1024


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
        table.add(
            f"{head}: time",
            done.seconds / 60.0,
            "min",
            reference="none that does this",
            source="wall clock",
            target=None if quick else f"<= {minutes:g}",
        )
        table.add(
            f"{head}: flagged or failed",
            done.samples - done.statuses["ok"],
            "samples",
            reference=0,
            source="the samples' status",
            note="; ".join(samples.reasons),
        )
        table.add(
            f"{head}: solved with large displacements",
            done.theories["large"],
            "samples",
            reference=done.samples,
            source="auto, tolerance of the scenario",
        )


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
    table.add(
        f"cylinder60, platform, {count} samples: data sets of 1, 2 and 4 workers that differ",
        len(set(prints.values())) - 1,
        "of 2",
        reference=0,
        source="SHA-256 of both files",
        target="== 0",
    )
    for workers in (2, 4):
        table.add(
            f"cylinder60, platform, {count} samples: efficiency of {workers} workers "
            f"on {os.cpu_count()} cores, start included",
            seconds[1] / (min(workers, os.cpu_count() or 1) * seconds[workers]),
            "of ideal",
            reference=1.0,
            source="one worker in the same run",
            target=">= 0.85" if workers == 2 and not quick else None,
        )


def _stored(out: Path) -> int:
    """Samples that an unfinished run has stored."""
    return sum(1 for _ in (out / JOURNAL_FOLDER).rglob("*.bin"))


def kill_rows(table: Table, *, quick: bool) -> None:
    """Kill the command at random moments, resume it, and compare with an uninterrupted run."""
    kills = 2 if quick else KILLS
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        command = [
            str(Path(sys.executable).parent / "phytac"), "simulate", "cylinder40", "platform",
            "--accuracy", "draft", "--samples", "40", "--workers", "2", "--out",
        ]  # fmt: skip
        begin = time.perf_counter()
        subprocess.run([*command, str(folder / "whole")], check=True, capture_output=True)
        whole = time.perf_counter() - begin
        moments = np.random.default_rng(SEED)
        killed = same = 0
        for _ in range(kills):
            out = folder / "killed"
            # The first kill falls anywhere, start-up included; later ones after it, so that a
            # machine that got slower meanwhile still comes to an end.
            first, before = True, 0
            while not (out / TABLE).exists():
                run = subprocess.Popen(
                    [*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
                while not first and run.poll() is None and _stored(out) == before:
                    time.sleep(0.05)
                try:
                    run.wait(moments.uniform(0.0, (0.9 if first else 0.4) * whole))
                except subprocess.TimeoutExpired:
                    run.send_signal(signal.SIGKILL)
                    run.wait()
                    killed += 1
                first, before = False, _stored(out)
            same += fingerprint(out) == fingerprint(folder / "whole")
            for path in sorted(out.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
            out.rmdir()
    table.add(
        f"cylinder40, 40 samples: runs killed (SIGKILL) at random and resumed, {killed} kills in "
        f"{kills} runs: data sets identical to the uninterrupted one",
        same,
        f"of {kills}",
        reference=kills,
        source="SHA-256 of both files",
        target=f"== {kills}",
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
    table.add(
        f"cylinder60, 598 samples, network's inputs and outputs ({nodes} key nodes): size on disk",
        size / 1024.0,
        "KiB",
        reference=45.0,
        source="the paper's data set, KB",
        target="<= 64",
    )


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
        table.add(
            f"{name}, platform, first {count} samples, draft: samples that are ok",
            ok,
            f"of {count}",
            reference=count,
            source="the samples' status",
            target=f"== {count}",
            note=f"{seconds:.0f} s{'; ' + note if note else ''}",
        )


def extreme(at: Sequence[dict[str, object]], **solve: object) -> Scenario:
    """One sample with contacts given by hand."""
    data: dict[str, object] = {
        "name": "extreme",
        "touch": {"samples": 1, "at": list(at)},
        "solve": {"displacement": "auto", **solve},
    }
    return parse_scenario(data, "extreme")


def press(along: float, around: float, force: float, radius: float = 5.0) -> dict[str, object]:
    """One contact by shares of the chart."""
    return {"along": along, "around": around, "force_N": force, "radius_mm": radius}


EXTREMES: dict[str, list[dict[str, object]]] = {
    "0.05 N": [press(0.5, 0.3, 0.05)],
    "60 N": [press(0.5, 0.3, 60.0)],
    "on the near rim": [press(0.0, 0.3, 10.0)],
    "on the far rim": [press(1.0, 0.3, 10.0)],
    "on the seam": [press(0.5, 0.0, 10.0)],
    "between two receptors": [press(0.5, 0.28125, 10.0, 1.5)],
    "two dozen contacts at once": [
        press(a, b, 8.0) for a in (0.2, 0.4, 0.6, 0.8) for b in np.arange(6) / 6.0
    ],
    "patch larger than the sensor": [press(0.5, 0.3, 20.0, 500.0)],
    "a point": [press(0.5, 0.3, 5.0, 1e-3)],
    "no contact": [],
    "no force": [press(0.5, 0.3, 0.0)],
}


def extreme_rows(table: Table, *, quick: bool) -> None:
    """Extremes: right, or flagged or refused with the reason; never NaN, never silent."""
    design = load_design("cylinder60")
    accuracy: Preset = "draft" if quick else "standard"
    for case, at in EXTREMES.items():
        job = Job(design=design, scenario=extreme(at), seed=SEED, accuracy=accuracy)
        with tempfile.TemporaryDirectory() as folder:
            try:
                run_job(job, workers=1, folder=Path(folder) / "data")
                samples, _ = read_samples(Path(folder) / "data")
                status = STATUSES[int(samples.status[0])]
                note = "; ".join(samples.why(0))
                assert samples.shift_px is not None
                finite = bool(np.isfinite(samples.shift_px[0]).all())
                right = finite if status == "ok" else bool(note)
                peak = float(np.linalg.norm(samples.shift_px[0], axis=1).max())
                note = f"{status}, largest shift {peak:.3g} px{'; ' + note if note else ''}"
            except PhytacError as error:
                right, note = True, f"refused: {error}"
        table.add(
            f"extreme: {case}: a finite answer, or a reason",
            int(right),
            "yes",
            reference=1,
            source="status, reason and numbers of the sample",
            target="== 1",
            note=note,
        )


def corrupt_rows(table: Table, *, quick: bool) -> None:
    """A data set with a byte changed or cut short is refused."""
    job = Job(
        design=load_design("cylinder40"),
        scenario=changed("platform", touch={"samples": 6}, solve={"displacement": "linear"}),
        seed=SEED,
        accuracy="draft",
    )
    tries = 40 if quick else 1000
    rng = np.random.default_rng(SEED)
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "data"
        run_job(job, workers=1, folder=out)
        for k in range(tries):
            path = out / (TABLE if k % 2 else FILE)
            whole = path.read_bytes()
            at = int(rng.integers(len(whole)))
            flipped = bytes([whole[at] ^ (1 << int(rng.integers(8)))])
            path.write_bytes(whole[:at] if k % 4 < 2 else whole[:at] + flipped + whole[at + 1 :])
            try:
                read_samples(out)
            except InputError:
                refused += 1
            path.write_bytes(whole)
    table.add(
        f"data sets with one bit changed, or cut short, that are refused ({tries} of them)",
        100.0 * refused / tries,
        "%",
        reference=100.0,
        source="random places in both files",
        target="== 100",
    )
