r"""A box with rounded edges around the optical axis, open at both ends; chosen faces sense.

::

        y                              camera ◁   +-------------------+
        |                                         |                   |
      .-+--------.    rounded edges      axis - - | - - - - - - - - - | - - ▷ z
      | |        |                                |                   |
    --+-+--------+-- x    v runs around from      +-------------------+
      | |        |        the middle of +x      z = 0             z = length
      `-+--------´
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, get_args

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError
from phytac_shapes.plane_curves import Arc, Line, Path
from phytac_shapes.surface import Surface
from phytac_shapes.variables import check_variables, choice, variable

Face = Literal["+x", "+y", "-x", "-y"]
FACES = get_args(Face)


@dataclass(frozen=True, kw_only=True)
class Cuboid(Surface):
    """Rounded box; chart u = z (mm), v = length around the outer cross-section (mm)."""

    width_mm: float = variable("Outer size along x.", minimum=1.0, maximum=2000.0)
    depth_mm: float = variable("Outer size along y.", minimum=1.0, maximum=2000.0)
    length_mm: float = variable(
        "Length along the axis between the two rims.", minimum=1.0, maximum=5000.0
    )
    edge_radius_mm: float = variable(
        "Outer radius of the four rounded edges; more than the wall's thickness.",
        minimum=0.01,
        maximum=1000.0,
    )
    faces: tuple[Face, ...] = choice(
        "Faces that carry markers; the rounded edges go with the face they begin.",
        default=FACES,
    )
    name: ClassVar[str] = "cuboid"

    def __post_init__(self) -> None:
        check_variables(self)
        least = min(self.width_mm, self.depth_mm)
        if 2.0 * self.edge_radius_mm >= least:
            raise DesignError(
                "cuboid-edge-radius",
                f"cuboid: edge_radius_mm must be less than half of the smaller side (got "
                f"{self.edge_radius_mm:g} for {least:g} mm); lower it, or use a cylinder",
            )
        unknown = [face for face in self.faces if face not in FACES]
        if unknown or not self.faces or len(set(self.faces)) != len(self.faces):
            raise DesignError(
                "cuboid-faces",
                f"cuboid: faces must be some of {', '.join(FACES)}, each once "
                f"(got {', '.join(self.faces) or 'none'})",
            )

    @cached_property
    def _path(self) -> Path:
        """Outer cross-section, anticlockwise from the middle of +x."""
        x, y, r = self.width_mm / 2.0, self.depth_mm / 2.0, self.edge_radius_mm
        quarter = float(np.pi / 2.0)

        def edge(cx: float, cy: float, k: int) -> Arc:
            return Arc(centre=(cx, cy), radius=r, first=k * quarter, last=(k + 1) * quarter)

        return Path(
            parts=(
                Line(start=(x, 0.0), end=(x, y - r)),
                edge(x - r, y - r, 0),
                Line(start=(x - r, y), end=(r - x, y)),
                edge(r - x, y - r, 1),
                Line(start=(-x, y - r), end=(-x, r - y)),
                edge(r - x, r - y, 2),
                Line(start=(r - x, -y), end=(x - r, -y)),
                edge(x - r, r - y, 3),
                Line(start=(x, r - y), end=(x, 0.0)),
            ),
            closed=True,
        )

    @property
    def perimeter_mm(self) -> float:
        """Length around the outer cross-section."""
        return self._path.length

    @property
    def domain(self) -> FloatArray:
        """Chart limits: z in [0, L], v in [0, perimeter)."""
        return np.array([[0.0, self.length_mm], [0.0, self._path.length]])

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Closed around, open along."""
        return (False, True)

    def sensing(self, uv: FloatArray) -> BoolArray:
        """Whether the face at ``uv`` is one of ``faces``; edges are halved between faces."""
        normal = self.normal(uv)
        turn = np.arctan2(normal[:, 1], normal[:, 0]) / (np.pi / 2.0)
        face = np.mod(np.rint(turn), 4).astype(np.int64)
        return np.isin(face, [FACES.index(item) for item in self.faces])

    def normal(self, uv: FloatArray) -> FloatArray:
        """Unit vectors square to the axis, (n, 3)."""
        heading = self._path.at(np.asarray(uv, dtype=np.float64)[:, 1])[1]
        return np.column_stack([heading[:, 1], -heading[:, 0], np.zeros(len(heading))])

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points of the offset face, (n, 3) mm."""
        uv = np.asarray(uv, dtype=np.float64)
        xy, heading = self._path.at(uv[:, 1])
        offset = np.broadcast_to(np.asarray(offset_mm, dtype=np.float64), uv.shape[:1])[:, None]
        out = xy + offset * np.column_stack([heading[:, 1], -heading[:, 0]])
        return np.column_stack([out, uv[:, 0]])

    def tangents(self, uv: FloatArray) -> FloatArray:
        """d/dz and d/dv, unit vectors, (n, 2, 3)."""
        heading = self._path.at(np.asarray(uv, dtype=np.float64)[:, 1])[1]
        zero = np.zeros(len(heading))
        along = np.column_stack([zero, zero, np.ones(len(heading))])
        return np.stack([along, np.column_stack([heading, zero])], axis=1)

    def chart(self, points_mm: FloatArray) -> FloatArray:
        """(z, v in [0, perimeter)) of each point, (n, 2)."""
        p = np.asarray(points_mm, dtype=np.float64)
        return np.column_stack([p[:, 2], np.mod(self._path.foot(p[:, :2]), self._path.length)])

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """(v, z) in mm: the box unrolls without stretch, (n, 2)."""
        uv = np.asarray(uv, dtype=np.float64)
        return uv[:, ::-1].copy()

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """(perimeter + 2π·offset)·L."""
        return float((self._path.length + 2.0 * np.pi * offset_mm) * self.length_mm)

    def reach_mm(self, uv: FloatArray) -> FloatArray:
        """Half the box on its faces, the edge's radius on its edges, (n,) mm."""
        uv = np.asarray(uv, dtype=np.float64)
        curved = self._path.curvature(uv[:, 1]) > 0.0
        across = np.abs(self.normal(uv)[:, 0]) > np.sqrt(0.5)
        flat = np.where(across, self.width_mm / 2.0, self.depth_mm / 2.0)
        return np.where(curved, self.edge_radius_mm, flat)

    def inner_reach_mm(self) -> float:
        """Radius of the edges: deeper, a wall would cross itself there."""
        return self.edge_radius_mm

    def facts(self) -> Mapping[str, float]:
        """Outer area and perimeter."""
        return {
            "area_outer_mm2": self.area_mm2(),
            "perimeter_outer_mm": self._path.length,
            "length_mm": self.length_mm,
        }
