"""Regions to press: one marker of each set that is equal by symmetry.

Turns about the sensor's axis and mirrors through it are tried on the markers themselves: one
counts if it maps every marker onto a marker of the same paint and height, and the surface onto
itself. On a spiral of two colours that leaves two neighbouring columns, as in the paper.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

SAME_mm = 1e-6
"""Markers closer than this are one."""


@dataclass(frozen=True, kw_only=True)
class Symmetry:
    """Symmetries of the markers, and one marker of each class.

    Attributes
    ----------
    maps : (k, n) int
        Marker that each marker goes to, for each symmetry; the first is none at all.
    turns, mirrors : int
        Turns (the whole circle included) and mirrors among them.
    needed : (m,) int
        One marker of each set of markers that are alike.
    alike : (n,) int
        The needed marker that stands for each marker.
    """

    maps: IntArray
    turns: int
    mirrors: int
    needed: IntArray
    alike: IntArray


def find_symmetry(surface: Surface, markers: Markers) -> Symmetry:
    """Symmetries of a sensor, and the markers they leave; the lowest columns stand for all."""
    points = surface.point(markers.uv)
    maps, turns, mirrors = [np.arange(markers.count)], 1, 0
    for matrix, mirrored in _candidates(points):
        found = _mapping(points, markers, matrix)
        if found is not None and _onto_itself(surface, matrix):
            maps.append(found)
            turns, mirrors = turns + (not mirrored), mirrors + mirrored
    every = np.stack(maps)
    # A set's lowest column, then its lowest number, stands for it.
    rank = np.lexsort((np.arange(markers.count), markers.column))
    order = np.empty(markers.count, dtype=np.int64)
    order[rank] = np.arange(markers.count)
    alike = every[order[every].argmin(axis=0), np.arange(markers.count)]
    return Symmetry(maps=every, turns=turns, mirrors=mirrors, needed=np.unique(alike), alike=alike)


def _candidates(points: FloatArray) -> list[tuple[FloatArray, bool]]:
    """Turns and mirrors (3, 3) that map one marker onto another of its height and distance."""
    x, y, z = points.T
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    off = np.flatnonzero(radius > 0.01 * max(float(radius.max()), SAME_mm))
    if len(off) == 0:
        return []
    like = np.abs(z[off, None] - z[off]) < SAME_mm
    like &= np.abs(radius[off, None] - radius[off]) < SAME_mm
    # Of the marker with the fewest peers: every symmetry maps it onto one of them.
    first = off[int(like.sum(axis=1).argmin())]
    peers = off[like[int(like.sum(axis=1).argmin())]]
    out: list[tuple[FloatArray, bool]] = []
    for peer in peers.tolist():
        turn = float(np.mod(angle[peer] - angle[first], 2.0 * np.pi))
        if min(turn, 2.0 * np.pi - turn) > 1e-9:
            out.append((_turned(turn), False))
        out.append((_turned(float(angle[peer] + angle[first]), mirrored=True), True))
    return out


def _turned(angle: float, *, mirrored: bool = False) -> FloatArray:
    """Turn (3, 3) about z, or the mirror through the plane of the axis at half the angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]]) * (
        1.0 if mirrored else np.array([1.0, -1.0, 1.0])
    )


def _mapping(points: FloatArray, markers: Markers, matrix: FloatArray) -> IntArray | None:
    from scipy.spatial import cKDTree

    gap, onto = cKDTree(points).query(points @ matrix.T)
    same = bool(np.all(gap < SAME_mm)) and len(np.unique(onto)) == markers.count
    if not same or np.any(markers.colour[onto] != markers.colour):
        return None
    if np.abs(markers.height_mm[onto] - markers.height_mm).max() > SAME_mm:
        return None
    return np.asarray(onto, dtype=np.int64)


def _onto_itself(surface: Surface, matrix: FloatArray) -> bool:
    """Whether points of the surface are mapped onto it, inside its edges."""
    grid = 9  # places each way at which the surface is compared with itself
    (u0, u1), (v0, v1) = surface.domain
    u = np.linspace(u0, u1, grid)
    v = v0 + (v1 - v0) * (np.arange(grid) + 0.37) / grid
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    moved = surface.point(uv) @ matrix.T
    foot = surface.chart(moved)
    span = surface.domain[:, 1] - surface.domain[:, 0]
    inside = (foot >= surface.domain[:, 0] - 1e-6 * span) & (
        foot <= surface.domain[:, 1] + 1e-6 * span
    )
    inside |= np.array(surface.periodic)
    gap = np.linalg.norm(surface.point(foot) - moved, axis=1)
    return bool(inside.all() and gap.max() < SAME_mm)
