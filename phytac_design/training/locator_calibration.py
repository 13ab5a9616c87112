"""What one sensor's own samples tell its locator: stiffness, priors, noise, correction, spread."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.estimation.contact_fit import ContactPrior, ShiftNoise
from phytac_decoder.estimation.force_correction import ForceCorrection, fit_correction
from phytac_decoder.estimation.locator import ContactLocator
from phytac_design.datasets.samples import FAILED, Samples, TouchRows
from phytac_design.training.marker_gain import (
    CrossValidationFold,
    apply_gain,
    cross_validation_folds,
    estimate_marker_noise,
    fit_gains,
    predict_residuals,
)
from phytac_design.training.stiffness_field import StiffnessField
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

SCALE_SAMPLES = 100
"""Samples that stiffness and noise are found with; more change them by less than their spread."""
FIRST_SAMPLES, SCALE_ROUNDS = 50, 2
"""Samples and rounds of a first look; gains of markers make up for what is left."""
PLACE_LEAST_MM = 0.3
"""No place is known better beforehand."""
WORSE = 1.05
"""Left-out forces that scatter by so much more say that few samples told unevenness wrong."""
PARTS = 10
"""Of the samples: each is read with gains that the others told."""
NOISE_CHANGE = (0.25, 4.0)
CORRECTION_LEAST = 10
"""Fewer contacts tell a stiffness, and no more."""
FLAT, SPHERE, CYLINDER = range(3)


@dataclass(frozen=True, kw_only=True)
class ContactMatches:
    """Contacts found, beside those that were pressed; arrays run over c contacts.

    Attributes
    ----------
    touch : (c,) int
        Row of the contact in the samples' touches.
    point_mm : (c, 3) float
        Where it was found.
    force_N, sd_N : (c,) float
        As found, before correction.
    signal_px : (c,) float
        Shift of all markers together, px per newton.
    truth_N : (c,) float
        As pressed.
    misfit : (s,) float
        Of each sample.
    """

    touch: IntArray
    point_mm: FloatArray
    force_N: FloatArray
    sd_N: FloatArray
    signal_px: FloatArray
    truth_N: FloatArray
    misfit: FloatArray


def match_contacts(locator: ContactLocator, samples: Samples, chosen: IntArray) -> ContactMatches:
    """Find contacts in samples (k,), and match them to what was pressed by the switches tripped.

    A contact that was found as two, or two that were found as one, are no match.
    """
    touches, truth, shift, bits = samples.points()
    start = np.searchsorted(truth.sample, np.arange(samples.count + 1))
    rows: list[tuple[int, LocatedContact]] = []
    misfit = []
    for sample in chosen:
        koi = np.flatnonzero(bits[sample])
        if samples.status[sample] == FAILED or len(koi) == 0:
            continue
        found = locator.find(shift[sample], koi)
        misfit.append(found.misfit)
        own = slice(start[sample], start[sample + 1])
        rows += _matched(found, truth.marker[own], truth.touch[own])
    if not rows:
        raise InputError(
            "no contact of the samples tripped a switch that was found again; give samples with "
            "stronger contacts"
        )
    index = np.array([touch for touch, _ in rows], dtype=np.int64)
    contacts = [contact for _, contact in rows]
    return ContactMatches(
        touch=index,
        point_mm=np.stack([contact.point_mm for contact in contacts]),
        force_N=np.array([contact.raw_N for contact in contacts]),
        sd_N=np.array([contact.raw_sd_N for contact in contacts]),
        signal_px=np.array([contact.signal_px for contact in contacts]),
        truth_N=touches.force_N[index],
        misfit=np.array(misfit),
    )


def _matched(
    found: ContactDetection, marker: IntArray, touch: IntArray
) -> list[tuple[int, LocatedContact]]:
    out = []
    for contact in found.contacts:
        pressed = np.unique(touch[np.isin(marker, contact.markers)])
        if len(pressed) != 1 or pressed[0] < 0:
            continue
        others = [c for c in found.contacts if c is not contact]
        mine = marker[touch == pressed[0]]
        if any(np.isin(c.markers, mine).any() for c in others):
            continue
        out.append((int(pressed[0]), contact))
    return out


def calibrate_locator(
    locator: ContactLocator,
    samples: Samples,
    chosen: IntArray,
    *,
    force_max_N: float,
    seed: int = 0,
) -> tuple[ContactLocator, dict[str, Any]]:
    """A locator that knows its sensor, and what it learnt, as figures.

    Parameters
    ----------
    locator : Locator
        By design alone.
    samples : Samples
        Of the sensor.
    chosen : (k,) int
        Samples to learn from; those with contacts alone count.
    force_max_N : float
        Greatest force it is meant for.
    seed : int
        Of the draw of those that stiffness and noise are found with.

    Raises
    ------
    InputError
        If the samples hold no contacts that are found again.
    """
    few = chosen
    if len(chosen) > SCALE_SAMPLES:
        few = np.random.default_rng(seed).permutation(chosen)[:SCALE_SAMPLES]
    plain = replace(locator, correction=None, prior=learnt_prior(locator, samples, chosen))
    plain, first = _scaled(plain, samples, few[:FIRST_SAMPLES], rounds=SCALE_ROUNDS)
    seen, pressed = predict_residuals(plain, samples, chosen, _moments(plain, samples))
    gain, parts, design = (
        fit_gains(seen),
        cross_validation_folds(seen, PARTS, samples.sequence[chosen]),
        plain.places,
    )
    noise = _noise(plain.noise, *estimate_marker_noise(seen, parts))
    uneven = StiffnessField(seen, parts, pressed, design, noise)
    plain = replace(plain, noise=noise)
    again = _left_out(plain, uneven, 1.0, parts, samples, chosen, few)
    if len(chosen) <= SCALE_SAMPLES:
        even = _left_out(plain, uneven.silenced(), 1.0, parts, samples, chosen, few)
        if _scatter(again) > WORSE * _scatter(even):
            uneven, again = uneven.silenced(), even
    plain = replace(plain, places=apply_gain(uneven.told(), gain))
    plain, second = _rescaled(plain, again)
    matches = _left_out(plain, uneven, second, parts, samples, chosen, chosen)
    box = plain.position_mm
    empty = ForceCorrection.plain(
        low_mm=box.min(axis=0),
        size_mm=max(float(np.ptp(box, axis=0).max()), 1e-9),
        force_max_N=force_max_N,
    )
    correction = empty
    if len(matches.force_N) >= CORRECTION_LEAST:
        correction = fit_correction(
            empty,
            point_mm=matches.point_mm,
            force_N=matches.force_N,
            signal_px=matches.signal_px,
            sd_N=matches.sd_N,
            truth_N=matches.truth_N,
            block=_blocks(samples, matches.touch),
        )
    facts = {
        "contacts": len(matches.force_N),
        "stiffness": first * second,
        "gain": float(np.sqrt(np.mean(gain**2))),
        "uneven": uneven.speaks,
        "noise_px": plain.noise.centroid_px,
        "switched_px": plain.noise.switched_px,
        "place_mm": plain.prior.place_mm,
        "spread": correction.spread,
        "spread_share": correction.spread_share,
    }
    return replace(plain, correction=correction), facts


def _blocks(samples: Samples, touch: IntArray) -> IntArray:
    """What contacts (c,) are left out together: those of a sequence of several samples."""
    touches, *_ = samples.points()
    sample = touches.sample[touch]
    sequence, count = np.unique(samples.sequence, return_counts=True)
    several = np.isin(samples.sequence[sample], sequence[count > 1])
    alone = -1 - np.arange(len(touch))
    return np.where(several, samples.sequence[sample], alone)


def _scaled(
    plain: ContactLocator, samples: Samples, chosen: IntArray, *, rounds: int
) -> tuple[ContactLocator, float]:
    """Locator as stiff and as noisy as samples (k,) say, and its stiffness over the one given."""
    stiffness = 1.0
    for _ in range(rounds):
        plain, factor = _rescaled(plain, match_contacts(plain, samples, chosen))
        stiffness *= factor
    return plain, stiffness


def _rescaled(plain: ContactLocator, matches: ContactMatches) -> tuple[ContactLocator, float]:
    """The same by contacts that were found."""
    factor = weighted_median(matches.truth_N / matches.force_N, matches.force_N / matches.sd_N)
    change = float(np.clip(np.sqrt(np.median(matches.misfit)), *NOISE_CHANGE))
    noise = replace(plain.noise, centroid_px=plain.noise.centroid_px * change)
    return replace(plain, places=plain.places.scaled(factor), noise=noise), factor


def _scatter(matches: ContactMatches) -> float:
    """Mean of how far found forces are from the truth, over it, but for what all are off."""
    ratio = matches.force_N / matches.truth_N
    return float(np.mean(np.abs(ratio / np.median(ratio) - 1.0)))


def _moments(plain: ContactLocator, samples: Samples) -> FloatArray:
    """Second moments (c, 3) mm² of all contacts less the disc's; of unknown ones the usual."""
    touches, *_ = samples.points()
    moments = np.tile(plain.prior.moments_mm2, (len(touches.force_N), 1))
    sized = np.flatnonzero(touches.radius_mm > 0.0)
    moments[sized] = _moments_over_disc(plain, touches, sized)
    return moments


def _noise(before: ShiftNoise, each_px: FloatArray, switched_px: float | None) -> ShiftNoise:
    """Noise of each marker, and of those whose switch is on."""
    usual = float(np.sqrt(np.mean(each_px**2)))
    return replace(
        before,
        centroid_px=usual,
        ratio=each_px / usual,
        switched_px=before.switched_px if switched_px is None else switched_px,
    )


def _left_out(
    plain: ContactLocator,
    uneven: StiffnessField,
    stiffness: float,
    parts: list[CrossValidationFold],
    samples: Samples,
    chosen: IntArray,
    within: IntArray,
) -> ContactMatches:
    """Contacts of samples (m,) among those chosen, each found with tables that others told."""
    found = []
    for number, part in enumerate(parts):
        rows = part.rows & np.isin(chosen, within)
        own = apply_gain(uneven.told(without=number).scaled(stiffness), part.gain)
        others = replace(plain, places=own)
        with suppress(InputError):  # none of a few samples may be found again
            found.append(match_contacts(others, samples, chosen[rows]))
    if not found:
        return match_contacts(plain, samples, within)
    columns = {
        f.name: np.concatenate([getattr(m, f.name) for m in found]) for f in fields(ContactMatches)
    }
    return ContactMatches(**columns)


def _moments_over_disc(locator: ContactLocator, touches: TouchRows, rows: IntArray) -> FloatArray:
    """Second moments (k, 3) mm² of contacts' pressures, less those of the tables' disc."""
    moments = pressure_moments(
        {
            "indenter": touches.indenter[rows],
            "radius_mm": touches.radius_mm[rows],
            "length_mm": touches.length_mm[rows],
            "turn_rad": touches.turn_rad[rows],
        }
    )
    moments[:, [0, 2]] -= locator.places.radius_mm**2 / 4.0
    return moments


def weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """Median of values (m,) that count by weights (m,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2.0)])


def learnt_prior(locator: ContactLocator, samples: Samples, chosen: IntArray) -> ContactPrior:
    """How contacts of samples lie about the switches they tripped, and how large they are."""
    touches, truth = samples.touches, samples.truth
    if touches is None or truth is None:
        return locator.prior
    mine = np.isin(truth.sample, chosen) & (truth.touch >= 0)
    number = np.bincount(truth.touch[mine], minlength=len(touches.force_N))
    # One switch, one place: several are weighted by forces that are not known here.
    alone = mine & (number[np.maximum(truth.touch, 0)] == 1)
    prior = locator.prior
    if int(alone.sum()) >= CORRECTION_LEAST:
        gap = touches.point_mm[truth.touch[alone]] - locator.position_mm[truth.marker[alone]]
        each = float(np.sqrt(np.sum(gap**2, axis=1).mean() / 2.0))
        prior = replace(prior, place_mm=max(each, PLACE_LEAST_MM))
    sized = np.flatnonzero(np.isin(touches.sample, chosen) & (touches.radius_mm > 0.0))
    if len(sized) >= CORRECTION_LEAST:
        moments = _moments_over_disc(locator, touches, sized)
        mean, sd = moments.mean(axis=0), np.maximum(moments.std(axis=0), 0.5)
        prior = replace(
            prior,
            moments_mm2=(float(mean[0]), float(mean[1]), float(mean[2])),
            moments_sd_mm2=(float(sd[0]), float(sd[1]), float(sd[2])),
        )
    return prior


def pressure_moments(touches: Mapping[str, Any]) -> FloatArray:
    """Second moments xx, xy, yy (c, 3) mm² of indenters' pressures about their centres.

    An even disc of radius a has a²/4 along each axis, Hertz's ball a²/5, and a strip of half-width
    b and length l b²/4 across (Hertz) and l²/12 along.
    """
    kind, radius = touches["indenter"], touches["radius_mm"]
    share = np.where(kind == SPHERE, 0.2, 0.25)
    along = np.where(kind == CYLINDER, touches["length_mm"] ** 2 / 12.0, share * radius**2)
    across = share * radius**2
    c, s = np.cos(touches["turn_rad"]), np.sin(touches["turn_rad"])
    return np.column_stack(
        [
            c * c * along + s * s * across,
            c * s * (along - across),
            s * s * along + c * c * across,
        ]
    )
