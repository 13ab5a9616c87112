"""Selecting samples of a data set, and joining several data sets."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from phytac_design.datasets.samples import KeyNodeRows, Samples, TruthRows
from phytac_design.datasets.samples_file import names_of
from phytac_shapes.arrays import BoolArray, IntArray
from phytac_shapes.errors import InputError

PER_SAMPLE = [name for name in names_of(["samples"]) if not name.startswith("reason_")]
POINTS = names_of(["points"])
ROWS = ("touches", "truth", "key_nodes")
"""Parts with rows of their own, each with its sample."""
SHARED = ("height_z_mm", "step_mm", "step_N")
"""Fields of key nodes that are not rows."""


def _names(rows: Any) -> list[str]:
    return [field.name for field in fields(rows) if field.name not in SHARED]


def select_samples(samples: Samples, index: IntArray) -> Samples:
    """Return some samples with everything that belongs to them, renumbered from 0.

    Parameters
    ----------
    samples : Samples
        Samples to select from.
    index : (p,) int
        Samples to keep, ascending.
    """
    new = np.full(samples.count, -1)
    new[index] = np.arange(len(index))

    def selected(rows: Any, keep: BoolArray) -> Any:
        kept = {name: getattr(rows, name)[keep] for name in _names(rows)}
        return replace(rows, **kept | {"sample": new[kept["sample"]]})

    parts: dict[str, Any] = {name: getattr(samples, name)[index] for name in PER_SAMPLE}
    for name in POINTS:
        value = getattr(samples, name)
        parts[name] = None if value is None else value[index]
    for name in ROWS:
        rows = getattr(samples, name)
        parts[name] = None if rows is None else selected(rows, new[rows.sample] >= 0)
    if samples.truth is not None:
        new_touch = np.zeros(0, dtype=np.int64)
        if samples.touches is not None:
            keep = new[samples.touches.sample] >= 0
            new_touch = np.where(keep, np.cumsum(keep) - 1, -1)
        # -1, no contact, selects the -1 at the end.
        touch = np.append(new_touch, -1)[parts["truth"].touch]
        parts["truth"] = replace(parts["truth"], touch=touch)
    remarks = new[samples.reason_sample] >= 0
    return replace(
        samples,
        reason_sample=new[samples.reason_sample[remarks]],
        reason_index=samples.reason_index[remarks],
        **parts,
    )


def join_samples(sets: Sequence[Samples]) -> Samples:
    """Join data sets of one sensor; a part is kept if all of them have it.

    Sequences are renumbered, so that no two sets share one.

    Raises
    ------
    InputError
        If there are none, or they are of sensors with different numbers of markers.
    """
    counts = sorted({samples.markers for samples in sets})
    if len(counts) != 1:
        raise InputError(
            "data-sets-marker-count",
            f"data sets of sensors with {', '.join(map(str, counts)) or 'no'} markers cannot be "
            "joined; give one or more of the same design",
        )
    if len(sets) == 1:
        return sets[0]
    sequences = [np.unique(samples.sequence, return_inverse=True) for samples in sets]
    reasons = sorted({text for samples in sets for text in samples.reasons})
    indices = [
        np.array([reasons.index(text) for text in samples.reasons], dtype=np.int64)
        for samples in sets
    ]
    first = _starts([samples.count for samples in sets])
    parts: dict[str, Any] = {
        name: np.concatenate([getattr(samples, name) for samples in sets]) for name in PER_SAMPLE
    }
    parts["sequence"] = _shifted(
        [member for _, member in sequences], _starts([len(names) for names, _ in sequences])
    )
    parts["reason_index"] = np.concatenate(
        [index[samples.reason_index] for index, samples in zip(indices, sets, strict=True)]
    )
    parts["reason_sample"] = _shifted([samples.reason_sample for samples in sets], first)
    for name in POINTS:
        values = [getattr(samples, name) for samples in sets]
        parts[name] = None if any(value is None for value in values) else np.concatenate(values)
    touches = [samples.touches for samples in sets]
    for name in ROWS:
        rows = [getattr(samples, name) for samples in sets]
        needed = [*rows, *touches] if name == "truth" else rows
        parts[name] = None
        if all(part is not None for part in needed):
            parts[name] = _joined_rows(rows, first, [len(part.sample) for part in touches if part])
    return Samples(markers=counts[0], reasons=tuple(reasons), **parts)


def _joined_rows(rows: Sequence[Any], first: Sequence[int], touches: Sequence[int]) -> Any:
    """Join rows of all sets; ``touches`` are the numbers of their contacts."""
    values = {
        name: np.concatenate([getattr(part, name) for part in rows]) for name in _names(rows[0])
    }
    values["sample"] = _shifted([part.sample for part in rows], first)
    if isinstance(rows[0], TruthRows):
        touch = _shifted([part.touch for part in rows], _starts(touches))
        values["touch"] = np.where(values["touch"] >= 0, touch, -1)
    if isinstance(rows[0], KeyNodeRows):
        values["step_mm"] = min(part.step_mm for part in rows)
        values["step_N"] = min(part.step_N for part in rows)
    return replace(rows[0], **values)


def _starts(counts: Sequence[int]) -> list[int]:
    return [sum(counts[:number]) for number in range(len(counts))]


def _shifted(parts: Sequence[IntArray], first: Sequence[int]) -> IntArray:
    return np.concatenate([part + start for part, start in zip(parts, first, strict=True)])
