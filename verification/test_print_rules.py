"""Print rules: just kept and just broken, where geometry says exactly when."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.layout.receptor_distances import nearest_pair, smallest_receptor_gap_mm
from phytac_design.rules.check import check_design
from phytac_shapes.errors import DesignError
from verification.case import Case, Cases, Evidence, Recorder, verify
from verification.designs import SHAPES, design_of

NEAR = 1e-6
"""mm that a rule is kept or broken by: a thousand times its slack, a thousandth of a printer's."""
SHOWN_mm = 0.051
"""Half of the last place that messages show."""


def check_rule(values: Mapping[str, Any], found: Evidence) -> None:
    """A design that keeps all rules has the gaps that geometry says; a refusal says by how much."""
    design = design_of(values)
    try:
        sensor = check_design(design)
        surface, markers = sensor.surface, sensor.markers
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
        found.add("minimum gap between tubes: closed form, mm", gap - values["gap_mm"], 1e-9)
    elif markers.count > 1:
        apart = nearest_pair(surface.point(markers.uv))[0]
        pairs = surface.point(markers.uv)
        every = np.linalg.norm(pairs[:, None] - pairs[None], axis=2)
        least = every[~np.eye(len(pairs), dtype=bool)].min()
        found.add("minimum distance of receptors: all pairs, mm", apart - least, 1e-9)
    else:
        found.true("one marker", markers.count == 1)


def cases() -> Cases:
    """Each rule kept by a millionth of a millimetre and broken by as much."""
    out = Cases()
    for shape, table in (("plane", _flat()), *_round().items()):
        for name, (changes, says, figures, *gap) in table.items():
            # ``changes(d)`` keeps the rule where d > 0.
            exact = {"gap_mm": gap[0]} if gap else {}
            out.add_design(shape, f"{name}, just kept", check_rule, changes(NEAR), **exact)
            message = {"says": says, "figures": figures}
            broken = changes(-NEAR)
            out.add_design(shape, f"{name}, just broken", check_rule, broken, "refused", **message)
    monsters: dict[str, Any] = {
        "tubes of 200 mm": {"receptor": {"diameter_outer_mm": 200.0}},
        "a wall of 100 mm": {"wall": {"thickness_mm": 100.0}},
        "heights of 1 m": {"layout": {"height_near_mm": 1000.0}},
        "bowls of 500 mm": {"switch": {"footprint_diameter_mm": 500.0}},
        "holes wider than tubes": {"receptor": {"diameter_hole_mm": 2.5}},
        "patches of 1 m": {"training": {"patch_radius_max_mm": 1000.0}},
        "thresholds of 1 kN": {"switch": {"threshold_N": 1000.0}},
        "four million markers": {"layout": {"kind": "straight", "rows": 2000, "columns": 2000}},
    }
    for shape in SHAPES:
        for name, change in monsters.items():
            flat = shape in ("plane", "patch") and name in ("heights of 1 m", "a wall of 100 mm")
            out.add_design(shape, name, check_rule, change, "either" if flat else "refused")
    return out


Rules = dict[str, tuple[Any, ...]]
"""Rule: changes by the margin, words and figures of the message, the gap in closed form."""


def _flat() -> Rules:
    pitch = SHAPES["plane"]["width_mm"] / 20.0
    share = (4.0 / 8.0) ** 2

    def at(*places: tuple[float, float], **tables: Any) -> Any:
        return {"layout": {"kind": "explicit", "positions": [list(p) for p in places]}, **tables}

    return {
        "gap between parallel tubes": (
            lambda d: {
                "layout": {"rows": 2, "kind": "straight", "columns": 20},
                "switch": {"footprint_diameter_mm": 1.5},
                "receptor": {"diameter_outer_mm": pitch - 0.3 - d, "diameter_hole_mm": 1.3},
            },
            "meet",
            [0.3],
            0.3 + NEAR,
        ),
        "switches side by side": (
            lambda d: at((0, -5), (0, 5), switch={"footprint_diameter_mm": 10.0 - d}),
            "overlap on the outer face",
            [10.0],
        ),
        "a receptor at the edge": (
            lambda d: at((20.0 - 1.2 - d, 0.0), wall={"rim_flange_mm": 0.0}),
            "cuts the rim",
            [1.2],
        ),
        "a switch at the rim": (lambda d: at((20.0 - 2.0 - d, 0.0)), "cuts the rim", [2.0]),
        "thin wall": (lambda d: {"wall": {"thickness_mm": 0.4 + d}}, "too thin to print", [0.4]),
        "narrow hole": (
            lambda d: {
                "receptor": {"diameter_hole_mm": 0.5 + d},
                "switch": {"tip_diameter_mm": 0.2},
            },
            "would close",
            [0.5],
        ),
        "thin tube": (
            lambda d: {"receptor": {"diameter_hole_mm": 1.6 - 2.0 * d}},
            "tube walls",
            [0.4],
        ),
        "tip in its hole": (
            lambda d: {"switch": {"tip_diameter_mm": 1.1 - d}},
            "does not pass",
            [0.3, 1.1],
        ),
        "switch that releases": (
            lambda d: {"switch": {"release_N": 0.5 - d}},
            "release below",
            [0.5],
        ),
        "stroke and recess": (
            lambda d: {"switch": {"stroke_mm": 0.3 + d}},
            "never comes out",
            [0.3],
        ),
        "bowl over its hole": (
            lambda d: {"switch": {"footprint_diameter_mm": 1.4 + d}},
            "does not cover",
            [1.4],
        ),
        "patch on its pad": (
            lambda d: {"training": {"patch_radius_max_mm": 20.0 - d}},
            "larger than the sensor",
            [20.0],
        ),
        "a contact that trips": (
            lambda d: {"switch": {"threshold_N": 25.0 * share - d, "release_N": 0.1}},
            "trip a switch",
            [25.0 * share],
        ),
    }


def _round() -> dict[str, Rules]:
    """Tubes that converge on an axis: cylinder, cuboid, dome."""
    radius, wall, height, columns = 20.0, 0.8, 8.0, 16
    tips = 2.0 * (radius - wall - height) * np.sin(np.pi / columns)
    chord = 2.0 * radius * np.sin(np.pi / columns)
    row = {"kind": "straight", "rows": 1, "columns": columns, "height_near_mm": height}
    one = row | {"columns": 1, "height_near_mm": 14.0}
    explicit = {"kind": "explicit", "height_near_mm": 1.0}
    cylinder: Rules = {
        "gap between tips around": (
            lambda d: {
                "layout": row,
                "receptor": {"diameter_outer_mm": tips - 0.3 - d, "diameter_hole_mm": 1.3},
            },
            "meet",
            [0.3],
            0.3 + NEAR,
        ),
        "switches around": (
            lambda d: {
                "layout": row | {"height_near_mm": 1.0},
                "switch": {"footprint_diameter_mm": chord - d},
            },
            "overlap on the outer face",
            [chord],
        ),
        "a tip at the light bar": (
            lambda d: {
                "layout": one,
                "light": {"bar_radius_mm": radius - wall - 14.0 - 0.3 - d},
                "switch": {"stroke_mm": 0.35},
            },
            "light bar",
            [14.0],
        ),
        "a tip at the axis": (
            lambda d: {"layout": one | {"height_near_mm": radius - wall - d}},
            "collide at the axis",
            [19.2],
        ),
        "a wall to the axis": (
            lambda d: {
                "wall": {"thickness_mm": radius - 0.2 - 0.1 * d},
                "layout": one | {"height_near_mm": 0.2 - max(d, 0.0)},
            },
            "collide",
            [],
        ),
    }
    cuboid: Rules = {
        "a wall as thick as its edges": (
            lambda d: {
                "wall": {"thickness_mm": 6.0 - d},
                "layout": explicit | {"positions": [[16.0, 0.0]]},
            },
            "thicker than the cuboid allows",
            [6.0],
        )
    }
    dome: Rules = {
        "a tip at the dome's centre": (
            lambda d: {
                "layout": explicit
                | {"positions": [[20.0, 0.0]], "height_near_mm": radius - wall - d}
            },
            "normals meet",
            [19.2],
        )
    }
    return {"cylinder": cylinder, "cuboid": cuboid, "hemisphere": dome}


CASES = cases()


@CASES.parametrize
def test_print_rules(case: Case, record_property: Recorder) -> None:
    """Every rule kept and broken by a millionth of a millimetre; sizes that no printer makes."""
    verify(case, record_property)
