"""Where to press a print, so that a few known forces say most about its stiffness.

The logarithm of a print's stiffness over that of its design is taken as a Gaussian process
(Rasmussen and Williams 2006, ch. 2): one number for the whole wall, and a part that varies from
place to place. A press of known force measures it where it presses. The next press is the one after
which the variance, averaged over the wall, is least (A-optimal design: Chaloner and Verdinelli
1995).
"""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.locator import SETTINGS as LOCATOR
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.sensor_limits import markers_in_play
from phytac_design.training.stiffness_field import SETTINGS as FIELD
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class PressPlaceSettings:
    """Error of a press, and where a force is read well."""

    press_sd: float = 0.02
    """Error of a press: of the scale, of its direction, and of the reading."""
    signal_min: float = 0.5
    """Least motion of all markers per newton at a place, over the median: force and place are hard
    to tell apart beside a clamped rim, where markers move less."""
    receptors_max: int = 500


SETTINGS = PressPlaceSettings()


def pressable_receptors(bundle: Bundle, locator: ContactLocator) -> IntArray:
    """Receptors that the decoder reads, with a switch that it can read, and away from rims."""
    places = locator.places
    signal = np.linalg.norm(places.shift_px[:, 0], axis=1)[places.nearest(bundle.position_mm)]
    good = markers_in_play(bundle) & bundle.tips.readable
    good[locator.blind] = False
    good &= signal >= SETTINGS.signal_min * np.median(signal)
    receptors = np.flatnonzero(good if good.any() else markers_in_play(bundle))
    if len(receptors) <= SETTINGS.receptors_max:
        return receptors
    return np.sort(np.random.default_rng(0).permutation(receptors)[: SETTINGS.receptors_max])


def remaining_covariance(
    targets_mm: FloatArray, pressed_mm: FloatArray, *, radius_mm: float
) -> FloatArray:
    """Covariance (t, t) of the logarithm of the stiffness at places, once others are pressed.

    Parameters
    ----------
    targets_mm, pressed_mm : (t, 3), (k, 3) float
        Places asked for, and presses that are known.
    radius_mm : float
        Of the tables' disc: the scale of the part that varies.
    """
    length_mm = FIELD.length * radius_mm
    common = LOCATOR.stiffness_sd**2 - FIELD.share**2

    def covariance(a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
        gap = np.sum((a_mm[:, None] - b_mm[None]) ** 2, axis=2)
        return np.asarray(common + FIELD.share**2 * np.exp(-gap / (2.0 * length_mm**2)))

    own = covariance(targets_mm, targets_mm)
    if not len(pressed_mm):
        return own
    cross = covariance(targets_mm, pressed_mm)
    known = covariance(pressed_mm, pressed_mm) + SETTINGS.press_sd**2 * np.eye(len(pressed_mm))
    return np.asarray(own - cross @ np.linalg.solve(known, cross.T))


def next_press(candidates_mm: FloatArray, pressed_mm: FloatArray, *, radius_mm: float) -> int:
    """Return which of the candidates (m, 3) to press next.

    Parameters
    ----------
    pressed_mm : (k, 3) float
        Places that were pressed, or need not be.
    radius_mm : float
        Of the tables' disc.
    """
    left = remaining_covariance(candidates_mm, pressed_mm, radius_mm=radius_mm)
    gain = np.sum(left**2, axis=0) / (np.diagonal(left) + SETTINGS.press_sd**2)
    return int(np.argmax(gain))
