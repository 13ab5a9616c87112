"""Places over a surface, and how a sensor that repeats itself around turns onto itself."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.layout import Markers
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.compliance import landing
from phytac_design.simulation.pressed_series import ImageResponse
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

IMAGE_TOLERANCE = 2e-3
"""How far images of turned motion may be from turned images, over their size. Paint in sight is
measured in pixels, which do not turn: shipped designs have 0.4 ‰."""
MOTION_TRIED = 1e-2
"""Motion (mm and rad) by which images are compared."""


@dataclass(frozen=True, kw_only=True)
class PlaceRings:
    """Places over a surface, in rings along u.

    Attributes
    ----------
    uv : (p, 2) float
        Places.
    base : (p,) int
        The place of the same ring that each is a turned copy of; itself where it is none.
    turns : (p,) int
        By how many sectors it is turned from there.
    """

    uv: FloatArray
    base: IntArray
    turns: IntArray

    def landing(self) -> IntArray:
        """Return the place (p,) that each lands on when all turn by one sector."""
        places = list(zip(self.base.tolist(), self.turns.tolist(), strict=True))
        number = {place: k for k, place in enumerate(places)}
        return np.array([number.get((base, turns + 1), base) for base, turns in places])


def rings(surface: Surface, spacing_mm: float, sectors: int) -> PlaceRings:
    """Places at most about ``spacing_mm`` apart; ``sectors`` > 1 repeats them around so often."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, 513), np.linspace(v0, v1, 65)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    metric = surface.metric(grid).reshape(len(u), len(v), 2, 2)
    along = np.sqrt(metric[..., 0, 0]).max(axis=1)
    length = np.append(0.0, np.cumsum((along[1:] + along[:-1]) / 2.0 * np.diff(u)))
    around = np.trapezoid(np.sqrt(metric[..., 1, 1]), v, axis=1)
    steps = max(int(np.ceil(length[-1] / spacing_mm)), 2)
    uv: list[tuple[float, float]] = []
    base: list[int] = []
    turns: list[int] = []
    for place in np.linspace(0.0, length[-1], steps + 1):
        at = float(np.interp(place, length, u))
        width = float(np.interp(at, u, around))
        start = len(uv)
        if not surface.periodic[1]:
            number = max(int(np.ceil(width / spacing_mm)), 2)
            uv += [(at, float(k)) for k in np.linspace(v0, v1, number + 1)]
            base += range(start, len(uv))
            turns += [0] * (number + 1)
            continue
        per = max(int(np.ceil(width / spacing_mm / sectors)), 1)
        number = 1 if width < 1e-6 * length[-1] else per * sectors
        uv += [(at, v0 + (v1 - v0) * k / number) for k in range(number)]
        base += [start + k % per for k in range(number)]
        turns += [k // per for k in range(number)]
    return PlaceRings(uv=np.array(uv), base=np.array(base), turns=np.array(turns))


@dataclass(frozen=True, kw_only=True)
class Symmetry:
    """How a sensor and places on it turn onto themselves, sector by sector.

    Attributes
    ----------
    sectors : int
        How many.
    turn : (3, 3) float
        Rotation by one.
    node, marker, place : (N,), (n,), (p,) int
        The one that each lands on.
    base : (b,) int
        Places that all others are turned copies of.
    image : (2, 2) float
        Rotation of shifts: turned ones are ``shift @ image``.
    """

    sectors: int
    turn: FloatArray
    node: IntArray
    marker: IntArray
    place: IntArray
    base: IntArray
    image: FloatArray

    def motion(self, motion: FloatArray) -> FloatArray:
        """Nodes' motion (6N, k), turned by one sector."""
        out = np.empty_like(motion)
        field = motion.reshape(-1, 2, 3, motion.shape[1])
        out.reshape(field.shape)[self.node] = np.einsum("xy,nayk->naxk", self.turn, field)
        return out

    def shifts(self, shifts: FloatArray) -> FloatArray:
        """Images (k, 2n), turned by one sector."""
        out = np.empty_like(shifts)
        field = shifts.reshape(len(shifts), -1, 2)
        out.reshape(field.shape)[:, self.marker] = field @ self.image
        return out

    def copies(
        self, values: NDArray[Any], turned: Callable[[NDArray[Any]], NDArray[Any]]
    ) -> Iterator[tuple[IntArray, NDArray[Any]]]:
        """The base's places and their values, then those turned by one sector, two, and so on."""
        places = self.base
        for _ in range(self.sectors):
            yield places, values
            places, values = self.place[places], turned(values)


def symmetry_of(
    mesh: ShellMesh,
    markers: Markers,
    see: ImageResponse,
    ring: PlaceRings,
    sectors: int,
    turn: FloatArray,
) -> Symmetry | None:
    """Symmetry of a sensor whose shell and markers repeat themselves; None if images do not.

    Parameters
    ----------
    mesh, markers, see : ShellMesh, Markers, ImageResponse
        The sensor.
    ring : PlaceRings
        Places in as many sectors.
    sectors : int
        Sectors of shell and markers.
    turn : (3, 3) float
        Rotation by one.
    """
    if sectors < 2 or mesh.around is None or markers.lattice is None:
        return None
    around, columns = mesh.around, markers.lattice.columns
    plain = Symmetry(
        sectors=sectors,
        turn=turn,
        node=landing(len(mesh.nodes_mm), around, around // sectors),
        marker=landing(markers.count, columns, columns // sectors),
        place=ring.landing(),
        base=np.unique(ring.base),
        image=np.eye(2),
    )
    motion = MOTION_TRIED * np.random.default_rng(0).normal(size=(markers.count, 6))
    seen = see.shift(turned_receptors(motion, turn, 1, columns, sectors))
    moved = plain.shifts(see.shift(motion).reshape(1, -1)).reshape(-1, 2)
    # The rotation that is nearest (Procrustes).
    left, _, right = np.linalg.svd(moved.T @ seen)
    image = left @ right
    misfit = np.linalg.norm(moved @ image - seen) / np.linalg.norm(seen)
    return replace(plain, image=image) if misfit <= IMAGE_TOLERANCE else None


def markers_turn(markers: Markers, turn: FloatArray, step: int) -> bool:
    """Whether markers land on those ``step`` columns on."""
    if markers.lattice is None or markers.count % markers.lattice.columns:
        return False
    mid = markers.mid_mm.reshape(-1, markers.lattice.columns, 3)
    gap = np.abs(mid @ turn.T - np.roll(mid, -step, axis=1)).max()
    return bool(gap <= 1e-6 * np.abs(mid).max())


def turned_receptors(
    motion: FloatArray, turn: FloatArray | None, times: int, columns: int, sectors: int
) -> FloatArray:
    """Motion (n, 6) of a load that is turned by some sectors."""
    if turn is None or times == 0:
        return motion
    power = np.linalg.matrix_power(turn, times)
    field = motion.reshape(-1, columns, 2, 3) @ power.T
    return np.asarray(np.roll(field, times * (columns // sectors), axis=1).reshape(motion.shape))
