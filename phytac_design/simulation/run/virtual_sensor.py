"""A virtual print that answers contacts within milliseconds, for simulators that step in real time.

Its wall is tabulated on the simulation's own meshes, with the thickness, modulus and markers of
the print: they are not those of the decoder, nor nested in them. Between places the tables are
interpolated by the same formula as the decoder's, see
:mod:`phytac_decoder.mechanics.response_table`. ``phytac simulate`` solves every press instead.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from phytac_decoder.estimation.contact_shifts import ContactState, predicted_shifts
from phytac_decoder.io.bundle_locator import response_arrays, response_from_arrays
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import Readers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import SPHERE, Indentations
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.simulation.imaging.imaging_model import CentroidErrors, ImagingModel
from phytac_design.simulation.instance_shell import instance_shells
from phytac_design.simulation.linear_response import rigid_slope
from phytac_design.simulation.pressed_series import ImageResponse
from phytac_design.simulation.response_tables import place_spacing_mm, tabulate_responses
from phytac_design.simulation.run.switch_loads import SwitchLoads
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

ERRORS = ("rest_px", "place_px", "noise_px", "grid_px", "tip_bias_px")
"""Arrays of :class:`CentroidErrors`."""
SPACING = 0.9
"""Distance of places over the decoder's: only those at the edges are places of both."""


class PatchFrames(NamedTuple):
    """Points (c, 3) mm of patches, outward normals (c, 3), and tangents (c, 2, 3) there."""

    point_mm: FloatArray
    normal: FloatArray
    axes: FloatArray


@dataclass(frozen=True, kw_only=True)
class VirtualSensor:
    """One virtual print; arrays run over n markers.

    Attributes
    ----------
    design, surface : Design, Surface
        The sensor as designed.
    unit : SensorInstance
        How this print differs.
    places : ResponseTable
        What contacts do to the images of its markers.
    errors : CentroidErrors
        Errors of centroids in its frames.
    """

    design: Design
    surface: Surface
    unit: SensorInstance
    places: ResponseTable
    errors: CentroidErrors

    @classmethod
    def of(
        cls,
        imaging: ImagingModel,
        design: Design,
        surface: Surface,
        accuracy: Accuracy,
        progress: Callable[[str], None] = lambda _: None,
    ) -> "VirtualSensor":
        """Tabulate a print.

        Parameters
        ----------
        imaging : ImagingModel
            Of the print.
        design, surface : Design, Surface
            The sensor as designed.
        accuracy : Accuracy
            Its ``truth_refine`` is that of the finer mesh.

        Raises
        ------
        InputError
            If the print cannot be read.
        NumericalError
            If its shell cannot be solved.
        """
        unit, training = imaging.unit, design.training
        (mesh, model), pair = instance_shells(design, surface, unit, accuracy.truth_refine)
        radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        done = tabulate_responses(
            Sensor.of(design, surface, unit.markers),
            mesh=mesh,
            model=model,
            pair=pair,
            see=_image_response(imaging),
            spacing_mm=SPACING * place_spacing_mm(surface, accuracy.place_share, radius),
            orders=accuracy.place_orders,
            progress=progress,
        )
        return cls(
            design=design,
            surface=surface,
            unit=unit,
            places=done.places,
            errors=imaging.errors,
        )

    def arrays(self) -> dict[str, Any]:
        """What :meth:`from_arrays` needs besides design and print."""
        scale = np.array([self.places.radius_mm, self.places.top_N])
        own = {f"errors.{name}": getattr(self.errors, name) for name in ERRORS}
        return response_arrays(self.places) | own | {"scale": scale}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, Any], design: Design, surface: Surface, unit: SensorInstance
    ) -> "VirtualSensor":
        """Undo :meth:`arrays`."""
        radius, top = arrays["scale"].tolist()
        return cls(
            design=design,
            surface=surface,
            unit=unit,
            places=response_from_arrays(arrays, radius, top),
            errors=CentroidErrors(
                number=unit.number, **{name: arrays[f"errors.{name}"] for name in ERRORS}
            ),
        )

    def shifts_px(self, contacts: Indentations) -> FloatArray:
        """Shift (n, 2) px of each marker's paint under simultaneous contacts, without noise.

        What tips cover and what friction does beyond linear theory is not part of it.
        """
        total = np.zeros(2 * self.unit.markers.count)
        if not len(contacts.force_N):
            return total.reshape(-1, 2)
        for shift, _ in predicted_shifts(self.places, self._states(contacts)):
            total += shift
        return total.reshape(-1, 2)

    def switched(self, contacts: Indentations, before: BoolArray | None = None) -> BoolArray:
        """Switches (n,) that are on.

        Parameters
        ----------
        contacts : Indentations
            All contacts at a time.
        before : (n,) bool, optional
            Switches that were on just before: they go off at their lower threshold.
        """
        frames = self.patch_frames(contacts.uv)
        share = self._switch_loads.shares(contacts, frames.point_mm, frames.normal)
        carried = contacts.force_N @ share
        on = carried > self.unit.on_N
        if before is not None:
            on |= before & (carried > self.unit.off_N)
        return np.asarray(on)

    def measured(
        self, contacts: Indentations, on: BoolArray, rng: np.random.Generator | None
    ) -> FrameMeasurement:
        """What a frame shows under contacts.

        Parameters
        ----------
        contacts : Indentations
            All contacts at a time.
        on : (n,) bool
            Switches that are on.
        rng : Generator or None
            Draws the noise; none without.
        """
        shift = self.errors.added(self.shifts_px(contacts), on, rng=rng)
        seen = on & self.design.has_switches
        return FrameMeasurement(
            koi=np.flatnonzero(seen), shift_px=shift, found=np.isfinite(shift[:, 0])
        )

    def patch_frames(self, uv: FloatArray) -> PatchFrames:
        """Where patches at chart positions (c, 2) are; those of the last call are kept."""
        last = self._last_frames
        if not last or not np.array_equal(last[0][0], uv):
            along, across = tangent_frame(self.surface, uv)
            frames = PatchFrames(
                self.surface.point(uv), np.cross(along, across), np.stack([along, across], axis=1)
            )
            last[:] = [(uv.copy(), frames)]
        return last[0][1]

    @cached_property
    def _last_frames(self) -> list[tuple[FloatArray, PatchFrames]]:
        """Chart positions and frames of the last patches; empty at first."""
        return []

    @cached_property
    def _switch_loads(self) -> SwitchLoads:
        """Shares of contacts on the switches."""
        radius = self.design.switch.footprint_diameter_mm / 2.0
        return SwitchLoads(self.surface, self.unit.markers.uv, radius)

    def _states(self, contacts: Indentations) -> Sequence[ContactState]:
        """Contacts as the tables take them: discs of the same second moment."""
        places = self.places
        points, _, axes = self.patch_frames(contacts.uv)
        nearest = places.nearest(points)
        none = np.zeros(0, dtype=np.int64)
        states = []
        for k, place in enumerate(nearest.tolist()):
            # Second moment of a disc, or of Hertz's pressure, less that of the tables' disc.
            share = 0.2 if contacts.indenter[k] == SPHERE else 0.25
            moment = share * contacts.radius_mm[k] ** 2 - 0.25 * places.radius_mm**2
            along = contacts.friction[k] @ axes[k]
            x = np.array(
                [
                    contacts.force_N[k],
                    *places.tangent_coordinates([place], points[k : k + 1])[0],
                    *(moment, 0.0, moment),
                    *places.axes[place] @ along,
                ]
            )
            states.append(
                ContactState(
                    place=place,
                    x=x,
                    start_mm=points[k],
                    place_sd_mm=0.0,
                    tables=places.cubic(place),
                    shear=places.shear_cubic(place),
                    markers=none,
                )
            )
        return states


def _image_response(imaging: ImagingModel) -> ImageResponse:
    """What the print's cameras see of the motion of its markers."""
    markers = imaging.unit.markers
    arm = markers.tip_mm - markers.mid_mm
    readers = Readers(cameras=imaging.unit.cameras, read_by=imaging.nominal.read_by)
    slope = imaging.paint_slope()
    point = rigid_slope(readers.jacobian(markers.tip_mm), arm)
    # A marker that is not seen has no centroid, and is not found in any frame either.
    slope = np.where(np.isfinite(slope), slope, point)
    return ImageResponse(readers, markers.mid_mm, arm, slope)
