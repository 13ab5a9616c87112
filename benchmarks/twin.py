"""The virtual sensor: its shell against CalculiX, its speed, its imaging, its data sets.

The parts ``shell_…`` hold it against contacts solved by CalculiX on solids of the true CAD.

``python -m benchmarks.twin [--quick] [--parts a,b]``
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks import twin_camera, twin_engine, twin_theory
from benchmarks.harness import Table, run_parts
from benchmarks.referee.contacts import COUNTS
from benchmarks.referee.read import Solved, data_file, read_solved
from benchmarks.referee.solve import sensor, sizes_for, solve_contact
from phytac_design.design.accuracy import PRESETS
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.linear_response import turned_points
from phytac_design.simulation.sensor_instance import designed_shell
from phytac_design.simulation.solver import Solver
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SOURCE = "CalculiX NLGEOM, quadratic tetrahedra of the CAD (benchmarks/referee)"
QUICK = 4
"""Contacts of a quick run."""
LIMIT = 2.0
RIM_MM = 5.0
RIM = (
    "the worst tip stands beside a clamped rim: solids of this size hardly converge there, and a "
    "tall tube multiplies the turn"
)
GROUPS: tuple[tuple[str, Callable[[Solved], bool]], ...] = (
    ("all", lambda _: True),
    ("up to 5 N", lambda item: item.largest_N <= 5.0),
    ("5 to 12 N", lambda item: 5.0 < item.largest_N <= 12.0),
    ("12 to 25 N", lambda item: item.largest_N > 12.0),
    ("one patch on a receptor", lambda item: item.contact.kind == "receptor"),
    ("one patch anywhere", lambda item: item.contact.kind == "between"),
    ("near a rim", lambda item: item.contact.kind == "rim"),
    ("several patches", lambda item: item.contact.kind == "multi"),
)


@dataclass(frozen=True, kw_only=True)
class TipComparison:
    """Tips of one contact by the shell, beside the referee's.

    Attributes
    ----------
    item : Solved
        The referee's.
    large_mm : (n, 3) float
        By large displacements.
    """

    item: Solved
    large_mm: FloatArray


def touches_of(item: Solved) -> Contacts:
    """Contacts of one sample, as the referee pressed them."""
    count = len(item.contact.uv)
    return Contacts.flat(
        sample=np.zeros(count, dtype=np.int64),
        uv=item.contact.centres,
        radius_mm=np.array(item.contact.radius_mm),
        force_N=np.array(item.contact.force_N),
        samples=1,
    )


def judge(this: Sensor, solver: Solver, solved: list[Solved]) -> list[TipComparison]:
    """Solve the referee's contacts by the simulated sensor; nothing presses on holes."""
    arm = this.markers.tip_mm - this.markers.mid_mm
    out = []
    for item in solved:
        contacts = touches_of(item)
        found = solver.solve(contacts, contacts.force_N)
        if found.motion is None:
            raise RuntimeError(f"contact {item.index} has no shell solution: {found.reason}")
        out.append(TipComparison(item=item, large_mm=turned_points(found.motion, arm)))
    return out


def gap(found: FloatArray, item: Solved, tips: IntArray | None = None) -> float:
    """Largest distance of tips (all, or some) from the referee's, in % of its largest motion."""
    away = np.linalg.norm(found - item.motion_mm, axis=1)
    return float(100.0 * away[slice(None) if tips is None else tips].max() / item.peak_mm)


def at_rim(this: Sensor) -> BoolArray:
    """Which receptors (n,) stand beside a rim."""
    uv = this.markers.uv
    here = this.surface.point(uv)
    ends = [
        this.surface.point(np.column_stack([np.full(len(uv), end), uv[:, 1]]))
        for end in this.surface.domain[0]
    ]
    return np.asarray(np.min([np.linalg.norm(p - here, axis=1) for p in ends], axis=0) < RIM_MM)


def worst_tip(one: TipComparison) -> int:
    """The receptor whose tip is farthest off."""
    return int(np.argmax(np.linalg.norm(one.large_mm - one.item.motion_mm, axis=1)))


def bias(found: FloatArray, item: Solved) -> float:
    """Least-squares scale of the shell's motion over the referee's, less 1, in %."""
    truth = item.motion_mm
    return float(100.0 * (np.sum(found * truth) / np.sum(truth * truth) - 1.0))


def shell_rows(table: Table, name: str, *, quick: bool) -> None:
    """Tips of the twin's shell against the referee's, by force and by kind of contact."""
    this = sensor(name)
    solved = read_solved(data_file(name), this.design, this.markers)[: QUICK if quick else None]
    refine = PRESETS["draft" if quick else "standard"].truth_refine
    unit = designed_shell(this.surface, this.markers)
    solver = Solver(this.design, this.surface, unit, refine=refine, displacement="large")
    judged = judge(this, solver, solved)
    rim = at_rim(this)
    what = f"{name}: twin's shell (refine {refine}, extrapolated, large displacements)"
    for group, chosen in GROUPS:
        part = [one for one in judged if chosen(one.item)]
        if not part:
            continue
        errors = [gap(one.large_mm, one.item) for one in part]
        worst = part[int(np.argmax(errors))]
        head = f"{what}, tip displacement, {group} ({len(part)} contacts)"
        for word, value in (("median", np.median(errors)), ("worst", np.max(errors))):
            row = f"{head}: {word} difference"
            note = RIM if value > LIMIT and rim[worst_tip(worst)] else ""
            table.add(row, float(value), "% of peak", 0.0, SOURCE, "<= 2", note)
        row = f"{head}: mean scale of the shell's motion over the referee's, less 1"
        table.add(
            row, float(np.mean([bias(one.large_mm, one.item) for one in part])), "%", 0.0, SOURCE
        )
    every = np.arange(this.markers.count)
    inner = [gap(one.large_mm, one.item, np.flatnonzero(~rim)) for one in judged]
    for word, value in (("median", np.median(inner)), ("worst", np.max(inner))):
        row = f"{what}, tips {RIM_MM:g} mm from the rims and farther: {word} difference"
        table.add(row, float(value), "% of peak", 0.0, SOURCE, "<= 2")
    for label, tips_in in (
        ("receptors that the referee models with tube and hole", lambda item: item.kept),
        ("other receptors", lambda item: np.setdiff1d(every, item.kept)),
    ):
        errors = [gap(one.large_mm, one.item, tips_in(one.item)) for one in judged]
        row = f"{what}, tip displacement of {label}: worst difference"
        table.add(row, float(np.max(errors)), "% of peak", 0.0, SOURCE)
    row = f"{name}: contacts solved by the referee"
    source = "the frozen list"
    note = "" if len(solved) == sum(COUNTS[name]) else "the others are being solved"
    target = f">= {50 if name == 'cylinder60' else 20}"
    table.add(row, len(solved), "contacts", sum(COUNTS[name]), source, target, note)


OWN_ERROR = {"cylinder60": (2, 27, 24), "grip": (19, 3)}
"""Contacts that the referee solves on other meshes too: beside a receptor, on one, near a rim."""
COARSER, FINER = 1.33, 0.75
"""Sizes of elements of those meshes over the referee's own."""


def referee_rows(table: Table, *, quick: bool) -> None:
    """Error of the referee because of its own mesh, from a coarser and a finer one."""
    for name, indices in OWN_ERROR.items():
        this = sensor(name)
        frozen = {one.index: one for one in read_solved(data_file(name), this.design, this.markers)}
        for index in indices[: 1 if quick else None]:
            item = frozen[index]
            sizes = sizes_for(this.design, item.contact)
            sizes = replace(sizes, reach_mm=item.facts.get("reach", 1.0) * sizes.reach_mm)
            head = f"{name}, contact {index} ({item.contact.kind}), referee"
            off = []
            for size in (COARSER, FINER):
                found = solve_contact(name, index, item.contact, sizes.scaled(size))
                off.append(bias(found.motion_mm, item))
                row = f"{head}: motion on elements of {size:g} times the size over its own, less 1"
                table.add(row, off[-1], "%", 0.0, f"CalculiX, {found.facts['nodes']} nodes")
            error, rate = own_error(*off)
            row = f"{head}: its motion is too small by"
            table.add(row, error, "%", 0.0, f"extrapolated, measured rate {rate:.1f}")


def own_error(coarser: float, finer: float) -> tuple[float, float]:
    """What the limit differs by from the middle one of three meshes, and the measured rate.

    Parameters
    ----------
    coarser, finer : float
        Results on elements of ``COARSER`` and ``FINER`` times the size, less the middle one's.
    """
    low, high = 0.5, 6.0
    for _ in range(50):
        rate = (low + high) / 2.0
        grown = (COARSER**rate - 1.0) / (1.0 - FINER**rate)
        low, high = (rate, high) if grown < -coarser / finer else (low, rate)
    return finer / (1.0 - FINER**rate), rate


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts of this benchmark."""
    out: dict[str, Callable[[Table], None]] = {}
    for name in COUNTS:
        out[f"shell_{name}"] = partial(shell_rows, name=name, quick=quick)
    out["referee"] = partial(referee_rows, quick=quick)
    out |= {
        name: partial(rows, quick=quick)
        for name, rows in (
            ("theory", twin_theory.add_rows),
            ("mesh", twin_theory.mesh_rows),
            ("imaging", twin_camera.add_rows),
            ("time", twin_engine.time_rows),
            ("workers", twin_engine.worker_rows),
            ("size", twin_engine.size_rows),
            ("shapes", twin_engine.shape_rows),
        )
    }
    return out


if __name__ == "__main__":
    run_parts("twin", parts, __doc__ or "")
