"""Theories of the simulated wall: seconds and error of each.

Rows of ``twin``. Everything is solved on one core; seconds are of the processor.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.simulation.contacts import Contacts, draw_contacts
from phytac_design.simulation.linear_response import point_motions, turned_points
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.sensor_instance import designed_shell
from phytac_design.simulation.solver import Solver
from phytac_shapes.arrays import FloatArray

NEWTON = {5: 12, 7: 6, 9: 6}
"""Samples solved by Newton's method too, for each mesh."""
TOLERANCES = (0.1, 0.03, 0.01)


@dataclass
class SolvedSamples:
    """Tips (n, 3), seconds, theory, and whether the guarded way was taken, of each sample."""

    tips_mm: list[FloatArray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    theory: list[str] = field(default_factory=list)
    guarded: list[bool] = field(default_factory=list)


def solve_all(sensor: Sensor, solver: Solver, touches: Contacts) -> SolvedSamples:
    """Solve all samples; one that is not ``ok`` ends the benchmark."""
    out, arm = SolvedSamples(), sensor.markers.tip_mm - sensor.markers.mid_mm
    for k in range(touches.samples):
        one = touches.of(k)
        start = time.process_time()
        found = solver.solve(one, one.force_N)
        out.seconds.append(time.process_time() - start)
        if found.motion is None or found.status != "ok":
            raise RuntimeError(f"sample {k} is {found.status}: {found.reason}")
        points = turned_points if found.theory == "large" else point_motions
        out.tips_mm.append(points(found.motion, arm))
        out.theory.append(found.theory)
        out.guarded.append(bool(found.guarded))
    return out


def newton_all(sensor: Sensor, solver: Solver, touches: Contacts, count: int) -> SolvedSamples:
    """Solve the first samples by Newton's method, with a factor at every step."""
    out, arm = SolvedSamples(), sensor.markers.tip_mm - sensor.markers.mid_mm
    for k in range(count):
        one = touches.of(k)
        start = time.process_time()
        end = solve_large(solver.model, solver.load(one, one.force_N))[0]
        out.seconds.append(time.process_time() - start)
        out.tips_mm.append(turned_points(solver.kinematics.large(end.state.motion), arm))
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


def add_rows(table: Table, *, quick: bool) -> None:
    """Seconds and error of each theory on each mesh."""
    name = "cylinder40" if quick else "cylinder60"
    this = Sensor(load_design(name))
    unit = draw_sensor_instance(this, SensorInstanceSection(number=0), seed=0)
    finest, refines, samples = (5, (3,), 6) if quick else (13, (5, 7, 9), 24)
    # Samples as on the paper's platform.
    rng = np.random.default_rng(3)
    touches = draw_contacts(this, samples=samples, rng=rng, most=5)

    def solver_of(refine: int) -> Solver:
        return Solver(
            this.design, this.surface, unit, refine=refine, displacement="large", extrapolate=False
        )

    truth = solve_all(this, solver_of(finest), touches).tips_mm
    source = f"large, refine {finest}"
    row = f"{name}, theories: samples with several contacts"
    value = float(np.mean(touches.counts > 1))
    reference = this.design.training.multi_contact
    table.add(
        row, value, "share", reference, "the design's training table; forces and radii likewise"
    )
    for refine in refines:
        solver = solver_of(refine)
        head = f"{name}, refine {refine} ({solver.nodes} nodes)"
        large = solve_all(this, solver, touches)
        error_rows(table, f"{head}, large, accelerated", large, truth, source)
        row = f"{head}, large, accelerated: samples that took the guarded way"
        table.add(row, sum(large.guarded), "samples", 0, f"of {samples}")
        newton = newton_all(this, solver, touches, NEWTON.get(refine, 3))
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


def mesh_rows(table: Table, *, quick: bool) -> None:
    """Error of the simulated sensor because of its meshes, plain and extrapolated, by shape.

    The reference is of two much finer meshes, of even single contacts under large displacements.
    """
    names = ("cylinder40",) if quick else ("cylinder60", "hemisphere", "cuboid", "grip")
    refines, finest, samples = ((6,), 8, 2) if quick else ((6, 9), 14, 8)
    for name in names:
        this = Sensor(load_design(name))
        unit = designed_shell(this.surface, this.markers)
        solver = partial(Solver, this.design, this.surface, unit, displacement="large")
        touches = draw_contacts(this, samples=samples, rng=np.random.default_rng(3), most=1)
        both = [solver(refine=refine, extrapolate=False) for refine in (finest, finest // 2)]
        tips = [np.stack(solve_all(this, one, touches).tips_mm) for one in both]
        ratio = len(both[0].mesh.quads) / len(both[1].mesh.quads)
        truth = list(tips[0] + (tips[0] - tips[1]) / (ratio - 1.0))
        source = f"large, extrapolated from refine {finest} and {finest // 2}"
        for refine, extrapolate in product(refines, (False, True)):
            found = solve_all(this, solver(refine=refine, extrapolate=extrapolate), touches)
            word = "extrapolated" if extrapolate else "plain"
            head = f"{name}, {samples} contacts, refine {refine}, {word}"
            error_rows(table, head, found, truth, source)
            each = zip(found.tips_mm, truth, strict=True)
            off = [float(np.vdot(b, a) / np.vdot(b, b)) - 1.0 for a, b in each]
            row = f"{head}: force that the motion stands for, RMS error"
            value = 100.0 * float(np.sqrt(np.mean(np.square(off))))
            target = "<= 0.3" if extrapolate and refine == refines[-1] else None
            table.add(row, value, "%", 0.0, source, target)
