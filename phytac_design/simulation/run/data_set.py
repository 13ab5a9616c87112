"""The data set of a simulation, from its plan and its journal."""

import numpy as np

from phytac_design.core.journal import Journal
from phytac_design.datasets.samples import (
    STATUSES,
    THEORIES,
    DataSetInfo,
    Samples,
    truth_rows,
)
from phytac_design.design.design_file import design_hash
from phytac_design.engine.cache import code_hash
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import scenario_hash
from phytac_shapes.errors import OutputError


def gather_samples(job: Job, journal: Journal) -> Samples:
    """All samples of a job, from its journal."""
    plan, touches = job.plan, job.plan.touches
    items = [journal.get(str(index)) for index in range(touches.samples)]
    missing = [index for index, item in enumerate(items) if item is None]
    if missing:
        raise OutputError(
            "sample-store-damaged",
            f"sample {missing[0]} was stored but cannot be read again; check the disk, then run "
            "the same command again",
        )
    facts = [item[0] for item in items if item is not None]
    arrays = [item[1] for item in items if item is not None]
    reasons = sorted({text for fact in facts for text in fact["reasons"]})
    remarks = [(k, reasons.index(text)) for k, f in enumerate(facts) for text in f["reasons"]]
    order = np.argsort(touches.sample, kind="stable")
    rank = np.empty(len(order) + 1, dtype=np.int64)
    rank[order], rank[-1] = np.arange(len(order)), -1
    switching = plan.switching
    total = np.zeros(len(facts))
    np.add.at(total, touches.sample, touches.force_N)
    return Samples(
        markers=job.markers.count,
        time_s=plan.time_s,
        sequence=plan.sequence,
        light=plan.light,
        status=np.array([STATUSES.index(fact["status"]) for fact in facts]),
        theory=np.array([THEORIES.index(fact["theory"]) for fact in facts]),
        total_N=total,
        contacts=touches.counts,
        reasons=tuple(reasons),
        reason_sample=np.array([k for k, _ in remarks], dtype=np.int64),
        reason_index=np.array([k for _, k in remarks], dtype=np.int64),
        bits=switching.bits,
        bits_read=np.stack([item["bits_read"] for item in arrays]),
        shift_px=np.stack([item["shift_px"] for item in arrays]),
        touches=touches.take(order).table(job.surface),
        truth=truth_rows(switching.bits, rank[switching.owner], switching.receptor_force_N),
    )


def data_set_info(job: Job) -> DataSetInfo:
    """What the data set is."""
    scenario, unit = job.scenario, job.scenario.unit.number
    sensor = "the sensor as designed" if unit == 0 else f"virtual print {unit}"
    return DataSetInfo(
        simulated=True,
        what=f"simulated: scenario {scenario.name} on {job.design.name}, {sensor}",
        design=job.design.name,
        design_hash=design_hash(job.design),
        route=scenario.solve.route,
        seed=job.seed,
        hashes={"job": job.key, "scenario": scenario_hash(scenario), "program": code_hash()},
        notes={
            "scenario": scenario.model_dump(mode="json"),
            "accuracy": job.accuracy,
            "keep": job.keep,
            "unit": unit,
        },
    )
