"""What today's estimators make of the twin's data, linear and large; rows of ``twin``.

They are trained on linear data of even patches: what they lose here is the gap between that and
the twin, not noise.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.harness import Table
from benchmarks.twin_engine import SEED, changed
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.datasets.samples_reader import read_samples
from phytac_design.design.accuracy import Preset
from phytac_design.design.design_file import load_design
from phytac_design.simulation.force_errors import contact_forces
from phytac_design.simulation.run.job import Job
from phytac_design.stages.build import build
from phytac_design.workflows.simulate import simulate
from phytac_shapes.arrays import BoolArray, FloatArray

DESIGN = "cylinder60"
NAMES = ("fem", "fem_nn", "koi_inverse")
PAPER = {"fem": 18.0, "fem_nn": 2.3}
"""Mean relative error, %, of the paper's sensor; its FEM alone has 49 % below 5 N."""
WAYS = ("linear", "large")
ALIKE_N = 1.0
"""Contacts within this of a force count as pressed with it."""


def decoded(bundle: Bundle, samples: Samples, estimator: str) -> FloatArray:
    """Receptor forces (s, n) N from the points and switches of a data set."""
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    shift = np.nan_to_num(samples.shift_px)
    return np.stack(
        [
            bundle.model.forces(estimator, s, np.flatnonzero(bits))
            for s, bits in zip(shift, samples.bits_read, strict=True)
        ]
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Relative errors of the estimators, on linear and on large-displacement data."""
    design = load_design(DESIGN)
    accuracy: Preset = "draft" if quick else "standard"
    count = 12 if quick else 300
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        build(
            design, folder / "build", accuracy=accuracy, only=["decoder"], progress=lambda _: None
        )
        bundle = load_bundle(folder / "build" / "decoder")
        for way in WAYS:
            scenario = changed(
                "platform",
                touch={"samples": count},
                solve={"displacement": way},
                time={"relax_share": [], "relax_s": []},
            )
            job = Job(design=design, scenario=scenario, seed=SEED, accuracy=accuracy)
            simulate(job, folder / way, workers=2, progress=lambda _: None)
            _judge(table, bundle, job, read_samples(folder / way)[0], way)


def _judge(table: Table, bundle: Bundle, job: Job, samples: Samples, way: str) -> None:
    touches, switching = job.plan.touches, job.plan.switching
    truth = touches.force_N
    seen = switching.tripped & (samples.status[touches.sample] != FAILED)
    single = touches.counts[touches.sample] == 1
    groups: dict[str, BoolArray] = {
        "all contacts": np.ones(len(truth), dtype=np.bool_),
        "below 5 N": truth < 5.0,
        "from 5 N": truth >= 5.0,
        "single": single,
        "several": ~single,
    }
    groups |= {
        f"single, {force:g} N": single & (np.abs(truth - force) < ALIKE_N) for force in (5, 10, 24)
    }
    for name in NAMES:
        force = contact_forces(decoded(bundle, samples, name), touches, switching)
        error = (force - truth) / np.maximum(truth, 1e-12)
        for group, chosen in groups.items():
            part = error[seen & chosen]
            if not len(part):
                continue
            head = f"{DESIGN}, {way} twin, {name}, {group} ({len(part)} contacts)"
            table.add(
                f"{head}: mean relative error of force",
                100.0 * float(np.abs(part).mean()),
                "%",
                reference=PAPER.get(name, "none") if group == "all contacts" else "none",
                source="the paper's sensor; trained here on linear data of even patches",
            )
            table.add(
                f"{head}: mean of force over the truth, less 1",
                100.0 * float(part.mean()),
                "%",
                reference=0.0,
                source="the twin's truth",
            )
