"""Pressure of shaped indenters on the outer face, and the nodal forces it makes.

- ``flat``: even over a disc;
- ``sphere``: Hertz's p ∝ √(1 - (r/a)²) over a disc of radius a;
- ``cylinder``: a strip of half-width b, p ∝ √(1 - (y/b)²) across it and even along it.

A place under a contact is given in millimetres (x, y) by its chord from the centre (:mod:`contact`)
laid along its direction as seen along the centre's normal. Such a map needs no chart, so seams
and poles are places like any other. It keeps the areas of a sphere (it is Lambert's map there)
and those of a tube to (d/R)²/32; across a tube lengths are short by (d/R)²/24.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.indenter import CYLINDER, FLAT, SPHERE, Indentations
from phytac_design.mechanics.meshing.locate import outside
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.loads import PressurePatches, UniformDiscs, dot, spread_loads
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class ContactFrames:
    """Local frames and shapes of c contacts on the outer face.

    Attributes
    ----------
    at, normal : (c, 3) float
        Centres, mm, and outward unit normals there.
    kind : (c,) int
        ``FLAT``, ``SPHERE`` or ``CYLINDER``.
    half_mm, length_mm : (c,) float
        Radius of a disc or half-width of a strip; length of a strip.
    axis, across : (c, 3) float
        Unit vectors of x and y in the tangent plane: a strip's own, growing u and square to it
        for a disc.
    """

    at: FloatArray
    normal: FloatArray
    kind: IntArray
    half_mm: FloatArray
    length_mm: FloatArray
    axis: FloatArray
    across: FloatArray

    @property
    def reach_mm(self) -> FloatArray:
        """Farthest place under each contact from its centre, (c,)."""
        return np.where(
            self.kind == CYLINDER, np.hypot(self.half_mm, self.length_mm / 2.0), self.half_mm
        )

    def places(self, contact: IntArray, arm_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates x, y (p, q) of places ``arm_mm`` (p, q, 3) off contacts (p,)."""
        x, y = dot(arm_mm, self.axis[contact]), dot(arm_mm, self.across[contact])
        stretch = np.linalg.norm(arm_mm, axis=2) / np.maximum(np.hypot(x, y), 1e-300)
        return x * stretch, y * stretch

    def __call__(
        self, patch: IntArray, arm_mm: FloatArray, mean_mm: FloatArray, longest_mm: FloatArray
    ) -> FloatArray:
        """See :class:`loads.Pressure`; the peak of each is 1."""
        out = UniformDiscs(radii_mm=self.half_mm)(patch, arm_mm, mean_mm, longest_mm)
        kind = self.kind[patch]
        ball = np.flatnonzero(kind == SPHERE)
        if len(ball):
            distance = np.linalg.norm(arm_mm[ball], axis=2)
            out[ball] = _mean_of_hertz(distance, self.half_mm[patch[ball]], mean_mm[ball])
        rod = np.flatnonzero(kind == CYLINDER)
        if len(rod):
            x, y = self.places(patch[rod], arm_mm[rod])
            width = longest_mm[rod]
            out[rod] = _soft_hertz(y, self.half_mm[patch[rod]], width)
            out[rod] *= _soft_ends(x, self.length_mm[patch[rod]] / 2.0, width)
        return out


@dataclass(frozen=True, kw_only=True)
class Holes:
    """Round holes through the wall: nothing presses on them.

    Attributes
    ----------
    at : scipy.spatial.cKDTree
        Their centres on the outer face, mm.
    radius_mm : float
        Of each.
    """

    at: Any
    radius_mm: float

    @classmethod
    def of(cls, surface: Surface, uv: FloatArray, radius_mm: float) -> "Holes | None":
        """Holes around chart places (n, 2); None where there is no hole."""
        from scipy.spatial import cKDTree

        if len(uv) == 0 or radius_mm <= 0.0:
            return None
        return cls(at=cKDTree(surface.point(uv)), radius_mm=radius_mm)

    def carried(self, places_mm: FloatArray, width_mm: FloatArray) -> FloatArray:
        """Share (p, q) of cells at places (p, q, 3), ``width_mm`` (p,) wide, that is wall."""
        # Cells farther from any hole are all wall: a distance of inf says the same, and sooner.
        reach = self.radius_mm + float(width_mm.max(initial=0.0))
        distance, _ = self.at.query(places_mm.reshape(-1, 3), distance_upper_bound=reach)
        distance = distance.reshape(places_mm.shape[:2])
        share = (distance - self.radius_mm) / width_mm[:, None] + 0.5
        return np.asarray(np.clip(share, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class PressureWithHoles:
    """Pressure of contacts on a wall with holes."""

    whole: ContactFrames
    holes: Holes

    def __call__(
        self, patch: IntArray, arm_mm: FloatArray, mean_mm: FloatArray, longest_mm: FloatArray
    ) -> FloatArray:
        """See :class:`loads.Pressure`."""
        out = self.whole(patch, arm_mm, mean_mm, longest_mm)
        hit = np.flatnonzero(out.any(axis=1))
        places = self.whole.at[patch[hit]][:, None] + arm_mm[hit]
        out[hit] *= self.holes.carried(places, mean_mm[hit])
        return out


def _over_a_line(half: FloatArray, width: FloatArray) -> FloatArray:
    """Half-widths (p,) that are finite, and far below the resolution of cells ``width`` wide."""
    return np.maximum(half, 1e-6 * width)


def _mean_of_hertz(r: FloatArray, half: FloatArray, width: FloatArray) -> FloatArray:
    """Mean of √(1 - (r/a)²) over intervals of length ``width`` (p,) about r (p, q), a (p,)."""
    a, w = _over_a_line(half, width)[:, None], width[:, None]
    ends = [np.clip((r + side * w / 2.0) / a, -1.0, 1.0) for side in (1.0, -1.0)]
    upper, lower = (0.5 * (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) for x in ends)
    return np.asarray((upper - lower) * a / w)


def _soft_hertz(y: FloatArray, half: FloatArray, width: FloatArray) -> FloatArray:
    """√(1 - (y/b)²) averaged by a hat of half-width ``width`` (p,), at y (p, q), b (p,).

    A hat gives a line its total, and its place, on cells that it crosses at any angle; a plain
    mean does not.
    """
    b, w = _over_a_line(half, width)[:, None], width[:, None]

    def twice_integrated(y: FloatArray) -> FloatArray:
        x = np.clip(y / b, -1.0, 1.0)
        rest = np.sqrt(1.0 - x * x)
        beyond = 0.5 * np.pi * (np.abs(y / b) - np.abs(x))
        return np.asarray(0.5 * (x * np.arcsin(x) + rest - rest**3 / 3.0 + beyond))

    return _second_difference(twice_integrated, y, w) * (b / w) ** 2


def _soft_ends(x: FloatArray, half: FloatArray, width: FloatArray) -> FloatArray:
    """1 where |x| < half (p,), 0 beyond, averaged by the same hat; x (p, q)."""
    ends, w = _over_a_line(half, width)[:, None], width[:, None]

    def twice_integrated(x: FloatArray) -> FloatArray:
        inner = np.minimum(np.abs(x), ends)
        return np.asarray(0.5 * inner**2 + ends * (np.abs(x) - inner))

    return _second_difference(twice_integrated, x, w) / w**2


def _second_difference(
    function: Callable[[FloatArray], FloatArray], x: FloatArray, width: FloatArray
) -> FloatArray:
    return np.asarray(function(x + width) - 2.0 * function(x) + function(x - width))


def contact_frames(surface: Surface, contacts: Indentations) -> ContactFrames:
    """Frames of contacts on the surface."""
    normal = surface.normal(contacts.uv)
    u, v = tangent_frame(surface, contacts.uv)
    turn = np.where(contacts.indenter == CYLINDER, contacts.turn_rad, 0.0)[:, None]
    axis = np.cos(turn) * u + np.sin(turn) * v
    return ContactFrames(
        at=surface.point(contacts.uv),
        normal=normal,
        kind=contacts.indenter,
        half_mm=contacts.radius_mm,
        length_mm=contacts.length_mm,
        axis=axis,
        across=np.cross(normal, axis),
    )


def tangent_frame(surface: Surface, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction of growing u, and square to it, right-handed about the normal, (n, 3) each."""
    along = surface.tangents(uv)[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.cross(surface.normal(uv), along)


def indentation_loads(
    mesh: ShellMesh, surface: Surface, contacts: Indentations, *, holes: Holes | None = None
) -> Any:
    """Nodal loads of contacts, per newton of the normal force of each.

    The resultant along the inward normal at the centre is exactly 1 N, that of friction along its
    own direction is exactly ``friction`` times that; see :func:`loads.spread_loads` for rims,
    small patches, and the moment of friction, which acts half a thickness off the nodes.

    Parameters
    ----------
    mesh : ShellMesh
        Mesh of the middle face.
    surface : Surface
        The outer face.
    contacts : Indentations
        Contacts; their forces are not used.
    holes : Holes, optional
        Where the wall is open: the rest of a contact presses the more. One that stands on nothing
        but a hole is a point force.

    Returns
    -------
    scipy.sparse.csc_matrix, (6N, c)
        Forces in N and moments in N mm, DOF order as in the solver.

    Raises
    ------
    DesignError
        As :func:`check_indentations`.
    NumericalError
        If a contact reaches around an edge so far that friction alone presses with more than 1 N.
    """
    check_indentations(surface, contacts)
    frames = contact_frames(surface, contacts)
    drag: FloatArray | None = None
    if np.any(contacts.friction):
        u, v = tangent_frame(surface, contacts.uv)
        drag = contacts.friction[:, :1] * u + contacts.friction[:, 1:] * v
    pressure = frames if holes is None else PressureWithHoles(whole=frames, holes=holes)
    patches = PressurePatches(
        uv=contacts.uv, reach_mm=frames.reach_mm, pressure=pressure, drag=drag
    )
    return spread_loads(mesh, surface, patches)


def check_indentations(surface: Surface, contacts: Indentations) -> None:
    """Reject contacts that are invalid or off the surface.

    Raises
    ------
    DesignError
        For the first kind of mistake found, with the first contact that has it.
    """
    numbers = (
        contacts.uv,
        contacts.radius_mm,
        contacts.force_N,
        contacts.length_mm,
        contacts.turn_rad,
        contacts.friction,
    )
    table = np.column_stack(numbers)
    max_friction = 5.0  # rubber on glass reaches 3; more is a slip of the pen
    known = (contacts.indenter >= FLAT) & (contacts.indenter <= CYLINDER)
    short = (contacts.indenter == CYLINDER) & (contacts.length_mm <= 0.0)
    (u0, u1), (v0, v1) = surface.domain
    chart = f"u from {u0:.6g} to {u1:.6g}, v from {v0:.6g} to {v1:.6g}"
    _refuse(
        ~np.isfinite(table).all(axis=1),
        table,
        "contact-not-finite",
        "a number is not finite",
        "give finite numbers",
    )
    _refuse(
        ~known,
        contacts.indenter,
        "indenter-unknown",
        "the indenter is not known",
        "use 0 (flat), 1 (sphere) or 2 (cylinder)",
    )
    _refuse(
        contacts.radius_mm < 0.0,
        contacts.radius_mm,
        "contact-radius-negative",
        "radius_mm is negative",
        "use 0 or more",
    )
    _refuse(
        contacts.force_N < 0.0,
        contacts.force_N,
        "contact-force-negative",
        "force_N is negative",
        "contacts only push",
    )
    _refuse(
        short,
        contacts.length_mm,
        "contact-length-not-positive",
        "a cylinder's length_mm is not positive",
        "give the length of its strip in mm",
    )
    _refuse(
        np.hypot(*contacts.friction.T) > max_friction,
        contacts.friction,
        "contact-friction-too-large",
        f"friction is more than {max_friction:g} times the normal force",
        "give tangential over normal force, not newtons",
    )
    _refuse(
        outside(surface, contacts.uv),
        contacts.uv,
        "contact-off-surface",
        f"the centre is off the surface ({chart})",
        "move it onto the surface",
    )


def _refuse(bad: Any, value: FloatArray | IntArray, code: str, what: str, fix: str) -> None:
    if np.any(bad):
        first = int(np.argmax(bad))
        raise DesignError(
            code,
            f"contact {first}: {what} (got {value[first].tolist()}; {int(bad.sum())} in all); "
            f"{fix}",
        )
