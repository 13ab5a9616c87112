"""A shell parted for a smaller bed: pieces with pegs and sockets in bosses on the inner face."""

from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.design.spec import Design, WallSection
from phytac_design.fabrication.printing.cuts import CuttingPlane, plan_cuts, receptor_spans
from phytac_design.geometry.triangles import prisms
from phytac_design.layout import Markers
from phytac_design.layout.receptor_distances import segment_distance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import TOLERANCE_mm, to_manifold, to_triangles
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError, NumericalError


@dataclass(frozen=True, kw_only=True)
class KeySize:
    """Sizes of a key, mm: diameters of peg, socket and boss, length of the peg and of its root.

    The socket runs through its boss, which is as long as the peg: it drains, the tip shows.
    """

    peg: float
    socket: float
    boss: float
    length: float
    root: float


@dataclass(frozen=True, kw_only=True)
class Parting:
    """Pieces of a shell.

    Attributes
    ----------
    pieces : list
        Manifolds, in order along the cuts.
    cuts : list of CuttingPlane
        Where it is cut.
    keys_mm : (n, 3) float
        Middle of each key, on its cut.
    size : KeySize
        Of all keys.
    boss_volume_mm3 : float
        Added to the shell.
    clearance_volume_mm3 : float
        Sockets less the pegs in them.
    """

    pieces: list[Any]
    cuts: list[CuttingPlane]
    keys_mm: FloatArray
    size: KeySize
    boss_volume_mm3: float
    clearance_volume_mm3: float


def key_sizes(rules: PrintSection) -> list[KeySize]:
    """Keys that a printer can make, longest first."""
    # Length of pegs, and depth of their roots, over their diameter: the longest that have room.
    keys = ((2.0, 1.2), (1.3, 0.8), (0.9, 0.5))
    peg_mm = 1.2  # thinnest peg: one that does not break off by hand
    peg = max(peg_mm, rules.post_short_mm[0])
    socket = peg + 2.0 * rules.clearance_mm
    wall = max(rules.wall_free_min_mm, rules.wall_min_mm)
    return [
        KeySize(
            peg=peg, socket=socket, boss=socket + 2.0 * wall, length=long * peg, root=deep * peg
        )
        for long, deep in keys
    ]


def part_shell(sensor: Sensor, solid: Any, *, tolerance_mm: float = TOLERANCE_mm) -> Parting:
    """Part a shell so that each piece fits the bed.

    Parameters
    ----------
    solid : manifold3d.Manifold
        The shell.
    tolerance_mm : float
        Of its facets: bosses end on the same ones.

    Raises
    ------
    DesignError
        If it cannot be parted between receptors, or keys have no room.
    NumericalError
        If a piece is not one body.
    """
    design, surface = sensor.design, sensor.surface
    keys_min = 2
    # Where in the gap between two rows a cut is made: in its middle, or at the upper row.
    in_gap = (0.5, 1.0)
    corners = to_triangles(solid).vertices_mm
    sizes = key_sizes(design.print_rules)
    for size, share in product(sizes, in_gap):
        cuts = plan_cuts(sensor, corners, size.length, share)
        keys = [_keys(sensor, cut, cuts, size) for cut in cuts]
        if all(len(at) >= keys_min for at in keys):
            break
    else:
        raise DesignError(
            "parting-keys-no-room",
            "the shell's parts cannot be keyed: between receptors there is no room for bosses of "
            f"{sizes[-1].boss:.1f} mm around pegs; lower print_rules.clearance_mm or "
            "print_rules.wall_free_min_mm, or leave more room in the layout",
        )
    layer = WallSection(thickness_mm=size.boss, rim_length_mm=0.0)
    inside = to_manifold(wall_mesh(surface, layer, tolerance_mm=tolerance_mm))
    whole = solid
    for cut, at in zip(cuts, keys, strict=True):
        whole = whole + (_rods(at, cut.normal, (-size.root, size.length), size.boss) ^ inside)
    pieces, clearance = [whole], 0.0
    for cut, at in zip(cuts, keys, strict=True):
        parted = [_parted(piece, cut, at, size) for piece in pieces]
        pieces = [part for parts, _ in parted for part in parts]
        clearance += sum(volume for _, volume in parted)
    _refuse_torn(pieces)
    return Parting(
        pieces=pieces,
        cuts=cuts,
        keys_mm=np.concatenate([np.zeros((0, 3)), *keys]),
        size=size,
        boss_volume_mm3=float(whole.volume() - solid.volume()),
        clearance_volume_mm3=clearance,
    )


def _parted(
    piece: Any, cut: CuttingPlane, at_mm: FloatArray, size: KeySize
) -> tuple[list[Any], float]:
    """Both sides of a cut, the lower one with pegs, the upper one with sockets; their clearance."""
    over_mm = 0.02  # how far a socket's cutter runs beyond its boss, so that faces never coincide
    upper, lower = piece.split_by_plane(cut.normal.tolist(), cut.offset_mm)
    if upper.is_empty() or lower.is_empty():
        return [piece], 0.0
    corners = to_triangles(piece).vertices_mm
    own = at_mm[np.all((at_mm >= corners.min(axis=0)) & (at_mm <= corners.max(axis=0)), axis=1)]
    if len(own) == 0:
        return [lower, upper], 0.0
    pegs = _rods(own, cut.normal, (-size.root, size.length), size.peg)
    sockets = _rods(own, cut.normal, (-size.root, size.length + over_mm), size.socket)
    clearance = (sockets ^ upper).volume() - (pegs - lower).volume()
    return [lower + pegs, upper - sockets], float(clearance)


def _rods(
    at_mm: FloatArray, axis: FloatArray, ends_mm: tuple[float, float], diameter_mm: float
) -> Any:
    sides = 24
    first, last = (at_mm + end * axis for end in ends_mm)
    return to_manifold(prisms(first, last, diameter_mm / 2.0, sides))


def _refuse_torn(pieces: list[Any]) -> None:
    for number, piece in enumerate(pieces, start=1):
        bodies = len(piece.decompose())
        if bodies != 1:
            raise NumericalError(
                "shell-part-disconnected",
                f"part {number} of the shell falls into {bodies} bodies; please report this design",
            )


def _keys(sensor: Sensor, cut: CuttingPlane, cuts: list[CuttingPlane], size: KeySize) -> FloatArray:
    """Middles (k, 3) of the keys of a cut, clear of receptors and of other cuts; maybe none."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    # Greatest cosine between wall and cut plane's normal at a key: pegs stay inside the wall's
    # run.
    steep = 0.5
    # Places of keys around a ring, as shares of it: uneven, so that pieces join in one way only.
    round_keys = (0.0, 0.22, 0.5, 0.74)
    uv = _cut_line(surface, cut)
    uv = uv[np.abs(surface.normal(uv) @ cut.normal) <= steep]
    point = surface.point(uv, -size.boss / 2.0)
    # The wall may slant: the key stays in the cut, in the middle of the boss.
    point += (cut.offset_mm - point @ cut.normal)[:, None] * cut.normal
    clear = np.full(len(point), np.inf)
    gap = design.print_rules.gap_min_mm
    low, high = point - size.root * cut.normal, point + size.length * cut.normal
    for k in _beside(design, markers, cut, size):
        foot = np.broadcast_to(markers.base_mm[k], point.shape)
        tip = np.broadcast_to(markers.tip_mm[k], point.shape)
        clear = np.minimum(clear, segment_distance_mm(low, high, foot, tip))
    clear -= (size.boss + design.receptor.diameter_tube_mm) / 2.0
    # Keys of cuts that cross stand clear of each other at the corner.
    reach = size.boss / 2.0 + size.length
    for other in cuts:
        if other.axis != cut.axis:
            clear = np.minimum(clear, np.abs(point @ other.normal - other.offset_mm) - reach)
    fine = np.flatnonzero(clear >= gap)
    wanted = round_keys if surface.periodic[1] else _sheet_shares(point, cut, cuts)
    share = np.linspace(0.0, 1.0, len(point), endpoint=not surface.periodic[1])
    chosen: list[int] = []
    for target in wanted:
        away = np.abs(share[fine] - target)
        if surface.periodic[1]:
            away = np.minimum(away, 1.0 - away)
        apart = np.full(len(fine), np.inf)
        for k in chosen:
            apart = np.minimum(apart, np.linalg.norm(point[fine] - point[k], axis=1))
        away = np.where(apart > 2.0 * size.boss, away, np.inf)
        if len(fine) and np.isfinite(away).any():
            chosen.append(int(fine[np.argmin(away)]))
    return np.asarray(point[chosen])


def _beside(design: Design, markers: Markers, cut: CuttingPlane, size: KeySize) -> IntArray:
    """Receptors that reach between the ends of a cut's bosses, with the printer's gap."""
    low, high = receptor_spans(design, markers, cut.normal)
    gap = design.print_rules.gap_min_mm
    first, last = cut.offset_mm - size.root - gap, cut.offset_mm + size.length + gap
    return np.flatnonzero((high > first + 1e-9) & (low < last - 1e-9))


def _sheet_shares(
    point: FloatArray, cut: CuttingPlane, cuts: list[CuttingPlane]
) -> tuple[float, ...]:
    """Places of keys along a sheet's cut: the same in each piece that other cuts leave of it."""
    sheet_keys = (0.1, 0.5, 0.85)  # uneven places of keys along the cut of a sheet
    limits = [0.0, 1.0]
    for other in cuts:
        if other.axis != cut.axis:
            along = point @ other.normal - other.offset_mm
            limits.append(float(np.argmin(np.abs(along))) / len(point))
    limits.sort()
    return tuple(a + share * (b - a) for a, b in pairwise(limits) for share in sheet_keys)


def _cut_line(surface: Surface, cut: CuttingPlane) -> FloatArray:
    """Chart points (n, 2) where the outer face meets a cut, in order."""
    along = 100
    stations = 360
    axis = cut.axis
    low, high = surface.domain[1 - axis]
    others = np.linspace(low, high, stations, endpoint=not surface.periodic[1 - axis])
    t = np.linspace(surface.domain[axis, 0], surface.domain[axis, 1], along)
    uv = np.zeros((stations, along, 2))
    uv[..., axis], uv[..., 1 - axis] = t, others[:, None]
    height = (surface.point(uv.reshape(-1, 2)) @ cut.normal).reshape(stations, along)
    above = height >= cut.offset_mm
    cross = above[:, 1:] != above[:, :-1]
    met = cross.any(axis=1)
    k = np.argmax(cross, axis=1)[met]
    row = np.flatnonzero(met)
    before, after = height[row, k], height[row, k + 1]
    share = (cut.offset_mm - before) / (after - before)
    out = np.zeros((len(row), 2))
    out[:, axis] = t[k] + share * (t[k + 1] - t[k])
    out[:, 1 - axis] = others[met]
    return out
