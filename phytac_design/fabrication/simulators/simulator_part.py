"""What every simulator needs of a sensor: meshes, mass, collision pieces and frames, in SI units.

Everything is given in the frame ``base``: parallel to the sensor's frame, its origin on the
sensor's axis in the plane of the lowest rim, on which the sensor is mounted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.camera.lens import Lens
from phytac_design.fabrication.documents.bill_of_materials import density_g_cm3
from phytac_design.fabrication.hardware.sensor_solids import switch_mesh
from phytac_design.fabrication.simulators.convex_pieces import convex_pieces
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.geometry.boundary_loops import chart_loops
from phytac_design.geometry.envelope import divisions
from phytac_design.geometry.triangles import TriangleMesh, frames_along
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import DISPLAY_COLOURS
from phytac_design.solids.solid_mesh import painted_manifolds, to_triangles
from phytac_shapes.arrays import FloatArray

RUBBER_RGBA = (236, 222, 176, 255)
"""Colour of the switches, as in the exploded view."""


@dataclass(frozen=True, kw_only=True)
class MassProperties:
    """Mass, centre of mass (3,) and inertia (3, 3) about it, along the axes of ``base``."""

    mass_kg: float
    centre_m: FloatArray
    inertia_kg_m2: FloatArray


@dataclass(frozen=True, kw_only=True)
class CameraFrame:
    """A camera: its optical frame (z forward, x right, y down), lens and rate.

    ``rotation`` (3, 3) has the frame's axes as columns.
    """

    name: str
    position_m: FloatArray
    rotation: FloatArray
    lens: Lens
    rate_Hz: float


@dataclass(frozen=True, kw_only=True)
class SimulatorPart:
    """A sensor for simulators; lengths of meshes are mm, all other quantities SI.

    Attributes
    ----------
    name : str
        Name of the design.
    visuals : dict
        Triangles and RGBA (0 to 255) of each body that is shown, by the name of its file.
    pieces : list of TriangleMesh
        Convex collision pieces.
    mass : MassProperties
        Of shell and switches.
    cameras : list of CameraFrame
        The near one first.
    receptors_m : (n, 3) float
        Each marker's point on the outer face.
    receptor_rotation : (n, 3, 3) float
        Axes of each receptor's frame as columns; the third is the outward normal.
    receptor_radius_m : (n,) float
        Distance to the farthest point of the outer face that is nearest to this marker.
    """

    name: str
    visuals: dict[str, tuple[TriangleMesh, tuple[int, ...]]]
    pieces: list[TriangleMesh]
    mass: MassProperties
    cameras: list[CameraFrame]
    receptors_m: FloatArray
    receptor_rotation: FloatArray
    receptor_radius_m: FloatArray


def make_part(sensor: Sensor, switches: SwitchSet | None) -> SimulatorPart:
    """Everything of a sensor that goes into a simulator.

    Parameters
    ----------
    sensor : Sensor
        A design that passes its rules.
    switches : SwitchSet, optional
        Its switches; none if it has none.
    """
    shell_mm, rubber_mm = 0.02, 0.15  # accuracy of what is shown; its volume is exact
    design, markers = sensor.design, sensor.markers
    shift = np.array([0.0, 0.0, -base_z_mm(sensor)])
    bodies = painted_manifolds(sensor, tolerance_mm=shell_mm)
    shown: dict[str, tuple[TriangleMesh, tuple[int, ...]]] = {
        name: (to_triangles(body).moved(shift), DISPLAY_COLOURS.get(name, DISPLAY_COLOURS["resin"]))
        for name, body in bodies.items()
    }
    solids = [(mesh, "resin") for mesh, _ in shown.values()]
    if switches:
        coarse = switch_mesh(sensor.surface, markers, switches, tolerance_mm=rubber_mm)
        shown["switches"] = coarse.moved(shift), RUBBER_RGBA
        solids.append((switch_mesh(sensor.surface, markers, switches).moved(shift), "tpu"))
    names = ["camera", "camera_far"]
    return SimulatorPart(
        name=design.name,
        visuals=shown,
        pieces=[piece.moved(shift) for piece in convex_pieces(sensor)],
        mass=mass_properties([(mesh, _density_kg_m3(kind)) for mesh, kind in solids]),
        cameras=[
            CameraFrame(
                name=name,
                position_m=1e-3 * (camera.position_mm + shift),
                rotation=camera.rotation.T,
                lens=camera.lens,
                rate_Hz=design.camera.frame_rate_Hz,
            )
            for name, camera in zip(names, sensor.cameras, strict=False)
        ],
        receptors_m=1e-3 * (sensor.surface.point(markers.uv) + shift),
        receptor_rotation=frames_along(markers.normal),
        receptor_radius_m=1e-3 * _cell_radius_mm(sensor),
    )


def base_z_mm(sensor: Sensor) -> float:
    """Height of the lowest point of the rims, where the sensor stands, in the sensor's frame."""
    wall, surface = sensor.design.wall, sensor.surface
    (u0, u1), (v0, v1) = surface.domain
    v = np.linspace(v0, v1, 257)
    loops = chart_loops(surface, np.linspace(u0, u1, 257), v[:-1] if surface.periodic[1] else v)
    faces = (-wall.thickness_mm, wall.rim_flange_mm if wall.rim_length_mm > 0.0 else 0.0)
    return min(
        float(loop.points_mm(surface, offset, wall.rim_length_mm)[:, 2].min())
        for loop in loops
        for offset in faces
    )


def _density_kg_m3(material: str) -> float:
    density = density_g_cm3(material)
    assert density is not None  # noqa: S101 - resin and rubber have one
    return 1e3 * density


def mass_properties(solids: list[tuple[TriangleMesh, float]]) -> MassProperties:
    """Mass properties of closed meshes (mm) with a density each (kg/m³), together."""
    from trimesh.triangles import mass_properties as of_triangles

    parts = [of_triangles(1e-3 * mesh.corners_mm, density=density) for mesh, density in solids]
    mass = sum(float(part["mass"]) for part in parts)
    centre = sum(part["mass"] * np.asarray(part["center_mass"]) for part in parts) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        arm = np.asarray(part["center_mass"]) - centre
        # Steiner's theorem.
        inertia += part["inertia"] + part["mass"] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return MassProperties(
        mass_kg=mass, centre_m=np.asarray(centre), inertia_kg_m2=(inertia + inertia.T) / 2.0
    )


def _cell_radius_mm(sensor: Sensor) -> FloatArray:
    """Radius of each marker's Voronoi cell on the outer face, (n,) mm."""
    step_mm = 1.0  # distance of the points that are assigned to their nearest marker
    surface = sensor.surface
    u, v = (
        np.linspace(low, high, divisions(surface, 0.0, axis, np.inf, step_mm) + 1)
        for axis, (low, high) in enumerate(surface.domain)
    )
    points = surface.point(np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2))
    distance, nearest = cKDTree(surface.point(sensor.markers.uv)).query(points)
    radius = np.zeros(sensor.markers.count)
    np.maximum.at(radius, nearest, distance)
    return np.maximum(radius, step_mm)
