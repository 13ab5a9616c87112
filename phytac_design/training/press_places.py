"""Where to press a print, so that a few known forces say most about its stiffness.

The logarithm of a print's stiffness over that of its design is taken as a Gaussian process
(Rasmussen and Williams 2006, ch. 2): one number for the whole wall, and a part that varies from
place to place. A press of known force measures it where it presses. The next place is the one whose
press leaves the least variance in the mean over the wall (A-optimal design: Chaloner and Verdinelli
1995).
"""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.locator import SETTINGS as LOCATOR
from phytac_decoder.mechanics.response_table import ResponseTable
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
    places_max: int = 500


SETTINGS = PressPlaceSettings()


def usable_places(places: ResponseTable) -> IntArray:
    """Places of the tables, evenly chosen among those where a force is read well."""
    signal = np.linalg.norm(places.shift_px[:, 0], axis=1)
    good = np.flatnonzero(signal >= SETTINGS.signal_min * np.median(signal))
    step = -(-len(good) // SETTINGS.places_max)
    return good[::step]


def remaining_variance(
    places: ResponseTable, targets_mm: FloatArray, pressed_mm: FloatArray
) -> FloatArray:
    """Covariance (t, t) of the logarithm of the stiffness at places, once others are pressed.

    Parameters
    ----------
    places : ResponseTable
        Its disc's radius is the scale of the part that varies.
    targets_mm, pressed_mm : (t, 3), (k, 3) float
        Places asked for, and presses that are known.
    """
    length_mm = FIELD.length * places.radius_mm
    common = LOCATOR.stiffness_sd**2 - FIELD.share**2

    def covariance(a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
        gap = np.sum((a_mm[:, None] - b_mm[None]) ** 2, axis=2)
        local = FIELD.share**2 * np.exp(-gap / (2.0 * length_mm**2))
        return np.asarray(common + local)

    own = covariance(targets_mm, targets_mm)
    if not len(pressed_mm):
        return own
    cross = covariance(targets_mm, pressed_mm)
    known = covariance(pressed_mm, pressed_mm) + SETTINGS.press_sd**2 * np.eye(len(pressed_mm))
    return np.asarray(own - cross @ np.linalg.solve(known, cross.T))


def next_place(places: ResponseTable, pressed_mm: FloatArray) -> FloatArray:
    """Return where to press next, (3,) mm on the outer face.

    Parameters
    ----------
    places : ResponseTable
        Tables of the decoder.
    pressed_mm : (k, 3) float
        Where it was pressed, or need not be pressed.
    """
    targets = places.point_mm[usable_places(places)]
    left = remaining_variance(places, targets, pressed_mm)
    gain = np.sum(left**2, axis=0) / (np.diagonal(left) + SETTINGS.press_sd**2)
    return np.asarray(targets[int(np.argmax(gain))])
