"""The file that is printed is the file that is checked: binary STL, read again."""

from pathlib import Path

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.errors import OutputError

RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEAD = 84


def read_stl(path: Path) -> TriangleMesh:
    """Triangles of a binary STL file, equal corners made one.

    Raises
    ------
    OutputError
        If the file is no binary STL.
    """
    data = path.read_bytes()
    count = int(np.frombuffer(data[80:HEAD], "<u4")[0]) if len(data) >= HEAD else -1
    if len(data) != HEAD + count * RECORD.itemsize:
        raise OutputError(f"{path.name} is no binary STL file ({len(data)} bytes); build it again")
    corners = np.frombuffer(data, RECORD, offset=HEAD)["corners"].reshape(-1, 3)
    # Single precision repeats the same corner bit by bit; -0 and 0 are one.
    vertices, ids = np.unique(corners + np.float32(0.0), axis=0, return_inverse=True)
    triangles = ids.reshape(-1, 3)
    a, b, c = triangles.T
    return TriangleMesh(
        vertices_mm=vertices.astype(np.float64),
        triangles=triangles[(a != b) & (b != c) & (c != a)].astype(np.int64),
    )
