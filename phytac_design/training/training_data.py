"""Data sets for training: read, checked against the design, and split."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.datasets.samples import (
    FAILED,
    DataSetInfo,
    KeyNodeData,
    KeyNodeRows,
    Samples,
    key_nodes,
    split_sequences,
)
from phytac_design.datasets.samples_file import TABLE, file_hash, read_samples
from phytac_design.training.join_datasets import join_samples, select_samples
from phytac_shapes.arrays import IntArray
from phytac_shapes.errors import InputError

SHARES = (0.85, 0.05, 0.10)
"""Training, validation and test (paper)."""


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """A data set and its origin.

    Attributes
    ----------
    folder : Path
        Folder of the data set.
    samples, meta : Samples, DataSetInfo
        Its contents.
    sha256 : str
        Hash of ``dataset.json``, which contains the hashes of all other files.
    """

    folder: Path
    samples: Samples
    meta: DataSetInfo
    sha256: str

    @property
    def has_points(self) -> bool:
        """Whether the shifts of all markers, the switches and the truth are stored."""
        s = self.samples
        parts = (s.shift_px, s.bits, s.bits_read, s.touches, s.truth)
        return all(part is not None for part in parts)

    def facts(self) -> dict[str, Any]:
        """Return its provenance, plain JSON."""
        return {
            "what": self.meta.what,
            "simulated": self.meta.simulated,
            "samples": self.samples.count,
            "failed": int((self.samples.status == FAILED).sum()),
            "sha256": self.sha256,
        }


@dataclass(frozen=True, kw_only=True)
class SplitPart:
    """One part of the split data.

    Attributes
    ----------
    count : int
        Number of samples.
    rows : KeyNodeData
        Inputs and outputs of the networks.
    samples : Samples or None
        Samples with points, for trainers that need more than the networks' inputs.
    """

    count: int
    rows: KeyNodeData
    samples: Samples | None

    @property
    def has_points(self) -> bool:
        """Whether all of its samples have points."""
        return self.samples is not None and self.samples.count == self.count


def read_data_sets(folders: Sequence[Path], *, design_hash: str) -> list[DataSet]:
    """Read data sets of one design.

    Raises
    ------
    InputError
        If there are none, one cannot be read or is of another design, or a sample occurs twice.
    """
    if not folders:
        raise InputError(
            "data-set-missing",
            "no data set was given; name one or more folders of `phytac simulate`",
        )
    sets: list[DataSet] = []
    for folder in folders:
        samples, meta = read_samples(folder, expect_design_hash=design_hash)
        item = DataSet(folder=folder, samples=samples, meta=meta, sha256=file_hash(folder / TABLE))
        for other in sets:
            if other.sha256 == item.sha256:
                raise InputError(
                    "data-set-duplicate",
                    f"{folder} and {other.folder} are the same data set: samples would be used for "
                    "training and test, or counted twice; leave one of them out",
                )
            if shared := len(_sample_keys(item.samples) & _sample_keys(other.samples)):
                raise InputError(
                    "data-sets-overlap",
                    f"{shared} samples of {folder} are in {other.folder} as well, and would be "
                    "used for training and test, or counted twice; leave one of the two out, or "
                    "make one with another --seed",
                )
        sets.append(item)
    return sets


def _sample_keys(samples: Samples) -> set[bytes]:
    """Return the bytes of each sample's shifts, or of its network inputs without shifts.

    Samples whose numbers are all 0 are left out.
    """
    nodes = samples.key_nodes
    if samples.shift_px is not None:
        moved = np.any(np.nan_to_num(samples.shift_px) != 0.0, axis=(1, 2))
        return {row.tobytes() for row in samples.shift_px[moved]}
    if nodes is None:
        return set()
    first = np.flatnonzero(np.diff(nodes.sample)) + 1
    return {rows.tobytes() for rows in np.split(nodes.u_mm, first) if np.any(rows != 0.0)}


def bundle_hash(folder: Path) -> str:
    """Return the SHA-256 of a decoder's two files together."""
    names = ("bundle.json", "bundle.safetensors")
    return sha256("".join(file_hash(folder / name) for name in names).encode()).hexdigest()


def check_inputs(item: DataSet, model: ForceModel, accuracy: str) -> None:
    """Reject a data set that a model cannot be trained with.

    Raises
    ------
    InputError
        If it holds neither points nor inputs, or inputs of another model's mechanics.
    """
    if item.has_points:
        return
    nodes = item.samples.key_nodes
    if nodes is None:
        raise InputError(
            "data-set-without-inputs",
            f"{item.folder} holds neither points nor the networks' inputs; make it again with "
            "--keep points or --keep inputs",
        )
    made = item.meta.notes.get("accuracy")
    if item.meta.simulated and made != accuracy:
        raise InputError(
            "inputs-other-accuracy",
            f"{item.folder} holds inputs of the networks that were made at accuracy {made}, the "
            f"decoder is trained at {accuracy}, whose K·u is another; add --accuracy {made}, or "
            "make the data with --keep points, which suit any accuracy",
        )
    norm, ours = item.meta.notes.get("stiffness_size_N_mm"), model.stiffness_size_N_mm
    # Norms of K at one accuracy differ by less than 1e-4, at two by percents.
    same = isinstance(norm, float) and abs(norm - ours) <= 1e-4 * ours
    if not item.meta.simulated and not same:
        got = "unknown norm" if norm is None else f"norm {norm:.6g} N/mm, here {ours:.6g}"
        raise InputError(
            "inputs-other-decoder",
            f"{item.folder} holds inputs of the networks by the K·u of another decoder ({got}); "
            "add --accuracy as that decoder was built with, or import with --keep points, which "
            "suit any accuracy",
        )
    if not np.allclose(nodes.height_z_mm, model.height_z_mm, rtol=0.0, atol=1e-6):
        raise InputError(
            "inputs-other-heights",
            f"{item.folder} holds inputs of the networks whose marker heights are not this "
            "design's; make it again with this version of the program",
        )


def rows_of(item: DataSet, model: ForceModel, noise_px: float) -> KeyNodeRows:
    """Return inputs and outputs of the networks: from the points, or as stored."""
    kept = item.samples.key_nodes
    if kept is None or item.has_points:
        return key_nodes(model, item.samples, noise_px=noise_px)
    return kept


def split_data_sets(
    sets: Sequence[DataSet],
    model: ForceModel,
    *,
    noise_px: float,
    seed: int,
    limit: int | None = None,
) -> tuple[SplitPart, SplitPart, SplitPart]:
    """Split all data sets together into training, validation and test; sequences stay together.

    Parameters
    ----------
    sets : list of DataSet
        Data sets of one design.
    model : ForceModel
        Force model of that design, without networks.
    noise_px : float
        Standard deviation of each coordinate of a centroid.
    seed : int
        Seed of the draw.
    limit : int, optional
        Number of samples to use, the first ones that did not fail.

    Raises
    ------
    InputError
        If there are fewer samples than that, too few to split, or no key node.
    """
    rows = [rows_of(item, model, noise_px) for item in sets]
    whole = join_samples(
        [replace(item.samples, key_nodes=r) for item, r in zip(sets, rows, strict=True)]
    )
    usable = np.flatnonzero(whole.status != FAILED)
    if limit is not None:
        if not 0 < limit <= len(usable):
            raise InputError(
                "training-data-too-few",
                f"{limit} samples are wanted, the data hold {len(usable)} that did not fail; "
                "use fewer, or simulate more",
            )
        usable = usable[:limit]
    whole = select_samples(whole, usable)
    nodes = whole.key_nodes
    if nodes is None or len(nodes.sample) == 0:
        raise InputError(
            "no-switch-tripped",
            f"none of {len(usable)} samples has a switch that was read as on and whose marker was "
            "found: there is nothing to train with; press harder, or on receptors",
        )
    if len(usable) < len(SHARES):
        raise InputError(
            "training-data-too-few",
            f"{len(usable)} samples that did not fail cannot be split into training, "
            "validation and test; give more",
        )
    data = data_of(nodes)
    at = np.cumsum([0] + [item.samples.count for item in sets])
    parts = [
        SplitPart(count=len(index), rows=data.take(index), samples=_points(sets, at, usable[index]))
        for index in split_sequences(whole, SHARES, seed=seed)
    ]
    return parts[0], parts[1], parts[2]


def data_of(rows: KeyNodeRows) -> KeyNodeData:
    """Return rows of a data set in the form of the networks' training."""
    return KeyNodeData(
        features=rows.inputs_mm,
        apparent_mm=rows.u_mm[:, 0],
        stiffness_force_N=rows.stiffness_force_N,
        force_N=rows.force_N,
        sample=rows.sample,
    )


def _points(sets: Sequence[DataSet], at: IntArray, index: IntArray) -> Samples | None:
    """Return samples of a part with points; None without any."""
    found = []
    for item, first in zip(sets, at[:-1].tolist(), strict=True):
        own = index[(index >= first) & (index < first + item.samples.count)] - first
        if item.has_points and len(own):
            found.append(select_samples(replace(item.samples, key_nodes=None), own))
    return join_samples(found) if found else None
