"""Shares of contacts on the switches of one sensor, for simulators that ask in every frame.

A round patch away from rims and strong bends is a disc: distances to the switches are all that
:func:`phytac_design.mechanics.shell.footprints.footprint_shares` needs of it. Places of switches,
rims and normals are computed once. Any other patch is left to that function.
"""

import numpy as np

from phytac_design.mechanics.indenter import FLAT, SPHERE, Indentations
from phytac_design.mechanics.shell.footprints import (
    SETTINGS,
    footprint_shares,
    hertz_disc_share,
)
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.discs import disc_overlap_share

RIM_POINTS, TILES_ACROSS = 256, 64
"""Points that stand for an open edge; tiles along each axis of the chart that stand for a wall."""


class SwitchLoads:
    """Shares of contacts on switches.

    Parameters
    ----------
    surface : Surface
        The outer face.
    marker_uv : (n, 2) float
        Chart positions of the markers.
    footprint_radius_mm : float
        Radius of the switches' footprints.
    """

    def __init__(self, surface: Surface, marker_uv: FloatArray, footprint_radius_mm: float) -> None:
        self._surface, self._uv, self._radius_mm = surface, marker_uv, footprint_radius_mm
        self._marker, self._facing = surface.point(marker_uv), surface.normal(marker_uv)
        low, high = surface.domain.T
        step = (high - low) / TILES_ACROSS
        side = np.arange(TILES_ACROSS) + 0.5
        grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        self._tile, self._tile_normal = (
            part(low + grid * step) for part in (surface.point, surface.normal)
        )
        sides = np.linalg.norm(surface.tangents(low + grid * step) * step[:, None], axis=2)
        self._tile_mm = float(np.linalg.norm(sides, axis=1).max())
        rims = [np.zeros((0, 2))]
        for axis, end in surface.edges():
            rim = np.empty((RIM_POINTS, 2))
            rim[:, axis] = surface.domain[axis, end]
            rim[:, 1 - axis] = np.linspace(low[1 - axis], high[1 - axis], RIM_POINTS)
            rims.append(rim)
        self._rim = surface.point(np.concatenate(rims))

    def shares(
        self, contacts: Indentations, point_mm: FloatArray, normal: FloatArray
    ) -> FloatArray:
        """Share of each contact's normal force on each switch, (c, n).

        Parameters
        ----------
        contacts : Indentations
            Contacts; their forces are not used.
        point_mm, normal : (c, 3) float
            Their centres on the outer face, and the outward normals there.

        Raises
        ------
        DesignError
            As :func:`phytac_design.mechanics.shell.pressure.check_indentations`.
        """
        if not self._plain(contacts, point_mm, normal):
            return footprint_shares(self._surface, contacts, self._uv, self._radius_mm)
        out = np.zeros((len(contacts.uv), len(self._marker)))
        for k in range(len(out)):
            gap = np.linalg.norm(self._marker - point_mm[k], axis=1)
            half = max(float(contacts.radius_mm[k]), SETTINGS.min_half_width_mm)
            near = np.flatnonzero(gap <= half + self._radius_mm)
            near = near[self._facing[near] @ normal[k] > 0.0]
            law = hertz_disc_share if contacts.indenter[k] == SPHERE else disc_overlap_share
            size = np.full(len(near), half)
            out[k, near] = law(gap[near], size, np.full(len(near), self._radius_mm))
        return out

    def _plain(self, contacts: Indentations, point_mm: FloatArray, normal: FloatArray) -> bool:
        """Whether all contacts are round, off the rims, and on a wall that bends little."""
        known = (contacts.indenter == FLAT) | (contacts.indenter == SPHERE)
        whole = np.isfinite(contacts.uv).all() and np.isfinite(contacts.radius_mm).all()
        if not (whole and known.all() and (contacts.radius_mm > 0.0).all()):
            return False
        for radius, at, out in zip(contacts.radius_mm, point_mm, normal, strict=True):
            under = _squares(self._tile - at) <= (radius + self._tile_mm) ** 2
            if (self._tile_normal[under] @ out <= SETTINGS.flat_cosine).any():
                return False
            reach = SETTINGS.rim_margin * radius
            if (_squares(self._rim - at) <= reach**2).any():
                return False
        return True


def _squares(arm_mm: FloatArray) -> FloatArray:
    """Squared lengths (n,) of arms (n, 3); faster than a norm."""
    return np.asarray(np.einsum("ni,ni->n", arm_mm, arm_mm))
