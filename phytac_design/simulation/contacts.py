"""Drawing contacts: patches on the surface with a force, and which switches they trip."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from phytac_design.datasets.samples import TouchRows
from phytac_design.layout import Markers
from phytac_design.layout.arc import by_area
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import Indentations
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.switch_law import switch_law
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

Placement = Literal["receptor", "anywhere"]
Inside = Callable[[FloatArray], BoolArray]
"""Which chart positions (m, 2) may be centres of contacts, (m,)."""


@dataclass(frozen=True, kw_only=True)
class Contacts(Indentations):
    """Contacts of many samples; arrays run over c contacts.

    Attributes
    ----------
    sample : (c,) int
        Sample each contact belongs to.
    samples : int
        Number of samples.
    """

    sample: IntArray
    samples: int

    @classmethod
    def flat(
        cls,
        *,
        sample: IntArray,
        uv: FloatArray,
        radius_mm: FloatArray,
        force_N: FloatArray,
        samples: int,
    ) -> "Contacts":
        """Contacts of even pressure without friction."""
        count = len(force_N)
        return cls(
            sample=sample,
            uv=uv,
            radius_mm=radius_mm,
            force_N=force_N,
            samples=samples,
            indenter=np.zeros(count, dtype=np.int64),
            length_mm=np.zeros(count),
            turn_rad=np.zeros(count),
            friction=np.zeros((count, 2)),
        )

    @property
    def counts(self) -> IntArray:
        """Contacts in each sample, (samples,)."""
        return np.bincount(self.sample, minlength=self.samples)

    def take(self, rows: IntArray) -> "Contacts":
        """Contacts ``rows``, which keep the numbers of their samples."""
        arrays = {name: array[rows] for name, array in vars(self).items() if name != "samples"}
        return Contacts(**arrays, samples=self.samples)

    def pick(self, rows: IntArray, samples: "list[int] | IntArray") -> "Contacts":
        """Contacts ``rows`` of the given samples, numbered from 0 in that order."""
        number = {int(sample): k for k, sample in enumerate(samples)}
        sample = np.array([number[int(s)] for s in self.sample[rows]], dtype=np.int64)
        return replace(self.take(rows), sample=sample, samples=len(number))

    def of(self, sample: int) -> "Contacts":
        """Contacts of one sample, as the only one."""
        return self.pick(np.flatnonzero(self.sample == sample), [sample])

    def table(self, surface: Surface) -> TouchRows:
        """The same as a part of a data set."""
        rows = {name: array for name, array in vars(self).items() if name != "samples"}
        return TouchRows(**rows, point_mm=surface.point(self.uv))


@dataclass(frozen=True, kw_only=True)
class Switching:
    """What the contacts do to the switches.

    Attributes
    ----------
    bits : (samples, n) bool
        Switches that are on: force on the footprint above the threshold.
    owner : (samples, n) int
        Contact (global index) that presses most on a switch that is on; -1 where off.
    receptor_force_N : (samples, n) float
        The truth per receptor: a contact's force is shared among the switches it tripped in
        proportion to their footprint forces, so that they sum to the contact's force.
    tripped : (c,) bool
        Contacts that tripped at least one switch.
    out : (samples, n) float, optional
        How far tips are out, as shares of the stroke, where some come out gradually.
    """

    bits: BoolArray
    owner: IntArray
    receptor_force_N: FloatArray
    tripped: BoolArray
    out: FloatArray | None = None

    @property
    def shown(self) -> BoolArray | FloatArray:
        """Tips (samples, n) that are out, or how far each is."""
        return self.bits if self.out is None else self.out

    @property
    def example(self) -> int:
        """The sample with the most switches on."""
        return int(np.argmax(self.bits.sum(axis=1)))


def rig_jitter_mm(radius_min_mm: float) -> float:
    """Distance within which a rig hits a receptor, along and around: 1 mm.

    At most a third of the smallest patch's radius, on small sensors.
    """
    return min(1.0, 1.0 / 3.0 * radius_min_mm)


def draw_contacts(
    sensor: Sensor,
    *,
    samples: int,
    rng: np.random.Generator,
    placement: Placement = "receptor",
    most: int = 5,
    inside: Inside | None = None,
) -> Contacts:
    """Draw samples of one contact, and (a share of them) of two to ``most`` at once.

    Forces are uniform in the design's range, radii in theirs. ``receptor`` presses on receptors
    within :func:`rig_jitter_mm`, as the paper's rig traverses them; ``anywhere`` is uniform over
    the area that senses. Centres lie within the open edges. Contacts of one sample keep apart by
    more than both radii and a footprint; where the sensor has no room for as many, a sample has
    fewer. Centres are where ``inside`` says, if that is given; where no receptor is, anywhere
    there.

    Raises
    ------
    DesignError
        If nothing that senses is inside.
    """
    tries = 400
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    training = design.training
    jitter = rig_jitter_mm(training.patch_radius_min_mm)
    places = _places(surface, markers, placement, rng, jitter, inside)
    rows: list[tuple[int, float, float, float, float]] = []
    for sample in range(samples):
        multi = rng.random() < training.multi_contact and most > 1
        wanted = int(rng.integers(2, most + 1)) if multi else 1
        placed: list[tuple[FloatArray, float]] = []
        for _ in range(tries):
            if len(placed) == wanted:
                break
            uv, point = next(places)
            radius = rng.uniform(training.patch_radius_min_mm, training.patch_radius_max_mm)
            room = radius + design.switch.footprint_diameter_mm
            if all(np.linalg.norm(point - other) > room + size for other, size in placed):
                placed.append((point, radius))
                force = rng.uniform(training.force_min_N, training.force_max_N)
                rows.append((sample, float(uv[0]), float(uv[1]), radius, force))
    table = np.array(rows)
    return Contacts.flat(
        sample=table[:, 0].astype(np.int64),
        uv=table[:, 1:3],
        radius_mm=table[:, 3],
        force_N=table[:, 4],
        samples=samples,
    )


def _places(
    surface: Surface,
    markers: Markers,
    placement: Placement,
    rng: np.random.Generator,
    jitter_mm: float,
    inside: Inside | None = None,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Chart coordinates (2,) and points (3,) of one random place after the other."""
    # Places drawn at once: charts are cheaper by the thousand than one by one.
    places_per_draw = 2048
    empty_draws_max = 50  # draws without a single place that end the search
    held = np.arange(markers.count)
    if inside is not None:
        held = np.flatnonzero(inside(markers.uv))
    empty = 0
    while True:
        if placement == "anywhere" or len(held) == 0:
            uv = by_area(surface, rng.random((places_per_draw, 2)))
            uv = uv[surface.sensing(uv)]
        else:
            ids = held[rng.integers(len(held), size=places_per_draw)]
            uv = _near_markers(surface, markers, ids, rng, jitter_mm)
        if inside is not None:
            uv = uv[inside(uv)]
        empty = 0 if len(uv) else empty + 1
        if empty == empty_draws_max:
            raise DesignError(
                "no-contact-drawn",
                "no contact can be drawn: none of the "
                f"{empty_draws_max * places_per_draw} places drawn lies in the "
                "given regions; widen along and around",
            )
        yield from zip(uv, surface.point(uv), strict=True)


def _near_markers(
    surface: Surface, markers: Markers, ids: IntArray, rng: np.random.Generator, jitter_mm: float
) -> FloatArray:
    """Places (m, 2) within ``jitter_mm`` of markers (m,), along and around, within open edges."""
    step = rng.uniform(-jitter_mm, jitter_mm, size=(len(ids), 2))
    return tangent_step(surface, markers.uv[ids], step)


def tangent_step(surface: Surface, uv: FloatArray, step_mm: FloatArray) -> FloatArray:
    """Chart positions at steps (m, 2) along and around from ``uv`` (m, 2), within open edges.

    Steps are taken in the tangent plane and brought back to the surface, so that they are as
    long at a pole as anywhere.
    """
    along = surface.tangents(uv)[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = step_mm[:, :1] * along + step_mm[:, 1:] * np.cross(surface.normal(uv), along)
    moved = surface.chart(surface.point(uv) + aside)
    low, high = surface.domain.T
    inside = np.clip(moved, low, high)
    return np.where(np.array(surface.periodic), moved, inside)


def switch_states(sensor: Sensor, contacts: Contacts) -> Switching:
    """Apply the activation law: a switch is on when its footprint carries over its threshold."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    radius = design.switch.footprint_diameter_mm / 2.0
    share = footprint_shares(surface, contacts, markers.uv, radius)
    total = np.zeros((contacts.samples, markers.count))
    np.add.at(total, contacts.sample, share * contacts.force_N[:, None])
    law = switch_law(design, markers)
    state = total > law.on_N
    out = law.out_share(total, state, law.on_N) if law.gradual.any() else None
    return replace(assign_forces(contacts, share, state), out=out)


def assign_forces(contacts: Contacts, share: FloatArray, bits: BoolArray) -> Switching:
    """Who presses the switches that are on, and the truth per receptor.

    Parameters
    ----------
    contacts : Contacts
        c contacts.
    share : (c, n) float
        Share of each contact's force on each footprint.
    bits : (samples, n) bool
        Switches that are on.
    """
    carried = share * contacts.force_N[:, None]
    owner = np.full(bits.shape, -1, dtype=np.int64)
    most = np.zeros(bits.shape)
    for index, sample in enumerate(contacts.sample):
        better = bits[sample] & (carried[index] > most[sample])
        owner[sample, better] = index
        most[sample, better] = carried[index, better]
    mine = owner[contacts.sample] == np.arange(len(contacts.sample))[:, None]
    tripped = mine.any(axis=1)
    # Contacts that overlap share the switches they trip together.
    weight = np.where(bits[contacts.sample], carried, 0.0)
    norm = weight.sum(axis=1, keepdims=True)
    parts = contacts.force_N[:, None] * weight / np.where(norm > 0.0, norm, 1.0)
    truth = np.zeros(bits.shape)
    np.add.at(truth, contacts.sample, parts)
    return Switching(bits=bits, owner=owner, receptor_force_N=truth, tripped=tripped)
