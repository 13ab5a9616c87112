"""A simulated sensor, its decoder, and presses solved with large displacements."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.io.bundle import Bundle
from phytac_design.design.accuracy import Preset
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import expose
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import Scenario
from phytac_design.simulation.solver import Solver
from phytac_design.workflows.simulate import force_model_of, imaging_model
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from phytac_shapes.errors import InputError

REFINE = 7
"""Elements per marker pitch of the mesh that gives the truth."""
SEEN = 5
"""Seed of the image noise."""


@dataclass(frozen=True, kw_only=True)
class PressedSensor:
    """A sensor, its decoder and presses that are solved.

    Attributes
    ----------
    job : Job
        The presses.
    imaging : ImagingModel
        How the camera sees them.
    bundle : Bundle
        The decoder.
    motion : (s, n, 6) float
        Of the wall.
    """

    job: Job
    imaging: ImagingModel
    bundle: Bundle
    motion: FloatArray

    @classmethod
    def of(cls, design: Design, scenario: Scenario, *, seed: int, quick: bool) -> "PressedSensor":
        """Solve all presses of a scenario."""
        accuracy: Preset = "draft" if quick else "standard"
        job = Job(design=design, scenario=scenario, seed=seed, accuracy=accuracy)
        imaging = imaging_model(
            job, views=expected_views(Sensor.of(design, job.surface, job.markers))
        )
        bundle = replace(imaging.nominal, model=force_model_of(job))
        return cls.pressed(job, imaging, bundle, refine=5 if quick else REFINE)

    @classmethod
    def pressed(
        cls, job: Job, imaging: ImagingModel, bundle: Bundle, *, refine: int
    ) -> "PressedSensor":
        """Solve all presses of a job."""
        solver = Solver(job.design, job.surface, job.unit, refine=refine)
        touches, motion = job.plan.touches, []
        for index in range(touches.samples):
            rows = np.flatnonzero(touches.sample == index)
            found = solver.solve(touches.pick(rows, [index]), job.plan.felt_N[rows]).motion
            if found is None:
                raise InputError(
                    "sample-not-solved", f"sample {index} of the benchmark could not be solved"
                )
            motion.append(found)
        return cls(job=job, imaging=imaging, bundle=bundle, motion=np.stack(motion))

    @cached_property
    def tripped(self) -> BoolArray:
        """Samples (s,) all of whose contacts tripped a switch."""
        plan = self.job.plan
        none = np.bincount(plan.touches.sample[~plan.switching.tripped], minlength=len(self.motion))
        return np.asarray(none == 0)

    @property
    def at_rest(self) -> tuple[FloatArray, BoolArray]:
        """Motion and bits of the unloaded sensor."""
        return np.zeros((self.imaging.count, 6)), np.zeros(self.imaging.count, dtype=np.bool_)

    def pose(self, index: int) -> tuple[FloatArray, BoolArray]:
        """Motion and bits of a sample."""
        return self.motion[index], self.job.plan.switching.bits[index]

    def chip(self, motion: FloatArray, bits: BoolArray) -> NDArray[np.float32]:
        """Light on the chip."""
        camera = self.imaging.cameras[0]
        return camera.light(camera.scene(motion, bits))

    def shot(
        self,
        light: NDArray[np.float32],
        seed: int,
        *,
        gains: tuple[float, float] = (1.0, 1.0),
        stops: float = 0.0,
        corner: float | None = None,
    ) -> ImageArray:
        """Frame of that light; ``gains`` of red and blue."""
        given = self.imaging.exposure
        used = given if corner is None else replace(given, vignetting=corner)
        tinted = light * np.array([gains[1], 1.0, gains[0]], dtype=np.float32)
        rng = np.random.default_rng([SEEN, seed])
        camera = self.imaging.cameras[0].camera
        return expose(tinted, camera, used, brightness=2.0**stops, rng=rng)

    def forces_of(self, index: int, forces_N: FloatArray) -> tuple[float, FloatArray]:
        """Total, and force of each contact, and last of none, (c + 1,), from forces (n,)."""
        plan = self.job.plan
        rows = np.flatnonzero(plan.touches.sample == index)
        owner = plan.switching.owner[index]
        each = [forces_N[owner == row].sum() for row in rows]
        return float(forces_N.sum()), np.array([*each, forces_N[owner < 0].sum()])

    def true_N(self, index: int) -> FloatArray:
        """Force of each contact."""
        touches = self.job.plan.touches
        return np.asarray(touches.force_N[touches.sample == index])


def scenario_of(samples: int, placement: str) -> Scenario:
    """Flat and spherical indenters, one to five at once."""
    touch = {
        "samples": samples,
        "placement": placement,
        "indenters": [{"kind": "flat"}, {"kind": "sphere"}],
    }
    return Scenario.model_validate({"name": "faults", "touch": touch})


def rms(values: FloatArray) -> float:
    """Root mean square of what is known."""
    return float(np.sqrt(np.nanmean(values**2)))
