"""Data sets that decoders are judged on: those at hand, or simulated; and their two parts.

They lie in ``$PHYTAC_DATA``, a folder for each by its name, or where caches lie. The same can be
made by hand, also on another machine::

    phytac simulate cylinder60 platform --unit 1 --seed 1 --samples 1100 --route frames --out u1
"""

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.twin_engine import changed
from phytac_design.datasets.samples import FAILED, DataSetInfo, Samples
from phytac_design.datasets.samples_file import TABLE, file_hash, read_samples
from phytac_design.design.accuracy import Preset
from phytac_design.design.design_file import design_hash, load_design, parse_design
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import scenario_hash
from phytac_design.training.join_datasets import select_samples
from phytac_design.training.training_data import DataSet
from phytac_design.workflows.simulate import simulate
from phytac_shapes.arrays import IntArray
from phytac_shapes.errors import OutputError

SEED = 1
"""Of all data sets: a unit is drawn from the seed and its number."""
FLAT = ("plane", "cuboid", "patch")
"""Shapes whose walls are flat, or nearly."""
Route = Literal["points", "frames"]
LINEAR: dict[str, object] = {"displacement": "linear"}
"""How quick runs are solved."""


@dataclass(frozen=True, kw_only=True)
class DataSetSpec:
    """A data set and how it is used.

    Attributes
    ----------
    name : str
        Of its folder.
    job : Job
        What it holds.
    train : int
        Samples to learn from; all others are held out.
    mixed : bool
        Draw them at random; otherwise they are the first. The rig goes column by column: where
        it has not been all around, the first ones leave a side out.
    accuracy : str
        Preset of the decoder's own mechanics, where it is not that of the data.
    """

    name: str
    job: Job
    train: int
    mixed: bool = True
    accuracy: Preset | None = None

    def parts(self) -> tuple[DataSet, DataSet]:
        """What to learn from, and what is held out."""
        samples, meta = data_set(self.name, self.job)
        usable = np.flatnonzero(samples.status != FAILED)
        order = np.random.default_rng(SEED).permutation(usable) if self.mixed else usable
        mine = set_of(self.name, samples, meta)
        return chosen(mine, order[: self.train]), chosen(mine, order[self.train :])


def data_folder() -> Path:
    """Where data sets lie."""
    folder = os.environ.get("PHYTAC_DATA")
    return Path(folder) if folder else Path.home() / ".cache" / "phytac-benchmarks"


def data_set(name: str, job: Job) -> tuple[Samples, DataSetInfo]:
    """A data set that is at hand, also if another version of the program made it, or simulated.

    Parameters
    ----------
    name : str
        Of its folder.
    job : Job
        What it must hold: design, scenario (with the unit, the route and the number of samples),
        seed and accuracy.

    Raises
    ------
    OutputError
        If another data set is there, or the folder cannot be written.
    InputError
        If what is there cannot be read.
    """
    folder = data_folder() / name
    if not (folder / TABLE).is_file():
        simulate(job, folder, workers=2 if job.accuracy == "standard" else 0)
    samples, meta = read_samples(folder)
    found = {
        "design": meta.design_hash,
        "scenario": meta.hashes.get("scenario"),
        "seed": meta.seed,
        "accuracy": meta.notes.get("accuracy"),
    }
    wanted = {
        "design": design_hash(job.design),
        "scenario": scenario_hash(job.scenario),
        "seed": job.seed,
        "accuracy": job.accuracy,
    }
    other = [key for key, value in wanted.items() if found[key] != value]
    if other or samples.shift_px is None:
        raise OutputError(
            "output-foreign",
            f"{folder} holds another data set ({meta.what}: other {', '.join(other) or 'parts'}); "
            "move it away, or set PHYTAC_DATA to another folder",
        )
    return samples, meta


def origin(name: str, meta: DataSetInfo) -> str:
    """What a data set is and which program made it when, for a row's note."""
    table = data_folder() / name / TABLE
    day = time.strftime("%Y-%m-%d", time.gmtime(table.stat().st_mtime))
    program = str(meta.hashes.get("program", "unknown"))
    same = program == code_hash()
    made = "this program" if same else f"the program as it was then ({program[:8]})"
    return f"{meta.what}; {meta.route}, {meta.notes.get('accuracy')}; made {day} by {made}"


def set_of(name: str, samples: Samples, meta: DataSetInfo) -> DataSet:
    """A data set as trainers and judges take it."""
    folder = data_folder() / name
    table = folder / TABLE
    sha256 = file_hash(table) if table.is_file() else ""
    return DataSet(folder=folder, samples=samples, meta=meta, sha256=sha256)


def chosen(item: DataSet, index: IntArray) -> DataSet:
    """Some samples of a data set."""
    return replace(item, samples=select_samples(item.samples, np.sort(index)))


def random_subset(item: DataSet, count: int, *, seed: int) -> DataSet:
    """So many samples at random; for one seed, fewer are among more."""
    order = np.random.default_rng([seed, 25]).permutation(item.samples.count)
    return chosen(item, order[:count])


def job_of(
    design: Design,
    *,
    scenario: str = "platform",
    unit: int,
    samples: int | None = None,
    route: Route = "points",
    accuracy: Preset = "standard",
    seed: int = SEED,
    **tables: dict[str, object],
) -> Job:
    """A shipped scenario on a unit, as ``phytac simulate`` with these options has it."""
    tables["solve"] = {**tables.get("solve", {}), "route": route}
    tables["unit"] = {**tables.get("unit", {}), "number": unit}
    if samples is not None:
        tables["touch"] = {**tables.get("touch", {}), "samples": samples}
    return Job(design=design, scenario=changed(scenario, **tables), seed=seed, accuracy=accuracy)


def small_design() -> Design:
    """ø60 × 60 with 112 markers before a small camera, for quick runs."""
    data = load_design("cylinder60").model_dump(mode="json")
    for table, fields in {
        "shape": {"length_mm": 60.0},
        "layout": {"rows": 8, "columns": 14, "height_far_mm": 6.0},
        "camera": {"width_px": 1296, "height_px": 972, "focal_px": 485.0},
    }.items():
        data[table] = {**data[table], **fields}
    return parse_design({**data, "name": "small"}, "small")


def units(*, quick: bool) -> list[DataSetSpec]:
    """Three virtual prints of cylinder60, by frames; from the paper's 598 samples each."""
    if quick:
        return [_quick(1, 50), _quick(2, 40)]
    design = load_design("cylinder60")
    first = job_of(design, unit=1, samples=1100, route="frames")
    others = [
        DataSetSpec(
            name=f"u{k}", job=job_of(design, unit=k, samples=count, route="frames"), train=train
        )
        for k, count, train in ((2, 760, 598), (3, 760, 598))
    ]
    return [DataSetSpec(name="u1", job=first, train=598, mixed=False), *others]


def nominal(design: Design) -> DataSetSpec:
    """The sensor as designed, by points, to learn from alone."""
    count, name = 120, "u0" if design.name == "cylinder60" else f"u0-{design.name}"
    return DataSetSpec(name=name, job=job_of(design, unit=0, samples=count), train=count)


def of_shape(name: str, *, quick: bool) -> DataSetSpec:
    """The first virtual print of a shipped design, by frames."""
    if quick:
        return _quick(1, 50)
    # A flat wall snaps: its large displacements take many times longer.
    count = 60 if name in FLAT else 120
    accuracy: Preset = "draft" if name in FLAT else "standard"
    train = count // 2
    job = job_of(load_design(name), unit=1, samples=count, accuracy=accuracy, route="frames")
    return DataSetSpec(name=f"shape-{name}", job=job, train=train, accuracy="standard")


def cycles(*, quick: bool) -> DataSetSpec:
    """One press again and again, creep and light drift on, on the first unit, by frames."""
    if quick:
        cycle: dict[str, object] = {"count": 20, "every": 19}
        job = job_of(
            small_design(), scenario="cycles", unit=1, accuracy="draft", cycle=cycle, solve=LINEAR
        )
        return DataSetSpec(name="quick-cycles", job=job, train=0)
    job = job_of(load_design("cylinder60"), scenario="cycles", unit=1, route="frames")
    return DataSetSpec(name="cycles", job=job, train=0)


def _quick(unit: int, samples: int) -> DataSetSpec:
    """A few draft samples of the small design."""
    job = job_of(small_design(), unit=unit, samples=samples, accuracy="draft", solve=LINEAR)
    return DataSetSpec(name=f"quick-{unit}-{samples}", job=job, train=samples // 2)
