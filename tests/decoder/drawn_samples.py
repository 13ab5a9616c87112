"""Samples drawn at random, and what being the same means for them."""

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from phytac_design.datasets.samples import DataSetInfo, KeyNodeRows, Samples, TouchRows, TruthRows

SHIFT_STEP_PX = 2.0**-9

FORCE_STEP_N = 2.0**-10

META = DataSetInfo(
    simulated=True,
    what="Drawn at random for a test.",
    design="none",
    design_hash="ab" * 32,
    route="points",
    seed=3,
    hashes={"scenario": "cd" * 32},
    notes={"speed": 1.5, "names": ["a", "ü"]},
)


def drawn(seed: int, count: int = 7, markers: int = 9, *, keep: str = "all") -> Samples:
    """Samples that fit together, with numbers drawn at random."""
    rng = np.random.default_rng(seed)
    status = rng.integers(0, 3, count)
    flagged = np.flatnonzero(status)
    contacts = rng.integers(0, 4, count)
    owner_of = np.repeat(np.arange(count), contacts)
    c = len(owner_of)
    touches = TouchRows(
        sample=owner_of,
        uv=rng.normal(size=(c, 2)),
        point_mm=rng.normal(0.0, 30.0, (c, 3)),
        radius_mm=rng.uniform(0.0, 8.0, c),
        force_N=rng.uniform(0.0, 60.0, c),
        indenter=rng.integers(0, 3, c),
        length_mm=rng.uniform(0.0, 8.0, c),
        turn_rad=rng.normal(size=c),
        friction=rng.normal(size=(c, 2)),
    )
    bits = rng.random((count, markers)) < 0.3
    sample, marker = np.nonzero(bits)
    first = np.searchsorted(owner_of, sample)
    owned = (first < c) & (contacts[sample] > 0)
    truth = TruthRows(
        sample=sample,
        marker=marker,
        force_N=rng.uniform(0.0, 20.0, len(sample)),
        touch=np.where(owned, first, -1),
    )
    shift = rng.normal(0.0, 5.0, (count, markers, 2))
    shift[rng.random((count, markers)) < 0.1] = np.nan
    keys = np.flatnonzero(status[sample] != 2)
    nodes = KeyNodeRows(
        sample=sample[keys],
        marker=marker[keys],
        u_mm=rng.normal(0.0, 0.5, (len(keys), 9)),
        height_z_mm=rng.uniform(0.0, 120.0, markers),
        stiffness_force_N=rng.normal(0.0, 9.0, len(keys)),
        force_N=rng.uniform(0.0, 60.0, len(keys)),
        step_mm=2.0**-12,
        step_N=2.0**-4,
    )
    made = Samples(
        markers=markers,
        time_s=np.cumsum(rng.random(count)),
        sequence=rng.integers(0, max(count // 2, 1), count),
        light=rng.uniform(0.9, 1.0, count),
        status=status,
        theory=rng.integers(0, 4, count),
        total_N=np.bincount(owner_of, weights=touches.force_N, minlength=count).astype(np.float64),
        contacts=contacts,
        reasons=("too far", "not converged: ½ step"),
        reason_sample=np.repeat(flagged, 2),
        reason_index=np.tile([0, 1], len(flagged)),
        bits=bits,
        bits_read=rng.random((count, markers)) < 0.3,
        shift_px=shift,
        touches=touches,
        truth=truth,
        key_nodes=nodes,
    )
    points: dict[str, Any] = {"bits": None, "bits_read": None, "shift_px": None}
    if keep == "inputs":
        return replace(made, **points, touches=None, truth=None)
    return replace(made, key_nodes=None) if keep == "points" else made


TOLERANCE = {
    "shift_px": SHIFT_STEP_PX / 2,
    "u_mm": 2.0**-13,
    "stiffness_force_N": 2.0**-5,
    "total_N": 1e-5,
}


def assert_same(got: Any, expected: Any, *, exact: bool = False, keys: bool = False) -> None:
    """Equal, rounding of what is rounded apart."""
    for item in fields(expected):
        a, b = getattr(got, item.name), getattr(expected, item.name)
        if is_dataclass(b):
            assert_same(a, b, exact=exact, keys=item.name == "key_nodes")
        elif isinstance(b, np.ndarray):
            loose = TOLERANCE.get(item.name, FORCE_STEP_N / 2 if keys else 0.0)
            loose = 0.0 if exact or item.name == "height_z_mm" else loose
            assert a.dtype == b.dtype, item.name
            np.testing.assert_allclose(a, b, rtol=0.0, atol=loose, err_msg=item.name)
        else:
            assert a == b, item.name
