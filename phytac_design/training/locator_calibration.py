"""Training of the estimator ``auto`` from one sensor's own samples.

Fitted are the stiffness, the priors, the noise, marker gains, a stiffness field, a correction of
forces and their spread.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.special import ndtr, stdtrit

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.estimation.contact_fit import ContactPrior, ShiftNoise, initial_state
from phytac_decoder.estimation.contact_shifts import predicted_shifts
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.locator import INTERVAL_90_SDS, ContactLocator
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR_SETTINGS
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.datasets.samples import FAILED, Samples, TouchRows
from phytac_design.training.force_correction_fit import fit_correction
from phytac_design.training.marker_gain import (
    CrossValidationFold,
    KnownContacts,
    PredictionResiduals,
    apply_gain,
    cross_validation_folds,
    estimate_marker_noise,
    fit_gains,
    predict_residuals,
)
from phytac_design.training.stiffness_field import StiffnessField
from phytac_design.training.uneven_wall import SETTINGS as UNEVEN
from phytac_design.training.uneven_wall import WallSolver
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError, InputError, NumericalError


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Settings of the calibration, chosen on virtual prints."""

    scale_samples: int = 100
    """Samples that stiffness and noise are fitted to; more change them by less than their
    spread."""
    first_samples: int = 50
    first_iterations: int = 2
    """Samples and iterations of a first scaling; gains of markers make up for the rest."""
    folds: int = 10
    """Cross-validation folds: each is read with gains fitted to the others."""
    scatter_growth_max: float = 1.05
    """With few samples, the stiffness field is dropped if held-out forces scatter by more."""
    noise_change: tuple[float, float] = (0.25, 4.0)
    contacts_min: int = 10
    """Contacts that a prior, a correction or the noise of markers needs; fewer determine only the
    stiffness."""
    spread_contacts_min: int = 100
    """Contacts that show the spread of forces without a prior."""
    spread_prior: tuple[float, float] = (0.03, 4.0)
    """Spread of forces over their common factor before any contact is known, as a share of the
    force, and how many contacts it counts as. Eight simulated prints have 2.2 % (RMS, at most
    4.0 %)."""
    spread_own_wall: float = 0.02
    """The same share where the thickness of the wall was found: 90 % intervals after ten presses
    of six other simulated prints then hold 93 to 97 % of the forces."""


SETTINGS = CalibrationSettings()
NOTHING = np.zeros(0)
SPHERE, CYLINDER = 1, 2
"""Indenters, see ``phytac_design.datasets.samples.INDENTERS``."""


@dataclass(frozen=True, kw_only=True)
class ContactMatches:
    """Located contacts matched to known ones; arrays run over c contacts.

    Attributes
    ----------
    touch : (c,) int
        Row of the contact in the samples' touches.
    point_mm : (c, 3) float
        Located centre.
    force_N, sd_N : (c,) float
        Located force and its standard deviation, before correction.
    signal_px : (c,) float
        Shift of all markers together, px per newton.
    truth_N : (c,) float
        True force.
    reduced_chi2 : (s,) float
        Of each sample.
    """

    touch: IntArray
    point_mm: FloatArray
    force_N: FloatArray
    sd_N: FloatArray
    signal_px: FloatArray
    truth_N: FloatArray
    reduced_chi2: FloatArray


def match_contacts(locator: ContactLocator, samples: Samples, chosen: IntArray) -> ContactMatches:
    """Locate contacts in samples (k,), and match them to the known ones by their switches.

    A contact that was located as two, or two that were located as one, do not match.

    Raises
    ------
    InputError
        If no contact matches.
    """
    touches, truth, shift, bits = samples.points()
    start = np.searchsorted(truth.sample, np.arange(samples.count + 1))
    rows: list[tuple[int, LocatedContact]] = []
    chi2 = []
    for sample in chosen:
        koi = np.flatnonzero(bits[sample])
        if samples.status[sample] == FAILED or len(koi) == 0:
            continue
        found = locator.find(shift[sample], koi)
        chi2.append(found.reduced_chi2)
        own = slice(start[sample], start[sample + 1])
        rows += matches_by_switch(found, truth.marker[own], truth.touch[own])
    if not rows:
        raise InputError(
            "no-switch-tripped",
            "no contact of the samples tripped a switch that was found again; give samples with "
            "stronger contacts",
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
        reduced_chi2=np.array(chi2),
    )


def matches_by_switch(
    found: ContactDetection, marker: IntArray, touch: IntArray
) -> list[tuple[int, LocatedContact]]:
    """Return the contacts of one sample that were found, and which of the pressed ones each is.

    One that was found as two, or together with another, has no match.

    Parameters
    ----------
    found : ContactDetection
        What was found.
    marker, touch : (t,) int
        Markers whose switches were pressed, and the contact that each of them belongs to.
    """
    out = []
    for contact in found.contacts:
        pressed = np.unique(touch[np.isin(marker, contact.markers)])
        if len(pressed) != 1 or pressed[0] < 0:
            continue
        mine = marker[touch == pressed[0]]
        others = [c for c in found.contacts if c is not contact]
        if not any(np.isin(c.markers, mine).any() for c in others):
            out.append((int(pressed[0]), contact))
    return out


@dataclass(frozen=True, kw_only=True)
class _OwnWall:
    """Tables of a print's own wall.

    Attributes
    ----------
    locator : ContactLocator
        With them.
    seen, known : PredictionResiduals, KnownContacts
        What they leave of the samples.
    facts : dict
        Figures of the thickness, or why the wall is taken as even.
    stiffness : float
        Of the print over that before.
    """

    locator: ContactLocator
    seen: PredictionResiduals
    known: KnownContacts
    facts: dict[str, Any]
    stiffness: float = 1.0


def _fit_own_wall(
    plain: ContactLocator,
    wall: WallSolver | None,
    samples: Samples,
    chosen: IntArray,
    stiffness: float,
) -> _OwnWall:
    """Fit the thickness of the wall to samples (k,), by tables of a print so stiff."""
    moments = _moments(plain, samples)
    seen, known = predict_residuals(plain, samples, chosen, moments)

    def even(reason: str) -> _OwnWall:
        return _OwnWall(locator=plain, seen=seen, known=known, facts={"even": reason})

    if wall is None:
        return even("not fitted")
    if len(np.unique(samples.sequence[chosen][known.row])) < UNEVEN.blocks_min:
        return even(f"fewer than {UNEVEN.blocks_min} presses")
    shell = wall()
    if shell is None:
        return even("its mesh is too large")
    touches, *_ = samples.points()
    try:
        thickness = shell.fit(
            seen,
            known,
            touches,
            samples.sequence[chosen],
            stiffness=stiffness,
            radius_mm=plain.places.radius_mm,
            rest_px=plain.noise.median_px,
        )
        if thickness is None:
            return even("held-out samples do not show it")
        table = shell.table(plain.places, thickness)
    except (DesignError, NumericalError) as error:
        # Contacts of a rig may lie where the design's wall cannot be pressed.
        return even(str(error))
    factor = 1.0 / thickness.common
    uneven = replace(plain, places=table.scaled(factor))
    seen, known = predict_residuals(uneven, samples, chosen, moments)
    return _OwnWall(locator=uneven, seen=seen, known=known, facts=thickness.facts, stiffness=factor)


def calibrate_locator(
    locator: ContactLocator,
    samples: Samples,
    chosen: IntArray,
    *,
    force_max_N: float,
    seed: int = 0,
    wall: WallSolver | None = None,
) -> tuple[ContactLocator, dict[str, Any]]:
    """Fit a locator to its sensor; return it with figures of the fit.

    Parameters
    ----------
    locator : ContactLocator
        Locator by design alone.
    samples : Samples
        Samples of the sensor.
    chosen : (k,) int
        Samples to fit to; those without contacts are ignored.
    force_max_N : float
        Largest force that the sensor is designed for.
    seed : int
        Seed of the draw of the samples that stiffness and noise are fitted to.
    wall : WallSolver, optional
        The design's shell, whose thickness is fitted; without it the wall is taken as even.

    Raises
    ------
    InputError
        If no contact of the samples is located again.
    """
    few = chosen
    if len(chosen) > SETTINGS.scale_samples:
        few = np.random.default_rng(seed).permutation(chosen)[: SETTINGS.scale_samples]
    plain = replace(locator, correction=None, prior=_fit_prior(locator, samples, chosen))
    if plain.noise.markers and not plain.noise.fitted:
        # That of a design and of unknown prints; fitted is that of this print's own tables.
        plain = replace(plain, noise=ShiftNoise(centroid_px=plain.noise.centroid_px))
    first = 1.0
    for _ in range(SETTINGS.first_iterations):
        matches = match_contacts(plain, samples, few[: SETTINGS.first_samples])
        plain, factor = _rescaled(plain, matches)
        first *= factor
    own_wall = _fit_own_wall(plain, wall, samples, chosen, first)
    plain, seen, known = own_wall.locator, own_wall.seen, own_wall.known
    first *= own_wall.stiffness
    gain, design = fit_gains(seen), plain.places
    folds = cross_validation_folds(seen, SETTINGS.folds, samples.sequence[chosen])
    own = locator.noise.markers
    moved_px = own.moved_px if own else np.zeros(2 * samples.markers)
    markers, switched_px = estimate_marker_noise(seen, folds, moved_px)
    noise, few_known = locator.noise, len(known.row) < SETTINGS.contacts_min
    if not few_known:
        noise = replace(plain.noise, centroid_px=noise.centroid_px, markers=markers, fitted=True)
        if switched_px is not None:
            noise = replace(noise, switched_px=switched_px)
    plain = replace(plain, noise=noise)
    tables, uneven = _without_field(design), False
    again = _cross_validated(plain, tables, 1.0, folds, samples, chosen, few)
    if "even" in own_wall.facts:
        # Beside the tables of a wall whose thickness was found, the field lowers no error.
        field = StiffnessField(seen, folds, known, design, plain.noise)
        other = _cross_validated(plain, field.table, 1.0, folds, samples, chosen, few)
        uneven = field.enabled and (
            len(chosen) > SETTINGS.scale_samples
            or _scatter(other) <= SETTINGS.scatter_growth_max * _scatter(again)
        )
        if uneven:
            tables, again = field.table, other
    plain = replace(plain, places=apply_gain(tables(), gain))
    plain, second = _rescaled(plain, again)
    if few_known:
        plain = replace(plain, noise=locator.noise)
    matches = _cross_validated(plain, tables, second, folds, samples, chosen, chosen)
    box = plain.position_mm
    correction = ForceCorrection.plain(
        low_mm=box.min(axis=0),
        size_mm=max(float(np.ptp(box, axis=0).max()), 1e-9),
        force_max_N=force_max_N,
    )
    fitted = len(matches.force_N) >= SETTINGS.contacts_min
    if fitted:
        correction = fit_correction(
            correction,
            point_mm=matches.point_mm,
            force_N=matches.force_N,
            signal_px=matches.signal_px,
            sd_N=matches.sd_N,
            truth_N=matches.truth_N,
            block=press_blocks(samples, matches.touch),
        )
    share = _spread_share(
        correction,
        matches,
        press_blocks(samples, matches.touch),
        fitted=fitted,
        prior=SETTINGS.spread_prior[0] if "even" in own_wall.facts else SETTINGS.spread_own_wall,
    )
    correction = replace(correction, stiffness=first * second, spread_share=share)
    facts = {
        "contacts": len(matches.force_N),
        "stiffness": correction.stiffness,
        "gain": float(np.sqrt(np.mean(gain**2))),
        "uneven": uneven,
        "wall": own_wall.facts,
        "noise_px": float(np.sqrt(np.mean(plain.noise.each_px**2))),
        "switched_px": plain.noise.switched_px,
        "place_mm": plain.prior.place_mm,
        "spread": correction.spread,
        "spread_share": correction.spread_share,
    }
    return replace(plain, correction=correction), facts


def error_of_first_order(locator: ContactLocator) -> float:
    """Return how far the first order of the tables is off at the largest force, at the worst place.

    That is the force read from the tables' own shifts by their first order alone, its difference to
    the true force over the force read; 0 for tables of one order.
    """
    places, force_N = locator.places, locator.prior.force_N
    errors = [0.0]
    if places.orders > 1:
        for row in range(0, len(places.point_mm), max(len(places.point_mm) // 100, 1)):
            state = initial_state(places, locator.prior, places.point_mm[row], force_N)
            ((true_px, _),) = predicted_shifts(places, [state])
            ((first_px, _),) = predicted_shifts(locator.linear.places, [state])
            read = float(first_px @ true_px) / max(float(first_px @ first_px), 1e-12)
            errors.append(abs(1.0 / max(read, 1e-3) - 1.0))
    return max(errors)


def press_blocks(samples: Samples, touch: IntArray) -> IntArray:
    """Return blocks of contacts (c,) that are left out together: those of one press."""
    touches, *_ = samples.points()
    sample = touches.sample[touch]
    sequence, count = np.unique(samples.sequence, return_counts=True)
    several = np.isin(samples.sequence[sample], sequence[count > 1])
    alone = -1 - np.arange(len(touch))
    return np.where(several, samples.sequence[sample], alone)


def _spread_share(
    correction: ForceCorrection,
    matches: ContactMatches,
    block: IntArray,
    *,
    fitted: bool,
    prior: float,
) -> float:
    """Return the spread of forces as a share of the force, with a prior where contacts are few."""
    share = correction.spread_share
    if len(matches.force_N) >= SETTINGS.spread_contacts_min:
        return share
    return spread_with_prior(
        np.log(matches.truth_N / matches.force_N),
        correction.spread * matches.sd_N / matches.force_N,
        block,
        known=share if fitted else None,
        prior=prior,
    )


def spread_with_prior(
    error: FloatArray,
    sd_share: FloatArray,
    block: IntArray,
    *,
    known: float | None = None,
    prior: float = SETTINGS.spread_prior[0],
) -> float:
    """Return the spread of forces as a share of the force, by contacts and a prior.

    The variance has a prior, see :attr:`CalibrationSettings.spread_prior`: a scaled inverse χ²
    distribution (Gelman et al. 2013, Bayesian Data Analysis, 3.3), and the result is that of the
    normal distribution with as wide a 90 % interval of a new force. The error of the common factor,
    a median, is added; beforehand that factor is known to ``stiffness_sd``.

    Parameters
    ----------
    error : (c,) float
        Logarithm of the true over the located force, after the common factor.
    sd_share : (c,) float
        Standard deviation of the located force over the force.
    block : (c,) int
        Contacts of one press, which count once.
    known : float, optional
        Spread over ``sd_share`` that was fitted to these contacts; else it is that of ``error``.
    prior : float
        Spread before any contact is known.
    """
    prior_count = SETTINGS.spread_prior[1]
    _, press = np.unique(block, return_inverse=True)
    frames = np.bincount(press)
    count = len(frames)
    noise = np.bincount(press, weights=sd_share**2) / frames
    if known is None:
        # The common factor takes one degree of freedom.
        square = np.bincount(press, weights=error**2) / frames * count / max(count - 1, 1)
        seen = (square, noise) if count > 1 else (NOTHING, NOTHING)
        spread = _posterior_spread(*seen, prior=prior)
    else:
        spread = np.sqrt((prior_count * prior**2 + count * known**2) / (prior_count + count))
        spread *= stdtrit(prior_count + count, 0.95) / INTERVAL_90_SDS
    of_median = np.pi / 2.0 / float(np.sum(1.0 / (spread**2 + noise)))
    factor = 1.0 / (1.0 / of_median + 1.0 / LOCATOR_SETTINGS.stiffness_sd**2)
    return float(np.sqrt(spread**2 + factor))


def _posterior_spread(square: FloatArray, noise: FloatArray, *, prior: float) -> float:
    """Return the spread whose 90 % interval is that of the posterior, by errors with noise.

    Parameters
    ----------
    square, noise : (c,) float
        Squares of errors, and variances of what else is in them.
    """
    count = SETTINGS.spread_prior[1]
    spread = prior * np.geomspace(0.05, 50.0, 300)
    total = spread[:, None] ** 2 + noise
    log = -count * np.log(spread) - count * prior**2 / (2.0 * spread**2)
    log -= 0.5 * np.sum(np.log(total) + square / total, axis=1)
    weight = np.exp(log - log.max())
    # Of a normal distribution with each spread, as many lie within each half-width.
    width = INTERVAL_90_SDS * spread
    within = weight @ (2.0 * ndtr(width / spread[:, None]) - 1.0) / weight.sum()
    return float(np.interp(0.9, within, spread))


def _rescaled(plain: ContactLocator, matches: ContactMatches) -> tuple[ContactLocator, float]:
    """Return the locator with fitted stiffness and noise, and the stiffness over the old one."""
    factor = weighted_median(matches.truth_N / matches.force_N, matches.force_N / matches.sd_N)
    change = float(np.clip(np.sqrt(np.median(matches.reduced_chi2)), *SETTINGS.noise_change))
    noise = plain.noise.scaled(change)
    return replace(plain, places=plain.places.scaled(factor), noise=noise), factor


def _scatter(matches: ContactMatches) -> float:
    """Return the mean relative error of forces after their common factor."""
    ratio = matches.force_N / matches.truth_N
    return float(np.mean(np.abs(ratio / np.median(ratio) - 1.0)))


def _moments(plain: ContactLocator, samples: Samples) -> FloatArray:
    """Return second moments (c, 3) mm² of all contacts less the disc's; unknown ones by prior."""
    touches, *_ = samples.points()
    moments = np.tile(plain.prior.moments_mm2, (len(touches.force_N), 1))
    sized = np.flatnonzero(touches.radius_mm > 0.0)
    moments[sized] = _moments_over_disc(plain, touches, sized)
    return moments


def _without_field(places: ResponseTable) -> Callable[..., ResponseTable]:
    """Return :meth:`.StiffnessField.table` of a print as the tables have it."""
    return lambda **_: places


def _cross_validated(
    plain: ContactLocator,
    tables: Callable[..., ResponseTable],
    stiffness: float,
    folds: list[CrossValidationFold],
    samples: Samples,
    chosen: IntArray,
    within: IntArray,
) -> ContactMatches:
    """Match the contacts of samples (m,), each located with tables fitted to the other folds.

    Parameters
    ----------
    tables : callable
        See :meth:`.StiffnessField.table`.
    """
    found = []
    for number, fold in enumerate(folds):
        rows = fold.rows & np.isin(chosen, within)
        table = apply_gain(tables(without_fold=number).scaled(stiffness), fold.gain)
        with suppress(InputError):  # of few samples none may match
            found.append(match_contacts(replace(plain, places=table), samples, chosen[rows]))
    if not found:
        return match_contacts(plain, samples, within)
    return ContactMatches(
        **{
            column.name: np.concatenate([getattr(matches, column.name) for matches in found])
            for column in fields(ContactMatches)
        }
    )


def _moments_over_disc(locator: ContactLocator, touches: TouchRows, rows: IntArray) -> FloatArray:
    """Return second moments (k, 3) mm² of contacts' pressures, less those of the tables' disc."""
    names = ("indenter", "radius_mm", "length_mm", "turn_rad")
    moments = pressure_moments({name: getattr(touches, name)[rows] for name in names})
    moments[:, [0, 2]] -= locator.places.radius_mm**2 / 4.0
    return moments


def weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """Return the median of values (m,) with weights (m,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2.0)])


def _fit_prior(locator: ContactLocator, samples: Samples, chosen: IntArray) -> ContactPrior:
    """Return the prior of places about the switches, and of second moments."""
    touches, truth = samples.touches, samples.truth
    if touches is None or truth is None or not len(touches.force_N):
        return locator.prior
    mine = np.isin(truth.sample, chosen) & (truth.touch >= 0)
    number = np.bincount(truth.touch[mine], minlength=len(touches.force_N))
    # Contacts with one switch: the places of several are weighted by unknown forces.
    alone = mine & (number[np.maximum(truth.touch, 0)] == 1)
    prior = locator.prior
    if int(alone.sum()) >= SETTINGS.contacts_min:
        gap = touches.point_mm[truth.touch[alone]] - locator.position_mm[truth.marker[alone]]
        each = float(np.sqrt(np.sum(gap**2, axis=1).mean() / 2.0))
        prior = replace(prior, place_mm=max(each, locator.prior.place_mm))
    sized = np.flatnonzero(np.isin(touches.sample, chosen) & (touches.radius_mm > 0.0))
    if len(sized) >= SETTINGS.contacts_min:
        moments = _moments_over_disc(locator, touches, sized)
        mean, sd = moments.mean(axis=0), np.maximum(moments.std(axis=0), 0.5)
        prior = replace(
            prior,
            moments_mm2=tuple(mean.tolist()),
            moments_sd_mm2=tuple(sd.tolist()),
        )
    return prior


def pressure_moments(touches: Mapping[str, Any]) -> FloatArray:
    """Return second moments xx, xy, yy (c, 3) mm² of indenters' pressures about their centres.

    A uniform disc of radius a has a²/4 along each axis, a Hertzian sphere a²/5, and a strip of
    half-width b and length l b²/4 across (Hertz) and l²/12 along.
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
