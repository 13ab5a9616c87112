"""A simulation: all that its data set depends on."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import Any, Literal, get_args

import numpy as np

from phytac_design.core.journal import Journal
from phytac_design.datasets.samples import (
    STATUSES,
    THEORIES,
    DataSetInfo,
    Samples,
    truth_rows,
)
from phytac_design.design.accuracy import PRESETS, Preset
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.sample_plan import SamplePlan
from phytac_design.simulation.scenario.draw_plan import draw_plan
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import Scenario, scenario_hash
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError, OutputError

Keep = Literal["inputs", "points", "frames"]


@dataclass(frozen=True, kw_only=True)
class Job:
    """All that a data set depends on.

    Attributes
    ----------
    design : Design
        The sensor.
    scenario : Scenario
        What is done to it, on which sensor instance, and how it is solved and seen.
    seed : int
        Of everything random.
    accuracy : str
        Preset of the simulation's mesh.
    keep : str
        ``inputs`` of the network alone, ``points`` (all markers), or ``frames`` as well.
    """

    design: Design
    scenario: Scenario
    seed: int = 0
    accuracy: Preset = "standard"
    keep: Keep = "points"

    def __post_init__(self) -> None:
        """Reject settings that no data set can be made with.

        Raises
        ------
        DesignError
            With what is wrong and what would do.
        """
        if not (isinstance(self.design, Design) and isinstance(self.scenario, Scenario)):
            raise DesignError(
                "job-not-loaded",
                "a job needs a design and a scenario that are loaded (got "
                f"{type(self.design).__name__} and {type(self.scenario).__name__}); use "
                "load_design and load_scenario",
            )
        if self.accuracy not in PRESETS:
            known = ", ".join(PRESETS)
            raise DesignError(
                "accuracy-unknown", f"accuracy must be one of {known} (got {self.accuracy!r})"
            )
        if self.keep not in get_args(Keep):
            known = ", ".join(get_args(Keep))
            raise DesignError("keep-unknown", f"keep must be one of {known} (got {self.keep!r})")
        if self.keep == "frames" and self.scenario.solve.route != "frames":
            raise DesignError(
                "frames-not-rendered",
                "frames cannot be kept where none are made (got route = 'points'); set "
                "solve.route = 'frames', or --route frames",
            )
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise DesignError(
                "seed-invalid", f"the seed must be a whole number from 0 on (got {self.seed!r})"
            )

    @cached_property
    def key(self) -> str:
        """Hash of the job and of the program."""
        text = json.dumps([code_hash(), self.plain()], sort_keys=True)
        return sha256(text.encode()).hexdigest()

    def plain(self) -> dict[str, Any]:
        """The job as plain values, to hash it and to hand it to other processes."""
        return {
            "design": self.design.model_dump(mode="json"),
            "scenario": self.scenario.model_dump(mode="json"),
            "seed": self.seed,
            "accuracy": self.accuracy,
            "keep": self.keep,
        }

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> "Job":
        """Undo :meth:`plain`."""
        return cls(
            design=Design.model_validate(plain["design"]),
            scenario=Scenario.model_validate(plain["scenario"]),
            seed=plain["seed"],
            accuracy=plain["accuracy"],
            keep=plain["keep"],
        )

    @cached_property
    def surface(self) -> Surface:
        """The sensing surface."""
        return self.design.surface()

    @cached_property
    def markers(self) -> Markers:
        """The markers as designed."""
        return make_markers(self.design, self.surface)

    @cached_property
    def unit(self) -> SensorInstance:
        """The virtual sensor."""
        return draw_sensor_instance(
            Sensor.of(self.design, self.surface, self.markers), self.scenario.unit, self.seed
        )

    @cached_property
    def plan(self) -> SamplePlan:
        """All samples before they are solved."""
        return draw_plan(self.design, self.surface, self.unit, self.scenario, seed=self.seed)

    @property
    def refine(self) -> int:
        """Elements of the simulation's mesh per marker pitch."""
        return PRESETS[self.accuracy].truth_refine


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
