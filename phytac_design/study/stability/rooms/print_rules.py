"""Print rules: just kept and just broken, where geometry says exactly when."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.layout.receptor_distances import nearest_pair, smallest_receptor_gap_mm
from phytac_design.rules.check import check_design
from phytac_design.study.stability.bases import SHAPES, design_of
from phytac_design.study.stability.case import Case, Evidence, Expect, Room
from phytac_shapes.errors import DesignError

NEAR = 1e-6
"""mm that a rule is kept or broken by: a thousand times its slack, a thousandth of a printer's."""
SHOWN_mm = 0.051
"""Half of the last place that messages show."""


def check_rule(values: Mapping[str, Any], found: Evidence) -> None:
    """A design that keeps all rules has the gaps that geometry says; a refusal says by how much."""
    design = design_of(values)
    try:
        surface, markers = check_design(design)
    except DesignError as error:
        said = str(error)
        for figure in values.get("figures", []):
            numbers = [float(n) for n in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", said)]
            off = min((abs(n - figure) for n in numbers), default=np.inf)
            found.add(f"the message's figure, closed form {figure:.6g}, mm", off, SHOWN_mm)
        wanted = values.get("says", "")
        found.true(f"the rule that is broken is the one named ({wanted})", wanted in said)
        raise
    if "gap_mm" in values:
        gap = smallest_receptor_gap_mm(design, markers)[0]
        found.add("least gap between tubes: closed form, mm", gap - values["gap_mm"], 1e-9)
    elif markers.count > 1:
        apart = nearest_pair(surface.point(markers.uv))[0]
        pairs = surface.point(markers.uv)
        every = np.linalg.norm(pairs[:, None] - pairs[None], axis=2)
        least = every[~np.eye(len(pairs), dtype=bool)].min()
        found.add("least distance of feet: all pairs, mm", apart - least, 1e-9)
    else:
        found.true("one marker", markers.count == 1)


def cases() -> list[Case]:
    """Each rule kept by a millionth of a millimetre and broken by as much."""
    out: list[Case] = []

    def add(shape: str, name: str, expect: Expect, changes: Any, **more: Any) -> None:
        out.append(
            Case(
                room="print rules",
                name=f"{shape}: {name}",
                check="rule",
                shape=shape,
                expect=expect,
                values={"shape": shape, "changes": changes, **more},
            )
        )

    def both(shape: str, name: str, changes: Any, says: str, **more: Any) -> None:
        """``changes(d)`` keeps the rule where d > 0."""
        add(shape, f"{name}, just kept", "right", changes(NEAR), **more)
        figures = more.pop("figures", [])
        more.pop("gap_mm", None)
        add(
            shape,
            f"{name}, just broken",
            "refused",
            changes(-NEAR),
            says=says,
            figures=figures,
            **more,
        )

    small = {"footprint_diameter_mm": 1.5}
    pad = {"rows": 2, "kind": "straight"}
    pitch = SHAPES["plane"]["width_mm"] / 20.0
    both(
        "plane",
        "gap between parallel tubes",
        lambda d: {
            "layout": pad | {"columns": 20},
            "switch": small,
            "receptor": {"diameter_outer_mm": pitch - 0.3 - d, "diameter_hole_mm": 1.3},
        },
        "meet",
        gap_mm=0.3 + NEAR,
        figures=[0.3],
    )
    _round(both)
    both(
        "plane",
        "switches side by side",
        lambda d: {
            "layout": {"kind": "explicit", "positions": [[0.0, -5.0], [0.0, 5.0]]},
            "switch": {"footprint_diameter_mm": 10.0 - d},
        },
        "overlap on the outer face",
        figures=[10.0],
    )
    both(
        "plane",
        "a receptor at the edge",
        lambda d: {
            "layout": {"kind": "explicit", "positions": [[20.0 - 1.2 - d, 0.0]]},
            "wall": {"rim_flange_mm": 0.0},
        },
        "cuts the rim",
        figures=[1.2],
    )
    both(
        "plane",
        "a switch at the rim",
        lambda d: {"layout": {"kind": "explicit", "positions": [[20.0 - 2.0 - d, 0.0]]}},
        "cuts the rim",
        figures=[2.0],
    )
    both(
        "plane",
        "thin wall",
        lambda d: {"wall": {"thickness_mm": 0.4 + d}},
        "too thin to print",
        figures=[0.4],
    )
    both(
        "plane",
        "narrow hole",
        lambda d: {"receptor": {"diameter_hole_mm": 0.5 + d}, "switch": {"tip_diameter_mm": 0.2}},
        "would close",
        figures=[0.5],
    )
    both(
        "plane",
        "thin tube",
        lambda d: {"receptor": {"diameter_hole_mm": 1.6 - 2.0 * d}},
        "tube walls",
        figures=[0.4],
    )
    both(
        "plane",
        "tip in its hole",
        lambda d: {"switch": {"tip_diameter_mm": 1.1 - d}},
        "does not pass",
        figures=[0.3, 1.1],
    )
    both(
        "plane",
        "switch that releases",
        lambda d: {"switch": {"release_N": 0.5 - d}},
        "release below",
        figures=[0.5],
    )
    both(
        "plane",
        "stroke and recess",
        lambda d: {"switch": {"stroke_mm": 0.3 + d}},
        "never comes out",
        figures=[0.3],
    )
    both(
        "plane",
        "bowl over its hole",
        lambda d: {"switch": {"footprint_diameter_mm": 1.4 + d}},
        "does not cover",
        figures=[1.4],
    )
    both(
        "plane",
        "patch on its pad",
        lambda d: {"training": {"patch_radius_max_mm": 20.0 - d}},
        "larger than the sensor",
        figures=[20.0],
    )
    share = (4.0 / 8.0) ** 2
    both(
        "plane",
        "a contact that trips",
        lambda d: {"switch": {"threshold_N": 25.0 * share - d, "release_N": 0.1}},
        "trip a switch",
        figures=[25.0 * share],
    )
    for shape in SHAPES:
        _monsters(add, shape)
    return out


def _round(both: Any) -> None:
    """Tubes that close in on an axis: cylinder, cuboid, dome."""
    radius, wall, height, columns = 20.0, 0.8, 8.0, 16
    tips = 2.0 * (radius - wall - height) * np.sin(np.pi / columns)
    hole = {"diameter_hole_mm": 1.3}
    row = {"kind": "straight", "rows": 1, "columns": columns, "height_near_mm": height}
    both(
        "cylinder",
        "gap between tips around",
        lambda d: {"layout": row, "receptor": {"diameter_outer_mm": tips - 0.3 - d, **hole}},
        "meet",
        gap_mm=0.3 + NEAR,
        figures=[0.3],
    )
    chord = 2.0 * radius * np.sin(np.pi / columns)
    both(
        "cylinder",
        "switches around",
        lambda d: {
            "layout": row | {"height_near_mm": 1.0},
            "switch": {"footprint_diameter_mm": chord - d},
        },
        "overlap on the outer face",
        figures=[chord],
    )
    two = {"kind": "straight", "rows": 1, "columns": 1, "height_near_mm": 14.0}
    both(
        "cylinder",
        "a tip at the light bar",
        lambda d: {
            "layout": two,
            "light": {"bar_radius_mm": radius - wall - 14.0 - 0.3 - d},
            "switch": {"stroke_mm": 0.35},
        },
        "light bar",
        figures=[14.0],
    )
    both(
        "cylinder",
        "a tip at the axis",
        lambda d: {"layout": two | {"height_near_mm": radius - wall - d}},
        "collide at the axis",
        figures=[19.2],
    )
    both(
        "cylinder",
        "a wall to the axis",
        lambda d: {
            "wall": {"thickness_mm": radius - 0.2 - 0.1 * d},
            "layout": two | {"height_near_mm": 0.2 - d if d > 0 else 0.2},
        },
        "collide",
        figures=[],
    )
    both(
        "cuboid",
        "a wall as thick as its edges",
        lambda d: {
            "wall": {"thickness_mm": 6.0 - d},
            "layout": {"kind": "explicit", "positions": [[16.0, 0.0]], "height_near_mm": 1.0},
        },
        "thicker than the cuboid allows",
        figures=[6.0],
    )
    both(
        "hemisphere",
        "a tip at the dome's centre",
        lambda d: {
            "layout": {
                "kind": "explicit",
                "positions": [[20.0, 0.0]],
                "height_near_mm": radius - wall - d,
            }
        },
        "normals meet",
        figures=[19.2],
    )


def _monsters(add: Any, shape: str) -> None:
    """What no printer makes, whatever the shape."""
    table = {
        "tubes of 200 mm": {"receptor": {"diameter_outer_mm": 200.0}},
        "a wall of 100 mm": {"wall": {"thickness_mm": 100.0}},
        "heights of 1 m": {"layout": {"height_near_mm": 1000.0}},
        "bowls of 500 mm": {"switch": {"footprint_diameter_mm": 500.0}},
        "holes wider than tubes": {"receptor": {"diameter_hole_mm": 2.5}},
        "patches of 1 m": {"training": {"patch_radius_max_mm": 1000.0}},
        "thresholds of 1 kN": {"switch": {"threshold_N": 1000.0}},
        "four million markers": {"layout": {"kind": "straight", "rows": 2000, "columns": 2000}},
    }
    for name, changes in table.items():
        flat = shape in ("plane", "patch")
        expect = "either" if flat and "heights" in name else "refused"
        if flat and name == "a wall of 100 mm":
            expect = "either"
        add(shape, name, expect, changes)


ROOM = Room(
    name="print rules",
    about="every rule kept and broken by a millionth of a millimetre; monsters",
    checks={"rule": check_rule},
    cases=cases,
)
