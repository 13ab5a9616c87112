"""Samples of a print of the flat sensor in closed form, stiffer than designed and noisy."""

from collections.abc import Callable

import numpy as np

from phytac_design.datasets.samples import Samples, TouchRows, truth_rows
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import MARKERS, shifts

STIFFNESS = 1.15
NOISE_PX = 0.03
PLACE_MM = 0.8


def pressed(
    count: int,
    *,
    seed: int,
    slope: float = 0.0,
    gain: FloatArray | None = None,
    noise: FloatArray | float = NOISE_PX,
    uneven: Callable[[FloatArray], FloatArray] | None = None,
) -> Samples:
    """One or two contacts a sample on a sensor that is stiffer, and the more so along x.

    Its markers show motion by ``1 + gain`` (n, 2, 2), with noise (n, 1) px; of a contact at a
    point (3,) by ``1 + uneven(point)`` (n,) besides.
    """
    rng = np.random.default_rng(seed)
    n = len(MARKERS)
    bits = np.zeros((count, n), dtype=np.bool_)
    owner = np.full((count, n), -1)
    carried = np.zeros((count, n))
    shift = np.zeros((count, 2 * n))
    rows: list[tuple[int, FloatArray, float, float]] = []
    for sample in range(count):
        pressed: list[tuple[FloatArray, float, FloatArray]] = []
        far_apart = [int(rng.integers(0, 40)), int(rng.integers(60, 100))]
        for marker in far_apart[: 1 + sample % 2]:
            at = MARKERS[marker] + np.append(rng.normal(0.0, PLACE_MM, 2), 0.0)
            radius, force = rng.uniform(4.0, 6.0), rng.uniform(0.5, 25.0)
            moments = np.array([radius**2 / 4.0, 0.0, radius**2 / 4.0])
            stiff = STIFFNESS * (1.0 + slope * (at[0] - 30.0) / 30.0)
            pressed.append((at, force / stiff, moments))
            bits[sample, marker], owner[sample, marker] = True, len(rows)
            carried[sample, marker] = force
            rows.append((sample, at, radius, force))
        for at, force, moments in pressed:
            one = shifts(at, force, moments)
            more = np.zeros(n) if uneven is None else uneven(at)
            shift[sample] += np.repeat(1.0 + more, 2) * one
    shown = shift.reshape(count, n, 2)
    if gain is not None:
        shown = shown + np.einsum("kab,skb->ska", gain, shown)
    shown = shown + noise * rng.normal(size=shown.shape)
    of, at_mm, radii, forces = (np.array(column) for column in zip(*rows, strict=True))
    zeros = np.zeros(len(rows))
    return Samples(
        markers=n,
        time_s=np.arange(count, dtype=np.float64),
        sequence=np.arange(count),
        light=np.ones(count),
        status=np.zeros(count, dtype=np.int64),
        theory=np.zeros(count, dtype=np.int64),
        total_N=carried.sum(axis=1),
        contacts=np.bincount(of, minlength=count),
        bits=bits,
        bits_read=bits,
        shift_px=shown,
        touches=TouchRows(
            sample=of,
            uv=at_mm[:, :2],
            point_mm=at_mm,
            radius_mm=radii,
            force_N=forces,
            indenter=np.zeros(len(rows), dtype=np.int64),
            length_mm=zeros,
            turn_rad=zeros,
            friction=np.zeros((len(rows), 2)),
        ),
        truth=truth_rows(bits, owner, carried),
    )
