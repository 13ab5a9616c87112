"""Result of a calibration: values, intervals, and what the data determine."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from phytac_design.mechanics.calibration.calibration_noise import MeasurementNoise

Name = Literal["modulus", "thickness", "poisson"]
NAMES: tuple[Name, ...] = ("modulus", "thickness", "poisson")
CONFIDENCE = 0.95
"""Confidence of the intervals."""


@dataclass(frozen=True, kw_only=True)
class ShellParameters:
    """Young's modulus (MPa), wall thickness (mm), Poisson's ratio."""

    modulus: float
    thickness: float
    poisson: float


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Fitted parameters and how well the data determine them.

    Attributes
    ----------
    value, low, high : ShellParameters
        Best values and the ends of their 95 % intervals; both ends equal the value where held.
    fitted : tuple of str
        Names of the parameters that were fitted.
    noise : MeasurementNoise
        Estimated from the residuals.
    rows, presses : int
        Displacements, and presses that they belong to.
    condition : float
        Interval of the worst determined combination of the fitted parameters (in logarithms; ν
        as it is) over that of the best; 1 where only one was fitted.
    exponent, combination : float
        E·t^exponent is what the data determine best, to ± ``combination`` (95 %, relative).
    poisson_pull : dict
        Relative change of modulus and thickness if ν is really larger by 0.01 than the held
        value; empty where ν was fitted.
    mesh_pull : dict
        Change (relative; of ν absolute) that the extrapolation over two meshes made.
    """

    value: ShellParameters
    low: ShellParameters
    high: ShellParameters
    fitted: tuple[Name, ...]
    noise: MeasurementNoise
    rows: int
    presses: int
    condition: float
    exponent: float
    combination: float
    poisson_pull: dict[str, float]
    mesh_pull: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    def half_width(self) -> float:
        """Half of the wider interval of modulus and thickness, in logarithms: what is limited."""
        return 0.5 * max(
            math.log(getattr(self.high, name) / getattr(self.low, name))
            for name in self.fitted
            if name != "poisson"
        )

    def text(self) -> str:
        """For a person to read."""
        lines = [f"{self.rows} displacements of {self.presses} presses"]
        for name, label, unit in (
            ("modulus", "Young's modulus", "MPa"),
            ("thickness", "wall thickness", "mm"),
            ("poisson", "Poisson's ratio", ""),
        ):
            low, value, high = (getattr(p, name) for p in (self.low, self.value, self.high))
            known = f"{CONFIDENCE:.0%} {low:.4g} … {high:.4g}" if name in self.fitted else "held"
            lines.append(f"  {label:15s} {value:9.5g} {unit:4s} {known}")
        if len(self.fitted) > 1:
            lines.append(
                f"  E·t^{self.exponent:.2f} is known to ± {self.combination:.2%}; "
                f"condition {self.condition:.3g}"
            )
        pulls = ", ".join(f"{name} {x:+.2%}" for name, x in self.poisson_pull.items())
        if pulls:
            lines.append(f"  if ν is really 0.01 larger: {pulls}")
        noise = self.noise
        lines.append(
            f"  noise: {noise.relative:.2%} of a displacement, {1e3 * noise.floor_mm:.2g} µm, "
            f"{noise.force_relative:.2%} of a force"
        )
        return "\n".join(lines)
