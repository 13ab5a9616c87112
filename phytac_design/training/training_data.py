"""Data sets to learn from: read, held against the design, and shared out."""

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
    KeyNodeRows,
    Samples,
    key_nodes,
    split_sequences,
)
from phytac_design.datasets.samples_reader import read_samples
from phytac_design.datasets.samples_writer import TABLE, file_hash
from phytac_design.training.join_datasets import join_samples, select_samples
from phytac_design.training.levenberg_marquardt import KeyNodeData
from phytac_shapes.arrays import IntArray
from phytac_shapes.errors import InputError

SHARES = (0.85, 0.05, 0.10)
"""Training, validation and test (paper)."""
SAME_SHARE = 1e-4
"""Norms of K of one accuracy differ less, of two by percents."""
HEIGHT_MM = 1e-6
"""Heights of markers that are the same differ by less than this."""


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """A data set and where it came from.

    Attributes
    ----------
    folder : Path
        It was read from here.
    samples, meta : Samples, Meta
        What it holds.
    sha256 : str
        Of ``dataset.json``, which names the hash of all the rest.
    """

    folder: Path
    samples: Samples
    meta: DataSetInfo
    sha256: str

    @property
    def has_points(self) -> bool:
        """Whether all markers' shifts, the switches and the truth were kept."""
        s = self.samples
        parts = (s.shift_px, s.bits, s.bits_read, s.touches, s.truth)
        return all(part is not None for part in parts)

    def facts(self) -> dict[str, Any]:
        """What a reader should know of it, plain JSON."""
        return {
            "what": self.meta.what,
            "simulated": self.meta.simulated,
            "samples": self.samples.count,
            "failed": int((self.samples.status == FAILED).sum()),
            "sha256": self.sha256,
        }


@dataclass(frozen=True, kw_only=True)
class Part:
    """One part of the data.

    Attributes
    ----------
    count : int
        Samples of it.
    rows : KeyNodeData
        Inputs and outputs of the networks, of all its samples.
    samples : Samples or None
        Those whose points were kept, for trainers that need more than the networks' inputs.
    """

    count: int
    rows: KeyNodeData
    samples: Samples | None


def read_data_sets(folders: Sequence[Path], *, design_hash: str) -> list[DataSet]:
    """Read data sets of one design.

    Raises
    ------
    InputError
        If there are none, one cannot be read or is of another design, or a sample is there twice.
    """
    if not folders:
        raise InputError("no data set was given; name one or more folders of `phytac simulate`")
    sets: list[DataSet] = []
    for folder in folders:
        samples, meta = read_samples(folder, expect_design_hash=design_hash)
        item = DataSet(folder=folder, samples=samples, meta=meta, sha256=file_hash(folder / TABLE))
        for other in sets:
            if other.sha256 == item.sha256:
                raise InputError(
                    f"{folder} and {other.folder} are the same data set: a sample would be learnt "
                    "and judged, or counted twice; leave one of them out"
                )
            if shared := len(_marks(item.samples) & _marks(other.samples)):
                raise InputError(
                    f"{shared} samples of {folder} are in {other.folder} as well, and would be "
                    "learnt and judged, or counted twice; leave one of the two out, or make one "
                    "with another --seed"
                )
        sets.append(item)
    return sets


def _marks(samples: Samples) -> set[bytes]:
    """What samples that show anything are known by, to the bit.

    It is their markers' shifts; where these were not kept, the networks' inputs.
    """
    nodes = samples.key_nodes
    if samples.shift_px is not None:
        shows = np.any(np.nan_to_num(samples.shift_px) != 0.0, axis=(1, 2))
        return {row.tobytes() for row in samples.shift_px[shows]}
    if nodes is None:
        return set()
    first = np.flatnonzero(np.diff(nodes.sample)) + 1
    return {rows.tobytes() for rows in np.split(nodes.u_mm, first) if np.any(rows != 0.0)}


def bundle_hash(folder: Path) -> str:
    """SHA-256 of a decoder's two files together."""
    names = ("bundle.json", "bundle.safetensors")
    return sha256("".join(file_hash(folder / name) for name in names).encode()).hexdigest()


def check_inputs(item: DataSet, model: ForceModel, accuracy: str) -> None:
    """Refuse a data set that a model cannot learn from.

    Raises
    ------
    InputError
        If it holds neither points nor inputs, or inputs that another model's mechanics made.
    """
    if item.has_points:
        return
    nodes = item.samples.key_nodes
    if nodes is None:
        raise InputError(
            f"{item.folder} holds neither points nor the networks' inputs; make it again with "
            "--keep points or --keep inputs"
        )
    made = item.meta.notes.get("accuracy")
    if item.meta.simulated and made != accuracy:
        raise InputError(
            f"{item.folder} holds inputs of the networks that were made at accuracy {made}, the "
            f"decoder is trained at {accuracy}, whose K·u is another; add --accuracy {made}, or "
            "make the data with --keep points, which go with any"
        )
    if not item.meta.simulated:
        _check_mechanics(item, model)
    if not np.allclose(nodes.height_z_mm, model.height_z_mm, rtol=0.0, atol=HEIGHT_MM):
        raise InputError(
            f"{item.folder} holds inputs of the networks whose marker heights are not this "
            "design's; make it again with this version of the program"
        )


def _check_mechanics(item: DataSet, model: ForceModel) -> None:
    """Refuse inputs that were measured, if other mechanics made them."""
    made, ours = item.meta.notes.get("stiffness_size_N_mm"), model.stiffness_size_N_mm
    if isinstance(made, float) and abs(made - ours) <= SAME_SHARE * ours:
        return
    got = "which one is not said" if made is None else f"norm {made:.6g} N/mm, here {ours:.6g}"
    raise InputError(
        f"{item.folder} holds inputs of the networks by the K·u of another decoder ({got}); add "
        "--accuracy as that decoder was built with, or import with --keep points, which go with any"
    )


def rows_of(item: DataSet, model: ForceModel, noise_px: float) -> KeyNodeRows:
    """Inputs and outputs of the networks: made from the points, or as they were kept."""
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
) -> tuple[Part, Part, Part]:
    """Training, validation and test parts of all data sets together; sequences stay together.

    Parameters
    ----------
    sets : list of DataSet
        Of one design.
    model : ForceModel
        Of that design, without networks.
    noise_px : float
        Standard deviation of each coordinate of a centroid.
    seed : int
        Of the draw.
    limit : int, optional
        Use the first so many samples that did not fail.

    Raises
    ------
    InputError
        If there are fewer samples than that, or too few to share out, or no key node at all.
    """
    rows = [rows_of(item, model, noise_px) for item in sets]
    whole = join_samples(
        [replace(item.samples, key_nodes=r) for item, r in zip(sets, rows, strict=True)]
    )
    usable = np.flatnonzero(whole.status != FAILED)
    if limit is not None:
        if not 0 < limit <= len(usable):
            raise InputError(
                f"{limit} samples were asked for, the data hold {len(usable)} that did not fail; "
                "ask for fewer, or simulate more"
            )
        usable = usable[:limit]
    whole = select_samples(whole, usable)
    nodes = whole.key_nodes
    if nodes is None or len(nodes.sample) == 0:
        raise InputError(
            f"none of {len(usable)} samples has a switch that was read as on and whose marker was "
            "found: there is nothing to learn from; press harder, or on receptors"
        )
    if len(usable) < len(SHARES):
        raise InputError(
            f"{len(usable)} samples that did not fail cannot be shared out into training, "
            "validation and test; give more"
        )
    data = data_of(nodes)
    at = np.cumsum([0] + [item.samples.count for item in sets])
    parts = [
        Part(count=len(index), rows=data.take(index), samples=_points(sets, at, usable[index]))
        for index in split_sequences(whole, SHARES, seed=seed)
    ]
    return parts[0], parts[1], parts[2]


def data_of(rows: KeyNodeRows) -> KeyNodeData:
    """Rows of a data set as the networks' training takes them."""
    return KeyNodeData(
        features=rows.inputs_mm,
        apparent_mm=rows.u_mm[:, 0],
        stiffness_force_N=rows.stiffness_force_N,
        force_N=rows.force_N,
        sample=rows.sample,
    )


def _points(sets: Sequence[DataSet], at: IntArray, index: IntArray) -> Samples | None:
    """Samples of a part whose points were kept; None if there are none."""
    found = []
    for item, first in zip(sets, at[:-1].tolist(), strict=True):
        own = index[(index >= first) & (index < first + item.samples.count)] - first
        if item.has_points and len(own):
            found.append(select_samples(replace(item.samples, key_nodes=None), own))
    return join_samples(found) if found else None
