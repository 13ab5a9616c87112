"""A hand of fixed pads around a sensor: where its pads lie, and how hard each of them presses."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.scenario.contact_placement import ChartWindow, chart_window
from phytac_design.simulation.scenario.presses import ContactRanges, contact_ranges, draw_indenters
from phytac_design.simulation.scenario.random_streams import RandomStream, random_stream
from phytac_design.simulation.scenario.scenario_file import GripSection, Scenario
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


def draw_grips(
    design: Design, surface: Surface, scenario: Scenario, *, seed: int, grips: int
) -> Contacts:
    """Pads of ``grips`` grips, each grip a sample; forces are parts of 1.

    The hand is laid over the touched part of the chart, turned around a closed axis, swapped end
    for end and moved along, as ``[grip]`` allows. Pads that would overlap on a small sensor
    shrink.

    Raises
    ------
    DesignError
        If the pads have no room.
    """
    touch, limits = scenario.touch, contact_ranges(design, scenario.touch)
    part = chart_window(surface, touch.along, touch.around)
    grip = grip_section(scenario)
    count = len(grip.pads)
    draws = [random_stream(seed, RandomStream.GRIP, g) for g in range(grips)]
    header = np.array([rng.random(4) for rng in draws]).reshape(-1, 4)
    body = np.array([rng.random((count, 5)) for rng in draws]).reshape(-1, 5)
    spread = np.array([rng.standard_normal(count) for rng in draws]).reshape(-1, count)
    uv = part.wrapped(_pad_positions(grip, part, header).reshape(-1, 2))
    indenters = draw_indenters(touch, limits.radius_mm, body)
    reach = np.hypot(indenters["radius_mm"], indenters["length_mm"] / 2.0)
    shrink = _shrink(surface, uv, reach, count)
    share = np.array([pad.share for pad in grip.pads]) * np.exp(grip.scatter * spread)
    return Contacts(
        sample=np.repeat(np.arange(grips), count),
        uv=uv,
        force_N=(share / share.sum(axis=1, keepdims=True)).ravel(),
        samples=grips,
        **indenters | {name: shrink * indenters[name] for name in ("radius_mm", "length_mm")},
    )


def grip_section(scenario: Scenario) -> GripSection:
    """Table ``[grip]``, which the kind ``grips`` always has."""
    return scenario.grip or GripSection()


def _pad_positions(grip: GripSection, part: ChartWindow, header: FloatArray) -> FloatArray:
    """Chart positions (g, pads, 2), which may lie beyond the seam or the ends."""
    shares = np.array([[pad.along, pad.around] for pad in grip.pads])
    out = np.broadcast_to(shares, (len(header), *shares.shape)).copy()
    flipped = (header[:, 0] < 0.5) & (grip.flip == "any")
    out[flipped] = 1.0 - out[flipped]
    out[..., 0] += grip.shift * (2.0 * header[:, 1:2] - 1.0)
    out[..., 0] = np.clip(out[..., 0], 0.0, 1.0)
    span = part.surface.domain[1, 1] - part.surface.domain[1, 0]
    closed = part.surface.periodic[1] and part.size[1] >= (1.0 - 1e-9) * span
    if grip.turn == "any" and closed:
        out[..., 1] += header[:, 2:3]
    return np.asarray(part.low + out * part.size)


def _shrink(surface: Surface, uv: FloatArray, reach_mm: FloatArray, count: int) -> FloatArray:
    """Factor (m,) on the size of each pad, so that the ``count`` pads of a grip do not overlap."""
    gap = 0.98  # share of their distance that two neighbours take up after they shrank
    share_min = 0.2  # pads that would have to shrink below this share of their radius are rejected
    if count < 2:
        return np.ones(len(uv))
    at = surface.point(uv).reshape(-1, count, 3)
    reach = reach_mm.reshape(-1, count)
    apart = np.linalg.norm(at[:, :, None] - at[:, None], axis=3)
    apart += np.where(np.eye(count, dtype=np.bool_), np.inf, 0.0)
    fits = gap * apart / (reach[:, :, None] + reach[:, None])
    out = np.minimum(fits.min(axis=2), 1.0).ravel()
    worst = int(np.argmin(out))
    if out[worst] < share_min:
        raise DesignError(
            "grip-pads-no-room",
            f"the pads of a hand have no room on the {surface.name}: pad {worst % count} would "
            f"shrink to {out[worst]:.2f} of its radius; give [[grip.pads]] farther apart, or "
            "smaller touch.radius_max_mm",
        )
    return np.asarray(out)


def level_forces(
    scenario: Scenario, limits: ContactRanges, parts: FloatArray, *, seed: int, samples: int
) -> FloatArray:
    """Forces (samples, pads) in N of each level; parts (grips, pads) sum to 1.

    The sum is uniform in its range. No pad exceeds the largest force of a contact: what is beyond
    is taken over by the others.

    Raises
    ------
    DesignError
        If all pads at their largest do not reach the sum.
    """
    total_share = 0.98  # largest sum where none is given, over that of all pads at their largest
    grip = grip_section(scenario)
    count, most = parts.shape[1], limits.force_N[1]
    low = count * limits.force_N[0] if grip.total_min_N is None else grip.total_min_N
    high = total_share * count * most if grip.total_max_N is None else grip.total_max_N
    if high > count * most:
        raise DesignError(
            "grip-force-range",
            f"grip.total_max_N = {high:g} is more than {count} pads of {most:g} N can give; lower "
            "it, or raise touch.force_max_N",
        )
    if low > high:
        raise DesignError(
            "grip-force-range",
            f"grip.total_min_N = {low:g} exceeds the largest sum of {high:g} N; lower it",
        )
    draw = np.array([random_stream(seed, RandomStream.LEVEL, k).random() for k in range(samples)])
    total = low + (high - low) * draw
    return cap_forces(parts[np.arange(samples) // grip.levels], total, most)


def cap_forces(parts: FloatArray, total: FloatArray, most: float) -> FloatArray:
    """Forces in proportion to parts (s, p), none above ``most``, that sum to totals (s,)."""
    full = np.zeros(parts.shape, dtype=np.bool_)
    force = np.zeros(parts.shape)
    for _ in range(parts.shape[1]):
        left = total - most * full.sum(axis=1)
        free = np.where(full, 0.0, parts)
        force = np.where(full, most, free * (left / free.sum(axis=1).clip(1e-300))[:, None])
        over = force > most
        if not over.any():
            break
        full |= over
    return np.minimum(force, most)
