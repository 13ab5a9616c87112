r"""The wall with its two rims, made from the surface interface alone.

One station of the chart's v gives a closed loop in the (along, offset) plane::

      offset  +flange  4--3                          3--4     "extension" is measured from the
                       |  |         outer face       |  |     end of the sensing surface along
                    0  |  2--------------------------2  |     its conormal (tangent to the
                       |                                |     surface, square to the boundary)
            -thickness 5--6--------------------------6--5
                       rim           inner face      rim      u ->
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.fabrication.triangles import TriangleMesh, torus_triangles
from phytac_design.spec import WallSection
from shapes import Surface
from shapes.arrays import FloatArray
from shapes.errors import DesignError

STATIONS_MIN = 24
PROBE = 64


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Nodes of the closed loop, in order; all arrays run over nodes.

    Attributes
    ----------
    u : (p,) float
        Chart coordinate of the foot.
    offset_mm : (p,) float
        Distance outward from the outer face.
    extension_mm : (p,) float
        Signed distance beyond the end of the chart along the conormal: negative beyond u0.
    """

    u: FloatArray
    offset_mm: FloatArray
    extension_mm: FloatArray


def wall_profile(surface: Surface, wall: WallSection, *, intervals: int = 1) -> Profile:
    """Loop of the wall's cross-section, the faces sampled in ``intervals`` equal steps of u."""
    u0, u1 = surface.domain[0]
    along = np.linspace(u0, u1, intervals + 1)
    rim, flange, inner = wall.rim_length_mm, wall.rim_flange_mm, -wall.thickness_mm
    face = [(u, 0.0, 0.0) for u in along]
    back = [(u, inner, 0.0) for u in along[::-1]]
    if rim == 0.0:
        nodes = face + back
    else:
        step = [0.0] if flange > 0.0 else []
        near = [(u0, flange, -rim)] + [(u0, flange, z) for z in step]
        far = [(u1, flange, z) for z in step] + [(u1, flange, rim)]
        nodes = near + face + far + [(u1, inner, rim), *back, (u0, inner, -rim)]
    table = np.array(nodes, dtype=np.float64)
    return Profile(u=table[:, 0], offset_mm=table[:, 1], extension_mm=table[:, 2])


def profile_points(surface: Surface, profile: Profile, v: FloatArray) -> FloatArray:
    """Points of the loop at each station, (stations, p, 3) mm, on the exact surfaces."""
    v = np.asarray(v, dtype=np.float64)
    stations, nodes = len(v), len(profile.u)
    uv = np.column_stack([np.tile(profile.u, stations), np.repeat(v, nodes)])
    points = surface.point(uv, np.tile(profile.offset_mm, stations))
    along, around = np.moveaxis(surface.tangents(uv), 1, 0)
    around = around / np.linalg.norm(around, axis=1, keepdims=True)
    conormal = along - np.einsum("ni,ni->n", along, around)[:, None] * around
    conormal = conormal / np.linalg.norm(conormal, axis=1, keepdims=True)
    points = points + np.tile(profile.extension_mm, stations)[:, None] * conormal
    return np.asarray(points.reshape(stations, nodes, 3))


def wall_mesh(surface: Surface, wall: WallSection, *, tolerance_mm: float) -> TriangleMesh:
    """Closed mesh of the wall and its rims, within ``tolerance_mm`` of the true faces.

    Corners are moved off the true face by a twelfth of the second difference along each chart
    direction, which gives each cross-section the area of the true one (for a circle:
    r' = r·sqrt(θ / sin θ), θ = 2π/n, to fourth order; derived here).

    Raises
    ------
    DesignError
        If the surface is not open along u and closed around v (other topologies come later).
    """
    if surface.periodic != (False, True):
        raise DesignError(
            f"a shell on shape {surface.name!r} cannot be built yet: only surfaces that close "
            f"around v and are open along u can (got periodic {surface.periodic}); "
            "choose such a shape, for example 'cylinder'"
        )
    intervals = _intervals(surface, wall, tolerance_mm)
    profile = wall_profile(surface, wall, intervals=intervals)
    (v0, v1) = surface.domain[1]
    stations = _stations(surface, profile, tolerance_mm)
    v = v0 + (v1 - v0) * np.arange(stations) / stations
    points = profile_points(surface, profile, v)
    normals = surface.normal(
        np.column_stack([np.tile(profile.u, stations), np.repeat(v, len(profile.u))])
    ).reshape(points.shape)
    lift = _sag(points, normals, axis=0) + _sag_along(points, normals, profile)
    points = points + lift[..., None] * normals
    mesh = TriangleMesh(
        vertices_mm=points.reshape(-1, 3), triangles=torus_triangles(stations, len(profile.u))
    )
    return mesh if mesh.volume_mm3 > 0.0 else mesh.flipped()


def _sag(points: FloatArray, normals: FloatArray, *, axis: int) -> FloatArray:
    """Twelfth of the second difference along a closed direction, outward positive, mm."""
    second = np.roll(points, 1, axis) - 2.0 * points + np.roll(points, -1, axis)
    return np.asarray(-np.einsum("...i,...i->...", second, normals) / 12.0)


def _sag_along(points: FloatArray, normals: FloatArray, profile: Profile) -> FloatArray:
    """Return the same along u, for nodes that have both neighbours on their own face; else 0."""
    own = (profile.extension_mm == 0.0) & (profile.offset_mm <= 0.0)
    level = np.where(own, profile.offset_mm, np.inf)
    inside = own & (level == np.roll(level, 1)) & (level == np.roll(level, -1))
    return np.where(inside, _sag(points, normals, axis=1), 0.0)


def _stations(surface: Surface, profile: Profile, tolerance_mm: float) -> int:
    """Stations around v (a multiple of 4) that keep the chords within the tolerance."""
    (v0, v1) = surface.domain[1]
    v = v0 + (v1 - v0) * np.arange(PROBE) / PROBE
    points = profile_points(surface, profile, v)
    normals = surface.normal(
        np.column_stack([np.tile(profile.u, PROBE), np.repeat(v, len(profile.u))])
    ).reshape(points.shape)
    worst = np.abs(_sag(points, normals, axis=0)).max()
    return max(STATIONS_MIN, 4 * int(np.ceil(PROBE * np.sqrt(worst / tolerance_mm) / 4.0)))


def _intervals(surface: Surface, wall: WallSection, tolerance_mm: float) -> int:
    """Intervals along u that keep the chords within the tolerance; 1 where the face is straight."""
    profile = wall_profile(surface, wall, intervals=PROBE)
    (v0, v1) = surface.domain[1]
    v = v0 + (v1 - v0) * np.arange(8) / 8
    points = profile_points(surface, profile, v)
    normals = surface.normal(
        np.column_stack([np.tile(profile.u, 8), np.repeat(v, len(profile.u))])
    ).reshape(points.shape)
    worst = np.abs(_sag_along(points, normals, profile)).max()
    return max(1, int(np.ceil(PROBE * np.sqrt(worst / tolerance_mm) - 1e-6)))
