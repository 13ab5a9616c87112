"""How a virtual sensor is seen: by frames, or by points that behave as if they came from frames."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import with_pictures_at_rest
from phytac_decoder.pipeline.decode import (
    confirmed_switches,
    in_rest_light,
    locate_in,
    locate_markers,
    prepared_frames,
    with_edges,
)
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import Exposure, expose, lens_blur
from phytac_design.optics.loaded_visibility import scene_state
from phytac_design.optics.render_scene import RenderScene
from phytac_design.simulation.imaging.nominal_view import expected_views, vision_bundle
from phytac_design.simulation.imaging.paint_centroids import PaintPoints
from phytac_design.simulation.imaging.virtual_camera import SimulatedCamera, TipCover, bar_strip
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from phytac_shapes.errors import InputError

Centroids = Literal["paint", "pixels"]


@dataclass(frozen=True, kw_only=True)
class MarkerReading:
    """What was read of one sample; arrays over n markers.

    Attributes
    ----------
    shift_px : (n, 2) float
        Shift against the rest frame, the red tip's cover corrected; NaN where not found.
    bits : (n,) bool
        Switches that read as on.
    found : (n,) bool
        Markers that were seen.
    status : str
        Why nothing could be read; "" if it could.
    """

    shift_px: FloatArray
    bits: BoolArray
    found: BoolArray
    status: str = ""

    @classmethod
    def nothing(cls, count: int, status: str) -> "MarkerReading":
        """Of a sample that cannot be read."""
        no = np.zeros(count, dtype=np.bool_)
        return cls(shift_px=np.full((count, 2), np.nan), bits=no, found=no.copy(), status=status)


@dataclass(frozen=True, kw_only=True)
class CentroidNoise:
    """Positions of n markers at rest, and what moves them though nothing presses.

    Attributes
    ----------
    rest_px : (n, 2) float
        Rest positions: mean of eight frames; NaN where not found.
    noise_px : (n, 2) float
        Standard deviation of one frame's positions.
    grid_px : (n, 2) float
        Standard deviation of the error that depends on where on the pixels a marker lies.
    tip_bias_px : (n, 2) float
        What this instance's own tip covers, less what the decoder allows for.
    """

    rest_px: FloatArray
    noise_px: FloatArray
    grid_px: FloatArray
    tip_bias_px: FloatArray


@dataclass(frozen=True, kw_only=True)
class RestObservation(CentroidNoise):
    """What the unloaded sensor shows, measured in its own frames.

    Attributes
    ----------
    bundle : Bundle
        The design's marker detector, set to where this instance's markers are and to their edges.
    """

    bundle: Bundle


@dataclass(frozen=True, kw_only=True)
class CentroidErrors(CentroidNoise):
    """Errors of the centroids of one sensor instance; arrays over n markers.

    Attributes
    ----------
    number : int
        Of the instance.
    place_px : (n, 2) float
        Projected centroid of the paint at rest.
    """

    number: int
    place_px: FloatArray

    def added(
        self,
        shift_px: FloatArray,
        bits: BoolArray,
        *,
        light: float = 1.0,
        rng: np.random.Generator | None = None,
    ) -> FloatArray:
        """Shifts (n, 2) px as measured, of those of the paint; NaN where a marker is not found.

        Parameters
        ----------
        shift_px : (n, 2) float
            Of the paint's centroid.
        bits : (n,) bool
            Switches that are on.
        light : float
            Brightness over that at the start.
        rng : Generator, optional
            Draws the noise; none without.
        """
        shift = shift_px + np.where(bits[:, None], self.tip_bias_px, 0.0)
        shift[~np.isfinite(self.rest_px[:, 0])] = np.nan
        if rng is not None:
            grid = pixel_phase_error(self.place_px + shift, self.number) - pixel_phase_error(
                self.place_px, self.number
            )
            noise = rng.standard_normal(shift.shape) * self.noise_px / np.sqrt(light)
            shift += self.grid_px * grid + noise
        return shift


class ImagingModel:
    """All cameras of one sensor instance.

    Parameters
    ----------
    design, surface : Design, Surface
        The sensor as designed: what the decoder expects.
    unit : SensorInstance
        The sensor as made.
    exposure : Exposure
        How frames are exposed.
    views : mapping, optional
        Arrays of the stage ``views``, where they are known already.
    compliance_px : (2n, n) float, optional
        Of the stage ``response``: with it switches whose red is doubtful are confirmed by the
        force that their markers' motion needs, as in the decoder.
    centroids : {"paint", "pixels"}
        How points are found: from the paint that faces the camera, or with what neighbours, bar
        and wall hide of it as well, from exact ID maps.
    samples : int
        Samples per pixel of frames.
    at_rest : RestObservation or str, optional
        :attr:`rest` of another model of the same instance and settings, to skip measuring it.
    """

    def __init__(
        self,
        design: Design,
        surface: Surface,
        unit: SensorInstance,
        *,
        exposure: Exposure,
        views: Mapping[str, Any] | None = None,
        compliance_px: FloatArray | None = None,
        centroids: Centroids = "paint",
        samples: int = 8,
        at_rest: RestObservation | str | None = None,
    ) -> None:
        nominal = make_markers(design, surface)
        self.unit, self.exposure, self.centroids = unit, exposure, centroids
        self._given, self._has_switches = at_rest, design.has_switches
        self.confirm = compliance_px is not None
        of_design = Sensor.of(design, surface, nominal)
        self.nominal = vision_bundle(
            of_design,
            expected_views(of_design) if views is None else views,
            compliance_px=compliance_px,
        )
        strip = bar_strip(of_design) if exposure.fall_off else None
        self.cameras = [
            SimulatedCamera(
                design,
                surface,
                unit,
                camera,
                lens_blur(Sensor.of(design, surface, nominal), aim) if exposure.lens_blur else None,
                strip=strip,
                samples=samples,
            )
            for camera, aim in zip(unit.cameras, cameras_of(design, surface), strict=True)
        ]

    @property
    def count(self) -> int:
        """Number of markers."""
        return self.unit.markers.count

    @property
    def status(self) -> str:
        """Why this sensor cannot be read at all; "" if it can."""
        return self.rest if isinstance(self.rest, str) else ""

    @property
    def at_rest(self) -> RestObservation:
        """What the unloaded sensor shows.

        Raises
        ------
        InputError
            If it cannot be read, see :attr:`status`.
        """
        if isinstance(self.rest, str):
            raise InputError("rest-frame-undecodable", self.rest)
        return self.rest

    def frame(
        self,
        motion: FloatArray,
        out: BoolArray | FloatArray,
        light: float = 1.0,
        rng: np.random.Generator | None = None,
    ) -> tuple[ImageArray, ...]:
        """Frame (h, w, 3), BGR, of each camera.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation vector (rad) of the middle face under each marker.
        out : (n,) bool or float
            Tips that are out, or how far each is, as a share of the stroke.
        light : float
            Brightness over that at the start.
        rng : Generator, optional
            Draws the noise; none without.
        """
        return tuple(
            self._exposed(simulated, simulated.light(simulated.scene(motion, out)), light, rng)
            for simulated in self.cameras
        )

    def read(self, frames: tuple[ImageArray, ...]) -> MarkerReading:
        """Read frames as the decoder does, against this instance's rest frames."""
        if self.status:
            return MarkerReading.nothing(self.count, self.status)
        rest = self.at_rest
        bundle = rest.bundle
        try:
            matched, bits, half_out = locate_markers(bundle, frames)
        except InputError as error:
            return MarkerReading.nothing(self.count, str(error))
        images = in_rest_light(bundle, prepared_frames(bundle, frames))
        moved = matched.position_px - rest.rest_px
        moved = with_edges(bundle, images, moved, bits, half_out)
        if self.confirm:
            bits = confirmed_switches(bundle, bits, moved - bundle.tip_shift_px(bits))
        shift = moved - bundle.tip_shift_px(bits)
        found = np.isfinite(shift[:, 0])
        return MarkerReading(shift_px=shift, bits=bits, found=found)

    def points(
        self,
        motion: FloatArray,
        bits: BoolArray,
        light: float = 1.0,
        rng: np.random.Generator | None = None,
        *,
        out: FloatArray | None = None,
    ) -> MarkerReading:
        """What :meth:`read` would find in :meth:`frame`, without an image; parameters as there.

        Bits are taken as they are; of gradual switches ``out`` is how far tips are out. Noise is
        that of each marker's centroid in this instance's frames, which grows as light gets scarce;
        and the error of segmentation that depends on where on the pixels a marker lies: the same
        for the same place, and none for a marker at rest.
        """
        if self.status:
            return MarkerReading.nothing(self.count, self.status)
        shown = bits if out is None else out
        shift = self.exact(motion, shown, light) + self._covered(motion, bits, shown)
        shift = self.errors.added(shift, bits, light=light, rng=rng)
        seen = bits & self._has_switches
        return MarkerReading(shift_px=shift, bits=seen, found=np.isfinite(shift[:, 0]))

    def exact(
        self, motion: FloatArray, out: BoolArray | FloatArray, light: float = 1.0
    ) -> FloatArray:
        """Shift (n, 2) px of each marker's paint, without noise and without what tips cover."""
        shift = self._places(motion, light) - self._places_at_rest
        if self.centroids == "pixels":
            shift += self._hiding(motion, out)
        return shift

    @cached_property
    def errors(self) -> CentroidErrors:
        """Errors of centroids in this instance's frames.

        Raises
        ------
        InputError
            If the sensor cannot be read, see :attr:`status`.
        """
        rest = self.at_rest
        return CentroidErrors(
            number=self.unit.number,
            rest_px=rest.rest_px,
            place_px=self._places_at_rest,
            noise_px=rest.noise_px,
            grid_px=rest.grid_px,
            tip_bias_px=rest.tip_bias_px,
        )

    def paint_slope(self) -> FloatArray:
        """How centroids move with the wall under each marker, (n, 2, 6): px per mm and radian.

        Each through the camera that reads it; NaN where no paint is seen.
        """
        each = [paint.slope() for paint in self._paints]
        return np.asarray(np.stack(each)[self.nominal.read_by, np.arange(self.count)])

    def _places(self, motion: FloatArray, light: float) -> FloatArray:
        """Centroid (n, 2) px of each marker's paint, through the camera that reads it."""
        each = [paint.centroids(motion, light) for paint in self._paints]
        return np.asarray(np.stack(each)[self.nominal.read_by, np.arange(self.count)])

    def _covered(
        self, motion: FloatArray, bits: BoolArray, out: BoolArray | FloatArray
    ) -> FloatArray:
        """How far tips move centroids, over what those of switches that are on do at rest."""
        still = np.zeros_like(motion)
        each = [
            tips.shift_px(motion, np.where(self.nominal.read_by == number, out, np.zeros_like(out)))
            - tips.shift_px(still, bits & (self.nominal.read_by == number))
            for number, tips in enumerate(self._tips)
        ]
        return np.asarray(sum(each))

    @cached_property
    def _tips(self) -> list[TipCover]:
        return [
            TipCover(simulated.rest, simulated.on, simulated.camera, simulated.pivots_mm)
            for simulated in self.cameras
        ]

    @cached_property
    def _paints(self) -> list[PaintPoints]:
        return [
            PaintPoints(
                simulated.rest,
                simulated.camera,
                self.unit.markers,
                chosen=self.nominal.read_by == number,
                colours=self.nominal.colours,
                colour=self.nominal.colour,
                strip=simulated.strip,
                paint=simulated.paint,
            )
            for number, simulated in enumerate(self.cameras)
        ]

    @cached_property
    def _places_at_rest(self) -> FloatArray:
        return self._places(np.zeros((self.count, 6)), 1.0)

    @cached_property
    def _hiding_at_rest(self) -> list[FloatArray]:
        """Centroid offsets (n, 2) px by occlusion at rest, in each camera."""
        return [_occlusion_px(simulated, simulated.rest) for simulated in self.cameras]

    def _hiding(self, motion: FloatArray, out: BoolArray | FloatArray) -> FloatArray:
        """How far what hides parts of a marker moves its centroid, over that at rest, (n, 2) px."""
        each = [
            _occlusion_px(simulated, simulated.scene(motion, out, wall_follows=False)) - rest
            for simulated, rest in zip(self.cameras, self._hiding_at_rest, strict=True)
        ]
        return np.asarray(np.stack(each)[self.nominal.read_by, np.arange(self.count)])

    def _exposed(
        self,
        simulated: SimulatedCamera,
        light: NDArray[np.float32],
        brightness: float,
        rng: np.random.Generator | None,
    ) -> ImageArray:
        return expose(light, simulated.camera, self.exposure, brightness=brightness, rng=rng)

    @cached_property
    def rest(self) -> RestObservation | str:
        """What the unloaded sensor shows, or why it cannot be read; can be pickled."""
        # A marker at rest whose place scatters more from frame to frame is mistaken for others.
        rest_noise_max_px = 1.0
        rest_stream = 23  # of the generators of those frames
        # Noisy rest frames that an instance's rest positions and their noise are measured in.
        rest_frames = 8
        if self._given is not None:
            return self._given
        still, off = np.zeros((self.count, 6)), np.zeros(self.count, dtype=np.bool_)
        lights = [simulated.light(simulated.scene(still, off)) for simulated in self.cameras]
        rng = np.random.default_rng([rest_stream, self.unit.number])

        def draw() -> tuple[ImageArray, ...]:
            return tuple(
                self._exposed(simulated, light, 1.0, rng)
                for simulated, light in zip(self.cameras, lights, strict=True)
            )

        try:
            bundle = self._set_to(draw())
            drawn = [draw() for _ in range(rest_frames)]
            found = np.stack([locate_markers(bundle, frames)[0].position_px for frames in drawn])
            clean = tuple(
                self._exposed(simulated, light, 1.0, None)
                for simulated, light in zip(self.cameras, lights, strict=True)
            )
            before = locate_markers(bundle, clean)[0].position_px
            grid = self._grid(bundle, before)
            after = locate_markers(bundle, self.frame(still, ~off))[0].position_px
            # Frames are read by a bundle that knows the markers' edges. Points are of the paint
            # alone, and so is the noise above, which is theirs.
            mean = tuple(
                np.rint(np.mean(each, axis=0)).astype(np.uint8) for each in zip(*drawn, strict=True)
            )
            read_by = with_pictures_at_rest(bundle, prepared_frames(bundle, mean))
        except InputError as error:
            return str(error)
        noise = found.std(axis=0, ddof=1)
        sure = np.linalg.norm(noise, axis=1) <= rest_noise_max_px
        return RestObservation(
            bundle=read_by,
            rest_px=np.where(sure[:, None], found.mean(axis=0), np.nan),
            noise_px=noise,
            grid_px=grid,
            tip_bias_px=np.nan_to_num(after - before - bundle.tip_shift_px(~off)),
        )

    def _grid(self, bundle: Bundle, before: FloatArray) -> FloatArray:
        """Standard deviation (n, 2) px of the centroids' error over places on the pixels."""
        # Besides none, shifts of the image at which the error of placing markers on pixels is
        # measured.
        pixel_shifts_px = ((0.25, 0.5), (0.5, -0.25), (-0.25, 0.25))
        still, off = np.zeros((self.count, 6)), np.zeros(self.count, dtype=np.bool_)
        scenes = [simulated.scene(still, off) for simulated in self.cameras]
        found = [before]
        for shift in pixel_shifts_px:
            frames = tuple(
                self._exposed(simulated, simulated.light(scene, shift), 1.0, None)
                for simulated, scene in zip(self.cameras, scenes, strict=True)
            )
            found.append(locate_markers(bundle, frames)[0].position_px - np.array(shift))
        return np.asarray(np.stack(found).std(axis=0, ddof=1))

    def _set_to(self, frames: tuple[ImageArray, ...]) -> Bundle:
        """Marker detector that expects markers and tips where this instance's rest frame has them.

        What is not found there is expected where the design has it.
        """
        shown = []
        for number, frame in enumerate(prepared_frames(self.nominal, frames)):
            old = self.nominal.shown_by(number)
            matched, _ = locate_in(self.nominal, number, frame)
            move = np.where(matched.found[:, None], matched.position_px - old.rest_px, 0.0)
            tips = replace(old.tips, on_px=old.tips.on_px + move)
            shown.append(replace(old, rest_px=old.rest_px + move, tips=tips))
        read_by, own = self.nominal.read_by, np.arange(self.count)
        return replace(
            self.nominal,
            shown=tuple(shown),
            rest_px=np.stack([item.rest_px for item in shown])[read_by, own],
            tips=replace(
                self.nominal.tips,
                on_px=np.stack([item.tips.on_px for item in shown])[read_by, own],
            ),
        )


def _occlusion_px(simulated: SimulatedCamera, scene: RenderScene) -> FloatArray:
    """How far what hides parts of each marker moves its centroid in a scene, (n, 2) px."""
    return scene_state(scene, simulated.camera, wall_follows=True).offset_px


def pixel_phase_error(place_px: FloatArray, number: int) -> FloatArray:
    """Error (n, 2) of standard deviation 1 that depends on the place (n, 2) px of a marker alone.

    Segmentation takes pixels in and out as a marker moves over them: places 0.1 px apart err
    independently, the same place always errs alike.
    """
    cell_px = 0.1  # places on the pixels this far apart are misjudged independently
    cell = np.floor(np.nan_to_num(place_px) / cell_px).astype(np.int64).astype(np.uint64)
    marker = np.arange(len(cell), dtype=np.uint64)
    key = np.full(len(cell), number, dtype=np.uint64)
    for part in (marker, cell[:, 0], cell[:, 1]):
        key = _mixed(key ^ part)
    both = np.column_stack([_mixed(key), _mixed(_mixed(key))])
    share = ((both >> np.uint64(11)).astype(np.float64) + 0.5) / 2.0**53
    return np.asarray(ndtri(share), dtype=np.float64)


def _mixed(key: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Next number of splitmix64 (Steele, Lea and Flood 2014)."""
    key = key + np.uint64(0x9E3779B97F4A7C15)
    key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(key ^ (key >> np.uint64(31)))
