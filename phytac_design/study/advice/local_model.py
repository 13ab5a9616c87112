r"""Fast approximate figures of designs near an evaluated one, without pixels, for sensitivities.

The bound is taken at a few receptors along the sensor. The visible paint of the evaluated design,
and the change of what is visible when a receptor turns, are expressed in the receptor's own frame
and transferred unscaled. Where a change leaves the shell as it is (camera, heights, paint) the
wall's motion is reused; where it scales the modulus, motion is scaled by 1/E; otherwise the shell
is solved again.

Gaps are those of outlines, smooth in the design. The outline of a marker is the convex hull of the
images of the two circles that bound its paint. Two hulls are as far apart as the widest strip
between them,

    gap = max over directions e of  min over A of x·e  -  max over B of x·e

taken over 64 directions; negative where they overlap. Occlusion is neglected; for wholly visible
markers the least distance of their pixels is this plus about 1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.camera.camera import Camera
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.field_groups import values_of
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, with_heights
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.simulation.cramer_rao import (
    ContactSignals,
    PositionPrior,
    cell_prior,
    contact_signals,
)
from phytac_design.simulation.linear_response import point_motions, rigid_slope
from phytac_design.study.advice.design_evaluation import (
    FORCES,
    EvaluatedDesign,
    force_figures,
    middle_of,
)
from phytac_design.study.advice.design_variables import ROW, DesignVariable
from phytac_design.study.search.fidelity_levels import band_rings
from phytac_design.study.search.surrogate import FORCE_N, strain_of
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import PhytacError

GAPS = ("gap_px", "load_gap_px")
SENSITIVE = (*FORCES, *GAPS, "strain")
"""Figures with sensitivities: gaps absolute, the others relative."""


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
    signals, prior : ContactSignals, PositionPrior
        For the bound; columns run over cameras, markers, x and y.
    middle : (c,) bool
        Contacts at the middle heights.
    """

    sensor: Sensor
    camera_of: IntArray
    motion: MarkerWallMotion
    signals: ContactSignals
    prior: PositionPrior
    middle: BoolArray


class LocalModel:
    """Approximate figures near an evaluated design, with a mesh of some accuracy."""

    def __init__(self, base: EvaluatedDesign, accuracy: Accuracy) -> None:
        self.base, self.accuracy = base, accuracy
        self.solves = 0
        # For each camera, in the receptors' frames: the offset (n, 3) mm from the tip to the
        # visible paint, and how this point would have to move (n, 3, 6), per mm and radian of the
        # wall, to show what the paint does besides moving rigidly.
        self.paint: list[tuple[FloatArray, FloatArray]] = []
        markers, views = base.markers, base.views
        for number, camera in enumerate(base.sensor.cameras):
            watched, frame = views["paint_points_mm"][number], _frames(markers, camera)
            offset = np.einsum("nkj,nj->nk", frame, watched - markers.tip_mm)
            image = camera.jacobian(watched)
            rest = views["paint_slopes"][number] - rigid_slope(image, watched - markers.mid_mm)
            seen = views["seen_by"][number][:, None, None]
            motion = np.linalg.pinv(np.where(seen, image, 0.0)) @ np.where(seen, rest, 0.0)
            self.paint.append((offset, _rotated(motion, np.swapaxes(frame, 1, 2))))

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
        sensor = Sensor(design)
        if markers is not None:
            sensor = Sensor.of(design, sensor.surface, markers)
        contacts = contacts_of(self.base.sensor if held else sensor)
        motion = self._base_motion if held else self._motion(sensor)
        slopes, camera_of = self._image_slopes(sensor)

        def shifts(_uv: FloatArray, _radius_mm: FloatArray) -> FloatArray:
            each = [np.einsum("nij,cnj->cni", slope, motion.touch) for slope in slopes]
            return np.concatenate(each, axis=1)

        low, high = design.training.patch_radius_min_mm, design.training.patch_radius_max_mm
        uv = sensor.markers.uv[contacts]
        return ContactView(
            sensor=sensor,
            camera_of=camera_of,
            motion=motion,
            signals=contact_signals(sensor.surface, shifts, uv=uv, radius_mm=(low + high) / 2.0),
            prior=cell_prior(sensor.surface.area_mm2(), sensor.markers.count, low, high),
            middle=middle_of(sensor)[contacts],
        )

    def gaps(self, view: ContactView) -> FloatArray:
        """Gaps (1 + p, n) at rest and under each press, each marker in its camera's image."""
        markers = view.sensor.markers
        points = band_rings(view.sensor.design, markers)
        arm = points - markers.mid_mm[:, None]
        poses = [points]
        poses += [points + point_motions(press[:, None], arm) for press in view.motion.press]
        out = np.full((len(poses), markers.count), np.inf)
        for number, camera in enumerate(view.sensor.cameras):
            own = np.flatnonzero(view.camera_of == number)
            for k, pose in enumerate(poses):
                out[k, own] = gaps_px(camera, pose[own], markers.colour[own])
        return out

    def _image_slopes(self, sensor: Sensor) -> tuple[list[FloatArray], IntArray]:
        """Image motion per wall motion for each camera (n, 2, 6), 0 if unseen; camera of each."""
        base, markers = self.base, sensor.markers
        like = np.arange(markers.count)
        if markers.count != base.markers.count:
            # Markers of other layouts show what the nearest along the sensor show.
            before = base.surface.unwrap(base.markers.uv)[:, 1]
            after = sensor.surface.unwrap(markers.uv)[:, 1]
            like = np.abs(after[:, None] - before).argmin(axis=1)
        slopes = []
        for number, (camera, (offset, turns)) in enumerate(
            zip(sensor.cameras, self.paint, strict=True)
        ):
            frame = _frames(markers, camera)
            watched = markers.tip_mm + np.einsum("nk,nkj->nj", offset[like], frame)
            image = camera.jacobian(watched)
            slope = rigid_slope(image, watched - markers.mid_mm)
            slope = slope + image @ _rotated(turns[like], frame)
            seen = base.views["seen_by"][number][like]
            slopes.append(np.where(seen[:, None, None], slope, 0.0))
        return slopes, base.views["camera"][like]

    @cached_property
    def _base_motion(self) -> MarkerWallMotion:
        return self._solve(self.base.sensor)

    def _motion(self, sensor: Sensor) -> MarkerWallMotion:
        """Wall motion of a design: reused, scaled by the modulus, or solved."""
        base, design = self.base.design, sensor.design
        # That short receptors stiffen the wall less is neglected.
        before, after = (values_of(one, ("bases", "stiffness")) for one in (base, design))
        changed = {name for name in before | after if before.get(name) != after.get(name)}
        if base.material.poisson == design.material.poisson:
            changed -= {"material"}
        if changed:
            return self._solve(sensor)
        softer = base.material.modulus_MPa / design.material.modulus_MPa
        motion = self._base_motion
        return MarkerWallMotion(softer * motion.touch, softer * motion.press)

    def _solve(self, sensor: Sensor) -> MarkerWallMotion:
        """Wall motion by finite elements."""
        self.solves += 1
        design, surface, markers = sensor.design, sensor.surface, sensor.markers
        thickness, training = design.wall.thickness_mm, design.training
        mesh = marker_mesh(surface, markers, thickness_mm=thickness, refine=self.accuracy.refine)
        tubes = self.accuracy.receptors and not unknown_receptors(design)
        model = sensor_model(design, markers, mesh, receptors=tubes)
        touch: list[Any] = []

        def gather(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
            touch.append(patch_loads(mesh, surface, uv, radius_mm))
            return np.zeros((len(uv), 1, 2))

        radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        contact_signals(surface, gather, uv=markers.uv[contacts_of(sensor)], radius_mm=radius)
        # The base's presses, at the same shares of this surface's domain.
        old, new = self.base.surface.domain, surface.domain
        share = (self.base.load["uv"] - old[:, 0]) / np.ptp(old, axis=1)
        presses = np.asarray(new[:, 0] + share * np.ptp(new, axis=1))
        press = patch_loads(mesh, surface, presses, training.patch_radius_max_mm)
        loads = np.hstack([touch[0].toarray(), training.force_max_N * press.toarray()])
        at = np.moveaxis(model.solve(loads).motion[mesh.marker_nodes], 2, 0)
        touches = touch[0].shape[1]
        return MarkerWallMotion(at[:touches], at[touches:])


def contacts_of(sensor: Sensor) -> IntArray:
    """Up to 16 receptors to take the bound at: one of each row of a lattice, else some along u."""
    markers = sensor.markers
    if markers.lattice is not None:
        order = np.flatnonzero(markers.column == 0)
    else:
        order = np.argsort(sensor.surface.unwrap(markers.uv)[:, 1], kind="stable")
    pick = np.linspace(0, len(order) - 1, min(16, len(order)))
    return np.asarray(order[np.unique(np.rint(pick).astype(np.int64))])


def gaps_px(camera: Camera, points_mm: FloatArray, colour: IntArray) -> FloatArray:
    """Least gap (n,) of each marker's outline to another of its colour, px; inf where none is.

    Parameters
    ----------
    points_mm : (n, k, 3) float
        Points whose images span each outline.
    colour : (n,) int
        Colours.
    """
    directions, neighbours = 64, 12
    pixels = camera.project(points_mm.reshape(-1, 3)).reshape(*points_mm.shape[:2], 2)
    out = np.full(len(points_mm), np.inf)
    known = np.isfinite(pixels).all(axis=(1, 2))
    turn = 2.0 * np.pi * np.arange(directions) / directions
    # Half of the directions are minus the other half: low(e) = -high(-e).
    reach = pixels[known] @ np.stack([np.cos(turn), np.sin(turn)])
    high, low = reach.max(axis=1), reach.min(axis=1)
    for paint in np.unique(colour):
        same = np.flatnonzero(colour[known] == paint)
        if len(same) < 2:
            continue
        centre = pixels[known][same].mean(axis=1)
        near = cKDTree(centre).query(centre, k=min(neighbours, len(same)))[1][:, 1:]
        strips = low[same][near] - high[same][:, None]  # (m, k, directions)
        out[np.flatnonzero(known)[same]] = strips.max(axis=2).min(axis=1)
    return out


def _frames(markers: Markers, camera: Camera) -> FloatArray:
    """Unit vectors (n, 3, 3) of each receptor: along it, towards the camera, across."""
    axis = markers.direction
    sight = camera.position_mm - markers.tip_mm
    side = sight - np.sum(sight * axis, axis=1, keepdims=True) * axis
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    return np.stack([axis, side, np.cross(axis, side)], axis=1)


def _rotated(maps: FloatArray, frame: FloatArray) -> FloatArray:
    """Maps (n, 3, 6) of translation and rotation from ``frame`` (n, 3, 3) to the outer frame."""
    out = np.swapaxes(frame, 1, 2)
    return np.concatenate([out @ part @ frame for part in (maps[:, :, :3], maps[:, :, 3:])], axis=2)


@dataclass(frozen=True)
class Sensitivity:
    """Effect of one variable.

    Attributes
    ----------
    rate : dict
        By figure: d ln(figure) per unit of the variable for forces and strain, d(figure) for gaps.
    stuck : str
        Why it cannot change either way; "" if it can.
    """

    variable: DesignVariable
    rate: dict[str, float]
    stuck: str = ""

    def per_step(self, name: str) -> float:
        """Change by one step: a share for forces and strain, px for gaps."""
        return self.rate[name] * self.variable.step

    def predict(self, figures: Mapping[str, float], amount: float) -> dict[str, float]:
        """Figures after a change; forces and strain follow a power law of the variable's value."""
        value, out = self.variable.value, {}
        for name in SENSITIVE:
            if name in GAPS:
                out[name] = figures[name] + self.rate[name] * amount
            elif value > 0.0 and value + amount > 0.0:
                ratio = (value + amount) / value
                out[name] = figures[name] * float(ratio ** (self.rate[name] * value))
            else:
                out[name] = figures[name] * float(np.exp(self.rate[name] * amount))
        return out


def sensitivities(
    model: LocalModel,
    variables: Sequence[DesignVariable],
    progress: Callable[[str], None] = lambda _: None,
) -> list[Sensitivity]:
    """Sensitivity to every variable by central differences; one-sided where a rule forbids one."""
    base = model.base

    def sizes(design: Design, variable: DesignVariable | None = None) -> dict[str, float]:
        strain = base.figures["strain"]
        if variable and variable.name.partition(".")[0] in ("wall", "material", "shape"):
            strain = strain_of(Sensor(design))
        held = variable is not None and variable.kind == ROW
        found = model.figures(design, held=held) | {"strain": strain}
        logs = {name: float(np.log(found[name])) for name in SENSITIVE if name not in GAPS}
        return logs | {gap: found[gap] if np.isfinite(found[gap]) else 0.0 for gap in GAPS}

    here = sizes(base.design)
    out = []
    for number, variable in enumerate(variables, start=1):
        progress(f"sensitivities: {number} of {len(variables)}, {variable.name}")
        sides, why = [(0.0, here)], ""
        for amount in (variable.step, -variable.step):
            try:
                sides.append((amount, sizes(variable.moved(base.design, amount), variable)))
            except PhytacError as error:
                why = str(error)
        if len(sides) == 1:
            out.append(Sensitivity(variable, {}, why))
            continue
        (low, before), (high, after) = sides[-2:]
        rate = {name: (after[name] - before[name]) / (high - low) for name in SENSITIVE}
        out.append(Sensitivity(variable, rate))
    return out


@dataclass(frozen=True)
class RowSensitivity:
    """Relative change of the force bound at middle heights per half millimetre of row height."""

    row: int
    share: float


def row_sensitivities(
    model: LocalModel, row: IntArray, *, step_mm: float = 0.5
) -> list[RowSensitivity]:
    """Sensitivities to the height of each row, the most negative first.

    Markers add to the Fisher information one by one, so that one row's part can be exchanged for
    that at another height, with the wall motion of the base.
    """
    base, views, parts = model.base, [], []
    for rise in (0.0, step_mm, -step_mm):
        height = np.maximum(base.markers.height_mm + rise, 0.05)
        markers = with_heights(base.design, base.surface, base.markers, height)
        views.append(model.view(base.design, markers=markers, held=True))
        parts.append(_information(views[-1], row))
    total, middle = parts[0].sum(axis=1), views[0].middle

    def force(information: FloatArray) -> float:
        prior = views[0].prior
        known = np.diag([0.0, prior.place_mm**-2, prior.place_mm**-2, prior.radius_mm**-2])
        bound = np.sqrt(np.linalg.inv(information + known)[:, 0, 0])
        return float(bound[middle].mean())

    here, out = force(total), []
    for k in range(parts[0].shape[1]):
        up, down = (force(total - parts[0][:, k] + part[:, k]) for part in parts[1:])
        out.append(RowSensitivity(k, (up - down) / (2.0 * here)))
    return sorted(out, key=lambda one: one.share)


def _information(view: ContactView, row: IntArray) -> FloatArray:
    """Fisher information of each contact by row, (c, rows, 4, 4)."""
    signals = view.signals
    G = np.concatenate([signals.shift[:, :, None], FORCE_N * signals.slopes], axis=2)
    of = np.tile(np.repeat(row, 2), G.shape[1] // (2 * len(row)))
    rows = [G[:, of == k] for k in range(int(row.max()) + 1)]
    parts = [np.swapaxes(own, 1, 2) @ own for own in rows]
    return np.asarray(np.stack(parts, axis=1) / view.sensor.design.camera.noise_centroid_px**2)
