"""What a setting's force error will be, from small solves of the design itself.

Three errors of each standard contact are found apart, each where it is cheap, and multiplied:

- the mesh: the setting's own against linear theory on an endlessly fine one;
- the theory: linear or a series against large displacements, both on one coarse mesh;
- the places: the cubic between tabulated rows against the row itself, on that mesh too.

No large displacement is solved on a fine mesh, and no table is made. What is not known this way
(errors of one that depend on another, the pilot's own mesh) is what the safety is for.
"""

from functools import cached_property

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.study.tradeoff.force import COARSE, ForceError, read_forces, rms
from phytac_shapes.arrays import FloatArray

SAFETY = 1.25
"""Factor on predicted force errors; 0.9 to 1.2 was needed on domes, grips and a patch."""


class ForcePilot:
    """Predicted force errors of settings on one design.

    Parameters
    ----------
    error : ForceError
        The design's standard contacts and solves; what is solved here is not solved again there.
    """

    def __init__(self, error: ForceError) -> None:
        self.error = error
        self._theory: dict[int, FloatArray] = {}
        self._places: dict[float, FloatArray] = {}

    def mesh(self, refine: int, *, receptors: bool) -> FloatArray:
        """Force read over the true one (c,), for the mesh alone."""
        rows = self.error.rows(refine, receptors=receptors, orders=1).shift_px
        return read_forces(rows, self.error.linear_reference)

    @cached_property
    def _large(self) -> FloatArray:
        return self.error.own_large(COARSE).shift_px

    def theory(self, orders: int) -> FloatArray:
        """The same for the theory alone; NaN for contacts that were not solved."""
        if orders not in self._theory:
            rows = self.error.rows(COARSE, receptors=True, orders=orders).shift_px
            out = np.full(len(rows), np.nan)
            good = np.isfinite(self._large).all(axis=1)
            out[good] = read_forces(rows[good], self._large[good])
            self._theory[orders] = out / self.error.contacts.force_N
        return self._theory[orders]

    def places(self, share: float) -> FloatArray:
        """The same for the cubic between places alone."""
        if share not in self._places:
            exact = self.error.rows(COARSE, receptors=True, orders=1).shift_px[:, 0]
            between = self.error.between(COARSE, share, receptors=True)
            self._places[share] = read_forces(between[:, None], exact)
        return self._places[share]

    def alone(self, knob: str, setting: Accuracy) -> float:
        """Root mean square error that one knob makes, all else being ideal."""
        if knob in {"refine", "receptors"}:
            refine = setting.refine if knob == "refine" else COARSE
            read = self.mesh(refine, receptors=setting.receptors)
        elif knob == "place_share":
            read = self.places(setting.place_share)
        else:
            read = self.theory(setting.place_orders)
        return rms(read[np.isfinite(read)] - 1.0)

    def predict(self, setting: Accuracy) -> float:
        """Root mean square of the relative force error, with its safety."""
        product = (
            self.mesh(setting.refine, receptors=setting.receptors)
            * self.theory(setting.place_orders)
            * self.places(setting.place_share)
        )
        return SAFETY * rms(product[np.isfinite(product)] - 1.0)
