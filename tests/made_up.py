"""Detections and measurements of frames, made up."""

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_shapes.arrays import FloatArray


def found_of(*contacts: LocatedContact, shift_px: FloatArray) -> ContactDetection:
    """Detection of a frame, made up."""
    return ContactDetection(contacts=list(contacts), reduced_chi2=1.0, shift_px=shift_px)


def at(
    point_mm: FloatArray, markers: list[int], force_N: float, sd_N: float = 1.0
) -> LocatedContact:
    """A contact, made up."""
    return LocatedContact(
        markers=np.array(markers, dtype=np.int64),
        share=np.ones(len(markers)) / max(len(markers), 1),
        force_N=force_N,
        sd_N=sd_N,
        raw_N=force_N,
        raw_sd_N=sd_N,
        point_mm=point_mm,
        radius_mm=5.0,
        sd_mm=np.ones(2),
        moments_mm2=np.zeros(3),
        signal_px=1.0,
    )
