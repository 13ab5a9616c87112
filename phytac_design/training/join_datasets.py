"""Some samples of a data set, and several data sets as one."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from phytac_design.datasets.samples import KeyNodeRows, Samples, TouchRows, TruthRows
from phytac_shapes.arrays import BoolArray, IntArray
from phytac_shapes.errors import InputError

PER_SAMPLE = ("time_s", "sequence", "light", "status", "theory", "total_N", "contacts")
POINTS = ("bits", "bits_read", "shift_px")
TOUCH = (
    "sample", "uv", "point_mm", "radius_mm", "force_N", "indenter", "length_mm", "turn_rad",
    "friction",
)  # fmt: skip
TRUTH = ("sample", "marker", "force_N", "touch")
KEY = ("sample", "marker", "u_mm", "stiffness_force_N", "force_N")


def select_samples(samples: Samples, index: IntArray) -> Samples:
    """Some samples with all that belongs to them, renumbered from 0.

    Parameters
    ----------
    samples : Samples
        To choose from.
    index : (p,) int
        Samples to keep, growing.
    """
    new = np.full(samples.count, -1)
    new[index] = np.arange(len(index))
    told = new[samples.reason_sample] >= 0
    parts: dict[str, Any] = {name: getattr(samples, name)[index] for name in PER_SAMPLE}
    for name in POINTS:
        value = getattr(samples, name)
        parts[name] = None if value is None else value[index]
    touch_new = np.zeros(0, dtype=np.int64)
    if samples.touches is not None:
        keep = new[samples.touches.sample] >= 0
        parts["touches"] = _rows(samples.touches, TOUCH, keep, new)
        touch_new = np.where(keep, np.cumsum(keep) - 1, -1)
    if samples.truth is not None:
        truth = _rows(samples.truth, TRUTH, new[samples.truth.sample] >= 0, new)
        # -1, no contact, finds the -1 at the end.
        parts["truth"] = replace(truth, touch=np.append(touch_new, -1)[truth.touch])
    if samples.key_nodes is not None:
        nodes = samples.key_nodes
        parts["key_nodes"] = _rows(nodes, KEY, new[nodes.sample] >= 0, new)
    return replace(
        samples,
        reason_sample=new[samples.reason_sample[told]],
        reason_index=samples.reason_index[told],
        **parts,
    )


def _rows(rows: Any, names: Sequence[str], keep: BoolArray, new: IntArray) -> Any:
    """Rows of the samples that stay, with their new numbers."""
    kept = {name: getattr(rows, name)[keep] for name in names}
    return replace(rows, **kept | {"sample": new[kept["sample"]]})


def join_samples(sets: Sequence[Samples]) -> Samples:
    """Several data sets of one sensor as one; a part stays if all of them have it.

    Sequences are renumbered, so that no two sets share one.

    Raises
    ------
    InputError
        If there are none, or they are of sensors with different numbers of markers.
    """
    counts = sorted({samples.markers for samples in sets})
    if len(counts) != 1:
        raise InputError(
            f"data sets of sensors with {', '.join(map(str, counts)) or 'no'} markers cannot be "
            "joined; give one or more of the same design"
        )
    if len(sets) == 1:
        return sets[0]
    first = np.concatenate([[0], np.cumsum([samples.count for samples in sets])]).tolist()
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(samples, name) for samples in sets])
        for name in PER_SAMPLE
        if name != "sequence"
    }
    parts["sequence"] = _apart([samples.sequence for samples in sets])
    for name in POINTS:
        values = [getattr(samples, name) for samples in sets]
        complete = all(value is not None for value in values)
        parts[name] = np.concatenate(values) if complete else None
    reasons = sorted({text for samples in sets for text in samples.reasons})
    told = [
        np.array([reasons.index(text) for text in samples.reasons], dtype=np.int64)
        for samples in sets
    ]
    parts["reason_index"] = np.concatenate(
        [names[samples.reason_index] for names, samples in zip(told, sets, strict=True)]
    )
    parts["reason_sample"] = _shifted([samples.reason_sample for samples in sets], first)
    touches = [samples.touches for samples in sets]
    truths = [samples.truth for samples in sets]
    nodes = [samples.key_nodes for samples in sets]
    return Samples(
        markers=counts[0],
        reasons=tuple(reasons),
        touches=_joined(TouchRows, TOUCH, touches, first),
        truth=_joined(TruthRows, TRUTH, truths, first, touches),
        key_nodes=_joined(KeyNodeRows, KEY, nodes, first),
        **parts,
    )


def _shifted(parts: Sequence[IntArray], first: Sequence[int]) -> IntArray:
    pairs = zip(parts, first[: len(parts)], strict=True)
    return np.concatenate([part + start for part, start in pairs])


def _apart(sequences: Sequence[IntArray]) -> IntArray:
    """Numbers of sequences, counted on from set to set."""
    out, start = [], 0
    for sequence in sequences:
        groups, member = np.unique(sequence, return_inverse=True)
        out.append(member + start)
        start += len(groups)
    return np.concatenate(out)


def _joined(
    kind: Any,
    names: Sequence[str],
    parts: Sequence[Any],
    first: Sequence[int],
    touches: Sequence[Any] = (),
) -> Any:
    """Rows of all sets, or None if one lacks them."""
    if any(part is None for part in (*parts, *touches)):
        return None
    values = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    values["sample"] = _shifted([part.sample for part in parts], first)
    if kind is TruthRows:
        before = np.concatenate([[0], np.cumsum([len(rows.sample) for rows in touches])])
        values["touch"] = np.concatenate(
            [
                np.where(part.touch >= 0, part.touch + start, -1)
                for part, start in zip(parts, before[:-1].tolist(), strict=True)
            ]
        )
    if kind is KeyNodeRows:
        values["height_z_mm"] = parts[0].height_z_mm
        values["step_mm"] = min(part.step_mm for part in parts)
        values["step_N"] = min(part.step_N for part in parts)
    return kind(**values)
