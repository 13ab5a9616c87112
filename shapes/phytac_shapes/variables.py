"""Declared design variables of a shape: unit, range and effect."""

from dataclasses import MISSING, field, fields
from typing import Any

import numpy as np

from phytac_shapes.errors import DesignError


def variable(doc: str, *, minimum: float, maximum: float, default: Any = MISSING) -> Any:
    """Declare a field of a surface dataclass as a design variable.

    Parameters
    ----------
    doc : str
        What the variable does, for the schema and the commented design file.
    minimum, maximum : float
        Range accepted in a design file, in the unit of the field's name; of each number where
        the variable is a list of them.
    default : float or tuple of float, optional
        Value if the design file has none; without a default the variable is required.
    """
    return field(default=default, metadata={"doc": doc, "minimum": minimum, "maximum": maximum})


def choice(doc: str, *, default: Any) -> Any:
    """Declare a field whose type is a ``Literal`` (or a tuple of them) as a design variable."""
    return field(default=default, metadata={"doc": doc})


def check_variables(shape: Any) -> None:
    """Check that the numbers of a surface dataclass are finite and within their declared ranges.

    Raises
    ------
    DesignError
        For the first such number, with the range.
    """
    for item in fields(shape):
        if "minimum" not in item.metadata:
            continue
        low, high = item.metadata["minimum"], item.metadata["maximum"]
        values = np.asarray(getattr(shape, item.name), dtype=np.float64)
        bad = ~(np.isfinite(values) & (values >= low) & (values <= high))
        if np.any(bad):
            got = float(values[bad].ravel()[0])
            raise DesignError(
                "shape-variable-range",
                f"{shape.name}: {item.name} must lie between {low:g} and {high:g} (got {got:g}); "
                "correct it in the [shape] table",
            )
