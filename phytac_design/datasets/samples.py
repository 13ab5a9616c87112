"""Samples of a sensor, simulated or measured: what was pressed, what was seen, and the truth."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import network_features
from phytac_decoder.estimation.estimators import ForceModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError

STATUSES = ("ok", "flagged", "failed")
"""A flagged sample has its numbers and a reason to distrust them; a failed one has none."""
THEORIES = ("rest", "linear", "large", "real")
"""Where a sample's motion comes from; ``real`` is measured on a sensor."""
INDENTERS = ("flat", "sphere", "cylinder")
FAILED = STATUSES.index("failed")
REAL = THEORIES.index("real")
STEP_SHARE = 0.2
"""Largest step of stored inputs over their noise: rounding moves them by a tenth of it."""


@dataclass(frozen=True, kw_only=True)
class TouchRows:
    """Contacts; arrays run over c contacts, in the order of their samples.

    Attributes
    ----------
    sample : (c,) int
        Sample each contact belongs to.
    uv : (c, 2) float
        Centre, chart coordinates of the design's surface.
    point_mm : (c, 3) float
        Centre on the outer face, mm, sensor frame.
    radius_mm : (c,) float
        Radius of the contact; a cylinder's half-width. 0 where it was not measured.
    force_N : (c,) float
        Normal force, positive inward.
    indenter : (c,) int
        Index into ``INDENTERS``.
    length_mm : (c,) float
        Length of a cylinder's strip; 0 for the others.
    turn_rad : (c,) float
        A cylinder's axis: angle from the direction of growing u in the tangent plane,
        right-handed about the outward normal.
    friction : (c, 2) float
        Tangential over normal force, along growing u and square to it.
    """

    sample: IntArray
    uv: FloatArray
    point_mm: FloatArray
    radius_mm: FloatArray
    force_N: FloatArray
    indenter: IntArray
    length_mm: FloatArray
    turn_rad: FloatArray
    friction: FloatArray


@dataclass(frozen=True, kw_only=True)
class TruthRows:
    """Truth per receptor; one row per switch that is on, in the order of samples and markers.

    Attributes
    ----------
    sample, marker : (t,) int
        Which switch.
    force_N : (t,) float
        Share of its contact's force that the receptor carries; a contact's rows sum to its force.
    touch : (t,) int
        Row of the contact in :class:`TouchRows` that presses most on it; -1 where none does.
    """

    sample: IntArray
    marker: IntArray
    force_N: FloatArray
    touch: IntArray


@dataclass(frozen=True, kw_only=True)
class KeyNodeRows:
    """Inputs and outputs of the FEM-NN; one row per switch that was read as on.

    Attributes
    ----------
    sample, marker : (k,) int
        Which key node.
    u_mm : (k, 9) float
        Apparent inward displacement of the node and of its eight neighbours.
    height_z_mm : (n,) float
        The tenth input, of every marker.
    stiffness_force_N : (k,) float
        (K·U) at the node, what the FEM estimator alone says; the network adds k·u.
    force_N : (k,) float
        True force carried by the node.
    step_mm, step_N : float
        Largest steps at which ``u_mm`` and ``stiffness_force_N`` may be stored.
    """

    sample: IntArray
    marker: IntArray
    u_mm: FloatArray
    height_z_mm: FloatArray
    stiffness_force_N: FloatArray
    force_N: FloatArray
    step_mm: float
    step_N: float

    @property
    def inputs_mm(self) -> FloatArray:
        """The ten inputs (k, 10) of ``phytac_decoder.estimation.cascade_network.network_features``."""
        return np.column_stack([self.u_mm, self.height_z_mm[self.marker]])


@dataclass(frozen=True, kw_only=True)
class Samples:
    """A data set; arrays run over s samples, parts that were not kept are None.

    Attributes
    ----------
    markers : int
        Markers n of the sensor.
    time_s : (s,) float
        When each sample was taken.
    sequence : (s,) int
        Samples with a common history (one press) share a number; see :func:`split_sequences`.
    light : (s,) float
        Brightness of the light over that at the start; 1 where it was not measured.
    status, theory : (s,) int
        Index into ``STATUSES`` and ``THEORIES``.
    total_N : (s,) float
        Sum of the contacts' normal forces.
    contacts : (s,) int
        Contacts at once.
    reasons : tuple of str
        Sentences that say why samples are flagged or failed.
    reason_sample, reason_index : (r,) int
        Sample and sentence of each remark; every sample that is not ok has at least one.
    bits, bits_read : (s, n) bool or None
        Switches that were on, and those that were read as on.
    shift_px : (s, n, 2) float or None
        Marker shifts against rest, each in the image of the camera that reads the marker; NaN
        where a marker was not found.
    touches, truth, key_nodes : rows or None
        See :class:`TouchRows`, :class:`TruthRows`, :class:`KeyNodeRows`.
    """

    markers: int
    time_s: FloatArray
    sequence: IntArray
    light: FloatArray
    status: IntArray
    theory: IntArray
    total_N: FloatArray
    contacts: IntArray
    reasons: tuple[str, ...] = ()
    reason_sample: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    reason_index: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    bits: BoolArray | None = None
    bits_read: BoolArray | None = None
    shift_px: FloatArray | None = None
    touches: TouchRows | None = None
    truth: TruthRows | None = None
    key_nodes: KeyNodeRows | None = None

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.time_s)

    def why(self, sample: int) -> list[str]:
        """Why a sample is not ok, each as a sentence; empty for one that is."""
        return [self.reasons[i] for i in self.reason_index[self.reason_sample == sample]]

    def points(self) -> tuple[TouchRows, TruthRows, FloatArray, BoolArray]:
        """Contacts, truth, shifts and switches read, of samples that hold them.

        Raises
        ------
        InputError
            If one is missing.
        """
        touches, truth, shift, bits = self.touches, self.truth, self.shift_px, self.bits_read
        if touches is None or truth is None or shift is None or bits is None:
            raise InputError(
                "the samples hold no shifts, switches, contacts or truth; make them with --keep "
                "points"
            )
        return touches, truth, shift, bits


@dataclass(frozen=True, kw_only=True)
class DataSetInfo:
    """What a data set is and where it comes from.

    Attributes
    ----------
    simulated : bool
        Whether its numbers were computed; False for measurements of a real sensor.
    what : str
        One plain sentence that says what it is.
    design, design_hash : str
        Name of the design, and hash of the resolved design.
    route : str
        ``points`` or ``frames`` where simulated, ``camera`` where measured.
    seed : int or None
        Of everything random; None for measurements.
    hashes : dict of str
        SHA-256 of what it was made from, by name: scenario, unit, log, bundle, ….
    notes : dict
        Settings and figures of its making, plain JSON.
    frames : dict of str
        SHA-256 of each picture in ``frames/``, by file name; filled in when it is written.
    """

    simulated: bool
    what: str
    design: str
    design_hash: str
    route: str
    seed: int | None = None
    hashes: dict[str, str] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)


def truth_rows(bits: BoolArray, owner: IntArray, receptor_force_N: FloatArray) -> TruthRows:
    """Rows of the switches that are on, from full arrays (s, n) each.

    ``owner`` is the row of the contact that presses most on a switch, -1 where none does.
    """
    sample, marker = np.nonzero(bits)
    return TruthRows(
        sample=sample,
        marker=marker,
        force_N=receptor_force_N[sample, marker],
        touch=owner[sample, marker],
    )


def power_of_two_below(value: float) -> float:
    """Largest power of two that is not above a positive value: multiples of it are exact."""
    return float(2.0 ** np.floor(np.log2(value)))


def key_nodes(model: ForceModel, samples: Samples, *, noise_px: float) -> KeyNodeRows:
    """Inputs and outputs of the FEM-NN of samples whose points were kept (paper, eq. 2).

    A neighbour that was not found has u = 0, as in the decoder; a node that was not found has no
    row, and neither have failed samples.

    Parameters
    ----------
    model : ForceModel
        Of the sensor.
    samples : Samples
        With ``bits_read``, ``shift_px`` and ``truth``.
    noise_px : float
        Standard deviation of each coordinate of a centroid; steps of storage follow from it.
    """
    if samples.bits_read is None or samples.shift_px is None or samples.truth is None:
        raise InputError(
            "key_nodes: the samples hold no shifts, switches or truth; make them with keep='points'"
        )
    size = np.linalg.norm(model.shift_to_mm, axis=1)
    force_noise = noise_px * model.stiffness_noise_N_px
    force_noise = force_noise[(force_noise > 0.0) & np.isfinite(force_noise)]
    usable = samples.status != FAILED
    seen = np.isfinite(samples.shift_px).all(axis=2)
    on = samples.bits_read & usable[:, None] & seen
    truth = np.zeros(on.shape)
    np.add.at(truth, (samples.truth.sample, samples.truth.marker), samples.truth.force_N)
    sample, marker = np.nonzero(on)
    u, stiff = np.zeros((len(sample), 9)), np.zeros(len(sample))
    start = np.searchsorted(sample, np.arange(samples.count + 1))
    for s in np.unique(sample):
        rows = slice(start[s], start[s + 1])
        apparent = model.apparent_mm(np.nan_to_num(samples.shift_px[s]))
        koi = marker[rows]
        u[rows] = network_features(apparent, model.neighbours, model.height_z_mm, koi)[:, :9]
        stiff[rows] = model.stiffness[koi] @ apparent
    return KeyNodeRows(
        sample=sample,
        marker=marker,
        u_mm=u,
        height_z_mm=model.height_z_mm,
        stiffness_force_N=stiff,
        force_N=truth[sample, marker],
        step_mm=_step(noise_px * size[size > 0.0], 2.0**-13),
        step_N=_step(force_noise, 2.0**-7),
    )


def inputs_alone(samples: Samples, rows: KeyNodeRows) -> Samples:
    """Samples with the FEM-NN's inputs and outputs, without what they were made from."""
    return replace(
        samples,
        key_nodes=rows,
        bits=None,
        bits_read=None,
        shift_px=None,
        touches=None,
        truth=None,
    )


def _step(noise: FloatArray, otherwise: float) -> float:
    return power_of_two_below(STEP_SHARE * float(noise.min())) if len(noise) else otherwise


def split_sequences(samples: Samples, shares: Sequence[float], *, seed: int) -> list[IntArray]:
    """Samples shared out at random, sorted in each part; a sequence stays in one part.

    Failed samples are in none. Every part gets at least one sequence.

    Parameters
    ----------
    samples : Samples
        To share out.
    shares : sequence of float
        Share of each part, such as 0.85, 0.05, 0.10.
    seed : int
        Of the draw.

    Raises
    ------
    InputError
        If shares are not positive or do not sum to 1, or there are fewer sequences than parts.
    """
    wanted = np.asarray(shares, dtype=np.float64)
    if wanted.ndim != 1 or len(wanted) == 0 or not np.all(wanted > 0.0):
        raise InputError(f"split: shares must be positive numbers (got {list(shares)})")
    if abs(float(wanted.sum()) - 1.0) > 1e-9:
        raise InputError(f"split: shares must sum to 1 (got {wanted.sum():g}); correct one of them")
    usable = np.flatnonzero(samples.status != FAILED)
    groups, member, size = np.unique(
        samples.sequence[usable], return_inverse=True, return_counts=True
    )
    if len(groups) < len(wanted):
        raise InputError(
            f"split: {len(groups)} sequences cannot fill {len(wanted)} parts; a sequence stays in "
            "one part, so take more presses or fewer parts"
        )
    order = np.random.default_rng(seed).permutation(len(groups))
    part = np.zeros(len(groups), dtype=np.int64)
    left = wanted * len(usable)
    for number, group in enumerate(order):
        # The first sequences go one to each part, the others to where most is missing.
        chosen = number if number < len(wanted) else int(np.argmax(left))
        part[group] = chosen
        left[chosen] -= size[group]
    return [usable[part[member] == number] for number in range(len(wanted))]
