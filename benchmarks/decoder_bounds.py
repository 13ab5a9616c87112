"""What the best decoder could know: the Cramér-Rao bound of held-out contacts, and their noise."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.camera.camera_motion import MOUNTS, CameraMotion, tabulate_camera_motion
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.io.bundle_locator import response_from_arrays
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
from phytac_design.simulation.linear_response import motion_responses
from phytac_design.stages.response_stage import readers_of
from phytac_design.training.locator_calibration import pressure_moments
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

MEAN_SIZE = float(np.sqrt(2.0 / np.pi))
"""Mean of |error| over the standard deviation of a normal error."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Minimum standard deviations of the force; arrays run over c contacts.

    Attributes
    ----------
    force_N : (c,) float
        Place, size and forces of all of a sample's contacts unknown but for the prior; NaN for
        contacts that tripped no switch.
    alone_N : (c,) float
        The same if the sample's other contacts were known.
    """

    force_N: FloatArray
    alone_N: FloatArray

    def pick(self, rows: IntArray) -> "Bounds":
        """Of some contacts."""
        return Bounds(force_N=self.force_N[rows], alone_N=self.alone_N[rows])


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
        # Markers that contacts hardly move give the noise; errors of the mechanics are below it.
        quiet = np.linalg.norm(explained, axis=1) < 0.05
        left[sample, quiet] = (samples.shift_px[sample] - explained)[quiet]
    # With fewer readings a coordinate has the noise of all.
    known = np.isfinite(left).sum(axis=0) >= 10
    noise = np.full(known.shape, np.nan)
    # Median of |x| of a normal distribution is 0.6745 standard deviations.
    noise[known] = np.nanmedian(np.abs(left[:, known]), axis=0) / 0.6745
    each = np.abs(left[np.isfinite(left)])
    overall = float(np.median(each)) / 0.6745 if len(each) else np.nan
    return np.where(known, noise, overall)


def bounds(context: Context, samples: Samples, noise_px: FloatArray) -> Bounds:
    """Bounds of all contacts of samples, by the decoder's own shell, linear.

    Motion of the cameras since the rest frame is unknown, as in the decoder.

    Parameters
    ----------
    context : Context
        Of the decoder's mechanics.
    samples : Samples
        With contacts and truth.
    noise_px : (n, 2) float
        Standard deviation of each coordinate of a shift.
    """
    touches, truth = samples.touches, samples.truth
    assert touches is not None
    assert truth is not None
    assert samples.shift_px is not None
    design = context.design
    tripped = np.isin(np.arange(len(touches.sample)), truth.touch) & (touches.force_N > 0.0)
    prior = cell_prior(
        context.surface.area_mm2(),
        context.markers.count,
        design.training.patch_radius_min_mm,
        design.training.patch_radius_max_mm,
    )
    motion = camera_motion(context)
    rows = np.flatnonzero(tripped)
    signals = _signals(context, samples, tripped)
    force, alone = np.full((2, len(tripped)), np.nan)
    start = np.searchsorted(touches.sample[rows], np.arange(samples.count + 1))
    for sample in range(samples.count):
        own = slice(start[sample], start[sample + 1])
        if own.start == own.stop:
            continue
        weight = np.isfinite(samples.shift_px[sample]).reshape(-1) / noise_px.reshape(-1)
        mine = ContactSignals(shift=signals.shift[own], slopes=signals.slopes[own])
        found = _sample(mine, touches.force_N[rows[own]], weight, prior, motion)
        force[rows[own]], alone[rows[own]] = found
    return Bounds(force_N=force, alone_N=alone)


def camera_motion(context: Context) -> CameraMotion:
    """Motion of the design's cameras on a bench."""
    readers = readers_of(context)
    return tabulate_camera_motion(
        readers.cameras, readers.read_by, context.markers.tip_mm, MOUNTS["bench"]
    )


def _sample(
    signals: ContactSignals,
    force_N: FloatArray,
    weight: FloatArray,
    prior: PositionPrior,
    motion: CameraMotion,
) -> tuple[FloatArray, FloatArray]:
    """Bounds (m,) of m contacts at once, and of each alone."""
    slopes = force_N[:, None, None] * signals.slopes
    G = np.concatenate([signals.shift[:, :, None], slopes], axis=2) * weight[:, None]
    known = prior.known
    weighed, camera = np.swapaxes(G, 1, 2), motion.first * weight
    alone = np.array([_least(one[None], known, camera, motion.prior)[0] for one in weighed])
    return _least(weighed, known, camera, motion.prior), alone


def _least(
    weighed: FloatArray, known: FloatArray, camera: FloatArray, camera_prior: FloatArray
) -> FloatArray:
    """Bounds (m,) of the first of k unknowns of each of m contacts at once.

    Parameters
    ----------
    weighed : (m, k, 2n) float
        Slopes of all shifts over their standard deviations.
    known : (k,) float
        Inverse variances of what is known beforehand.
    camera : (q, 2n) float
        Slopes by motion of the cameras over the same.
    camera_prior : (q, q) float
        What is known of that motion beforehand: its inverse covariance.
    """
    count = len(weighed) * len(known)
    flat = np.concatenate([weighed.reshape(count, -1), camera])
    information = flat @ flat.T
    information[:count, :count] += np.diag(np.tile(known, len(weighed)))
    information[count:, count:] += camera_prior
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(information))[: count : len(known)]))


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

    names = ("indenter", "radius_mm", "length_mm", "turn_rad")
    moments = pressure_moments({name: getattr(touches, name)[chosen] for name in names})
    # An even disc of radius a has a²/4 along each axis.
    radius = np.sqrt(2.0 * (moments[:, 0] + moments[:, 2]))
    signals = contact_signals(surface, shifts, uv=touches.uv[chosen], radius_mm=radius)
    places = response_from_arrays(context.arrays("places"), float(radius.mean()))
    return signals.with_shear(places.shear_at(touches.point_mm[chosen]))
