"""The closed mold, measured: common volume of its halves, and the cavities between them.

Independent of how the plates were built: a half of silicone is a block minus its tray, a cavity is
a column minus both halves.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.fabrication.molds.cavity import MoldSizes
from phytac_design.fabrication.molds.plate_grid import PlateLayout, SwitchKind
from phytac_design.fabrication.switch_set import revolved_volume_mm3
from phytac_design.geometry.triangles import TriangleMesh, merged, prisms
from phytac_design.solids.solid_mesh import box, to_manifold, to_triangles
from phytac_shapes.arrays import FloatArray

COLUMN_SIDES = 48


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A cavity against the switch that it is made for, the rubber's shrinkage undone.

    Attributes
    ----------
    volume_mm3 : float
        Volume of the shrunk rubber.
    volume_error : float
        Relative to the switch's.
    hausdorff_mm : float
        Largest distance between both surfaces, either way.
    """

    volume_mm3: float
    volume_error: float
    hausdorff_mm: float


def block(mesh: TriangleMesh, low_mm: float, high_mm: float, inset_mm: float) -> Any:
    """Box within a tray's frame, between two heights."""
    x, y = np.abs(mesh.vertices_mm[:, :2]).max(axis=0) - inset_mm
    return box(np.array([-x, -y, low_mm]), np.array([x, y, high_mm]))


def silicone_halves(parts: Mapping[str, TriangleMesh], sizes: MoldSizes) -> tuple[Any, Any]:
    """Silicone cast into both trays up to the lip: dome half and core half."""
    dome, core = parts["dome_tray"], parts["core_tray"]
    section = sizes.section
    # Half the frame's wall: the block's sides lie inside it at every height.
    inset = 0.5 * section.wall_mm
    over = block(dome, -section.fence_mm - 0.5 * section.backing_mm, sizes.top_mm, inset)
    under = block(core, -sizes.depth_mm, sizes.core_mm + 0.5 * section.backing_mm, inset)
    return over - to_manifold(dome), under - to_manifold(core)


def halves_of(parts: Mapping[str, TriangleMesh], sizes: MoldSizes) -> tuple[Any, Any]:
    """The two solids that close around the rubber: dome side and core side."""
    if sizes.section.way == "rigid":
        return to_manifold(parts["dome_plate"]), to_manifold(parts["core_plate"])
    return silicone_halves(parts, sizes)


def shared_mm3(first: Any, second: Any) -> float:
    """Volume that two solids share."""
    return float((first ^ second).volume())


def cavities_of(
    plan: PlateLayout, sizes: MoldSizes, halves: tuple[Any, Any]
) -> dict[SwitchKind, TriangleMesh]:
    """Cavity of the first switch of each kind, its axis at the origin."""
    # Plates are pressed together by this, so that no film is left where they touch but for
    # rounding: files are in single precision.
    pressed_mm = 1e-5
    cells = {run.kind: run.cells[0] for run in reversed(plan.runs)}
    radius = sizes.rim_mm + 0.5 * sizes.section.land_mm
    columns, centres = [], {}
    for kind, cell in cells.items():
        centre = plan.centre_mm([cell], sizes.pitch_mm)
        low = np.column_stack([centre, [2.0 * pressed_mm - sizes.cavities[kind].reach_mm]])
        high = np.column_stack([centre, [sizes.dome_mm + 0.1]])
        columns.append(prisms(low, high, radius, COLUMN_SIDES))
        centres[kind] = centre[0]
    rest = to_manifold(merged(columns)) - halves[0] - halves[1].translate((0.0, 0.0, pressed_mm))
    bodies = [to_triangles(body) for body in rest.decompose()]
    middle = np.array([0.5 * np.ptp(b.vertices_mm[:, :2], axis=0) for b in bodies])
    middle += np.array([b.vertices_mm[:, :2].min(axis=0) for b in bodies])
    found = {}
    for kind, centre in centres.items():
        near = int(np.hypot(*(middle - centre).T).argmin())
        body = bodies[near]
        found[kind] = TriangleMesh(
            vertices_mm=body.vertices_mm - [*centre, 0.0], triangles=body.triangles
        )
    return found


def fit_of(cavity: TriangleMesh, profile: FloatArray, shrink: float, sides: int) -> Fit:
    """Compare the shrunk content of a cavity with a switch's fine section (k, 2)."""
    aside_mm = 1e-4  # distance from a plane within which a corner is taken to lie on it
    scale = 1.0 - shrink
    volume = scale**3 * cavity.volume_mm3
    points = scale * cavity.vertices_mm
    line = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    profile_all, profile = profile, profile[1:-1]
    ahead = (np.abs(points[:, 1]) < aside_mm) & (points[:, 0] > -aside_mm)
    pairs = np.concatenate([cavity.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    pairs = pairs[ahead[pairs].all(axis=1) & (pairs[:, 0] < pairs[:, 1])]
    rings = np.unique(np.round(line, 6), axis=0)
    away = [_distance(rings, profile_all[:-1], profile_all[1:]).max()]
    for factor in (1.0, np.cos(np.pi / sides)):
        start, end = line[pairs[:, 0]] * [factor, 1.0], line[pairs[:, 1]] * [factor, 1.0]
        away.append(_distance(profile, start, end).max())
        away.append(_distance(0.5 * (start + end), profile_all[:-1], profile_all[1:]).max())
    return Fit(
        volume_mm3=volume,
        volume_error=volume / revolved_volume_mm3(profile_all) - 1.0,
        hausdorff_mm=float(max(away)),
    )


def key_gap_mm(plan: PlateLayout, sizes: MoldSizes, halves: tuple[Any, Any]) -> float:
    """Least gap between the keys and their sockets, above their feet."""
    low, high = 0.1 * sizes.key_height_mm, sizes.key_height_mm + sizes.section.key_clearance_mm
    return least_gap_mm(plan.centre_mm(plan.keys, sizes.pitch_mm), (low, high), sizes, halves)


def cap_gap_mm(plan: PlateLayout, sizes: MoldSizes, core: Any, cap: Any) -> float:
    """Least gap between the cap's bosses and their troughs."""
    cells = [run.cells[0] for run in plan.runs]
    span = (-sizes.depth_mm, 0.0)
    return least_gap_mm(plan.centre_mm(cells, sizes.pitch_mm), span, sizes, (core, cap))


def least_gap_mm(
    centres: FloatArray, span_mm: tuple[float, float], sizes: MoldSizes, pair: tuple[Any, Any]
) -> float:
    """Least distance of two solids in columns over cells, between two heights."""
    low, high = (np.column_stack([centres, np.full(len(centres), z)]) for z in span_mm)
    columns = to_manifold(prisms(low, high, 0.48 * sizes.pitch_mm, COLUMN_SIDES))
    first, second = (columns ^ solid for solid in pair)
    return float(first.min_gap(second, 2.0 * sizes.section.key_mm))


def _distance(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance of each point (n, 2) from the nearest of the segments (m, 2)."""
    way = end - start
    long = np.maximum(np.einsum("mi,mi->m", way, way), 1e-300)
    best = np.full(len(points), np.inf)
    for first in range(0, len(points), 1000):
        off = points[first : first + 1000, None] - start
        share = np.clip(np.einsum("nmi,mi->nm", off, way) / long, 0.0, 1.0)
        gap = np.linalg.norm(off - share[..., None] * way, axis=2)
        best[first : first + 1000] = gap.min(axis=1)
    return best
