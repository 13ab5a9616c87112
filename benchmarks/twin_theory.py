"""Theories of the twin's wall: seconds and error of each; what a local mesh saves and costs.

Rows of ``twin``. Everything is solved on one core; seconds are of the processor.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Loading
from phytac_design.simulation.contacts import draw_contacts
from phytac_design.simulation.indenters import Touches, flat_touches
from phytac_design.simulation.response import point_motions, turned_points
from phytac_design.simulation.scenario.contact_box import contact_box
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.sections import SensorInstanceSection
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_design.simulation.solver import Displacement, Solver
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

SAMPLES, FINEST, REFINES = 24, 13, (5, 7, 9)
NEWTON = {5: 12, 7: 6, 9: 6}
"""Samples solved by Newton's method too, for each mesh."""
TOLERANCES = (0.1, 0.03, 0.01)
AT_N = (5.0, 10.0, 25.0)
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
                self.design, self.surface, self.markers, samples=samples, rng=rng, most=most
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
    unit = draw_sensor_instance(design, surface, markers, SensorInstanceSection(number=0), seed=0)
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
    table.add(
        f"{head}: processor time a sample",
        float(np.mean(found.seconds)),
        "s",
        reference="-",
        source="mean; the shell built and factored before",
    )
    off = errors(found.tips_mm, truth)
    for word, value in (("median", np.median(off)), ("worst", np.max(off))):
        table.add(
            f"{head}: tips, {word} difference",
            float(value),
            "% of peak",
            reference=0.0,
            source=source,
        )


def theory_rows(table: Table, *, quick: bool) -> None:
    """Seconds and error of each theory on each mesh."""
    this = bench("cylinder40" if quick else "cylinder60")
    finest, refines, samples = (5, (3,), 6) if quick else (FINEST, REFINES, SAMPLES)
    touches = this.draw(samples)
    truth = solve_all(this, this.solver(finest, "large"), touches).tips_mm
    source = f"large, refine {finest}"
    name = this.design.name
    table.add(
        f"{name}, theories: samples with several contacts",
        float(np.mean(touches.counts > 1)),
        "share",
        reference=this.design.training.multi_contact,
        source="the design's training table; forces and radii likewise",
    )
    for refine in refines:
        solver = this.solver(refine, "large")
        head = f"{name}, refine {refine} ({solver.nodes} nodes)"
        large = solve_all(this, solver, touches)
        error_rows(table, f"{head}, large, accelerated", large, truth, source)
        table.add(
            f"{head}, large, accelerated: samples that took the guarded way",
            sum(large.guarded),
            "samples",
            reference=0,
            source=f"of {samples}",
        )
        newton = newton_all(this, solver, touches, 3 if quick else NEWTON[refine])
        count = len(newton.tips_mm)
        error_rows(table, f"{head}, large, Newton ({count} samples)", newton, truth, source)
        table.add(
            f"{head}, accelerated against Newton: tips, worst difference",
            float(errors(large.tips_mm, newton.tips_mm).max()),
            "% of peak",
            reference=0.0,
            source=f"Newton's method, {count} samples",
            target="<= 0.01",
        )
        table.add(
            f"{head}, accelerated against Newton: processor time",
            float(np.sum(newton.seconds) / np.sum(large.seconds[:count])),
            "times less",
            reference=1.0,
            source=f"the same {count} samples",
        )
        solver.displacement = "linear"
        linear = solve_all(this, solver, touches)
        error_rows(table, f"{head}, linear", linear, truth, source)
        solver.displacement = "auto"
        for tolerance in TOLERANCES:
            solver.tolerance = tolerance
            auto = solve_all(this, solver, touches)
            label = f"{head}, auto at {tolerance:g}"
            error_rows(table, label, auto, truth, source)
            table.add(
                f"{label}: samples solved by linear theory",
                auto.theory.count("linear") / samples,
                "share",
                reference="-",
                source="the estimate",
            )
            table.add(
                f"{label}: tips, worst difference from large on the same mesh",
                float(errors(auto.tips_mm, large.tips_mm).max()),
                "% of peak",
                reference=0.0,
                source="large, accelerated",
                target=f"<= {100.0 * tolerance:g}",
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
        table.add(
            f"{head}: nodes of the local mesh",
            local.nodes / whole.nodes,
            "of the whole",
            reference=1.0,
            source=f"{local.nodes} of {whole.nodes} nodes; made and factored in {spent:.1f} s",
        )
        exact = solve_all(this, truth, touches).tips_mm
        for label, solver in (("local", local), ("fine all over", whole)):
            solver.displacement = "linear"
            off = errors(solve_all(this, solver, touches).tips_mm, exact)
            for word, value in (("median", np.median(off)), ("worst", np.max(off))):
                table.add(
                    f"{head}: {label}, tips, {word} error of the mesh",
                    float(value),
                    "% of peak",
                    reference=0.0,
                    source=f"refine {finest} all over; linear",
                )
        seconds = []
        for solver in (local, whole):
            solver.displacement = "large"
            seconds.append(float(np.mean(solve_all(this, solver, touches).seconds)))
        table.add(
            f"{head}: processor time a sample, local mesh, large",
            seconds[0],
            "s",
            reference=seconds[1],
            source="fine all over",
        )


def force_rows(table: Table, *, quick: bool) -> None:
    """Linear theory against large displacements on a receptor in the middle."""
    this = bench("cylinder40" if quick else "cylinder60")
    solver = this.solver(5 if quick else 9, "large")
    (u0, u1), _ = this.surface.domain
    middle = np.array([(u0 + u1) / 2.0, np.pi])
    at = this.surface.point(middle[None])
    place = np.argmin(np.linalg.norm(this.surface.point(this.markers.uv) - at, axis=1))
    pressed = this.draw(1, most=1)
    for force in AT_N:
        one = Touches(
            **{
                **vars(pressed),
                "uv": this.markers.uv[place][None],
                "force_N": np.array([force]),
                "radius_mm": np.array([5.0]),
            }
        )
        peaks, tips = [], []
        for displacement in ("large", "linear"):
            solver.displacement = displacement
            tips.append(solve_all(this, solver, one).tips_mm[0])
            peaks.append(float(np.linalg.norm(tips[-1], axis=1).max()))
        head = f"{this.design.name}, {force:g} N on a receptor in the middle, patch radius 5 mm"
        table.add(
            f"{head}: linear peak over large, less 1",
            100.0 * (peaks[1] / peaks[0] - 1.0),
            "%",
            reference=0.0,
            source=f"large, the same mesh; peak {peaks[0]:.4f} mm",
        )
        table.add(
            f"{head}: linear, tips, largest difference from large",
            float(errors([tips[1]], [tips[0]])[0]),
            "% of peak",
            reference=0.0,
            source="large, the same mesh",
        )


def add_rows(table: Table, *, quick: bool) -> None:
    """All rows of this module."""
    theory_rows(table, quick=quick)
    local_rows(table, quick=quick)
    force_rows(table, quick=quick)
