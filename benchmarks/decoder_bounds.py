"""What the best decoder could know: the Cramér-Rao bound of held-out contacts, and their noise."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.contact_fit import initial_state
from phytac_decoder.estimation.contact_shifts import UNKNOWNS, single_contact_shifts
from phytac_design.datasets.samples import Samples
from phytac_design.engine.stage import Context
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.simulation.cramer_rao import (
    ContactSignals,
    PositionPrior,
    cell_prior,
    contact_signals,
)
from phytac_design.simulation.response import motion_responses
from phytac_design.stages.places import locator_of
from phytac_design.training.locator_calibration import pressure_moments
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

QUIET_px = 0.05
"""Markers that contacts move by less tell the noise: what mechanics leave out is far below it."""
QUIET_LEAST = 10
"""Readings of a coordinate from which on it has a noise of its own."""
STILL_px = 0.1
"""Markers that move by more lie elsewhere on the pixels."""
MOMENT_LEAST_MM2 = 0.1
"""Least scatter of second moments that is presumed."""
MEAN_SIZE = float(np.sqrt(2.0 / np.pi))
"""Mean of |error| over the standard deviation of a normal error."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Least standard deviations of the force; arrays run over c contacts.

    Attributes
    ----------
    force_N : (c,) float
        Place, size and forces of all of a sample's contacts unknown but for the prior; NaN for
        contacts that tripped no switch.
    alone_N : (c,) float
        The same if all about the sample's other contacts were known.
    pixels_N : (c,) float
        As the first, with what pixels add to the noise of markers that move.
    shaped_N : (c,) float
        As the last, of contacts of which three second moments are unknown, not a radius alone:
        balls, edges and discs that are turned anyhow.
    tips_N : (c,) float
        As the last, with the scatter of markers whose red tip is out.
    """

    force_N: FloatArray
    alone_N: FloatArray
    pixels_N: FloatArray
    shaped_N: FloatArray
    tips_N: FloatArray

    def pick(self, rows: IntArray) -> "Bounds":
        """Of some contacts."""
        return Bounds(
            force_N=self.force_N[rows],
            alone_N=self.alone_N[rows],
            pixels_N=self.pixels_N[rows],
            shaped_N=self.shaped_N[rows],
            tips_N=self.tips_N[rows],
        )


def noise_of(found: list[ContactDetection | None], samples: Samples) -> FloatArray:
    """Noise (n, 2) px of shifts: robust scatter of markers that a sample's contacts leave alone.

    Parameters
    ----------
    found : list of Found or None
        Of each sample, None where nothing was looked for.
    samples : Samples
        With shifts.
    """
    assert samples.shift_px is not None
    left = np.full(samples.shift_px.shape, np.nan)
    for sample, one in enumerate(found):
        if one is None:
            continue
        explained = one.shift_px.reshape(-1, 2)
        quiet = np.linalg.norm(explained, axis=1) < QUIET_px
        left[sample, quiet] = (samples.shift_px[sample] - explained)[quiet]
    known = np.isfinite(left).sum(axis=0) >= QUIET_LEAST
    noise = np.full(known.shape, np.nan)
    # Median of |x| of a normal distribution is 0.6745 standard deviations.
    noise[known] = np.nanmedian(np.abs(left[:, known]), axis=0) / 0.6745
    each = np.abs(left[np.isfinite(left)])
    overall = float(np.median(each)) / 0.6745 if len(each) else np.nan
    return np.where(known, noise, overall)


def bounds(
    context: Context,
    samples: Samples,
    noise_px: FloatArray,
    pixels_px: FloatArray | float = 0.0,
    switched_px: float = 0.0,
) -> Bounds:
    """Bounds of all contacts of samples, by the decoder's own shell, linear.

    Parameters
    ----------
    context : Context
        Of the decoder's mechanics.
    samples : Samples
        With contacts and truth.
    noise_px : (n, 2) float
        Standard deviation of each coordinate of a shift.
    pixels_px : (n, 2) float
        Standard deviation of the error of a place that depends on where on the pixels it is; of a
        marker that moves, shifts have it twice: of where it is and of where it was.
    switched_px : float
        Standard deviation of shifts of markers whose tip is out, besides.
    """
    touches, truth = samples.touches, samples.truth
    assert touches is not None
    assert truth is not None
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    design = context.design
    tripped = np.isin(np.arange(len(touches.sample)), truth.touch) & (touches.force_N > 0.0)
    prior = cell_prior(
        context.surface.area_mm2(),
        context.markers.count,
        design.training.patch_radius_min_mm,
        design.training.patch_radius_max_mm,
    )
    rows = np.flatnonzero(tripped)
    signals = _signals(context, samples, tripped)
    force, alone, pixels, shaped, tips = np.full((5, len(tripped)), np.nan)
    slopes, known = _by_moments(context, samples, tripped, prior)
    twice = np.broadcast_to(2.0 * np.asarray(pixels_px) ** 2, noise_px.shape)
    start = np.searchsorted(touches.sample[rows], np.arange(samples.count + 1))
    for sample in range(samples.count):
        own = slice(start[sample], start[sample + 1])
        if own.start == own.stop:
            continue
        seen = np.isfinite(samples.shift_px[sample]).reshape(-1)
        mine = ContactSignals(shift=signals.shift[own], slopes=signals.slopes[own])
        newtons = touches.force_N[rows[own]]
        force[rows[own]], alone[rows[own]] = _sample(
            mine, newtons, seen / noise_px.reshape(-1), prior
        )
        moves = np.linalg.norm((newtons @ mine.shift).reshape(-1, 2), axis=1) > STILL_px
        noise = np.sqrt(noise_px**2 + twice * moves[:, None])
        weight = seen / noise.reshape(-1)
        pixels[rows[own]] = _sample(mine, newtons, weight, prior)[0]
        shaped[rows[own]] = _least(slopes[own] * weight, known)
        noise = np.hypot(noise, switched_px * samples.bits_read[sample][:, None])
        tips[rows[own]] = _least(slopes[own] * (seen / noise.reshape(-1)), known)
    return Bounds(force_N=force, alone_N=alone, pixels_N=pixels, shaped_N=shaped, tips_N=tips)


def _sample(
    signals: ContactSignals, force_N: FloatArray, weight: FloatArray, prior: PositionPrior
) -> tuple[FloatArray, FloatArray]:
    """Bounds (m,) of m contacts at once, and of each alone."""
    slopes = force_N[:, None, None] * signals.slopes
    G = np.concatenate([signals.shift[:, :, None], slopes], axis=2) * weight[:, None]
    known = np.array([0.0, prior.place_mm**-2, prior.place_mm**-2, prior.radius_mm**-2])
    each = np.swapaxes(G, 1, 2) @ G + np.diag(known)
    alone = np.sqrt(np.linalg.inv(each)[:, 0, 0])
    return _least(np.swapaxes(G, 1, 2), known), alone


def _least(weighed: FloatArray, known: FloatArray) -> FloatArray:
    """Bounds (m,) of the first of k unknowns of each of m contacts at once.

    Parameters
    ----------
    weighed : (m, k, 2n) float
        Slopes of all shifts over their standard deviations.
    known : (k,) float
        Inverse variances of what is known beforehand.
    """
    count = len(weighed)
    flat = weighed.reshape(count * len(known), -1)
    information = flat @ flat.T + np.diag(np.tile(known, count))
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(information))[:: len(known)]))


def _by_moments(
    context: Context, samples: Samples, chosen: BoolArray, prior: PositionPrior
) -> tuple[FloatArray, FloatArray]:
    """Slopes (c, 6, 2n) of shifts by all unknowns of the chosen contacts, and what is known (6,).

    By the decoder's linear tables. Moments are presumed to scatter as those of these contacts do.
    """
    locator = locator_of(context).linear
    touches = samples.touches
    assert touches is not None
    moments = _moments(samples, chosen)
    moments[:, [0, 2]] -= locator.places.radius_mm**2 / 4.0
    out = np.empty((len(moments), UNKNOWNS, 2 * samples.markers))
    rows = zip(touches.point_mm[chosen], touches.force_N[chosen], moments, strict=True)
    for k, (point, force, own) in enumerate(rows):
        state = initial_state(locator.places, locator.prior, point, float(force))
        state.x[3:] = own
        out[k] = single_contact_shifts(state, 1)[1]
    spread = np.maximum(moments.std(axis=0), MOMENT_LEAST_MM2)
    return out, np.array([0.0, *[prior.place_mm**-2] * 2, *spread**-2.0])


def _moments(samples: Samples, chosen: BoolArray) -> FloatArray:
    """Second moments (c, 3) mm² of the chosen contacts."""
    touches = samples.touches
    assert touches is not None
    return pressure_moments(
        {
            "indenter": touches.indenter[chosen],
            "radius_mm": touches.radius_mm[chosen],
            "length_mm": touches.length_mm[chosen],
            "turn_rad": touches.turn_rad[chosen],
        }
    )


def _signals(context: Context, samples: Samples, chosen: BoolArray) -> ContactSignals:
    """Shifts per newton of the chosen contacts, as even discs of their second moments."""
    touches = samples.touches
    assert touches is not None
    design, surface, markers = context.design, context.surface, context.markers
    mesh = marker_mesh(
        surface, markers, thickness_mm=design.wall.thickness_mm, refine=context.accuracy.refine
    )
    receptors = context.accuracy.receptors and not unknown_receptors(design)
    model = sensor_model(design, markers, mesh, receptors=receptors)
    slope = context.arrays("views")["paint_slope"]

    def shifts(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
        motion = motion_responses(model, mesh, surface, markers, uv=uv, radius_mm=radius_mm)
        return np.asarray(np.einsum("nij,cnj->cni", slope, motion))

    moments = _moments(samples, chosen)
    # An even disc of radius a has a²/4 along each axis.
    radius = np.sqrt(2.0 * (moments[:, 0] + moments[:, 2]))
    return contact_signals(surface, shifts, uv=touches.uv[chosen], radius_mm=radius)
