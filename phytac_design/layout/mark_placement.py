"""Reference marks: dots painted on the inner side of the clamped rims.

They do not move with the wall: a camera that sees them shift has moved itself. Dots are evenly
spaced around a rim but for dot 0, half a step aside, so that no turn maps them onto themselves.
Even and odd dots stand at two distances from the wall, which separates distance from focal length.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.safe_rounding import at_least
from phytac_design.design.spec import Design
from phytac_design.geometry.boundary_loops import Loop, chart_loops
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class PlacedMarks:
    """Dots of one sensor, r in all, rim after rim; arrays are empty without dots.

    Attributes
    ----------
    end, number : (r,) int
        Rim (0 near, 1 far) and number of each around it.
    point_mm : (r, 3) float
        Centres on the inner side of the rim, sensor frame.
    outline_mm : (r, s, 3) float
        Points on the edge of each dot.
    edge_uv : (r, 2) float
        Chart position beside each, on the edge of the sensing surface.
    distance_mm : (r,) float
        Distance from there.
    """

    end: IntArray
    number: IntArray
    point_mm: FloatArray
    outline_mm: FloatArray
    edge_uv: FloatArray
    distance_mm: FloatArray

    @property
    def count(self) -> int:
        """Number of dots."""
        return len(self.end)

    @property
    def neighbours(self) -> IntArray:
        """Numbers (r, 8) of the two next dots on either side; -1 for no more."""
        out = np.full((self.count, 8), -1, dtype=np.int64)
        for end in np.unique(self.end):
            own = np.flatnonzero(self.end == end)
            for column, step in enumerate((-2, -1, 1, 2)):
                out[own, column] = np.roll(own, -step)
        return out

    def mesh(self, lift_mm: float, surface: Surface, design: Design) -> TriangleMesh:
        """Fans of triangles, one dot after the other, lifted off the rim towards the inside."""
        lifted = _placed(design, surface, lift_mm)
        count, sides = lifted.outline_mm.shape[:2]
        vertices = np.concatenate([lifted.point_mm[:, None], lifted.outline_mm], axis=1)
        corner = 1 + np.arange(sides)
        fan = np.column_stack([np.zeros_like(corner), corner, np.roll(corner, -1)])
        faces = fan[None] + (np.arange(count) * (sides + 1))[:, None, None]
        return TriangleMesh(vertices_mm=vertices.reshape(-1, 3), triangles=faces.reshape(-1, 3))


def place_reference_marks(design: Design, surface: Surface) -> PlacedMarks:
    """Place the dots of a design.

    Raises
    ------
    DesignError
        If a rim is missing or too short for them, or they touch one another.
    """
    table, ends = design.reference_marks, len(surface.edges()) if surface.periodic[1] else 1
    if table.count and max(table.end_numbers) >= ends:
        raise DesignError(
            "reference-marks-end",
            f"the {surface.name} has no far rim (got reference_marks.ends = {table.ends!r}); set "
            'reference_marks.ends = "near"',
        )
    if table.count and table.reach_mm > design.wall.rim_length_mm:
        raise DesignError(
            "reference-marks-rim",
            "the rim is too short for reference marks: they need "
            f"{at_least(table.reach_mm)} mm (got wall.rim_length_mm = "
            f"{design.wall.rim_length_mm:g}); raise it, or lower reference_marks.diameter_mm or "
            "gap_mm",
        )
    return _placed(design, surface, 0.0)


def _placed(design: Design, surface: Surface, lift_mm: float) -> PlacedMarks:
    """Dots at a height above the inner side of the rims."""
    table, sides = design.reference_marks, 24
    turn = 2.0 * np.pi * np.arange(sides) / sides
    circle = table.diameter_mm / 2.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    number = np.arange(table.count)
    rows = np.where(number % 2, table.rows_mm[1], table.rows_mm[0])
    parts = []
    for end in table.end_numbers:
        rim = _Rim(surface, _loops(surface)[end], -design.wall.thickness_mm)
        step = rim.length_mm / table.count
        # Half a step remains between dots 0 and 1.
        if step / 2.0 < 1.5 * table.diameter_mm:
            raise DesignError(
                "reference-marks-crowded",
                f"{table.count} reference marks of {table.diameter_mm:g} mm are too close around a "
                f"rim of {rim.length_mm:.1f} mm; lower reference_marks.count or diameter_mm",
            )
        even = np.asarray(step * (number + np.where(number == 0, 0.5, 0.0)), dtype=np.float64)
        along = rim.clear_of_corners(even, 1.5 * table.diameter_mm)
        flat = np.column_stack([along, rows])
        outline = (flat[:, None] + circle).reshape(-1, 2)
        parts.append(
            (
                np.full(table.count, end),
                number,
                rim.points_mm(flat, lift_mm),
                rim.points_mm(outline, lift_mm).reshape(table.count, sides, 3),
                rim.uv(along),
                rows,
            )
        )
    if not parts:
        nothing = np.zeros(0, dtype=np.int64)
        return PlacedMarks(
            end=nothing,
            number=nothing,
            point_mm=np.zeros((0, 3)),
            outline_mm=np.zeros((0, sides, 3)),
            edge_uv=np.zeros((0, 2)),
            distance_mm=np.zeros(0),
        )
    ends, numbers, point, outline, uv, distance = map(np.concatenate, zip(*parts, strict=True))
    return PlacedMarks(
        end=ends,
        number=numbers,
        point_mm=point,
        outline_mm=outline,
        edge_uv=uv,
        distance_mm=distance,
    )


def _loops(surface: Surface) -> list[Loop]:
    """Loops of edges with many stations."""
    (u0, u1), (v0, v1) = surface.domain
    v = np.linspace(v0, v1, 721)
    u = np.array([u0, u1]) if surface.periodic[1] else np.linspace(u0, u1, 721)
    return chart_loops(surface, u, v[:-1] if surface.periodic[1] else v)


class _Rim:
    """A rim by distance along the inner edge, and away from the sensing surface, mm."""

    def __init__(self, surface: Surface, loop: Loop, offset_mm: float) -> None:
        self._surface, self._offset_mm = surface, offset_mm
        edge = loop.points_mm(surface, offset_mm, 0.0)
        step = np.linalg.norm(np.roll(edge, -1, axis=0) - edge, axis=1)
        self._at = np.append(0.0, np.cumsum(step))
        self.length_mm = float(self._at[-1])
        closed = np.concatenate([loop.uv, loop.uv[:1]])
        if surface.periodic[1]:
            closed[:, 1] = np.unwrap(closed[:, 1], period=float(np.ptp(surface.domain[1])))
        self._columns = np.column_stack([closed, np.concatenate([loop.out, loop.out[:1]])])

    def clear_of_corners(self, along_mm: FloatArray, margin_mm: float) -> FloatArray:
        """Return distances (n,) along the edge with those near a corner moved away from it."""
        # A corner of a sheet has several stations in one place.
        corner = np.unique(self._at[:-1][np.diff(self._at) < 1e-9])
        for at in corner:
            off = np.mod(along_mm - at + self.length_mm / 2.0, self.length_mm) - self.length_mm / 2
            aside = at + np.where(off < 0.0, -margin_mm, margin_mm)
            along_mm = np.where(np.abs(off) < margin_mm, aside, along_mm)
        return along_mm

    def _interpolated(self, along_mm: FloatArray) -> FloatArray:
        at = np.mod(along_mm, self.length_mm)
        return np.column_stack([np.interp(at, self._at, c) for c in self._columns.T])

    def uv(self, along_mm: FloatArray) -> FloatArray:
        """Chart positions (n, 2) on the edge."""
        v0, v1 = self._surface.domain[1]
        uv = self._interpolated(along_mm)[:, :2]
        if self._surface.periodic[1]:
            uv[:, 1] = v0 + np.mod(uv[:, 1] - v0, v1 - v0)
        return np.asarray(uv)

    def points_mm(self, flat: FloatArray, lift_mm: float) -> FloatArray:
        """Points (n, 3) of places (n, 2), along the edge and away from it."""
        out = self._interpolated(flat[:, 0])[:, 2:]
        foot = self._surface.point(self.uv(flat[:, 0]), self._offset_mm - lift_mm)
        return np.asarray(foot + flat[:, 1:] * out)
