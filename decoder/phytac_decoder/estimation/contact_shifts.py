"""Shift model: marker shifts of contacts, and their derivatives by the contacts' unknowns."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.mechanics.interaction_table import (
    InteractionCache,
    add_interactions,
    interaction_likeness,
)
from phytac_decoder.mechanics.membrane_stretching import lost_softness, order_factors
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray

UNKNOWNS = 8
"""Of a contact: force (N), centre along and around (mm), second moments xx, xy, yy (mm²), and
force along the surface over the normal force, along and around."""
SHEAR_START = 6
"""Index of the first unknown of force along the surface."""


@dataclass(kw_only=True)
class ContactState:
    """A contact being fitted.

    Attributes
    ----------
    place : int
        Nearest place of the tables.
    x : (8,) float
        Unknowns; the centre in the tangent plane about that place.
    start_mm : (3,) float
        Prior centre, by its switches.
    place_sd_mm : float
        Standard deviation of the prior centre.
    tables : (10, k, 2n) float32
        Derivatives of the tables at the place.
    shear : (10, 2, 2n) float32
        The same of shifts by force along the surface.
    markers : (m,) int
        Switches that it was started from.
    tentative : bool
        It is fitted with the others, so that they do not take its force, but not reported.
    """

    place: int
    x: FloatArray
    start_mm: FloatArray
    place_sd_mm: float
    tables: NDArray[np.float32]
    shear: NDArray[np.float32]
    markers: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    tentative: bool = False

    def copy(self) -> "ContactState":
        """Return a copy with unknowns of its own."""
        return replace(self, x=self.x.copy())


def predicted_shifts(
    places: ResponseTable, states: Sequence[ContactState], cache: InteractionCache | None = None
) -> list[tuple[FloatArray, FloatArray]]:
    """Return shifts (2n,) and slopes (8, 2n) of simultaneous contacts, one pair each.

    The effect of a contact on others, on its flat wall or by interactions, is part of its own
    slope; the shifts of an interaction are divided equally. See :func:`single_contact_shifts`.

    Parameters
    ----------
    cache : InteractionCache, optional
        Interactions at earlier places of the contacts.
    """
    out = {}
    wall = places.walls.wall[[state.place for state in states]] if places.walls else None
    for k, state in enumerate(states):
        if wall is None or wall[k] < 0:
            out[k] = single_contact_shifts(state, places.orders, top_N=places.top_N)
        elif k not in out:
            own = np.flatnonzero(wall == wall[k]).tolist()
            out |= dict(zip(own, _on_wall(places, [states[i] for i in own]), strict=True))
    parts = [out[k] for k in range(len(states))]
    if places.pairs is None or len(states) <= 1:
        return parts
    cache = cache or InteractionCache(pairs=places.pairs)
    points = np.stack([centre_of(places, state) for state in states])
    force = np.array([state.x[0] for state in states])
    own = [state.place for state in states]
    images = cache.between(points)
    likeness = interaction_likeness(images, places.shift_px[own, 1])
    linear = [_linear_px(state) for state in states]
    return add_interactions(images, likeness, force, places.softening[own], parts, linear)


def changed_by_others(
    places: ResponseTable, states: Sequence[ContactState], each_px: Sequence[FloatArray]
) -> FloatArray:
    """Return how far contacts change each other's shifts: (c,), over those of each alone.

    0 without a table of interactions, of whose higher orders this is a measure.

    Parameters
    ----------
    each_px : sequence of (2n,) float
        Their shifts together, by :func:`predicted_shifts`.
    """
    if len(states) < 2 or places.pairs is None:
        return np.zeros(len(states))
    alone = [single_contact_shifts(state, places.orders, top_N=places.top_N)[0] for state in states]
    change = np.linalg.norm(np.subtract(each_px, alone), axis=1)
    return np.asarray(change / np.maximum(np.linalg.norm(alone, axis=1), 1e-9))


def centre_of(places: ResponseTable, state: ContactState) -> FloatArray:
    """Return the centre (3,) mm of a contact."""
    x, y = state.x[1:3]
    along, around = places.along[state.place], places.around[state.place]
    return np.asarray(places.point_mm[state.place] + x * along + y * around)


def single_contact_shifts(
    state: ContactState, orders: int, *, top_N: float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Return shifts (2n,) px of a single contact, and their slopes (8, 2n) by its unknowns.

    Parameters
    ----------
    orders : int
        Powers of the force in its tables; further rows are ignored.
    top_N : float
        Largest tabulated force.
    """
    f, ratio = float(state.x[0]), state.x[SHEAR_START:].astype(np.float32)
    terms, tables = _terms(state), state.tables[:, :orders]
    rows = (terms[0] @ tables.reshape(10, -1)).reshape(orders, -1)
    shear = (terms[0] @ state.shear.reshape(10, -1)).reshape(2, -1)
    powers, change = order_factors(rows, f, top_N)
    slope = np.empty((UNKNOWNS, rows.shape[1]))
    # Of all orders at this force, and of the force along the surface.
    whole = np.einsum("k,ukn->un", (f * powers).astype(np.float32), tables)
    whole += np.einsum("k,ukn->un", np.float32(f) * ratio, state.shear)
    slope[:SHEAR_START] = terms @ whole
    total = slope[0].copy()
    slope[0] = ((1.0 + change) * powers).astype(np.float32) @ rows + ratio @ shear
    slope[SHEAR_START:] = f * shear
    return total, slope


def _linear_px(state: ContactState) -> FloatArray:
    """Return the linear shifts (2n,) of a contact by a newton."""
    weights = _terms(state)[0]
    ratio = state.x[SHEAR_START:].astype(np.float32)
    shear = ratio @ (weights @ state.shear.reshape(10, -1)).reshape(2, -1)
    return np.asarray(weights @ state.tables[:, 0] + shear)


def _on_wall(
    places: ResponseTable, states: Sequence[ContactState]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the same of contacts on one flat wall, which stiffen it for each other."""
    out = [single_contact_shifts(state, places.orders, top_N=places.top_N) for state in states]
    if len(states) == 1 or places.walls is None:
        return out
    near, weights = places.fits
    force = [float(state.x[0]) for state in states]
    stretch = []
    for f, state in zip(force, states, strict=True):
        cubic = places.walls.cubic(near[state.place], weights[state.place], state.place)
        one = np.tensordot(_terms(state), cubic, axes=1)
        # The slope by the force is per newton.
        one[1:] *= f
        stretch.append(one)
    order = np.arange(1, stretch[0].shape[1])
    most = places.walls.most
    whole = np.sum([f * one[0] for f, one in zip(force, stretch, strict=True)], axis=0)
    lost, by_all = _lost(whole, stretch, most)
    stiffer = np.zeros(places.shift_px.shape[2])
    for k, (f, state) in enumerate(zip(force, states, strict=True)):
        rows = _rows(state, state.tables[:, places.orders :])
        own, by_own = _lost(f * stretch[k][0], stretch[k : k + 1], most)
        total, slope = out[k]
        more = ((lost**order - own**order).astype(np.float32) @ rows).astype(np.float64)
        total += f * more[0]
        more[1:] *= f
        slope[:SHEAR_START] += more
        slope[:SHEAR_START] -= np.outer(by_own[0], f * (order * own ** (order - 1)) @ rows[0])
        stiffer += f * (order * lost ** (order - 1)) @ rows[0]
    for part, by in zip(out, by_all, strict=True):
        part[1][:SHEAR_START] += np.outer(by, stiffer)
    return out


def _lost(
    whole: FloatArray, stretch: Sequence[FloatArray], most: float
) -> tuple[float, list[FloatArray]]:
    """Return the share v of softness that a wall loses under slopes (k, r), and its derivatives.

    The derivatives (6,) are by the unknowns of contacts, of which the slopes have derivatives
    ``stretch`` (6, k, r).
    """
    lost, grows = lost_softness(whole, most)
    powers = lost ** np.arange(len(whole))
    now = powers @ whole
    return lost, [2.0 * grows * (np.einsum("k,ukr->ur", powers, one) @ now) for one in stretch]


def _rows(state: ContactState, tables: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return rows (6, k, 2n) of shifts and their slopes, by derivatives (10, k, 2n) of tables."""
    rows = _terms(state) @ tables.reshape(10, -1)
    return np.asarray(rows.reshape(SHEAR_START, *tables.shape[1:]))


def _terms(state: ContactState) -> NDArray[np.float32]:
    """Return weights (6, 10) of the tables' derivatives in shifts and their slopes.

    Rows: value, d/dx, d/dy, then those by the moments.
    """
    # Plain numbers are faster: this runs for each contact in each iteration.
    _, x, y, m_xx, m_xy, m_yy, _, _ = state.x.tolist()
    xx, xy, yy, hx, hy = x * x / 2.0, x * y, y * y / 2.0, x / 2.0, y / 2.0
    m_xx, m_yy = m_xx / 2.0, m_yy / 2.0
    a, b, c = xx + m_xx, xy + m_xy, yy + m_yy
    cubic = (
        x * (xx / 3.0 + m_xx),
        y * (xx + m_xx) + m_xy * x,
        x * (yy + m_yy) + m_xy * y,
        y * (yy / 3.0 + m_yy),
    )
    return np.array(
        [
            (1.0, x, y, a, b, c, *cubic),
            (0.0, 1.0, 0.0, x, y, 0.0, a, b, c, 0.0),
            (0.0, 0.0, 1.0, 0.0, x, y, 0.0, a, b, c),
            (0.0, 0.0, 0.0, 0.5, 0.0, 0.0, hx, hy, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, x, y, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, hx, hy),
        ],
        dtype=np.float32,
    )
