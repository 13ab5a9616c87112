"""Designs and a doubly curved surface that the fabrication tests build on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design_file import load_design
from phytac_design.layout import Markers, make_markers
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import FloatArray
from shapes.surface import Surface as Base


def shipped(name: str) -> Design:
    return load_design(name)


def design(**sections: dict[str, Any]) -> Design:
    """A ø60 x 120 cylinder with a small lattice, changed section by section."""
    base: dict[str, Any] = {
        "name": "case",
        "shape": {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0},
        "layout": {"rows": 3, "columns": 4},
    }
    for section, values in sections.items():
        base[section] = {**base.get(section, {}), **values}
    return Design.model_validate(base)


def built(case: Design) -> tuple[Design, Surface, Markers]:
    surface = case.surface()
    return case, surface, make_markers(case, surface)


def scaled(case: Design, factor: float) -> Design:
    """The same sensor, every length times ``factor``."""
    data = case.model_dump()

    def walk(table: dict[str, Any]) -> dict[str, Any]:
        return {
            key: walk(value)
            if isinstance(value, dict)
            else value * factor
            if key.endswith("_mm") and isinstance(value, float)
            else value
            for key, value in table.items()
        }

    return Design.model_validate(walk(data))


@dataclass(frozen=True, kw_only=True)
class Barrel(Base):
    """A zone of a sphere of radius ``ball_mm``: curved both ways; u is the latitude (rad)."""

    ball_mm: float = 40.0
    latitude: float = 0.6
    name = "barrel"

    @property
    def domain(self) -> FloatArray:
        return np.array([[-self.latitude, self.latitude], [0.0, 2.0 * np.pi]])

    @property
    def periodic(self) -> tuple[bool, bool]:
        return (False, True)

    def normal(self, uv: FloatArray) -> FloatArray:
        u, v = np.asarray(uv, dtype=np.float64).T
        return np.column_stack([np.cos(u) * np.cos(v), np.cos(u) * np.sin(v), np.sin(u)])

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        radius = np.broadcast_to(self.ball_mm + np.asarray(offset_mm), (len(uv),))
        points = self.normal(uv) * radius[:, None]
        points[:, 2] += self.ball_mm * np.sin(self.latitude)
        return points

    def tangents(self, uv: FloatArray) -> FloatArray:
        u, v = np.asarray(uv, dtype=np.float64).T
        along = [-np.sin(u) * np.cos(v), -np.sin(u) * np.sin(v), np.cos(u)]
        around = [-np.cos(u) * np.sin(v), np.cos(u) * np.cos(v), 0.0 * u]
        return self.ball_mm * np.stack([np.column_stack(along), np.column_stack(around)], axis=1)

    def chart(self, points_mm: FloatArray) -> FloatArray:
        x, y, z = points_mm.T
        z = z - self.ball_mm * np.sin(self.latitude)
        return np.column_stack(
            [np.arctan2(z, np.hypot(x, y)), np.mod(np.arctan2(y, x), 2.0 * np.pi)]
        )

    def intersect(self, *_: Any, **__: Any) -> FloatArray:
        raise NotImplementedError

    def unwrap(self, uv: FloatArray) -> FloatArray:
        return self.ball_mm * np.asarray(uv)[:, ::-1]

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        return float(4.0 * np.pi * (self.ball_mm + offset_mm) ** 2 * np.sin(self.latitude))

    def inner_reach_mm(self) -> float:
        return self.ball_mm

    def facts(self) -> dict[str, float]:
        return {}
