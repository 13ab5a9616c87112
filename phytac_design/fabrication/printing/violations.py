"""A violation of a print rule: which, where, how much, and what to do."""

from dataclasses import asdict, dataclass
from typing import Any

from phytac_shapes.arrays import FloatArray

RULES = ("wall", "free wall", "post", "hole", "gap", "overhang", "sealed", "drain", "cup", "bed")
"""All rules, in the order of reports."""


@dataclass(frozen=True, kw_only=True)
class Violation:
    """One place where a body breaks a rule.

    Attributes
    ----------
    rule : str
        One of ``RULES``.
    point_mm : (3,) tuple of float
        Middle of the place, in the body's frame.
    measured, asked : float
        Measured value, and the minimum (overhang, bed: maximum) of the rule.
    unit : str
        Of both.
    fix : str
        What to change.
    marker : int or None
        The receptor it belongs to.
    """

    rule: str
    point_mm: tuple[float, float, float]
    measured: float
    asked: float
    unit: str
    fix: str
    marker: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the report."""
        data = asdict(self)
        data["point_mm"] = [round(x, 3) for x in self.point_mm]
        data["measured"], data["asked"] = round(self.measured, 4), round(self.asked, 4)
        return data

    def text(self) -> str:
        """One line of text."""
        owner = "" if self.marker is None else f" (marker {self.marker})"
        x, y, z = self.point_mm
        return (
            f"{self.rule} {self.measured:.3g} {self.unit} (required {self.asked:.3g} {self.unit}) "
            f"at ({x:.1f}, {y:.1f}, {z:.1f}) mm{owner}: {self.fix}"
        )


def violation(
    rule: str,
    point_mm: FloatArray,
    measured: float,
    required: float,
    fix: str,
    *,
    unit: str = "mm",
    marker: int | None = None,
) -> Violation:
    """Violation at a point (3,)."""
    x, y, z = map(float, point_mm)
    return Violation(
        rule=rule,
        point_mm=(x, y, z),
        measured=float(measured),
        asked=float(required),
        unit=unit,
        fix=fix,
        marker=marker,
    )


def in_order(violations: list[Violation]) -> list[Violation]:
    """Sort by rule, then marker, then place: the same body gives the same list."""
    return sorted(
        violations,
        key=lambda v: (RULES.index(v.rule), -1 if v.marker is None else v.marker, v.point_mm),
    )
