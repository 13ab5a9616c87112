"""Frames of a force stream as ROS 2 messages: the types' definitions, and their fields.

Definitions are the published ones of ROS 2 Humble, without comments; ``TactileContact`` is that of
``tactile_msgs``. Lengths are metres and moments newton metres, as ROS has them; moments are about
the origin of the frame ``sensor``, that of the design.
"""

import struct
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.serving.wire_protocol import Message
from phytac_shapes.arrays import ImageArray

SENSOR_FRAME = "sensor"
"""Frame of wrenches and contacts."""
CAMERA_FRAMES = ("camera_optical", "camera_far_optical")
"""Frames of the cameras, as in exported models."""
ARROW_m_N = 0.005
"""Length of a contact's arrow for a newton."""
DISTORTION_NAMES = {"pinhole": "plumb_bob", "kannala_brandt": "equidistant"}
"""ROS's name of a lens model, where it does not follow from the number of coefficients."""

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/UInt8MultiArray": "std_msgs/MultiArrayLayout layout\nuint8[] data",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "sensor_msgs/RegionOfInterest": (
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"
    ),
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
        "float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\n"
        "uint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    ),
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\n"
        "int32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n"
        "int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\nint32 ADD=0\n"
        "int32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\nstd_msgs/Header header\nstring ns\n"
        "int32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\n"
        "std_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\nbool frame_locked\n"
        "geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\n"
        "string text\nstring mesh_resource\nvisualization_msgs/MeshFile mesh_file\n"
        "bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\n"
        "string message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    "diagnostic_msgs/DiagnosticArray": (
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status"
    ),
    "tactile_msgs/TactileContact": (
        "std_msgs/Header header\nstring name\ngeometry_msgs/Point position\n"
        "geometry_msgs/Vector3 normal\ngeometry_msgs/Wrench wrench"
    ),
}
"""Fields of each type, one a line."""

LETTERS = {
    "bool": "?",
    "byte": "B",
    "uint8": "B",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}
"""Letters of :mod:`struct` for types of numbers."""
DELETE_ALL, ARROW = 3, 0
"""``Marker.DELETEALL`` and ``Marker.ARROW``."""


class TopicMessage(NamedTuple):
    """One message: where it goes, its type (``package/Name``), and its fields."""

    topic: str
    type_name: str
    fields: dict[str, Any]


def schema_text(type_name: str) -> str:
    """Definition of a type followed by those of all types in it, as MCAP has them."""
    found: list[str] = []

    def add(name: str) -> None:
        if name in found:
            return
        found.append(name)
        for line in DEFINITIONS[name].splitlines():
            inner = line.partition(" ")[0].partition("[")[0]
            if inner in DEFINITIONS:
                add(inner)

    add(type_name)
    rule = "\n" + "=" * 80 + "\n"
    texts = [f"MSG: {name}\n{DEFINITIONS[name]}" for name in found[1:]]
    return rule.join([DEFINITIONS[type_name], *texts])


def cdr_bytes(type_name: str, fields: dict[str, Any]) -> bytes:
    """Fields of a message in ROS 2's encoding, CDR with its header, little-endian (OMG 2002)."""
    out = bytearray()
    _put_fields(out, type_name, fields)
    return b"\x00\x01\x00\x00" + bytes(out)


@cache
def parsed_fields(type_name: str) -> tuple[tuple[str, str, str], ...]:
    """Type, array suffix and name of each field; constants are none."""
    fields = (line.split(" ") for line in DEFINITIONS[type_name].splitlines() if "=" not in line)
    return tuple((*kind.partition("[")[::2], name) for kind, name in fields)


def _put_fields(out: bytearray, type_name: str, fields: dict[str, Any]) -> None:
    for kind, suffix, name in parsed_fields(type_name):
        value = fields[name]
        if not suffix:
            _put(out, kind, value)
            continue
        if suffix == "]":  # of any length, which comes first
            _put(out, "uint32", len(value))
        elif len(value) != int(suffix[:-1]):
            raise ValueError(f"{type_name}.{name} takes {suffix[:-1]} numbers (got {len(value)})")
        if kind == "uint8":
            out += bytes(value)
            continue
        for item in value:
            _put(out, kind, item)


def _put(out: bytearray, kind: str, value: Any) -> None:
    if kind in DEFINITIONS:
        _put_fields(out, kind, value)
    elif kind == "string":
        text = value.encode()
        _put(out, "uint32", len(text) + 1)
        out += text + b"\0"
    else:
        letter = LETTERS[kind]
        # A number begins at a multiple of its own size.
        out += bytes(-len(out) % struct.calcsize(letter))
        out += struct.pack("<" + letter, value)


def frame_messages(message: Message, stamp_ns: int, markers: int) -> Iterator[TopicMessage]:
    """Messages of one frame: wrenches, contacts, arrows, switches, and what is wrong with it.

    Of a frame that is not valid there is the last alone.

    Parameters
    ----------
    message : dict
        Frame of a stream.
    stamp_ns : int
        Unix time when it was taken.
    markers : int
        Of the sensor.
    """
    header = _header(stamp_ns, SENSOR_FRAME)
    if message["valid"]:
        yield _wrench("wrench", header, message["net_force_N"], moment_at_origin(message))
        contacts = message["contacts"]
        wrenches = [_contact_wrench(contact) for contact in contacts]
        for region in message.get("regions", ()):
            own = [
                wrench
                for contact, wrench in zip(contacts, wrenches, strict=True)
                if contact["region"] == region["name"]
            ]
            force, moment = np.sum([np.zeros((2, 3)), *own], axis=0)
            yield _wrench(region_topic(region["name"]), header, force, moment)
        for contact, wrench in zip(contacts, wrenches, strict=True):
            yield _tactile(header, contact, wrench)
        yield _arrows(header, contacts, wrenches)
        yield _switches(message["koi"], markers)
    if message["warnings"] or not message["valid"]:
        yield _diagnostics(header, message)


def camera_messages(cameras: Sequence[Camera], stamp_ns: int) -> Iterator[TopicMessage]:
    """``CameraInfo`` of each camera; pixel centres are integers, as in OpenCV and ROS."""
    for camera, frame in zip(cameras, CAMERA_FRAMES, strict=False):
        lens = camera.lens
        few, many = len(lens.distortion) <= 5, "rational_polynomial"
        plain = lens.model if lens.model != "brown_conrady" else "plumb_bob" if few else many
        least = 4 if lens.model == "kannala_brandt" else 5
        d = [*lens.distortion, *[0.0] * (least - len(lens.distortion))]
        fx, fy, cx, cy = lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px
        yield TopicMessage(
            f"{frame.removesuffix('_optical')}/camera_info",
            "sensor_msgs/CameraInfo",
            {
                "header": _header(stamp_ns, frame),
                "height": lens.height_px,
                "width": lens.width_px,
                "distortion_model": DISTORTION_NAMES.get(lens.model, plain),
                "d": d,
                "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
                "r": np.eye(3).ravel().tolist(),
                "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
                "binning_x": 0,
                "binning_y": 0,
                "roi": dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
                | {"do_rectify": False},
            },
        )


def image_messages(images: Sequence[ImageArray], stamp_ns: int) -> Iterator[TopicMessage]:
    """Picture of each camera, (h, w, 3) uint8 BGR, beside its ``CameraInfo``."""
    for image, frame in zip(images, CAMERA_FRAMES, strict=False):
        height, width, channels = image.shape
        yield TopicMessage(
            f"{frame.removesuffix('_optical')}/image_raw",
            "sensor_msgs/Image",
            {
                "header": _header(stamp_ns, frame),
                "height": height,
                "width": width,
                "encoding": "bgr8",
                "is_bigendian": 0,
                "step": channels * width,
                "data": image.tobytes(),
            },
        )


def _header(stamp_ns: int, frame: str) -> dict[str, Any]:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def _xyz(vector: Any, scale: float = 1.0) -> dict[str, float]:
    x, y, z = (scale * float(part) for part in vector)
    return {"x": x, "y": y, "z": z}


def moment_at_origin(message: Message) -> Any:
    """Return the moment of a message about the sensor frame's origin, (3,) N·mm."""
    arm = np.cross(message["moment_about_mm"], message["net_force_N"])
    return np.asarray(message["net_moment_Nmm"]) + arm


def _contact_wrench(contact: Message) -> Any:
    """Force, N, and moment about the origin, N·mm, of a contact, (2, 3)."""
    force = np.asarray(contact.get("shear_N", (0.0, 0.0, 0.0)))
    force = force - contact["force_N"] * np.asarray(contact["normal"])
    return np.stack([force, np.cross(contact["position_mm"], force)])


def _wrench(topic: str, header: dict[str, Any], force_N: Any, moment_Nmm: Any) -> TopicMessage:
    fields = {"header": header, "wrench": _wrench_fields(force_N, moment_Nmm)}
    return TopicMessage(topic, "geometry_msgs/WrenchStamped", fields)


def _wrench_fields(force_N: Any, moment_Nmm: Any) -> dict[str, Any]:
    return {"force": _xyz(force_N), "torque": _xyz(moment_Nmm, 1e-3)}


def _tactile(header: dict[str, Any], contact: Message, wrench: Any) -> TopicMessage:
    return TopicMessage(
        "contacts",
        "tactile_msgs/TactileContact",
        {
            "header": header,
            "name": str(contact["id"]),
            "position": _xyz(contact["position_mm"], 1e-3),
            "normal": _xyz(contact["normal"]),
            "wrench": _wrench_fields(*wrench),
        },
    )


def _arrows(header: dict[str, Any], contacts: Sequence[Message], wrenches: Any) -> TopicMessage:
    """An arrow for each contact, which ends where it presses; those of the frame before go."""
    markers = [_marker(header, 0, DELETE_ALL, [])]
    for contact, (force, _) in zip(contacts, wrenches, strict=True):
        end = 1e-3 * np.asarray(contact["position_mm"])
        points = [_xyz(end - ARROW_m_N * force), _xyz(end)]
        markers.append(_marker(header, contact["id"], ARROW, points))
    return TopicMessage("markers", "visualization_msgs/MarkerArray", {"markers": markers})


def _marker(
    header: dict[str, Any], number: int, kind: int, points: list[dict[str, float]]
) -> dict[str, Any]:
    """An arrow between two points, or the action that deletes all."""
    origin = {"position": _xyz((0, 0, 0)), "orientation": _xyz((0, 0, 0)) | {"w": 1.0}}
    return {
        "header": header,
        "ns": "contacts",
        "id": number,
        "type": ARROW,
        "action": kind if kind == DELETE_ALL else 0,
        "pose": origin,
        # Of an arrow by points: diameters of shaft and head, and the head's length.
        "scale": _xyz((0.002, 0.004, 0.006)),
        "color": {"r": 0.9, "g": 0.2, "b": 0.1, "a": 1.0},
        "lifetime": {"sec": 0, "nanosec": 0},
        "frame_locked": False,
        "points": points,
        "colors": [],
        "texture_resource": "",
        "texture": {"header": header, "format": "", "data": b""},
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": {"filename": "", "data": b""},
        "mesh_use_embedded_materials": False,
    }


def _switches(on: Sequence[int], markers: int) -> TopicMessage:
    """The digital channel: 1 for each receptor whose switch is on."""
    bits = bytearray(markers)
    for marker in on:
        bits[marker] = 1
    size = {"label": "receptor", "size": markers, "stride": markers}
    return TopicMessage(
        "switches",
        "std_msgs/UInt8MultiArray",
        {"layout": {"dim": [size], "data_offset": 0}, "data": bytes(bits)},
    )


def _diagnostics(header: dict[str, Any], message: Message) -> TopicMessage:
    level, code = (1 if message["valid"] else 2), message.get("code", "")
    status = {
        "level": level,
        "name": "phytac",
        "message": "; ".join(message["warnings"]),
        "hardware_id": "",
        "values": [{"key": "code", "value": code}] if code else [],
    }
    fields = {"header": header, "status": [status]}
    return TopicMessage("diagnostics", "diagnostic_msgs/DiagnosticArray", fields)


def region_topic(name: str) -> str:
    """Topic of a region's wrench; in its name are letters, digits and underscores alone."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
    return f"regions/{plain if plain[:1].isalpha() else f'region_{plain}'}/wrench"
