"""Tables of what contacts at any place do to the markers' images, by the decoder's own mesh.

Linear theory gives the first power of the force, Koiter's expansion the second and third; the
camera is the true lens, and receptors turn with the wall's inner face (:mod:`feet`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from decoder.bundle_locator import LEAST_PLACES
from decoder.places import Places
from phytac_design.layout import Markers
from phytac_design.mechanics.compliance import column_turn
from phytac_design.mechanics.large.modified import Modified
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.pressure import Holes, tangent_frame, touch_loads
from phytac_design.mechanics.solve import ShellModel
from phytac_design.optics.view import Readers
from phytac_design.spec import Design
from phytac_design.twin.contacts import Contacts
from phytac_design.twin.feet import Feet
from phytac_design.twin.response import point_motions, turned_points
from phytac_design.twin.touch import flat_touches
from shapes import Surface
from shapes.arrays import BoolArray, FloatArray, IntArray
from shapes.errors import DesignError, NumericalError

BATCH = 32
"""Loads solved together."""
SERIES_MAX = 0.9
"""Largest the second and third term may be together over the first, at the greatest force."""
FINE = 513
"""Points along u that rings are spaced by."""
BYTES_MAX = 400e6
"""Largest tables; places stand wider apart where they would be larger."""


@dataclass(frozen=True, kw_only=True)
class Rings:
    """Places over a surface, in rings along u.

    Attributes
    ----------
    uv : (p, 2) float
        Places.
    base : (p,) int
        The place of the same ring that each is a turned copy of; itself where it is none.
    turns : (p,) int
        By how many columns it is turned from there.
    """

    uv: FloatArray
    base: IntArray
    turns: IntArray


@dataclass(frozen=True, kw_only=True)
class Tabulated:
    """Tables, and how they came about.

    Attributes
    ----------
    places : Places
        The tables.
    solves : int
        Places solved; the others are turned copies.
    unsure : int
        Of these, those whose series says nothing at the greatest force: linear ones stand there.
    """

    places: Places
    solves: int
    unsure: int


def rings(surface: Surface, spacing_mm: float, columns: int) -> Rings:
    """Places at most about ``spacing_mm`` apart; ``columns`` > 1 repeats them around so often."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, FINE), np.linspace(v0, v1, 65)
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
        per = max(int(np.ceil(width / spacing_mm / columns)), 1)
        number = 1 if width < 1e-6 * length[-1] else per * columns
        uv += [(at, v0 + (v1 - v0) * k / number) for k in range(number)]
        base += [start + k % per for k in range(number)]
        turns += [k // per for k in range(number)]
    return Rings(uv=np.array(uv), base=np.array(base), turns=np.array(turns))


def make_places(
    design: Design,
    surface: Surface,
    markers: Markers,
    *,
    mesh: ShellMesh,
    model: ShellModel,
    readers: Readers,
    arm_mm: FloatArray,
    spacing_mm: float,
    orders: int,
    near: Callable[[float, FloatArray], BoolArray] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Tabulated:
    """Tables over the whole surface, or a part of it.

    Where the shell repeats itself around (checked), the places of one column are solved and turned.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    mesh, model : ShellMesh, ShellModel
        The decoder's own shell.
    readers : Readers
        Cameras.
    arm_mm : (n, 3) float
        From each marker's place on the middle face to the paint that its camera sees.
    spacing_mm : float
        Between places, at most.
    orders : int
        Powers of the force: 1 (linear theory) to 3.
    near : callable, optional
        ``near(spacing, uv)`` says which of places (p, 2) so far apart are wanted; all without it.

    Raises
    ------
    NumericalError
        If the shell cannot be solved.
    DesignError
        If fewer than ``LEAST_PLACES`` are wanted.
    """
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    columns = markers.lattice.columns if markers.lattice else 1
    turn = column_turn(model, mesh, columns)
    least = np.sqrt(surface.area_mm2() * orders * 8.0 * markers.count / BYTES_MAX)
    spacing = max(spacing_mm, float(least))
    ring = rings(surface, spacing, columns if turn is not None else 1)
    wanted = np.arange(len(ring.uv)) if near is None else np.flatnonzero(near(spacing, ring.uv))
    if len(wanted) < LEAST_PLACES:
        raise DesignError(
            f"the part of the surface asked for holds {len(wanted)} places of the tables, "
            f"{spacing:.2g} mm apart; it takes {LEAST_PLACES}: widen it"
        )
    row = np.full(len(ring.uv), -1)
    row[wanted] = np.arange(len(wanted))
    solved = np.unique(ring.base[wanted])
    shell = _Pressed(design, surface, markers, mesh=mesh, model=model, orders=orders)
    see = _Seen(readers, markers.mid_mm, arm_mm)
    out = np.zeros((len(wanted), orders, 2 * markers.count), dtype=np.float32)
    copies = [wanted[ring.base[wanted] == base] for base in solved]
    unsure = 0
    for first in range(0, len(solved), BATCH):
        batch = solved[first : first + BATCH]
        for own, motions in zip(
            copies[first : first + BATCH], shell.motions(ring.uv[batch], radius), strict=True
        ):
            unsure += len(motions) < orders
            for place in own:
                turned = [_turned(m, turn, int(ring.turns[place]), columns) for m in motions]
                out[row[place], : len(motions)] = see.powers(turned, shell.forces)
        progress(f"places: {min(first + BATCH, len(solved))} of {len(solved)}")
    along, around = tangent_frame(surface, ring.uv[wanted])
    places = Places(
        point_mm=surface.point(ring.uv[wanted]),
        along=along,
        around=around,
        shift_px=out,
        radius_mm=radius,
    )
    return Tabulated(places=places, solves=len(solved), unsure=unsure)


class _Pressed:
    """Receptors' motion under discs."""

    def __init__(
        self,
        design: Design,
        surface: Surface,
        markers: Markers,
        *,
        mesh: ShellMesh,
        model: ShellModel,
        orders: int,
    ) -> None:
        receptor = design.receptor
        self.mesh, self.surface, self.model, self.orders = mesh, surface, model, orders
        self.holes = Holes.of(surface, markers.uv, receptor.diameter_hole_mm / 2.0)
        self.feet = Feet(mesh, surface, markers.uv, receptor.diameter_outer_mm / 2.0)
        self.shell = Modified(model)
        most = design.training.force_max_N
        self.forces = most * np.arange(1, orders) / max(orders - 1, 1)

    def motions(self, uv: FloatArray, radius_mm: float) -> list[list[FloatArray]]:
        """For each place the motion (n, 6) per newton, then that under each of the forces."""
        count = len(uv)
        touches = flat_touches(
            Contacts(
                sample=np.arange(count),
                uv=uv,
                radius_mm=np.full(count, radius_mm),
                force_N=np.ones(count),
                samples=count,
            )
        )
        loads = touch_loads(self.mesh, self.surface, touches, holes=self.holes).toarray()
        linear = self.model.solve(loads).motion.reshape(loads.shape)
        return [self._motions(loads[:, k], linear[:, k].copy()) for k in range(count)]

    def _motions(self, load: FloatArray, first: FloatArray) -> list[FloatArray]:
        out = [self.feet.linear(first)]
        if self.orders == 1:
            return out
        try:
            second, third = self.shell.series(load, first)
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError):
            return out
        most = float(self.forces[-1])
        more = np.linalg.norm((most * second + most**2 * third).reshape(-1, 6)[:, :3], axis=1)
        size = np.linalg.norm(first.reshape(-1, 6)[:, :3], axis=1)
        if not float(more.max()) <= SERIES_MAX * float(size.max()):
            return out
        return out + [
            self.feet.large(f * first + f**2 * second + f**3 * third) for f in self.forces
        ]


class _Seen:
    """What the cameras see of motion."""

    def __init__(self, readers: Readers, mid_mm: FloatArray, arm_mm: FloatArray) -> None:
        self.readers, self.arm_mm = readers, arm_mm
        self.watched = mid_mm + arm_mm
        self.rest = readers.project(self.watched)
        self.slope = readers.jacobian(self.watched)

    def powers(self, motions: list[FloatArray], forces: FloatArray) -> FloatArray:
        """Rows (k, 2n) of the powers of the force, exact at each of the forces (k - 1,)."""
        linear = point_motions(motions[0], self.arm_mm)
        first = np.einsum("nij,nj->ni", self.slope, linear).ravel()
        if len(motions) == 1:
            return np.asarray(first[None])
        rest = [
            ((self._shift(motion) / f) - first) / f
            for f, motion in zip(forces, motions[1:], strict=True)
        ]
        powers = forces[:, None] ** np.arange(len(forces))
        return np.concatenate([first[None], np.linalg.solve(powers, np.stack(rest))])

    def _shift(self, motion: FloatArray) -> FloatArray:
        moved = self.watched + turned_points(motion, self.arm_mm)
        return np.asarray(self.readers.project(moved) - self.rest).ravel()


def _turned(motion: FloatArray, turn: FloatArray | None, times: int, columns: int) -> FloatArray:
    """Motion (n, 6) of a load that is turned by some columns."""
    if turn is None or times == 0:
        return motion
    power = np.linalg.matrix_power(turn, times)
    field = motion.reshape(-1, columns, 2, 3) @ power.T
    return np.asarray(np.roll(field, times, axis=1).reshape(motion.shape))
