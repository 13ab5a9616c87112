"""What a disc at a place does to receptors and to their images, in powers of its force.

The powers are fitted to the motion at a few forces, the greatest last; that motion is linear,
Koiter's expansion to third order, or large displacements where the expansion does not hold. Curved
walls soften as they are pressed in, and the terms of the expansion are then about a geometric
series, which is summed (Padé approximant).
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.cameras import Readers
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.discretisation import SETTINGS, force_ratio
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.linear_response import point_motions, rigid_slope, turned_points
from phytac_design.simulation.mesh_pair import MeshPair
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

LARGE_SOLVED_ABOVE = {4: 0.06, 5: 0.005}
"""Error of the expansion at the greatest force, in the norm of the stiffness, from which on
large displacements are solved, by the powers of the force that are kept. With fewer powers none
are."""
RATIO_MAX = 1.5
"""Largest ratio of linear motions on two meshes that higher powers are scaled by: beside a clamped
rim hardly anything moves, and meshes may differ by more than that."""
SUMMED_MAX = 0.5
"""Share of the stiffness that the greatest force takes away by a geometric series, up to which that
is summed."""


class _BeyondLinear(NamedTuple):
    """Motions (6N,) of one disc at the forces.

    Whether that is beyond the expansion, and whether large displacements were solved for it.
    """

    motions: list[FloatArray]
    beyond: bool
    solved: bool


class DiscResponse:
    """Receptors' motion under discs.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    mesh, model : ShellMesh, ShellModel
        Its shell.
    orders : int
        Powers of the force.

    Attributes
    ----------
    forces : (orders - 1,) float
        Forces (N) that motions are known at, besides the first newton.
    solved, beyond : int
        Discs so far that large displacements were solved for; that are beyond the expansion.
    """

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
        self.kinematics = ReceptorKinematics(
            mesh, surface, markers.uv, receptor.diameter_tube_mm / 2.0
        )
        self.shell = QuasiNewtonSolver(model)
        most = design.training.force_max_N
        self.forces = most * np.arange(1, orders) / max(orders - 1, 1)
        self.solved = self.beyond = 0

    def motions(self, uv: FloatArray, radius_mm: float) -> list[list[FloatArray]]:
        """For each place the motion (n, 6) per newton, then that under each of the forces.

        Of a place that is known to linear theory alone there is nothing more than the first.

        Parameters
        ----------
        uv : (c, 2) float
            Places.
        radius_mm : float
            Of the disc.

        Raises
        ------
        NumericalError
            If linear theory fails.
        """
        loads, linear = self.linear(uv, radius_mm)
        each = [linear[:, k].copy() for k in range(len(uv))]
        if self.orders == 1:
            return [[self.kinematics.linear(first)] for first in each]
        found = self.shell.together(
            [partial(self._beyond_linear, loads[:, k], first) for k, first in enumerate(each)]
        )
        self.beyond += sum(one.beyond for one in found)
        self.solved += sum(one.solved for one in found)
        return [
            [self.kinematics.linear(first), *map(self.kinematics.large, one.motions)]
            for first, one in zip(each, found, strict=True)
        ]

    def linear(self, uv: FloatArray, radius_mm: float) -> tuple[FloatArray, FloatArray]:
        """Loads (6N, c) of a newton on discs at places (c, 2), and their linear motions (6N, c).

        Raises
        ------
        NumericalError
            If linear theory fails.
        """
        loads = self.loads(uv, radius_mm, (0.0, 0.0))
        return loads, self._solve(loads)

    def sheared(self, uv: FloatArray, radius_mm: float) -> list[list[FloatArray]]:
        """For each place the linear motions (n, 6) by a newton along the surface on a disc.

        Those of the directions of growing u, and square to it.

        Raises
        ------
        NumericalError
            If linear theory fails.
        """
        pressed = self.loads(uv, radius_mm, (0.0, 0.0))
        motions = [
            self._solve(self.loads(uv, radius_mm, friction) - pressed)
            for friction in ((1.0, 0.0), (0.0, 1.0))
        ]
        return [
            [self.kinematics.linear(motion[:, k].copy()) for motion in motions]
            for k in range(len(uv))
        ]

    def loads(self, uv: FloatArray, radius_mm: float, friction: tuple[float, float]) -> FloatArray:
        """Return loads (6N, c) of a newton on discs at places (c, 2), with friction over it."""
        count = len(uv)
        touches = Contacts.flat(
            sample=np.arange(count),
            uv=uv,
            radius_mm=np.full(count, radius_mm),
            force_N=np.ones(count),
            samples=count,
        )
        touches = replace(touches, friction=np.tile(friction, (count, 1)))
        loads = indentation_loads(self.mesh, self.surface, touches, holes=self.holes)
        return np.asarray(loads.toarray())

    def _solve(self, loads: FloatArray) -> FloatArray:
        return self.model.solve(loads).motion.reshape(loads.shape)

    def _beyond_linear(self, load: FloatArray, first: FloatArray) -> _BeyondLinear:
        """Motions at the forces, by a load (6N,) of a newton and its linear motion (6N,)."""
        # The same from which on a sensor is beyond the expansion.
        series_error_max = LARGE_SOLVED_ABOVE[4]
        series = self._series(load, first)
        gap = self._gap(load, first, series) if self.orders in LARGE_SOLVED_ABOVE else 0.0
        large: list[FloatArray] = []
        if self.orders in LARGE_SOLVED_ABOVE and not gap <= LARGE_SOLVED_ABOVE[self.orders]:
            large = self._large(load, first)
        # A gap that is no number holds nowhere.
        beyond = not gap <= series_error_max
        return _BeyondLinear(motions=large or series, beyond=beyond, solved=bool(large))

    def _series(self, load: FloatArray, first: FloatArray) -> list[FloatArray]:
        """Motions (6N,) at the forces by Koiter's expansion; none where it says nothing."""
        # Largest the second and third term may be together over the first, at the greatest force.
        series_terms_max = 0.9
        try:
            found = self.shell.expand(load, first)
        except (ArithmeticError, NumericalError, np.linalg.LinAlgError):
            return []
        most = float(self.forces[-1])
        second, third = found.second, found.third
        more = np.linalg.norm((most * second + most**2 * third).reshape(-1, 6)[:, :3], axis=1)
        size = np.linalg.norm(first.reshape(-1, 6)[:, :3], axis=1)
        if not float(more.max()) <= series_terms_max * float(size.max()):
            return []
        ratio = float(third @ second) / max(float(second @ second), 1e-30)
        if not 0.0 <= most * ratio <= SUMMED_MAX:
            ratio = 0.0
        rest = third - ratio * second
        return [f * first + (f**2 * second + f**3 * rest) / (1.0 - ratio * f) for f in self.forces]

    def _gap(self, load: FloatArray, first: FloatArray, series: list[FloatArray]) -> float:
        """Error of the expansion at the greatest force; inf where it says nothing."""
        if not series:
            return float("inf")
        most = float(self.forces[-1])
        try:
            return self.shell.gap(most * load, series[-1], most * first)
        except (ArithmeticError, NumericalError):
            return float("inf")

    def _large(self, load: FloatArray, first: FloatArray) -> list[FloatArray]:
        """The same by large displacements; none where one of them cannot be solved."""
        out: list[FloatArray] = []
        for force in self.forces.tolist():
            motion = self.shell.approximate(force * load, force * first)
            if motion is None:
                return []
            out.append(motion)
        return out


class ExtrapolatedResponse:
    """Receptors' linear motion under discs, extrapolated from two meshes to elements of size 0.

    The error of a mesh falls with the square of its elements' size
    (:mod:`phytac_design.mechanics.shell.discretisation`). Shifts per newton of ``cylinder60`` with
    4 elements a pitch are off by 3 % (5 % beside rims) and with 8 by 1.1 % (1.7 %); extrapolated
    from 8 and 4 by 0.4 % (0.6 %), from 6 and 4 by 0.5 % (1.4 %).

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    pair : MeshPair
        Its shell.

    Attributes
    ----------
    claimed : list of float
        Of each disc so far, how far its motion may be off because of the meshes, relative: root
        mean square over the receptors, three times what the extrapolation changed.
    """

    def __init__(self, design: Design, surface: Surface, markers: Markers, pair: MeshPair) -> None:
        self.pair = pair
        self.each = [
            DiscResponse(design, surface, markers, mesh=mesh, model=model, orders=1)
            for mesh, model in pair.each
        ]
        self.claimed: list[float] = []

    def motions(self, uv: FloatArray, radius_mm: float) -> list[list[FloatArray]]:
        """Return for each place (c, 2) the motion (n, 6) per newton, see ``DiscResponse``."""
        fine, coarse = (each.motions(uv, radius_mm) for each in self.each)
        return [[one] for one in self._limits(fine, coarse)]

    def beside(
        self, own: DiscResponse, found: list[list[FloatArray]], uv: FloatArray, radius_mm: float
    ) -> list[FloatArray]:
        """Motion (n, 6) per newton where ``own`` has ``found`` its motions: not solved twice."""
        fine, coarse = (
            found if each.model is own.model else each.motions(uv, radius_mm) for each in self.each
        )
        return self._limits(fine, coarse)

    def sheared(self, uv: FloatArray, radius_mm: float) -> list[list[FloatArray]]:
        """Return for each place (c, 2) the motions (n, 6), see ``DiscResponse``."""
        fine, coarse = (each.sheared(uv, radius_mm) for each in self.each)
        return [
            [one + self.pair.correction(one, other) for one, other in zip(*both, strict=True)]
            for both in zip(fine, coarse, strict=True)
        ]

    def _limits(
        self, fine: list[list[FloatArray]], coarse: list[list[FloatArray]]
    ) -> list[FloatArray]:
        out = []
        for (one, *_), (other, *_) in zip(fine, coarse, strict=True):
            change = self.pair.correction(one, other)
            out.append(one + change)
            size = float(np.linalg.norm(out[-1][:, :3]))
            change_size = float(np.linalg.norm(change[:, :3]))
            self.claimed.append(SETTINGS.safety_outside * change_size / max(size, 1e-300))
        return out


def scaled_powers(rows: FloatArray, first: FloatArray) -> FloatArray:
    """Rows of the powers of the force on one mesh, with the first power of a finer one.

    A finer mesh is softer: it moves as a coarser one does under a force that is larger by the ratio
    of their linear motions. So the k-th power grows with the k-th power of that ratio.

    Parameters
    ----------
    rows : (k, 2n) float
        Shifts by the powers of the force.
    first : (2n,) float
        The first of them, on the finer mesh.
    """
    ratio = min(force_ratio(first, rows[0]), RATIO_MAX)
    out = rows * ratio ** np.arange(1, len(rows) + 1)[:, None]
    out[0] = first
    return np.asarray(out)


class ImageResponse:
    """What the cameras see of motion.

    Parameters
    ----------
    readers : Readers
        Cameras.
    mid_mm : (n, 3) float
        Markers on the middle face.
    arm_mm : (n, 3) float
        From there to the paint that the camera sees.
    slope : (n, 2, 6) float, optional
        How the image of each marker's paint moves with the wall under it, px per mm and radian;
        that of the point that is watched if not given.
    """

    def __init__(
        self,
        readers: Readers,
        mid_mm: FloatArray,
        arm_mm: FloatArray,
        slope: FloatArray | None = None,
    ) -> None:
        self.readers, self.arm_mm = readers, arm_mm
        self.watched = mid_mm + arm_mm
        self.rest = readers.project(self.watched)
        point = rigid_slope(readers.jacobian(self.watched), arm_mm)
        self.slope = point if slope is None else slope
        self.more = self.slope - point

    def powers(self, motions: list[FloatArray], forces: FloatArray) -> FloatArray:
        """Rows (k, 2n) of the powers of the force, exact at each of the forces (k - 1,)."""
        first = np.einsum("nij,nj->ni", self.slope, motions[0]).ravel()
        if len(motions) == 1:
            return np.asarray(first[None])
        rest = [
            (self.shift(motion).ravel() / f - first) / f
            for f, motion in zip(forces, motions[1:], strict=True)
        ]
        powers = forces[:, None] ** np.arange(len(forces))
        return np.concatenate([first[None], np.linalg.solve(powers, np.stack(rest))])

    def pull(self, row: FloatArray) -> FloatArray:
        """Force and moment (n, 6) on each receptor whose work is ``row`` (2n,) times its shifts."""
        return np.asarray(np.einsum("nij,ni->nj", self.slope, row.reshape(-1, 2)))

    def shift(self, motion: FloatArray, *, linear: bool = False) -> FloatArray:
        """Shifts (…, n, 2) px under motion (…, n, 6): translations mm, rotation vectors rad.

        That of the point watched through the true lens, and, to first order, what the paint that
        comes into sight and goes out of it does besides.

        Parameters
        ----------
        linear : bool
            Motion is linear theory's, whose rotations are infinitesimal.
        """
        moved = (point_motions if linear else turned_points)(motion, self.arm_mm)
        seen = self.readers.project(self.watched + moved) - self.rest
        return np.asarray(seen + np.einsum("nij,...nj->...ni", self.more, motion))
