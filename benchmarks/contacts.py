"""Several strong contacts at once: how the decoder adds up their shifts, by large displacements.

Discs of 5.5 mm on ``cylinder60``, 4 to 31 mm apart. The reference of solved terms is a solution
with large displacements on the decoder's own mesh; that of its tables, which are extrapolated, one
that is extrapolated from that mesh and one of half its element size. ::

    python -m benchmarks.contacts [--quick]
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.decoder_evaluation import by_design, mechanics
from benchmarks.harness import Table, run_parts
from phytac_decoder.estimation.contact_fit import ContactPrior, initial_state
from phytac_decoder.estimation.contact_shifts import predicted_shifts
from phytac_decoder.mechanics.interaction_table import add_interactions, interaction_likeness
from phytac_decoder.mechanics.response_table import softening_of
from phytac_design.design.design_file import load_design
from phytac_design.engine.stage import Context
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.interaction_tables import InteractionSolver
from phytac_design.simulation.pressed_series import DiscResponse
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.solver import Solver
from phytac_design.stages.response_stage import decoder_shell, image_response_of
from phytac_shapes.arrays import FloatArray

FIRST = (48.0, 0.35)
"""Place of the first disc: mm along the axis, and angle in rad around it."""
BESIDE_mm = (
    *((0, 8), (0, 12), (0, 16), (0, 22), (0, 30), (8, 0), (12, 0), (16, 0), (22, 0)),
    *((9, 9), (6, -9), (-11, 5)),
)
"""From there to the others, along the axis and around it."""
OUTER_RADIUS_mm = 30.0
SETS: list[tuple[list[int], list[float]]] = [
    *(([0, k], [25.0, 25.0]) for k in range(1, 13)),
    *(([0, k], [12.5, 12.5]) for k in (1, 4, 6)),
    *(([0, k], [25.0, 5.0]) for k in (1, 4, 6)),
    ([0, 1, 6], [20.0, 20.0, 20.0]),
    ([0, 1, 2], [20.0, 20.0, 20.0]),
    ([0, 6, 8], [25.0, 25.0, 25.0]),
    ([0, 3, 7], [25.0, 25.0, 25.0]),
    ([0, 4, 5], [25.0, 25.0, 25.0]),
    ([0, 6, 12], [20.0, 20.0, 20.0]),
    ([0, 1, 10], [25.0, 20.0, 3.0]),
    ([0, 1, 6, 10], [15.0, 15.0, 15.0, 15.0]),
    ([0, 1, 4, 9, 11], [12.0, 12.0, 12.0, 12.0, 12.0]),
]
"""Discs that press at once, and their forces, N."""


class Discs:
    """Discs at some places: their own shifts, their interactions, and what they do together."""

    def __init__(self, context: Context) -> None:
        design, refine = context.design, context.accuracy.refine
        mesh, model, _ = decoder_shell(context)
        self.see = image_response_of(context)
        shell = DiscResponse(
            design, context.surface, context.markers, mesh=mesh, model=model, orders=4
        )
        bundle = by_design(context)
        assert bundle.model.locator is not None
        self.places = bundle.model.locator.places
        self.radius_mm = self.places.radius_mm
        step = np.array([[0, 0], *BESIDE_mm]) / [1.0, OUTER_RADIUS_mm]
        self.uv = np.array(FIRST) + step
        self.point_mm = context.surface.point(self.uv)
        self.rows = np.array(
            [self.see.powers(each, shell.forces) for each in shell.motions(self.uv, self.radius_mm)]
        )
        self.softening = softening_of(self.rows[:, 1:].astype(np.float32), shell.forces[-1])
        self.terms = InteractionSolver(shell, self.see, self.uv, self.radius_mm)
        instance = draw_sensor_instance(context.sensor, SensorInstanceSection(), 0)
        self.solvers = [
            Solver(
                design,
                context.surface,
                instance,
                refine=each,
                displacement="large",
                extrapolate=False,
            )
            for each in (refine, 2 * refine)
        ]

    def solved(self, ids: list[int], force_N: list[float]) -> tuple[FloatArray, FloatArray]:
        """Return the shifts (2n,) px with large displacements, own mesh and extrapolated."""
        count = len(ids)
        touch = Contacts.flat(
            sample=np.zeros(count, dtype=np.int64),
            uv=self.uv[ids],
            radius_mm=np.full(count, self.radius_mm),
            force_N=np.array(force_N),
            samples=1,
        )
        touch = replace(touch, friction=np.zeros((count, 2)))
        own, fine = (self.see.shift(each).ravel() for each in self._motions(touch, force_N))
        return own, fine + (fine - own) / 3.0

    def _motions(self, touch: Contacts, force_N: list[float]) -> Iterator[FloatArray]:
        for solver in self.solvers:
            motion = solver.solve(touch, np.array(force_N)).motion
            assert motion is not None
            yield motion

    def added(self, ids: list[int], force_N: list[float], *, softer: bool) -> FloatArray:
        """Return the shifts by solved terms, with interactions that grow or of second order."""
        force, rows = np.array(force_N), self.rows[ids]
        order = np.arange(rows.shape[1])
        parts = [
            (f ** (order + 1.0) @ own, ((order + 1.0) * f**order @ own)[None])
            for f, own in zip(force_N, rows, strict=True)
        ]
        pairs = np.array([(one, other) for i, one in enumerate(ids) for other in ids[:i]])
        images = self.terms.images(pairs)
        likeness = interaction_likeness(images, rows[:, 1])
        softening = self.softening[ids] if softer else np.zeros(len(ids))
        found = add_interactions(images, likeness, force, softening, parts, list(rows[:, 0]))
        return np.asarray(np.sum([shift for shift, _ in found], axis=0))

    def tabulated(self, ids: list[int], force_N: list[float]) -> FloatArray:
        """Return the shifts by the decoder's tables."""
        prior = ContactPrior(place_mm=1.0)
        states = [
            initial_state(self.places, prior, point, f)
            for point, f in zip(self.point_mm[ids], force_N, strict=True)
        ]
        shifts = [shift for shift, _ in predicted_shifts(self.places, states)]
        return np.asarray(np.sum(shifts, axis=0))


def add_rows(table: Table, *, quick: bool) -> None:
    """Add errors over the size of all shifts, by the number of contacts."""
    discs = Discs(mechanics(load_design("cylinder60"), "standard"))
    sets = SETS[::6] if quick else SETS
    errors: dict[int, list[list[float]]] = {}
    for ids, force_N in sets:
        own, limit = discs.solved(ids, force_N)
        tries = (
            (discs.added(ids, force_N, softer=False), own),
            (discs.added(ids, force_N, softer=True), own),
            (discs.tabulated(ids, force_N), limit),
        )
        found = [100.0 * np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in tries]
        errors.setdefault(len(ids), []).append([float(each) for each in found])
    on_own = "large displacements on the same mesh"
    names = {
        "solved terms, interactions of second order": on_own,
        "solved terms, interactions that grow as the wall softens": on_own,
        "the decoder's tables": "large displacements, extrapolated from 8 and 4 elements a pitch",
    }
    for count, each in sorted(errors.items()):
        forces = [f for ids, some in sets if len(ids) == count for f in some]
        case = f"cylinder60, {count} discs at once, {min(forces):g} to {max(forces):g} N"
        for (name, source), value in zip(names.items(), np.mean(each, axis=0), strict=True):
            note = f"mean of {len(each)} sets; error over the size of all shifts"
            table.add(f"{case}: {name}", float(value), "%", "", source, note=note)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts by name."""
    return {"at once": partial(add_rows, quick=quick)}


if __name__ == "__main__":
    run_parts("contacts", parts, __doc__ or "")
