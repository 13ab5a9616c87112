"""Hollows that hold resin: sealed ones, ones that drain too slowly, cups.

The first are closed faces that look inward. The others are found on a grid of cells: a ball of the
drain's diameter is moved through the air; where it can be but cannot leave, resin is trapped
unless the openings are together as large as the drain's.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from phytac_design.core.kernels import kernel
from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.surface_samples import bodies
from phytac_design.fabrication.printing.violations import Violation, violation
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class VoxelGrid:
    """Cells of a box around a body.

    Attributes
    ----------
    solid : (a, b, c) bool
        Cells whose middle is in the body.
    low_mm : (3,) float
        Middle of the first cell.
    cell_mm : float
        Side of a cell.
    """

    solid: BoolArray
    low_mm: FloatArray
    cell_mm: float


@dataclass(frozen=True, kw_only=True)
class Hollow:
    """Air that may hold resin, in a part of a grid.

    Attributes
    ----------
    box : tuple of slice
        Part of the grid.
    cells, counted : (a, b, c) bool
        The air, and those of its cells at which openings count.
    depth, brim : int
        Layers that a ball's middle can be in, and the first above them.
    middle_mm : (3,) float
        Middle of those places.
    """

    box: tuple[slice, ...]
    cells: BoolArray
    counted: BoolArray
    depth: int
    brim: int
    middle_mm: FloatArray

    def below(self, layers: float) -> "Hollow":
        """Count openings only so far below the highest ball's middle: below the brim."""
        counted = self.cells.copy()
        counted[:, :, max(0, int(self.brim - layers)) :] = False
        return replace(self, counted=counted)


def fill(mesh: TriangleMesh, cell_mm: float, margin_mm: float) -> VoxelGrid:
    """Cells inside a closed mesh, with a margin of air all around."""
    low = mesh.vertices_mm.min(axis=0) - margin_mm
    # Off the corners of round numbers, so that no column runs along an edge.
    low = low + cell_mm * np.array([0.1234567, 0.2345678, 0.3456789])
    size = np.ceil((mesh.vertices_mm.max(axis=0) + margin_mm - low) / cell_mm).astype(int) + 1
    turns = np.zeros((size[0], size[1], size[2] + 1), dtype=np.int32)
    _count(np.ascontiguousarray((mesh.corners_mm - low) / cell_mm), turns)
    return VoxelGrid(solid=np.cumsum(turns, axis=2)[:, :, :-1] > 0, low_mm=low, cell_mm=cell_mm)


@kernel
def _count(corners: FloatArray, turns: IntArray) -> None:
    """Add 1 at the first cell above a face that a column enters the body by, -1 where it leaves."""
    for t in range(len(corners)):
        ax, ay, az = corners[t, 0]
        bx, by, bz = corners[t, 1]
        cx, cy, cz = corners[t, 2]
        double = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if double == 0.0:
            continue
        sign = -1 if double > 0.0 else 1
        for i in range(int(np.ceil(min(ax, bx, cx))), int(np.floor(max(ax, bx, cx))) + 1):
            for j in range(int(np.ceil(min(ay, by, cy))), int(np.floor(max(ay, by, cy))) + 1):
                u = ((bx - i) * (cy - j) - (by - j) * (cx - i)) / double
                v = ((cx - i) * (ay - j) - (cy - j) * (ax - i)) / double
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                height = u * az + v * bz + (1.0 - u - v) * cz
                turns[i, j, int(np.ceil(height))] += sign


def sealed(mesh: TriangleMesh, rules: PrintSection) -> list[Violation]:
    """Closed hollows: faces (welded mesh) that enclose air."""
    if rules.drain_min_mm == 0.0:
        return []
    label = bodies(mesh)
    used, number = np.unique(label, return_inverse=True)
    a, b, c = np.moveaxis(mesh.corners_mm, 1, 0)
    volume = np.bincount(number, np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0, len(used))
    found = []
    for k in np.flatnonzero(volume < -1e-6):
        own = number == k
        weight = np.einsum("ni,ni->n", a[own], np.cross(b[own], c[own]))
        centre = np.average((a[own] + b[own] + c[own]) / 4.0, axis=0, weights=weight)
        fix = f"{-volume[k]:.2f} mm³ of resin are shut in; fill the hollow or open a drain"
        found.append(violation("sealed", centre, 0.0, rules.drain_min_mm, fix))
    return found


def undrained(mesh: TriangleMesh, rules: PrintSection) -> list[Violation]:
    """Hollows whose openings are together smaller than the drain."""
    grid = _grid(mesh, rules, cells_max=1_500_000)
    if grid is None:
        return []
    label = ndimage.label(_ball_centres(grid, rules.drain_min_mm))[0]
    hollows = _hollows(grid, np.where(label == label[0, 0, 0], 0, label), rules.drain_min_mm)
    advice = "run out too slowly; widen the opening"
    return _trapped("drain", grid, hollows, rules, _reached, advice)


def cups(mesh: TriangleMesh, up: FloatArray, rules: PrintSection) -> list[Violation]:
    """Hollows that hold resin as the body stands when printed, open upward only.

    They are air that a ball of the drain's diameter can fill but not leave sideways or downward,
    and whose smaller openings below its brim are together smaller than the drain.

    Parameters
    ----------
    up : (3,) float
        Build direction.
    """
    turn, drain = upright(up), rules.drain_min_mm
    turned = TriangleMesh(vertices_mm=mesh.vertices_mm @ turn.T, triangles=mesh.triangles)
    # Coarser than for drains: cups are searched in several directions.
    grid = _grid(turned, rules, cells_max=300_000)
    if grid is None:
        return []
    pools = _pools(_ball_centres(grid, drain))
    hollows = [
        replace(item.below(drain / 2.0 / grid.cell_mm), middle_mm=item.middle_mm @ turn)
        for item in _hollows(grid, ndimage.label(pools)[0], drain)
        if item.depth * grid.cell_mm >= drain / 2.0
    ]
    advice = "stay inside as it stands; turn the part or open a drain"
    return _trapped("cup", grid, hollows, rules, lambda air: air & ~_pools(air), advice)


def _grid(mesh: TriangleMesh, rules: PrintSection, *, cells_max: int) -> VoxelGrid | None:
    """Cells of a body with a margin for the drain's ball; None if cells are too coarse for it."""
    coarse = 2.5  # drains narrower than this many cells are not searched
    drain, cell = rules.drain_min_mm, cell_size_mm(mesh, rules, cells_max)
    return None if drain < coarse * cell else fill(mesh, cell, drain / 2.0 + 2.0 * cell)


def _trapped(
    rule: str,
    grid: VoxelGrid,
    hollows: list[Hollow],
    rules: PrintSection,
    reached: Callable[[BoolArray], BoolArray],
    advice: str,
) -> list[Violation]:
    """Violations of the hollows whose openings are together smaller than the drain."""
    drain = rules.drain_min_mm
    found = []
    holding = _holding(grid, hollows, np.pi / 4.0 * drain**2, reached)
    if holding:
        # Corners and slots of a hollow hold resin, too, where the ball does not fit.
        shut = ~grid.solid & ~reached(~grid.solid)
    for item, area in holding:
        label = ndimage.label(item.counted | shut[item.box])[0]
        held = np.isin(label, np.unique(label[item.counted]))
        fix = f"about {float(held.sum()) * grid.cell_mm**3:.0f} mm³ of resin {advice}"
        found.append(violation(rule, item.middle_mm, 2.0 * np.sqrt(area / np.pi), drain, fix))
    return found


def _hollows(grid: VoxelGrid, label: IntArray, drain_mm: float) -> list[Hollow]:
    """Cells that a ball fills whose middle is in a region; 0 is no region."""
    reach = int(np.ceil(drain_mm / 2.0 / grid.cell_mm)) + 2
    found = []
    for k, span in enumerate(ndimage.find_objects(label), start=1):
        if span is None:
            continue
        box = tuple(
            slice(max(0, s.start - reach), min(n, s.stop + reach))
            for s, n in zip(span, label.shape, strict=True)
        )
        own = label[box] == k
        far = ndimage.distance_transform_edt(~own) * grid.cell_mm
        centre = np.mean(np.nonzero(own), axis=1) + [s.start for s in box]
        cells = (far <= drain_mm / 2.0 + grid.cell_mm / 2.0) & ~grid.solid[box]
        found.append(
            Hollow(
                box=box,
                cells=cells,
                counted=cells,
                depth=span[2].stop - span[2].start,
                brim=span[2].stop - box[2].start,
                middle_mm=grid.low_mm + grid.cell_mm * centre,
            )
        )
    return found


def _reached(air: BoolArray) -> BoolArray:
    """Cells that the outside reaches."""
    label = ndimage.label(air)[0]
    return np.asarray(label == label[0, 0, 0])


def _holding(
    grid: VoxelGrid,
    hollows: list[Hollow],
    required_mm2: float,
    reached: Callable[[BoolArray], BoolArray],
) -> list[tuple[Hollow, float]]:
    """Hollows with too small openings, and their area (mm²).

    What drains is open air to its neighbours: hollows are let go until all that stay are slow.
    """
    while hollows:
        air = ~grid.solid
        for item in hollows:
            air[item.box] &= ~item.cells
        outside = reached(air)
        slow = []
        for item in hollows:
            opening = ndimage.binary_dilation(item.counted) & outside[item.box]
            area = float(opening.sum()) * grid.cell_mm**2
            if area < required_mm2:
                slow.append((item, area))
        if len(slow) == len(hollows):
            return slow
        hollows = [item for item, _ in slow]
    return []


def cell_size_mm(mesh: TriangleMesh, rules: PrintSection, cells: int) -> float:
    """Side of the cells that suits the drain and the size of the body."""
    cells_drain = 7.0  # cells across the drain's diameter, where the number of cells allows
    size = np.ptp(mesh.vertices_mm, axis=0) + 2.0 * rules.drain_min_mm
    return float(max(rules.drain_min_mm / cells_drain, np.cbrt(np.prod(size) / cells)))


def upright(up: FloatArray) -> FloatArray:
    """Rotation (3, 3) that turns a direction up."""
    third = np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    helper = np.array([1.0, 0.0, 0.0]) if abs(third[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    second = np.cross(third, helper)
    second /= np.linalg.norm(second)
    return np.stack([np.cross(second, third), second, third])


def _ball_centres(grid: VoxelGrid, diameter_mm: float) -> BoolArray:
    """Cells in which the middle of a ball can be; the outermost ones are air."""
    # The nearest solid cell's middle is about half a cell inside the body.
    distance = ndimage.distance_transform_edt(~grid.solid) * grid.cell_mm - grid.cell_mm / 2.0
    core = distance >= diameter_mm / 2.0 - grid.cell_mm / 4.0
    for axis in range(3):
        for end in (0, -1):
            core[(slice(None),) * axis + (end,)] = True
    return np.asarray(core)


@kernel
def _root(parent: IntArray, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def _rise(label: IntArray, pooled: BoolArray) -> None:
    """Join the layers' regions from the bottom up; those not joined to the first one are pools."""
    parent = np.arange(len(pooled))
    outside = label[0, 0, 0]
    for z in range(label.shape[2]):
        if z:
            for i in range(label.shape[0]):
                for j in range(label.shape[1]):
                    a, b = label[i, j, z], label[i, j, z - 1]
                    if a > 0 and b > 0:
                        a, b = _root(parent, a), _root(parent, b)
                        if a != b:
                            parent[a] = b
        last = 0
        for i in range(label.shape[0]):
            for j in range(label.shape[1]):
                k = label[i, j, z]
                if k > 0 and k != last:
                    pooled[k] = _root(parent, k) != _root(parent, outside)
                    last = k


def _pools(core: BoolArray) -> BoolArray:
    """Cells that the outside cannot reach without going above them; z is up."""
    flat = np.zeros((3, 3, 3), dtype=np.bool_)
    flat[:, 1, 1] = flat[1, :, 1] = True
    label = np.asarray(ndimage.label(core, flat)[0], dtype=np.int64)
    pooled = np.zeros(int(label.max()) + 1, dtype=np.bool_)
    _rise(label, pooled)
    # The box's lid is air all over: it does not count as a place that holds resin.
    pools = pooled[label]
    pools[:, :, -1] = False
    return np.asarray(pools)
