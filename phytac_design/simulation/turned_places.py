"""Places over a surface, and how a sensor that repeats itself around turns onto itself."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.layout import Markers
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.compliance import turns_of
from phytac_design.mechanics.shell.solve import ShellModel
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

    def turned(self) -> IntArray:
        """Return the place (p,) that each comes to when all turn by one sector."""
        places = list(zip(self.base.tolist(), self.turns.tolist(), strict=True))
        number = {place: k for k, place in enumerate(places)}
        return np.array([number.get((base, turns + 1), base) for base, turns in places])


def rings(surface: Surface, spacing_mm: float, sectors: int) -> PlaceRings:
    """Places at most about ``spacing_mm`` apart, the same ones in each of so many sectors."""
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
class SectorSymmetry:
    """How a sensor and places on it repeat themselves around, sector by sector.

    Attributes
    ----------
    sectors : int
        How many.
    turn : (3, 3) float
        Rotation by one.
    around, columns : int
        Nodes of the mesh, and markers, in each line around.
    pixel_turn : (n, 2, 2) float
        Rotation that shifts of each marker make in its camera's image: ``shift @ pixel_turn``.
    ring : PlaceRings
        Places.
    """

    sectors: int
    turn: FloatArray
    around: int
    columns: int
    pixel_turn: FloatArray
    ring: PlaceRings

    @cached_property
    def base(self) -> IntArray:
        """Places (b,) that all others are turned copies of."""
        return np.unique(self.ring.base)

    @cached_property
    def place(self) -> IntArray:
        """The place (p,) that each comes to by a turn."""
        return self.ring.turned()

    def turn_nodes(self, motion: FloatArray) -> FloatArray:
        """Turn the nodes' motion (6N, k) by one sector."""
        field = motion.reshape(-1, 6, motion.shape[1])
        step = self.around // self.sectors
        turned = turned_motion(field, self.turn, self.around, step)
        return turned.reshape(motion.shape)

    def turn_shifts(self, shifts: FloatArray) -> FloatArray:
        """Turn shifts (k, 2n) by one sector."""
        field = np.einsum("kni,nij->knj", shifts.reshape(len(shifts), -1, 2), self.pixel_turn)
        lines = field.reshape(len(shifts), -1, self.columns, 2)
        turned = np.roll(lines, self.columns // self.sectors, axis=2)
        return np.asarray(turned.reshape(shifts.shape))

    def copies(
        self, values: NDArray[Any], turned: Callable[[NDArray[Any]], NDArray[Any]]
    ) -> Iterator[tuple[IntArray, NDArray[Any]]]:
        """Yield the base and its values, then places and values turned by one sector, two, ..."""
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
) -> SectorSymmetry | None:
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
    found = pixel_turns(see.shift, markers, see.readers.read_by, sectors, turn)
    if found is None:
        return None
    return SectorSymmetry(
        sectors=sectors,
        turn=turn,
        around=mesh.around,
        columns=markers.lattice.columns,
        pixel_turn=found,
        ring=ring,
    )


def pixel_turns(
    shift: Callable[[FloatArray], FloatArray],
    markers: Markers,
    camera: IntArray,
    sectors: int,
    turn: FloatArray,
) -> FloatArray | None:
    """Rotation (n, 2, 2) that shifts of each marker make as all turn; None if they do otherwise.

    Parameters
    ----------
    shift : callable
        Motion (n, 6) of the markers -> shifts (n, 2) px.
    markers : Markers
        Markers that come to stand on each other by the turn.
    camera : (n,) int
        Camera of each.
    sectors, turn : int, (3, 3) float
        Sectors, and rotation by one.
    """
    columns = markers.lattice.columns if markers.lattice else 1
    step = columns // sectors
    motion = MOTION_TRIED * np.random.default_rng(0).normal(size=(markers.count, 6))
    still, turned = shift(motion), shift(turned_motion(motion, turn, columns, step))
    # Of each marker where it then stands.
    turned = np.roll(turned.reshape(-1, columns, 2), -step, axis=1).reshape(-1, 2)
    found = np.empty((markers.count, 2, 2))
    for each in np.unique(camera):
        own = camera == each
        # The rotation that is nearest (Procrustes).
        left, _, right = np.linalg.svd(still[own].T @ turned[own])
        found[own] = left @ right
    misfit = np.linalg.norm(np.einsum("ni,nij->nj", still, found) - turned)
    return found if misfit <= IMAGE_TOLERANCE * np.linalg.norm(turned) else None


def sectors_of(
    model: ShellModel, mesh: ShellMesh, markers: Markers
) -> tuple[int, FloatArray | None]:
    """Sectors that shell and markers repeat themselves in, and the turn (3, 3) by one.

    1 and None where they do not.
    """
    columns = markers.lattice.columns if markers.lattice else 1
    sectors, turn = turns_of(model, mesh, columns)
    if turn is None or not markers_turn(markers, turn, columns // sectors):
        return 1, None
    return sectors, turn


def repeated_markers(markers: Markers, sectors: int) -> IntArray:
    """For each marker (n,), the one of the first sector that it is a turned copy of."""
    columns = markers.lattice.columns if markers.lattice else 1
    row, column = np.divmod(np.arange(markers.count), columns)
    return np.asarray(row * columns + column % (columns // sectors))


def turned_motion(motion: FloatArray, turn: FloatArray, around: int, step: int) -> FloatArray:
    """Motion of nodes or receptors, turned about the axis.

    Parameters
    ----------
    motion : (n, 6) or (n, 6, k) float
        Translations and rotations, in lines around the axis.
    turn : (3, 3) float
        Rotation.
    around : int
        How many stand in a line.
    step : int
        Places in its line by which each moves on.
    """
    field = motion.reshape(-1, around, 2, 3, *motion.shape[2:])
    turned = np.einsum("xy,lnay...->lnax...", turn, field)
    return np.asarray(np.roll(turned, step, axis=1).reshape(motion.shape))


def markers_turn(markers: Markers, turn: FloatArray, step: int) -> bool:
    """Whether markers come to stand on those ``step`` columns on."""
    if markers.lattice is None or markers.count % markers.lattice.columns:
        return False
    mid = markers.mid_mm.reshape(-1, markers.lattice.columns, 3)
    gap = np.abs(mid @ turn.T - np.roll(mid, -step, axis=1)).max()
    return bool(gap <= 1e-6 * np.abs(mid).max())
