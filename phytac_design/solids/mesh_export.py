"""Binary STL and 3MF; the same mesh always gives the same bytes."""

import io
import uuid
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh, distinct_points, proper_triangles
from phytac_shapes.errors import NumericalError, OutputError

STL_HEADER = b"PhyTac Design, binary STL, units mm".ljust(80)
STL_RECORD = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
DISPLAY_COLOURS = {
    "resin": (214, 208, 196, 255),
    "blue": (28, 82, 220, 255),
    "green": (24, 168, 72, 255),
    "red": (214, 40, 40, 255),
}
"""RGBA of the bodies in a 3MF file, for display in slicers."""
NAMESPACE = uuid.UUID("6f0c2f5e-6f7c-5d0e-9a37-0d1f5a1c7b60")
"""Root of all ids in 3MF files: ids follow from names, so files do not change from run to run."""


def check_solid(mesh: TriangleMesh, name: str) -> None:
    """Refuse a mesh that is no solid, before a printer or a bill gets it.

    Parameters
    ----------
    name : str
        Of the part or its file, for the message.

    Raises
    ------
    NumericalError
        If it is empty, not closed, or encloses no volume.
    """
    corners, count = mesh.triangles, len(mesh.vertices_mm)
    first, second = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    forth, back = np.sort(first * count + second), np.sort(second * count + first)
    volume = mesh.volume_mm3
    if not (0.0 < volume < np.inf and np.array_equal(forth, back)):
        raise NumericalError(
            "body-without-volume",
            f"{name} is no closed solid (got {len(corners)} triangles around {volume:.4g} mm³); "
            "please report this design",
        )


def stl_bytes(mesh: TriangleMesh) -> bytes:
    """Binary STL (single precision, mm) of a mesh; the header holds no date."""
    record = np.zeros(len(mesh.triangles), dtype=STL_RECORD)
    # Normals of the corners as they are stored, sides rounded as readers round them: rounding
    # turns the normal of a sliver.
    corners = mesh.vertices_mm.astype(np.float32)[mesh.triangles]
    first, second = (corners[:, k] - corners[:, 0] for k in (1, 2))
    normal = np.cross(first.astype(np.float64), second.astype(np.float64))
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    record["normal"] = normal / np.where(length > 0.0, length, 1.0)
    record["corners"] = corners
    count = np.array(len(record), dtype="<u4").tobytes()
    return STL_HEADER + count + record.tobytes()


def read_stl(path: Path) -> TriangleMesh:
    """Triangles of a binary STL file, equal corners made one.

    Raises
    ------
    OutputError
        If the file is no binary STL.
    """
    data = path.read_bytes()
    count = int(np.frombuffer(data[80:84], "<u4")[0]) if len(data) >= 84 else -1
    if len(data) != 84 + count * STL_RECORD.itemsize:
        raise OutputError(
            "stl-file-invalid",
            f"{path.name} is no binary STL file ({len(data)} bytes); build it again",
        )
    corners = np.frombuffer(data, STL_RECORD, offset=84)["corners"].reshape(-1, 3)
    # Single precision repeats the same corner bit by bit; -0 and 0 are one.
    vertices, ids = distinct_points(corners + np.float32(0.0))
    triangles = proper_triangles(ids.reshape(-1, 3))
    return TriangleMesh(vertices_mm=vertices.astype(np.float64), triangles=triangles)


def write_stl(mesh: TriangleMesh, path: Path) -> None:
    """Write a binary STL file of a solid (:func:`check_solid`)."""
    check_solid(mesh, path.name)
    path.write_bytes(stl_bytes(mesh))


def threemf_bytes(bodies: Mapping[str, TriangleMesh], *, name: str) -> bytes:
    """3MF of named bodies in one frame, mm: one part of several components, one build item.

    Bodies share one frame: a slicer must keep them together (one object of several parts).
    PrusaSlicer 2.5 opens the components as separate objects at their right places; there, load
    them as a single object with multiple parts.

    Parameters
    ----------
    bodies : mapping of str to TriangleMesh
        Bodies that tile the part, by name; names in ``DISPLAY_COLOURS`` get that colour.
    name : str
        Name of the part.
    """
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    model.SetBuildUUID(_uuid(name, "build"))
    materials = model.AddBaseMaterialGroup()
    part = model.AddComponentsObject()
    part.SetName(name)
    part.SetUUID(_uuid(name, "part"))
    for label, mesh in bodies.items():
        rgba = DISPLAY_COLOURS.get(label, DISPLAY_COLOURS["resin"])
        material = materials.AddMaterial(label, wrapper.RGBAToColor(*rgba))
        body = model.AddMeshObject()
        body.SetName(label)
        body.SetUUID(_uuid(name, label))
        body.SetGeometry(*_geometry(lib3mf, mesh))
        body.SetObjectLevelProperty(materials.GetResourceID(), material)
        part.AddComponent(body, wrapper.GetIdentityTransform()).SetUUID(
            _uuid(name, f"{label}/component")
        )
    item = model.AddBuildItem(part, wrapper.GetIdentityTransform())
    item.SetUUID(_uuid(name, "item"))
    return _undated(bytes(model.QueryWriter("3mf").WriteToBuffer()))


def write_3mf(bodies: Mapping[str, TriangleMesh], path: Path, *, name: str) -> None:
    """Write a 3MF file of named bodies."""
    path.write_bytes(threemf_bytes(bodies, name=name))


def _uuid(*path: str) -> str:
    return str(uuid.uuid5(NAMESPACE, "/".join(path)))


def _geometry(lib3mf: Any, mesh: TriangleMesh) -> tuple[Any, Any]:
    """Vertex and triangle arrays as the C structures of lib3mf, filled without a Python loop."""
    vertices = np.ascontiguousarray(mesh.vertices_mm, dtype=np.float32)
    triangles = np.ascontiguousarray(mesh.triangles, dtype=np.uint32)
    return (
        (lib3mf.Position * len(vertices)).from_buffer_copy(vertices.tobytes()),
        (lib3mf.Triangle * len(triangles)).from_buffer_copy(triangles.tobytes()),
    )


def _undated(archive: bytes) -> bytes:
    """Return a zip archive with the same members in the same order, and no dates."""
    epoch = (1980, 1, 1, 0, 0, 0)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as source, zipfile.ZipFile(out, "w") as target:
        for info in source.infolist():
            member = zipfile.ZipInfo(info.filename, date_time=epoch)
            member.compress_type = zipfile.ZIP_DEFLATED
            target.writestr(member, source.read(info.filename), compresslevel=6)
    return out.getvalue()
