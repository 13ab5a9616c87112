"""Fast approximate figures of designs near an evaluated one, without pixels, for sensitivities.

The bound is taken at a few receptors along the sensor, with the paint of the evaluated design
transferred; gaps are those of outlines. Where a change leaves the shell as it is (camera, heights,
paint) the wall's motion is reused; where it scales the modulus, motion is scaled by 1/E; otherwise
the shell is solved again.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.field_groups import values_of
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.simulation.cramer_rao import (
    ContactSignals,
    PositionPrior,
    cell_prior,
    contact_signals,
)
from phytac_design.simulation.linear_response import point_motions
from phytac_design.study.advice.design_evaluation import EvaluatedDesign, force_figures, middle_of
from phytac_design.study.advice.outlines import gaps_px
from phytac_design.study.advice.paint_transfer import PaintTransfer
from phytac_design.study.search.fidelity_levels import band_rings
from phytac_design.study.search.surrogate import FORCE_N
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class MarkerWallMotion:
    """Motion of the wall under n markers, mm and rad.

    Attributes
    ----------
    touch : (7 c, n, 6) float
        Per newton on c receptors and at the finite-difference places around them.
    press : (p, n, 6) float
        Under each press at the greatest force.
    """

    touch: FloatArray
    press: FloatArray


@dataclass(frozen=True, kw_only=True)
class ContactView:
    """What the cameras see of contacts on c receptors.

    Attributes
    ----------
    camera_of : (n,) int
        Camera that reads each marker.
    motion : MarkerWallMotion
        Motion of the wall.
    signals, prior : Signals, Prior
        For the bound; columns run over cameras, markers, x and y.
    middle : (c,) bool
        Contacts at the middle heights.
    """

    design: Design
    markers: Markers
    cameras: tuple[Camera, ...]
    camera_of: IntArray
    motion: MarkerWallMotion
    signals: ContactSignals
    prior: PositionPrior
    middle: BoolArray


class LocalModel:
    """Approximate figures near an evaluated design, with a mesh of some accuracy."""

    def __init__(self, base: EvaluatedDesign, accuracy: Accuracy) -> None:
        self.base, self.accuracy = base, accuracy
        self.paint = PaintTransfer(base)
        self.solves = 0

    def figures(
        self, design: Design, *, markers: Markers | None = None, held: bool = False
    ) -> dict[str, float]:
        """Force figures and gaps of a design near the base.

        Parameters
        ----------
        markers : Markers, optional
            Its markers, if they are known.
        held : bool
            Reuse the wall motion of the base whatever changed; needs equally many markers.

        Raises
        ------
        DesignError
            If its markers cannot be placed, or its camera cannot work.
        """
        view = self.view(design, markers=markers, held=held)
        noise = design.camera.noise_centroid_px
        bound = view.signals.bound(FORCE_N, noise_px=noise, prior=view.prior)
        gaps = self.gaps(view)
        return force_figures(bound.force_N, view.middle) | {
            "gap_px": float(gaps[0].min()),
            "load_gap_px": float(gaps.min()),
        }

    def view(
        self, design: Design, *, markers: Markers | None = None, held: bool = False
    ) -> ContactView:
        """View of contacts on some receptors; arguments and errors as :meth:`figures`."""
        surface, base = design.surface(), self.base
        own = make_markers(design, surface) if markers is None else markers
        cameras = cameras_of(design, surface)
        contacts = contacts_of(base.surface, base.markers) if held else contacts_of(surface, own)
        motion = self._base_motion if held else self._motion(design, surface, own)
        slopes, camera_of = self.paint.slopes(surface, own, cameras)

        def shifts(_uv: FloatArray, _radius_mm: FloatArray) -> FloatArray:
            each = [np.einsum("nij,cnj->cni", slope, motion.touch) for slope in slopes]
            return np.concatenate(each, axis=1)

        low, high = design.training.patch_radius_min_mm, design.training.patch_radius_max_mm
        return ContactView(
            design=design,
            markers=own,
            cameras=cameras,
            camera_of=camera_of,
            motion=motion,
            signals=contact_signals(
                surface, shifts, uv=own.uv[contacts], radius_mm=(low + high) / 2.0
            ),
            prior=cell_prior(surface.area_mm2(), own.count, low, high),
            middle=middle_of(surface, own)[contacts],
        )

    def gaps(self, view: ContactView) -> FloatArray:
        """Gaps (1 + p, n) at rest and under each press, each marker in its camera's image."""
        markers = view.markers
        points = band_rings(view.design, markers)
        arm = points - markers.mid_mm[:, None]
        poses = [points]
        poses += [points + point_motions(press[:, None], arm) for press in view.motion.press]
        out = np.full((len(poses), markers.count), np.inf)
        for number, camera in enumerate(view.cameras):
            own = np.flatnonzero(view.camera_of == number)
            for k, pose in enumerate(poses):
                out[k, own] = gaps_px(camera, pose[own], markers.colour[own])
        return out

    @cached_property
    def _base_motion(self) -> MarkerWallMotion:
        return self._solve(self.base.design, self.base.surface, self.base.markers)

    def _motion(self, design: Design, surface: Surface, markers: Markers) -> MarkerWallMotion:
        """Wall motion of a design: reused, scaled by the modulus, or solved."""
        base = self.base.design
        # That short receptors stiffen the wall less is neglected.
        before, after = (values_of(one, ("feet", "stiffness")) for one in (base, design))
        changed = {name for name in before | after if before.get(name) != after.get(name)}
        if base.material.poisson == design.material.poisson:
            changed -= {"material"}
        if changed:
            return self._solve(design, surface, markers)
        softer = base.material.modulus_MPa / design.material.modulus_MPa
        motion = self._base_motion
        return MarkerWallMotion(softer * motion.touch, softer * motion.press)

    def _solve(self, design: Design, surface: Surface, markers: Markers) -> MarkerWallMotion:
        """Wall motion by finite elements."""
        self.solves += 1
        thickness, training = design.wall.thickness_mm, design.training
        mesh = marker_mesh(surface, markers, thickness_mm=thickness, refine=self.accuracy.refine)
        tubes = self.accuracy.receptors and not unknown_receptors(design)
        model = sensor_model(design, markers, mesh, receptors=tubes)
        touch: list[Any] = []

        def gather(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
            touch.append(patch_loads(mesh, surface, uv, radius_mm))
            return np.zeros((len(uv), 1, 2))

        radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        uv = markers.uv[contacts_of(surface, markers)]
        contact_signals(surface, gather, uv=uv, radius_mm=radius)
        # The base's presses, at the same shares of this surface's domain.
        old, new = self.base.surface.domain, surface.domain
        share = (self.base.load["uv"] - old[:, 0]) / np.ptp(old, axis=1)
        presses = np.asarray(new[:, 0] + share * np.ptp(new, axis=1))
        press = patch_loads(mesh, surface, presses, training.patch_radius_max_mm)
        loads = np.hstack([touch[0].toarray(), training.force_max_N * press.toarray()])
        at = np.moveaxis(model.solve(loads).motion[mesh.marker_nodes], 2, 0)
        touches = touch[0].shape[1]
        return MarkerWallMotion(at[:touches], at[touches:])


def contacts_of(surface: Surface, markers: Markers) -> IntArray:
    """Up to 16 receptors to take the bound at: one of each row of a lattice, else some along u."""
    if markers.lattice is not None:
        order = np.flatnonzero(markers.column == 0)
    else:
        order = np.argsort(surface.unwrap(markers.uv)[:, 1], kind="stable")
    pick = np.linspace(0, len(order) - 1, min(16, len(order)))
    return np.asarray(order[np.unique(np.rint(pick).astype(np.int64))])
