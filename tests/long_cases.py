"""Cases of a test of which only some run in each ``make test``."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest

TUBES = ("cylinder40", "cone", "grip")
"""Shipped designs whose shells are tubes like that of cylinder60."""


def with_long(values: Iterable[str], long: Collection[str]) -> list[Any]:
    """Values for ``parametrize``; those in ``long`` are left to ``make test-all``."""
    return [pytest.param(each, marks=[pytest.mark.long] * (each in long)) for each in values]
