"""Whether OpenGL shows the same markers: the decoder's detector on another renderer's picture."""

from dataclasses import dataclass

import numpy as np

from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.opengl_picture import render_picture
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import build_scene, paint_owner
from phytac_design.simulation.imaging.nominal_view import colour_model, matched, owner_centroids

CENTROID_MAX_px = 0.5
"""Largest distance of a marker between the two that is in order. OpenGL averages colours after its
gamma and with few samples, which moves edges between light and dark by some tenths of a pixel."""


@dataclass(frozen=True, kw_only=True)
class OpenGLComparison:
    """What the decoder's detector finds of one camera's view, at rest.

    Attributes
    ----------
    markers : int
        Markers that the project's own frame shows.
    found : int
        Those of them that are found in OpenGL's picture.
    median_px, max_px : float
        Distances of their centroids in the two; NaN if none is found.
    """

    markers: int
    found: int
    median_px: float
    max_px: float

    @property
    def same(self) -> bool:
        """Whether both show the same markers at the same places."""
        return self.found == self.markers and self.max_px <= CENTROID_MAX_px


def compare_with_opengl(sensor: Sensor) -> list[OpenGLComparison]:
    """Compare each camera's frame of the unloaded sensor with OpenGL's picture of the same scene.

    Projection and hidden surfaces are OpenGL's own; geometry, light and detector are shared.

    Raises
    ------
    MissingPartError
        If OpenGL is not available, or a lens is not a pinhole.
    """
    return [_compare(sensor, number) for number in range(len(sensor.cameras))]


def _compare(sensor: Sensor, number: int) -> OpenGLComparison:
    camera, count = sensor.cameras[number], sensor.markers.count
    scene = build_scene(sensor, tolerance_mm=tolerance_mm(camera, sensor.markers))
    centroid = owner_centroids(paint_owner(rasterise(scene, camera).part), count)
    # Marks, which `matched` looks for behind the markers, are left out.
    expected = np.pad(centroid, ((0, sensor.reference_marks.count), (0, 0)), constant_values=np.nan)
    model = colour_model(sensor.design)[0]
    own, other = (
        matched(sensor, model.prepared(image), expected)
        for image in (render_frame(scene, camera), render_picture(scene, camera))
    )
    both = own.found & other.found
    distance = np.linalg.norm(own.position_px - other.position_px, axis=1)[both]
    return OpenGLComparison(
        markers=int(own.found.sum()),
        found=int(both.sum()),
        median_px=float(np.median(distance)) if both.any() else float("nan"),
        max_px=float(distance.max(initial=-np.inf)) if both.any() else float("nan"),
    )
