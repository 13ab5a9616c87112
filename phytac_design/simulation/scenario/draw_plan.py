"""From a scenario and a sensor instance to all of its samples: forces, switches, light, region."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.contacts import Contacts, Switching, assign_forces
from phytac_design.simulation.sample_plan import ChartBox, SamplePlan
from phytac_design.simulation.scenario.contact_placement import (
    chart_window,
    contact_box,
    pressed_receptors,
    window_grid,
)
from phytac_design.simulation.scenario.grips import draw_grips, grip_section, level_forces
from phytac_design.simulation.scenario.presses import (
    contact_ranges,
    draw_presses,
    given_contacts,
    largest_reach_mm,
    press_count,
    reach_mm,
)
from phytac_design.simulation.scenario.scenario_file import CycleSection, Scenario, TimeSection
from phytac_design.simulation.scenario.viscoelasticity import (
    Relaxation,
    felt_cycles,
    felt_force,
    force_under_cycles,
    force_under_depth,
    light_at,
    switch_step,
)
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

Shares = Callable[[Contacts], FloatArray]
"""(c contacts) -> share of the force of each on each footprint, (c, n)."""


@dataclass(frozen=True, kw_only=True)
class ContactHistory:
    """Contacts with their history.

    Attributes
    ----------
    touches : Contacts
        Contacts with the force that a gauge reads.
    felt_N : (c,) float
        Their felt force.
    body : (c,) int
        Indenter of each contact: same place, same shape.
    before_N : (c, k) float
        Force at turning points since the sample's switches were all off; the last is now.
    time_s : (s,) float
        When samples are taken.
    sequence : (s,) int
        Press that each belongs to.
    """

    touches: Contacts
    felt_N: FloatArray
    body: IntArray
    before_N: FloatArray
    time_s: FloatArray
    sequence: IntArray


def draw_plan(
    design: Design,
    surface: Surface,
    unit: SensorInstance,
    scenario: Scenario,
    *,
    seed: int,
    carried: Shares | None = None,
) -> SamplePlan:
    """Draw all samples of a scenario on one sensor instance.

    A sample of presses or grips depends on the seed and its own number only, not on how many there
    are. The rig presses where receptors were designed, not where they were printed.

    Parameters
    ----------
    design, surface : Design, Surface
        The sensor as designed.
    unit : SensorInstance
        The print, see ``scatter.draw_sensor_instance``.
    scenario : Scenario
        What is done to it.
    seed : int
        Seed of every draw.
    carried : callable, optional
        Share of each contact's force on each footprint; ``footprint_shares`` by default.

    Raises
    ------
    DesignError
        If contacts cannot be placed, or the scenario does not go with the design.
    """
    known = unit.markers if unit.number == 0 else make_markers(design, surface)
    makers = {"presses": _presses, "grips": _grips, "cycles": _cycles}
    pressed = makers[scenario.kind](design, surface, known, scenario, seed)
    shares = carried or _footprints(design, surface, unit)
    light = scenario.light
    return SamplePlan(
        touches=pressed.touches,
        felt_N=pressed.felt_N,
        time_s=pressed.time_s,
        sequence=pressed.sequence,
        light=light_at(pressed.time_s, light.drift_share, light.drift_time_s),
        switching=_switching(pressed, unit, shares),
        region=_region(design, surface, known, scenario, pressed.touches),
    )


def _region(
    design: Design, surface: Surface, markers: Markers, scenario: Scenario, touches: Contacts
) -> ChartBox:
    """Where contacts may lie: as drawn, the whole touched part, however many samples there are."""
    touch = scenario.touch
    if touch.at is not None or scenario.kind == "cycles":
        return contact_box(surface, touches.uv, reach_mm(touches))
    places = window_grid(chart_window(surface, touch.along, touch.around))
    if touch.columns is not None:
        places = markers.uv[pressed_receptors(surface, markers, touch)]
    reach = largest_reach_mm(touch, contact_ranges(design, touch))
    return contact_box(surface, places, np.full(len(places), reach))


def _footprints(design: Design, surface: Surface, unit: SensorInstance) -> Shares:
    radius = design.switch.footprint_diameter_mm / 2.0
    return lambda touches: footprint_shares(surface, touches, unit.markers.uv, radius)


def _relaxation(time: TimeSection) -> Relaxation:
    return Relaxation(share=np.array(time.relax_share), time_s=np.array(time.relax_s))


def _history(time: TimeSection, times_s: FloatArray, drawn_N: FloatArray) -> FloatArray:
    """Gauge and felt force, (2, t) or (2, t, c), of a force or depth that is prescribed."""
    wall = _relaxation(time)
    if time.control == "force":
        return np.stack([drawn_N, felt_force(wall.creep(), times_s, drawn_N)])
    held = force_under_depth(wall, times_s, drawn_N)
    return np.stack([held.force_N, held.felt_N])


def _presses(
    design: Design, surface: Surface, markers: Markers, scenario: Scenario, seed: int
) -> ContactHistory:
    """Samples that remember nothing of each other: up, held, sampled."""
    touch, time = scenario.touch, scenario.time
    count = press_count(design, scenario)
    if touch.at is None:
        bodies = draw_presses(
            Sensor.of(design, surface, markers), scenario, seed=seed, samples=count
        )
    else:
        bodies = given_contacts(surface, markers, touch, count)
    times = np.array([0.0, time.ramp_s, time.ramp_s + time.hold_s])
    gauge, felt = _history(time, times, np.array([0.0, 1.0, 1.0]))
    peak = bodies.force_N
    period = times[-1] + time.release_s + time.rest_s
    return ContactHistory(
        touches=replace(bodies, force_N=gauge[-1] * peak),
        felt_N=felt[-1] * peak,
        body=np.arange(len(peak)),
        before_N=np.multiply.outer(peak, gauge[1:]),
        time_s=np.arange(count) * period + times[-1],
        sequence=np.arange(count),
    )


def _grips(
    design: Design, surface: Surface, _: Markers, scenario: Scenario, seed: int
) -> ContactHistory:
    """A hand that changes its forces from level to level, then lets go and comes from elsewhere."""
    time, levels = scenario.time, grip_section(scenario).levels
    count = press_count(design, scenario)
    grips = -(-count // levels)
    hand = draw_grips(design, surface, scenario, seed=seed, grips=grips)
    parts = hand.force_N.reshape(grips, -1)
    pads = parts.shape[1]
    level = level_forces(
        scenario, contact_ranges(design, scenario.touch), parts, seed=seed, samples=grips * levels
    ).reshape(grips, levels, pads)
    # Corners of the history: nothing, then the end of each ramp and of each hold.
    corners = np.zeros((2 * levels + 1, grips, pads))
    corners[1::2] = corners[2::2] = np.moveaxis(level, 1, 0)
    step = time.ramp_s + time.hold_s
    ends = step * np.arange(1, levels + 1)
    times = np.concatenate([[0.0], np.column_stack([ends - time.hold_s, ends]).ravel()])
    past = _history(time, times, corners.reshape(len(times), -1))
    gauge, felt = np.moveaxis(past.reshape(2, len(times), grips, pads), 1, 3)  # (grip, pad, t)
    number = np.arange(count)
    before = np.zeros((grips, levels, pads, 2 * levels))
    for k in range(levels):
        # Right-aligned: all end at their own sample.
        before[:, k, :, 2 * (levels - k - 1) :] = gauge[..., 1 : 2 * k + 3]
    body = np.arange(grips * pads).reshape(grips, 1, pads).repeat(levels, axis=1)
    body = body.reshape(-1, pads)[:count].ravel()
    now = before[..., -1].reshape(-1, pads)[:count].ravel()
    period = levels * step + time.release_s + time.rest_s
    return ContactHistory(
        touches=replace(hand.take(body), sample=number.repeat(pads), samples=count, force_N=now),
        felt_N=np.swapaxes(felt[..., 2::2], 1, 2).reshape(-1, pads)[:count].ravel(),
        body=body,
        before_N=before.reshape(-1, pads, 2 * levels)[:count].reshape(len(body), -1),
        time_s=number // levels * period + (number % levels + 1) * step,
        sequence=number // levels,
    )


def _cycles(
    design: Design, surface: Surface, markers: Markers, scenario: Scenario, seed: int
) -> ContactHistory:
    """One press again and again; what it left behind stays."""
    # A contact at rest whose creep is less than this share of its peak is no contact.
    negligible = 1e-9
    # Steps of each piece of a press under a prescribed depth, to find where the wall lets go.
    substeps = 8
    touch, time, cycle = scenario.touch, scenario.time, scenario.cycle or CycleSection()
    if touch.at is None:
        bodies = draw_presses(
            Sensor.of(design, surface, markers), scenario, seed=seed, samples=1, alone=True
        )
    else:
        bodies = given_contacts(surface, markers, touch, 1)
    parts = 4 if time.control == "force" else 4 * substeps
    phases = np.array(cycle.phases)
    nodes = np.unique(np.concatenate([np.linspace(0.0, 4.0, parts + 1), phases]))
    ends = np.cumsum([0.0, time.ramp_s, time.hold_s, time.release_s, time.rest_s])
    times = np.interp(nodes, np.arange(5.0), ends)
    shape = np.interp(nodes, np.arange(5.0), [0.0, 1.0, 1.0, 0.0, 0.0])
    chosen = np.arange(0, cycle.count, cycle.every)
    wall = _relaxation(time)
    if time.control == "force":
        felt = felt_cycles(wall.creep(), times, shape, chosen)
        gauge = np.broadcast_to(shape, felt.shape)
    else:
        held = force_under_cycles(wall, times, shape, chosen)
        gauge, felt = held.force_N, held.felt_N
    taken = np.searchsorted(nodes, phases)
    most = np.maximum.accumulate(gauge, axis=1)[:, taken].ravel()
    now, left = gauge[:, taken].ravel(), felt[:, taken].ravel()
    samples, count = len(now), len(bodies.force_N)
    row = np.repeat(np.flatnonzero((now > 0.0) | (left > negligible)), count)
    body = np.tile(np.arange(count), len(row) // max(count, 1))
    peak = bodies.force_N[body]
    return ContactHistory(
        touches=replace(bodies.take(body), sample=row, samples=samples, force_N=now[row] * peak),
        felt_N=left[row] * peak,
        body=body,
        before_N=np.column_stack([most[row] * peak, now[row] * peak]),
        time_s=np.add.outer(chosen * ends[-1], times[taken]).ravel(),
        sequence=np.repeat(chosen, len(taken)),
    )


def _switching(
    pressed: ContactHistory, unit: SensorInstance, shares: Shares, *, block: int = 2000
) -> Switching:
    """Switches with their hysteresis, ``block`` samples at a time to bound the memory."""
    touches, parts = pressed.touches, []
    for first in range(0, touches.samples, block):
        last = min(first + block, touches.samples)
        begin, end = np.searchsorted(touches.sample, [first, last])
        rows = np.arange(begin, end)
        own = touches.take(rows)
        own = replace(own, sample=own.sample - first, samples=last - first)
        _, unique, inverse = np.unique(pressed.body[rows], return_index=True, return_inverse=True)
        share = shares(own.take(unique))[inverse] if len(rows) else np.zeros((0, len(unit.on_N)))
        state = np.zeros((last - first, len(unit.on_N)), dtype=np.bool_)
        for past in pressed.before_N[rows].T:
            total = np.zeros(state.shape)
            np.add.at(total, own.sample, share * past[:, None])
            state = switch_step(state, total, unit.on_N, unit.off_N)
        part = assign_forces(own, share, state)
        if unit.law is not None:  # tips follow the force of now, the last one
            part = replace(part, out=unit.law.out_share(total, state, unit.on_N))
        parts.append(replace(part, owner=np.where(part.owner >= 0, part.owner + begin, -1)))
    return Switching(
        bits=np.concatenate([part.bits for part in parts]),
        owner=np.concatenate([part.owner for part in parts]),
        receptor_force_N=np.concatenate([part.receptor_force_N for part in parts]),
        tripped=np.concatenate([part.tripped for part in parts]),
        out=None if unit.law is None else np.concatenate([part.shown for part in parts]),
    )
