"""Motion of cameras against the shell since the rest frame: how it shifts the markers.

A camera that has moved, turned or changed its focal length by little shifts all markers, by a
smooth field that few numbers b describe. To second order the shifts are ::

    d(b) = Σ b_i C_i + ½ Σ b_i b_j D_ij

with C and D by finite differences of the projection through the true lens. Markers that no contact
moves determine b, so that it is estimated together with the contacts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

MOTION_UNKNOWNS = 7
"""Of a camera: translation x, y, z (mm), rotation x, y, z (rad), relative change of focus."""
STEPS = np.array([0.01] * 3 + [1e-3] * 4)
"""Steps of the finite differences."""
MOVED_SDS = 3.0
"""Standard deviations of the prior beyond which a camera has moved too far."""
ROBUST_ITERATIONS = 8
CAUCHY_SCALE = 2.0
"""Distance of a marker, over the median one, at which it has half of its weight."""


def median(values: FloatArray) -> float:
    """Median of finite values (n,); ``np.median`` takes three times as long for some hundred."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1].tolist()
    return float((low + high) / 2.0)


@dataclass(frozen=True, kw_only=True)
class MountTolerance:
    """How far a camera may move against the shell: standard deviations of the prior.

    Attributes
    ----------
    shift_mm : float
        Of its translation along each axis.
    turn_deg : float
        Of its rotation about each axis.
    zoom_percent : float
        Of the relative change of its focal length, by focus breathing or warmth.
    """

    shift_mm: float = 0.1
    turn_deg: float = 0.1
    zoom_percent: float = 0.1

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (7,) in the units of the unknowns."""
        each = (self.shift_mm, float(np.radians(self.turn_deg)), self.zoom_percent / 100.0)
        return np.repeat(each, (3, 3, 1))


MARKED = MountTolerance(shift_mm=1.0, turn_deg=1.0, zoom_percent=1.0)
"""Motion that reference marks can show, as limits and as standard deviations of a wide prior:
beyond it terms of third order are above a tenth of a pixel."""
MARKS_MIN, MARKS_CHI2_MAX = 4, 25.0
"""Fewer marks in a camera do not determine its motion; and the largest reduced χ² of marks that
only a camera has moved."""
Mount = Literal["rigid", "bench", "handheld"]
MOUNTS: dict[Mount, MountTolerance] = {
    "rigid": MountTolerance(shift_mm=0.02, turn_deg=0.02, zoom_percent=0.03),
    "bench": MountTolerance(),
    "handheld": MountTolerance(shift_mm=0.5, turn_deg=0.5, zoom_percent=0.3),
}
"""Tolerances by name: camera and shell on one optical table, on a bracket or printed holder, or in
something that is held, swung or dropped."""


@dataclass(frozen=True, kw_only=True)
class CameraMotion:
    """Shifts of n markers by the motion of one or two cameras, 7 unknowns each, and by light.

    All q unknowns are called b. The last ones, if any, are changes of light, focus and the delay
    between rows since the rest frame (:mod:`phytac_decoder.pipeline.light_response`).

    Attributes
    ----------
    first : (q, 2n) float
        Shift px of (x0, y0, x1, …) per unknown.
    second : (t, 2n) float32
        Second derivatives by pairs of unknowns.
    pair : (2, t) int
        Which pairs.
    sd : (q,) float
        Standard deviations of the prior.
    precision : (q, q) float, optional
        Inverse covariance of the prior, where reference marks tell more than the mount.
    light : int
        Number of unknowns that are no motion: of light, focus and the delay between rows.
    """

    first: FloatArray
    second: NDArray[np.float32]
    pair: IntArray
    sd: FloatArray
    precision: FloatArray | None = None
    light: int = 0

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return len(self.sd)

    @property
    def prior(self) -> FloatArray:
        """Inverse covariance (q, q) of the motion before a frame's markers are seen."""
        return np.diag(self.sd**-2.0) if self.precision is None else self.precision

    def shift_px(self, b: FloatArray) -> FloatArray:
        """Return the shifts (2n,) px by b (q,), or by its first part: the cameras' motion alone."""
        first = self.first[: len(b)]
        # The second order of so small a motion is far below noise and costs more than the first.
        if np.abs(b / self.sd[: len(b)]).max(initial=0.0) < 0.05:
            return np.asarray(b @ first)
        products = b[self.pair[0]] * b[self.pair[1]]
        products[self.pair[0] == self.pair[1]] *= 0.5
        return np.asarray(b @ first + products @ self.second)

    @property
    def motions(self) -> int:
        """Number of unknowns that are of the cameras' motion."""
        return self.count - self.light

    def with_light(self, first: FloatArray, sd: FloatArray) -> "CameraMotion":
        """Return the same with shifts (l, 2n) by changes of light, and the sds (l,) of these."""
        return replace(
            self,
            first=np.concatenate([self.first[: self.motions], first]),
            sd=np.concatenate([self.sd[: self.motions], sd]),
            light=len(sd),
        )

    def given_marks(self, marked: "MarkedMotion") -> "CameraMotion":
        """Return the same with what reference marks tell of the motion as its prior."""
        precision = np.diag(self.sd**-2.0)
        precision[: self.motions, : self.motions] = marked.precision
        return replace(self, precision=precision)

    def excess(self, b: FloatArray, marked: "MarkedMotion | None" = None) -> list[str]:
        """Return what of b (q,) is more than three standard deviations, in words.

        With ``marked``, which b is relative to, a motion may be as large as marks can show.
        """
        out, limit = [], MOVED_SDS * self.sd
        cameras = self.motions // MOTION_UNKNOWNS
        if marked is not None:
            b = b + np.append(marked.mean, np.zeros(self.light))
            wide = np.where(marked.marked, np.tile(MARKED.sd, cameras), 0.0)
            limit = np.maximum(limit, np.append(wide, np.zeros(self.light)))
        far = np.abs(b) > limit
        for number in range(cameras):
            own = slice(MOTION_UNKNOWNS * number, MOTION_UNKNOWNS * (number + 1))
            one, much = b[own], far[own]
            words = (
                (much[:3], f"moved by {1e3 * np.linalg.norm(one[:3]):.0f} µm"),
                (much[3:6], f"turned by {np.degrees(np.linalg.norm(one[3:6])):.2f}°"),
                (much[6:], f"changed its focal length by {100.0 * one[6]:+.2f} %"),
            )
            found = [text for mask, text in words if mask.any()]
            if found:
                name = "camera" if cameras == 1 else ("near camera", "far camera")[number]
                out.append(f"the {name} has {' and '.join(found)}")
        if far[self.motions :].any():
            out.append("light, exposure, focus or the delay between rows have changed")
        return out

    def normal_equations(
        self, rows: FloatArray, shift_px: FloatArray, noise_px: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return matrix (m, m) and right-hand side (m,) for multiples of rows under any motion.

        Least squares of shifts (2n,) by multiples of rows (m, 2n) and by the motion, whose unknowns
        are eliminated, given noise of shifts.
        """
        inner = self._gram + noise_px**2 * self.prior
        across = rows @ self.first.T
        explained = np.linalg.solve(inner, across.T).T
        gram = rows @ rows.T - explained @ across.T
        return gram, rows @ shift_px - explained @ (self.first @ shift_px)

    @cached_property
    def _gram(self) -> FloatArray:
        return np.asarray(self.first @ self.first.T)

    def estimate(self, shift_px: FloatArray, noise_px: float) -> FloatArray:
        """Return the motion (q,) behind shifts (2n,): least squares with the prior, robust.

        Markers that move otherwise, as by a contact that is not known, are down-weighted by
        Cauchy's law (Holland and Welsch 1977): those that nothing presses determine the motion.
        """
        weight = np.ones(len(shift_px))
        b = np.zeros(self.count)
        for _ in range(ROBUST_ITERATIONS):
            rows = self.first * weight
            inner = rows @ self.first.T + noise_px**2 * self.prior
            b[:] = np.linalg.solve(inner, rows @ shift_px)
            off = np.hypot.reduce((shift_px - b @ self.first).reshape(-1, 2), axis=1)
            usual = max(median(off), noise_px)
            weight = np.repeat(1.0 / (1.0 + (off / (CAUCHY_SCALE * usual)) ** 2), 2)
        return np.asarray(b)

    def estimate_by_marks(self, shift_px: FloatArray, noise_px: float) -> "MarkedMotion | None":
        """Return the motion behind shifts (r, 2) of reference marks, NaN where not found.

        The table is that of the marks. The mount's prior is widened as far as the marks demand.
        None if no camera sees enough marks, or no motion explains them.
        """
        found = np.isfinite(shift_px[:, 0])
        seen = self._own & found
        enough = seen.sum(axis=1) >= np.maximum(MARKS_MIN, self._own.sum(axis=1) / 2.0)
        if not enough.any():
            return None
        used, marked = seen[enough].any(axis=0), np.repeat(enough, MOTION_UNKNOWNS)
        d = np.where(used[:, None], shift_px, 0.0).reshape(-1)
        wide = np.tile(MARKED.sd, len(enough))
        prior = np.diag(np.where(marked, np.maximum(wide, self.sd), self.sd) ** -2.0)
        b, information, chi2 = self._marked_fit(d, used, prior, noise_px)
        if chi2 > MARKS_CHI2_MAX:
            return None
        information /= max(chi2, 1.0)
        posterior = information + prior
        spread = np.sqrt(np.diagonal(np.linalg.inv(posterior)))
        demand = ((np.abs(b) - 2.0 * spread) / self.sd).reshape(len(enough), -1).max(axis=1)
        sd = self.sd * np.repeat(np.maximum(demand, 1.0), MOTION_UNKNOWNS)
        precision = information + np.diag(sd**-2.0)
        mean = np.asarray(np.linalg.solve(precision, posterior @ b), dtype=np.float64)
        return MarkedMotion(mean=mean, precision=precision, marked=marked)

    @cached_property
    def _own(self) -> BoolArray:
        """Points (cameras, r) that the motion of each camera moves."""
        blocks = self.first.reshape(-1, MOTION_UNKNOWNS, self.first.shape[1] // 2, 2)
        return np.asarray(np.any(blocks, axis=(1, 3)))

    def _marked_fit(
        self, d: FloatArray, used: BoolArray, prior: FloatArray, noise_px: float
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return motion (q,), what marks tell of it (q, q) and their reduced χ²; robust."""
        share: FloatArray = used.astype(np.float64)
        b, residual = np.zeros(self.count), d
        for _ in range(ROBUST_ITERATIONS):
            weight = np.repeat(share, 2) / noise_px**2
            rows = self.first * weight
            information = rows @ self.first.T
            # Slopes of first order converge fast enough: the second is a hundredth of it.
            step = np.linalg.solve(information + prior, rows @ residual - prior @ b)
            b, old, foreseen = b + step, share, residual - step @ self.first
            residual = d - self.shift_px(b)
            off = np.hypot(residual[::2], residual[1::2])
            usual = max(float(np.sort(off[used])[np.count_nonzero(used) // 2]), noise_px)
            weighed = np.minimum(1.0, np.square(3.0 * usual / (off + 1e-12)))
            share = np.where(used, weighed, 0.0)
            bent = float(np.abs(residual - foreseen).max())
            if bent < 0.1 * noise_px and np.abs(share - old).max() < 0.01:
                break
        freedom = max(2 * int(np.count_nonzero(used)) - MOTION_UNKNOWNS, 1)
        return b, information, float(residual @ (weight * residual)) / freedom

    def masked(self, found: BoolArray) -> "CameraMotion":
        """Return the same with no shift where ``found`` (2n,) is false."""
        return self if found.all() else replace(self, first=self.first * found)

    def weighted(self, root: FloatArray) -> "CameraMotion":
        """Return the same with each shift multiplied by the root (2n,) of its weight."""
        return replace(self, first=self.first * root)


@dataclass(frozen=True, kw_only=True)
class MarkedMotion:
    """Motion of the cameras since the rest frame as reference marks show it.

    Attributes
    ----------
    mean : (q,) float
        The motion.
    precision : (q, q) float
        Its inverse covariance, the mount's prior included.
    marked : (q,) bool
        Unknowns of cameras that see enough marks.
    """

    mean: FloatArray
    precision: FloatArray
    marked: BoolArray


def tabulate_camera_motion(
    cameras: Sequence[Camera],
    read_by: IntArray,
    head_mm: FloatArray,
    tolerance: MountTolerance,
) -> CameraMotion:
    """Tabulate how motions of the cameras shift markers.

    Parameters
    ----------
    read_by : (n,) int
        Camera that reads each marker.
    head_mm : (n, 3) float
        Painted faces of the receptors, sensor frame.
    tolerance : MountTolerance
        Prior of the motion.
    """
    first, second, pair = [], [], []
    upper = np.stack(np.triu_indices(MOTION_UNKNOWNS))
    for number, camera in enumerate(cameras):
        own = (read_by == number)[:, None]

        def place(b: FloatArray, *, camera: Camera = camera) -> FloatArray:
            return _moved(camera, b).project(head_mm)

        unit = np.diag(STEPS)
        slope = np.stack([(place(step) - place(-step)) / (2.0 * step.sum()) for step in unit])
        curve = np.stack(
            [
                (
                    place(unit[i] + unit[j])
                    - place(unit[i] - unit[j])
                    - place(unit[j] - unit[i])
                    + place(-unit[i] - unit[j])
                )
                / (4.0 * STEPS[i] * STEPS[j])
                for i, j in upper.T
            ]
        )
        # A marker outside of the field of a moved camera is not shifted by it.
        first.append(np.nan_to_num(np.where(own, slope, 0.0)))
        second.append(np.nan_to_num(np.where(own, curve, 0.0)))
        pair.append(upper + MOTION_UNKNOWNS * number)
    size = 2 * len(read_by)
    return CameraMotion(
        first=np.concatenate(first).reshape(-1, size),
        second=np.concatenate(second).reshape(-1, size).astype(np.float32),
        pair=np.concatenate(pair, axis=1),
        sd=np.tile(tolerance.sd, len(cameras)),
    )


def _moved(camera: Camera, b: FloatArray) -> Camera:
    """Return the camera after a motion (7,): moved in the sensor frame, turned about its centre."""
    lens = replace(
        camera.lens, fx_px=camera.lens.fx_px * (1.0 + b[6]), fy_px=camera.lens.fy_px * (1.0 + b[6])
    )
    return replace(
        camera,
        lens=lens,
        position_mm=camera.position_mm + b[:3],
        rotation=camera.rotation @ cv2.Rodrigues(b[3:6])[0].T,
    )
