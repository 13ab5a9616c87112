"""Contacts whose force depends on a poorly known place: mean and covariance over the places.

Beside a rim the wall is stiff, and a strong contact near the rim moves the markers almost as a
weak one farther away does. The force then grows by the same factor for each millimetre, and the
covariance at the best place alone is neither wide enough nor symmetric. The posterior is therefore
integrated numerically over the one direction in which place and force are confused, with a normal
distribution of all other unknowns at each node (nested Laplace approximation; Rue, Martino and
Chopin 2009).
"""

from collections.abc import Callable, Iterator
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
    fit_contacts,
    prior_cost,
)
from phytac_decoder.estimation.contact_shifts import (
    SHEAR_START,
    UNKNOWNS,
    ContactState,
    centre_of,
    predicted_shifts,
)
from phytac_decoder.mechanics.response_table import ResponseTable, axes_turn
from phytac_shapes.arrays import FloatArray


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
    cost_max: float = 9.0
    """Growth of the cost, in units of its scale, at which the density has vanished."""
    iterations: int = 3
    """Iterations at a node; they start from the node before."""
    coupling_min: float = 0.1
    """Correlation of a contact's unknowns with those of another, from which that one is fitted
    with it at every node; others stay as they are."""


SETTINGS = AverageSettings()
INTERVAL_SDS = 1.96
"""Half the width of a 95 % interval, in standard deviations."""
FINE = 8
"""Places between nodes at which quantiles are computed."""
_NORMAL = np.array([NormalDist().inv_cdf((k + 0.5) / 40) for k in range(40)])
"""Values of a normal distribution of equal probability."""


@dataclass(frozen=True, kw_only=True)
class _Line:
    """Places of one contact, and what stays as it is beside it.

    Attributes
    ----------
    number : int
        Of the contact, among those that are fitted with it.
    held : (3,) float
        Direction in which its centre is moved, and held.
    besides_px : (2n,) float
        What all other contacts do.
    """

    number: int
    held: FloatArray
    besides_px: FloatArray


@dataclass(frozen=True, kw_only=True)
class _Node:
    """A contact whose centre is held, at a distance from its best place."""

    distance_mm: float
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
        Logarithm of how likely it is that switches read as they do, under a contact.
    """

    places: ResponseTable
    prior: ContactPrior
    noise: ShiftNoise
    seen: ShiftObservation
    fit: ContactFit
    scale: float
    log_switches: Callable[[ContactState], float]

    def contact(self, number: int) -> tuple[ContactState, FloatArray]:
        """Return a contact's mean state, with its median force, and covariance (8, 8).

        Where its place hardly matters for its force, and agrees with the switches, they are those
        of the fit.
        """
        state, own = self.fit.states[number], slice(UNKNOWNS * number, UNKNOWNS * (number + 1))
        covariance = self.scale * self.fit.covariance[own, own]
        direction, sd_mm, by_place_N = _confusion(covariance)
        sure = by_place_N < SETTINGS.force_share * state.x[0]
        if not sure or self.log_switches(state) < SETTINGS.log_switches_min:
            coupled = self._coupled(number)
            states = [self.fit.states[k] for k in coupled]
            line = _Line(
                number=coupled.index(number),
                held=direction @ self.places.axes[state.place],
                besides_px=self._pressed_px
                - np.sum([part for part, _ in predicted_shifts(self.places, states)], axis=0),
            )
            middle = self._node(line, 0.0, states)
            step_mm = min(sd_mm, SETTINGS.step_max_mm)
            before = list(self._walk(line, middle, -step_mm))
            after = list(self._walk(line, middle, step_mm))
            if before or after:
                return self._moments(line.number, [*before[::-1], middle, *after])
        # The logarithm of a force is what is determined: intervals reach farther upwards.
        share = min(float(np.sqrt(covariance[0, 0])) / state.x[0], 1.0)
        return state, _widened(covariance, np.expm1(share) / share)

    @cached_property
    def _pressed_px(self) -> FloatArray:
        """What all contacts do, (2n,) px, without motion of the cameras."""
        camera_motion = self.seen.camera_motion
        moved = camera_motion.shift_px(self.fit.motion) if camera_motion else 0.0
        return np.asarray(self.fit.predicted_px - moved)

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

    def _walk(self, line: _Line, node: _Node, step_mm: float) -> Iterator[_Node]:
        """Yield nodes to one side of a node, to the end of the surface or of the density."""
        least, number = node.cost, line.number
        for _ in range(SETTINGS.steps_max):
            moved = self._moved(node.states[number], step_mm, line.held)
            if moved is None:
                return
            states = [*node.states[:number], moved, *node.states[number + 1 :]]
            node = self._node(line, node.distance_mm + step_mm, states)
            yield node
            least = min(least, node.cost)
            if node.cost - least > SETTINGS.cost_max:
                return

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

    def _node(self, line: _Line, distance_mm: float, states: list[ContactState]) -> _Node:
        number = line.number
        fit = fit_contacts(
            self.places,
            [state.copy() for state in states],
            self.seen,
            prior=self.prior,
            noise=self.noise,
            motion=self.fit.motion,
            unweighted=0,
            iterations=SETTINGS.iterations,
            held=(number, line.held),
            besides_px=line.besides_px,
        )
        own = slice(UNKNOWNS * number, UNKNOWNS * (number + 1))
        cost = fit.residual_cost / self.scale + prior_cost(self.places, fit.states, self.prior)
        return _Node(
            distance_mm=distance_mm,
            states=fit.states,
            covariance=fit.covariance[own, own],
            cost=cost - 2.0 * self.log_switches(fit.states[number]),
            log_volume=0.5 * float(np.linalg.slogdet(fit.covariance)[1]),
        )

    def _moments(self, number: int, nodes: list[_Node]) -> tuple[ContactState, FloatArray]:
        """Return mean and covariance over nodes by the trapezoidal rule; of the force the median.

        Its standard deviation is such that the 95 % interval about the median holds the true one.
        """
        cost = np.array([node.cost for node in nodes])
        uniform = np.array([node.log_volume for node in nodes]) - 0.5 * cost
        # Beforehand a force is as likely in each of equal ranges of its logarithm.
        log_weight = uniform - np.log([node.states[number].x[0] for node in nodes])
        weight = np.exp(log_weight - log_weight.max())
        at = np.array([node.distance_mm for node in nodes])
        weight *= np.diff(np.concatenate([at[:1], (at[1:] + at[:-1]) / 2.0, at[-1:]]))
        weight /= weight.sum()
        each = [node.states[number] for node in nodes]
        point = weight @ np.stack([centre_of(self.places, state) for state in each])
        place = int(self.places.nearest(point[None])[0])
        x = np.stack(
            [_about(self.places, state, place, centre_of(self.places, state)) for state in each]
        )
        mean = weight @ x
        within = np.einsum("k,kij->ij", weight, np.stack([node.covariance for node in nodes]))
        between = (weight[:, None] * (x - mean)).T @ (x - mean)
        covariance = self.scale * within + between
        sd = np.sqrt(self.scale * np.array([node.covariance[0, 0] for node in nodes]))
        low, mean[0], _ = _quantiles(at, log_weight, x[:, 0], sd)
        # Or in each of equal ranges: the upper end depends on that.
        _, _, high = _quantiles(at, uniform, x[:, 0], sd)
        half_width = max(high - mean[0], mean[0] - low) / INTERVAL_SDS
        state = _at(self.places, replace(each[0], x=mean), place)
        return state, _widened(covariance, half_width / np.sqrt(covariance[0, 0]))


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
    return replace(state, place=place, tables=places.cubic(place), shear=places.shear_cubic(place))


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
