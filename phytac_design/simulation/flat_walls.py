r"""Flat walls under tension: what discs do to images and slopes as a wall loses its softness.

A flat wall that is pressed in stretches, and its tension stiffens it: to good accuracy one tension
for the whole wall (Berger 1955), under which the wall is linear. With K its stiffness, B the change
of K by an even stretch e, and x(e) the linear motion under all contacts in the stretched wall, it
is that of

    e = α (1 - ν) / (2 A E t (1 + ν)) · x(e)ᵀ B x(e)      (K + e·B)·x(e) = F

with A, E, t and ν the wall's area, modulus, thickness and Poisson's ratio (derived here from
Berger's energy). α = 1 for a plate whose edges hold still; walls of a box give way there, and α is
fitted to large displacements. A wall of one mode of deflection loses the share v = e / (e + e₀) of
its softness, with e₀ = xᵀK x / xᵀB x: images and slopes per newton go by powers of v.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, hstack
from scipy.sparse.linalg import splu

from phytac_decoder.mechanics.membrane_stretching import BergerWall
from phytac_decoder.mechanics.response_table import FLAT_COSINE_DROP, ResponseTable
from phytac_design.mechanics.large.corotational import Corotational
from phytac_design.mechanics.shell.discretisation import force_ratio
from phytac_design.mechanics.shell.factor import SUPERLU
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.pressed_series import DiscResponse, ImageResponse
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class MembraneSettings:
    """How flat walls under tension are found and tabulated."""

    stretch_step: float = 1e-4
    """Stretch of the differences that stand for B."""
    lost_softness_max: float = 0.85
    """Largest share v of a wall's softness that tables hold for."""
    modes_max: int = 64
    """Slopes at most."""
    mode_size_min: float = 1e-5
    """Least stretching of a mode of slopes, over the largest."""
    batch: int = 64
    """Loads solved together."""
    mode_places_max: int = 400
    """Places at most that the modes are found from."""
    edge_factor_range: tuple[float, float] = (0.02, 2.0)
    """α is in between."""
    discs: int = 4
    """Discs that α is fitted to besides one."""
    shares_tried: int = 4001
    """Shares v at which α is looked for."""
    coplanar_share: float = 0.02
    """Height of one place over another's wall that it may have, over their distance."""
    places_min: int = 9
    """Fewer places make no wall."""
    parallel_cosine_drop: float = 1e-4
    """One less the cosine of normals of one wall's elements."""


SETTINGS = MembraneSettings()


class StretchedWall:
    """One flat wall of a shell under tension.

    Parameters
    ----------
    model : ShellModel
        The shell.
    elements : (E,) bool
        Those of the wall.
    """

    def __init__(self, model: ShellModel, elements: BoolArray) -> None:
        self._free = np.flatnonzero(~model.fixed.ravel())
        corner = model.nodes_mm[model.quads[elements]]
        across = _across(corner)
        area_mm2 = 0.5 * float(np.linalg.norm(across, axis=1).sum())
        normal = across[0] / np.linalg.norm(across[0])
        aside = model.nodes_mm - corner.mean(axis=(0, 1))
        aside -= np.outer(aside @ normal, normal)
        corotational = Corotational(model)
        sides = []
        for step in (SETTINGS.stretch_step, -SETTINGS.stretch_step):
            state = replace(corotational.rest(), displacement_mm=step * aside)
            local = corotational.local(state)
            sides.append(corotational.element_tangents(local, local.forces))
        change = np.where(
            elements[:, None, None], (sides[0] - sides[1]) / (2.0 * SETTINGS.stretch_step), 0.0
        )
        whole = corotational.assembled((change + np.swapaxes(change, 1, 2)) / 2.0)
        self._change: Any = whole[self._free][:, self._free].tocsc()
        self._still: Any = model.stiffness[self._free][:, self._free].tocsc()
        stiff = float(np.mean(model.modulus_MPa * np.asarray(model.thickness_mm)))
        nu = model.poisson
        self._factor = (1.0 - nu) / (2.0 * area_mm2 * stiff * (1.0 + nu))

    def at(self, stretch: float) -> Callable[[FloatArray], FloatArray]:
        """What makes linear motion (6N, c) of loads (6N, c), of the wall at a stretch."""
        solved = splu((self._still + stretch * self._change).tocsc(), **SUPERLU)

        def moved(loads: FloatArray) -> FloatArray:
            out = np.zeros_like(loads)
            out[self._free] = solved.solve(np.ascontiguousarray(loads[self._free]))
            return out

        return moved

    def stretching(self, motion: FloatArray, other: FloatArray) -> FloatArray:
        """Stretch (c, d) that motions (6N, c) bring on with others (6N, d), at α = 1."""
        by_other = self._change @ other[self._free]
        return np.asarray(self._factor * (motion[self._free].T @ by_other))

    def halved_at(self, load: FloatArray, motion: FloatArray) -> float:
        """Stretch e₀ that takes half of the softness of one load (6N,) of a motion (6N,)."""
        unit = float(self.stretching(motion[:, None], motion[:, None])[0, 0])
        return self._factor * float(load @ motion) / unit


@dataclass(frozen=True, kw_only=True)
class WallTable:
    """One wall's places (q) in powers of the lost share v, from 0.

    Attributes
    ----------
    image : (k, q, 2n) float
        Shifts per newton, px.
    slope : (k, q, r) float
        Slopes of the wall by a newton, see :mod:`phytac_decoder.mechanics.membrane_stretching`.
    """

    image: FloatArray
    slope: FloatArray


def add_membrane_walls(
    shell: DiscResponse, see: ImageResponse, places: ResponseTable, uv: FloatArray
) -> tuple[ResponseTable, list[float]]:
    """Tables of places (p,) at chart positions (p, 2), with their flat walls if there are any.

    Returns
    -------
    places : Places
        Tables.
    give : list of float
        α of each wall.

    Raises
    ------
    NumericalError
        If the shell cannot be solved.
    """
    found = flat_walls(shell.model, places)
    if not found:
        return places, []
    number = np.full(len(uv), -1)
    tables, gives = [], []
    for one, (own, elements) in enumerate(found):
        table, give = _tabulated(shell, see, StretchedWall(shell.model, elements), uv[own], places)
        tables.append(table)
        gives.append(give)
        number[own] = one
    rows = np.zeros((len(uv), places.orders - 1, places.shift_px.shape[2]), dtype=np.float32)
    modes = max(table.slope.shape[2] for table in tables)
    slopes = np.zeros((len(uv), places.orders, modes), dtype=np.float32)
    for (own, _), table, give in zip(found, tables, gives, strict=True):
        # Places whose linear part is extrapolated are softer than this mesh.
        linear = zip(places.shift_px[own, 0], table.image[0], strict=True)
        ratio = np.array([force_ratio(*each) for each in linear])[:, None, None]
        rows[own] = ratio * np.moveaxis(table.image[1:], 0, 1)
        slope = np.sqrt(give) * ratio * np.moveaxis(table.slope, 0, 1)
        slopes[own, :, : slope.shape[2]] = slope
    whole = np.concatenate([places.shift_px, rows], axis=1)
    walls = BergerWall(wall=number, slopes=slopes, most=SETTINGS.lost_softness_max)
    return replace(places, shift_px=whole, walls=walls), gives


def flat_walls(model: ShellModel, places: ResponseTable) -> list[tuple[IntArray, BoolArray]]:
    """Places of each flat wall, and its elements (E,)."""
    corner = model.nodes_mm[model.quads]
    across = _across(corner)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    centre = corner.mean(axis=1)
    thick = float(np.max(model.thickness_mm))
    normal = np.cross(places.along, places.around)
    left = np.flatnonzero(places.flat)
    out = []
    while len(left):
        one = left[0]
        arm = places.point_mm[left] - places.point_mm[one]
        mine = normal[left] @ normal[one] > 1.0 - FLAT_COSINE_DROP
        mine &= np.abs(arm @ normal[one]) <= SETTINGS.coplanar_share * np.linalg.norm(arm, axis=1)
        own, left = left[mine], left[~mine]
        elements = np.abs(across @ normal[one]) > 1.0 - SETTINGS.parallel_cosine_drop
        elements &= np.abs((centre - places.point_mm[one]) @ normal[one]) < 1.5 * thick
        if len(own) >= SETTINGS.places_min and elements.any():
            out.append((own, elements))
    return out


def _across(corner: FloatArray) -> FloatArray:
    """Normals (E, 3) of quads (E, 4, 3), as long as twice their area."""
    return np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])


def _tabulated(
    shell: DiscResponse,
    see: ImageResponse,
    wall: StretchedWall,
    uv: FloatArray,
    places: ResponseTable,
) -> tuple[WallTable, float]:
    """Tables of a wall's places at ``uv`` (q, 2), at α = 1, and its α."""
    parts = [
        np.arange(k, min(k + SETTINGS.batch, len(uv))) for k in range(0, len(uv), SETTINGS.batch)
    ]
    loads: Any = hstack([csc_matrix(shell.linear(uv[own], places.radius_mm)[0]) for own in parts])
    loads = loads.tocsc()
    still = wall.at(0.0)
    # Motions whose products with any other give its slopes, of places all over the wall.
    some = still(loads[:, :: -(-len(uv) // SETTINGS.mode_places_max)].toarray())
    size, turn = np.linalg.eigh(wall.stretching(some, some))
    kept = np.argsort(-size)[: SETTINGS.modes_max]
    kept = kept[size[kept] > SETTINGS.mode_size_min * size[-1]]
    modes = (some @ turn[:, kept]) / np.sqrt(size[kept])

    def seen(moved: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, FloatArray]:
        motions = (moved(loads[:, own].toarray()) for own in parts)
        both = [(_images(shell, see, x), wall.stretching(x, modes)) for x in motions]
        images, slopes = zip(*both, strict=True)
        return np.concatenate(images), np.concatenate(slopes)

    image, slope = seen(still)
    discs = _independent_discs(slope)
    load = loads[:, discs].toarray()
    motion = still(load)
    half = wall.halved_at(load[:, 0], motion[:, 0])
    count = places.orders - 1
    nodes = (
        SETTINGS.lost_softness_max * (1.0 - np.cos(np.pi * (np.arange(count) + 1.0) / count)) / 2.0
    )
    images, slopes = [], []
    for v in nodes.tolist():
        now = seen(wall.at(half * v / (1.0 - v)))
        images.append((now[0] - image) / v)
        slopes.append((now[1] - slope) / v)
    table = WallTable(
        image=np.concatenate([image[None], _powers(nodes, np.stack(images))]),
        slope=np.concatenate([slope[None], _powers(nodes, np.stack(slopes))]) / np.sqrt(half),
    )
    few = WallTable(image=table.image[:, discs], slope=table.slope[:, discs])
    return table, _edge_factor(shell, see, few, load, motion)


def _powers(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Coefficients (k, …) of powers of v, from 0, through values (k, …) at nodes (k,)."""
    powers = nodes[:, None] ** np.arange(len(nodes))
    flat = np.linalg.solve(powers, values.reshape(len(nodes), -1))
    return np.asarray(flat.reshape(values.shape))


def _images(shell: DiscResponse, see: ImageResponse, motion: FloatArray) -> FloatArray:
    """Shifts (c, 2n) px of linear motions (6N, c)."""
    receptors = np.asarray(shell.kinematics.matrix @ motion).reshape(len(see.slope), 6, -1)
    return np.asarray(np.einsum("nij,njc->cni", see.slope, receptors).reshape(motion.shape[1], -1))


def _edge_factor(
    shell: DiscResponse, see: ImageResponse, table: WallTable, loads: FloatArray, still: FloatArray
) -> float:
    """α, by large displacements under the first of some discs (d) and under all.

    Parameters
    ----------
    loads, still : (6N, d) float
        Of a newton on each, and its linear motions.
    """
    lost = np.linspace(0.0, SETTINGS.lost_softness_max, SETTINGS.shares_tried)
    powers = lost[:, None] ** np.arange(len(table.image))
    top = float(shell.forces[-1])
    found = []
    for count, force in ((1, top / 2.0), (1, top), (SETTINGS.discs, top / 2.0)):
        load, motion = loads[:, :count].sum(axis=1), still[:, :count].sum(axis=1)
        large = shell.shell.approximate(force * load, force * motion)
        if large is None:
            continue
        seen = see.shift(shell.kinematics.large(large)).ravel() / force
        left = powers @ table.image[:, :count].sum(axis=1) - seen
        at = int(np.argmin(np.linalg.norm(left, axis=1)))
        slope = force * powers[at] @ table.slope[:, :count].sum(axis=1)
        found.append(lost[at] / (1.0 - lost[at]) / max(float(slope @ slope), 1e-12))
    return (
        float(np.exp(np.mean(np.log(np.clip(found, *SETTINGS.edge_factor_range)))))
        if found
        else 1.0
    )


def _independent_discs(slope: FloatArray) -> list[int]:
    """Places of slopes (q, r) that are soft, and do not slope alike."""
    size = np.sum(slope**2, axis=1)
    out = [int(np.argmax(size))]
    for _ in range(SETTINGS.discs - 1):
        alike = (slope @ slope[out].T) ** 2 / np.maximum(np.outer(size, size[out]), 1e-300)
        out.append(int(np.argmax(size * (1.0 - alike.max(axis=1)))))
    return out
