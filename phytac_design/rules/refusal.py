"""Errors of rules: what fails, by how much, and the fix."""

from typing import NoReturn

from phytac_design.design.spec import Design
from phytac_shapes.errors import DesignError

SLACK_mm = 1e-9
"""Lengths that meet a rule exactly pass in spite of rounding."""


def refuse(code: str, text: str) -> NoReturn:
    """Raise the error of a broken rule."""
    raise DesignError(code, text)


def fewer(design: Design, what: str = "rows or layout.columns") -> str:
    """Fix that spaces markers out; ``what`` to lower where the layout has rows."""
    if design.layout.kind == "explicit":
        return "move layout.positions apart or lower"
    return (
        "lower layout.count or"
        if design.layout.kind == "phyllotaxis"
        else f"lower layout.{what} or"
    )
