"""Predicted errors of a setting, from small solves on the design itself, and the audit of each.

The force error has three factors, each found where it is cheap, and multiplied contact by contact:

- the mesh: the setting's own against linear theory on an infinitely fine one;
- the theory: linear or a series against large displacements, both on one coarse mesh;
- the tables: rows interpolated between tabulated places against the rows themselves, on that mesh.

The visibility error is the largest difference in the clearance that markers keep when each standard
contact presses alone. The volume error is proportional to the chordal tolerance; two coarse meshes
give the factor.
"""

from collections.abc import Sequence
from functools import cache, cached_property, partial
from typing import Protocol

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.engine.stage import Context
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.optics.loaded_visibility import LoadedVisibility, visibility_under_load
from phytac_design.optics.render_scene import build_scene
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.study.tradeoff.force import ForceError, fit_forces, rms
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


class Pilot(Protocol):
    """Errors of settings on one design."""

    def predict(self, setting: Accuracy) -> float:
        """Predicted error, with a safety factor."""

    def achieved(self, setting: Accuracy) -> float:
        """Error against the reference."""


class ForcePilot:
    """Relative force errors, root mean square over the standard contacts.

    Parameters
    ----------
    error : ForceError
        Of the design.
    safety : float
        Factor on predicted errors; 0.9 to 1.2 was needed on domes, grips and a patch.
    """

    def __init__(self, error: ForceError, safety: float = 1.25) -> None:
        self.error, self.safety = error, safety
        self.mesh = cache(self._mesh)
        self.theory = cache(self._theory)
        self.tables = cache(self._tables)

    def _mesh(self, refine: int, receptors: bool) -> FloatArray:
        """Estimated over true force (c,), for the mesh alone."""
        rows = self.error.linear_rows(refine, receptors=receptors)
        return fit_forces(rows[:, None], self.error.linear_reference)

    @cached_property
    def _large_px(self) -> FloatArray:
        return self.error.large(*self.error.shell(self.error.pilot_refine, receptors=True)).shift_px

    def _theory(self, orders: int) -> FloatArray:
        """The same for the theory alone; NaN for contacts without a solution."""
        rows = self.error.rows(self.error.pilot_refine, receptors=True, orders=orders)
        return fit_forces(rows, self._large_px) / self.error.contacts.force_N

    def _tables(self, share: float) -> FloatArray:
        """The same for the interpolation between places alone."""
        exact = self.error.rows(self.error.pilot_refine, receptors=True, orders=1)[:, 0]
        between = self.error.between(self.error.pilot_refine, share, receptors=True)
        return fit_forces(between[:, None], exact)

    def alone(self, name: str, setting: Accuracy) -> float:
        """Root mean square error of one field of the settings, everything else being ideal."""
        if name in {"refine", "receptors"}:
            refine = setting.refine if name == "refine" else self.error.pilot_refine
            ratio = self.mesh(refine, setting.receptors)
        elif name == "place_share":
            ratio = self.tables(setting.place_share)
        else:
            ratio = self.theory(setting.place_orders)
        return rms(ratio[np.isfinite(ratio)] - 1.0)

    def predict(self, setting: Accuracy) -> float:
        """Predicted error, with its safety factor."""
        ratio = (
            self.mesh(setting.refine, setting.receptors)
            * self.theory(setting.place_orders)
            * self.tables(setting.place_share)
        )
        return self.safety * rms(ratio[np.isfinite(ratio)] - 1.0)

    def achieved(self, setting: Accuracy) -> float:
        """Error against the reference."""
        return rms(self.error.errors(setting))


class VolumePilot:
    """Relative errors of the printed shell's volume."""

    def __init__(self, error: ForceError) -> None:
        self.volume_mm3 = cache(
            lambda mm: float(shell_manifold(error.sensor, tolerance_mm=mm).volume())
        )

    def predict(self, setting: Accuracy) -> float:
        """Predicted error; the factor of 1.5 covers facets of whole numbers."""
        first, second = self.volume_mm3(0.2), self.volume_mm3(0.1)
        return 1.5 * abs(first - second) / 0.1 / second * setting.cad_tolerance_mm

    def achieved(self, setting: Accuracy) -> float:
        """Error against the limit of two fine meshes."""
        first, second = self.volume_mm3(0.01), self.volume_mm3(0.005)
        return abs(self.volume_mm3(setting.cad_tolerance_mm) / (2.0 * second - first) - 1.0)


class VisibilityPilot:
    """Largest differences in marker clearance: mesh and theory of the stage ``underload``."""

    def __init__(self, error: ForceError) -> None:
        self.error = error
        self.coarse = cache(lambda: self.pressed(error.truth(error.reference_refines[0]).motion))
        self.fine = cache(lambda: self.pressed(error.reference.motion))
        self.clearance = cache(self._clearance)

    def predict(self, setting: Accuracy) -> float:
        """Difference from a coarse reference; 0.002 is a pixel more or less on a small marker."""
        return 0.002 + 1.3 * self._difference(setting, self.coarse())

    def achieved(self, setting: Accuracy) -> float:
        """Difference from the reference."""
        return self._difference(setting, self.fine())

    def _difference(self, setting: Accuracy, reference: FloatArray) -> float:
        own = self.clearance(setting.refine, setting.receptors, setting.press_tolerance)
        gap = np.abs(own - reference)
        if not np.isfinite(gap).any():
            raise NumericalError(
                "contacts-not-solved",
                "no standard contact could be solved and seen; run `phytac check` on the design",
            )
        return float(np.nanmax(gap))

    def _clearance(self, refine: int, receptors: bool, tolerance: float) -> FloatArray:
        """Clearance (c, n) of markers by the motion that the stage computes."""
        mesh, model = self.error.shell(refine, receptors=receptors)
        loads, shell = self.error.loads(mesh), QuasiNewtonSolver(model)
        motion = np.full((loads.shape[1], self.error.sensor.markers.count, 6), np.nan)
        for k, force in enumerate(self.error.contacts.force_N.tolist()):
            load = force * loads[:, k]
            found: FloatArray | None = shell.linear(load) if tolerance >= 1.0 else None
            if tolerance < 1.0:
                found = shell.solve(load, tolerance=tolerance).motion
            if found is not None:
                motion[k] = found.reshape(-1, 6)[mesh.marker_nodes]
        return self.pressed(motion)

    def pressed(self, motion: FloatArray) -> FloatArray:
        """Clearance (c, n) of markers under each contact, by their motion (c, n, 6)."""
        sensor, readers = self.error.sensor, self.error.imaging.readers
        forces, markers = self.error.contacts.force_N, sensor.markers
        out = np.full((len(motion), markers.count), np.nan)
        for number, camera in enumerate(readers.cameras):
            own = readers.read_by == number
            if not own.any():
                continue
            scene = build_scene(sensor, tolerance_mm=tolerance_mm(camera, markers))
            look = partial(
                visibility_under_load, scene, camera, pivots_mm=markers.mid_mm, counted=own
            )
            rest = look(motions=motion[:0, None], forces_N=forces[:1])
            for k in np.flatnonzero(np.isfinite(motion).all(axis=(1, 2))).tolist():
                loaded = look(motions=motion[k][None, None], forces_N=forces[k : k + 1])
                out[k, own] = clearance_between(loaded, rest)[own]
        return out


def relative_clearance(
    fraction: FloatArray, gaps_px: Sequence[FloatArray], rest_px: Sequence[FloatArray]
) -> FloatArray:
    """Clearance (n,) that each marker keeps: 1 is undisturbed, 0 hidden or fused.

    The minimum of its visible fraction and of its gaps over those at rest. The minimum over all
    markers would not do as a figure: a few presses at the tightest place find it.

    Parameters
    ----------
    fraction : (n,) float
        Visible fraction under load.
    gaps_px, rest_px : each (n,) float
        Gaps to markers of its own colour and of others, under load and at rest. Gaps that are
        infinite (no such marker) or zero at rest are ignored.
    """
    out = np.array(fraction, dtype=np.float64)
    for gap, rest in zip(gaps_px, rest_px, strict=True):
        known = np.isfinite(rest) & (rest > 0.0)
        out = np.minimum(out, np.divide(gap, rest, out=np.ones_like(out), where=known))
    return out


def clearance_between(loaded: LoadedVisibility, rest: LoadedVisibility) -> FloatArray:
    """Clearance (n,) of each marker over all presses of one result, from one at rest."""
    return relative_clearance(
        loaded.least_fraction,
        (loaded.least_gap_same_px, loaded.least_gap_other_px),
        (rest.least_gap_same_px, rest.least_gap_other_px),
    )


def built_clearance(context: Context) -> FloatArray:
    """Clearance that markers keep over all presses of the stage ``underload``.

    Of each marker (n,); where one symmetric sector was pressed, the minimum of each row (rows,).
    """
    rest, loaded = context.arrays("views"), context.arrays("underload")
    out = relative_clearance(
        loaded["least_fraction"],
        (loaded["least_gap_same_px"], loaded["least_gap_other_px"]),
        (rest["gap_same_colour_px"], rest["gap_other_colour_px"]),
    )
    if not context.facts("underload")["sector_only"]:
        return out
    _, row = np.unique(context.markers.row, return_inverse=True)
    minimum = np.full(int(row.max()) + 1, np.inf)
    np.minimum.at(minimum, row, out)
    return minimum


def visibility_error(clearance: Sequence[float], finest: Sequence[float]) -> float:
    """Largest difference in the clearance that any marker (or row) keeps."""
    return float(np.abs(np.subtract(clearance, finest)).max(initial=0.0))
