"""Presses on a linear sensor: its own response to drawn forces, so that truth is known exactly."""

import numpy as np

from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.datasets.samples import DataSetInfo, Samples, TouchRows, truth_rows
from phytac_shapes.arrays import BoolArray, FloatArray


def meta_of(design: str, design_hash: str, **changes: object) -> DataSetInfo:
    """What such a set says of itself."""
    fields = {"what": "drawn for a test", "notes": {"accuracy": "draft"}} | changes
    return DataSetInfo(
        simulated=True, design=design, design_hash=design_hash, route="points", seed=0, **fields
    )


def presses(
    model: ForceModel,
    uv: FloatArray,
    *,
    count: int,
    seed: int,
    softer: float = 1.0,
    noise_px: float = 0.0,
    contacts_max: int = 3,
) -> Samples:
    """Samples of one to ``contacts_max`` contacts, each on one receptor of its own.

    ``softer``: the sensor moves as much under this many times less force than the model says.
    """
    rng = np.random.default_rng(seed)
    n = len(uv)
    number = rng.integers(1, contacts_max + 1, count)
    sample = np.repeat(np.arange(count), number)
    marker = np.concatenate([rng.choice(n, k, replace=False) for k in number])
    force = rng.uniform(0.6, 24.0, len(sample))
    receptor = np.zeros((count, n))
    receptor[sample, marker] = force
    owner = np.full((count, n), -1)
    owner[sample, marker] = np.arange(len(sample))
    shift = (receptor @ model.compliance_px.T).reshape(count, n, 2) * softer
    shift += rng.normal(0.0, 1.0, shift.shape) * noise_px
    bits: BoolArray = receptor > 0.0
    c = len(sample)
    return Samples(
        markers=n,
        time_s=np.arange(count, dtype=np.float64),
        sequence=np.arange(count),
        light=np.ones(count),
        status=np.zeros(count, dtype=np.int64),
        theory=np.ones(count, dtype=np.int64),
        total_N=receptor.sum(axis=1),
        contacts=number,
        bits=bits,
        bits_read=bits.copy(),
        shift_px=shift,
        touches=TouchRows(
            sample=sample,
            uv=uv[marker],
            point_mm=np.zeros((c, 3)),
            radius_mm=np.full(c, 4.0),
            force_N=force,
            indenter=np.zeros(c, dtype=np.int64),
            length_mm=np.zeros(c),
            turn_rad=np.zeros(c),
            friction=np.zeros((c, 2)),
        ),
        truth=truth_rows(bits, owner, receptor),
    )
