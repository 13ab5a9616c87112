"""A press that the user drags over the camera view: the wall moves by the mesh of a draft build.

Receptors, wall and red tips are rendered as in the report's pictures of a press. The motion is
linear in the force. Once a design's shell is factorised, a press takes tens of milliseconds.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.core.json_values import finite
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.rules.check import check_design
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_design.simulation.linear_response import motion_responses
from phytac_design.studio.draft import rendered, small_camera
from phytac_design.studio.latest_only import Check
from phytac_shapes.arrays import FloatArray

Json = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class PressView:
    """One design's camera views under a press; what does not depend on the press is kept.

    Attributes
    ----------
    design : Design
        The design.
    side_px : int
        Longer side of the images at most.
    """

    design: Design
    side_px: int

    @cached_property
    def sensor(self) -> Sensor:
        """The design with its surface, markers and cameras.

        Raises
        ------
        DesignError
            If the design breaks a rule.
        """
        return check_design(self.design)

    @cached_property
    def cameras(self) -> list[Camera]:
        """Cameras with the images' pixels."""
        return [small_camera(camera, self.side_px) for camera in self.sensor.cameras]

    @cached_property
    def _scenes(self) -> list[PressedScene]:
        return [PressedScene(self.sensor, camera) for camera in self.cameras]

    @cached_property
    def _wall_px(self) -> list[FloatArray]:
        """Image positions (n, 2) of the inner face under each marker, by camera."""
        return [camera.project(self._inner_mm(self.sensor.markers.uv)) for camera in self.cameras]

    def _inner_mm(self, uv: FloatArray) -> FloatArray:
        """Points (n, 3) of the inner face."""
        surface = self.sensor.surface
        return np.asarray(surface.point(uv) - self.design.wall.thickness_mm * surface.normal(uv))

    def chart_position(self, number: int, at_px: FloatArray) -> FloatArray:
        """Chart position (2,) of the wall that camera ``number`` sees at an image position (2,).

        The nearest on the surface where that is beside it.
        """
        surface, camera = self.sensor.surface, self.cameras[number]
        away = np.linalg.norm(self._wall_px[number] - at_px, axis=1)
        away = np.nan_to_num(away, nan=np.inf)
        uv = self.sensor.markers.uv[int(away.argmin())].astype(np.float64)
        best: FloatArray = uv
        best_px = float(away.min())
        low, high = surface.domain.T
        step = 1e-4 * (high - low)
        for _ in range(12):
            # Differences to the inner side of an edge.
            side = np.where(uv + step > high, -step, step)
            points = camera.project(self._inner_mm(np.stack([uv, *(uv + np.diag(side))])))
            slope = ((points[1:] - points[0]) / side[:, None]).T
            if not np.isfinite(points).all():
                break
            change = np.linalg.lstsq(slope, at_px - points[0], rcond=None)[0]
            # Not so far that the face bends away.
            change *= min(1.0, 0.1 / max(float(np.max(np.abs(change) / (high - low))), 1e-12))
            uv = uv + change
            for axis in range(2):
                if surface.periodic[axis]:
                    span = high[axis] - low[axis]
                    uv[axis] = low[axis] + (uv[axis] - low[axis]) % span
            uv = np.clip(uv, low, high)
            off_px = float(np.linalg.norm(camera.project(self._inner_mm(uv[None]))[0] - at_px))
            if np.isfinite(off_px) and off_px < best_px:
                best, best_px = uv, off_px
        return best

    @cached_property
    def _shell(self) -> tuple[ShellMesh, ShellModel]:
        """Mesh and model of the shell, as in a draft build."""
        design, markers, settings = self.design, self.sensor.markers, PRESETS["draft"]
        mesh = marker_mesh(
            self.sensor.surface,
            markers,
            thickness_mm=design.wall.thickness_mm,
            refine=settings.refine,
        )
        receptors = settings.receptors and not unknown_receptors(design)
        return mesh, sensor_model(design, markers, mesh, receptors=receptors)

    def motion(self, uv: FloatArray, force_N: float) -> FloatArray:
        """Motion (n, 6) of the wall under each marker, mm and rad, by a press at ``uv`` (2,)."""
        mesh, model = self._shell
        per_newton = motion_responses(
            model,
            mesh,
            self.sensor.surface,
            self.sensor.markers,
            uv=uv[None],
            radius_mm=np.array([self.radius_mm]),
        )
        return np.asarray(force_N * per_newton[0])

    @property
    def radius_mm(self) -> float:
        """Radius of the press: the mean of the design's contacts."""
        training = self.design.training
        return (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0

    def draw(self, number: int, share: FloatArray, force_N: float, check: Check) -> Json:
        """Camera views under a press.

        Parameters
        ----------
        number : int
            Camera in whose view the press is placed; the last one if there are fewer.
        share : (2,) float
            Place in its image, as shares of width and height.
        force_N : float
            Force of the press.
        check : callable
            Called between steps; may raise to stop.

        Returns
        -------
        dict
            Plain JSON: ``cameras`` (``jpeg``, ``ids``, ``tip_px`` as in a draft, and ``press``, the
            place as shares of width and height), ``force_N``, ``radius_mm``, ``marker`` (the
            nearest one), ``dent_mm`` (its motion inwards) and ``on`` (switches that are on).
        """
        number = min(number, len(self.cameras) - 1)
        camera, surface, markers = self.cameras[number], self.sensor.surface, self.sensor.markers
        size = np.array([camera.width_px, camera.height_px])
        uv = self.chart_position(number, share * size - 0.5)
        motion = self.motion(uv, force_N)
        check()
        contact = Contacts.flat(
            sample=np.zeros(1, dtype=np.int64),
            uv=uv[None],
            radius_mm=np.array([self.radius_mm]),
            force_N=np.array([force_N]),
            samples=1,
        )
        switching = switch_states(self.sensor, contact)
        on = switching.bits[0] & self.design.has_switches
        out = switching.shown[0] if self.design.has_switches else on
        pictures = []
        for view, scenes in zip(self.cameras, self._scenes, strict=True):
            check()
            tips = markers.tip_mm - markers.mid_mm
            moved = markers.tip_mm + motion[:, :3] + np.cross(motion[:, 3:], tips)
            press = view.project(self._inner_mm(uv[None]))[0]
            place = ((press + 0.5) / [view.width_px, view.height_px]).tolist()
            pictures.append(rendered(scenes.scene(motion, out), view, moved) | {"press": place})
        away = np.linalg.norm(surface.point(markers.uv) - surface.point(uv[None]), axis=1)
        nearest = int(away.argmin())
        drawn: Json = finite(
            {
                "cameras": pictures,
                "force_N": force_N,
                "radius_mm": self.radius_mm,
                "marker": nearest,
                "dent_mm": -float(motion[nearest, :3] @ markers.normal[nearest]),
                "on": int(on.sum()),
            }
        )
        return drawn
