"""Response table of the estimator ``auto``: marker shifts of a contact at any place.

A patch of force f about a place shifts the images by::

    d(f) = f·S₁ + f²·S₂ + f³·S₃

with one row of each S per place, tabulated for a uniform disc. Between places the rows are a cubic
in the tangent plane, fitted to the places around (moving least squares). Another patch of the same
force differs by its moments, to second order: a shift (x, y) of its centre, and the difference m
of its second moments to the disc's, ::

    d = S(x, y) + ½·(m_xx ∂²S/∂x² + 2·m_xy ∂²S/∂x∂y + m_yy ∂²S/∂y²)

so that one table serves discs, spheres and edges of any size and orientation (derived here).
A force along the surface adds shifts in proportion to its components along and around.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.discs import cut_disc_centroid

if TYPE_CHECKING:
    from phytac_decoder.mechanics.interaction_table import InteractionTable
    from phytac_decoder.mechanics.membrane_stretching import BergerWall

TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""Powers of x and y of the cubic."""
FIT_PLACES = 20
"""Number of places that a cubic is fitted to: twice its coefficients."""
END_GAP_rad, END_PLACES = 2.6, 3
"""Angle without a neighbour from which a place is at the end of the surface (150°, and 180° at a
straight end); number of such places that the distance of a point to the end is measured from."""
END_POWER_MAX, END_MARKERS = 2.0, 6
"""Largest power with which shifts fall towards an end: a plate's deflection is as the square.
Number of markers that it is taken from: those that move most."""
SOFTENING_GROWTH_MAX = 1.5
"""Largest growth of the shifts beyond linear ones, over f², from half the largest force to all of
it: half of the stiffness is then gone."""
FLAT_COSINE_DROP, FLATNESS_NEIGHBOURS = 1e-4, 8
"""Largest 1 - cos of the angle between normals on a flat wall (0.8°); number of places whose
normals are compared."""


@dataclass(frozen=True, kw_only=True)
class ResponseTable:
    """Tables over p places of a sensor with n markers.

    Attributes
    ----------
    point_mm : (p, 3) float
        Places on the outer face.
    along, around : (p, 3) float
        Unit tangents: away from the camera, and square to it.
    shift_px : (p, k, 2n) float32
        S₁ … S_k: px per N, N², …, as (x0, y0, x1, y1, …). With flat walls these are followed by
        px per N of v, v², …: the response by the share v of softness that a wall has lost.
    radius_mm : float
        Radius of the disc.
    top_N : float
        Largest tabulated force.
    pairs : InteractionTable, optional
        Interactions of simultaneous contacts.
    walls : BergerWall, optional
        Flat walls.
    shear : ResponseTable, optional
        Over fewer places: px per N of force along the surface, (q, 2, 2n), along and around.
    """

    point_mm: FloatArray
    along: FloatArray
    around: FloatArray
    shift_px: NDArray[np.float32]
    radius_mm: float
    top_N: float = np.inf
    pairs: "InteractionTable | None" = None
    walls: "BergerWall | None" = None
    shear: "ResponseTable | None" = None

    @property
    def orders(self) -> int:
        """Powers of the force in the tables."""
        return int(self.shift_px.shape[1]) - (self.walls.orders if self.walls else 0)

    @cached_property
    def softening(self) -> FloatArray:
        """Share (p,) of the stiffness that each newton on a place takes away, 1/N."""
        return softening_of(self.shift_px[:, 1 : self.orders], self.top_N)

    @cached_property
    def spacing_mm(self) -> float:
        """Median distance from a place to the nearest other."""
        near, _ = self.fits
        if near.shape[1] < 2:
            return self.radius_mm
        gap = self.point_mm - self.point_mm[near[:, 1]]
        return float(np.median(np.linalg.norm(gap, axis=1)))

    def scaled(self, stiffness: float) -> "ResponseTable":
        """Return the tables of a sensor stiffer by a factor: d(f) becomes d(f / stiffness)."""
        powers = np.ones(self.shift_px.shape[1])
        powers[: self.orders] = np.arange(1.0, self.orders + 1.0)
        rows = self.shift_px * (stiffness**-powers).astype(np.float32)[:, None]
        pairs = self.pairs.scaled(stiffness) if self.pairs else None
        walls = self.walls.scaled(stiffness) if self.walls else None
        top_N = stiffness * self.top_N
        shear = self.shear
        if shear:
            shear = shear.with_rows(shear.shift_px / np.float32(stiffness))
        return self.with_rows(rows, pairs=pairs, walls=walls, top_N=top_N, shear=shear)

    def with_rows(self, shift_px: NDArray[np.float32], **others: Any) -> "ResponseTable":
        """Return other tables over the same places; ``others`` are attributes by name."""
        return self._like(replace(self, shift_px=shift_px, **others))

    def _like(self, out: "ResponseTable") -> "ResponseTable":
        # These depend on the places alone, and computing them takes a third of a second.
        for known in ("fits", "flat", "place_normals", "ends"):
            if known in self.__dict__:
                out.__dict__[known] = self.__dict__[known]
        if out.shear is self.shear and "shear_px" in self.__dict__:
            out.__dict__["shear_px"] = self.__dict__["shear_px"]
        return out

    def nearest(self, point_mm: FloatArray) -> IntArray:
        """Return the index (m,) of the place nearest to each of points (m, 3)."""
        # |q|² - 2 p·q: |p|² is the same for all places.
        gap = self._squares - 2.0 * (point_mm @ self.point_mm.T)
        return np.asarray(np.argmin(gap, axis=1))

    @cached_property
    def _squares(self) -> FloatArray:
        return np.asarray(np.sum(self.point_mm**2, axis=1))

    @cached_property
    def place_normals(self) -> FloatArray:
        """Outward unit normals (p, 3) at the places."""
        return np.cross(self.along, self.around)

    @cached_property
    def flat(self) -> BoolArray:
        """Places (p,) on flat walls: the normals around them are parallel."""
        normal = self.place_normals
        near = self.fits[0][:, :FLATNESS_NEIGHBOURS]
        return np.asarray(
            np.einsum("pqi,pi->pq", normal[near], normal).min(axis=1) > 1.0 - FLAT_COSINE_DROP
        )

    @cached_property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Places (r, 3) at the end of the surface, and unit tangents (r, 3) that point inward.

        A place is at the end if its neighbours leave more than ``END_GAP_rad`` free on one side.
        """
        near = self.fits[0][:, 1:]
        normal = self.place_normals
        ours = np.arange(len(near))[:, None]
        arm = self.point_mm[near] - self.point_mm[:, None]
        xy = _tangent_coordinates(arm, self.along[:, None], self.around[:, None])
        size = np.linalg.norm(xy, axis=2)
        # On a thin sensor the far side is near; turned copies of a pole coincide with it.
        known = (np.einsum("pqi,pqi->pq", normal[near], normal[ours]) > 0.0) & (size > 0.0)
        angle = np.arctan2(xy[..., 1], xy[..., 0])
        angle = np.sort(np.where(known, angle, angle[np.arange(len(near)), known.argmax(1), None]))
        gap = np.diff(angle, axis=1, append=angle[:, :1] + 2.0 * np.pi)
        rows = np.flatnonzero(gap.max(axis=1) > END_GAP_rad)
        widest = gap[rows].argmax(axis=1)
        inward = angle[rows, widest] + gap[rows, widest] / 2.0 + np.pi
        x, y = np.cos(inward)[:, None], np.sin(inward)[:, None]
        return self.point_mm[rows], x * self.along[rows] + y * self.around[rows]

    def end_distance_mm(self, points_mm: FloatArray) -> FloatArray:
        """Return how far points (m, 3) are from the end of the surface, (m,); inf without one."""
        return self.towards_end(points_mm)[0]

    def towards_end(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distance mm of points (m, 3) from the end of the surface, (m,), and a power.

        Towards a clamped end shifts per newton fall as a power of the distance between the end and
        the centroid of the pressure: see :attr:`_end_powers`. Without an end the distance is inf
        and the power 0.
        """
        ends, inward = self.ends
        if not len(ends):
            return np.full(len(points_mm), np.inf), np.zeros(len(points_mm))
        arm = points_mm[:, None] - ends
        # The nearest few: at a corner two ends are near.
        order = np.argsort(np.linalg.norm(arm, axis=2), axis=1)[:, :END_PLACES]
        across = np.take_along_axis(np.einsum("mri,ri->mr", arm, inward), order, axis=1)
        least = across.argmin(axis=1)
        row = np.arange(len(order))
        return across[row, least], self._end_powers[order[row, least]]

    @cached_property
    def _end_powers(self) -> FloatArray:
        """Powers (r,) between the tables' discs on each end place and one radius farther in.

        From the shifts of the few markers that move most: a sum over all would fall towards an end
        also because there are no markers beyond it.
        """
        ends, inward = self.ends
        near, far = self.nearest(ends), self.nearest(ends + self.radius_mm * inward)
        image = self.shift_px[:, 0].reshape(len(self.shift_px), -1, 2)
        size = np.sort(np.linalg.norm(image[[near, far]], axis=3), axis=2)[:, :, -END_MARKERS:]
        size = np.maximum(np.linalg.norm(size, axis=2), 1e-12)
        gap = np.einsum("ri,ri->r", self.point_mm[far] - ends, inward)
        depth = cut_disc_centroid(np.stack([0.0 * gap, np.maximum(gap, 0.0)]), self.radius_mm)
        steps = np.diff(np.log([size, depth]), axis=1)[:, 0]
        power = steps[0] / np.maximum(steps[1], 0.1)
        return np.asarray(np.clip(power, 0.0, END_POWER_MAX))

    def tangent_coordinates(
        self, places: int | Sequence[int] | IntArray, points_mm: FloatArray
    ) -> FloatArray:
        """Return tangent-plane coordinates (m, 2) of points (m, 3); lengths of chords are kept.

        Parameters
        ----------
        places : int or (m,) int
            The place about which, for all points or for each.
        """
        arm = points_mm - self.point_mm[places]
        return _tangent_coordinates(arm, self.along[places], self.around[places])

    @cached_property
    def fits(self) -> tuple[IntArray, NDArray[np.float32]]:
        """Places (p, q) that each cubic is fitted to, and its coefficients (p, 10, q).

        Coefficients are derivatives at the place: value, x, y, xx, xy, yy, xxx, xxy, xyy, yyy.
        """
        count = len(self.point_mm)
        # In chunks of 256 places, which bounds the memory.
        parts = [self._fit(np.arange(k, min(k + 256, count))) for k in range(0, count, 256)]
        near, weights = zip(*parts, strict=True)
        return np.concatenate(near), np.concatenate(weights).astype(np.float32)

    def _fit(self, own: IntArray) -> tuple[IntArray, FloatArray]:
        normal = self.place_normals
        gap = self._squares - 2.0 * (self.point_mm[own] @ self.point_mm.T)
        # On a thin sensor the far side is near: its normals point the other way.
        gap[normal[own] @ normal.T <= 0.0] = np.inf
        # The place itself first, regardless of rounding.
        gap[np.arange(len(own)), own] = -np.inf
        wanted = min(2 * FIT_PLACES, len(self.point_mm))
        near = np.argsort(gap, axis=1, kind="stable")[:, :wanted]
        far = np.isinf(np.take_along_axis(gap, near, axis=1))
        far[:, 0] = False
        arm = self.point_mm[near] - self.point_mm[own][:, None]
        xy = _tangent_coordinates(arm, self.along[own][:, None], self.around[own][:, None])
        best = _balanced(xy, far)[:, :FIT_PLACES]
        near, far = np.take_along_axis(near, best, axis=1), np.take_along_axis(far, best, axis=1)
        xy = np.take_along_axis(xy, best[:, :, None], axis=1)
        size = np.linalg.norm(np.where(far[:, :, None], 0.0, xy), axis=2).max(axis=1)
        size = np.where(size > 0.0, size, 1.0)
        xy = xy / size[:, None, None]
        basis = np.stack([xy[..., 0] ** a * xy[..., 1] ** b for a, b in TERMS], axis=2)
        # The farthest place has the weight exp(-4).
        weight = np.where(far, 0.0, np.exp(-4.0 * np.sum(xy**2, axis=2)))
        fit = np.linalg.pinv(weight[:, :, None] * basis, rcond=1e-8) * weight[:, None]
        scale = np.array([float(factorial(a) * factorial(b)) for a, b in TERMS])
        powers = size[:, None] ** np.array([a + b for a, b in TERMS])
        return near, fit * (scale / powers)[:, :, None]

    def shares(self, points_mm: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the place (m,) nearest to each of points (m, 3), and weights of rows there.

        The weights (m, q) are those of the rows of the places that the cubic is fitted to, see
        :attr:`fits`.
        """
        place = self.nearest(points_mm)
        x, y = self.tangent_coordinates(place, points_mm).T
        xx, xy, yy = x * x / 2.0, x * y, y * y / 2.0
        cubic = (x * xx / 3.0, xx * y, x * yy, y * yy / 3.0)
        powers = np.stack([np.ones_like(x), x, y, xx, xy, yy, *cubic], axis=1)
        return place, np.einsum("mt,mtq->mq", powers, self.fits[1][place])

    def shear_at(self, points_mm: FloatArray) -> FloatArray:
        """Return shifts (m, 2, 2n) per N of force along the surface at points (m, 3).

        Along and around in the axes of the place nearest to each.
        """
        out = np.zeros((len(points_mm), 2, self.shift_px.shape[2]))
        for k, place in enumerate(self.nearest(points_mm).tolist()):
            x, y = self.tangent_coordinates([place], points_mm[k : k + 1])[0]
            powers = [x**a * y**b / (factorial(a) * factorial(b)) for a, b in TERMS]
            out[k] = np.tensordot(powers, self.shear_cubic(place), axes=1)
        return out

    def normals(self, points_mm: FloatArray) -> FloatArray:
        """Return outward unit normals (m, 3) at points (m, 3) of the outer face."""
        place, counts = self.shares(points_mm)
        each = self.place_normals[self.fits[0][place]]
        out = np.einsum("mq,mqi->mi", counts, each)
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))

    def normal_slopes(self, points_mm: FloatArray) -> FloatArray:
        """Return how normals turn per mm along and around, (m, 2, 3), at points (m, 3).

        Those of the place nearest to each point.
        """
        place = self.nearest(points_mm)
        near, weights = self.fits
        each = self.place_normals[near[place]]
        # The second and third rows of a cubic are its first derivatives.
        return np.asarray(np.einsum("mtq,mqi->mti", weights[place, 1:3], each))

    def cubics(self, place: int) -> tuple[Any, Any]:
        """Return :meth:`cubic` and :meth:`shear_cubic` of a place, of recent places kept."""
        found = self._recent.get(place)
        if found is None:
            # 64 places, of 150 kB each for cylinder60.
            if len(self._recent) >= 64:
                self._recent.pop(next(iter(self._recent)), None)
            found = self._recent[place] = self.cubic(place), self.shear_cubic(place)
        return found

    @cached_property
    def _recent(self) -> dict[int, tuple[Any, Any]]:
        """Cubics of recent places: contacts stay for many iterations and frames."""
        return {}

    def cubic(self, place: int) -> Any:
        """Return derivatives (10, k, 2n) float32 of the rows at a place; see :attr:`fits`."""
        near, weights = self.fits
        rows = self.shift_px[near[place]].reshape(near.shape[1], -1)
        return (weights[place] @ rows).reshape(len(TERMS), *self.shift_px.shape[1:])

    def shear_cubic(self, place: int) -> Any:
        """Return the same (10, 2, 2n) of shifts by force along the surface, in the place's axes."""
        if self.shear is None:
            return np.zeros((len(TERMS), 2, self.shift_px.shape[2]), dtype=np.float32)
        near, weights = self.fits
        own = near[place]
        turn = axes_turn(self.axes[place], self.axes[own]).astype(np.float32)
        # (t, q) with (q, i, j) to (t, i, q j), and then with rows (q j, 2n).
        each = np.einsum("tq,qij->tiqj", weights[place], turn).reshape(2 * len(TERMS), -1)
        rows = each @ self.shear_px[own].reshape(each.shape[1], -1)
        return rows.reshape(len(TERMS), 2, -1)

    @cached_property
    def axes(self) -> FloatArray:
        """Unit tangents along and around (p, 2, 3) of each place."""
        return np.stack([self.along, self.around], axis=1)

    @cached_property
    def shear_px(self) -> NDArray[np.float32]:
        """Shifts (p, 2, 2n) per N of force along the surface at each place."""
        shear = self.shear
        if shear is None:
            return np.zeros((len(self.point_mm), 2, self.shift_px.shape[2]), dtype=np.float32)
        out = np.empty((len(self.point_mm), 2, self.shift_px.shape[2]), dtype=np.float32)
        for k in range(0, len(out), 256):  # bounds the memory
            own = slice(k, k + 256)
            place, weights = shear.shares(self.point_mm[own])
            near = shear.fits[0][place]
            turn = axes_turn(self.axes[own, None], shear.axes[near])
            each = np.einsum("pq,pqij->piqj", weights, turn).astype(np.float32)
            rows = shear.shift_px[near].reshape(len(near), -1, out.shape[2])
            out[own] = each.reshape(len(near), 2, -1) @ rows
        return out


def softening_of(shift_px: NDArray[np.float32], top_N: float) -> FloatArray:
    """Return the share (p,) of the stiffness that each newton takes away, 1/N; at least 0.

    The shifts beyond linear ones are as f² / (1 - a·f): a follows from half the largest force and
    all of it.

    Parameters
    ----------
    shift_px : (p, k, 2n) float
        Shifts by powers of the force from the second on.
    top_N : float
        Largest force.
    """
    orders = shift_px.shape[1]
    if orders < 2 or not np.isfinite(top_N):
        return np.zeros(len(shift_px))
    powers = (top_N * np.array([[0.5], [1.0]])) ** np.arange(orders)
    half, top = np.einsum("tk,pkn->tpn", powers.astype(np.float32), shift_px)
    size = np.maximum(np.einsum("pn,pn->p", half, half), 1e-30)
    growth = np.einsum("pn,pn->p", half, top) / size
    growth = np.clip(growth, 1.0, SOFTENING_GROWTH_MAX)
    return np.asarray((growth - 1.0) / (growth - 0.5) / top_N)


def axes_turn(ours: FloatArray, theirs: FloatArray) -> FloatArray:
    """Return the rotations (…, 2, 2) that take components along ``theirs`` to those along ``ours``.

    Both are two unit tangents, (…, 2, 3). Their plane is first turned into ours by the shortest
    way. Around a pole, the axes of neighbouring places differ by large angles.
    """
    turn = np.einsum("...ik,...jk->...ij", ours, theirs)
    # The rotation nearest to the projection: its polar factor, in two dimensions.
    cosine, sine = turn[..., 0, 0] + turn[..., 1, 1], turn[..., 1, 0] - turn[..., 0, 1]
    size = np.maximum(np.hypot(cosine, sine), 1e-12)
    cosine, sine = cosine / size, sine / size
    out = np.stack([cosine, -sine, sine, cosine], axis=-1)
    return out.reshape(*out.shape[:-1], 2, 2)


def _balanced(xy: FloatArray, far: BoolArray) -> IntArray:
    """Return the order (p, q) of the places (p, q, 2) around, nearest first.

    At a rim the nearest lie along it, on too few lines for a cubic across. There distances are
    weighted by the spread of the places, so that those across come first.
    """
    weight = np.where(far, 0.0, 1.0)
    total = weight.sum(axis=1)
    mean = np.einsum("pq,pqi->pi", weight, xy) / total[:, None]
    from_mean = (xy - mean[:, None]) * weight[:, :, None]
    spread = np.einsum("pqi,pqj->pij", from_mean, from_mean) / total[:, None, None]
    low, high = np.linalg.eigvalsh(spread).T
    one_sided = high > 1.5 * low
    square = np.sum(xy**2, axis=2)
    weighed = np.einsum("pqi,pij,pqj->pq", xy, spread, xy)
    square = np.where(one_sided[:, None], weighed, square)
    square[far] = np.inf
    square[:, 0] = -np.inf
    return np.argsort(square, axis=1, kind="stable")


def _tangent_coordinates(arm: FloatArray, along: FloatArray, around: FloatArray) -> FloatArray:
    """Return coordinates (…, 2) of arms (…, 3) in a tangent plane, as long as the arms."""
    if arm.size == along.size == 3:  # Plain numbers are ten times as fast for one.
        a, p, q = arm.ravel().tolist(), along.ravel().tolist(), around.ravel().tolist()
        x, y = a[0] * p[0] + a[1] * p[1] + a[2] * p[2], a[0] * q[0] + a[1] * q[1] + a[2] * q[2]
        length, flat = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]), sqrt(x * x + y * y)
        stretch = min(length / (flat or 1.0), 2.0)
        return np.array([x * stretch, y * stretch]).reshape(*arm.shape[:-1], 2)
    xy = np.stack([np.sum(arm * along, axis=-1), np.sum(arm * around, axis=-1)], axis=-1)
    flat = np.linalg.norm(xy, axis=-1)
    stretch = np.linalg.norm(arm, axis=-1) / np.where(flat > 0.0, flat, 1.0)
    return np.asarray(xy * np.minimum(stretch, 2.0)[..., None])
