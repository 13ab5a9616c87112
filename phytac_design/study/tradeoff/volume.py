"""The volume error of a setting: what facets cut off the printed shell.

Facets of a chordal tolerance t change the volume by about k·t. Two coarse meshes give k; the audit
holds the setting's own mesh against the limit of two fine ones.
"""

from functools import cached_property

from phytac_design.design.accuracy import Accuracy
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.study.tradeoff.force import ForceError

COARSE_mm = (0.2, 0.1)
"""Tolerances of the pilot's meshes."""
FINE_mm = (0.01, 0.005)
"""Tolerances of the audit's."""
SAFETY = 1.5
"""Factor on predicted errors: facets come in whole numbers."""


class VolumePilot:
    """Volume errors of settings on one design.

    Parameters
    ----------
    error : ForceError
        The design, its surface and its markers.
    """

    def __init__(self, error: ForceError) -> None:
        self.error = error
        self._volumes: dict[float, float] = {}

    def volume_mm3(self, tolerance_mm: float) -> float:
        """Volume of the printed shell."""
        if tolerance_mm not in self._volumes:
            error = self.error
            solid = shell_manifold(
                error.design, error.surface, error.markers, tolerance_mm=tolerance_mm
            )
            self._volumes[tolerance_mm] = float(solid.volume())
        return self._volumes[tolerance_mm]

    @cached_property
    def _slope(self) -> float:
        """Relative change of the volume per mm of tolerance."""
        first, second = (self.volume_mm3(t) for t in COARSE_mm)
        return abs(first - second) / (COARSE_mm[0] - COARSE_mm[1]) / second

    def predict(self, setting: Accuracy) -> float:
        """Relative error, with its safety."""
        return SAFETY * self._slope * setting.cad_tolerance_mm

    def achieved(self, setting: Accuracy) -> float:
        """Relative error against the limit of two fine meshes."""
        first, second = (self.volume_mm3(t) for t in FINE_mm)
        limit = second + (second - first) / (FINE_mm[0] / FINE_mm[1] - 1.0)
        return abs(self.volume_mm3(setting.cad_tolerance_mm) / limit - 1.0)
