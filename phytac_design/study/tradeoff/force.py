"""The force error of a setting: what its mechanics misread on the standard contacts.

The reference is the shell under large displacement, without noise, extrapolated from two meshes
that are not nested in any setting's. It moves the markers' images by d. A setting knows, for a
contact at a place, the shifts f·S₁ + f²·S₂ + f³·S₃ of its own mesh and theory
(:mod:`phytac_design.simulation.response_tables`), and reads the force f that explains d best. The error is the
root mean square of f/f_true − 1.

In this figure: the mesh, receptors, the theory, and the cubic between tabulated places. Not in it:
noise, the search for place, size and number of contacts, the print's scatter, networks.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phytac_decoder.mechanics.response_table import FIT_PLACES, ResponseTable
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import Readers, cameras_of
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.compliance import turns_of
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads, tangent_frame
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.pressed_series import DiscResponse, ImageResponse
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_design.simulation.response import turned_points
from phytac_design.simulation.response_tables import interpolate_responses, place_spacing_mm, rings
from phytac_design.study.tradeoff.contacts import StandardContacts, standard_contacts
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError

NEWTON_STEPS = 30
"""Of the fit of one force; four are common."""
COARSE = 4
"""Elements per marker pitch of the finest mesh that the cubic between places is looked at on."""
REFERENCE = (5, 9)
"""Elements per marker pitch of the two meshes that the reference is extrapolated from; their errors
fall with the square of that number (a third mesh of 13 is met within 0.1 %)."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Images under the standard contacts, by the reference.

    Attributes
    ----------
    shift_px : (c, 2n) float
        Shifts of the markers' images; NaN for contacts that were not solved.
    motion : (c, n, 6) float
        Motion of the middle face under each marker; likewise.
    nodes : int
        Of the mesh.
    """

    shift_px: FloatArray
    motion: FloatArray
    nodes: int

    @property
    def solved(self) -> IntArray:
        """Rows (s,) of contacts that were solved."""
        return np.flatnonzero(np.isfinite(self.shift_px).all(axis=1))


@dataclass(frozen=True, kw_only=True)
class Rows:
    """What a setting's mechanics expect of the standard contacts.

    Attributes
    ----------
    shift_px : (c, k, 2n) float
        S₁ … S_k at each contact's own place, px per N, N², ….
    nodes : int
        Of the mesh.
    """

    shift_px: FloatArray
    nodes: int


class ForceError:
    """Force errors of any setting on one design; meshes are solved when they are first asked for.

    Parameters
    ----------
    design : Design
        The sensor.
    count : int, optional
        Standard contacts.
    """

    def __init__(self, design: Design, *, count: int | None = None) -> None:
        self.design = design
        self._count = count
        self._truths: dict[int, Truth] = {}
        self._rows: dict[tuple[int, bool, int], Rows] = {}
        self._between: dict[tuple[int, bool, float], FloatArray] = {}

    @cached_property
    def surface(self) -> Surface:
        """The sensing surface."""
        return self.design.surface()

    @cached_property
    def markers(self) -> Markers:
        """The markers on it."""
        return make_markers(self.design, self.surface)

    @cached_property
    def contacts(self) -> StandardContacts:
        """The standard contacts."""
        if self._count is None:
            return standard_contacts(self.design, self.surface)
        return standard_contacts(self.design, self.surface, self._count)

    @cached_property
    def see(self) -> ImageResponse:
        """What the cameras see of motion; the paint is taken at the tips, no view is rendered."""
        markers = self.markers
        cameras = cameras_of(self.design, self.surface)
        away = [np.linalg.norm(markers.tip_mm - c.position_mm, axis=1) for c in cameras]
        readers = Readers(cameras=cameras, read_by=np.argmin(np.stack(away), axis=0))
        return ImageResponse(readers, markers.mid_mm, markers.tip_mm - markers.mid_mm)

    def truth(self, refine: int) -> Truth:
        """Images under the standard contacts on a mesh that no setting nests in.

        Raises
        ------
        NumericalError
            If not even half of the contacts can be solved.
        """
        if refine not in self._truths:
            mesh, model = truth_shell(self.design, self.surface, refine)
            self._truths[refine] = self._large(mesh, model)
        return self._truths[refine]

    def loaded(self, refine: int) -> tuple[ShellMesh, ShellModel, FloatArray]:
        """Mesh and model of the simulated sensor, and a newton on each contact, (6N, c)."""
        mesh, model = truth_shell(self.design, self.surface, refine)
        return mesh, model, self.loads(mesh)

    def loads(self, mesh: ShellMesh) -> FloatArray:
        """Return a newton on each contact, (6N, c)."""
        hole = self.design.receptor.diameter_hole_mm / 2.0
        holes = Holes.of(self.surface, self.markers.uv, hole)
        loads = indentation_loads(mesh, self.surface, self.contacts.touches, holes=holes)
        return np.asarray(loads.toarray())

    def _large(self, mesh: ShellMesh, model: ShellModel) -> Truth:
        contacts, receptor = self.contacts, self.design.receptor
        feet = ReceptorKinematics(
            mesh, self.surface, self.markers.uv, receptor.diameter_outer_mm / 2.0
        )
        loads = self.loads(mesh)
        linear = model.solve(loads).motion.reshape(loads.shape)
        shell = QuasiNewtonSolver(model)
        motion = np.full((len(contacts.uv), self.markers.count, 6), np.nan)
        for k, force in enumerate(contacts.force_N.tolist()):
            found = shell.solve(force * loads[:, k], linear=force * linear[:, k]).sample
            if found.motion is not None:
                motion[k] = feet.large(found.motion)
        good = np.isfinite(motion).all(axis=(1, 2))
        if 2 * int(good.sum()) < len(good):
            raise NumericalError(
                f"only {int(good.sum())} of the {len(good)} standard contacts can be solved with "
                "large displacements; lower training.force_max_N or raise wall.thickness_mm"
            )
        see = self.see
        shift = np.full((len(motion), 2 * self.markers.count), np.nan)
        for k in np.flatnonzero(good).tolist():
            moved = see.watched + turned_points(motion[k], see.arm_mm)
            shift[k] = (see.readers.project(moved) - see.rest).ravel()
        return Truth(shift_px=shift, motion=motion, nodes=len(mesh.nodes_mm))

    def shell(self, refine: int, *, receptors: bool) -> tuple[ShellMesh, ShellModel]:
        """Mesh and model that a build of these settings decodes with."""
        mesh = marker_mesh(
            self.surface,
            self.markers,
            thickness_mm=self.design.wall.thickness_mm,
            refine=refine,
        )
        known = receptors and not unknown_receptors(self.design)
        return mesh, sensor_model(self.design, self.markers, mesh, receptors=known)

    def rows(self, refine: int, *, receptors: bool, orders: int) -> Rows:
        """What a build's tables would hold at the contacts' own places."""
        key = (refine, receptors, orders)
        if key not in self._rows:
            mesh, model = self.shell(refine, receptors=receptors)
            shell = self._pressed(mesh, model, orders)
            motions = shell.motions(self.contacts.uv, self.contacts.radius_mm)
            out = np.zeros((len(motions), orders, 2 * self.markers.count))
            for k, own in enumerate(motions):
                out[k, : len(own)] = self.see.powers(own, shell.forces)
            self._rows[key] = Rows(shift_px=out, nodes=len(mesh.nodes_mm))
        return self._rows[key]

    def _pressed(self, mesh: ShellMesh, model: ShellModel, orders: int) -> DiscResponse:
        return DiscResponse(
            self.design, self.surface, self.markers, mesh=mesh, model=model, orders=orders
        )

    def between(self, refine: int, share: float, *, receptors: bool) -> FloatArray:
        """S₁ (c, 2n) at the contacts as cubics between tabulated places have it."""
        key = (refine, receptors, share)
        if key not in self._between:
            self._between[key] = self._interpolated(refine, share, receptors=receptors)
        return self._between[key]

    def _interpolated(self, refine: int, share: float, *, receptors: bool) -> FloatArray:
        mesh, model = self.shell(refine, receptors=receptors)
        columns = self.markers.lattice.columns if self.markers.lattice else 1
        sectors, _ = turns_of(model, mesh, columns)
        radius = self.contacts.radius_mm
        ring = rings(self.surface, place_spacing_mm(self.surface, share, radius), sectors)
        along, around = tangent_frame(self.surface, ring.uv)
        point = self.surface.point(ring.uv)
        wanted = self.surface.point(self.contacts.uv)
        local, base = [], []
        for target in wanted:
            near = np.argsort(np.linalg.norm(point - target, axis=1), kind="stable")[
                : 3 * FIT_PLACES
            ]
            bare = ResponseTable(
                point_mm=point[near],
                along=along[near],
                around=around[near],
                shift_px=np.zeros((len(near), 1, 0), dtype=np.float32),
                radius_mm=radius,
            )
            at = int(bare.nearest(target[None])[0])
            local.append((near, bare))
            base.append(near[bare.fits[0][at]])
        needed = np.unique(np.concatenate(base))
        shell = self._pressed(mesh, model, 1)
        solved = np.zeros((len(point), 2 * self.markers.count), dtype=np.float32)
        motions = shell.motions(ring.uv[needed], radius)
        solved[needed] = [self.see.powers(own, shell.forces)[0] for own in motions]
        out = np.zeros((len(wanted), 2 * self.markers.count))
        for k, (near, bare) in enumerate(local):
            filled = ResponseTable(
                point_mm=bare.point_mm,
                along=bare.along,
                around=bare.around,
                shift_px=solved[near][:, None],
                radius_mm=radius,
            )
            out[k] = interpolate_responses(filled, wanted[k][None])[0, 0]
        return out

    @cached_property
    def reference(self) -> Truth:
        """Images under the standard contacts on an endlessly fine mesh, extrapolated."""
        coarse, fine = (self.truth(refine) for refine in REFERENCE)
        share = extrapolation(*REFERENCE)
        return Truth(
            shift_px=fine.shift_px + share * (fine.shift_px - coarse.shift_px),
            motion=fine.motion + share * (fine.motion - coarse.motion),
            nodes=fine.nodes,
        )

    @cached_property
    def linear_reference(self) -> FloatArray:
        """S₁ (c, 2n) likewise: linear theory alone."""
        coarse, fine = (self._linear_truths[refine] for refine in REFERENCE)
        return fine + extrapolation(*REFERENCE) * (fine - coarse)

    @cached_property
    def _linear_truths(self) -> dict[int, FloatArray]:
        return {refine: self._linear_truth(refine) for refine in REFERENCE}

    def _linear_truth(self, refine: int) -> FloatArray:
        mesh, model = truth_shell(self.design, self.surface, refine)
        shell = self._pressed(mesh, model, 1)
        motions = shell.motions(self.contacts.uv, self.contacts.radius_mm)
        return np.stack([self.see.powers(own, shell.forces)[0] for own in motions])

    def own_large(self, refine: int) -> Truth:
        """Images by the large displacements of a build's own mesh: what its theory should give."""
        return self._large(*self.shell(refine, receptors=True))

    def rows_of(self, setting: Accuracy) -> FloatArray:
        """Rows (c, k, 2n) of a setting at the contacts, S₁ between its tabulated places."""
        known = {"receptors": setting.receptors}
        rows = self.rows(setting.refine, orders=setting.place_orders, **known).shift_px
        coarse = min(setting.refine, COARSE)
        exact = self.rows(coarse, orders=1, **known).shift_px[:, 0]
        missed = self.between(coarse, setting.place_share, **known) - exact
        return np.concatenate([(rows[:, 0] + missed)[:, None], rows[:, 1:]], axis=1)

    def truth_error(self, refine: int) -> float:
        """Relative force error of the simulated sensor's own mesh, linear theory."""
        known = refine in REFERENCE
        rows = self._linear_truths[refine] if known else self._linear_truth(refine)
        return rms(read_forces(rows[:, None], self.linear_reference) - 1.0)

    def errors(self, setting: Accuracy) -> FloatArray:
        """Relative force errors (s,) of a setting on the contacts that the reference has solved."""
        solved = self.reference.solved
        read = read_forces(self.rows_of(setting)[solved], self.reference.shift_px[solved])
        return np.asarray(read / self.contacts.force_N[solved] - 1.0)


def extrapolation(coarse: int, fine: int) -> float:
    """How far beyond the finer of two meshes the limit lies, over the step between them."""
    return 1.0 / ((fine / coarse) ** 2 - 1.0)


def read_forces(rows_px: FloatArray, shift_px: FloatArray) -> FloatArray:
    """Forces (c,) whose shifts f·S₁ + f²·S₂ + … are nearest to those seen.

    Parameters
    ----------
    rows_px : (c, k, 2n) float
        S₁ … S_k.
    shift_px : (c, 2n) float
        What is seen.
    """
    count, orders, _ = rows_px.shape
    powers = np.arange(1, orders + 1)
    gram = np.einsum("ckn,cln->ckl", rows_px, rows_px)
    pull = np.einsum("ckn,cn->ck", rows_px, shift_px)
    force = pull[:, 0] / gram[:, 0, 0]
    for k in range(count):
        f = force[k]
        for _ in range(NEWTON_STEPS):
            basis, slope = f**powers, powers * f ** (powers - 1)
            left = pull[k] - gram[k] @ basis
            step = float(slope @ left) / float(slope @ gram[k] @ slope)
            f = f + float(np.clip(step, -0.5 * abs(f), 0.5 * abs(f)))
            if abs(step) <= 1e-10 * abs(f):
                break
        force[k] = f
    return np.asarray(force)


def rms(errors: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))
