r"""A free patch: a smooth face through a grid of points, from the user's own CAD or by hand.

::

      points_mm[i][j]          rows i run along u, columns j along v; a natural bicubic spline
       *----*----*----*        passes through every point (u = i, v = j at the points)
       |    |    |    |
       *----*----*----*   ↑ u      outward (away from the camera, towards the hand) is d/dv × d/du
       |    |    |    |
       *----*----*----*   → v
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError
from phytac_shapes.spline import Spline
from phytac_shapes.surface import Surface
from phytac_shapes.variables import check_variables, variable


@dataclass(frozen=True, kw_only=True)
class Patch(Surface):
    """Bicubic spline face; chart u, v = places in the grid of points."""

    points_mm: tuple[tuple[tuple[float, float, float], ...], ...] = variable(
        "Grid of points of the outer face: rows along u, columns along v, each (x, y, z).",
        minimum=-1e4,
        maximum=1e4,
    )
    name: ClassVar[str] = "patch"

    def __post_init__(self) -> None:
        rows = {len(row) for row in self.points_mm}
        if len(self.points_mm) < 2 or len(rows) != 1 or min(rows) < 2:
            raise DesignError(
                "patch-grid-invalid",
                "patch: points_mm must be a grid of at least 2 x 2 points with rows of one length "
                f"(got rows of {sorted(rows)} points, {len(self.points_mm)} rows)",
            )
        check_variables(self)
        uv = self._lattice(4)
        across = np.cross(*np.moveaxis(self.tangents(uv)[:, ::-1], 1, 0))
        size = np.linalg.norm(across, axis=1)
        if not float(size.min()) > 1e-6 * float(size.max()):
            raise DesignError(
                "patch-folds",
                f"patch: the face folds or has no area at some place (got {size.min():.3g} mm² per "
                f"cell there, {size.max():.3g} mm² where it is largest); space points_mm apart, "
                "not all on a line",
            )
        if float(across[:, 2].sum()) < 0.0:
            raise DesignError(
                "patch-inside-out",
                "patch: the face is inside out (d/dv × d/du must point away from the camera, "
                "towards +z); reverse the order of the rows of points_mm",
            )

    @cached_property
    def _grid(self) -> FloatArray:
        return np.array(self.points_mm, dtype=np.float64)

    @property
    def domain(self) -> FloatArray:
        """Chart limits: 0 to one less than the number of points."""
        rows, columns = self._grid.shape[:2]
        return np.array([[0.0, rows - 1.0], [0.0, columns - 1.0]])

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Open both ways."""
        return (False, False)

    def _lattice(self, cells: int) -> FloatArray:
        (_, u1), (_, v1) = self.domain
        u = np.linspace(0.0, u1, cells * int(u1) + 1)
        v = np.linspace(0.0, v1, cells * int(v1) + 1)
        return np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)

    @cached_property
    def _operators(self) -> tuple[Spline, Spline]:
        """Splines of the unit vectors of rows and of columns."""
        rows, columns = self._grid.shape[:2]
        return Spline(values=np.eye(rows)), Spline(values=np.eye(columns))

    def _derivatives(self, uv: FloatArray, order: int = 2) -> tuple[FloatArray, ...]:
        """Point, d/du, d/dv, d²/du², d²/dudv, d²/dv², (n, 3) each, those up to an order.

        A tensor spline: the operators of u act on the rows, those of v on the columns.
        """
        uv = np.asarray(uv, dtype=np.float64)
        rows, columns = self._grid.shape[:2]
        of_u, of_v = self._operators
        a, b = of_u.at(uv[:, 0]), of_v.at(uv[:, 1])
        along = [(x @ self._grid.reshape(rows, -1)).reshape(-1, columns, 3) for x in a[: order + 1]]
        return tuple(
            (b[total - i][:, None] @ along[i])[:, 0]
            for total in range(order + 1)
            for i in range(total, -1, -1)
        )

    def normal(self, uv: FloatArray) -> FloatArray:
        """Outward unit normals, (n, 3)."""
        return self._point_and_normal(uv)[1]

    def _point_and_normal(self, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points of the outer face and outward unit normals, (n, 3) each."""
        point, along, around = self._derivatives(uv, 1)
        out = np.cross(around, along)
        return point, np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points of the offset face, (n, 3) mm."""
        uv = np.asarray(uv, dtype=np.float64)
        if np.ndim(offset_mm) == 0 and offset_mm == 0.0:
            return self._derivatives(uv, 0)[0]
        offset = np.broadcast_to(np.asarray(offset_mm, dtype=np.float64), uv.shape[:1])[:, None]
        point, normal = self._point_and_normal(uv)
        return np.asarray(point + offset * normal)

    def tangents(self, uv: FloatArray) -> FloatArray:
        """d/du and d/dv, (n, 2, 3)."""
        _, along, around = self._derivatives(uv, 1)
        return np.stack([along, around], axis=1)

    def chart(self, points_mm: FloatArray) -> FloatArray:
        """(u, v) of the nearest foot, (n, 2), by Newton's method from the nearest sample."""
        points = np.asarray(points_mm, dtype=np.float64)
        chunk = 4_000  # bounds the memory
        parts = [self._chart(points[k : k + chunk]) for k in range(0, len(points), chunk)]
        return np.concatenate([np.zeros((0, 2)), *parts])

    @cached_property
    def _samples(self) -> tuple[FloatArray, FloatArray]:
        # Eight samples of a cell's side, among which the start of Newton's method is chosen.
        uv = self._lattice(8)
        return uv, self._derivatives(uv, 0)[0]

    def _chart(self, points: FloatArray) -> FloatArray:
        uv_known, known = self._samples
        gap = (known**2).sum(axis=1) - 2.0 * points @ known.T
        uv = uv_known[np.argmin(gap, axis=1)].copy()
        for _ in range(40):
            x, xu, xv, xuu, xuv, xvv = self._derivatives(uv)
            d = points - x
            right = np.stack([np.sum(d * xu, axis=1), np.sum(d * xv, axis=1)], axis=1)
            e, f, g = (np.sum(y * z, axis=1) for y, z in ((xu, xu), (xu, xv), (xv, xv)))
            p, q, r = (np.sum(d * k, axis=1) for k in (xuu, xuv, xvv))
            a, b, c = e - p, f - q, g - r
            # Where the point lies beyond a centre of curvature take the safe Gauss-Newton step.
            bad = (a * c - b * b <= 1e-3 * (e * g - f * f)) | (a <= 0.0)
            a, b, c = np.where(bad, e, a), np.where(bad, f, b), np.where(bad, g, c)
            det = a * c - b * b
            step = np.stack(
                [c * right[:, 0] - b * right[:, 1], a * right[:, 1] - b * right[:, 0]], 1
            )
            step = np.clip(step / det[:, None], -0.5, 0.5)
            uv = uv + step
            if float(np.abs(step).max(initial=0.0)) < 1e-13 * max(self._grid.shape[:2]):
                break
        return np.asarray(uv)

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """Lengths along the chart's middle lines, (n, 2) mm: (around, along)."""
        uv = np.asarray(uv, dtype=np.float64)
        middle = self.domain.mean(axis=1)
        along = self._line_length(0, middle[1], uv[:, 0])
        around = self._line_length(1, middle[0], uv[:, 1])
        return np.column_stack([around, along])

    def _line_length(self, axis: int, other: float, t: FloatArray) -> FloatArray:
        stations = np.linspace(0.0, self.domain[axis, 1], 64 * int(self.domain[axis, 1]) + 1)
        uv = np.full((len(stations), 2), other)
        uv[:, axis] = stations
        steps = np.linalg.norm(np.diff(self._derivatives(uv, 0)[0], axis=0), axis=1)
        return np.asarray(np.interp(t, stations, np.concatenate([[0.0], np.cumsum(steps)])))

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """Gauss quadrature of ten points a cell and side of |n|·(1 - 2·o·H + o²·K)."""
        x, w = np.polynomial.legendre.leggauss(10)
        rows, columns = self._grid.shape[:2]
        u = (np.arange(rows - 1)[:, None] + (x + 1.0) / 2.0).ravel()
        v = (np.arange(columns - 1)[:, None] + (x + 1.0) / 2.0).ravel()
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        weight = np.outer(np.tile(w, rows - 1), np.tile(w, columns - 1)).ravel() / 4.0
        _, xu, xv = self._derivatives(uv, 1)
        size = np.linalg.norm(np.cross(xv, xu), axis=1)
        first, second = self._curvatures(uv)
        return float(np.sum(weight * size * (1.0 + offset_mm * first) * (1.0 + offset_mm * second)))

    def _curvatures(self, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Principal curvatures (n,) each, 1/mm, positive where convex outward."""
        _, xu, xv, xuu, xuv, xvv = self._derivatives(uv)
        normal = self.normal(uv)
        e, f, g = (np.sum(y * z, axis=1) for y, z in ((xu, xu), (xu, xv), (xv, xv)))
        p, q, r = (-np.sum(normal * k, axis=1) for k in (xuu, xuv, xvv))
        det = e * g - f * f
        mean = (e * r - 2.0 * f * q + g * p) / (2.0 * det)
        root = np.sqrt(np.maximum(mean**2 - (p * r - q * q) / det, 0.0))
        return mean + root, mean - root

    def reach_mm(self, uv: FloatArray) -> FloatArray:
        """Depth to the nearest centre of curvature, (n,) mm; inf where flat or concave."""
        most = self._curvatures(uv)[0]
        with np.errstate(divide="ignore"):
            return np.where(most > 0.0, 1.0 / np.maximum(most, 1e-300), np.inf)

    def inner_reach_mm(self) -> float:
        """Least depth over the face (sampled)."""
        return float(self.reach_mm(self._lattice(8)).min())

    def facts(self) -> Mapping[str, float]:
        """Outer area."""
        return {"area_outer_mm2": self.area_mm2()}
