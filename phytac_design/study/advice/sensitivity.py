"""How figures change with each knob: slopes, and what they foretell of a move."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.study.advice.design_evaluation import FORCES, EvaluatedDesign, strain_of
from phytac_design.study.advice.design_variables import DesignVariable
from phytac_design.study.advice.local_model import LocalModel
from phytac_shapes.errors import PhytacError

SENSITIVE = (*FORCES, "gap_px", "load_gap_px", "strain")
"""Figures with slopes: gaps absolute, the others relative."""
GAPS = ("gap_px", "load_gap_px")
BENT = ("wall", "material", "shape")
"""Tables that the strain depends on."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """What one knob does.

    Attributes
    ----------
    rate : dict
        By figure: d ln(figure) per unit of the knob for forces and strain, d(figure) for gaps.
    stuck : str
        Why it cannot be moved either way; "" if it can.
    """

    knob: DesignVariable
    rate: dict[str, float]
    stuck: str = ""

    def per_step(self, name: str) -> float:
        """Change by one step: a share for forces and strain, px for gaps."""
        return self.rate[name] * self.knob.step

    def predict(self, figures: Mapping[str, float], amount: float) -> dict[str, float]:
        """Figures (those with slopes) after a move; forces follow a power of the knob's value."""
        value, out = self.knob.value, {}
        for name in SENSITIVE:
            if name in GAPS:
                out[name] = figures[name] + self.rate[name] * amount
            elif value > 0.0 and value + amount > 0.0:
                ratio = (value + amount) / value
                out[name] = figures[name] * float(ratio ** (self.rate[name] * value))
            else:
                out[name] = figures[name] * float(np.exp(self.rate[name] * amount))
        return out


def sensitivities(
    probe: LocalModel,
    base: EvaluatedDesign,
    knobs: Sequence[DesignVariable],
    progress: Callable[[str], None] = lambda _: None,
) -> list[Sensitivity]:
    """Slope of every knob, by a step to either side; by one side where the other cannot be."""
    here = _figures(probe, base, base.design, "")
    out = []
    for number, knob in enumerate(knobs, start=1):
        progress(f"slopes: {number} of {len(knobs)}, {knob.name}")
        sides, why = [(0.0, here)], ""
        for sign in (1.0, -1.0):
            amount = sign * knob.step
            try:
                moved = knob.moved(base.design, amount)
                sides.append((amount, _figures(probe, base, moved, knob.name)))
            except PhytacError as error:
                why = str(error)
        # Both steps where there are both: the middle is for what has one only.
        (low, before), (high, after) = sides[-2:] if len(sides) > 1 else (sides[0], sides[0])
        if high == low:
            out.append(Sensitivity(knob=knob, rate={}, stuck=why))
            continue
        rate = {
            name: (_size(name, after[name]) - _size(name, before[name])) / (high - low)
            for name in SENSITIVE
        }
        out.append(Sensitivity(knob=knob, rate=rate))
    return out


def _size(name: str, value: float) -> float:
    """What slopes are taken of: logarithms of forces, gaps as they are (none is none)."""
    if name not in GAPS:
        return float(np.log(value))
    return value if np.isfinite(value) else 0.0


def _figures(
    probe: LocalModel, base: EvaluatedDesign, design: Design, knob: str
) -> dict[str, float]:
    """Figures with slopes of a design that a knob made; a row moves on the shell as it is."""
    strain = base.figures["strain"]
    if knob.partition(".")[0] in BENT:
        surface = design.surface()
        strain = strain_of(design, surface, make_markers(design, surface))
    return probe.figures(design, held=knob.startswith("rows.")) | {"strain": strain}
