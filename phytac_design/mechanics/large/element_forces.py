"""Internal forces of :class:`corotational.Corotational` as one compiled loop over the elements.

Five times faster than the same formulas in arrays, because an element stays in the processor's
cache.
"""

import numpy as np

from phytac_design.core.kernels import kernel
from phytac_design.mechanics.large.rotations import SMALL
from phytac_shapes.arrays import FloatArray, IntArray


@kernel
def _product(
    aw: float,
    ax: float,
    ay: float,
    az: float,
    bw: float,
    bx: float,
    by: float,
    bz: float,
) -> tuple[float, float, float, float]:
    """Quaternion of b followed by a."""
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + bw * ax + ay * bz - az * by
    y = aw * by + bw * ay + az * bx - ax * bz
    z = aw * bz + bw * az + ax * by - ay * bx
    size = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    return w * size, x * size, y * size, z * size


@kernel
def _turn_back(w: float, x: float, y: float, z: float, out: FloatArray) -> None:
    """Rᵀ − 1 (3, 3) of a quaternion, without cancellation."""
    out[0, 0] = -2.0 * (y * y + z * z)
    out[1, 1] = -2.0 * (x * x + z * z)
    out[2, 2] = -2.0 * (x * x + y * y)
    out[0, 1] = 2.0 * (x * y + w * z)
    out[1, 0] = 2.0 * (x * y - w * z)
    out[0, 2] = 2.0 * (x * z - w * y)
    out[2, 0] = 2.0 * (x * z + w * y)
    out[1, 2] = 2.0 * (y * z + w * x)
    out[2, 1] = 2.0 * (y * z - w * x)


@kernel
def _inverse(a: FloatArray, out: FloatArray) -> float:
    """Inverse of a (3, 3) into ``out``, and its determinant."""
    out[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    out[0, 1] = a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]
    out[0, 2] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    out[1, 0] = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    out[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    out[1, 2] = a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]
    out[2, 0] = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    out[2, 1] = a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]
    out[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant
    return float(determinant)


@kernel
def _deformed(arms: FloatArray, moved: FloatArray, back: FloatArray, ubar: FloatArray) -> None:
    """ū = Rᵀ(P + d) − P of four corners."""
    for a in range(4):
        for i in range(3):
            total = moved[a, i]
            for j in range(3):
                total += back[i, j] * (arms[a, j] + moved[a, j])
            ubar[a, i] = total


@kernel
def _inertia(arms: FloatArray, ubar: FloatArray, out: FloatArray) -> None:
    """A (3, 3) with A ω = Σ P_a × (ω × (P_a + ū_a))."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(4):
                total += (arms[a, i] + ubar[a, i]) * arms[a, j]
            out[i, j] = -total
    trace = -(out[0, 0] + out[1, 1] + out[2, 2])
    for i in range(3):
        out[i, i] += trace


@kernel
def _exponential(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Quaternion of a rotation vector."""
    half = 0.5 * np.sqrt(x * x + y * y + z * z)
    share = 0.5 if half == 0.0 else 0.5 * np.sin(half) / half
    return np.cos(half), share * x, share * y, share * z


@kernel
def _eta(square: float) -> float:
    """η of ``rotations.spin_to_vector`` for the squared angle."""
    angle = np.sqrt(square)
    if angle < SMALL:
        return 1.0 / 12.0 + square / 720.0 + square * square / 30240.0
    half = 0.5 * angle
    return float((1.0 - half * np.cos(half) / np.sin(half)) / square)


@kernel
def _corners(nodes: IntArray, displacement: FloatArray, moved: FloatArray) -> None:
    """Displacements (4, 3) of an element's corners about their mean."""
    for i in range(3):
        mean = 0.0
        for a in range(4):
            mean += displacement[nodes[a], i]
        for a in range(4):
            moved[a, i] = displacement[nodes[a], i] - 0.25 * mean


@kernel
def _mean_rotation(nodes: IntArray, quaternion: FloatArray) -> tuple[float, float, float, float]:
    """Quaternion halfway between those of the corners."""
    w, x, y, z = 0.0, 0.0, 0.0, 0.0
    first = quaternion[nodes[0]]
    for a in range(4):
        q = quaternion[nodes[a]]
        along = q[0] * first[0] + q[1] * first[1] + q[2] * first[2] + q[3] * first[3]
        sign = -1.0 if along < 0.0 else 1.0
        w, x, y, z = w + sign * q[0], x + sign * q[1], y + sign * q[2], z + sign * q[3]
    return _product(w, x, y, z, 1.0, 0.0, 0.0, 0.0)


@kernel
def _fit(
    arms: FloatArray,
    moved: FloatArray,
    back: FloatArray,
    ubar: FloatArray,
    q: FloatArray,
    work: FloatArray,
) -> bool:
    """Turn ``q`` (4,) until Σ P_a × ū_a = 0; leaves Rᵀ − 1 and ū of it. False if it does not."""
    # Newton's method: three steps are common; the step after the last would be of the order of
    # its square.
    max_steps, tolerance_rad2 = 12, 1e-11
    inertia, turn, gap, step = work[0], work[1], work[2, 0], work[2, 1]
    for _ in range(max_steps):
        _turn_back(q[0], q[1], q[2], q[3], back)
        _deformed(arms, moved, back, ubar)
        _inertia(arms, ubar, inertia)
        if not _inverse(inertia, turn) > 0.0:
            return False
        gap[:] = 0.0
        for a in range(4):
            _add_cross(arms[a], ubar[a], gap)
        square = 0.0
        for i in range(3):
            step[i] = turn[i, 0] * gap[0] + turn[i, 1] * gap[1] + turn[i, 2] * gap[2]
            square += step[i] * step[i]
        if not np.isfinite(square):
            return False
        short = 1.0 if square <= 1.0 else 1.0 / np.sqrt(square)
        w, x, y, z = _exponential(short * step[0], short * step[1], short * step[2])
        q[0], q[1], q[2], q[3] = _product(q[0], q[1], q[2], q[3], w, x, y, z)
        if square < tolerance_rad2:
            _turn_back(q[0], q[1], q[2], q[3], back)
            _deformed(arms, moved, back, ubar)
            return True
    return False


@kernel
def _add_cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@kernel
def _relative(q: FloatArray, node: FloatArray, theta: FloatArray) -> None:
    """Rotation vector of a node in the frame, log(Rᵀ R_a)."""
    w, x, y, z = _product(q[0], -q[1], -q[2], -q[3], node[0], node[1], node[2], node[3])
    sign = -1.0 if w < 0.0 else 1.0
    length = np.sqrt(x * x + y * y + z * z)
    ratio = 2.0 if length == 0.0 else 2.0 * np.arctan2(length, sign * w) / length
    theta[0], theta[1], theta[2] = sign * ratio * x, sign * ratio * y, sign * ratio * z


@kernel
def _stored(stiffness: FloatArray, motion: FloatArray, force: FloatArray) -> None:
    """K (ū, θ̄), (24,)."""
    force[:] = 0.0
    for j in range(24):
        # Column by column (K is symmetric), so that the inner loop is a plain vector one.
        share, column = motion[j], stiffness[j]
        for i in range(24):
            force[i] += share * column[i]


@kernel
def _spun(theta: FloatArray, moment: FloatArray, work: FloatArray) -> None:
    """Hᵀm = m + θ×m/2 + η θ×(θ×m) in place of m."""
    once, twice = work[2, 0], work[2, 1]
    once[:] = 0.0
    twice[:] = 0.0
    _add_cross(theta, moment, once)
    _add_cross(theta, once, twice)
    eta = _eta(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2)
    for i in range(3):
        moment[i] += 0.5 * once[i] + eta * twice[i]


@kernel
def _balance(arms: FloatArray, ubar: FloatArray, force: FloatArray, work: FloatArray) -> None:
    """Take out of forces (24,) what turns with the frame: n_a − G_aᵀτ = n_a + P_a × A⁻ᵀτ."""
    inertia, turn = work[0], work[1]
    torque, y, at = work[2, 0], work[2, 1], work[2, 2]
    torque[:] = 0.0
    for a in range(4):
        for i in range(3):
            at[i] = arms[a, i] + ubar[a, i]
            torque[i] += force[6 * a + 3 + i]
        _add_cross(at, force[6 * a : 6 * a + 3], torque)
    _inertia(arms, ubar, inertia)
    _inverse(inertia, turn)
    for i in range(3):
        y[i] = turn[0, i] * torque[0] + turn[1, i] * torque[1] + turn[2, i] * torque[2]
    for a in range(4):
        _add_cross(arms[a], y, force[6 * a : 6 * a + 3])


@kernel
def _scatter(nodes: IntArray, back: FloatArray, force: FloatArray, out: FloatArray) -> None:
    """Add R f = f + (Rᵀ − 1)ᵀ f to the nodes."""
    for a in range(4):
        for k in range(2):
            b = 6 * a + 3 * k
            for i in range(3):
                total = force[b + i]
                for j in range(3):
                    total += back[j, i] * force[b + j]
                out[nodes[a], 3 * k + i] += total


@kernel
def element_forces(
    quads: IntArray,
    arms: FloatArray,
    stiffness: FloatArray,
    displacement: FloatArray,
    quaternion: FloatArray,
    out: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> int:
    """Add the elements' forces to nodes; the first element without a frame, or -1.

    ``out`` is, to be filled: nodal forces (N, 6), zeros; per element its frame (E, 4), ū (E, 4, 3),
    motion (ū, θ̄) and forces f̄ in the frame (E, 24).
    """
    nodal, frames, ubars, motions, forces = out
    moved, back = np.empty((4, 3)), np.empty((3, 3))
    force, work = np.empty(24), np.empty((3, 3, 3))
    for e in range(len(quads)):
        nodes, q, ubar, motion = quads[e], frames[e], ubars[e], motions[e]
        _corners(nodes, displacement, moved)
        q[0], q[1], q[2], q[3] = _mean_rotation(nodes, quaternion)
        if not _fit(arms[e], moved, back, ubar, q, work):
            return e
        for a in range(4):
            b = 6 * a
            motion[b], motion[b + 1], motion[b + 2] = ubar[a, 0], ubar[a, 1], ubar[a, 2]
            _relative(q, quaternion[nodes[a]], motion[b + 3 : b + 6])
        _stored(stiffness[e], motion, force)
        forces[e] = force
        for a in range(4):
            b = 6 * a + 3
            _spun(motion[b : b + 3], force[b : b + 3], work)
        _balance(arms[e], ubar, force, work)
        _scatter(nodes, back, force, nodal)
    return -1
