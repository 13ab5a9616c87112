"""How far decoded forces are from the truth, per contact."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.simulation.contacts import Contacts, Switching
from phytac_shapes.arrays import BoolArray, FloatArray


def force_score(estimate_N: FloatArray, truth_N: FloatArray) -> dict[str, Any]:
    """Errors of estimated against true contact forces, (c,) each; NaN without contacts.

    Returns
    -------
    dict
        ``mae_N``, ``sd_N``, ``rmse_N``, ``bias_N``: mean absolute error, standard deviation of the
        error, root mean square, mean error; ``relative_error``: mean of |error| / force;
        ``samples``: contacts.
    """
    if len(truth_N) == 0:
        names = ("mae_N", "sd_N", "rmse_N", "bias_N", "relative_error")
        return dict.fromkeys(names, float("nan")) | {"samples": 0}
    error = estimate_N - truth_N
    return {
        "mae_N": float(np.abs(error).mean()),
        "sd_N": float(error.std()),
        "rmse_N": float(np.sqrt((error**2).mean())),
        "bias_N": float(error.mean()),
        "relative_error": float((np.abs(error) / truth_N).mean()),
        "samples": len(truth_N),
    }


def contact_forces(receptor_N: FloatArray, contacts: Contacts, switching: Switching) -> FloatArray:
    """Decoded forces (samples, n) summed over the switches that each contact tripped, (c,)."""
    out = np.zeros(len(contacts.sample))
    sample, marker = np.nonzero(switching.owner >= 0)
    np.add.at(out, switching.owner[sample, marker], receptor_N[sample, marker])
    return out


def score_contacts(
    receptor_N: FloatArray,
    contacts: Contacts,
    switching: Switching,
    *,
    height_mm: FloatArray,
    middle_mm: tuple[float, float],
) -> dict[str, Any]:
    """Scores over all evaluated contacts and apart by number, force and height.

    Parameters
    ----------
    receptor_N : (samples, n) float
        Decoded forces.
    contacts, switching : Contacts, Switching
        The truth. Contacts that tripped no switch cannot be decoded and are counted apart.
    height_mm : (c,) float
        Distance of each contact from the near rim along the sensor.
    middle_mm : (low, high)
        Heights that count as the middle (15 to 95 mm of 120 in the paper).
    """
    estimate = contact_forces(receptor_N, contacts, switching)
    seen, truth = switching.tripped, contacts.force_N
    alone = contacts.counts[contacts.sample] == 1
    middle = (height_mm >= middle_mm[0]) & (height_mm <= middle_mm[1])
    groups: Mapping[str, BoolArray] = {
        "single": alone,
        "multi": ~alone,
        "below_5N": truth < 5.0,
        "from_5N": truth >= 5.0,
        "middle": middle,
        "near_rims": ~middle,
    }
    out: dict[str, Any] = force_score(estimate[seen], truth[seen])
    for name, group in groups.items():
        out[name] = force_score(estimate[seen & group], truth[seen & group])
    owner = switching.owner
    on = owner >= 0
    receptor = force_score(receptor_N[on], switching.receptor_force_N[on])
    out["receptor"] = {key: value for key, value in receptor.items() if key != "relative_error"}
    return out
