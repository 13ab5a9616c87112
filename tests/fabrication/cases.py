"""Designs and a doubly curved surface that the fabrication tests build on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.surface import Surface as Base


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
        other = section == "shape" and values.get("kind", "cylinder") != "cylinder"
        base[section] = values if other else {**base.get(section, {}), **values}
    return Design.model_validate(base)


def waved(rows: int, columns: int, width: float, height: float) -> list[list[list[float]]]:
    """A gently curved grid of points, concave towards the camera, 40 mm in front of it."""
    y, x = np.meshgrid(
        np.linspace(-height / 2.0, height / 2.0, rows),
        np.linspace(-width / 2.0, width / 2.0, columns),
        indexing="ij",
    )
    z = 40.0 - 0.006 * x**2 - 0.004 * y**2 + 0.5 * np.sin(x / 9.0) * np.cos(y / 7.0)
    points: list[list[list[float]]] = np.stack([x, y, z], axis=-1).tolist()
    return points


FAMILIES: dict[str, dict[str, Any]] = {
    "cylinder": {"kind": "cylinder", "diameter_outer_mm": 40.0, "length_mm": 50.0},
    "cone": {"kind": "cone", "diameter_near_mm": 50.0, "diameter_far_mm": 36.0, "length_mm": 50.0},
    "capped cone": {
        "kind": "cone",
        "diameter_near_mm": 50.0,
        "diameter_far_mm": 36.0,
        "length_mm": 40.0,
        "end": "cap",
    },
    "plane": {"kind": "plane", "width_mm": 60.0, "height_mm": 40.0, "tilt_deg": 15.0},
    "cuboid": {
        "kind": "cuboid",
        "width_mm": 46.0,
        "depth_mm": 36.0,
        "length_mm": 50.0,
        "edge_radius_mm": 6.0,
    },
    "hemisphere": {"kind": "hemisphere", "diameter_outer_mm": 50.0, "skirt_mm": 10.0},
    "grip": {"kind": "grip", "diameters_mm": [40.0, 44.0, 38.0, 42.0], "length_mm": 60.0},
    "patch": {"kind": "patch", "points_mm": waved(4, 5, 60.0, 44.0)},
}
"""A small shape of every family and topology."""


def family_design(name: str, **layout: Any) -> Design:
    """A small design on one of ``FAMILIES``, 3 rows of 4 short receptors, no light bar."""
    return design(
        shape=FAMILIES[name],
        layout={"kind": "straight", "height_far_mm": 3.0, **layout},
        light={"bar_radius_mm": 0.0},
    )


def built(case: Design) -> tuple[Design, Surface, Markers]:
    surface = case.surface()
    return case, surface, make_markers(case, surface)


SENSOR = ("shape", "wall", "layout", "receptor", "switch", "camera", "light", "training")
"""Tables that hold a sensor's own lengths; what is bought or printed beside it stays."""
RULES = ("wall_min_mm", "hole_min_mm", "gap_min_mm")


def scaled(case: Design, factor: float) -> Design:
    """The same sensor, every length times ``factor``."""
    data = case.model_dump()

    def walk(table: dict[str, Any]) -> dict[str, Any]:
        return {
            key: value * factor if key.endswith("_mm") and isinstance(value, float) else value
            for key, value in table.items()
        }

    for name in SENSOR:
        data[name] = walk(data[name])
    data["switch"]["wall_tolerance_mm"] = case.switch.wall_tolerance_mm
    data["print_rules"] |= walk({name: data["print_rules"][name] for name in RULES})
    return Design.model_validate(data)


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
