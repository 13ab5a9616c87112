"""Contacts whose force depends on a poorly known place: mean and covariance over the places.

Beside a rim the wall is stiff, and a strong contact near the rim moves the markers almost as a
weak one farther away does. The force then grows by the same factor for each millimetre, and the
covariance at the best place alone is neither wide enough nor symmetric. The posterior is therefore
integrated numerically over the one direction in which place and force are confused, with a normal
distribution of all other unknowns at each node (nested Laplace approximation; Rue, Martino and
Chopin 2009). The contact and its neighbours are fitted at each node; all else follows as the linear
theory of the whole fit has it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist

import numpy as np

from phytac_decoder.estimation import contact_fit
from phytac_decoder.estimation.contact_fit import (
    ContactFit,
    ContactPrior,
    ShiftNoise,
    ShiftObservation,
    inverse_variance,
    prior_cost,
    prior_residual,
    prior_weight,
    robust_cost,
    take_step,
)
from phytac_decoder.estimation.contact_shifts import (
    SHEAR_START,
    UNKNOWNS,
    ContactState,
    centre_of,
    predicted_shifts,
)
from phytac_decoder.mechanics.interaction_table import InteractionCache
from phytac_decoder.mechanics.response_table import ResponseTable, axes_turn
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class AverageSettings:
    """Settings of the integration."""

    force_share: float = 0.08
    """Relative standard deviation of a force by its place, from which places are averaged."""
    log_switches_min: float = -4.0
    """Logarithm of how likely the switches are, below which places are averaged."""
    step_max_mm: float = 4.0
    """Longest distance of nodes; one standard deviation of the place if that is shorter."""
    steps_max: int = 6
    """Largest number of nodes on either side of the best place."""
    steps: int = 4
    """Number of them that are computed at first."""
    cost_max: float = 9.0
    """Growth of the cost, in units of its scale, at which the density has vanished."""
    iterations: int = 2
    """Iterations at a node; they start where a normal distribution has its mean. With a third,
    forces change by 0.03 standard deviations at most on a film of cylinder60."""
    step_tolerance: float = 0.05
    """Size of a step, see ``FitSettings.step_tolerance``, after which none follows: the error that
    remains is about its square."""
    held_mm: float = 1e-4
    """Standard deviation of a centre that is held."""
    coupling_min: float = 0.1
    """Correlation of a contact's unknowns with those of another, from which that one is fitted
    with it at every node; others follow by linear theory. From 0.3, standard deviations are 7 %
    larger on a sensor whose contacts interact."""
    usual_freedom: float = 8.0
    """Degrees of freedom with which the noise of a contact's own markers is known before the frame,
    by that of the whole frame; each of these markers adds one. It is the most likely value of 700
    contacts in disturbed frames of ``handle`` (seed 7): 4 and 20 are e² and e¹·⁵ times less so."""
    untaken_min: float = 0.3
    """Share of a residual that a contact's own unknowns leave, at least."""


SETTINGS = AverageSettings()
INTERVAL_SDS = 1.96
"""Half the width of a 95 % interval, in standard deviations."""
FINE = 8
"""Places between nodes at which quantiles are computed."""
_NORMAL = np.array([NormalDist().inv_cdf((k + 0.5) / 40) for k in range(40)])
"""Values of a normal distribution of equal probability."""


_Start = tuple[float, list[ContactState]]
"""A distance, and the contacts of a line there."""


@dataclass(frozen=True, kw_only=True)
class _OwnNoise:
    """Noise of the markers that determine one force.

    Attributes
    ----------
    scale : float
        Factor on the covariance of the fit.
    freedom : float
        Degrees of freedom with which that is known.
    """

    scale: float
    freedom: float

    @property
    def spread(self) -> float:
        """Factor on the covariance, where the scale is not known better."""
        return self.scale * self.freedom / (self.freedom - 2.0)

    def cost(self, growth: FloatArray) -> FloatArray:
        """Return minus twice the logarithm of the density where squares have grown by so much.

        By Student's distribution: far off it falls more slowly than a normal one.
        """
        far = np.maximum(growth, 0.0) / self.scale
        near = np.minimum(growth, 0.0) / self.scale
        return np.asarray((self.freedom + 1.0) * np.log1p(far / self.freedom) + near)


@dataclass(frozen=True, kw_only=True)
class _Line:
    """Places of one contact, and what else there is.

    Attributes
    ----------
    states : list of ContactState
        The c contacts that are fitted at each node, as they were fitted.
    number : int
        Of the contact, among these.
    held : (3,) float
        Direction in which its centre is moved, and held.
    drift : (8c,) float
        Change of their unknowns per mm, by their covariance.
    others : list of ContactState
        All other contacts.
    besides_px : (2n,) float
        What these do.
    slope, weighted : (m, 2n) float
        Derivatives by all other unknowns of the fit, and the same times the weight of each shift.
    covariance : (m, m) float
        Covariance of these where the c contacts are held.
    noise : _OwnNoise
        That of the contact's own markers.
    """

    states: list[ContactState]
    number: int
    held: FloatArray
    drift: FloatArray
    others: list[ContactState]
    besides_px: FloatArray
    slope: FloatArray
    weighted: FloatArray
    covariance: FloatArray
    noise: _OwnNoise


@dataclass(frozen=True, kw_only=True)
class _Node:
    """A contact whose centre is held, at a distance from its best place."""

    distance_mm: float
    state: ContactState
    states: list[ContactState]
    covariance: FloatArray
    cost: float
    log_volume: float


@dataclass(frozen=True, kw_only=True)
class PlaceAverage:
    """Averages contacts of a fit over the places where each may be.

    Attributes
    ----------
    places, prior, noise, seen
        Those of the fit.
    fit : ContactFit
        The fit.
    scale : float
        Factor on its covariance: 1 where residuals are as noise explains.
    log_switches : callable
        Logarithms (c,) of how likely it is that switches read as they do, under each of contacts.
    """

    places: ResponseTable
    prior: ContactPrior
    noise: ShiftNoise
    seen: ShiftObservation
    fit: ContactFit
    scale: float
    log_switches: Callable[[Sequence[ContactState]], FloatArray]

    def contact(self, number: int) -> tuple[ContactState, FloatArray]:
        """Return a contact's mean state, with its median force, and covariance (8, 8).

        Where its place hardly matters for its force, and agrees with the switches, they are those
        of the fit.
        """
        state, own = self.fit.states[number], slice(UNKNOWNS * number, UNKNOWNS * (number + 1))
        own_noise = self._own_noise(number)
        covariance = own_noise.spread * self.fit.covariance[own, own]
        direction, sd_mm, by_place_N = _confusion(covariance)
        sure = by_place_N < SETTINGS.force_share * state.x[0]
        if not sure or self._log_switches[number] < SETTINGS.log_switches_min:
            line = self._line(number, direction, own_noise)
            nodes = self._nodes_along(line, min(sd_mm, SETTINGS.step_max_mm))
            if len(nodes) > 1:
                return self._moments(nodes, own_noise.spread)
        # The logarithm of a force is what is determined: intervals reach farther upwards.
        share = min(float(np.sqrt(covariance[0, 0])) / state.x[0], 1.0)
        return state, _widened(covariance, np.expm1(share) / share)

    @cached_property
    def _log_switches(self) -> FloatArray:
        """Those of the contacts (c,) as they were fitted."""
        return self.log_switches(self.fit.states)

    def _own_noise(self, number: int) -> _OwnNoise:
        """Return the noise of the markers that determine a contact's force.

        A picture is not equally wrong everywhere: the markers beside a contact move and turn most,
        and there blur, compression and a neighbour's paint matter most. Their residuals count as
        they do in the force, and the noise of the whole frame is what was known beforehand, so that
        the force has Student's distribution.
        """
        fit, first = self.fit, UNKNOWNS * number
        part = slice(first, first + UNKNOWNS)
        slope, covariance = fit.slope[part], fit.covariance[part, part]
        share = (fit.joint_covariance[first] @ fit.slope) ** 2 * fit.inverse
        if not share.any():  # No marker that was found says anything of this force.
            return _OwnNoise(scale=self.scale, freedom=SETTINGS.usual_freedom)
        share /= share.sum()
        taken = fit.inverse * np.einsum("un,un->n", slope, covariance @ slope)
        square = fit.inverse * (self.seen.shift_px - fit.predicted_px) ** 2
        square /= np.maximum(1.0 - taken, SETTINGS.untaken_min)
        own = (self.noise.alike * self.seen.noise_scale) ** 2 * float(share @ square)
        # What moves one coordinate of a marker moves the other as well.
        each = share[::2] + share[1::2]
        count, usual = 1.0 / float(each @ each), SETTINGS.usual_freedom
        freedom = usual + count
        scale = max((usual * self.scale + count * own) / freedom, self.scale)
        return _OwnNoise(scale=scale, freedom=freedom)

    def _line(self, number: int, direction: FloatArray, noise: _OwnNoise) -> _Line:
        """Return the line of places of a contact in a direction (2,) along and around."""
        places, fit = self.places, self.fit
        coupled = self._coupled(number)
        own = (UNKNOWNS * np.array(coupled)[:, None] + np.arange(UNKNOWNS)).ravel()
        states = [fit.states[k] for k in coupled]
        place = UNKNOWNS * number + np.arange(1, 3)
        drift = fit.joint_covariance[:, place] @ direction
        drift = drift[own] / (drift[place] @ direction)
        slope = np.delete(fit.slope, own, axis=0)
        pressed_px = np.sum([part for part, _ in predicted_shifts(places, states)], axis=0)
        return _Line(
            states=states,
            number=coupled.index(number),
            held=direction @ places.axes[fit.states[number].place],
            drift=drift,
            others=[state for k, state in enumerate(fit.states) if k not in coupled],
            besides_px=self.fit.pressed_px - pressed_px,
            slope=slope,
            weighted=slope * fit.inverse,
            covariance=_given(fit.joint_covariance, own),
            noise=noise,
        )

    def _coupled(self, number: int) -> list[int]:
        """Return a contact and those that its unknowns depend on."""
        count = len(self.fit.states)
        sd = np.sqrt(self.fit.covariance.diagonal())
        both = np.abs(self.fit.covariance / np.outer(sd, sd)).reshape(count, UNKNOWNS, count, -1)
        coupled = both[number].max(axis=(0, 2)) >= SETTINGS.coupling_min
        if self.places.walls:  # All contacts on a flat wall stretch it together.
            wall = self.places.walls.wall[[state.place for state in self.fit.states]]
            coupled |= (wall == wall[number]) & (wall >= 0)
        return np.flatnonzero(coupled).tolist()

    def _nodes_along(self, line: _Line, step_mm: float) -> list[_Node]:
        """Return nodes to both sides of the best place, to where surface or density end."""
        first, steps = (0.0, line.states), (-step_mm, step_mm)
        near = [list(self._walk(line, first, step, SETTINGS.steps)) for step in steps]
        middle, *nodes = self._nodes(line, [first, *near[0], *near[1]])
        out = []
        for step, side in zip(steps, near, strict=True):
            found, nodes = nodes[: len(side)], nodes[len(side) :]
            kept = _to_end([middle, *found])
            if len(kept) == 1 + SETTINGS.steps:
                count = SETTINGS.steps_max - SETTINGS.steps
                start = (kept[-1].distance_mm, kept[-1].states)
                more = list(self._walk(line, start, step, count))
                kept = _to_end([*kept, *self._nodes(line, more)]) if more else kept
            out.append(kept[1:])
        return [*out[0][::-1], middle, *out[1]]

    def _walk(self, line: _Line, start: _Start, step_mm: float, count: int) -> Iterator[_Start]:
        """Yield distances, and where a normal distribution has its mean, on from a start."""
        distance_mm, states = start
        drift = step_mm * line.drift.reshape(-1, UNKNOWNS)
        drift[line.number, 1:3] = 0.0
        # The force grows by the same factor for each millimetre.
        share = np.array([state.x[0] for state in line.states])
        drift[:, 0] = np.expm1(np.clip(drift[:, 0] / share, -3.0, 3.0))
        for _ in range(count):
            moved = self._moved(states[line.number], step_mm, line.held)
            if moved is None:
                return
            states = [state.copy() for state in states]
            states[line.number] = moved
            change = drift.copy()
            change[:, 0] *= [state.x[0] for state in states]
            take_step(self.places, states, change.ravel())
            distance_mm += step_mm
            yield distance_mm, states

    def _moved(self, state: ContactState, step_mm: float, held: FloatArray) -> ContactState | None:
        """Return a contact moved by a step; None beyond the end of the surface."""
        places = self.places
        x, y = places.axes[state.place] @ held
        size = float(np.hypot(x, y))
        step = step_mm / size * (x * places.along[state.place] + y * places.around[state.place])
        point = centre_of(places, state) + step
        own = int(places.nearest(point[None])[0])
        xy = places.tangent_coordinates([own], point[None])[0]
        if np.hypot(*xy) > contact_fit.SETTINGS.place_distance_max * places.spacing_mm:
            return None
        return _at(places, replace(state, x=_about(places, state, own, point)), own)

    def _nodes(self, line: _Line, starts: Sequence[_Start]) -> list[_Node]:
        """Fit a contact whose centre is held, at several places at once."""
        places, fit, size = self.places, self.fit, UNKNOWNS * len(line.states)
        nodes = [[state.copy() for state in states] for _, states in starts]
        flat = [state for states in nodes for state in states]
        caches = [InteractionCache(pairs=places.pairs) if places.pairs else None for _ in nodes]
        own = slice(UNKNOWNS * line.number, UNKNOWNS * (line.number + 1))
        centre = slice(own.start + 1, own.start + 3)
        change = np.inf
        for number in range(SETTINGS.iterations + 1):
            parts = [
                predicted_shifts(places, states, cache)
                for states, cache in zip(nodes, caches, strict=True)
            ]
            pressed_px = np.stack([sum(each for each, _ in part) for part in parts])
            pressed_px += line.besides_px
            slope = np.stack([each for part in parts for _, each in part])
            slope = slope.reshape(len(nodes), size, -1)
            change_px, weighted = pressed_px - self.fit.pressed_px, slope * fit.inverse
            # Of the other unknowns: their slopes along these contacts', and where they go.
            along, steps = weighted @ line.slope.T, -change_px @ line.weighted.T @ line.covariance
            off = prior_residual(places, flat, self.prior)
            weight = prior_weight(flat, off, self.prior)
            held = [states[line.number].place for states in nodes]
            across = places.axes[held] @ line.held / SETTINGS.held_mm
            hessian = weighted @ slope.swapaxes(1, 2)
            hessian -= along @ line.covariance @ along.swapaxes(1, 2)
            hessian[:, range(size), range(size)] += weight.reshape(-1, size)
            hessian[:, centre, centre] += across[:, :, None] * across[:, None]
            if number == SETTINGS.iterations or change < SETTINGS.step_tolerance:
                break
            residual_px = self.seen.shift_px - fit.predicted_px - change_px
            gradient = (weighted @ residual_px[:, :, None] - along @ steps[:, :, None]).ravel()
            gradient -= weight * off
            step = np.linalg.solve(hessian, gradient.reshape(-1, size, 1))
            change = take_step(places, flat, np.asarray(step.ravel(), dtype=np.float64))
        covariance = np.asarray(np.linalg.inv(hessian), dtype=np.float64)
        cost = self._cost(line, pressed_px, steps)
        cost += prior_cost(flat, off, self.prior).reshape(len(nodes), -1).sum(axis=1)
        cost -= 2.0 * self.log_switches([states[line.number] for states in nodes])
        volume = 0.5 * np.linalg.slogdet(covariance)[1]
        return [
            _Node(
                distance_mm=starts[k][0],
                states=states,
                state=states[line.number],
                covariance=covariance[k, own, own],
                cost=float(cost[k]),
                log_volume=float(volume[k]),
            )
            for k, states in enumerate(nodes)
        ]

    def _cost(self, line: _Line, pressed_px: FloatArray, steps: FloatArray) -> FloatArray:
        """Return costs (k,), but for the prior of the contacts that are fitted.

        All other unknowns take steps (k, m) from the fit; without these, contacts shift markers by
        ``pressed_px`` (k, 2n).
        """
        split = UNKNOWNS * len(line.others)
        pressed_px = pressed_px + steps[:, :split] @ line.slope[:split]
        total_px = pressed_px + self.fit.predicted_px - self.fit.pressed_px
        total_px += steps[:, split:] @ line.slope[split:]
        square = [
            robust_cost(
                self.seen.shift_px - total, inverse_variance(self.noise, self.seen, total, pressed)
            )[0]
            for total, pressed in zip(total_px, pressed_px, strict=True)
        ]
        off = prior_residual(self.places, line.others, self.prior) + steps[:, :split]
        own = prior_cost(line.others, off, self.prior).sum(axis=1)
        return np.asarray(line.noise.cost(np.array(square) - self.fit.residual_cost) + own)

    def _moments(self, nodes: list[_Node], spread: float) -> tuple[ContactState, FloatArray]:
        """Return mean and covariance over nodes by the trapezoidal rule; of the force the median.

        Its standard deviation is such that the 95 % interval about the median holds the true one.
        """
        cost = np.array([node.cost for node in nodes])
        uniform = np.array([node.log_volume for node in nodes]) - 0.5 * cost
        # Beforehand a force is as likely in each of equal ranges of its logarithm.
        log_weight = uniform - np.log([node.state.x[0] for node in nodes])
        weight = np.exp(log_weight - log_weight.max())
        at = np.array([node.distance_mm for node in nodes])
        weight *= np.diff(np.concatenate([at[:1], (at[1:] + at[:-1]) / 2.0, at[-1:]]))
        weight /= weight.sum()
        each = [node.state for node in nodes]
        point = weight @ np.stack([centre_of(self.places, state) for state in each])
        place = int(self.places.nearest(point[None])[0])
        x = np.stack(
            [_about(self.places, state, place, centre_of(self.places, state)) for state in each]
        )
        mean = weight @ x
        within = np.einsum("k,kij->ij", weight, np.stack([node.covariance for node in nodes]))
        between = (weight[:, None] * (x - mean)).T @ (x - mean)
        covariance = spread * within + between
        sd = np.sqrt(spread * np.array([node.covariance[0, 0] for node in nodes]))
        low, mean[0], _ = _quantiles(at, log_weight, x[:, 0], sd)
        # Or in each of equal ranges: the upper end depends on that.
        _, _, high = _quantiles(at, uniform, x[:, 0], sd)
        half_width = max(high - mean[0], mean[0] - low) / INTERVAL_SDS
        state = _at(self.places, replace(each[0], x=mean), place)
        return state, _widened(covariance, half_width / np.sqrt(covariance[0, 0]))


def _to_end(nodes: Sequence[_Node]) -> Sequence[_Node]:
    """Return nodes up to the first where the density has vanished."""
    least = np.minimum.accumulate([node.cost for node in nodes])
    over = np.array([node.cost for node in nodes]) - least > SETTINGS.cost_max
    return nodes[: int(over.argmax()) + 1] if over.any() else nodes


def _about(
    places: ResponseTable, state: ContactState, place: int, point_mm: FloatArray
) -> FloatArray:
    """Return the unknowns (8,) of a contact at a point (3,), about another place."""
    x = state.x.copy()
    x[1:3] = places.tangent_coordinates([place], point_mm[None])[0]
    x[SHEAR_START:] = axes_turn(places.axes[place], places.axes[state.place]) @ x[SHEAR_START:]
    return x


def _at(places: ResponseTable, state: ContactState, place: int) -> ContactState:
    """Return a contact whose unknowns are about a place, with the tables there."""
    tables, shear = places.cubics(place)
    return replace(state, place=place, tables=tables, shear=shear)


def _confusion(covariance: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the direction (2,), along and around, in which place and force vary together.

    Also the standard deviation of the place in that direction, mm, and of the force by its place
    alone, N.
    """
    place, with_force = covariance[1:3, 1:3], covariance[1:3, 0]
    size = float(np.linalg.norm(with_force))
    direction = with_force / size if size > 0.0 else np.array([1.0, 0.0])
    sd_mm = float(np.sqrt(direction @ place @ direction))
    return direction, sd_mm, float(np.sqrt(with_force @ np.linalg.solve(place, with_force)))


def _given(covariance: FloatArray, own: IntArray) -> FloatArray:
    """Return the covariance (m, m) of unknowns where others are given."""
    across = np.delete(covariance[:, own], own, axis=0)
    rest = np.delete(np.delete(covariance, own, axis=0), own, axis=1)
    return np.asarray(rest - across @ np.linalg.solve(covariance[np.ix_(own, own)], across.T))


def _widened(covariance: FloatArray, factor: float) -> FloatArray:
    """Return a covariance (8, 8) with the standard deviation of the force times a factor."""
    out = covariance.copy()
    out[0] *= factor
    out[:, 0] *= factor
    return out


def _quantiles(
    at_mm: FloatArray, log_density: FloatArray, force_N: FloatArray, sd_N: FloatArray
) -> tuple[float, float, float]:
    """Return lower end, median and upper end of the 95 % interval of a mixture of forces.

    The force has a normal distribution at each of places (m,), which have the given density.
    """
    fine = np.linspace(at_mm[0], at_mm[-1], FINE * (len(at_mm) - 1) + 1)
    density, force, sd = (np.interp(fine, at_mm, y) for y in (log_density, force_N, sd_N))
    value = force[:, None] + sd[:, None] * _NORMAL
    # The least force of a fit.
    value = np.maximum(value, contact_fit.SETTINGS.force_min_N).ravel()
    weight = np.repeat(np.exp(density - density.max()), len(_NORMAL))
    order = np.argsort(value)
    share = np.cumsum(weight[order]) / weight.sum()
    low, middle, high = value[order][np.searchsorted(share, (0.025, 0.5, 0.975))].tolist()
    return low, middle, high
