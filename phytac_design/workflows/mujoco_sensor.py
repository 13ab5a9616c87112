"""A sensor in MuJoCo: contacts on its geoms in, what its decoder reports out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_decoder.pipeline.print_identity import for_this_print
from phytac_decoder.serving.sensor_loop import check_estimator
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.design.spec import Design
from phytac_design.fabrication.simulators.simulator_part import base_z_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import FLAT, SPHERE, Indentations
from phytac_design.simulation.run.virtual_sensor import VirtualSensor
from phytac_design.simulation.scenario.scenario_file import FRICTION_MAX
from phytac_design.stages.virtual_sensor_stage import virtual_sensor
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError, MissingPartError

DEEP_MM, BESIDE_MM = 5.0, 0.5
"""Contacts farther than this from the sensing face, along its normal or beyond its edges, are on
rims or mount: they move no marker. MuJoCo's contacts are soft: bodies sink in by up to
millimetres."""


@dataclass(frozen=True, kw_only=True)
class GeomContacts:
    """Contacts on a sensor's geoms, in the sensor's frame; arrays run over c points.

    Attributes
    ----------
    point_mm : (c, 3) float
        Where they are.
    force_N : (c, 3) float
        Force on the sensor.
    other : (c,) int
        Geom that presses.
    """

    point_mm: FloatArray
    force_N: FloatArray
    other: IntArray


class PhytacMujoco:
    """A sensor in a MuJoCo model that reports what the real sensor would.

    Contact points of one geom that are nearer to each other than the patch's radius are one patch.
    Patches move the markers of a virtual print by its own tables, trip its switches, with
    hysteresis, and are seen with the errors of its camera's centroids; the decoder reads that as it
    reads a frame. MuJoCo's own part is rigid: the shell's dent does not move what presses on it,
    and the wall has no memory.

    Parameters
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        Of the simulation, with the part that ``phytac export --to mjcf`` wrote.
    design : str or Design
        Shipped design, file or design of the sensor.
    bundle : Path, str or Bundle
        Its decoder.
    body : str
        Body of the sensor; with the prefix of ``attach``, as ``palm/base``.
    patch_radius_mm : float or callable, optional
        Radius of the patch that a geom presses with, or its radius by the geom's number: MuJoCo's
        bodies are rigid and touch in points. The middle of the design's range if not given.
    indenter : {"flat", "sphere"}
        Pressure: even over the patch, or Hertz's.
    unit, seed : int
        Which virtual print, as of ``phytac simulate``; 0 is the sensor as designed.
    accuracy : str
        Preset of the simulation's mesh.
    estimator : str, optional
        The bundle's best if not given.
    sensor : VirtualSensor, optional
        The print, where it is at hand; else it is made, which takes minutes at first, and kept in
        the cache.
    progress : callable
        Called with a short message while it is made.

    Attributes
    ----------
    pressed : Indentations
        Patches of the last frame: the truth that it is decoded from.
    elsewhere_N : float
        Sum of the magnitudes of the last frame's other forces, which the sensor does not show: on
        rims and mount, pulling, or of bodies that have sunk in by more than 5 mm.

    Raises
    ------
    MissingPartError
        If mujoco is not installed.
    InputError
        If the bundle is of another design, or the model has no such body.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        *,
        design: str | Design,
        bundle: Path | str | Bundle,
        body: str = "base",
        patch_radius_mm: float | Callable[[int], float] | None = None,
        indenter: str = "flat",
        unit: int = 0,
        seed: int = 0,
        accuracy: str = "standard",
        estimator: str | None = None,
        sensor: VirtualSensor | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._mujoco = mujoco_library()
        of_design = design if isinstance(design, Design) else load_design(design)
        decoder = bundle if isinstance(bundle, Bundle) else load_bundle(Path(bundle))
        if decoder.design_hash != design_hash(of_design):
            raise InputError(
                "decoder-of-other-design",
                f"the decoder is of {decoder.design} ({decoder.design_hash[:12]}…), not of "
                f"{of_design.name} ({design_hash(of_design)[:12]}…); build or train that design",
            )
        if indenter not in {"flat", "sphere"}:
            raise InputError(
                "patch-pressure-unknown", f"indenter must be 'flat' or 'sphere' (got {indenter!r})"
            )
        self.model, self.data = model, data
        self._body = self._mujoco.mj_name2id(model, self._mujoco.mjtObj.mjOBJ_BODY, body)
        if self._body < 0:
            names = ", ".join(repr(model.body(k).name) for k in range(1, min(model.nbody, 9)))
            raise InputError(
                "body-unknown",
                f"the model has no body {body!r} (its first: {names}); attach the exported part, "
                "and give its body with the prefix",
            )
        self.estimator = estimator or decoder.model.best
        check_estimator(decoder, self.estimator)
        self.sensor = sensor or virtual_sensor(
            of_design, unit=unit, seed=seed, accuracy=accuracy, progress=progress
        )
        self.bundle = for_this_print(replace(decoder, rest_px=self.sensor.errors.rest_px))
        self._messages = MessageBuilder(
            bundle=self.bundle, estimator=self.estimator, source="MuJoCo", clock="simulated"
        )
        training = of_design.training
        middle = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        given = middle if patch_radius_mm is None else patch_radius_mm
        self._radius_mm = given if callable(given) else lambda _: float(given)
        self._indenter = SPHERE if indenter == "sphere" else FLAT
        self._origin_mm = np.array([0.0, 0.0, base_z_mm(Sensor(of_design))])
        self._own = np.append(model.geom_bodyid == self._body, False)  # -1: no geom
        self._number = 0
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Start again: all switches off, no frame before, noise from a seed."""
        self._rng = np.random.default_rng(seed)
        self._on: BoolArray | None = None
        self._before: Reading | None = None
        self.pressed, self.elsewhere_N = _patches_of([], FLAT), 0.0

    def hello(self) -> Message:
        """The first message of a stream of this sensor."""
        return self._messages.hello()

    def read(self) -> Reading:
        """Decode a frame of this moment; contacts have forces, places and standard deviations."""
        self.pressed = self._patches()
        self._on = self.sensor.switched(self.pressed, self._on)
        measured = self.sensor.measured(self.pressed, self._on, self._rng)
        self._before = read(self.bundle, measured, self.estimator, before=self._before)
        return self._before

    def step(self) -> Reading:
        """Advance the simulation to the camera's next frame, and decode it."""
        self._mujoco.mj_step(self.model, self.data, nstep=self.steps_per_frame)
        return self.read()

    @property
    def steps_per_frame(self) -> int:
        """Steps of the simulation from one frame of the camera to the next, at least 1."""
        rate_Hz = self.sensor.design.camera.frame_rate_Hz
        return max(round(1.0 / (rate_Hz * float(self.model.opt.timestep))), 1)

    def message(self) -> Message:
        """Decode a frame of this moment, as the stream of the real sensor has it."""
        self._number += 1
        return self._messages.frame(
            self.read(), sequence=self._number - 1, timestamp_s=float(self.data.time)
        )

    def contacts(self) -> GeomContacts:
        """Contacts on the sensor's geoms at this moment, in the sensor's frame."""
        found = self.data.contact
        mine = self._own[found.geom]
        rows = np.flatnonzero(mine.any(axis=1) & ~mine.all(axis=1) & (found.exclude == 0))
        wrench = np.zeros((len(rows), 6))
        for k, row in enumerate(rows.tolist()):
            self._mujoco.mj_contactForce(self.model, self.data, row, wrench[k])
        # Rows of a contact's frame are its axes; the force is that on its second geom.
        frame = found.frame[rows].reshape(-1, 3, 3)
        sign = np.where(mine[rows, 1], 1.0, -1.0)[:, None]
        turn = self.data.xmat[self._body].reshape(3, 3)
        other = np.where(mine[rows, 0], found.geom[rows, 1], found.geom[rows, 0])
        return GeomContacts(
            point_mm=1e3 * (found.pos[rows] - self.data.xpos[self._body]) @ turn + self._origin_mm,
            force_N=sign * np.einsum("ci,cij->cj", wrench[:, :3], frame) @ turn,
            other=other.astype(np.int64),
        )

    def _patches(self) -> Indentations:
        """Patches on the sensing face."""
        surface, found = self.sensor.surface, self.contacts()
        low, high = surface.domain.T
        uv = surface.chart(found.point_mm)
        uv = np.where(np.array(surface.periodic), uv, np.clip(uv, low, high))
        gap_mm, normal = found.point_mm - surface.point(uv), surface.normal(uv)
        over_mm = np.sum(gap_mm * normal, axis=1)
        beside_mm = np.linalg.norm(gap_mm - over_mm[:, None] * normal, axis=1)
        on_face = (np.abs(over_mm) < DEEP_MM) & (beside_mm < BESIDE_MM)
        inward_N = -np.sum(found.force_N * normal, axis=1)
        felt = on_face & (inward_N > 0.0)
        self.elsewhere_N = float(np.linalg.norm(found.force_N[~felt], axis=1).sum())
        rows = np.flatnonzero(felt)
        if not len(rows):
            return _patches_of([], self._indenter)
        groups = list(_groups(found.point_mm, found.other, inward_N, rows, self._radius_mm))
        centres = np.array(
            [inward_N[own] @ found.point_mm[own] / inward_N[own].sum() for own in groups]
        )
        if len(groups) == len(rows):  # patches of one point each
            at = uv[np.concatenate(groups)]
        else:
            at = surface.chart(centres)
            at = np.where(np.array(surface.periodic), at, np.clip(at, low, high))
        frames = self.sensor.patch_frames(at)
        patches = []
        for k, group in enumerate(groups):
            weight = inward_N[group] / inward_N[group].sum()
            arm = found.point_mm[group] - centres[k]
            spread = float(weight @ np.sum(arm**2, axis=1))
            radius = self._radius_mm(int(found.other[group[0]]))
            force = found.force_N[group].sum(axis=0)
            inward = float(-force @ frames.normal[k])
            if inward <= 0.0:
                continue
            shear = frames.axes[k] @ force / inward
            # A contact at an edge may push along the surface more than any friction does.
            shear *= min(1.0, FRICTION_MAX / max(float(np.linalg.norm(shear)), 1e-9))
            # A disc with the second moment of discs at the points.
            patches.append((*at[k], np.sqrt(radius**2 + 2.0 * spread), inward, *shear))
        return _patches_of(patches, self._indenter)


def _groups(
    point_mm: FloatArray,
    other: IntArray,
    inward_N: FloatArray,
    rows: IntArray,
    radius_mm: Callable[[int], float],
) -> Iterator[IntArray]:
    """Yield points that make one patch: of one geom, within its radius of the strongest."""
    rest = rows[np.argsort(-inward_N[rows], kind="stable")]
    while len(rest):
        first = rest[0]
        near = np.linalg.norm(point_mm[rest] - point_mm[first], axis=1)
        own = (other[rest] == other[first]) & (near <= radius_mm(int(other[first])))
        yield rest[own]
        rest = rest[~own]


def _patches_of(rows: list[tuple[float, ...]], indenter: int) -> Indentations:
    """Patches of rows (u, v, radius, force, friction along u and square to it)."""
    table, count = np.array(rows, dtype=np.float64).reshape(-1, 6), len(rows)
    return Indentations(
        uv=table[:, :2],
        radius_mm=table[:, 2],
        force_N=table[:, 3],
        indenter=np.full(count, indenter, dtype=np.int64),
        length_mm=np.zeros(count),
        turn_rad=np.zeros(count),
        friction=table[:, 4:],
    )


def mujoco_library() -> Any:
    """The package mujoco.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise MissingPartError.of_library("PhytacMujoco", "mujoco", "simulators") from None
    return mujoco
