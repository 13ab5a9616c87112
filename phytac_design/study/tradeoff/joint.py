"""Joint settings of a build: groups of settings that act together, their cost and errors.

The time of a joint setting is the sum over its groups of the stages that depend on them, each
measured alone. Each error depends on one group, but visibility also on the mesh of the mechanics.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.stages.response_stage import samples_of
from phytac_design.study.tradeoff.front import MeasuredSetting
from phytac_design.study.tradeoff.pilot import visibility_error
from phytac_design.study.tradeoff.points import Point, Points

Settings = Mapping[str, Any]
FIXED = "views,switch,pressed,report"
CAD = "shell,step,hardware,mold,kit,inserts,printing,bench,compare"
MECHANICS = "mesh,response,resolution,places"
LOAD = "underload"
SCORE = "twin,decoder,renders,frames"
"""Stages of a build by the group of settings that their seconds depend on: every stage once."""


@dataclass(frozen=True, kw_only=True)
class JointGrid:
    """Groups of settings that act together, each from the cheapest to the finest.

    Attributes
    ----------
    mechanics : tuple of dict
        Two and three powers are omitted: Koiter's expansion, which fails on flat faces.
    load_refine : tuple of int
        Coarsest mesh that each entry of ``load`` is measured with: many presses on a coarse mesh
        are useless.
    """

    cad: tuple[Settings, ...] = (
        {"cad_tolerance_mm": 0.05, "tools": False, "step": False},
        {"cad_tolerance_mm": 0.02, "tools": True, "step": True},
        {"cad_tolerance_mm": 0.01, "tools": True, "step": True},
        {"cad_tolerance_mm": 0.005, "tools": True, "step": True},
    )
    mechanics: tuple[Settings, ...] = tuple(
        {"refine": refine, "place_orders": orders, "place_share": share}
        for refine, orders, share in (
            (3, 1, 0.8),
            (4, 1, 0.8),
            (3, 4, 0.8),
            (4, 4, 0.8),
            (4, 4, 0.55),
            (6, 4, 0.55),
            (6, 5, 0.4),
        )
    )
    load: tuple[Settings, ...] = (
        {"press_places": 8, "press_tolerance": 1.0},
        {"press_places": 20, "press_tolerance": 1.0},
        {"press_places": 40, "press_tolerance": 0.05},
        {"press_places": 120, "press_tolerance": 0.02},
    )
    load_refine: tuple[int, ...] = (2, 2, 4, 4)
    score: tuple[Settings, ...] = (
        {"truth_refine": 5, "sample_share": 0.3, "frames": 5},
        {"truth_refine": 7, "sample_share": 1.0, "frames": 20},
        {"truth_refine": 9, "sample_share": 1.0, "frames": 50},
        {"truth_refine": 13, "sample_share": 1.0, "frames": 100},
    )


def joint_settings(points: Points, *, quick: bool = False) -> list[MeasuredSetting]:
    """Every joint setting of one design, with seconds, memory and errors.

    Parameters
    ----------
    points : Points
        Where points are measured.
    quick : bool
        Only the cheapest few of each group.
    """
    grid, (cut, one) = JointGrid(), (2, 1) if quick else (None, None)
    groups = grid.cad[:cut], grid.mechanics[:cut], grid.load[:one], grid.score[:one]

    def run(stages: str, settings: Settings) -> dict[str, Any]:
        return points.get(Point(kind="stages", name=stages, settings=settings))

    def errors(kind: Literal["force", "truth"], each: Sequence[Settings]) -> list[float]:
        found = points.get(Point(kind=kind, name=kind, settings={"each": [dict(s) for s in each]}))
        return [float(error) for error in found["errors"]]

    fixed = run(FIXED, {})
    cad = [run(CAD, s) for s in groups[0]]
    force = errors("force", groups[1])
    mechanics = [run(MECHANICS, s) for s in groups[1]]
    meshes = sorted({s["refine"] for s in groups[1]})
    load = {
        (refine, k): run(LOAD, {"refine": refine, **s})
        for refine in meshes
        for k, s in enumerate(groups[2])
        if refine >= grid.load_refine[k] or refine == meshes[-1]
    }
    finest = load[meshes[-1], len(groups[2]) - 1]["clearance"]
    truth = errors("truth", [{"truth_refine": s["truth_refine"]} for s in groups[3]])
    score = [run(SCORE, s) for s in groups[3]]
    out = []
    for c, m, k, s in product(*(range(len(group)) for group in groups)):
        pressed = load.get((groups[1][m]["refine"], k))
        if pressed is None:
            continue
        parts = (fixed, cad[c], mechanics[m], pressed, score[s])
        out.append(
            MeasuredSetting(
                settings={
                    "receptors": True,
                    **groups[0][c],
                    **groups[1][m],
                    **groups[2][k],
                    **groups[3][s],
                },
                seconds=sum(part["seconds"] for part in parts),
                cpu_s=sum(part["cpu_s"] for part in parts),
                peak_MB=max(part["peak_MB"] for part in parts),
                errors={
                    "force": force[m],
                    "visibility": visibility_error(pressed["clearance"], finest),
                    "volume": abs(cad[c]["volume_mm3"] / cad[-1]["volume_mm3"] - 1.0),
                    "score": score_error(points.design, groups[3][s], truth[s]),
                },
            )
        )
    return out


def score_error(design: Design, settings: Settings, truth: float) -> float:
    """Relative error of the scores of a report: few contacts, and a coarse mesh of the truth.

    The mean of n errors whose scatter equals their size has a relative error of 1/√n.
    """
    frames = int(settings["frames"])
    samples = samples_of(design, float(settings["sample_share"]), frames)["test"]
    few = 1.0 / np.sqrt(min(samples, frames))
    return float(np.hypot(few, truth))
