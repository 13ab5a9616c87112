#!/usr/bin/env python
"""Shared by the examples: simulate a hand on the handle, decode its markers, record the forces.

Nothing is fitted here: the sensor is simulated (finer mesh, large displacements, camera noise), the
decoder is the bundle that `phytac build` makes.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np

from phytac_decoder.estimation.force_regions import Region, load_regions
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.pipeline.frame_reading import read as read_measured
from phytac_decoder.serving.csv_recording import Recorder, RegionRecorder
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.datasets.samples_file import read_samples
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout.region_chart import chart_of_design
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.grips import grip_section
from phytac_design.simulation.scenario.scenario_file import Scenario, load_scenario, parse_scenario
from phytac_design.stages.build import build
from phytac_design.workflows.simulate import simulate
from phytac_shapes.arrays import BoolArray, FloatArray

mpl.use("Agg")
HERE = Path(__file__).parent


@dataclass(frozen=True, kw_only=True)
class Handle:
    """The sensor and its decoder."""

    design: Design
    bundle: Bundle
    regions: tuple[Region, ...]
    out: Path

    @property
    def estimator(self) -> str:
        """The default one."""
        return self.bundle.model.best

    @property
    def names(self) -> list[str]:
        """Of the regions."""
        return [region.name for region in self.regions]


def handle(out: Path) -> Handle:
    """Build the decoder of the handle (seconds; from the cache the second time)."""
    design = load_design(str(HERE / "handle.toml"))
    build(design, out / "handle", accuracy="draft", only=["decoder"], progress=lambda _: None)
    bundle = load_bundle(out / "handle" / "decoder")
    regions = load_regions(HERE / "fingers.toml", bundle.position_mm, chart_of_design(design))
    return Handle(design=design, bundle=bundle, regions=regions, out=out)


def hand(name: str) -> Scenario:
    """A scenario file beside this one: a hand of pads."""
    return load_scenario(str(HERE / f"{name}.toml"))


def moving(scenario: Scenario, force_N: FloatArray, along: FloatArray | None = None) -> Scenario:
    """The same pads with other forces in each sample, as explicit contacts.

    Parameters
    ----------
    scenario : Scenario
        Of kind ``grips``.
    force_N : (s, p) float
        Of each pad; 0 for a pad that is lifted.
    along : (s, p) float, optional
        How far each has slid, share of the sensor's length.
    """
    pads, touch = grip_section(scenario).pads or [], scenario.touch
    slid = np.zeros_like(force_N) if along is None else along
    at = [
        {
            "sample": sample,
            "along": float(np.clip(pad.along + slid[sample, number], 0.0, 1.0)),
            "around": pad.around,
            "force_N": float(force_N[sample, number]),
            "radius_mm": touch.radius_max_mm,
            "indenter": "sphere",
        }
        for sample in range(len(force_N))
        for number, pad in enumerate(pads[: force_N.shape[1]])
        if force_N[sample, number] > 0.0
    ]
    data = scenario.model_dump(mode="json", exclude_unset=True)
    data |= {"kind": "presses", "grip": None, "touch": {"samples": len(force_N), "at": at}}
    return parse_scenario(data, scenario.name)


def press(sensor: Handle, scenario: Scenario, *, workers: int = 2) -> Samples:
    """Simulate a scenario, or read it if it has been simulated already.

    Raises
    ------
    SystemExit
        If a sample could not be solved: the examples judge what they show against all of them.
    """
    job = Job(design=sensor.design, scenario=scenario, accuracy="draft")
    folder = sensor.out / f"samples-{scenario.name}"
    simulate(job, folder, workers=workers, force=True, progress=print)
    samples, _ = read_samples(folder)
    if np.any(samples.status == FAILED):
        raise SystemExit(f"{folder}: {int(np.sum(samples.status == FAILED))} samples failed")
    return samples


def messages_of(sensor: Handle) -> MessageBuilder:
    """Makes the messages of one stream."""
    return MessageBuilder(bundle=sensor.bundle, estimator=sensor.estimator, regions=sensor.regions)


def decode(sensor: Handle, samples: Samples, *, fps: float) -> list[Message]:
    """Messages as `phytac serve` sends them, one a sample, as frames of a camera at ``fps``."""
    if samples.shift_px is None or samples.bits_read is None:
        raise SystemExit("the samples hold no markers; simulate them with keep='points'")
    make = messages_of(sensor)
    return [
        make.frame(
            read(sensor, samples.shift_px[k], samples.bits_read[k]),
            sequence=k,
            timestamp_s=k / fps,
        )
        for k in range(samples.count)
    ]


def read(sensor: Handle, shift_px: FloatArray, bits: BoolArray) -> Reading:
    """Forces from markers and switches, by the decoder."""
    found = np.isfinite(shift_px[:, 0])
    measured = FrameMeasurement(koi=np.flatnonzero(bits), shift_px=shift_px, found=found)
    return read_measured(sensor.bundle, measured, sensor.estimator)


def record(sensor: Handle, messages: Sequence[Message], name: str) -> None:
    """Write contacts and forces of regions as `phytac serve --record` does."""
    contacts, regions = sensor.out / f"{name}.csv", sensor.out / f"{name}-regions.csv"
    for path in (contacts, regions):
        path.unlink(missing_ok=True)
    with Recorder(contacts) as rows, RegionRecorder(regions, sensor.names) as sums:
        for message in messages:
            rows.add(message)
            sums.add(message)
    print(f"wrote {contacts} and {regions}")


def region_forces(messages: Sequence[Message]) -> FloatArray:
    """Force of each region in each frame, (s, r) N."""
    return np.array([[region["force_N"] for region in m["regions"]] for m in messages])


def words(doc: str | None) -> argparse.Namespace:
    """Command line of an example."""
    parser = argparse.ArgumentParser(description=(doc or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, default=Path("exports/uses"), help="folder to write to")
    parser.add_argument("--quick", action="store_true", help="few samples, linear wall: seconds")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    return given


def quick_of(scenario: Scenario) -> Scenario:
    """The same with a linear wall and coarser pixels: much faster, less accurate."""
    data = scenario.model_dump(mode="json", exclude_unset=True)
    data["solve"] = {**data.get("solve", {}), "displacement": "linear", "samples_per_pixel": 8}
    return parse_scenario(data, scenario.name)
