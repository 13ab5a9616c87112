"""The most likely contacts behind marker shifts, given their number: Gauss-Newton on tables.

A marker that is far off says more about itself than about forces: a neighbour hides its paint, or
something shines beside it. Once a fit stands, its part of the sum of squares grows with the
logarithm alone, as in a distribution whose tails are a power (Huber 1981, ch. 7): it is weighted
anew in each round.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_shifts import UNKNOWNS, ContactState, predicted_shifts
from phytac_decoder.mechanics.interaction_table import InteractionCache
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

ROUNDS = 8
STILL = 2e-3
"""Change of every force, relative, and of every centre, in cm, below which a fit ends."""
STEP_MM, STEP_MM2 = 2.0, 4.0
"""Longest steps of centre and moments in a round: what the cubic between places stands for."""
FIRM = 3
"""Rounds in which all markers count, so that a fit that starts badly does not doubt them."""
ASTRAY = 2.5
"""How far off a marker may be before it is doubted, over what is usual in the frame."""
OFF_SPACINGS = 0.85
"""A contact is within this many spacings of a place; half a diagonal of a square grid is 0.71."""
FORCE_LEAST_N = 0.02
FORCE_SD_N = 1e3
"""Of a force nothing is known beforehand."""


@dataclass(frozen=True, kw_only=True)
class ContactPrior:
    """What is known of a contact before shifts are looked at.

    Attributes
    ----------
    place_mm : float
        Standard deviation, along and around, of its centre about the switches that it tripped.
    moments_mm2 : (3,) float
        Means of its second moments xx, xy, yy, less those of the tables' disc.
    moments_sd_mm2 : (3,) float
        Their standard deviations.
    """

    place_mm: float
    moments_mm2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moments_sd_mm2: tuple[float, float, float] = (3.0, 2.0, 3.0)


@dataclass(frozen=True, kw_only=True)
class ShiftNoise:
    """How far measured shifts are from those of the tables; standard deviations.

    Attributes
    ----------
    centroid_px : float
        Of a coordinate, as a rule.
    share : float
        Of the explained shift besides: the tables are not exact.
    switched_px : float
        Of receptors whose red tip is out besides: how much paint it covers changes with the load.
    ratio : (2n,) float, optional
        Of each coordinate (x0, y0, x1, …), over ``centroid_px``; 1 if not given.
    """

    centroid_px: float
    share: float = 0.02
    switched_px: float = 0.5
    ratio: FloatArray | None = None

    @property
    def each_px(self) -> FloatArray | float:
        """Of each coordinate, (2n,) or one for all."""
        return self.centroid_px if self.ratio is None else self.centroid_px * self.ratio


@dataclass(frozen=True, kw_only=True)
class ShiftObservation:
    """Shifts of one frame.

    Attributes
    ----------
    shift_px : (2n,) float
        As (x0, y0, x1, y1, …); 0 where a marker was not found.
    found : (2n,) bool
        Where it was.
    koi : (m,) int
        Markers whose switch is on.
    """

    shift_px: FloatArray
    found: BoolArray
    koi: IntArray


@dataclass(frozen=True, kw_only=True)
class ContactFit:
    """Fitted contacts.

    Attributes
    ----------
    states : list of State
        The contacts.
    explained : (2n,) float
        Their shifts, px.
    inverse : (2n,) float
        Weights: the inverse of each shift's variance, less where a marker is doubted, 0 where it
        was not found.
    covariance : (6c, 6c) float
        Of all unknowns.
    cost : float
        Weighted sum of squares of what is left, in which doubted markers count for the logarithm
        of theirs, and of how far all is from what was presumed.
    misfit : float
        The first part per number: 1 where noise is as expected.
    """

    states: list[ContactState]
    explained: FloatArray
    inverse: FloatArray
    covariance: FloatArray
    cost: float
    misfit: float


def contact_signal_px(state: ContactState) -> float:
    """Shift of all markers together by the first newton, px."""
    t = np.zeros(10)
    x, y = state.x[1:3]
    t[:6] = (1.0, x, y, x * x / 2.0, x * y, y * y / 2.0)
    return float(np.linalg.norm(t.astype(np.float32) @ state.tables[:, 0]))


def initial_state(
    places: ResponseTable,
    prior: ContactPrior,
    point_mm: FloatArray,
    force_N: float,
    *,
    markers: IntArray | None = None,
    place_sd_mm: float | None = None,
) -> ContactState:
    """A contact to begin with."""
    place = int(places.nearest(point_mm[None])[0])
    xy = places.beside([place], point_mm[None])[0]
    return ContactState(
        place=place,
        x=np.array([force_N, *xy, *prior.moments_mm2]),
        start_mm=point_mm,
        place_sd_mm=place_sd_mm or prior.place_mm,
        tables=places.cubic(place),
        markers=np.zeros(0, dtype=np.int64) if markers is None else markers,
    )


def fit_contacts(
    places: ResponseTable,
    states: list[ContactState],
    seen: ShiftObservation,
    *,
    prior: ContactPrior,
    noise: ShiftNoise,
    firm: int = FIRM,
    rounds: int = ROUNDS,
) -> ContactFit:
    """Move contacts to where they are most likely; changes ``states``.

    All markers count in the first ``firm`` rounds; none need if the contacts begin where they were
    a frame ago.
    """
    weight = np.concatenate(
        [
            np.array([FORCE_SD_N, s.place_sd_mm, s.place_sd_mm, *prior.moments_sd_mm2]) ** -2.0
            for s in states
        ]
    )
    switched = np.concatenate([2 * seen.koi, 2 * seen.koi + 1])
    images = InteractionCache(pairs=places.pairs) if places.pairs else None
    moved, doubting = np.inf, False
    for number in range(rounds + 1):
        parts = predicted_shifts(places, states, images)
        total = np.sum([part[0] for part in parts], axis=0)
        slope = np.concatenate([part[1] for part in parts])
        spread = noise.each_px**2 + (noise.share * total) ** 2
        spread[switched] += noise.switched_px**2
        inverse = np.where(seen.found, 1.0 / spread, 0.0)
        left = seen.shift_px - total
        off = _off(places, states, prior)
        square, settled = float(left @ (inverse * left)), False
        if doubting or number >= firm or moved < STILL:
            square, share = robust_cost(left, inverse)
            inverse = inverse * share
            settled = moved < STILL and (doubting or bool((share == 1.0).all()))
            doubting = True
        hessian = (slope * inverse) @ slope.T + np.diag(weight)
        # Ends where all has been looked at that is told.
        if settled or number == rounds:
            break
        step = np.linalg.solve(hessian, slope @ (inverse * left) - weight * off)
        moved = _moved(places, states, step)
    return ContactFit(
        states=states,
        explained=total,
        inverse=inverse,
        covariance=np.linalg.inv(hessian),
        cost=square + float(off @ (weight * off)),
        misfit=square / max(int(seen.found.sum()) - len(weight), 1),
    )


def fit_without_contacts(seen: ShiftObservation, noise: ShiftNoise) -> ContactFit:
    """The fit of no contact at all."""
    inverse = np.where(seen.found, 1.0 / np.square(noise.each_px), 0.0)
    return ContactFit(
        states=[],
        explained=np.zeros(len(seen.shift_px)),
        inverse=inverse,
        covariance=np.zeros((0, 0)),
        cost=robust_cost(seen.shift_px, inverse)[0],
        misfit=float(inverse @ seen.shift_px**2) / max(int(seen.found.sum()), 1),
    )


def robust_cost(left: FloatArray, inverse: FloatArray) -> tuple[float, FloatArray]:
    """Sum of squares in which markers far off count for less, and the share (2n,) that they keep.

    Parameters
    ----------
    left : (2n,) float
        What is not explained, px.
    inverse : (2n,) float
        Inverse variances; 0 for a marker that was not found.
    """
    square = (inverse * left**2).reshape(-1, 2).sum(axis=1)
    usual = float(np.median(square[inverse[::2] > 0.0])) if np.any(inverse) else 0.0
    # Of two coordinates.
    limit = ASTRAY**2 * max(usual, 2.0)
    over = np.maximum(square / limit, 1.0)
    total = float(np.sum(np.minimum(square, limit) + limit * np.log(over)))
    return total, np.repeat(1.0 / over, 2)


def _off(places: ResponseTable, states: Sequence[ContactState], prior: ContactPrior) -> FloatArray:
    """How far contacts are from what is known beforehand, (6c,)."""
    x = np.array([state.x for state in states])
    starts = np.array([state.start_mm for state in states])
    off = np.zeros_like(x)
    off[:, 1:3] = x[:, 1:3] - places.beside([state.place for state in states], starts)
    off[:, 3:] = x[:, 3:] - np.array(prior.moments_mm2)
    return off.reshape(-1)


_LONGEST = np.array([np.inf, STEP_MM, STEP_MM, STEP_MM2, STEP_MM2, STEP_MM2])


def _moved(places: ResponseTable, states: Sequence[ContactState], step: FloatArray) -> float:
    """Take a step, bounded; its size, see :data:`STILL`."""
    old = np.array([state.x for state in states])
    new = old + np.clip(step.reshape(-1, UNKNOWNS), -_LONGEST, _LONGEST)
    force = old[:, 0]
    least = np.maximum(0.3 * force, FORCE_LEAST_N)
    new[:, 0] = np.minimum(np.maximum(new[:, 0], least), 3.0 * force + 1.0)
    aside = np.abs(new[:, 1:3] - old[:, 1:3]).max(axis=1) / 10.0
    more = np.abs(new[:, 0] - force) / np.maximum(force, 0.5)
    own = [state.place for state in states]
    points = places.point_mm[own] + new[:, 1:2] * places.along[own]
    points += new[:, 2:3] * places.around[own]
    nearest = places.nearest(points)
    for state, place, point, x in zip(states, nearest.tolist(), points, new, strict=True):
        if place != state.place:
            state.place, state.tables = place, places.cubic(place)
            x[1:3] = places.beside([place], point[None])[0]
        # Every place of the surface is nearer to the tables: beyond a rim there is none.
        far = float(np.hypot(*x[1:3])) / (OFF_SPACINGS * places.spacing_mm)
        if far > 1.0:
            x[1:3] /= far
        state.x = x
    return float(max(aside.max(), more.max()))
