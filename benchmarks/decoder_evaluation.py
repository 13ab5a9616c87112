"""Training decoders as ``phytac train`` does, and judging them as ``phytac evaluate`` does."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from benchmarks.decoder_bounds import MEAN_SIZE, Bounds, bounds, noise_of
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.design.accuracy import Preset
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder_stage import assemble_bundle, untrained_model
from phytac_design.stages.places_stage import uneven_wall_of
from phytac_design.training.evaluation.contact_scores import Bootstrap, interval_coverage
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts, decode_contacts
from phytac_design.training.evaluation.groups import Groups, contact_positions, groups_of
from phytac_design.training.fem_calibration import ReceptorSolver
from phytac_design.training.locator_calibration import matches_by_switch
from phytac_design.training.trainers import TRAINERS, TrainingTask
from phytac_design.training.training_data import DataSet, split_data_sets
from phytac_design.workflows.train_decoder import MECHANICS
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

LEARNT = ("fem_nn", "fem_nn_identity", "auto")
TRAINED = ("mechanics", *LEARNT)
"""Trainers: the mechanics first, then the estimators that learn."""


def mechanics(design: Design, accuracy: Preset) -> Context:
    """Context with the stages that a decoder is made from, built or from the cache."""
    return run_stages(
        design,
        select_stages(MECHANICS),
        accuracy=accuracy,
        seed=0,
        force=True,
        progress=lambda _: None,
    )[0]


def by_design(context: Context) -> Bundle:
    """Decoder of a design that has seen no data."""
    return assemble_bundle(context, untrained_model(context), {})


def train_decoder(
    context: Context,
    plain: Bundle,
    data: DataSet,
    *,
    names: Sequence[str] = TRAINED,
    start: Bundle | None = None,
    seed: int = 0,
    receptors: ReceptorSolver | None = None,
) -> tuple[Bundle, dict[str, dict[str, Any]]]:
    """Decoder that learnt from data: the trainers of ``phytac train``, its split 8.5 : 0.5 : 1.

    Without ``receptors`` large displacements are those of the tables.

    Returns
    -------
    bundle : Bundle
        The decoder.
    facts : dict
        Of each trainer, ``seconds`` and ``cpu_seconds`` among them.
    """
    parts = split_data_sets([data], plain.model, noise_px=plain.noise_centroid_px, seed=seed)
    bundle, facts = plain, {}
    for name, trainer in TRAINERS:
        if name not in names:
            continue
        begin, cpu = time.perf_counter(), time.process_time()
        task = TrainingTask(
            bundle=bundle,
            training=parts[0],
            validation=parts[1],
            test=parts[2],
            seed=seed,
            start=start if start is not None and name in start.model.networks else None,
            receptors=receptors,
            wall=partial(uneven_wall_of, context),
        )
        model, found = trainer(task)
        bundle = replace(bundle, model=model)
        facts[name] = found | {
            "seconds": time.perf_counter() - begin,
            "cpu_seconds": time.process_time() - cpu,
        }
    return bundle, facts


def locate_all(model: ForceModel, samples: Samples) -> list[ContactDetection | None]:
    """What ``auto`` finds in each sample, None for those that failed."""
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    return [
        model.contacts(shift, np.flatnonzero(bits)) if status != FAILED else None
        for shift, bits, status in zip(
            samples.shift_px, samples.bits_read, samples.status, strict=True
        )
    ]


SILENT_NEAR_MM = 5.0
"""Distance within which a contact that was found without a switch counts as a pressed one, or that
one's radius if larger."""


@dataclass(frozen=True, kw_only=True)
class Claims:
    """Contacts that ``auto`` found, beside what was pressed; arrays run over m matched ones.

    Attributes
    ----------
    touch : (m,) int
        Row of the contact that it is.
    force_N, sd_N, truth_N : (m,) float
        Found force, its standard deviation, and the truth.
    unmatched : int
        Contacts with a switch that was read which were found as two, or together with another.
    pressed_silent, found_silent : int
        Contacts that tripped no switch, in frames with one that is on, and those of them that
        were found all the same: within their radius, or :data:`SILENT_NEAR_MM`.
    claimed_silent : int
        Contacts found by motion alone.
    nothing_N, nothing_mm : (k,) float
        Force of those of them that are none of these, and how far off the nearest contact is
        that did trip a switch.
    """

    touch: IntArray
    force_N: FloatArray
    sd_N: FloatArray
    truth_N: FloatArray
    unmatched: int
    pressed_silent: int
    found_silent: int
    claimed_silent: int
    nothing_N: FloatArray
    nothing_mm: FloatArray

    @property
    def covered(self) -> float:
        """Share of truths within the intervals that claim 90 %."""
        return interval_coverage(self.force_N, self.sd_N, self.truth_N, level=0.9)


def claims_of(found: Sequence[ContactDetection | None], samples: Samples) -> Claims:
    """Match what was found to what was pressed: by switches, and where there is none by place."""
    touches, truth = samples.touches, samples.truth
    assert touches is not None
    assert truth is not None
    assert samples.bits_read is not None
    first = np.searchsorted(truth.sample, np.arange(samples.count + 1))
    start = np.searchsorted(touches.sample, np.arange(samples.count + 1))
    tripped = np.isin(np.arange(len(touches.sample)), truth.touch)
    rows: list[tuple[int, float, float]] = []
    unmatched, silent = 0, np.zeros(3, dtype=np.int64)
    nothing: list[tuple[float, float]] = []
    for sample, one in enumerate(found):
        if one is None or not samples.bits_read[sample].any():
            continue
        own = slice(first[sample], first[sample + 1])
        marker, owner = truth.marker[own], truth.touch[own]
        on = owner >= 0
        matched = [
            (touch, contact.force_N, contact.sd_N)
            for touch, contact in matches_by_switch(one, marker[on], owner[on])
        ]
        rows += matched
        read = np.unique(owner[samples.bits_read[sample, marker] & on])
        unmatched += int((~np.isin(read, [row[0] for row in matched])).sum())
        here = np.arange(start[sample], start[sample + 1])
        quiet = here[~tripped[here] & (touches.force_N[here] > 0.0)]
        reach = np.maximum(touches.radius_mm[quiet], SILENT_NEAR_MM)
        tripping = here[tripped[here]]
        counts, wrong = _silent(one, touches.point_mm[quiet], reach, touches.point_mm[tripping])
        silent += counts
        nothing += wrong
    touch = np.array([row[0] for row in rows], dtype=np.int64)
    return Claims(
        touch=touch,
        force_N=np.array([row[1] for row in rows]),
        sd_N=np.array([row[2] for row in rows]),
        truth_N=touches.force_N[touch],
        unmatched=unmatched,
        pressed_silent=int(silent[0]),
        found_silent=int(silent[1]),
        claimed_silent=int(silent[2]),
        nothing_N=np.array([force for force, _ in nothing]),
        nothing_mm=np.array([gap for _, gap in nothing]),
    )


def _silent(
    one: ContactDetection, quiet_mm: FloatArray, reach_mm: FloatArray, others_mm: FloatArray
) -> tuple[IntArray, list[tuple[float, float]]]:
    """What was found by motion alone in a sample.

    Parameters
    ----------
    one : Found
        What was found.
    quiet_mm, others_mm : (q, 3), (p, 3) float
        Contacts that tripped no switch, and those that did.
    reach_mm : (q,) float
        How far off the former are found.

    Returns
    -------
    counts : (3,) int
        Pressed without a switch, found of these, claimed by motion alone.
    nothing : list of (float, float)
        Force of each that was claimed where none of them is, and its distance from the others.
    """
    claimed = [c for c in one.contacts if len(c.markers) == 0]
    found, nothing = np.zeros(len(quiet_mm), dtype=np.bool_), []
    for contact in claimed:
        near = np.linalg.norm(quiet_mm - contact.point_mm, axis=1) <= reach_mm
        found |= near
        if not near.any():
            gap = np.linalg.norm(others_mm - contact.point_mm, axis=1).min(initial=np.inf)
            nothing.append((contact.force_N, float(gap)))
    return np.array([len(quiet_mm), found.sum(), len(claimed)]), nothing


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """A decoder judged on held-out samples.

    Attributes
    ----------
    data : DataSet
        The samples.
    decoded : Decoded
        Their contacts and what the estimators say of them.
    groups : dict
        Masks over these, see :func:`phytac_design.training.evaluation.groups.groups_of`.
    found : list
        What ``auto`` found in each sample.
    claims : Claims
        The same beside what was pressed.
    context : Context
        Of the decoder's mechanics.
    """

    data: DataSet
    decoded: DecodedContacts
    groups: Groups
    found: list[ContactDetection | None]
    claims: Claims
    context: Context

    def group(self, section: str, name: str) -> BoolArray:
        """Mask (c,); a name may be only begun. Empty for a group without contacts."""
        for known, mask in self.groups.get(section, {}).items():
            if known.startswith(name):
                return mask
        return np.zeros(len(self.decoded.sample), dtype=np.bool_)

    @cached_property
    def bootstrap(self) -> Bootstrap:
        """Draws of samples, the same for all estimators."""
        return Bootstrap(sample=self.decoded.sample, seed=0)

    def score(self, estimator: str, mask: BoolArray) -> dict[str, Any]:
        """Errors with intervals, see :meth:`Bootstrap.score`."""
        return self.bootstrap.score(self.decoded.decoded_N[estimator], self.decoded.force_N, mask)

    @cached_property
    def noise_px(self) -> FloatArray:
        """Noise (n, 2) of the data's shifts."""
        return noise_of(self.found, self.data.samples)

    @cached_property
    def bounds(self) -> Bounds:
        """Of the judged contacts, (c,)."""
        return bounds(self.context, self.data.samples, self.noise_px).pick(self.decoded.touch)

    def over_bound(self, mask: BoolArray) -> tuple[float, float, float]:
        """RMSE of ``auto`` over the RMS of the bound; that, N; RMSE over that of each alone."""
        least = _rms(self.bounds.force_N[mask])
        return self._rmse(mask) / least, least, self._rmse(mask) / _rms(self.bounds.alone_N[mask])

    def _rmse(self, mask: BoolArray) -> float:
        return _rms((self.decoded.decoded_N["auto"] - self.decoded.force_N)[mask])

    def typical(self, mask: BoolArray) -> float:
        """Median of |error| of ``auto`` over that of a normal error as large as the bound says."""
        error = (self.decoded.decoded_N["auto"] - self.decoded.force_N)[mask]
        return float(np.median(np.abs(error)) / np.median(0.6745 * self.bounds.force_N[mask]))

    def least_relative(self, mask: BoolArray) -> tuple[float, float]:
        """Least mean of |error| / force that the bound allows, and the median of bound / force."""
        share = self.bounds.force_N[mask] / self.decoded.force_N[mask]
        return MEAN_SIZE * float(share.mean()), float(np.median(share))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def evaluate_decoder(
    context: Context, model: ForceModel, data: DataSet, *, estimators: Sequence[str] | None = None
) -> Evaluation:
    """Judge a model on samples that it has not learnt from.

    Parameters
    ----------
    context : Context
        Of the decoder's mechanics, for heights and bounds.
    model : ForceModel
        With tables for ``auto``.
    data : DataSet
        With points.
    estimators : list of str, optional
        All that the model has if not given.
    """
    samples = data.samples
    assert samples.touches is not None
    decoded = decode_contacts(model, samples, estimators=estimators)
    where = contact_positions(context.design, samples.touches.uv[decoded.touch])
    found = locate_all(model, samples)
    return Evaluation(
        data=data,
        decoded=decoded,
        groups=groups_of([data], samples, decoded, where),
        found=found,
        claims=claims_of(found, samples),
        context=context,
    )
