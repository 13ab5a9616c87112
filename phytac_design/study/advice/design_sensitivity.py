"""Sensitivities: how figures change with each design variable, and what they predict."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.study.advice.design_evaluation import FORCES, EvaluatedDesign, strain_of
from phytac_design.study.advice.design_variables import ROW, DesignVariable
from phytac_design.study.advice.local_model import LocalModel
from phytac_shapes.errors import PhytacError

GAPS = ("gap_px", "load_gap_px")
SENSITIVE = (*FORCES, *GAPS, "strain")
"""Figures with sensitivities: gaps absolute, the others relative."""


@dataclass(frozen=True)
class Sensitivity:
    """Effect of one variable.

    Attributes
    ----------
    rate : dict
        By figure: d ln(figure) per unit of the variable for forces and strain, d(figure) for gaps.
    stuck : str
        Why it cannot change either way; "" if it can.
    """

    variable: DesignVariable
    rate: dict[str, float]
    stuck: str = ""

    def per_step(self, name: str) -> float:
        """Change by one step: a share for forces and strain, px for gaps."""
        return self.rate[name] * self.variable.step

    def predict(self, figures: Mapping[str, float], amount: float) -> dict[str, float]:
        """Figures after a change; forces and strain follow a power law of the variable's value."""
        value, out = self.variable.value, {}
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
    model: LocalModel,
    base: EvaluatedDesign,
    variables: Sequence[DesignVariable],
    progress: Callable[[str], None] = lambda _: None,
) -> list[Sensitivity]:
    """Sensitivity to every variable by central differences; one-sided where a rule forbids one."""

    def sizes(design: Design, variable: DesignVariable | None = None) -> dict[str, float]:
        strain = base.figures["strain"]
        if variable and variable.name.partition(".")[0] in ("wall", "material", "shape"):
            surface = design.surface()
            strain = strain_of(Sensor.of(design, surface, make_markers(design, surface)))
        held = variable is not None and variable.kind == ROW
        found = model.figures(design, held=held) | {"strain": strain}
        logs = {name: float(np.log(found[name])) for name in SENSITIVE if name not in GAPS}
        return logs | {gap: found[gap] if np.isfinite(found[gap]) else 0.0 for gap in GAPS}

    here = sizes(base.design)
    out = []
    for number, variable in enumerate(variables, start=1):
        progress(f"sensitivities: {number} of {len(variables)}, {variable.name}")
        sides, why = [(0.0, here)], ""
        for amount in (variable.step, -variable.step):
            try:
                sides.append((amount, sizes(variable.moved(base.design, amount), variable)))
            except PhytacError as error:
                why = str(error)
        if len(sides) == 1:
            out.append(Sensitivity(variable, {}, why))
            continue
        (low, before), (high, after) = sides[-2:]
        rate = {name: (after[name] - before[name]) / (high - low) for name in SENSITIVE}
        out.append(Sensitivity(variable, rate))
    return out
