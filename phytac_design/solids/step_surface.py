"""A user's own face from a STEP file, as the grid of points that a ``patch`` takes.

OpenCASCADE reads it in a process of its own: files that are damaged make it crash or hang.
"""

import multiprocessing
import os
import resource
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.solids.cad_kernel import cadquery
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError, PhytacError

AGAIN = "export the one face again, as a STEP file of its own"


def surface_from_step(
    path: Path,
    *,
    rows: int = 9,
    columns: int = 9,
    face: int | None = None,
    seconds_max: float = 120.0,
) -> FloatArray:
    """Grid of points (rows, columns, 3) mm on one face of a STEP file, outward towards +z.

    Rows run along the chart's u and columns along v, so that d/dv × d/du points away from the
    camera, as :class:`shapes.Patch` wants it. Points lie at equal steps of the face's own
    parameters.

    Parameters
    ----------
    path : Path
        STEP file, sensor frame, mm.
    rows, columns : int
        Points along each direction, at least two.
    face : int, optional
        Number of the face in the file; the one of largest area if left out.
    seconds_max : float
        Time that reading may take.

    Raises
    ------
    InputError
        If the file cannot be read, has no such face, or the face is trimmed, closed or folded.
    """
    if min(rows, columns) < 2:
        raise InputError(
            "step-points-too-few", f"a patch needs at least 2 x 2 points (got {rows} x {columns})"
        )
    # A fork has the libraries that are loaded here: others take seconds to start.
    fork = multiprocessing.get_context("fork")
    mine, its = fork.Pipe(duplex=False)
    child = fork.Process(target=_send_grid, args=(its, path, rows, columns, face), daemon=True)
    child.start()
    its.close()
    try:
        answer = mine.recv() if mine.poll(seconds_max) else None
    except EOFError:
        child.join()
        raise InputError(
            "step-unreadable",
            f"cannot read STEP file {path}: OpenCASCADE crashed on it (exit code "
            f"{child.exitcode}); {AGAIN}",
        ) from None
    finally:
        mine.close()
        child.kill()
        child.join()
    if answer is None:
        raise InputError(
            "step-unreadable",
            f"cannot read STEP file {path}: no end within {seconds_max:g} s; {AGAIN}",
        )
    if isinstance(answer, PhytacError):
        raise answer
    return np.asarray(answer, dtype=np.float64)


def _send_grid(pipe: Connection, path: Path, rows: int, columns: int, face: int | None) -> None:
    """Send the grid or the error; OpenCASCADE's own output is discarded."""
    statm = Path("/proc/self/statm")
    memory_max = 4 << 30  # bytes that reading a file may take
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    if statm.is_file():
        pages = int(statm.read_text().split()[0])
        limit = pages * resource.getpagesize() + memory_max
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
    answer: FloatArray | PhytacError
    try:
        answer = read_surface(path, rows, columns, face)
    except PhytacError as error:
        answer = error
    except Exception as error:  # noqa: BLE001 - the kernel's own errors have no common class
        answer = InputError(
            "step-unreadable",
            f"cannot read STEP file {path}: {str(error)[:200] or 'damaged'}; {AGAIN}",
        )
    pipe.send(answer)


def read_surface(path: Path, rows: int, columns: int, face: int | None) -> FloatArray:
    """Read the grid in this very process.

    Raises
    ------
    InputError
        See :func:`surface_from_step`; of files that are damaged OpenCASCADE raises anything else.
    """
    chosen = _face(path, face)
    surface, (u0, u1, v0, v1) = _untrimmed(chosen, path)
    points = np.array(
        [
            [_point(surface, u, v) for v in np.linspace(v0, v1, columns)]
            for u in np.linspace(u0, u1, rows)
        ]
    )
    if not np.isfinite(points).all():
        raise InputError(
            "step-face-not-finite", f"the face of {path} has points that are not finite; {AGAIN}"
        )
    size = float(np.ptp(points.reshape(-1, 3), axis=0).max())
    for axis in (0, 1):
        ends = np.take(points, [0, -1], axis=axis)
        across = np.linalg.norm(np.diff(points, axis=1 - axis), axis=2).sum(axis=1 - axis)
        gap = np.linalg.norm(np.diff(ends, axis=axis), axis=2).max()
        if gap <= 1e-6 * size or across.min() <= 1e-6 * size:
            raise InputError(
                "step-face-closed",
                f"the face of {path} closes on itself or ends in a point; a patch is open on four "
                "sides: cut the face, or use a shape of its kind (cylinder, cone, hemisphere, "
                "grip)",
            )
    return _outward(points, path)


def _face(path: Path, number: int | None) -> Any:
    cq = cadquery()
    try:
        faces = cq.importers.importStep(str(path)).faces().vals()
    except ValueError as error:
        raise InputError(
            "step-unreadable", f"cannot read STEP file {path}: {error}; export it again"
        ) from None
    if not faces:
        raise InputError(
            "step-without-face", f"{path} holds no face; export a surface or a solid, not curves"
        )
    if number is None:
        return max(faces, key=lambda item: item.Area())
    if not 0 <= number < len(faces):
        raise InputError(
            "step-face-number", f"{path} has faces 0 to {len(faces) - 1} (got {number})"
        )
    return faces[number]


def _untrimmed(face: Any, path: Path) -> tuple[Any, tuple[float, float, float, float]]:
    """Geometry of a face and the rectangle of its parameters, which it fills."""
    # Relative area by which a face may miss its parameter rectangle and still count as untrimmed.
    covered = 1e-6
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.BRepTools import BRepTools

    cq = cadquery()
    bounds = BRepTools.UVBounds_s(face.wrapped)
    geometry = face._geomAdaptor()  # noqa: SLF001 - CadQuery's only way to the surface
    whole = cq.Face(BRepBuilderAPI_MakeFace(geometry, *bounds, 1e-6).Face()).Area()
    share = face.Area() / whole
    if abs(share - 1.0) > covered:
        raise InputError(
            "step-face-trimmed",
            f"the face of {path} is trimmed: it covers {share:.1%} of the rectangle of its "
            "parameters, and a patch is a whole one; rebuild it in CAD as an untrimmed face with "
            "four sides and no holes",
        )
    return geometry, bounds


def _point(surface: Any, u: float, v: float) -> tuple[float, float, float]:
    point = surface.Value(u, v)
    return point.X(), point.Y(), point.Z()


def _outward(points: FloatArray, path: Path) -> FloatArray:
    """Return the grid with its rows reversed if need be, so that it faces +z.

    Which side a face counts as its outer one differs between CAD programs.
    """
    facing_min = 0.1  # mean normal along z; below it no side is the outer one
    along = np.diff(points, axis=0)[:, :-1]
    around = np.diff(points, axis=1)[:-1]
    across = np.cross(around, along)
    x, y, z = across.sum(axis=(0, 1)) / np.linalg.norm(across, axis=2).sum()
    if not abs(z) > facing_min:
        raise InputError(
            "step-face-aside",
            f"the face of {path} faces aside (its mean normal is {x:.2f}, {y:.2f}, {z:.2f}): the "
            "camera looks along +z at the inner side of a face, so it must face +z; turn the "
            "part, or choose another face (--face)",
        )
    return points if z > 0.0 else points[::-1].copy()
