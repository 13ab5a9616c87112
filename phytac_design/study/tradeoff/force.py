"""The force error of a setting on the standard contacts.

The reference is the shell under large displacement, without noise, extrapolated from two meshes
that are not those of a simulated sensor, nor aligned with markers as the decoder's are. It moves
the markers' images by d. A setting expects, for a contact at a known place, the shifts
f·S₁ + f²·S₂ + f³·S₃ of its own mesh and theory (:mod:`response_tables`). Its force f is the
least-squares fit to d, and its error the root mean square of f/f_true − 1.

Included: the mesh, receptors, the theory, and the interpolation between tabulated places. Not
included: noise, the estimation of place, size and number of contacts, print scatter, networks.
"""

from dataclasses import dataclass
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.mechanics.response_table import FIT_PLACES, ResponseTable
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.layout.arc import by_area
from phytac_design.layout.cameras import Readers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.compliance import turns_of
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads, tangent_frame
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.instance_shell import instance_shells, truth_shell
from phytac_design.simulation.linear_response import turned_points
from phytac_design.simulation.mesh_pair import MeshPair, mesh_pair
from phytac_design.simulation.pressed_series import (
    DiscResponse,
    ExtrapolatedResponse,
    ImageResponse,
    scaled_powers,
)
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_design.simulation.response_tables import interpolate_responses, place_spacing_mm
from phytac_design.simulation.sensor_instance import designed_shell
from phytac_design.simulation.turned_places import rings
from phytac_design.stages.places_stage import extrapolated_from
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError, NumericalError


@dataclass(frozen=True, kw_only=True)
class ReferenceSolution:
    """Response to the standard contacts.

    Attributes
    ----------
    shift_px : (c, 2n) float
        Shifts of the markers' images; NaN for contacts without a solution.
    motion : (c, n, 6) float
        Motion of the middle face under each marker; likewise.
    """

    shift_px: FloatArray
    motion: FloatArray


class ForceError:
    """Force errors of any setting on one design; every mesh is solved once, when it is needed.

    Parameters
    ----------
    design : Design
        The sensor.
    count : int
        Standard contacts.
    """

    pilot_refine = 4
    """Elements per marker pitch of the mesh that theory and interpolation are evaluated on."""
    reference_refines = 8, 12
    """Elements per marker pitch of the two meshes that the reference is extrapolated from; no
    simulated sensor is extrapolated from these two. Extrapolated from 9 and 13 it is the same
    within 0.1 %."""

    def __init__(self, design: Design, *, count: int = 16) -> None:
        self.design, self.count = design, count
        self.sensor = Sensor(design)
        self.truth = cache(lambda refine: self.large(*self.truth_shell(refine)))
        self.linear_truth = cache(
            lambda refine: self.powers(*self.truth_shell(refine), self.contacts.uv)[:, 0]
        )
        self.rows = cache(self._rows)
        self.linear_rows = cache(self._linear_rows)
        self.between = cache(self._between)

    @cached_property
    def contacts(self) -> Contacts:
        """The standard contacts."""
        return standard_contacts(self.design, self.sensor.surface, self.count)

    @cached_property
    def imaging(self) -> ImageResponse:
        """Image shifts of the cameras; the paint is taken at the tips, no view is rendered."""
        markers, cameras = self.sensor.markers, self.sensor.cameras
        away = [np.linalg.norm(markers.tip_mm - c.position_mm, axis=1) for c in cameras]
        readers = Readers(cameras=cameras, read_by=np.argmin(np.stack(away), axis=0))
        return ImageResponse(readers, markers.mid_mm, markers.tip_mm - markers.mid_mm)

    def image_shift(self, moved_mm: FloatArray) -> FloatArray:
        """Shifts (2n,) of the markers' images by motions (n, 3) of their paint."""
        imaging = self.imaging
        return (imaging.readers.project(imaging.watched + moved_mm) - imaging.rest).ravel()

    def truth_shell(self, refine: int) -> tuple[ShellMesh, ShellModel]:
        """Mesh and model of the simulated sensor."""
        return truth_shell(self.design, self.sensor.surface, refine)

    def kinematics(self, mesh: ShellMesh) -> ReceptorKinematics:
        """Motion of the receptors on a mesh."""
        radius = self.design.receptor.diameter_tube_mm / 2.0
        return ReceptorKinematics(mesh, self.sensor.surface, self.sensor.markers.uv, radius)

    def loads(self, mesh: ShellMesh) -> FloatArray:
        """Return 1 N on each contact, (6N, c)."""
        sensor = self.sensor
        holes = Holes.of(
            sensor.surface, sensor.markers.uv, self.design.receptor.diameter_hole_mm / 2.0
        )
        loads = indentation_loads(mesh, sensor.surface, self.contacts, holes=holes)
        return np.asarray(loads.toarray())

    def large(self, mesh: ShellMesh, model: ShellModel) -> ReferenceSolution:
        """Solve the standard contacts with large displacements.

        Raises
        ------
        NumericalError
            If fewer than half of the contacts can be solved.
        """
        forces, count = self.contacts.force_N, self.sensor.markers.count
        kinematics, loads = self.kinematics(mesh), self.loads(mesh)
        linear = model.solve(loads).motion.reshape(loads.shape)
        shell = QuasiNewtonSolver(model)
        motion = np.full((len(forces), count, 6), np.nan)
        shift = np.full((len(forces), 2 * count), np.nan)
        for k, force in enumerate(forces.tolist()):
            found = shell.solve(force * loads[:, k], linear=force * linear[:, k]).motion
            if found is not None:
                motion[k] = kinematics.large(found)
                shift[k] = self.image_shift(turned_points(motion[k], self.imaging.arm_mm))
        solved = int(np.isfinite(motion).all(axis=(1, 2)).sum())
        if 2 * solved < len(motion):
            raise NumericalError(
                "contacts-not-solved",
                f"only {solved} of the {len(motion)} standard contacts can be solved with "
                "large displacements; lower training.force_max_N or raise wall.thickness_mm",
            )
        return ReferenceSolution(shift_px=shift, motion=motion)

    def shell(self, refine: int, *, receptors: bool) -> tuple[ShellMesh, ShellModel]:
        """Mesh and model that a build with these settings decodes with."""
        design, markers = self.design, self.sensor.markers
        thickness = design.wall.thickness_mm
        mesh = marker_mesh(self.sensor.surface, markers, thickness_mm=thickness, refine=refine)
        known = receptors and not unknown_receptors(design)
        return mesh, sensor_model(design, markers, mesh, receptors=known)

    def powers(
        self, mesh: ShellMesh, model: ShellModel, uv: FloatArray, *, orders: int = 1
    ) -> FloatArray:
        """Shifts S₁ … S_k (p, k, 2n) of contacts at places (p, 2), px per N, N², …."""
        sensor = self.sensor
        shell = DiscResponse(
            self.design, sensor.surface, sensor.markers, mesh=mesh, model=model, orders=orders
        )
        out = np.zeros((len(uv), orders, 2 * sensor.markers.count))
        for k, own in enumerate(shell.motions(uv, float(self.contacts.radius_mm[0]))):
            out[k, : len(own)] = self.imaging.powers(own, shell.forces)
        return out

    def _rows(self, refine: int, *, receptors: bool, orders: int) -> FloatArray:
        """S₁ … S_k (c, k, 2n) that a build's tables would hold at the contacts' own places."""
        mesh, model = self.shell(refine, receptors=receptors)
        return self.powers(mesh, model, self.contacts.uv, orders=orders)

    def _linear_rows(self, refine: int, *, receptors: bool) -> FloatArray:
        """S₁ (c, 2n) likewise, extrapolated where a build does that."""
        sensor = self.sensor
        levels = extrapolated_from(refine, sensor.markers.count)
        pair = mesh_pair(partial(self.shell, receptors=receptors), levels)
        if pair is None:
            return self.rows(refine, receptors=receptors, orders=1)[:, 0]
        return self._extrapolated_rows(pair)

    def _extrapolated_rows(self, pair: MeshPair) -> FloatArray:
        """S₁ (c, 2n) extrapolated from two meshes."""
        sensor = self.sensor
        shell = ExtrapolatedResponse(self.design, sensor.surface, sensor.markers, pair)
        motions = shell.motions(self.contacts.uv, float(self.contacts.radius_mm[0]))
        return np.stack([self.imaging.powers(one, np.zeros(0))[0] for one in motions])

    def _between(self, refine: int, share: float, *, receptors: bool) -> FloatArray:
        """S₁ (c, 2n) at the contacts, interpolated between tabulated places."""
        mesh, model = self.shell(refine, receptors=receptors)
        surface, markers = self.sensor.surface, self.sensor.markers
        sectors, _ = turns_of(model, mesh, markers.lattice.columns if markers.lattice else 1)
        radius = float(self.contacts.radius_mm[0])
        ring = rings(surface, place_spacing_mm(surface, share, radius), sectors)
        along, around = tangent_frame(surface, ring.uv)
        point, wanted = surface.point(ring.uv), surface.point(self.contacts.uv)

        def table(near: IntArray, shift_px: NDArray[np.float32]) -> ResponseTable:
            return ResponseTable(
                point_mm=point[near],
                along=along[near],
                around=around[near],
                shift_px=shift_px[:, None],
                radius_mm=radius,
            )

        local, base = [], []
        for target in wanted:
            away = np.linalg.norm(point - target, axis=1)
            near = np.argsort(away, kind="stable")[: 3 * FIT_PLACES]
            empty = table(near, np.zeros((len(near), 0), dtype=np.float32))
            local.append(near)
            base.append(near[empty.fits[0][int(empty.nearest(target[None])[0])]])
        needed = np.unique(np.concatenate(base))
        solved = np.zeros((len(point), 2 * markers.count), dtype=np.float32)
        solved[needed] = self.powers(mesh, model, ring.uv[needed])[:, 0]
        return np.stack(
            [
                interpolate_responses(table(near, solved[near]), target[None])[0, 0]
                for near, target in zip(local, wanted, strict=True)
            ]
        )

    @cached_property
    def reference(self) -> ReferenceSolution:
        """Response of an infinitely fine mesh, extrapolated."""
        coarse, fine = (self.truth(refine) for refine in self.reference_refines)
        return ReferenceSolution(
            shift_px=extrapolated(coarse.shift_px, fine.shift_px),
            motion=extrapolated(coarse.motion, fine.motion),
        )

    @cached_property
    def linear_reference(self) -> FloatArray:
        """S₁ (c, 2n) likewise: linear theory."""
        return extrapolated(*(self.linear_truth(refine) for refine in self.reference_refines))

    def truth_error(self, refine: int) -> float:
        """Relative force error of the simulated sensor's own meshes, linear theory."""
        unit = designed_shell(self.sensor.surface, self.sensor.markers)
        _, pair = instance_shells(self.design, self.sensor.surface, unit, refine)
        rows = self._extrapolated_rows(pair) if pair else self.linear_truth(refine)
        return rms(fit_forces(rows[:, None], self.linear_reference) - 1.0)

    def errors(self, setting: Accuracy) -> FloatArray:
        """Relative force errors (s,) of a setting on the contacts that the reference solves."""
        receptors, coarse = setting.receptors, min(setting.refine, self.pilot_refine)
        orders = setting.place_orders
        plain = self.rows(setting.refine, receptors=receptors, orders=orders)
        linear = self.linear_rows(setting.refine, receptors=receptors)
        rows = np.stack([scaled_powers(*each) for each in zip(plain, linear, strict=True)])
        # S₁ as between the setting's tabulated places.
        exact = self.rows(coarse, receptors=receptors, orders=1)[:, 0]
        rows[:, 0] += self.between(coarse, setting.place_share, receptors=receptors) - exact
        solved = np.isfinite(self.reference.shift_px).all(axis=1)
        force = fit_forces(rows[solved], self.reference.shift_px[solved])
        return np.asarray(force / self.contacts.force_N[solved] - 1.0)


def standard_contacts(design: Design, surface: Surface, count: int = 16) -> Contacts:
    """Single contacts spread evenly over area and force, away from the rims.

    The places are at least a patch diameter away from every open edge, where place and force are
    nearly degenerate; forces go from a fifth of the design's largest to all of it, over its mean
    patch. The same design always has the same contacts.

    Raises
    ------
    DesignError
        If no place is that far from the rims.
    """
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    # An even additive sequence in three dimensions: powers of 1/p, p⁴ = p + 1. Forty candidates for
    # each contact: those near a rim are skipped.
    steps = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
    numbers = (0.5 + np.arange(1, 40 * count + 1)[:, None] * steps) % 1.0
    uv = by_area(surface, numbers[:, :2])
    away = np.full(len(uv), np.inf)
    for axis, end in surface.edges():
        edge = np.full((129, 2), surface.domain[axis, end])
        low, high = surface.domain[1 - axis]
        edge[:, 1 - axis] = np.linspace(low, high, len(edge))
        gap = np.linalg.norm(surface.point(uv)[:, None] - surface.point(edge)[None], axis=2)
        away = np.minimum(away, gap.min(axis=1))
    kept = np.flatnonzero(away >= 2.0 * radius)[:count]
    if len(kept) == 0:
        raise DesignError(
            "standard-contacts-no-room",
            f"no place on this sensor is {2.0 * radius:g} mm from its rims, so it has no standard "
            "contacts to measure a force error on; lower training.patch_radius_max_mm or make the "
            "sensor larger",
        )
    low = max(training.force_min_N, 0.2 * training.force_max_N)
    return Contacts.flat(
        sample=np.arange(len(kept)),
        uv=uv[kept],
        radius_mm=np.full(len(kept), radius),
        force_N=low + (training.force_max_N - low) * numbers[: len(kept), 2],
        samples=len(kept),
    )


def extrapolated(coarse: FloatArray, fine: FloatArray) -> FloatArray:
    """Limit of two results on the reference meshes, whose errors fall with the square."""
    low, high = ForceError.reference_refines
    return np.asarray(fine + (fine - coarse) / ((high / low) ** 2 - 1.0))


def fit_forces(rows_px: FloatArray, shift_px: FloatArray) -> FloatArray:
    """Forces (c,) whose shifts f·S₁ + f²·S₂ + … are nearest to the observed ones (Newton).

    Parameters
    ----------
    rows_px : (c, k, 2n) float
        S₁ … S_k.
    shift_px : (c, 2n) float
        Observed shifts.
    """
    powers = np.arange(1, rows_px.shape[1] + 1)
    gram = np.einsum("ckn,cln->ckl", rows_px, rows_px)
    projection = np.einsum("ckn,cn->ck", rows_px, shift_px)
    force = projection[:, 0] / gram[:, 0, 0]
    for _ in range(30):
        basis, slope = force[:, None] ** powers, powers * force[:, None] ** (powers - 1)
        residual = projection - np.einsum("ckl,cl->ck", gram, basis)
        step = (slope * residual).sum(axis=1) / np.einsum("ck,ckl,cl->c", slope, gram, slope)
        force = force + np.clip(step, -0.5 * np.abs(force), 0.5 * np.abs(force))
        if not (np.abs(step) > 1e-10 * np.abs(force)).any():
            break
    return np.asarray(force)


def rms(errors: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))
