"""Contacts of data sets, decoded by each estimator."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_decoder.estimation.estimators import ForceModel
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.training.locator_calibration import matches_by_switch
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError, NumericalError


@dataclass(frozen=True, kw_only=True)
class DecodedContacts:
    """Contacts of all samples that did not fail, c of them.

    Attributes
    ----------
    sample, touch : (c,) int
        Sample of each contact, and its row in the samples' touches.
    force_N : (c,) float
        True force: the sum over the contact's switches; without a switch, the contact's own.
    tripped : (c,) bool
        Whether it turned on a switch; other contacts cannot be seen by switches.
    read : (c,) bool
        Whether at least one of its switches was read as on.
    decoded_N : dict of (c,) float
        By estimator: the sum of decoded forces over the contact's switches.
    evaluated : (j,) int
        Samples that did not fail.
    elsewhere_N : dict of (j,) float
        By estimator: decoded force on receptors without a contact, per evaluated sample.
    stated : (m, 4) float
        Of each contact that ``auto`` found alone, not as two, nor together with another: row in the
        samples' touches, found force, its standard deviation, and the contact's own true force,
        which is not that on its switches where it shares one.
    missed, on, false, off : int
        Number of switches that were on but not read, on, read but not on, and off.
    """

    sample: IntArray
    touch: IntArray
    force_N: FloatArray
    tripped: BoolArray
    read: BoolArray
    decoded_N: dict[str, FloatArray]
    evaluated: IntArray
    elsewhere_N: dict[str, FloatArray]
    stated: FloatArray
    missed: int
    on: int
    false: int
    off: int

    def switches(self) -> dict[str, Any]:
        """Return how well switches were read, plain JSON."""
        return {
            "on": self.on,
            "off": self.off,
            "missed": self.missed,
            "false": self.false,
            "missed_rate": self.missed / self.on if self.on else None,
            "false_rate": self.false / self.off if self.off else None,
        }


def decode_contacts(
    model: ForceModel,
    samples: Samples,
    *,
    estimators: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> DecodedContacts:
    """Decode every sample with every estimator, from the shifts and switches that were read.

    Parameters
    ----------
    model : ForceModel
        Force model of the sensor.
    samples : Samples
        With points, contacts and truth.
    estimators : list of str, optional
        Names; by default all of the model.
    progress : callable
        Called with the name of each estimator.

    Raises
    ------
    InputError
        If the samples lack shifts, switches, contacts or truth.
    NumericalError
        If an estimator gives a force that is not a finite number.
    """
    shift, bits, read = samples.shift_px, samples.bits, samples.bits_read
    touches, truth = samples.touches, samples.truth
    if shift is None or bits is None or read is None or touches is None or truth is None:
        raise InputError(
            "samples-without-points",
            "decoding needs the markers' shifts, the switches and the truth of every sample; make "
            "the data with --keep points",
        )
    usable = samples.status != FAILED
    evaluated = np.flatnonzero(usable)
    row = np.flatnonzero(truth.touch >= 0)
    owner = truth.touch[row]
    count = len(touches.sample)

    def per_touch(values: FloatArray) -> FloatArray:
        """Sum values (t,) of the switches over their contacts."""
        return np.bincount(owner, weights=values[row], minlength=count).astype(np.float64)

    tripped = np.bincount(owner, minlength=count) > 0
    force = np.where(tripped, per_touch(truth.force_N), touches.force_N)
    was_read = read[truth.sample, truth.marker].astype(np.float64)
    keep = np.flatnonzero(usable[touches.sample])
    decoded, elsewhere = {}, {}
    stated: list[tuple[float, float, float, float]] = []
    start, marker = (
        np.searchsorted(truth.sample[row], np.arange(samples.count + 1)),
        truth.marker[row],
    )
    for name in estimators if estimators is not None else model.estimators:
        progress(name)
        forces = np.zeros(bits.shape)
        for k in evaluated.tolist():
            koi = np.flatnonzero(read[k])
            # As in ForceModel.forces: without either there is nothing to find.
            if name == "auto" and (len(koi) or (model.locator and len(model.locator.blind))):
                found = model.contacts(shift[k], koi)
                forces[k] = found.receptor_forces_N(samples.markers)
                own = slice(start[k], start[k + 1])
                stated += [
                    (touch, contact.force_N, contact.sd_N, touches.force_N[touch])
                    for touch, contact in matches_by_switch(found, marker[own], owner[own])
                ]
            else:
                forces[k] = model.forces(name, shift[k], koi)
        if not np.isfinite(forces).all():
            bad = int(np.flatnonzero(~np.isfinite(forces).all(axis=1))[0])
            raise NumericalError(
                "estimator-not-finite",
                f"estimator {name} gives forces that are not numbers in sample {bad}; train "
                "it again, or leave that sample out",
            )
        decoded[name] = per_touch(forces[truth.sample, truth.marker])[keep]
        on_contacts = np.bincount(
            truth.sample[row],
            weights=forces[truth.sample[row], truth.marker[row]],
            minlength=samples.count,
        )
        elsewhere[name] = (forces.sum(axis=1) - on_contacts)[evaluated]
    seen_on, seen_read = bits[evaluated], read[evaluated]
    return DecodedContacts(
        sample=touches.sample[keep],
        touch=keep,
        force_N=force[keep],
        tripped=tripped[keep],
        read=(per_touch(was_read) > 0.0)[keep],
        decoded_N=decoded,
        evaluated=evaluated,
        elsewhere_N=elsewhere,
        stated=_checked(np.array(stated).reshape(-1, 4)),
        missed=int((seen_on & ~seen_read).sum()),
        on=int(seen_on.sum()),
        false=int((~seen_on & seen_read).sum()),
        off=int((~seen_on).sum()),
    )


def _checked(stated: FloatArray) -> FloatArray:
    """The same, if all standard deviations are positive numbers."""
    sd = stated[:, 2]
    wrong = np.flatnonzero(~(np.isfinite(sd) & (sd > 0.0)))
    if len(wrong):
        raise NumericalError(
            "estimator-not-finite",
            f"estimator auto gives a standard deviation of {sd[wrong[0]]:g} N for contact "
            f"{stated[wrong[0], 0]:.0f}; train it again, or leave that sample out",
        )
    return stated
