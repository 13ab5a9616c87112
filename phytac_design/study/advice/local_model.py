r"""Figures of designs near a judged one, quickly and without pixels, for slopes.

The bound is taken at some receptors only, as they stand along the sensor, with the paint that the
judged design shows, and how it shows when they turn, carried along by its receptors; gaps are
those of outlines. Where a change leaves the shell as it is (camera, heights, paint) the shell's
motion under the patches is held. Where it scales the modulus, motion goes with 1/E; where it
thickens the wall, with

    du/dt = -K⁻¹ (dK/dt · u)        K = E·(t·K_m + t³·K_b + t·K_s),

the change of what receptors add to t and E included, on the middle face as it stands.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.field_groups import values_of
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.assembly import assemble, make_pattern
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import (
    receptor_stiffness,
    sensor_model,
    unknown_receptors,
)
from phytac_design.mechanics.shell.sensitivity import motion_rate
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.cramer_rao import (
    ContactSignals,
    PositionPrior,
    cell_prior,
    contact_signals,
)
from phytac_design.simulation.response import point_motions
from phytac_design.study.advice.design_evaluation import EvaluatedDesign, force_figures, middle_of
from phytac_design.study.advice.outlines import gaps_px, ring_points
from phytac_design.study.advice.paint_transfer import CarriedPaint
from phytac_design.study.search.surrogate import FORCE_N
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

CONTACTS = 16
"""Receptors at which the bound is taken, at most."""
THICKER = 1e-4
"""Step of the wall for dK/dt, as a share."""
SHELL = ("feet", "stiffness")
"""What the shell's motion depends on; that short receptors stiffen less is left out."""


@dataclass(frozen=True, kw_only=True)
class Moved:
    """Motion of the wall under n markers, mm and rad.

    Attributes
    ----------
    touch : (7 c, n, 6) float
        Per newton on c receptors and at the places around them that slopes are taken from.
    press : (p, n, 6) float
        Under each press at the greatest force.
    """

    touch: FloatArray
    press: FloatArray

    def plus(self, share: float, other: "Moved") -> "Moved":
        """Sum with a share of another."""
        return Moved(touch=self.touch + share * other.touch, press=self.press + share * other.press)


@dataclass(frozen=True, kw_only=True)
class View:
    """What the cameras see of contacts on c receptors.

    Attributes
    ----------
    reads : (n,) int
        Camera that reads each marker.
    moved : Moved
        Motion of the wall.
    signals, prior : Signals, Prior
        For the bound; columns run over cameras, markers, x and y.
    middle : (c,) bool
        Contacts at the middle heights.
    """

    design: Design
    markers: Markers
    cameras: tuple[Camera, ...]
    reads: IntArray
    moved: Moved
    signals: ContactSignals
    prior: PositionPrior
    middle: BoolArray


class LocalModel:
    """Figures near a judged design.

    Parameters
    ----------
    base : Judged
        The design.
    accuracy : Accuracy
        Fineness of its mesh.
    """

    def __init__(self, base: EvaluatedDesign, accuracy: Accuracy) -> None:
        self.base, self.accuracy = base, accuracy
        self.paint = CarriedPaint(base)
        self.span = base.surface.domain
        self.solved: _Shell | None = None
        self.rate: Moved | None = None
        self.solves = 0

    def figures(
        self, design: Design, *, markers: Markers | None = None, held: bool = False
    ) -> dict[str, float]:
        """Force figures and gaps of a design like the base.

        Parameters
        ----------
        markers : Markers, optional
            Its markers, if they are known.
        held : bool
            Take the shell's motion as that of the base whatever moved; markers must be as many.

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

    def view(self, design: Design, *, markers: Markers | None = None, held: bool = False) -> "View":
        """What a design like the base shows of contacts on some of its receptors.

        Raises
        ------
        DesignError
            If its markers cannot be placed, or its camera cannot work.
        """
        surface = design.surface()
        own = make_markers(design, surface) if markers is None else markers
        cameras = cameras_of(design, surface)
        base = self.base
        like = (base.surface, base.markers) if held else (surface, own)
        contacts = contacts_of(*like)
        moved = self._base.moved if held else self._moved(design, surface, own)
        slopes, reads = self.paint.slopes(surface, own, cameras)

        def shifts(_uv: FloatArray, _radius_mm: FloatArray) -> FloatArray:
            each = [np.einsum("nij,cnj->cni", slope, moved.touch) for slope in slopes]
            return np.concatenate(each, axis=1)

        training = design.training
        radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        signals = contact_signals(surface, shifts, uv=own.uv[contacts], radius_mm=radius)
        prior = cell_prior(
            surface.area_mm2(),
            own.count,
            training.patch_radius_min_mm,
            training.patch_radius_max_mm,
        )
        return View(
            design=design,
            markers=own,
            cameras=cameras,
            reads=reads,
            moved=moved,
            signals=signals,
            prior=prior,
            middle=middle_of(surface, own)[contacts],
        )

    def gaps(self, view: "View") -> FloatArray:
        """Gaps (1 + p, n) at rest and under each press, each marker in its camera's picture."""
        markers = view.markers
        points = ring_points(view.design, markers)
        poses = [points]
        for press in view.moved.press:
            arm = points - markers.mid_mm[:, None]
            poses.append(points + point_motions(press[:, None], arm))
        out = np.full((len(poses), markers.count), np.inf)
        for number, camera in enumerate(view.cameras):
            own = np.flatnonzero(view.reads == number)
            for k, pose in enumerate(poses):
                out[k, own] = gaps_px(camera, pose[own], markers.colour[own])
        return out

    @property
    def _base(self) -> "_Shell":
        if self.solved is None:
            base = self.base
            self.solved = self._solve(base.design, base.surface, base.markers)
        return self.solved

    def _moved(self, design: Design, surface: Surface, markers: Markers) -> Moved:
        """Motion of a design's shell, held, scaled, by its slope, or solved."""
        base = self.base.design
        before, after = values_of(base, SHELL), values_of(design, SHELL)
        other = {name for name in before | after if before.get(name) != after.get(name)}
        if base.material.poisson == design.material.poisson:
            other -= {"material"}
        if not other <= {"wall.thickness_mm"}:
            return self._solve(design, surface, markers).moved
        moved = self._base.moved
        if other:
            if self.rate is None:
                self.rate = thickness_rate(base, self.base.markers, self._base, self.accuracy)
            moved = moved.plus(design.wall.thickness_mm - base.wall.thickness_mm, self.rate)
        softer = base.material.modulus_MPa / design.material.modulus_MPa
        return Moved(touch=softer * moved.touch, press=softer * moved.press)

    def _solve(self, design: Design, surface: Surface, markers: Markers) -> "_Shell":
        """Motion by finite elements."""
        self.solves += 1
        mesh = marker_mesh(
            surface,
            markers,
            thickness_mm=design.wall.thickness_mm,
            refine=self.accuracy.refine,
        )
        model = sensor_model(design, markers, mesh, receptors=_with_tubes(design, self.accuracy))
        training = design.training
        radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        touch: list[Any] = []

        def gather(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
            touch.append(patch_loads(mesh, surface, uv, radius_mm))
            return np.zeros((len(uv), 1, 2))

        uv = markers.uv[contacts_of(surface, markers)]
        contact_signals(surface, gather, uv=uv, radius_mm=radius)
        wide = training.patch_radius_max_mm
        press = patch_loads(mesh, surface, self._presses(surface), wide)
        loads = np.hstack([touch[0].toarray(), training.force_max_N * press.toarray()])
        motion = model.solve(loads).motion
        return _Shell(mesh=mesh, model=model, motion=motion, touches=touch[0].shape[1])

    def _presses(self, surface: Surface) -> FloatArray:
        """The judged design's presses, at the same shares of another's chart."""
        low, width = self.span[:, 0], np.ptp(self.span, axis=1)
        new = surface.domain
        return np.asarray(new[:, 0] + (self.base.load["uv"] - low) / width * np.ptp(new, axis=1))


@dataclass(frozen=True, kw_only=True)
class _Shell:
    """A solved shell: motion (N, 6, m), of which the first ``touches`` loads are per newton."""

    mesh: ShellMesh
    model: ShellModel
    motion: FloatArray
    touches: int

    @property
    def moved(self) -> Moved:
        """Motion under the markers."""
        return self.part(self.motion)

    def part(self, motion: FloatArray) -> Moved:
        """The same of another field of the same loads."""
        at = np.moveaxis(motion[self.mesh.marker_nodes], 2, 0)
        return Moved(touch=at[: self.touches], press=at[self.touches :])


def _with_tubes(design: Design, accuracy: Accuracy) -> bool:
    return accuracy.receptors and not unknown_receptors(design)


def thickness_rate(design: Design, markers: Markers, shell: _Shell, accuracy: Accuracy) -> Moved:
    """Motion per mm of wall, the middle face held."""
    mesh, model = shell.mesh, shell.model
    thickness, modulus = design.wall.thickness_mm, design.material.modulus_MPa
    parts = []
    for sign in (1.0, -1.0):
        t: Any = thickness * (1.0 + sign * THICKER)
        E: Any = modulus
        if _with_tubes(design, accuracy):
            wall = design.wall.model_copy(update={"thickness_mm": t})
            thick = design.model_copy(update={"wall": wall})
            factors = receptor_stiffness(thick, markers, mesh)
            t, E = factors.section(thickness_mm=t, modulus_MPa=E)
        parts.append(model.elements.combine(modulus_MPa=E, thickness_mm=t))
    slope = (parts[0] - parts[1]) / (2.0 * THICKER * thickness)
    rate = assemble(make_pattern(model.quads, len(model.nodes_mm)), slope)
    return shell.part(motion_rate(model, rate, shell.motion))


def contacts_of(surface: Surface, markers: Markers) -> IntArray:
    """Receptors to take the bound at: one of each row where rows are alike, else some along u."""
    if markers.lattice is not None:
        order = np.flatnonzero(markers.column == 0)
    else:
        order = np.argsort(surface.unwrap(markers.uv)[:, 1], kind="stable")
    pick = np.linspace(0, len(order) - 1, min(CONTACTS, len(order)))
    return np.asarray(order[np.unique(np.rint(pick).astype(np.int64))])
