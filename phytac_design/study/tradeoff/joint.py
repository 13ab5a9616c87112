"""Joint settings of a build: groups of knobs that act together, and what each costs and loses.

The time of a setting is the sum over its groups of the stages that they touch, each measured
alone; its errors are of four kinds (:data:`knobs.QUANTITIES`), each of one group, but that the mesh
of the mechanics is also the one that is pressed under the camera.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.stages.response import samples_of
from phytac_design.study.tradeoff.front import Measured
from phytac_design.study.tradeoff.points import Point, Points
from phytac_design.study.tradeoff.room import visibility_error

Settings = Mapping[str, Any]
FIXED = ("views", "switch", "compare", "step", "decoder", "report")
"""Stages that no knob of the front changes in time."""
CAD_STAGES = ("shell", "hardware", "mold", "kit", "printing", "bench")
MECHANICS_STAGES = ("mesh", "response", "resolution", "places")
CAD: tuple[Settings, ...] = (
    {"cad_tolerance_mm": 0.05, "print_tools": False},
    {"cad_tolerance_mm": 0.02, "print_tools": True},
    {"cad_tolerance_mm": 0.01, "print_tools": True},
    {"cad_tolerance_mm": 0.005, "print_tools": True},
)
MECHANICS: tuple[Settings, ...] = tuple(
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
"""Two and three powers are left out: Koiter's expansion, which flat faces (none is among the
designs of the presets' fronts) leave far behind."""
LOAD: tuple[Settings, ...] = (
    {"press_places": 8, "press_tolerance": 1.0},
    {"press_places": 20, "press_tolerance": 1.0},
    {"press_places": 40, "press_tolerance": 0.05},
    {"press_places": 120, "press_tolerance": 0.02},
)
LOAD_REFINE = (2, 2, 4, 4)
"""Least mesh that each of these is measured with: many presses on a coarse one are of no use."""
SCORE: tuple[Settings, ...] = (
    {"truth_refine": 5, "sample_share": 0.3, "frames": 5},
    {"truth_refine": 7, "sample_share": 1.0, "frames": 20},
    {"truth_refine": 9, "sample_share": 1.0, "frames": 50},
    {"truth_refine": 13, "sample_share": 1.0, "frames": 100},
)
BASE: Settings = {"receptors": True}


@dataclass(frozen=True, kw_only=True)
class Part:
    """What one group costs at one of its settings: seconds, CPU seconds, peak MB."""

    seconds: float
    cpu_s: float
    peak_MB: float


def _spent(*results: Mapping[str, Any]) -> Part:
    return Part(
        seconds=sum(float(r["seconds"]) for r in results),
        cpu_s=sum(float(r["cpu_s"]) for r in results),
        peak_MB=max(float(r["peak_MB"]) for r in results),
    )


class Joint:
    """Joint settings of one design, measured through its journal.

    Parameters
    ----------
    points : Points
        Where points are measured.
    quick : bool
        The cheapest few of each group alone.
    """

    def __init__(self, points: Points, *, quick: bool = False) -> None:
        self.points = points
        cut = 2 if quick else None
        self.groups = [CAD[:cut], MECHANICS[:cut], LOAD[: cut and 1], SCORE[: cut and 1]]

    def measured(self) -> list[Measured]:
        """Every joint setting, with seconds, memory and errors."""
        fixed = _spent(self._ran(FIXED, {}))
        cad = [self._cad(s) for s in self.groups[0]]
        finest = cad[-1][1]
        forces = self._errors("force", [dict(s) for s in self.groups[1]])
        mechanics = [
            (_spent(self._ran(MECHANICS_STAGES, s)), error)
            for s, error in zip(self.groups[1], forces, strict=True)
        ]
        meshes = {s["refine"] for s in self.groups[1]}
        load = {
            (refine, k): self._load({"refine": refine} | dict(s))
            for refine in sorted(meshes)
            for k, s in enumerate(self.groups[2])
            if refine >= LOAD_REFINE[k] or refine == max(meshes)
        }
        clearest = load[max(meshes), len(self.groups[2]) - 1][1]
        score = self._scores()
        out = []
        for c, m, k, s in product(*(range(len(group)) for group in self.groups)):
            if (self.groups[1][m]["refine"], k) not in load:
                continue
            settings = dict(BASE)
            for group, index in zip(self.groups, (c, m, k, s), strict=True):
                settings |= group[index]
            pressed = load[settings["refine"], k]
            parts = (fixed, cad[c][0], mechanics[m][0], pressed[0], score[s][0])
            out.append(
                Measured(
                    settings=settings,
                    seconds=sum(part.seconds for part in parts),
                    cpu_s=sum(part.cpu_s for part in parts),
                    peak_MB=max(part.peak_MB for part in parts),
                    errors={
                        "force": mechanics[m][1],
                        "visibility": visibility_error(pressed[1], clearest),
                        "volume": abs(cad[c][1] / finest - 1.0),
                        "score": score[s][1],
                    },
                )
            )
        return out

    def _ran(self, names: Sequence[str], settings: Settings) -> dict[str, Any]:
        return self.points.get(Point(kind="stages", name=",".join(names), settings=settings))

    def _cad(self, settings: Settings) -> tuple[Part, float]:
        found = self._ran(CAD_STAGES, settings)
        return _spent(found), float(found["facts"]["shell"]["volume_mm3"])

    def _errors(self, kind: Literal["force", "truth"], each: list[dict[str, Any]]) -> list[float]:
        found = self.points.get(Point(kind=kind, name=kind, settings={"each": each}))
        return [float(error) for error in found["errors"]]

    def _load(self, settings: Settings) -> tuple[Part, list[float]]:
        found = self._ran(("underload",), settings)
        return _spent(found), found["room"]

    def _scores(self) -> list[tuple[Part, float]]:
        group = self.groups[3]
        truths = self._errors("truth", [{"truth_refine": s["truth_refine"]} for s in group])
        return [
            (
                _spent(self._ran(("twin", "frames"), settings)),
                score_error(self.points.design, settings, truth),
            )
            for settings, truth in zip(group, truths, strict=True)
        ]


def score_error(design: Design, settings: Settings, truth: float) -> float:
    """Relative error of the scores of a report: too few contacts, and a coarse truth.

    The mean over n contacts of errors that scatter as much as they are large is sure to 1/√n.
    """
    samples = samples_of(design, float(settings["sample_share"]))["test"]
    few = 1.0 / np.sqrt(min(samples, int(settings["frames"])))
    return float(np.hypot(few, truth))


def accuracy_of(settings: Settings) -> Accuracy:
    """All settings of a joint one."""
    return replace(PRESETS["draft"], **settings)
