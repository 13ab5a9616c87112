"""A new patch design from a face of the user's own CAD."""

from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.solids.step_surface import surface_from_step
from phytac_shapes import Patch
from phytac_shapes.bounded_reader import check_file
from phytac_shapes.errors import InputError


def patch_changes(
    path: Path,
    *,
    face: int | None = None,
    rows: int = 9,
    columns: int = 9,
    pitch_mm: float = 6.0,
    size_max_mm: float = 1000.0,
) -> tuple[dict[str, dict[str, Any]], str]:
    """Tables of a design that a face of a STEP file changes, and what was done, as a sentence.

    The face is moved so that the camera's axis runs through the middle of its bounding box and
    its lowest point is at z = 0; it must face +z, away from the camera, as a whole.

    Parameters
    ----------
    path : Path
        STEP file, mm, +z away from the camera.
    face : int, optional
        Number of the face, the largest if left out.
    rows, columns : int
        Points that are taken from it along u and v.
    pitch_mm : float
        Distance between receptors that the new design starts with.
    size_max_mm : float
        Largest side of the face.

    Raises
    ------
    InputError
        If the file is not usable, or the face is too large.
    """
    # OpenCASCADE prints complaints of its own about other files.
    try:
        # Larger parts take minutes to read: one face is all that is wanted of them.
        check_file(path, bytes_max=1 << 28)
    except OSError as error:
        raise InputError("file-unreadable", f"no STEP file at {path} ({error.strerror})") from None
    with path.open("rb") as file:
        if b"ISO-10303-21" not in file.read(1024):
            raise InputError(
                "file-not-step",
                f"{path} is not a STEP file (it does not begin with ISO-10303-21); export "
                "the part as STEP",
            )
    fine = surface_from_step(path, rows=2 * rows - 1, columns=2 * columns - 1, face=face)
    points = fine[::2, ::2]
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    size = high - low
    if float(size.max()) > size_max_mm:
        raise InputError(
            "step-face-too-large",
            f"the face of {path} spans {size.max():.4g} mm, more than {size_max_mm:g}; export it "
            "in millimetres, or cut it",
        )
    shift = -np.array([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, low[2]])
    placed = np.round(points + shift, 6) + 0.0
    surface = Patch(points_mm=tuple(tuple(tuple(p) for p in row) for row in placed.tolist()))
    steps = np.meshgrid(*(np.arange(0.0, n - 0.75, 0.5) for n in (rows, columns)), indexing="ij")
    half = surface.point(np.stack(steps, axis=-1).reshape(-1, 2)).reshape(fine.shape)
    gap = float(np.linalg.norm(half - fine - shift, axis=-1).max())
    around, along = (float(x) for x in surface.unwrap(surface.domain[:, 1][None])[0])
    count = {
        "rows": max(int(along / pitch_mm), 1),
        "columns": 2 * max(int(around / pitch_mm / 2.0), 1),
    }
    said = (
        f"a face of {around:.4g} x {along:.4g} mm through {rows} x {columns} points (between them "
        f"up to {gap:.2g} mm off; --rows and --columns take more), moved by "
        f"({shift[0]:.4g}, {shift[1]:.4g}, {shift[2]:.4g}) mm onto the camera's axis, "
        f"{count['rows']} x {count['columns']} markers"
    )
    changes = {"shape": {"kind": "patch", "points_mm": placed.tolist()}, "layout": count}
    return changes, said
