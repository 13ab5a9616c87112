"""Checks of errors by their stable code, not their wording."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from phytac_shapes.errors import PhytacError


@contextmanager
def refused(code: str) -> Iterator[pytest.ExceptionInfo[PhytacError]]:
    """Context in which an error of this code must be raised."""
    with pytest.raises(PhytacError) as caught:
        yield caught
    assert caught.value.code == code, f"{caught.value.code!r} instead of {code!r}: {caught.value}"
