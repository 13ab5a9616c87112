"""Key nodes grouped to contacts, with place, force and size.

Places between markers lie on local quadrics, each fitted through a marker and its nearest others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray

Place = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """One contact of one frame.

    Attributes
    ----------
    markers : tuple of int
        Its key nodes, ascending.
    force_N : float
        Total force.
    position_mm : (x, y, z)
        Centroid by force, projected onto the surface.
    size_mm : float
        Diameter of the uniformly loaded disc with the same second moment; each marker's force is
        spread over its own cell.
    id : int
        Constant from frame to frame; -1 before tracking.
    since_s : float
        When it was first seen, on the source's clock.
    sd_N : float, optional
        Standard deviation of the force, where the estimator has it.
    shear_N, shear_sd_N : (x, y, z), optional
        Force along the surface and its standard deviations, where the markers determine it.
    """

    markers: tuple[int, ...]
    force_N: float
    position_mm: Place
    size_mm: float
    id: int = -1
    since_s: float = 0.0
    sd_N: float | None = None
    shear_N: Place | None = None
    shear_sd_N: Place | None = None


def group_key_nodes(koi: IntArray, neighbours: IntArray) -> list[list[int]]:
    """Return connected groups of key nodes, as rows of ``koi``, ascending.

    Parameters
    ----------
    koi : (m,) int
        Markers.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim; one direction is enough.
    """
    of = {marker: row for row, marker in enumerate(koi.tolist())}
    label = list(range(len(of)))

    def root(row: int) -> int:
        while label[row] != row:
            label[row] = label[label[row]]
            row = label[row]
        return row

    for row, near in enumerate(neighbours[koi].tolist()):
        for marker in near:
            if marker in of:
                label[root(row)] = root(of[marker])
    groups: dict[int, list[int]] = {}
    for row in range(len(label)):
        groups.setdefault(root(row), []).append(row)
    return list(groups.values())


def assign_to_contacts(
    markers: Sequence[IntArray], koi: IntArray, neighbours: IntArray
) -> list[IntArray] | None:
    """Return rows of ``koi`` of each contact, by its markers in the frame before.

    A new switch belongs to the contact next to it. None if that is no contact or several, or if a
    contact has lost all of its markers.

    Parameters
    ----------
    markers : sequence of (k,) int
        Key nodes of each contact; a contact without any gets none.
    koi : (m,) int
        Key nodes of this frame.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim.
    """
    owner = {marker: k for k, own in enumerate(markers) for marker in own.tolist()}
    rows: list[list[int]] = [[] for _ in markers]
    for row, marker in enumerate(koi.tolist()):
        near = [marker] if marker in owner else neighbours[marker].tolist()
        of = {owner[each] for each in near if each in owner}
        if len(of) != 1:
            return None
        rows[of.pop()].append(row)
    if any(len(own) and not now for own, now in zip(markers, rows, strict=True)):
        return None
    return [np.array(now, dtype=np.int64) for now in rows]


@dataclass(frozen=True, kw_only=True)
class ContactGrouper:
    """Groups the key nodes of a frame to contacts.

    Attributes
    ----------
    position_mm : (n, 3) float
        Markers on the outer face.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim.
    """

    position_mm: FloatArray
    neighbours: IntArray

    @cached_property
    def _near(self) -> tuple[IntArray, FloatArray]:
        """The twelve nearest others (n, 12) of each marker, and its distance (n,) mm to them."""
        gap = np.linalg.norm(self.position_mm[:, None] - self.position_mm[None], axis=2)
        order = np.argsort(gap, axis=1)[:, 1:13]
        # Of the four nearest: at a rim some of the eight neighbours are missing.
        four = np.take_along_axis(gap, order[:, :4], axis=1)
        spacing = np.median(four, axis=1) if len(gap) > 1 else np.ones(len(gap))
        return order, np.maximum(spacing, 1e-9)

    @cached_property
    def _quadrics(self) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Quadrics so far, by marker."""
        return {}

    @cached_property
    def spacing_mm(self) -> float:
        """Median distance of neighbouring markers."""
        return float(np.median(self._near[1]))

    def onto_surface(self, point_mm: FloatArray, markers: Sequence[int]) -> FloatArray:
        """Return the point (3,) of the outer face next to ``point_mm`` (3,).

        The face is the quadric around the nearest of ``markers``, fitted through it and the markers
        around with weights that fall with their distance; it ends two spacings from the marker.
        """
        gap = np.linalg.norm(self.position_mm[markers] - point_mm, axis=1)
        own = markers[int(gap.argmin())]
        axes, quadric = self._quadric(own)
        x, y = self._on_patch(own, axes, point_mm)
        z = quadric @ np.array([x, y, x * x, x * y, y * y])
        return np.asarray(self.position_mm[own] + np.array([x, y, z]) @ axes)

    def normals(self, points_mm: FloatArray, inside_mm: FloatArray) -> FloatArray:
        """Return outward unit normals (m, 3) of the outer face next to points (m, 3).

        Parameters
        ----------
        points_mm : (m, 3) float
            Points on the outer face; the nearest marker's quadric counts.
        inside_mm : (n, 3) float
            For each marker a point on the inner side of the wall, such as the camera.
        """
        out = np.empty((len(points_mm), 3))
        for k, point in enumerate(points_mm):
            own = int(np.linalg.norm(self.position_mm - point, axis=1).argmin())
            axes, c = self._quadric(own)
            x, y = self._on_patch(own, axes, point)
            slope = (c[0] + 2.0 * c[2] * x + c[3] * y, c[1] + c[3] * x + 2.0 * c[4] * y)
            normal = np.array([-slope[0], -slope[1], 1.0]) @ axes
            if normal @ (self.position_mm[own] - inside_mm[own]) < 0.0:
                normal = -normal
            out[k] = normal / np.linalg.norm(normal)
        return out

    def _quadric(self, marker: int) -> tuple[FloatArray, FloatArray]:
        """Axes (3, 3) at a marker, the normal last, and terms x, y, xx, xy, yy of the height."""
        if marker in self._quadrics:
            return self._quadrics[marker]
        spacing = self._near[1][marker]
        arm = self.position_mm[self._near[0][marker]] - self.position_mm[marker]
        weight = np.exp(-0.25 * np.sum((arm / (1.5 * spacing)) ** 2, axis=1))[:, None]
        # The last principal axis is the normal.
        axes = np.linalg.eigh((weight * arm).T @ (weight * arm))[1].T[::-1]
        x, y, z = axes @ arm.T
        terms = weight * np.column_stack([x, y, x * x, x * y, y * y])
        self._quadrics[marker] = axes, np.linalg.lstsq(terms, weight[:, 0] * z, rcond=1e-6)[0]
        return self._quadrics[marker]

    def _on_patch(self, marker: int, axes: FloatArray, point_mm: FloatArray) -> tuple[float, float]:
        """Coordinates of a point on a marker's quadric, at most two spacings from the marker."""
        x, y, _ = axes @ (point_mm - self.position_mm[marker])
        far = max(sqrt(x * x + y * y) / (2.0 * float(self._near[1][marker])), 1.0)
        return x / far, y / far

    def find(self, forces_N: FloatArray, koi: IntArray) -> list[Contact]:
        """Return the contacts, the strongest first.

        Parameters
        ----------
        forces_N : (n,) float
            Force on every marker.
        koi : (m,) int
            Key nodes of interest.
        """
        # Plain lists are faster than arrays for a dozen key nodes.
        markers, forces = koi.tolist(), forces_N[koi].tolist()
        out = [
            self._contact([markers[row] for row in group], [forces[row] for row in group])
            for group in group_key_nodes(koi, self.neighbours)
        ]
        return sorted(out, key=lambda contact: -contact.force_N)

    def _contact(self, markers: list[int], forces_N: list[float]) -> Contact:
        # K·u may be negative: such a force must not move the centroid off the contact.
        weight = np.array([max(force, 0.0) for force in forces_N])
        if not weight.sum() > 0.0:
            weight = np.ones(len(markers))
        weight /= weight.sum()
        places = self.position_mm[markers]
        centroid = weight @ places
        # Second moments: r²/2 of a uniform disc of radius r, a²/6 of a square cell of side a.
        cell = float(weight @ self._near[1][markers] ** 2) / 6.0
        moment = float(weight @ np.sum((places - centroid) ** 2, axis=1)) + cell
        if len(markers) > 1:
            centroid = self.onto_surface(centroid, markers)
        x, y, z = centroid.tolist()
        return Contact(
            markers=tuple(markers),
            force_N=sum(forces_N),
            position_mm=(x, y, z),
            size_mm=2.0 * sqrt(2.0 * moment),
        )
