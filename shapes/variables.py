"""Declared design variables: what a shape asks of a design file, with unit, range and effect."""

from dataclasses import field
from typing import Any


def variable(doc: str, *, minimum: float, maximum: float) -> Any:
    """Declare a required field of a surface dataclass as a design variable.

    Parameters
    ----------
    doc : str
        What the variable does, for the schema and the commented design file.
    minimum, maximum : float
        Range accepted in a design file, in the unit of the field's name.
    """
    return field(metadata={"doc": doc, "minimum": minimum, "maximum": maximum})
