"""The indenters of a scenario: where they stand, how large they are, how strong they press.

They are drawn before any history: the force of each is the one it is pressed with.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import INDENTERS
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.scenario.contact_placement import (
    PlaceSampler,
    grid_numbers,
    jitter_of,
    place_sampler,
    places_at,
    pressed_receptors,
    traverse,
)
from phytac_design.simulation.scenario.random_streams import RandomStream, random_stream
from phytac_design.simulation.scenario.scenario_file import LENGTH_RADII, ContactsSection, Scenario
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class ContactRanges:
    """Ranges of a scenario on a design; a pair is (least, most)."""

    force_N: tuple[float, float]
    radius_mm: tuple[float, float]
    multi_share: float


def contact_ranges(design: Design, touch: ContactsSection) -> ContactRanges:
    """Ranges that the scenario gives, and the design's where it gives none.

    Raises
    ------
    DesignError
        If one end is given and does not go with the design's other end.
    """
    own = design.training

    def pick(given: float | None, default: float) -> float:
        return default if given is None else given

    force = (pick(touch.force_min_N, own.force_min_N), pick(touch.force_max_N, own.force_max_N))
    radius = (
        pick(touch.radius_min_mm, own.patch_radius_min_mm),
        pick(touch.radius_max_mm, own.patch_radius_max_mm),
    )
    if touch.patch == "switch":
        radius = (design.switch.footprint_diameter_mm / 2.0,) * 2
    for name, unit, (low, high) in (("force", "N", force), ("radius", "mm", radius)):
        if low > high:
            raise DesignError(
                "press-range-reversed",
                f"touch.{name}_min_{unit} = {low:g} exceeds touch.{name}_max_{unit} = {high:g} "
                "(one of them is the design's training table's); give both",
            )
    return ContactRanges(
        force_N=force, radius_mm=radius, multi_share=pick(touch.multi_share, own.multi_contact)
    )


def press_count(design: Design, scenario: Scenario) -> int:
    """Samples of kinds ``presses`` and ``grips``."""
    touch = scenario.touch
    if touch.samples is not None:
        return touch.samples
    if touch.at:
        return 1 + max(item.sample for item in touch.at)
    return design.training.samples


def given_contacts(
    surface: Surface, markers: Markers, touch: ContactsSection, samples: int
) -> Contacts:
    """Contacts of ``[[touch.at]]``, in the order of their samples."""
    items = tuple(sorted(touch.at or (), key=lambda item: item.sample))
    radius = np.array([item.radius_mm for item in items])
    length = [
        0.0 if item.indenter != "cylinder" else item.length_mm or LENGTH_RADII * item.radius_mm
        for item in items
    ]
    return Contacts(
        sample=np.array([item.sample for item in items], dtype=np.int64),
        uv=places_at(surface, markers, items),
        radius_mm=radius,
        force_N=np.array([item.force_N for item in items]),
        samples=samples,
        indenter=np.array([INDENTERS.index(item.indenter) for item in items], dtype=np.int64),
        length_mm=np.array(length),
        turn_rad=np.radians([item.turn_deg for item in items]),
        friction=np.array([item.friction for item in items]).reshape(-1, 2),
    )


def draw_presses(
    sensor: Sensor,
    scenario: Scenario,
    *,
    seed: int,
    samples: int,
    alone: bool = False,
    chunk: int = 4096,
) -> Contacts:
    """Draw the contacts of independent samples; a sample depends on the seed and its number only.

    Forces are uniform in their range, radii in theirs. Contacts of one sample keep apart by more
    than their patches and a footprint.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor as designed.
    scenario : Scenario
        Its table ``[touch]`` is used.
    seed : int
        Seed.
    samples : int
        How many.
    alone : bool
        One contact in every sample.
    chunk : int
        Samples drawn at once, to bound the memory.

    Raises
    ------
    DesignError
        If a sample's contacts find no room.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    touch, limits = scenario.touch, contact_ranges(design, scenario.touch)
    place = place_sampler(surface, markers, touch, limits.radius_mm[0])
    route = traverse(surface, markers, touch) if touch.placement == "columns" else None
    parts, fitting = [], list[list[list[int]]]()
    for first in range(0, samples, chunk):
        numbers = np.arange(first, min(first + chunk, samples))
        wanted = np.ones(len(numbers), dtype=np.int64)
        draw = _Draw(
            surface=surface,
            touch=touch,
            limits=limits,
            place=place,
            route=route,
            room_mm=design.switch.footprint_diameter_mm,
        )
        rngs = [random_stream(seed, RandomStream.PRESS, int(k)) for k in numbers]
        if not alone:
            wanted = _wanted(touch, limits.multi_share, numbers, seed, rngs)
        gripped = (wanted > 1) & bool(touch.grippers)
        parts.append(draw.fill(numbers, np.where(gripped, 0, wanted), rngs))
        if gripped.any():
            fitting = fitting or _fitting(draw, markers)
            rows = [_gripped(draw, fitting, int(k), rngs[k - first]) for k in numbers[gripped]]
            both = concatenate_contacts([parts.pop(), *rows], len(numbers))
            parts.append(both.take(np.argsort(both.sample, kind="stable")))
    return concatenate_contacts(parts, samples)


def _fitting(draw: "_Draw", markers: Markers) -> list[list[list[int]]]:
    """Receptors under the fingers of each gripper that fits anywhere, at each of those places.

    Raises
    ------
    DesignError
        If none of them fits anywhere.
    """
    touch, surface = draw.touch, draw.surface
    row, column = grid_numbers(markers)
    held = pressed_receptors(surface, markers, touch)
    known = {(int(row[k]), int(column[k])): int(k) for k in held}
    turn_of = int(column.max()) + 1 if surface.periodic[1] else markers.count
    at = surface.point(markers.uv)
    # Patches do not overlap.
    room = 2.0 * largest_reach_mm(touch, draw.limits)
    fitting: list[list[list[int]]] = []
    for gripper in touch.grippers:
        steps = gripper.fingers
        places = [[known.get((r + a, (c + b) % turn_of), -1) for a, b in steps] for r, c in known]
        fitting.append([each for each in places if min(each) >= 0 and _apart(at[each], room)])
    fitting = [places for places in fitting if places]
    if not fitting:
        fingers = [[list(each) for each in gripper.fingers] for gripper in touch.grippers]
        raise DesignError(
            "gripper-no-room",
            f"touch.grippers: none of them (got fingers {fingers}) fits on the {len(held)} "
            f"receptors that may be pressed, with {room:.3g} mm between fingers; bring them closer "
            "or farther apart, give more touch.columns, or lower touch.radius_max_mm",
        )
    return fitting


def _gripped(
    draw: "_Draw", fitting: list[list[list[int]]], number: int, rng: np.random.Generator
) -> Contacts:
    """Contacts of a sample that one of the grippers presses, wherever all its fingers fit."""
    places = fitting[int(rng.integers(len(fitting)))]
    receptor = np.array(places[int(rng.integers(len(places)))])
    draws = rng.random((len(receptor), draw.draws))
    return draw.candidates(np.full(len(receptor), number), receptor, draws)


def _apart(at: FloatArray, room_mm: float) -> bool:
    """Whether points (m, 3) are at least so far from each other."""
    gap = np.linalg.norm(at[:, None] - at, axis=2)
    return bool(gap[np.triu_indices(len(at), 1)].min() >= room_mm)


def _wanted(
    touch: ContactsSection,
    multi_share: float,
    numbers: IntArray,
    seed: int,
    rngs: Sequence[np.random.Generator],
) -> IntArray:
    """Contacts (s,) that each sample should have."""
    start = random_stream(seed, RandomStream.OFFSET, 0).random(2)
    multi = _evenly(numbers, (np.sqrt(5.0) - 1.0) / 2.0, start[0], multi_share)
    empty = _evenly(numbers, np.sqrt(2.0) - 1.0, start[1], touch.empty_share)
    many = np.array([rng.integers(2, touch.most + 1) for rng in rngs], dtype=np.int64)
    return np.where(empty, 0, np.where(multi, many, 1))


def _evenly(numbers: IntArray, step: float, start: float, share: float) -> BoolArray:
    """Samples (s,) that are among a share of all, by an irrational step: even over any run."""
    return np.asarray(np.mod(numbers * step + start, 1.0) < share)


def concatenate_contacts(parts: Sequence[Contacts], samples: int) -> Contacts:
    """Contacts of several sets, one after the other."""
    names = [name for name in vars(parts[0]) if name != "samples"]
    arrays = {name: np.concatenate([vars(part)[name] for part in parts]) for name in names}
    return Contacts(**arrays, samples=samples)


@dataclass(frozen=True, kw_only=True)
class _Draw:
    """What is the same for all samples while their contacts are drawn.

    How places are tried is part of what a seed stands for: ``tries`` for the contacts of one
    sample, ``first`` at once for every sample, then ``more`` at once for those that need more. A
    candidate takes ``draws`` random numbers: place (4), radius, force, kind, turn, friction (2).
    """

    surface: Surface
    touch: ContactsSection
    limits: ContactRanges
    place: PlaceSampler
    route: IntArray | None
    room_mm: float
    tries: int = 400
    first: int = 8
    more: int = 56
    draws: int = 10

    def fill(
        self, numbers: IntArray, wanted: IntArray, rngs: Sequence[np.random.Generator]
    ) -> Contacts:
        """Draw candidates for samples that lack contacts, and keep those that find room."""
        kept: list[Contacts] = []
        taken: list[list[tuple[FloatArray, float]]] = [[] for _ in numbers]
        lacking, tried = np.flatnonzero(wanted > 0), 0
        while len(lacking) and tried < self.tries:
            count = self.first if tried == 0 else self.more
            draws = np.concatenate([rngs[int(k)].random((count, self.draws)) for k in lacking])
            receptor = np.full((len(lacking), count), -1, dtype=np.int64)
            if tried == 0 and self.route is not None:
                receptor[:, 0] = self.route[numbers[lacking] % len(self.route)]
            sample = np.repeat(numbers[lacking], count)
            rows = self.candidates(sample, receptor.ravel(), draws)
            hit = np.asarray(np.isfinite(rows.uv).all(axis=1))
            at = self.surface.point(np.where(hit[:, None], rows.uv, self.surface.domain[:, 0]))
            size, chosen = reach_mm(rows), []
            for row in np.flatnonzero(hit):
                k = lacking[row // count]
                if len(taken[k]) < wanted[k] and self.apart(at[row], float(size[row]), taken[k]):
                    taken[k].append((at[row], float(size[row])))
                    chosen.append(row)
            kept.append(rows.take(np.array(chosen, dtype=np.int64)))
            lacking = np.array([k for k in lacking if len(taken[k]) < wanted[k]], dtype=np.int64)
            tried += count
        several = wanted > 1
        cramped = several & (np.array([len(own) for own in taken]) < 2)
        for k in lacking:
            # One contact is enough where others have room for several.
            enough = 2 if cramped[several].all() else 1
            self.reject_cramped(int(numbers[k]), len(taken[k]), min(int(wanted[k]), enough))
        if not kept:
            return self.candidates(*(np.zeros(0, dtype=np.int64),) * 2, np.zeros((0, self.draws)))
        whole = concatenate_contacts(kept, len(numbers))
        return whole.take(np.argsort(whole.sample, kind="stable"))

    def apart(self, at: FloatArray, size: float, taken: list[tuple[FloatArray, float]]) -> bool:
        """Whether a contact keeps off those that a sample has."""
        room = size + self.room_mm
        return all(np.linalg.norm(at - other) > room + own for other, own in taken)

    def reject_cramped(self, number: int, got: int, wanted: int) -> None:
        """Reject a sample with fewer contacts than it must have."""
        if got < wanted:
            what = "a contact" if got == 0 else "two contacts apart from each other"
            raise DesignError(
                "presses-no-room",
                f"sample {number}: no room for {what} in the touched part after {self.tries} "
                "tries; widen touch.along and touch.around, lower touch.radius_max_mm, or set "
                "touch.multi_share = 0",
            )

    def candidates(self, sample: IntArray, receptor: IntArray, draw: FloatArray) -> Contacts:
        """Contacts (m,) out of random numbers (m, draws); places that hit nothing are NaN."""
        low, high = self.limits.force_N
        return Contacts(
            sample=sample,
            uv=self.place(receptor, draw[:, :4]),
            force_N=low + (high - low) * draw[:, 5],
            samples=int(sample.max(initial=-1)) + 1,
            **draw_indenters(self.touch, self.limits.radius_mm, draw[:, [6, 4, 7, 8, 9]]),
        )


def draw_indenters(
    touch: ContactsSection, radius_mm: tuple[float, float], draw: FloatArray
) -> dict[str, Any]:
    """Fields ``radius_mm``, ``indenter``, ``length_mm``, ``turn_rad``, ``friction`` of contacts.

    Parameters
    ----------
    touch : ContactsSection
        Its indenters and friction are used.
    radius_mm : (low, high)
        Range of the radius, before the indenter's own factor.
    draw : (m, 5) float
        Random numbers in [0, 1): indenter, radius, turn, size and direction of friction.
    """
    kinds = touch.indenters
    until = np.cumsum([kind.share for kind in kinds])
    kind = np.searchsorted(until / until[-1], draw[:, 0], side="right")
    kind = np.minimum(kind, len(kinds) - 1)
    low, high = radius_mm
    radius = (low + (high - low) * draw[:, 1]) * np.array([k.radius_share for k in kinds])[kind]
    index = np.array([INDENTERS.index(item.kind) for item in kinds], dtype=np.int64)[kind]
    rod = index == INDENTERS.index("cylinder")
    given = np.array([np.nan if item.length_mm is None else item.length_mm for item in kinds])[kind]
    length = np.where(np.isnan(given), LENGTH_RADII * radius, given)
    fixed = np.array([np.nan if item.turn_deg is None else item.turn_deg for item in kinds])[kind]
    turn = np.where(np.isnan(fixed), np.pi * draw[:, 2], np.radians(fixed))
    slide = touch.friction_min + (touch.friction_max - touch.friction_min) * draw[:, 3]
    angle = 2.0 * np.pi * draw[:, 4]
    if touch.friction_deg is not None:
        angle = np.full(len(draw), np.radians(touch.friction_deg))
    return {
        "radius_mm": radius,
        "indenter": index,
        "length_mm": np.where(rod, length, 0.0),
        "turn_rad": np.where(rod, turn, 0.0),
        "friction": slide[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]),
    }


def reach_mm(touches: Contacts) -> FloatArray:
    """Distance from each centre to the farthest point of its patch, (c,) mm."""
    return np.asarray(np.hypot(touches.radius_mm, touches.length_mm / 2.0))


def largest_reach_mm(touch: ContactsSection, limits: ContactRanges) -> float:
    """Farthest that a drawn patch may reach from the place it is meant for, mm."""
    radius = limits.radius_mm[1]
    reach = 0.0
    for kind in touch.indenters:
        half = kind.radius_share * radius
        length = LENGTH_RADII * half if kind.length_mm is None else kind.length_mm
        reach = max(reach, float(np.hypot(half, length / 2.0)) if kind.kind == "cylinder" else half)
    if touch.placement in {"receptor", "columns"}:
        reach += np.sqrt(2.0) * jitter_of(touch, limits.radius_mm[0])
    return float(reach)
