"""Shares of the pressure of shaped contacts on the footprints of the switches.

Footprints are discs, placed in the frames of :class:`pressure.ContactFrames`. All
integrals over a disc or a strip have square-root ends only, which the substitution
s = (1 - cos θ)/2 makes smooth: a few Gauss points give ten digits.
"""

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from phytac_design.mechanics.indenter import CYLINDER, FLAT, SPHERE, Indentations
from phytac_design.mechanics.shell.loads import dot
from phytac_design.mechanics.shell.pressure import ContactFrames, check_indentations, contact_frames
from phytac_design.mechanics.shell.pressure_sharing import near_pairs, on_shell_share
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.discs import disc_overlap_share


@dataclass(frozen=True, kw_only=True)
class FootprintSettings:
    """Numerical quadrature of contact pressure."""

    min_half_width_mm: float = 1e-6
    """Half-width that stands for a point or a line."""
    min_square_arm: float = 1e-30
    """Keeps a division finite; in squared radii of the contact."""
    disc_points: int = 24
    strip_points: int = 12
    """Gauss points of each interval."""
    flat_cosine: float = 0.95
    """Cosine of the turn up to which a patch counts as flat: its area is then within 0.3 %."""
    rim_margin: float = 1.2
    """A patch so much larger must keep off the rims for its whole to count as carried."""
    tiles_across: int = 48
    """Tiles across a surface, taken as a square of its area, that cut patches are measured with."""
    disc_cells: int = 16
    strip_cells: int = 2
    """Cells along a disc's radius, and along a strip's half-width or half its length; the
    pressure's mean over a cell keeps a strip's total however coarse they are."""
    max_cells: tuple[int, ...] = (64, 16)
    """Cells along a tile at most, under discs and under strips."""
    cells_at_once: int = 500_000
    """Cells worked on at once, to bound the memory."""


SETTINGS = FootprintSettings()


def footprint_shares(
    surface: Surface,
    contacts: Indentations,
    marker_uv: FloatArray,
    footprint_radius_mm: FloatArray | float,
) -> FloatArray:
    """Share of each contact's normal force on each marker's footprint, (c, n).

    The pressure is that of :func:`pressure.touch_loads`; over a tiling of footprints a row sums
    to 1. A contact over a rim is carried by its part on the shell alone, at accordingly higher
    pressure. Footprints that face away from the contact by more than 90° feel nothing. Friction
    does not press.

    Parameters
    ----------
    surface : Surface
        The outer face.
    contacts : Indentations
        Contacts; their forces are not used.
    marker_uv : (n, 2) float
        Chart positions of the markers.
    footprint_radius_mm : float or (n,) float
        Footprint radii, > 0.

    Raises
    ------
    DesignError
        As :func:`pressure.check_indentations`.
    """
    check_indentations(surface, contacts)
    frames = contact_frames(surface, contacts)
    marker_uv = np.asarray(marker_uv, dtype=np.float64).reshape(-1, 2)
    marker, facing = surface.point(marker_uv), surface.normal(marker_uv)
    footprint = np.broadcast_to(np.asarray(footprint_radius_mm, dtype=np.float64), len(marker))
    out = np.zeros((len(frames.at), len(marker)))
    if out.size == 0:
        return out
    i, j, gap = near_pairs(frames.at, frames.reach_mm, marker, footprint)
    front = np.sum(frames.normal[i] * facing[j], axis=1) > 0.0
    i, j, gap = i[front], j[front], gap[front]
    half, kind = np.maximum(frames.half_mm[i], SETTINGS.min_half_width_mm), frames.kind[i]
    share = np.zeros(len(i))
    for which, law in ((FLAT, disc_overlap_share), (SPHERE, hertz_disc_share)):
        mine = kind == which
        share[mine] = law(gap[mine], half[mine], footprint[j[mine]])
    mine = np.flatnonzero(kind == CYLINDER)
    x, y = frames.places(i[mine], (marker[j[mine]] - frames.at[i[mine]])[:, None])
    hit = np.abs(x[:, 0]) < frames.length_mm[i[mine]] / 2.0 + footprint[j[mine]]
    hit &= np.abs(y[:, 0]) < half[mine] + footprint[j[mine]]
    mine, x, y = mine[hit], x[hit, 0], y[hit, 0]
    length = frames.length_mm[i[mine]]
    share[mine] = strip_share(x, y, half[mine], length, footprint[j[mine]])
    carried = carried_share(surface, contacts.uv, frames)
    out[i, j] = np.minimum(share / np.maximum(carried[i], 1e-12), 1.0)
    return out


def hertz_disc_share(distance: FloatArray, half: FloatArray, footprint: FloatArray) -> FloatArray:
    """Share of Hertz's pressure over discs (p,) that falls on footprint discs, 0 … 1.

    The part of the footprint that surrounds the centre in closed form, 1 - (1 - (r/a)²)^{3/2};
    the rest over rings, of which the footprint covers an angle 2φ(r). Lengths in mm, > 0.
    """
    d, f = distance / half, footprint / half
    core = np.clip(f - d, 0.0, 1.0)
    with np.errstate(divide="ignore"):  # all of it: log 0
        whole = -np.expm1(1.5 * np.log1p(-(core**2)))
    theta, weight = _gauss(SETTINGS.disc_points)
    low, high = np.minimum(np.abs(d - f), 1.0), np.minimum(d + f, 1.0)
    r = low[:, None] + (high - low)[:, None] * theta
    d, f = d[:, None], f[:, None]
    cosine = (r * r + d * d - f * f) / np.maximum(2.0 * r * d, SETTINGS.min_square_arm)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    rings = np.sum(np.sqrt(np.maximum(1.0 - r * r, 0.0)) * r * angle * weight, axis=1)
    rings *= high - low
    return np.asarray(np.clip(whole + rings * 3.0 / np.pi, 0.0, 1.0))


def strip_share(
    x: FloatArray, y: FloatArray, half: FloatArray, length: FloatArray, footprint: FloatArray
) -> FloatArray:
    """Share of the pressure of strips (p,) on footprint discs at (x, y) off their centres, 0 … 1.

    Hertz's across y, even along x. Lines of constant y are covered along a length that has kinks
    where the footprint's edge crosses an end of the strip; the intervals run between those.
    """
    low, high = np.maximum(-half, y - footprint), np.minimum(half, y + footprint)
    high = np.maximum(low, high)
    kinks = [low, high]
    for end in (-length / 2.0, length / 2.0):
        side = np.sqrt(np.maximum(footprint**2 - (end - x) ** 2, 0.0))
        kinks += [np.clip(y - side, low, high), np.clip(y + side, low, high)]
    knots = np.sort(np.stack(kinks), axis=0)
    theta, weight = _gauss(SETTINGS.strip_points)
    step = np.diff(knots, axis=0)[:, :, None]
    t = knots[:-1, :, None] + step * theta  # (5, p, q)
    wide = np.sqrt(np.maximum((footprint[:, None]) ** 2 - (t - y[:, None]) ** 2, 0.0))
    last = np.minimum(x[:, None] + wide, length[:, None] / 2.0)
    first = np.maximum(x[:, None] - wide, -length[:, None] / 2.0)
    press = np.sqrt(np.maximum(1.0 - (t / half[:, None]) ** 2, 0.0))
    lines = np.sum(press * np.maximum(last - first, 0.0) * weight, axis=2)
    total = np.sum(lines * step[:, :, 0], axis=0)
    return np.asarray(np.clip(total / (0.5 * np.pi * half * length), 0.0, 1.0))


@cache
def _gauss(count: int) -> tuple[FloatArray, FloatArray]:
    """Places and weights over [0, 1] for integrands with square-root ends."""
    node, weight = np.polynomial.legendre.leggauss(count)
    theta = 0.5 * np.pi * (node + 1.0)
    return (1.0 - np.cos(theta)) / 2.0, weight * np.pi / 4.0 * np.sin(theta)


def carried_share(surface: Surface, uv: FloatArray, frames: ContactFrames) -> FloatArray:
    """Pressure on the shell over that on an endless flat one, of contacts at ``uv`` (c, 2), (c,).

    Straight rims next to even discs in closed form; what is cut otherwise, or bends far around
    the sensor, is summed over small cells of the surface.
    """
    out = np.ones(len(uv))
    tiles = _tiles_of(surface)
    gentle = tiles.turn(frames) > SETTINGS.flat_cosine
    even = gentle & (frames.kind == FLAT)
    out[even] = on_shell_share(surface, uv[even], frames.half_mm[even])
    whole = on_shell_share(surface, uv, SETTINGS.rim_margin * frames.reach_mm) > 1.0 - 1e-12
    small = frames.reach_mm <= SETTINGS.min_half_width_mm
    rest = np.flatnonzero(~(even | (gentle & whole) | small))
    if len(rest):
        out[rest] = tiles.measure(frames, rest)
    out[small] = 1.0
    return out


@lru_cache(maxsize=4)
def _tiles_of(surface: Surface) -> "_SurfaceTiles":
    """Tiles of a surface; a sensor in a control loop asks for them thousands of times."""
    return _SurfaceTiles(surface)


class _SurfaceTiles:
    """The outer face in tiles of equal steps of the chart."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.side = np.sqrt(surface.area_mm2()) / SETTINGS.tiles_across
        low, high = surface.domain.T
        ends = [np.linspace(a, b, 17) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1)
        metric = surface.metric(grid.reshape(-1, 2)).reshape(17, 17, 2, 2)
        lengths = [
            float(np.sqrt(metric[..., k, k]).mean(axis=k).max() * (high - low)[k]) for k in (0, 1)
        ]
        count = [max(int(np.ceil(length / self.side)), 2) for length in lengths]
        self.step = (high - low) / count
        cells = np.stack(np.meshgrid(*[np.arange(n) for n in count], indexing="ij"), axis=-1)
        self.low = low + cells.reshape(-1, 2) * self.step
        middle = self.low + self.step / 2.0
        self.middle, self.normal = surface.point(middle), surface.normal(middle)
        tangents = surface.tangents(middle) * self.step[None, :, None]
        sides = np.linalg.norm(tangents, axis=2)
        self.longest = sides.max(axis=1)
        # Half a diagonal, and something for what a tile bends and widens.
        self.reach = 0.75 * sides.sum(axis=1)

    def turn(self, frames: ContactFrames) -> FloatArray:
        """Least cosine between the normals under each contact and its own, (c,)."""
        i, k, _ = near_pairs(frames.at, frames.reach_mm, self.middle, np.zeros(len(self.middle)))
        out = np.ones(len(frames.at))
        np.minimum.at(out, i, np.sum(frames.normal[i] * self.normal[k], axis=1))
        return out

    def measure(self, frames: ContactFrames, contact: IntArray) -> FloatArray:
        """Pressure of contacts (m,) on the surface, over that on an endless plane, (m,)."""
        rod = frames.kind[contact] == CYLINDER
        half, length = frames.half_mm[contact], frames.length_mm[contact]
        fine = np.where(
            rod, np.minimum(half, length / 2.0) / SETTINGS.strip_cells, half / SETTINGS.disc_cells
        )
        with np.errstate(divide="ignore"):
            wanted = np.ceil(np.log2(self.side / np.maximum(fine, 1e-300)))
        max_count = np.where(rod, SETTINGS.max_cells[1], SETTINGS.max_cells[0])
        count = 2 ** np.clip(wanted, 2, np.log2(max_count)).astype(np.int64)
        i, k, _ = near_pairs(frames.at[contact], frames.reach_mm[contact], self.middle, self.reach)
        x, y = frames.places(contact[i], (self.middle[k] - frames.at[contact[i]])[:, None])
        slack = self.reach[k]
        outside = np.abs(x[:, 0]) > length[i] / 2.0 + slack
        outside |= np.abs(y[:, 0]) > half[i] + slack
        keep = ~(outside & rod[i])
        i, k = i[keep], k[keep]
        total = np.zeros(len(contact))
        for cells in np.unique(count):
            mine = np.flatnonzero(count[i] == cells)
            mine = mine[np.argsort(k[mine], kind="stable")]  # each tile is evaluated once
            for part in np.array_split(
                mine, max(1, len(mine) * cells**2 // SETTINGS.cells_at_once)
            ):
                weight = self._pressed(frames, contact[i[part]], k[part], int(cells))
                np.add.at(total, i[part], weight)
        plain = np.where(frames.kind[contact] == SPHERE, 2.0 / 3.0, 1.0) * np.pi * half**2
        return total / np.maximum(np.where(rod, 0.5 * np.pi * half * length, plain), 1e-300)

    def _pressed(
        self, frames: ContactFrames, contact: IntArray, tile: IntArray, cells: int
    ) -> FloatArray:
        """Integral of the pressure of contacts (p,) over tiles (p,) cut into cells², (p,)."""
        side = (np.arange(cells) + 0.5) / cells
        sub = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        used, slot = np.unique(tile, return_inverse=True)
        uv = (self.low[used][:, None] + self.step * sub).reshape(-1, 2)
        shape = (len(used), len(sub))
        area = np.sqrt(np.maximum(np.linalg.det(self.surface.metric(uv)), 0.0)).reshape(shape)
        area *= float(np.prod(self.step)) / cells**2
        point = self.surface.point(uv).reshape(*shape, 3)
        normal = self.surface.normal(uv).reshape(*shape, 3)
        arm = point[slot] - frames.at[contact][:, None]
        mean = np.sqrt(area.mean(axis=1))[slot]
        press = frames(contact, arm, mean, self.longest[tile] / cells)
        front = dot(normal[slot], frames.normal[contact]) > 0.0
        return np.asarray(np.sum(press * front * area[slot], axis=1))
