"""The mold's own details against the printer's rules."""

from typing import Any

import numpy as np

from phytac_design.fabrication.molds.cavity import Cavity, MoldSizes
from phytac_design.fabrication.molds.plates import FREEBOARD_mm, label_sizes_mm


def rule_rows(sizes: MoldSizes) -> list[dict[str, Any]]:
    """Each detail, the thinnest of its kind: what, got, needed (mm), and whether it holds."""
    section, rules = sizes.section, sizes.rules
    cavities = list(sizes.cavities.values())
    stroke, height = label_sizes_mm(rules)
    top = 2.0 * float(sizes.key(socket=False)[1, 0])
    rows = [
        ("pinching ring", section.land_mm, rules.wall_min_mm),
        ("channel", section.channel_mm, rules.engrave_min_mm),
        ("frame and fence", section.wall_mm, rules.wall_free_min_mm),
        ("strokes of labels", stroke, rules.emboss_min_mm),
        ("height of labels", height, rules.emboss_min_mm),
        ("key, diameter at its top", top, rules.post_diameter_mm(sizes.key_height_mm)),
        ("wall around a key's socket", sizes.key_wall_mm, rules.wall_free_min_mm),
        ("ridge of a core", min(_ridge_mm(cavity) for cavity in cavities), rules.wall_min_mm),
    ]
    if sizes.strips is not None:
        web = sizes.strips.section
        rows.append(("web between bowls", web.web_width_mm, rules.engrave_min_mm))
    if section.way == "rigid":
        tip = min(float(cavity.under[-1, 0]) for cavity in cavities)
        rows.append(("stem hole", 2.0 * tip, rules.hole_min_mm))
        rows.append(("wall between troughs", sizes.trough_wall_mm, rules.wall_min_mm))
    else:
        pegs = [_peg_mm(sizes, cavity) for cavity in cavities]
        rows.append(("stem and vent, mean diameter", *min(pegs, key=lambda peg: peg[0] - peg[1])))
    return [
        {"detail": name, "got_mm": got, "needed_mm": need, "holds": bool(got >= need - 1e-9)}
        for name, got, need in rows
    ]


def _ridge_mm(cavity: Cavity) -> float:
    """Width of a core a little below its ridge: the thinnest wall that stands free."""
    below_mm = 0.2  # where the thickness of a core's ridge is taken, below its top
    r, z = cavity.under.T
    top = int(z.argmax())
    level = z[top] - below_mm
    outer = np.interp(level, z[: top + 1], r[: top + 1])
    inner = np.interp(-level, -z[top:], r[top:])
    return float(outer - inner)


def _peg_mm(sizes: MoldSizes, cavity: Cavity) -> tuple[float, float]:
    """Mean diameter of a stem's peg with its vent, and what its height needs."""
    level = sizes.depth_mm + FREEBOARD_mm
    foot = float(cavity.under[:, 1].max())
    vent = float(sizes.vent(cavity, level)[:, 0].sum())
    stem = float(cavity.under[-2:, 0].sum())
    mean = stem * (cavity.reach_mm + foot) + vent * (level - cavity.reach_mm)
    return mean / (level + foot), sizes.rules.post_diameter_mm(level + foot)
