"""Figures as plain JSON."""

import math
from typing import Any


def finite(value: Any) -> Any:
    """Plain JSON: figures that do not exist (NaN, infinite) become null."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
