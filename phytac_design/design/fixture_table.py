"""Fixtures of a design file: bodies beside the receptors that the camera sees and that can hide."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from phytac_design.design.base_table import Section, with_file
from phytac_shapes.arrays import FloatArray
from phytac_shapes.bounded_reader import read_bytes
from phytac_shapes.errors import DesignError

TRIANGLES_MAX = 5000
"""A fixture becomes part of the design file; more would make that unwieldy."""
Length = Annotated[float, Field(ge=-1e4, le=1e4)]
Point = tuple[Length, Length, Length]


class Fixture(Section):
    """What all fixtures have."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}$")
    """What messages call it: letters, digits, spaces, '_', '-', '.'."""


class CylinderFixture(Fixture):
    """A rod between two points, with flat ends."""

    kind: Literal["cylinder"] = "cylinder"
    """A rod."""
    radius_mm: float = Field(gt=0.0, le=1e4)
    """Radius."""
    from_mm: Point
    """Middle of one end, (x, y, z) in the sensor frame."""
    to_mm: Point
    """Middle of the other end."""

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.from_mm == self.to_mm:
            raise ValueError(
                f"from_mm and to_mm of the fixture {self.name!r} are the same point; move one"
            )
        return self


class BoxFixture(Fixture):
    """A box with its sides along x, y and z, or turned about z."""

    kind: Literal["box"] = "box"
    """A box."""
    centre_mm: Point
    """Its middle, (x, y, z) in the sensor frame."""
    size_mm: tuple[
        Annotated[float, Field(gt=0.0, le=1e4)],
        Annotated[float, Field(gt=0.0, le=1e4)],
        Annotated[float, Field(gt=0.0, le=1e4)],
    ]
    """Lengths of its sides along x, y and z, before it is turned."""
    turn_deg: float = Field(0.0, ge=-360.0, le=360.0)
    """Turn about z, from x towards y."""


class MeshFixture(Fixture):
    """A body from an STL file, in the sensor frame and millimetres."""

    kind: Literal["mesh"] = "mesh"
    """A body of triangles."""
    file: str = ""
    """STL file beside the design file; it is read into vertices_mm and triangles."""
    vertices_mm: tuple[Point, ...] = Field((), max_length=3 * TRIANGLES_MAX)
    """Corners, (x, y, z) in the sensor frame."""
    triangles: tuple[tuple[int, int, int], ...] = Field((), max_length=TRIANGLES_MAX)
    """Three corners each, numbered from 0; both sides are visible."""

    @model_validator(mode="before")
    @classmethod
    def _read_file(cls, data: Any, info: ValidationInfo) -> Any:
        return with_file(data, info, "file", "triangles", read_stl)

    @model_validator(mode="after")
    def _has_corners(self) -> Self:
        if not self.triangles:
            raise ValueError(f"the fixture {self.name!r} needs a file (STL) or triangles")
        numbers = [corner for triangle in self.triangles for corner in triangle]
        if min(numbers) < 0 or max(numbers) >= len(self.vertices_mm):
            raise ValueError(
                f"triangles of the fixture {self.name!r} name corners {min(numbers)} to "
                f"{max(numbers)}; it has 0 to {len(self.vertices_mm) - 1}"
            )
        return self


AnyFixture = Annotated[CylinderFixture | BoxFixture | MeshFixture, Field(discriminator="kind")]


def read_stl(path: Path) -> dict[str, Any]:
    """Read ``vertices_mm`` and ``triangles`` of a fixture; equal corners become one.

    Raises
    ------
    DesignError
        If the file cannot be read, is not STL, holds no triangle or too many.
    """
    try:
        # Enough for fifty times as many triangles, written as text.
        data = read_bytes(path, bytes_max=1 << 24)
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
    head = 84
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    count = int.from_bytes(data[head - 4 : head], "little")
    if len(data) >= head and len(data) == head + count * record.itemsize:
        records = np.frombuffer(data, dtype=record, offset=head)
        return np.asarray(records["corners"], dtype=np.float64)
    try:
        words = data.decode("ascii").split()
        places = [i for i, word in enumerate(words) if word == "vertex"]
        numbers = [[float(word) for word in words[i + 1 : i + 4]] for i in places]
        return np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)
    except (UnicodeDecodeError, ValueError):
        return None
