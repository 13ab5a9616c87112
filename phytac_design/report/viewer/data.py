"""Contents of the 3-D shell and the map, as plain JSON.

Numbers go as base64 of little-endian arrays. Places in space are quantised: three ``uint16`` a
point, ``place = low + step * number``, which keeps them within ``step / 2`` (0.001 mm on a sensor
of 120 mm). Keys:

``version``
    1.
``box``
    ``low`` [x, y, z] and ``step`` [x, y, z], mm.
``eye``
    Unit vector from the middle to where the view starts from; the z axis is up.
``bodies``
    List of ``name``, ``colour`` (``#rrggbb``), ``points`` (V, 3), and ``triangles`` (T, 3)
    ``uint32``: first the ``wall`` with its rims, its triangles anticlockwise from outside; then
    the light bar and fixtures.
``wall``
    How the wall is shown at first: ``cut`` (only where it shows its inner side to the viewer, and
    the receptors there) or ``clear`` (seen through).
``lines``
    Ends of line pieces (m, 2, 3): the cameras' fields of view.
``tubes``
    ``foot`` and ``tip`` (n, 3), ``band_mm``, ``radius_mm``, ``tube_mm`` below the band,
    ``hole_mm`` (radii).
``markers``
    ``names`` (n), ``paint`` (n) ``uint8``, an index into ``paints`` (``name``, ``colour``).
``map``
    ``points`` (n, 2) ``float32`` and ``outline``, a list of (m, 2), in mm or px; ``x_label``,
    ``y_label``, ``y_down``, ``note``, and ``limits`` [[x0, y0], [x1, y1]].
``colourings``
    List of ``key``, ``label``, ``unit``, ``kind`` (``id``, ``paint`` or ``value``), ``values`` (n)
    ``float32``, ``low``, ``high`` (ends of the scale), ``log`` (whether it is logarithmic),
    ``note``. NaN: no value.
"""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_mesh, shell_mesh
from phytac_design.geometry.flat_map import flat_map, surface_topology
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics import paint
from phytac_design.optics.render_scene import fixture_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

if TYPE_CHECKING:
    from phytac_decoder.camera.camera import Camera

LOG_RANGE = 20.0
"""Values that differ by more than this factor are coloured on a logarithmic scale."""


@dataclass(frozen=True)
class Colouring:
    """A number of every marker that colours it.

    Attributes
    ----------
    key : str
        Name in scripts.
    label, unit, note : str
        For the reader.
    values : (n,) float
        NaN where there is none.
    kind : str
        ``value``: on a scale; ``id`` and ``paint``: by the marker itself.
    """

    key: str
    label: str
    values: FloatArray
    unit: str = ""
    note: str = ""
    kind: Literal["id", "paint", "value"] = "value"

    def as_dict(self) -> dict[str, Any]:
        """Plain values; the scale runs over what there is."""
        known = self.values[np.isfinite(self.values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        return {
            "key": self.key,
            "label": self.label,
            "unit": self.unit,
            "note": self.note,
            "kind": self.kind,
            "low": low,
            "high": high,
            "log": low > 0.0 and high > LOG_RANGE * low,
            "values": packed(self.values, "<f4"),
        }


@dataclass(frozen=True)
class Box:
    """Corners (3,) of all that is shown, and the steps (3,) that places are counted in, mm."""

    low: FloatArray
    step: FloatArray

    @classmethod
    def around(cls, points: FloatArray) -> "Box":
        """Box of points (n, 3)."""
        low, high = points.min(axis=0), points.max(axis=0)
        return cls(low, np.maximum(high - low, 1e-6) / 65535)

    def pack(self, points: FloatArray) -> str:
        """Points (…, 3) as text."""
        return packed(np.rint((points - self.low) / self.step), "<u2")


def packed(values: NDArray[Any], kind: str) -> str:
    """Array as base64 of a little-endian type, row after row."""
    return b64encode(np.ascontiguousarray(values).astype(kind).tobytes()).decode()


def hexed(rgb: Sequence[int]) -> str:
    """Colour as ``#rrggbb``."""
    return "#" + "".join(f"{int(value):02x}" for value in rgb)


def base_colourings(markers: Markers) -> list[Colouring]:
    """Colourings that need no result: the marker itself, its paint, its height."""
    number = np.arange(markers.count, dtype=np.float64)
    return [
        Colouring("id", "marker", number, kind="id"),
        Colouring("paint", "paint", markers.colour.astype(np.float64), kind="paint"),
        Colouring("height_mm", "receptor height", markers.height_mm, "mm"),
    ]


def eye_of(surface: Surface, markers: Markers) -> FloatArray:
    """Unit vector (3,) towards the first viewpoint: beside tubes, on the marker side of others."""
    tube_view = np.array([0.62, -0.70, 0.35])
    if surface_topology(surface) == "tube":
        return np.asarray(tube_view / np.linalg.norm(tube_view))
    inward = -markers.normal.mean(axis=0)
    inward /= max(float(np.linalg.norm(inward)), 1e-9)
    aside = tube_view - (tube_view @ inward) * inward
    eye = inward + 0.6 * aside / np.linalg.norm(aside)
    return np.asarray(eye / np.linalg.norm(eye))


def viewer_data(
    sensor: Sensor, colourings: Sequence[Colouring], *, cameras: "Sequence[Camera]" = ()
) -> dict[str, Any]:
    """Everything that ``PhytacViewer`` and ``PhytacMap`` need, as plain JSON (see above).

    Parameters
    ----------
    colourings : list of Colouring
        In the order of the page's list; the first is shown first.
    cameras : list of Camera
        Whose fields of view are drawn.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    (low, high) = surface.bounds_mm()
    size = float(np.linalg.norm(high - low))
    meshes = _bodies(design, surface, 0.002 * size)
    lines = np.concatenate([np.zeros((0, 2, 3)), *(_field(camera, size) for camera in cameras)])
    everything = [mesh.vertices_mm for _, _, mesh in meshes if len(mesh.vertices_mm)]
    box = Box.around(
        np.concatenate([*everything, lines.reshape(-1, 3), markers.base_mm, markers.tip_mm])
    )
    flat = flat_map(surface, markers.uv)
    return {
        "version": 1,
        "box": {"low": box.low.tolist(), "step": box.step.tolist()},
        "eye": eye_of(surface, markers).round(4).tolist(),
        "wall": "clear" if surface_topology(surface) == "sheet" else "cut",
        "bodies": [
            {
                "name": name,
                "colour": hexed(colour),
                "points": box.pack(mesh.vertices_mm),
                "triangles": packed(mesh.triangles, "<u4"),
            }
            for name, colour, mesh in meshes
            if len(mesh.triangles)
        ],
        "lines": box.pack(lines),
        "tubes": {
            "foot": box.pack(markers.base_mm),
            "tip": box.pack(markers.tip_mm),
            "band_mm": design.receptor.band_marker_mm,
            "radius_mm": design.receptor.diameter_outer_mm / 2.0,
            "tube_mm": design.receptor.diameter_tube_mm / 2.0,
            "hole_mm": design.receptor.diameter_hole_mm / 2.0,
        },
        "markers": {
            "names": [markers.name(k).strip("()") for k in range(markers.count)],
            "paint": packed(markers.colour, "<u1"),
            "paints": [
                {"name": name, "colour": hexed(getattr(design.paints, name))}
                for name in design.layout.colours
            ],
        },
        "map": {
            "points": packed(flat.points, "<f4"),
            "outline": [packed(edge, "<f4") for edge in flat.outline],
            "limits": flat.limits.tolist(),
            "x_label": flat.x_label,
            "y_label": flat.y_label,
            "y_down": flat.y_down,
            "note": flat.note,
        },
        "colourings": [item.as_dict() for item in colourings],
    }


def _bodies(
    design: Design, surface: Surface, tolerance_mm: float
) -> list[tuple[str, Sequence[int], TriangleMesh]]:
    """Name, colour and mesh of all but the receptors."""
    return [
        (
            "wall",
            paint.resin_of(design.layout.colours, design.paints),
            _outward(surface, shell_mesh(design, surface, tolerance_mm=tolerance_mm)),
        ),
        ("light bar", paint.BAR, bar_mesh(design, surface, tolerance_mm=tolerance_mm)),
        *(
            (item.name, paint.FIXTURE, fixture_mesh(item, tolerance_mm=tolerance_mm))
            for item in design.fixtures
        ),
    ]


def _outward(surface: Surface, mesh: TriangleMesh) -> TriangleMesh:
    """Mesh with its triangles turned so that their normals point away from the sensor's inside."""
    corners = mesh.vertices_mm[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    out = surface.normal(surface.chart(corners.mean(axis=1)))
    wrong = np.einsum("ti,ti->t", normal, out) < 0.0
    triangles = np.where(wrong[:, None], mesh.triangles[:, ::-1], mesh.triangles)
    return TriangleMesh(vertices_mm=mesh.vertices_mm, triangles=triangles)


def _field(camera: "Camera", size_mm: float) -> FloatArray:
    """Edges (m, 2, 3) of a camera's field of view, 0.12 of the sensor's size long."""
    width, height = camera.width_px, camera.height_px
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]) - 0.5
    rays = camera.lens.unproject(corners) @ camera.rotation
    rays = rays[np.isfinite(rays).all(axis=1)]
    if not len(rays):
        return np.zeros((0, 2, 3))
    ends = camera.position_mm + 0.12 * size_mm * rays
    around = np.stack([ends, np.roll(ends, -1, axis=0)], axis=1)
    out = np.stack([np.broadcast_to(camera.position_mm, ends.shape), ends], axis=1)
    return np.concatenate([out, around])
