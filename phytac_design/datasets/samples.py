"""Samples of a sensor, simulated or measured: contacts, observations and true forces."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from phytac_decoder.estimation.cascade_network import Base, CascadeNetwork, network_features
from phytac_decoder.estimation.estimators import ForceModel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError

STATUSES = ("ok", "flagged", "failed")
"""A flagged sample has numbers and a reason to distrust them; a failed one has none."""
THEORIES = ("rest", "linear", "large", "real")
"""Origin of a sample's motion; ``real`` is measured on a sensor."""
FLAGGED, FAILED = STATUSES.index("flagged"), STATUSES.index("failed")
REAL = THEORIES.index("real")


@dataclass(frozen=True, kw_only=True)
class TouchRows:
    """Contacts; arrays run over c contacts, in the order of their samples.

    Attributes
    ----------
    sample : (c,) int
        Sample of each contact.
    uv : (c, 2) float
        Centre, chart coordinates of the design's surface.
    point_mm : (c, 3) float
        Centre on the outer face, mm, sensor frame.
    radius_mm : (c,) float
        Radius of the contact; a cylinder's half-width. 0 if unknown.
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
        The switch.
    force_N : (t,) float
        Share of its contact's force that the receptor carries; a contact's rows sum to its force.
    touch : (t,) int
        Row of the contact in :class:`TouchRows` with the largest force on it; -1 for none.
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
        The key node.
    u_mm : (k, 9) float
        Apparent inward displacement of the node and of its eight neighbours.
    height_z_mm : (n,) float
        The tenth input, of every marker.
    stiffness_force_N : (k,) float
        (K·U) at the node, the estimate of FEM alone; the network adds k·u.
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
        """The ten inputs (k, 10) of :func:`network_features`."""
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
        Brightness of the light over that at the start; 1 if unknown.
    status, theory : (s,) int
        Index into ``STATUSES`` and ``THEORIES``.
    total_N : (s,) float
        Sum of the contacts' normal forces.
    contacts : (s,) int
        Number of contacts.
    reasons : tuple of str
        Reasons why samples are flagged or failed.
    reason_sample, reason_index : (r,) int
        Sample and reason of each remark; every sample that is not ok has at least one.
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
        """Return the reasons why a sample is not ok."""
        return [self.reasons[i] for i in self.reason_index[self.reason_sample == sample]]

    def points(self) -> tuple[TouchRows, TruthRows, FloatArray, BoolArray]:
        """Return contacts, truth, shifts and switches read.

        Raises
        ------
        InputError
            If one is missing.
        """
        touches, truth, shift, bits = self.touches, self.truth, self.shift_px, self.bits_read
        if touches is None or truth is None or shift is None or bits is None:
            raise InputError(
                "samples-without-points",
                "the samples hold no shifts, switches, contacts or truth; make them with --keep "
                "points",
            )
        return touches, truth, shift, bits


@dataclass(frozen=True, kw_only=True)
class DataSetInfo:
    """Description and provenance of a data set.

    Attributes
    ----------
    simulated : bool
        Whether its numbers were computed; False for measurements of a real sensor.
    what : str
        Description, one sentence.
    design, design_hash : str
        Name of the design, and hash of the resolved design.
    route : str
        ``points`` or ``frames`` where simulated, ``camera`` where measured.
    seed : int or None
        Seed of everything random; None for measurements.
    hashes : dict of str
        SHA-256 of its inputs by name: scenario, unit, log, bundle, ….
    notes : dict
        Settings and figures, plain JSON.
    frames : dict of str
        SHA-256 of each image in ``frames/``, by file name; set when it is written.
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

    @property
    def rest_px(self) -> FloatArray | None:
        """Rest positions (n, 2) px of its print's markers, NaN where not found; None if unknown.

        Raises
        ------
        InputError
            If ``notes`` hold something else.
        """
        stored = self.notes.get("rest_px")
        if stored is None:
            return None
        try:
            pairs = [(np.nan, np.nan) if pair is None else pair for pair in stored]
            return np.array(pairs, dtype=np.float64).reshape(len(pairs), 2)
        except (TypeError, ValueError) as error:
            raise InputError(
                "data-set-table-invalid",
                f"{self.what}: notes.rest_px is no list of pairs of numbers ({error}); make the "
                "data set again",
            ) from None


def rest_note(rest_px: FloatArray) -> dict[str, Any]:
    """Return rest positions (n, 2) px as a note of a data set: they identify the print."""
    found = np.asarray(np.isfinite(rest_px).all(axis=1))
    pairs = np.round(rest_px, 3).tolist()
    return {"rest_px": [pair if seen else None for pair, seen in zip(pairs, found, strict=True)]}


def truth_rows(bits: BoolArray, owner: IntArray, receptor_force_N: FloatArray) -> TruthRows:
    """Return rows of the switches that are on, from full arrays (s, n).

    ``owner`` is the row of the contact with the largest force on a switch, -1 for none.
    """
    sample, marker = np.nonzero(bits)
    return TruthRows(
        sample=sample,
        marker=marker,
        force_N=receptor_force_N[sample, marker],
        touch=owner[sample, marker],
    )


def power_of_two_below(value: float) -> float:
    """Return the largest power of two up to a positive value; multiples of it are exact."""
    return float(2.0 ** np.floor(np.log2(value)))


@dataclass(frozen=True, kw_only=True)
class PressedNodes:
    """Key nodes that were found, of samples that did not fail, in order of the samples.

    Attributes
    ----------
    sample, marker : (k,) int
        Which ones.
    force_N : (k,) float
        True force on each.
    shift_px : (samples, n, 2) float
        Shifts of all markers.
    """

    sample: IntArray
    marker: IntArray
    force_N: FloatArray
    shift_px: FloatArray

    def by_sample(self) -> Iterator[tuple[slice, FloatArray, IntArray]]:
        """Yield each sample's rows, shifts (n, 2) and key nodes."""
        each, start, count = np.unique(self.sample, return_index=True, return_counts=True)
        for s, first, stop in zip(each, start, start + count, strict=True):
            yield slice(first, stop), self.shift_px[s], self.marker[first:stop]


def pressed_nodes(samples: Samples) -> PressedNodes:
    """Return the key nodes of samples with points and their true forces."""
    if samples.bits_read is None or samples.shift_px is None or samples.truth is None:
        raise InputError(
            "samples-without-points",
            "key_nodes: the samples hold no shifts, switches or truth; make them with "
            "keep='points'",
        )
    seen = np.isfinite(samples.shift_px).all(axis=2)
    on = samples.bits_read & (samples.status != FAILED)[:, None] & seen
    truth = np.zeros(on.shape)
    np.add.at(truth, (samples.truth.sample, samples.truth.marker), samples.truth.force_N)
    sample, marker = np.nonzero(on)
    return PressedNodes(
        sample=sample, marker=marker, force_N=truth[sample, marker], shift_px=samples.shift_px
    )


def key_nodes(
    model: ForceModel, samples: Samples, *, noise_px: float, base: Base = "stiffness"
) -> KeyNodeRows:
    """Return inputs and outputs of the FEM-NN of samples with points (paper, eq. 2).

    A neighbour that was not found has u = 0, as in the decoder; a node that was not found has no
    row, and neither have failed samples.

    Parameters
    ----------
    model : ForceModel
        Force model of the sensor.
    samples : Samples
        With ``bits_read``, ``shift_px`` and ``truth``.
    noise_px : float
        Standard deviation of each coordinate of a centroid; it sets the steps of storage.
    base : str
        Force that stands in ``stiffness_force_N``, see :class:`.CascadeNetwork`.
    """
    nodes = pressed_nodes(samples)
    size = np.linalg.norm(model.shift_to_mm, axis=1)
    force_noise = noise_px * model.stiffness_noise_N_px
    force_noise = force_noise[(force_noise > 0.0) & np.isfinite(force_noise)]
    u, stiff = np.zeros((len(nodes.sample), 9)), np.zeros(len(nodes.sample))
    for rows, shift_px, koi in nodes.by_sample():
        apparent = model.pressed_mm(shift_px, koi)
        u[rows] = network_features(apparent, model.neighbours, model.height_z_mm, koi)[:, :9]
        stiff[rows] = model.base_forces(base, shift_px, apparent, koi)
    return KeyNodeRows(
        sample=nodes.sample,
        marker=nodes.marker,
        u_mm=u,
        height_z_mm=model.height_z_mm,
        stiffness_force_N=stiff,
        force_N=nodes.force_N,
        step_mm=_step(noise_px * size[size > 0.0], 2.0**-13),
        step_N=_step(force_noise, 2.0**-7),
    )


def inputs_alone(samples: Samples, rows: KeyNodeRows) -> Samples:
    """Return samples with the FEM-NN's inputs and outputs, without points and contacts."""
    points: dict[str, Any] = dict.fromkeys(("bits", "bits_read", "shift_px", "touches", "truth"))
    return replace(samples, key_nodes=rows, **points)


def _step(noise: FloatArray, default: float) -> float:
    # Rounding to a fifth of the noise changes the numbers by a tenth of it.
    return power_of_two_below(0.2 * float(noise.min())) if len(noise) else default


def split_sequences(samples: Samples, shares: Sequence[float], *, seed: int) -> list[IntArray]:
    """Split samples at random, sorted in each part; a sequence stays in one part.

    Failed samples are left out. Every part gets at least one sequence.

    Parameters
    ----------
    samples : Samples
        Samples to split.
    shares : sequence of float
        Share of each part, such as 0.85, 0.05, 0.10.
    seed : int
        Seed of the draw.

    Raises
    ------
    InputError
        If shares are not positive or do not sum to 1, or there are fewer sequences than parts.
    """
    wanted = np.asarray(shares, dtype=np.float64)
    if wanted.ndim != 1 or len(wanted) == 0 or not np.all(wanted > 0.0):
        raise InputError(
            "split-shares-invalid", f"split: shares must be positive numbers (got {list(shares)})"
        )
    if abs(float(wanted.sum()) - 1.0) > 1e-9:
        raise InputError(
            "split-shares-invalid",
            f"split: shares must sum to 1 (got {wanted.sum():g}); correct one of them",
        )
    usable = np.flatnonzero(samples.status != FAILED)
    groups, member, size = np.unique(
        samples.sequence[usable], return_inverse=True, return_counts=True
    )
    if len(groups) < len(wanted):
        raise InputError(
            "split-sequences-too-few",
            f"split: {len(groups)} sequences cannot fill {len(wanted)} parts; a sequence stays in "
            "one part, so take more presses or fewer parts",
        )
    order = np.random.default_rng(seed).permutation(len(groups))
    part = np.zeros(len(groups), dtype=np.int64)
    missing = wanted * len(usable)
    for number, group in enumerate(order):
        # One sequence for each part first, then to the part that lacks most.
        chosen = number if number < len(wanted) else int(np.argmax(missing))
        part[group] = chosen
        missing[chosen] -= size[group]
    return [usable[part[member] == number] for number in range(len(wanted))]


@dataclass(frozen=True, kw_only=True)
class KeyNodeData:
    """One row per key node of interest (a marker whose switch is on).

    Attributes
    ----------
    features : (m, 10) float
        u of the node and its eight neighbours (mm), z (mm); see ``network_features``.
    apparent_mm : (m,) float
        u of the node itself.
    stiffness_force_N : (m,) float
        (K·U) at the node, or another base that the network adds to.
    force_N : (m,) float
        True force carried by the node.
    sample : (m,) int
        Sample the row belongs to.
    """

    features: FloatArray
    apparent_mm: FloatArray
    stiffness_force_N: FloatArray
    force_N: FloatArray
    sample: IntArray

    def take(self, samples: IntArray) -> "KeyNodeData":
        """Return the rows of some samples."""
        keep = np.isin(self.sample, samples)
        return KeyNodeData(
            **{field.name: getattr(self, field.name)[keep] for field in fields(self)}
        )

    def rmse_N(self, network: CascadeNetwork) -> float:
        """Return the force error (root mean square) of a network; NaN without rows."""
        stiffness = network(self.features)
        error = self.stiffness_force_N + stiffness * self.apparent_mm - self.force_N
        return float(np.sqrt((error**2).mean())) if len(error) else float("nan")
