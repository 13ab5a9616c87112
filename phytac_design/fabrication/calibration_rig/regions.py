"""The regions that are pressed, and the face of the indenter that fits each.

Heights are measured in a region's own frame: origin on the outer face, x along u, z along the
outward normal.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.calibration_rig.symmetry import Symmetry, find_symmetry
from phytac_design.geometry.boundary_loops import edge_distance_mm
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

FIT_mm = 0.045
"""Largest distance of a face from the surface of the regions it serves."""
RADIUS_MIN_mm = 0.8
"""Thinner indenters bend; regions that leave less room are left out."""
COSINE_MIN = 0.5
"""A face of an indenter leans at most 60 degrees from its plane: steeper sides are not pressed."""
RINGS, SECTORS = 2, 24


@dataclass(frozen=True, kw_only=True)
class Face:
    """Concave face of one indenter.

    Attributes
    ----------
    marker : int
        Region that it is cut from.
    radius_mm : float
        Radius of the pressed disc.
    """

    marker: int
    radius_mm: float


@dataclass(frozen=True, kw_only=True)
class Regions:
    """Regions to press, and the indenter of each.

    Attributes
    ----------
    symmetry : Symmetry
        Where the choice comes from.
    marker : (m,) int
        Regions, in the order in which they are pressed.
    face : (m,) int
        Which of ``faces`` presses each.
    faces : tuple of Face
        Indenters.
    too_near : (k,) int
        Needed markers that no indenter fits: too near a rim, or on too sharp an edge.
    """

    symmetry: Symmetry
    marker: IntArray
    face: IntArray
    faces: tuple[Face, ...]
    too_near: IntArray


def frames_at(surface: Surface, uv: FloatArray) -> FloatArray:
    """Axes (n, 3, 3), in columns: along u, across, outward normal."""
    normal = surface.normal(uv)
    along = surface.tangents(uv)[:, 0]
    along = along - np.sum(along * normal, axis=1)[:, None] * normal
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([along, np.cross(normal, along), normal], axis=2)


def heights_mm(surface: Surface, uv: FloatArray, xy: FloatArray) -> FloatArray:
    """Height of the outer face over the tangent planes at ``uv`` (n, 2), (n, k) mm.

    ``xy`` (k, 2) are places in the planes. Found by Newton's method along each normal, on the
    distance to the surface's foot. NaN where the normal misses the face, or meets it at a lean of
    more than 60 degrees.
    """
    rounds = 30
    frame, base = frames_at(surface, uv), surface.point(uv)
    places = base[:, None] + np.einsum("nij,kj->nki", frame[:, :, :2], xy)
    up = np.broadcast_to(frame[:, None, :, 2], places.shape).reshape(-1, 3)
    places = places.reshape(-1, 3)
    height = np.zeros(len(places))
    cosine = np.ones(len(places))
    todo = np.arange(len(places))
    for _ in range(rounds):
        at = places[todo] + height[todo, None] * up[todo]
        foot = surface.chart(at)
        normal = surface.normal(foot)
        gap = np.sum((at - surface.point(foot)) * normal, axis=1)
        cosine[todo] = np.sum(normal * up[todo], axis=1)
        height[todo] -= gap / np.maximum(cosine[todo], 0.2)
        todo = todo[np.abs(gap) > 1e-9]
        if len(todo) == 0:
            break
    height[todo] = np.nan
    height[cosine < COSINE_MIN] = np.nan
    return np.asarray(height.reshape(len(uv), len(xy)))


def disc_places(radius_mm: float, *, rings: int = RINGS, sectors: int = SECTORS) -> FloatArray:
    """Places on a disc: rings outwards, the centre last, (rings · sectors + 1, 2)."""
    angle = 2.0 * np.pi * np.arange(sectors) / sectors
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    radii = radius_mm * np.arange(1, rings + 1) / rings
    places = (radii[:, None, None] * ring[None]).reshape(-1, 2)
    return np.concatenate([places, np.zeros((1, 2))])


def fit_mm(heights: FloatArray) -> FloatArray:
    """Largest distance of each face (n, k) from each other one, pressed together, (n, n) mm."""
    apart = heights[:, None] - heights[None]
    return np.asarray((apart.max(axis=2) - apart.min(axis=2)) / 2.0)


def clear_mm(design: Design, surface: Surface, uv: FloatArray) -> FloatArray:
    """Distance from places on the outer face to the nearest rim that stands out of it, (n,)."""
    out = np.full(len(uv), np.inf)
    if design.wall.rim_length_mm > 0.0 and design.wall.rim_flange_mm > 0.0:
        for axis, end in surface.edges():
            out = np.minimum(out, edge_distance_mm(surface, uv, axis, end))
    return out


def follows(surface: Surface, uv: FloatArray, radius_mm: float) -> BoolArray:
    """Whether a disc of a radius around each place can follow the outer face, (n,)."""
    rings, sectors = 2, 72  # as many sectors as the faces of indenters have
    places = disc_places(radius_mm, rings=rings, sectors=sectors)
    return np.asarray(np.isfinite(heights_mm(surface, uv, places)).all(axis=1))


def radii_mm(design: Design, surface: Surface, uv: FloatArray) -> FloatArray:
    """Radius of the indenter for each place, (n,) mm: the smallest patch, narrower where needed.

    Near rims, and where it would hang over an edge; 0 where not even ``RADIUS_MIN_mm`` fits.
    """
    narrower = 0.75  # radii step down by this
    room = clear_mm(design, surface, uv) - design.kit.clearance_mm
    radius, size = np.zeros(len(uv)), design.training.patch_radius_min_mm
    least = min(RADIUS_MIN_mm, size)
    todo = np.arange(len(uv))
    while len(todo) and size >= least:
        fits = size <= room[todo]
        fits[fits] = follows(surface, uv[todo[fits]], size)
        radius[todo[fits]] = size
        todo, size = todo[~fits], narrower * size
    return radius


def make_regions(sensor: Sensor) -> Regions:
    """Regions by symmetry, and as few indenters as fit them."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    symmetry = find_symmetry(surface, markers)
    uv = markers.uv[symmetry.needed]
    radius = radii_mm(design, surface, uv)
    reached: BoolArray = radius > 0.0
    faces: list[Face] = []
    face = np.full(len(uv), -1)
    for size in np.unique(radius[reached])[::-1]:
        own = np.flatnonzero(radius == size)
        for seed, served in _covers(heights_mm(surface, uv[own], disc_places(float(size)))):
            face[own[served]] = len(faces)
            marker = int(symmetry.needed[own[seed]])
            faces.append(Face(marker=marker, radius_mm=float(size)))
    chosen, face = symmetry.needed[reached], face[reached]
    # One indenter after the other, up and down one column after the other.
    column = markers.column[chosen]
    along = np.where(column % 2 == 0, 1.0, -1.0) * markers.uv[chosen, 0]
    order = np.lexsort((along, column, face))
    return Regions(
        symmetry=symmetry,
        marker=chosen[order],
        face=face[order],
        faces=tuple(faces),
        too_near=symmetry.needed[~reached],
    )


def _covers(heights: FloatArray) -> list[tuple[int, IntArray]]:
    """Faces that serve all of (n, k), each the one that serves most of the remaining ones."""
    fits = fit_mm(heights) <= FIT_mm
    left = np.ones(len(heights), dtype=np.bool_)
    out = []
    while left.any():
        count = np.sum(fits & left[None], axis=1)
        seed = int(count.argmax())
        served = np.flatnonzero(fits[seed] & left)
        out.append((seed, served))
        left[served] = False
    return out
