"""The visibility error of a setting: how wrongly its mechanics hide markers from the camera.

Each standard contact presses alone; the figure is the room that each marker keeps then
(:mod:`room`), and the error its greatest difference, over contacts and markers, from the
reference's. In it: mesh and theory of the stage ``underload``. Not in it: how many places that
stage presses.
"""

from functools import partial

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.optics.loaded_visibility import press_all
from phytac_design.optics.scene import build_scene
from phytac_design.study.tradeoff.force import REFERENCE, ForceError
from phytac_design.study.tradeoff.room import room_between
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

SAFETY = 1.3
"""Factor on predicted differences."""
FLOOR = 0.002
"""Least predicted difference: a pixel more or less on a small marker."""


class SightPilot:
    """Visibility errors of settings on one design.

    Parameters
    ----------
    error : ForceError
        The design's standard contacts and solves.
    """

    def __init__(self, error: ForceError) -> None:
        self.error = error
        self._own: dict[tuple[int, bool, float], FloatArray] = {}
        self._true: dict[bool, FloatArray] = {}

    def predict(self, setting: Accuracy) -> float:
        """Greatest difference from a coarse reference, with its safety."""
        found = self._differences(setting, extrapolated=False)
        return FLOOR + SAFETY * found

    def achieved(self, setting: Accuracy) -> float:
        """Greatest difference from the reference."""
        return self._differences(setting, extrapolated=True)

    def _differences(self, setting: Accuracy, *, extrapolated: bool) -> float:
        if extrapolated not in self._true:
            true = self.error.reference if extrapolated else self.error.truth(REFERENCE[0])
            self._true[extrapolated] = self.room(true.motion)
        key = (setting.refine, setting.receptors, setting.press_tolerance)
        if key not in self._own:
            self._own[key] = self.room(self.motion(setting))
        gap = np.abs(self._own[key] - self._true[extrapolated])
        if not np.isfinite(gap).any():
            raise NumericalError(
                "no standard contact could be solved and seen; run `phytac check` on the design"
            )
        return float(np.nanmax(gap))

    def motion(self, setting: Accuracy) -> FloatArray:
        """Motion (c, n, 6) of the middle face under each marker, as the stage takes it."""
        error = self.error
        mesh, model = error.shell(setting.refine, receptors=setting.receptors)
        loads, shell = error.loads(mesh), QuasiNewtonSolver(model)
        out = np.full((loads.shape[1], error.markers.count, 6), np.nan)
        tolerance = setting.press_tolerance
        for k, force in enumerate(error.contacts.force_N.tolist()):
            load = force * loads[:, k]
            if tolerance >= 1.0:
                found: FloatArray | None = shell.linear(load)
            else:
                found = shell.solve(load, tolerance=tolerance).sample.motion
            if found is not None:
                out[k] = found.reshape(-1, 6)[mesh.marker_nodes]
        return out

    def room(self, motion: FloatArray) -> FloatArray:
        """Room (c, n) that each marker keeps under each contact; NaN where not solved."""
        error = self.error
        markers, readers = error.markers, error.see.readers
        out = np.full((len(motion), markers.count), np.nan)
        for number, camera in enumerate(readers.cameras):
            own = readers.read_by == number
            if not own.any():
                continue
            tolerance = tolerance_mm(camera, markers)
            look = partial(
                press_all,
                build_scene(error.design, error.surface, markers, tolerance_mm=tolerance),
                camera,
                pivots_mm=markers.mid_mm,
                counted=own,
            )
            forces = error.contacts.force_N
            rest = look(motions=motion[:0, None], forces_N=forces[:1])
            for k in np.flatnonzero(np.isfinite(motion).all(axis=(1, 2))).tolist():
                loaded = look(motions=motion[k][None, None], forces_N=forces[k : k + 1])
                out[k, own] = room_between(loaded, rest)[own]
        return out
