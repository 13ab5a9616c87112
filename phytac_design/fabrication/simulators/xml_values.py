"""Numbers, rotations and meshes as the text of simulator files; equal values give equal text."""

from collections.abc import Iterable

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray


def numbers(values: Iterable[float]) -> str:
    """Numbers with twelve digits, a thousandth of a nanometre at a metre; zero has no sign."""
    tiny = 1e-15  # rounding of a rotation's zeros
    return " ".join(f"{0.0 if abs(x) < tiny else x:.12g}" for x in values)


def quaternion(rotation: FloatArray) -> FloatArray:
    """Unit quaternion (w, x, y, z) of a rotation (3, 3), w not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True)
    return np.array([w, x, y, z])


def roll_pitch_yaw(rotation: FloatArray) -> FloatArray:
    """Angles (3,) rad about the fixed axes x, y, z of a rotation ``Rz(yaw) Ry(pitch) Rx(roll)``.

    At a pitch of ±90° the yaw is 0.
    """
    locked = 1e-9  # sine of the angle from there within which only their sum is known
    cosine = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    pitch = np.arctan2(-rotation[2, 0], cosine)
    if cosine < locked:
        return np.array([np.arctan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0])
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            pitch,
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def rgba(colour: Iterable[int]) -> str:
    """Colour of 0 to 255 as shares."""
    return numbers(round(part / 255.0, 4) for part in colour)


def obj_text(mesh: TriangleMesh) -> str:
    """Wavefront OBJ of a mesh in metres, to 0.1 nm: MuJoCo, ROS, Gazebo and Drake all read it."""
    points, corners = 1e-3 * mesh.vertices_mm, mesh.triangles + 1
    lines = [f"v {x:.10f} {y:.10f} {z:.10f}" for x, y, z in points.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in corners.tolist()]
    return "\n".join(lines) + "\n"
