"""Theories of the twin's wall: seconds and error of each; what a local mesh saves and costs.

Rows of ``twin``. Everything is solved on one core; seconds are of the processor.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Loading
from phytac_design.simulation.contacts import draw_contacts
from phytac_design.simulation.indenters import Touches, flat_touches
from phytac_design.simulation.linear_response import point_motions, turned_points
from phytac_design.simulation.scenario.contact_box import contact_box
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_sections import SensorInstanceSection
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_design.simulation.solver import Displacement, Solver
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

SAMPLES, FINEST, REFINES = 24, 13, (5, 7, 9)
NEWTON = {5: 12, 7: 6, 9: 6}
"""Samples solved by Newton's method too, for each mesh."""
TOLERANCES = (0.1, 0.03, 0.01)
PART = 8
"""Contacts of each scenario that touches a part of the wall."""
PARTS = (
    ("a quarter around, all along", (0.0, 0.375), (1.0, 0.625)),
    ("the middle fifth of a quarter", (0.4, 0.375), (0.6, 0.625)),
    ("a fifth at the near rim, a quarter around", (0.0, 0.375), (0.2, 0.625)),
)
"""Name, low and high shares of the chart."""


@dataclass(frozen=True, kw_only=True)
class DesignUnit:
    """A shipped design, built without scatter."""

    design: Design
    surface: Surface
    markers: Markers
    unit: SensorInstance

    @property
    def arm_mm(self) -> FloatArray:
        """From the middle face to the tips, (n, 3)."""
        return np.asarray(self.markers.tip_mm - self.markers.mid_mm)

    def solver(self, refine: int, displacement: Displacement, **options: Any) -> Solver:
        """Solver of unit 0."""
        return Solver(
            self.design,
            self.surface,
            self.unit,
            refine=refine,
            displacement=displacement,
            **options,
        )

    def draw(self, samples: int, most: int = 5) -> Touches:
        """Samples as on the paper's platform."""
        rng = np.random.default_rng(3)
        return flat_touches(
            draw_contacts(
                Sensor.of(self.design, self.surface, self.markers),
                samples=samples,
                rng=rng,
                most=most,
            )
        )


@dataclass
class SolvedSamples:
    """Tips (n, 3), seconds, theory, and whether the guarded way was taken, of each sample."""

    tips_mm: list[FloatArray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    theory: list[str] = field(default_factory=list)
    guarded: list[bool] = field(default_factory=list)


def bench(name: str) -> DesignUnit:
    """Unit 0 of a shipped design."""
    design = load_design(name)
    surface = design.surface()
    markers = make_markers(design, surface)
    unit = draw_sensor_instance(
        Sensor.of(design, surface, markers), SensorInstanceSection(number=0), seed=0
    )
    return DesignUnit(design=design, surface=surface, markers=markers, unit=unit)


def solve_all(this: DesignUnit, solver: Solver, touches: Touches) -> SolvedSamples:
    """Solve all samples; one that is not ``ok`` ends the benchmark."""
    out = SolvedSamples()
    for k in range(touches.samples):
        one = touches.of(k)
        start = time.process_time()
        found = solver.solve(one, one.force_N)
        out.seconds.append(time.process_time() - start)
        if found.motion is None or found.status != "ok":
            raise RuntimeError(f"sample {k} is {found.status}: {found.reason}")
        points = turned_points if found.theory == "large" else point_motions
        out.tips_mm.append(points(found.motion, this.arm_mm))
        out.theory.append(found.theory)
        out.guarded.append(bool(found.guarded))
    return out


def newton_all(this: DesignUnit, solver: Solver, touches: Touches, count: int) -> SolvedSamples:
    """Solve the first samples by Newton's method, with a factor at every step."""
    out = SolvedSamples()
    for k in range(count):
        one = touches.of(k)
        start = time.process_time()
        force = solver.load(one, one.force_N)
        end = solve_large(solver.model, Loading(force=force))[0]
        out.seconds.append(time.process_time() - start)
        out.tips_mm.append(turned_points(solver.kinematics.large(end.state.motion), this.arm_mm))
    return out


def errors(found: Sequence[FloatArray], truth: Sequence[FloatArray]) -> FloatArray:
    """Largest distance of a tip from the truth, % of the truth's largest motion, per sample."""
    return np.array(
        [
            100.0 * np.linalg.norm(a - b, axis=1).max() / np.linalg.norm(b, axis=1).max()
            for a, b in zip(found, truth, strict=False)
        ]
    )


def error_rows(
    table: Table, head: str, found: SolvedSamples, truth: Sequence[FloatArray], source: str
) -> None:
    """Seconds, and median and worst error."""
    row = f"{head}: processor time a sample"
    table.add(
        row, float(np.mean(found.seconds)), "s", "-", "mean; the shell built and factored before"
    )
    off = errors(found.tips_mm, truth)
    for word, value in (("median", np.median(off)), ("worst", np.max(off))):
        table.add(f"{head}: tips, {word} difference", float(value), "% of peak", 0.0, source)


def theory_rows(table: Table, *, quick: bool) -> None:
    """Seconds and error of each theory on each mesh."""
    this = bench("cylinder40" if quick else "cylinder60")
    finest, refines, samples = (5, (3,), 6) if quick else (FINEST, REFINES, SAMPLES)
    touches = this.draw(samples)
    truth = solve_all(this, this.solver(finest, "large"), touches).tips_mm
    source = f"large, refine {finest}"
    name = this.design.name
    row = f"{name}, theories: samples with several contacts"
    value = float(np.mean(touches.counts > 1))
    reference = this.design.training.multi_contact
    table.add(
        row, value, "share", reference, "the design's training table; forces and radii likewise"
    )
    for refine in refines:
        solver = this.solver(refine, "large")
        head = f"{name}, refine {refine} ({solver.nodes} nodes)"
        large = solve_all(this, solver, touches)
        error_rows(table, f"{head}, large, accelerated", large, truth, source)
        row = f"{head}, large, accelerated: samples that took the guarded way"
        table.add(row, sum(large.guarded), "samples", 0, f"of {samples}")
        newton = newton_all(this, solver, touches, 3 if quick else NEWTON[refine])
        count = len(newton.tips_mm)
        error_rows(table, f"{head}, large, Newton ({count} samples)", newton, truth, source)
        row = f"{head}, accelerated against Newton: tips, worst difference"
        value = float(errors(large.tips_mm, newton.tips_mm).max())
        table.add(row, value, "% of peak", 0.0, f"Newton's method, {count} samples", "<= 0.01")
        row = f"{head}, accelerated against Newton: processor time"
        value = float(np.sum(newton.seconds) / np.sum(large.seconds[:count]))
        table.add(row, value, "times less", 1.0, f"the same {count} samples")
        solver.displacement = "linear"
        linear = solve_all(this, solver, touches)
        error_rows(table, f"{head}, linear", linear, truth, source)
        solver.displacement = "auto"
        for tolerance in TOLERANCES:
            solver.tolerance = tolerance
            auto = solve_all(this, solver, touches)
            label = f"{head}, auto at {tolerance:g}"
            error_rows(table, label, auto, truth, source)
            row = f"{label}: samples solved by linear theory"
            table.add(row, auto.theory.count("linear") / samples, "share", "-", "the estimate")
            row = f"{label}: tips, worst difference from large on the same mesh"
            value = float(errors(auto.tips_mm, large.tips_mm).max())
            table.add(
                row, value, "% of peak", 0.0, "large, accelerated", f"<= {100.0 * tolerance:g}"
            )


def local_rows(table: Table, *, quick: bool) -> None:
    """Meshes that are fine in the touched part alone."""
    this = bench("cylinder40" if quick else "cylinder60")
    finest, refine = (7, 5) if quick else (FINEST, 9)
    drawn = this.draw(400, most=1)
    share = (drawn.uv - this.surface.domain[:, 0]) / np.ptp(this.surface.domain, axis=1)
    truth = this.solver(finest, "linear")
    whole = this.solver(refine, "linear")
    for name, low, high in PARTS:
        inside = np.all((share >= low) & (share <= high), axis=1)
        rows = np.flatnonzero(inside)[:PART]
        touches = drawn.pick(rows, drawn.sample[rows])
        region = contact_box(this.surface, touches.uv, touches.radius_mm)
        start = time.process_time()
        local = this.solver(refine, "linear", region=region)
        spent = time.process_time() - start
        head = f"{this.design.name}, refine {refine}, touched: {name} ({len(rows)} contacts)"
        row = f"{head}: nodes of the local mesh"
        source = f"{local.nodes} of {whole.nodes} nodes; made and factored in {spent:.1f} s"
        table.add(row, local.nodes / whole.nodes, "of the whole", 1.0, source)
        exact = solve_all(this, truth, touches).tips_mm
        for label, solver in (("local", local), ("fine all over", whole)):
            solver.displacement = "linear"
            off = errors(solve_all(this, solver, touches).tips_mm, exact)
            for word, value in (("median", np.median(off)), ("worst", np.max(off))):
                row = f"{head}: {label}, tips, {word} error of the mesh"
                table.add(row, float(value), "% of peak", 0.0, f"refine {finest} all over; linear")
        seconds = []
        for solver in (local, whole):
            solver.displacement = "large"
            seconds.append(float(np.mean(solve_all(this, solver, touches).seconds)))
        row = f"{head}: processor time a sample, local mesh, large"
        table.add(row, seconds[0], "s", seconds[1], "fine all over")


def add_rows(table: Table, *, quick: bool) -> None:
    """All rows of this module."""
    theory_rows(table, quick=quick)
    local_rows(table, quick=quick)
