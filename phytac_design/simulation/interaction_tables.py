r"""Koiter's mixed term of two discs, as the cameras see it.

With x the linear motion of a newton on a disc and Π the shell's energy, the mixed term of discs i
and k solves ``K·x_ik = -Π‴(x_i, x_k)``, and the image sees it by its slope H, and what the two
motions do together to the image by its bend (the lens, and arms that turn)::

    M = H·x_ik + x_i·H'·x_k

Images of some random pairs give the axes along which most of all of them lies (Halko,
Martinsson and Tropp 2011 find a range so). Along an axis g ::

    g·H·x_ik = -Π‴(x_i, x_k, z)      K·z = Hᵀ·g

(derived here: the third derivative of an energy is symmetric): a matrix over the DOFs for each
axis, and pairs only products.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from phytac_decoder.mechanics.interaction_table import InteractionTable
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.mechanics.large.cubic_stiffness import DOFS, cubic_stiffness
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.simulation.pressed_series import DiscResponse, ImageResponse
from phytac_design.simulation.turned_places import SectorSymmetry
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class InteractionSettings:
    """How interactions of discs are tabulated."""

    spacing_share: float = 2.2
    """Distance of places over the disc's radius."""
    places_max: int = 250
    """Places at most, without symmetry: tables grow by their square."""
    pairs_per_axis: int = 3
    """Pairs drawn at random, for each axis."""
    near_radii: float = 6.0
    """Distance over the disc's radius up to which pairs count as near."""
    near_share: float = 0.6
    """Share of near pairs among those drawn: they interact more, and differ more."""
    batch: int = 32
    """Loads solved together."""
    elements_max: int = 40000
    """Shells of more have no such tables: time and memory grow with both."""
    elements_kept: int = 6500
    """Shells of more get third derivatives twice: they take 80 kB an element."""
    axes_max: int = 128
    """Of the images, at most."""
    difference_step: float = 1e-2
    """Motion (mm and rad) of the differences for the image's bend."""
    copied_images: float = 4.0
    """With symmetry: images that axes are found from, turned copies included, over those without.
    Copies resemble one another, so that it takes more. Errors fall by a third from 1 to 4."""
    more_places: float = 1.3
    """With symmetry: places at most, over those without. Every sector has the same number of places
    in a ring, which may be more than the spacing needs."""


SETTINGS = InteractionSettings()


def pair_spacing_mm(area_mm2: float, radius_mm: float) -> float:
    """Distance of the places of a table over so much surface."""
    return max(SETTINGS.spacing_share * radius_mm, float(np.sqrt(area_mm2 / SETTINGS.places_max)))


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Some of a shell's elements, and their motions under a newton at each of p places.

    Attributes
    ----------
    elements : slice
        Which.
    third : (e, 24, 24, 24) float32
        See :func:`cubic_stiffness`.
    dofs : (d,) int
        DOFs of their nodes.
    gather : (d, 24 e) float32, sparse
        Sums values at elements to those at nodes.
    motion, own : (d, p), (e, 24, p) float32
        Motions at nodes, and at elements.
    """

    elements: slice
    third: NDArray[np.float32]
    dofs: IntArray
    gather: csr_array
    motion: NDArray[np.float32]
    own: NDArray[np.float32]

    @classmethod
    def of(
        cls, elements: slice, third: NDArray[np.float32], each: IntArray, motion: FloatArray
    ) -> "_Part":
        """Part by the DOFs (e, 24) of its elements and the motions (6N, p) of the shell."""
        dofs, place = np.unique(each, return_inverse=True)
        place = place.ravel()
        ones = np.ones(len(place), dtype=np.float32)
        gather = csr_array((ones, (place, np.arange(len(place)))), shape=(len(dofs), len(place)))
        at_nodes = motion[dofs].astype(np.float32)
        own = at_nodes[place].reshape(*each.shape, -1)
        return cls(
            elements=elements, third=third, dofs=dofs, gather=gather, motion=at_nodes, own=own
        )


class InteractionSolver:
    """Mixed terms of discs at p places.

    Parameters
    ----------
    shell, see : DiscResponse, ImageResponse
        The sensor's shell, and what its cameras see.
    uv : (p, 2) float
        Places.
    radius_mm : float
        Of the discs.
    symmetry : SectorSymmetry, optional
        Of the sensor and the places.
    """

    def __init__(
        self,
        shell: DiscResponse,
        see: ImageResponse,
        uv: FloatArray,
        radius_mm: float,
        symmetry: SectorSymmetry | None = None,
    ) -> None:
        self.shell, self.see, self.uv, self.radius_mm = shell, see, uv, radius_mm
        self.symmetry = symmetry
        self.held = shell.model.fixed.ravel()
        # Places that are solved; all others are turned copies of these.
        self.base = symmetry.base if symmetry else np.arange(len(uv))
        # A newton's linear motions, (6N, p), and those of receptors, (p, n, 6).
        self.motion = self._linear()
        self.receptors = np.stack([shell.kinematics.linear(motion) for motion in self.motion.T])
        self.bend = image_curvature(see, self.receptors.shape[1])
        self.point_mm = shell.surface.point(uv)
        quads = shell.model.quads
        # DOFs (E, 24) of the elements.
        self.dofs = (6 * quads[:, :, None] + np.arange(6)).reshape(len(quads), DOFS)
        few = len(quads) <= SETTINGS.elements_kept
        self._kept = list(self._make_parts()) if few else None

    def _linear(self) -> FloatArray:
        """Linear motions (6N, p) under a newton at each place."""
        solved = [
            self.shell.linear(self.uv[self.base[k : k + SETTINGS.batch]], self.radius_mm)[1]
            for k in range(0, len(self.base), SETTINGS.batch)
        ]
        found = np.concatenate(solved, axis=1)
        if self.symmetry is None:
            return found
        out = np.empty((len(found), len(self.uv)))
        for places, motion in self.symmetry.copies(found, self.symmetry.turn_nodes):
            out[:, places] = motion
        return out

    def parts(self) -> Iterable[_Part]:
        """All elements, part by part."""
        return self._make_parts() if self._kept is None else self._kept

    def _make_parts(self) -> Iterator[_Part]:
        for elements, third in cubic_stiffness(self.shell.model):
            yield _Part.of(elements, third, self.dofs[elements], self.motion)

    def pairs(self, progress: Callable[[str], None] = lambda _: None) -> InteractionTable:
        """Tables of all pairs of the places."""
        axes = self.axes()
        progress(f"places: pairs of contacts, {len(axes)} axes")
        along, around = tangent_frame(self.shell.surface, self.uv)
        grid = ResponseTable(
            point_mm=self.point_mm,
            along=along,
            around=around,
            shift_px=self.coordinates(axes),
            radius_mm=self.radius_mm,
        )
        return InteractionTable(grid=grid, axes_px=axes.astype(np.float32))

    def axes(self) -> FloatArray:
        """Axes (r, 2n) of the images, each of unit length."""
        images = self.images(self.drawn())
        if self.symmetry:
            copies = self.symmetry.copies(images, self.symmetry.turn_shifts)
            images = np.concatenate([each for _, each in copies])
        _, size, axes = np.linalg.svd(images, full_matrices=False)
        count = min(SETTINGS.axes_max, int((size > 0.0).sum()))
        # Axes of equal size turn into each other: all of them are kept, or none.
        while self.symmetry and 1 < count < len(size) and _same_size(size, count):
            count -= 1
        return np.asarray(axes[:count])

    def drawn(self) -> IntArray:
        """Pairs (k, 2) of places that do not overlap, near ones more often.

        No two are the same, or turned copies of each other.
        """
        gap = np.linalg.norm(self.point_mm[self.base, None] - self.point_mm[None], axis=2)
        first, other = np.nonzero(gap > 2.0 * self.radius_mm)
        count = SETTINGS.pairs_per_axis * SETTINGS.axes_max
        one, two, turns, sectors = self.base[first], other, np.zeros_like(other), 1
        if self.symmetry:
            ring, sectors = self.symmetry.ring, self.symmetry.sectors
            two, turns = ring.base[other], ring.turns[other]
            count = min(count, round(SETTINGS.copied_images * count / sectors))
        # Counted from its other place, a pair is turned the other way: it is kept from one of them.
        once = (one < two) | ((one == two) & (turns <= -turns % sectors))
        first, other = first[once], other[once]
        near = gap[first, other] < SETTINGS.near_radii * self.radius_mm
        rng = np.random.default_rng(0)
        some = rng.permutation(np.flatnonzero(near))[: round(SETTINGS.near_share * count)]
        rest = rng.permutation(np.setdiff1d(np.arange(len(first)), some))[: count - len(some)]
        taken = np.sort(np.concatenate([some, rest]))
        return np.asarray(np.stack([self.base[first], other], axis=1)[taken])

    def images(self, pairs: IntArray) -> FloatArray:
        """M (k, 2n) px/N² of pairs of places (k, 2), each solved for itself."""
        push = np.zeros((len(pairs), len(self.motion)))
        for part in self.parts():
            flat = part.third.reshape(-1, DOFS, DOFS * DOFS)
            for first in range(0, len(pairs), SETTINGS.batch):
                some = slice(first, first + SETTINGS.batch)
                one, other = part.own[:, :, pairs[some, 0]], part.own[:, :, pairs[some, 1]]
                products = (other[:, :, None] * one[:, None]).reshape(len(one), DOFS * DOFS, -1)
                force = flat @ products
                push[some, part.dofs] -= (part.gather @ force.reshape(len(part.own) * DOFS, -1)).T
        push[:, self.held] = 0.0
        out = []
        for first in range(0, len(pairs), SETTINGS.batch):
            some = slice(first, first + SETTINGS.batch)
            moved = self.shell.model.solve(push[some].T).motion.reshape(len(self.motion), -1)
            for (i, j), motion in zip(pairs[some], moved.T, strict=True):
                slope = np.einsum(
                    "nij,nj->ni", self.see.slope, self.shell.kinematics.linear(motion)
                )
                bent = np.einsum("nj,nijk,nk->ni", self.receptors[i], self.bend, self.receptors[j])
                out.append((slope + bent).ravel())
        return np.array(out).reshape(len(pairs), -1)

    def coordinates(self, axes: FloatArray) -> NDArray[np.float32]:
        """M (p, p, r) of all pairs along axes (r, 2n), px/N²."""
        push = np.stack(
            [self.shell.kinematics.matrix.T @ self.see.pull(g).ravel() for g in axes], axis=1
        )
        push[self.held] = 0.0
        stirred = self.shell.model.solve(push).motion.reshape(push.shape)
        count, base = self.motion.shape[1], self.base
        terms = np.zeros((len(axes), len(base), count), dtype=np.float32)
        for part in self.parts():
            z = stirred[self.dofs[part.elements]].astype(np.float32)
            along = (part.third.reshape(len(z), -1, DOFS) @ z).transpose(2, 0, 1)
            own = part.own[:, :, base]
            for number, matrix in enumerate(along):
                pulls = matrix.reshape(-1, DOFS, DOFS) @ own
                # Sums at nodes first: the product over them is a quarter of that over elements.
                terms[number] -= (part.gather @ pulls.reshape(-1, len(base))).T @ part.motion
        receptors = self.receptors.reshape(count, -1)
        for number, axis in enumerate(axes):
            bend = np.einsum("ni,nijk->njk", axis.reshape(-1, 2), self.bend)
            turned = np.einsum("pnj,njk->pnk", self.receptors[base], bend).reshape(len(base), -1)
            terms[number] += (turned @ receptors.T).astype(np.float32)
        return self._spread(np.ascontiguousarray(terms.transpose(1, 2, 0)), axes)

    def _spread(self, terms: NDArray[np.float32], axes: FloatArray) -> NDArray[np.float32]:
        """Terms (p, p, r) of all pairs by those (b, p, r) whose first place is solved."""
        if self.symmetry is None:
            return terms
        place = self.symmetry.place
        axes_turn = (self.symmetry.turn_shifts(axes) @ axes.T).astype(np.float32)

        def turned(values: NDArray[np.float32]) -> NDArray[np.float32]:
            out = np.empty_like(values)
            out[:, place] = values @ axes_turn
            return out

        out = np.empty((len(place), *terms.shape[1:]), dtype=np.float32)
        for places, values in self.symmetry.copies(terms, turned):
            out[places] = values
        return out


def _same_size(size: FloatArray, count: int) -> bool:
    """Whether the last of so many sizes, in order, is as large as the next, but for rounding."""
    return bool(size[count - 1] - size[count] <= 1e-9 * size[0])


def image_curvature(see: ImageResponse, count: int) -> FloatArray:
    """Second derivatives (n, 2, 6, 6) of the images of n markers by their motion."""
    step = SETTINGS.difference_step * np.eye(6)

    def at(motion: FloatArray) -> FloatArray:
        return see.shift(np.tile(motion, (count, 1)))

    out = np.empty((count, 2, 6, 6))
    for i in range(6):
        for k in range(i + 1):
            one, two = step[i] + step[k], step[i] - step[k]
            bent = at(one) + at(-one) - at(two) - at(-two)
            out[:, :, i, k] = out[:, :, k, i] = bent / (4.0 * SETTINGS.difference_step**2)
    return out
