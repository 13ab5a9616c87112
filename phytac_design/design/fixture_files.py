"""Triangles of a fixture from an STL file, binary or text."""

from pathlib import Path
from typing import Any

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.bounded_reader import read_bytes
from phytac_shapes.errors import DesignError

TRIANGLES_MAX = 5000
"""A fixture becomes part of the design file; more would make that unwieldy."""
HEADER_BYTES = 84
BYTES_MAX = 1 << 24
"""Enough for fifty times as many triangles, written as text."""
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def read_stl(path: Path) -> dict[str, Any]:
    """Read ``vertices_mm`` and ``triangles`` of a fixture; equal corners become one.

    Raises
    ------
    DesignError
        If the file cannot be read, is not STL, holds no triangle or too many.
    """
    try:
        data = read_bytes(path, bytes_max=BYTES_MAX)
    except OSError as error:
        raise DesignError(
            "fixture-file-unreadable",
            f"cannot read the fixture {path}: {error.strerror}; file is relative to the "
            "design file",
        ) from None
    corners = _corners(data)
    if corners is None or len(corners) == 0 or not np.isfinite(corners).all():
        raise DesignError(
            "fixture-file-invalid",
            f"{path} is not an STL file with triangles; export the fixture as STL (binary or text)",
        )
    if len(corners) > TRIANGLES_MAX:
        raise DesignError(
            "fixture-too-many-triangles",
            f"{path} has {len(corners)} triangles, more than {TRIANGLES_MAX}; export the fixture "
            "coarser, its outline is all that matters",
        )
    points, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    # Printed with six digits the float32 numbers of the file look as its author wrote them.
    return {
        "vertices_mm": [[float(f"{x:.6g}") for x in point] for point in points],
        "triangles": index.reshape(-1, 3).tolist(),
    }


def _corners(data: bytes) -> FloatArray | None:
    """Corners (T, 3, 3) of an STL file's bytes; None if it is not one."""
    count = int.from_bytes(data[HEADER_BYTES - 4 : HEADER_BYTES], "little")
    if len(data) >= HEADER_BYTES and len(data) == HEADER_BYTES + count * RECORD.itemsize:
        records = np.frombuffer(data, dtype=RECORD, offset=HEADER_BYTES)
        return np.asarray(records["corners"], dtype=np.float64)
    try:
        words = data.decode("ascii").split()
        places = [i for i, word in enumerate(words) if word == "vertex"]
        numbers = [[float(word) for word in words[i + 1 : i + 4]] for i in places]
        return np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)
    except (UnicodeDecodeError, ValueError):
        return None
