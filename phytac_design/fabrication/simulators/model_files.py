"""MJCF, URDF and SDF of a sensor; each is one rigid body ``base`` with frames fixed to it."""

from collections.abc import Callable
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from phytac_design.fabrication.simulators.simulator_part import (
    CameraFrame,
    MassProperties,
    SimulatorPart,
)
from phytac_design.fabrication.simulators.xml_values import (
    numbers,
    quaternion,
    rgba,
    roll_pitch_yaw,
)
from phytac_shapes.arrays import FloatArray

BASE = "base"
"""The body or link that everything belongs to."""
NO_MASS = MassProperties(mass_kg=0.0, centre_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
CLIP_m = (1e-3, 10.0)
"""Near and far plane of simulated cameras: the wall is a few millimetres away."""


def visual_file(name: str) -> str:
    """File of a body that is shown."""
    return f"visual_{name}.obj"


def piece_file(number: int) -> str:
    """File of a collision piece."""
    return f"collision_{number}.obj"


def mjcf(part: SimulatorPart, *, receptors: bool, prefix: str) -> dict[str, str]:
    """MuJoCo's file ``NAME.xml``: sites with touch sensors, cameras, geoms.

    A touch sensor adds up the normal forces, N, of contacts within its site: a sphere that reaches
    to the edge of its marker's cell, so that no contact on the sensing face is missed.
    """
    root = Element("mujoco", model=part.name)
    SubElement(root, "compiler", angle="radian", meshdir=prefix)
    sizes = [(c.lens.width_px, c.lens.height_px) for c in part.cameras]
    width, height = (str(max(side)) for side in zip(*sizes, strict=True))
    SubElement(SubElement(root, "visual"), "global", offwidth=width, offheight=height)
    asset = SubElement(root, "asset")
    body = SubElement(SubElement(root, "worldbody"), "body", name=BASE)
    mass = part.mass
    inertia = mass.inertia_kg_m2
    SubElement(
        body,
        "inertial",
        pos=numbers(mass.centre_m),
        mass=numbers([mass.mass_kg]),
        fullinertia=numbers(
            inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        ),
    )
    for name, (_, colour) in part.visuals.items():
        mesh = f"visual_{name}"
        SubElement(asset, "mesh", name=mesh, file=visual_file(name), inertia="shell")
        SubElement(
            body,
            "geom",
            name=mesh,
            type="mesh",
            mesh=mesh,
            rgba=rgba(colour),
            group="2",
            contype="0",
            conaffinity="0",
        )
    for number in range(len(part.pieces)):
        mesh = f"collision_{number}"
        SubElement(asset, "mesh", name=mesh, file=piece_file(number))
        SubElement(body, "geom", name=mesh, type="mesh", mesh=mesh, group="3")
    for camera in part.cameras:
        _mjcf_camera(body, camera)
    if not receptors:
        return {f"{part.name}.xml": _text(root)}
    sensors = SubElement(root, "sensor")
    for number, at in enumerate(part.receptors_m):
        SubElement(
            body,
            "site",
            name=f"receptor_{number}",
            pos=numbers(at),
            quat=numbers(quaternion(part.receptor_rotation[number])),
            size=numbers([part.receptor_radius_m[number]]),
            group="4",
        )
        SubElement(sensors, "touch", name=f"touch_{number}", site=f"receptor_{number}")
    return {f"{part.name}.xml": _text(root)}


def _mjcf_camera(body: Element, camera: CameraFrame) -> None:
    """The optical frame as a site, and the camera, which looks along -z with y up."""
    lens, position = camera.lens, numbers(camera.position_m)
    SubElement(
        body,
        "site",
        name=f"{camera.name}_optical",
        pos=position,
        quat=numbers(quaternion(camera.rotation)),
        size="0.001",
        group="4",
    )
    # MuJoCo counts the image's middle from the principal point; its pixels begin at the corner.
    middle = (lens.width_px / 2.0 - lens.cx_px - 0.5, lens.height_px / 2.0 - lens.cy_px - 0.5)
    # Only the ratio of the sensor's size to the focal length matters: a pixel is 1 µm.
    size = np.array([lens.width_px, lens.height_px])
    SubElement(
        body,
        "camera",
        name=camera.name,
        pos=position,
        quat=numbers(quaternion(camera.rotation @ np.diag([1.0, -1.0, -1.0]))),
        resolution=numbers(size),
        sensorsize=numbers(1e-6 * size),
        focalpixel=numbers((lens.fx_px, lens.fy_px)),
        principalpixel=numbers(middle),
    )


def urdf(part: SimulatorPart, *, receptors: bool, prefix: str) -> dict[str, str]:
    """ROS's file ``NAME.urdf``: the link ``base``, and links fixed to it for the frames."""
    root = Element("robot", name=part.name)
    base = SubElement(root, "link", name=BASE)
    mass = part.mass
    _urdf_inertial(base, mass)
    for name, (_, colour) in part.visuals.items():
        visual = SubElement(base, "visual", name=f"visual_{name}")
        _urdf_mesh(visual, prefix + visual_file(name))
        material = SubElement(visual, "material", name=f"{part.name}_{name}")
        SubElement(material, "color", rgba=rgba(colour))
    for number in range(len(part.pieces)):
        collision = SubElement(base, "collision", name=f"collision_{number}")
        _urdf_mesh(collision, prefix + piece_file(number))
    for name, position, rotation in _frames(part, receptors=receptors):
        # Bullet takes a link without mass for one of 1 kg.
        _urdf_inertial(SubElement(root, "link", name=name), NO_MASS)
        joint = SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        SubElement(joint, "parent", link=BASE)
        SubElement(joint, "child", link=name)
        angles = numbers(roll_pitch_yaw(rotation))
        SubElement(joint, "origin", xyz=numbers(position), rpy=angles)
    return {f"{part.name}.urdf": _text(root)}


def _urdf_inertial(link: Element, mass: MassProperties) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=numbers(mass.centre_m), rpy="0 0 0")
    SubElement(inertial, "mass", value=numbers([mass.mass_kg]))
    SubElement(inertial, "inertia", _inertia(mass.inertia_kg_m2))


def _urdf_mesh(parent: Element, file: str) -> None:
    SubElement(parent, "origin", xyz="0 0 0", rpy="0 0 0")
    SubElement(SubElement(parent, "geometry"), "mesh", filename=file)


def sdf(part: SimulatorPart, *, receptors: bool, prefix: str) -> dict[str, str]:
    """Gazebo's ``model.sdf`` and ``model.config``: the link ``base`` with its cameras, and frames.

    A lens's distortion is written where SDF has its terms: Brown-Conrady up to k3.
    """
    root = Element("sdf", version="1.9")
    model = SubElement(root, "model", name=part.name, canonical_link=BASE)
    link = SubElement(model, "link", name=BASE)
    mass = part.mass
    inertial = SubElement(link, "inertial")
    _leaf(inertial, "pose", numbers([*mass.centre_m, 0.0, 0.0, 0.0]))
    _leaf(inertial, "mass", numbers([mass.mass_kg]))
    inertia = SubElement(inertial, "inertia")
    for name, value in _inertia(mass.inertia_kg_m2).items():
        _leaf(inertia, name, value)
    for name, (_, colour) in part.visuals.items():
        visual = SubElement(link, "visual", name=f"visual_{name}")
        _sdf_mesh(visual, prefix + visual_file(name))
        material = SubElement(visual, "material")
        for light in ("ambient", "diffuse"):
            _leaf(material, light, rgba(colour))
    for number in range(len(part.pieces)):
        collision = SubElement(link, "collision", name=f"collision_{number}")
        _sdf_mesh(collision, prefix + piece_file(number))
    for camera in part.cameras:
        _sdf_camera(link, camera)
    for name, position, rotation in _frames(part, receptors=receptors):
        frame = SubElement(model, "frame", name=name, attached_to=BASE)
        _leaf(frame, "pose", numbers([*position, *roll_pitch_yaw(rotation)]))
    config = Element("model")
    _leaf(config, "name", part.name)
    _leaf(config, "version", "1.0")
    sdf_file = SubElement(config, "sdf", version="1.9")
    sdf_file.text = "model.sdf"
    return {"model.sdf": _text(root), "model.config": _text(config)}


def _sdf_mesh(parent: Element, file: str) -> None:
    _leaf(SubElement(SubElement(parent, "geometry"), "mesh"), "uri", file)


def _sdf_camera(link: Element, camera: CameraFrame) -> None:
    """Gazebo's camera looks along x with z up; its pixels begin at the image's corner."""
    lens = camera.lens
    sensor = SubElement(link, "sensor", name=camera.name, type="camera")
    # Columns: the axes of Gazebo's camera in the optical frame.
    turn = camera.rotation @ np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    _leaf(sensor, "pose", numbers([*camera.position_m, *roll_pitch_yaw(turn)]))
    _leaf(sensor, "update_rate", numbers([camera.rate_Hz]))
    _leaf(sensor, "topic", camera.name)
    own = SubElement(sensor, "camera")
    _leaf(own, "optical_frame_id", f"{camera.name}_optical")
    _leaf(own, "horizontal_fov", numbers([2.0 * np.arctan(lens.width_px / (2.0 * lens.fx_px))]))
    image = SubElement(own, "image")
    _leaf(image, "width", str(lens.width_px))
    _leaf(image, "height", str(lens.height_px))
    clip = SubElement(own, "clip")
    for name, value in zip(("near", "far"), CLIP_m, strict=True):
        _leaf(clip, name, numbers([value]))
    if lens.model == "brown_conrady" and any(lens.distortion[:5]) and not any(lens.distortion[5:]):
        distortion = SubElement(own, "distortion")
        terms = dict(zip(("k1", "k2", "p1", "p2", "k3"), lens.distortion, strict=False))
        for name in ("k1", "k2", "k3", "p1", "p2"):
            _leaf(distortion, name, numbers([terms.get(name, 0.0)]))
    intrinsics = SubElement(SubElement(own, "lens"), "intrinsics")
    values = (lens.fx_px, lens.fy_px, lens.cx_px + 0.5, lens.cy_px + 0.5, 0.0)
    for name, value in zip(("fx", "fy", "cx", "cy", "s"), values, strict=True):
        _leaf(intrinsics, name, numbers([value]))


FORMATS: dict[str, Callable[..., dict[str, str]]] = {"mjcf": mjcf, "urdf": urdf, "sdf": sdf}
"""Texts of a format's files by their names, from a part."""


def _frames(part: SimulatorPart, *, receptors: bool) -> list[tuple[str, FloatArray, FloatArray]]:
    """Name, origin and axes of every frame that is fixed to the base."""
    found = [(f"{c.name}_optical", c.position_m, c.rotation) for c in part.cameras]
    if receptors:
        found += [
            (f"receptor_{number}", at, part.receptor_rotation[number])
            for number, at in enumerate(part.receptors_m)
        ]
    return found


def _inertia(matrix: FloatArray) -> dict[str, str]:
    """Moments and products by the names that URDF and SDF share."""
    return {
        f"i{'xyz'[i]}{'xyz'[j]}": numbers([matrix[i, j]]) for i in range(3) for j in range(i, 3)
    }


def _leaf(parent: Element, name: str, text: str) -> None:
    SubElement(parent, name).text = text


def _text(root: Element) -> str:
    indent(root)
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'
