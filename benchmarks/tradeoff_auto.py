"""The estimator ``auto`` itself on the standard contacts, noise-free, with a build's own tables."""

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.design_file import load_design
from phytac_design.simulation.contacts import switch_states
from phytac_design.simulation.pressed_series import ImageResponse
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.places import locator_of
from phytac_design.stages.response import image_response_of
from phytac_design.study.tradeoff.force import REFERENCE_REFINES, ForceError, extrapolated, rms
from phytac_shapes.arrays import FloatArray


def auto_errors(name: str, setting: Accuracy) -> tuple[float, float, int]:
    """Force error of the figure, that of ``auto`` on the same contacts, and how many it judged.

    The truth's markers are watched at the paint that the build's views found.
    """
    design = load_design(name)
    context, _, _ = run_stages(
        design,
        select_stages(["places"]),
        accuracy=setting,
        seed=0,
        force=True,
        progress=lambda _: None,
    )
    locator = locator_of(context)
    error = ForceError(design)
    figure = rms(error.errors(setting))
    contacts = error.contacts
    switches = switch_states(design, error.surface, error.markers, contacts.touches)
    shift = watched_px(error, image_response_of(context))
    read, true = [], []
    for k in np.flatnonzero(np.isfinite(shift).all(axis=1)).tolist():
        found = locator.find(shift[k].reshape(-1, 2), np.flatnonzero(switches.bits[k]))
        if found.contacts:
            read.append(sum(contact.force_N for contact in found.contacts))
            true.append(contacts.force_N[k])
    return figure, rms(np.array(read) / np.array(true) - 1.0), len(read)


def watched_px(error: ForceError, see: ImageResponse) -> FloatArray:
    """Shifts (c, 2n) of the paint that the cameras really see, by the reference."""
    return extrapolated(
        *(
            np.stack([see.shift(one).ravel() for one in error.truth(refine).motion])
            for refine in REFERENCE_REFINES
        )
    )
